"""State estimation from shot to shot: trackers, and filters of resonance and noise."""
