"""The simulated tank: a world that plays shots and hides its truth. Imports neither motion nor the forward model."""

from lazy_loader import attach_stub

import smolbot as smolbot  # lets old paths be found

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
