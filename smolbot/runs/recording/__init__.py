"""The record of a run, as messages: written while it goes on, sent to a live page, read again afterwards."""
