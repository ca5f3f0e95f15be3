"""Localization, from raw sensor signals to a pose: signal chain, forward model, fit."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
