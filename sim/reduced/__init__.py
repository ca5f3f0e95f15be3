"""The reduced plant: the same sampled tank as an overdamped motion, with pose noise in place of signals."""
