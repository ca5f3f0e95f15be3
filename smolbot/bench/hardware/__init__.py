"""Drivers of real devices: data acquisition card, magnet stage and power supply of a bench."""
