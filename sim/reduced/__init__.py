"""The reduced plant: the same drawn tank as an overdamped motion, with pose noise in place of signals."""
