"""Is a rig fit to be used? Measures on its recordings, verdicts against its rig file, and how both are got."""
