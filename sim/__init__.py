"""The simulated tank: a world that plays shots and hides its truth. Imports neither motion nor the forward model."""
