"""Check of a rig before it is used: measurements, predictions from its rig file, and verdicts."""
