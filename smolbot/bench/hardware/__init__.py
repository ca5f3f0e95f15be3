"""Real devices: the converter card, the magnet stage and the power supply of a bench."""
