"""Functions for programs and notebooks; the command line wraps them. Public as names of `smolbot` itself."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
