"""Many flights: over seeds, over processes, and their pictures."""
