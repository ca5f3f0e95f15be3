"""The noise: learned, described, whitened, and what fits leave of it."""
