"""Paths that a robot follows, and their sources: glyphs, SVG drawings, CSV files."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
