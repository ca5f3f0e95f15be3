"""What is believed between two shots: trackers, and filters of resonance and noise."""
