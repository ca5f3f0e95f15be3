"""Poses, windows and shots, recordings, limits, rotations: what every other room speaks of."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
