"""Curves that a robot follows, and where they come from: glyphs, SVG, CSV."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
