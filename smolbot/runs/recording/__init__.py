"""The record of a run as messages: written during the run, sent to a live page, read again afterwards."""
