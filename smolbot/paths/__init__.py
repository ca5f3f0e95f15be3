"""Curves that a robot follows, and where they come from: glyphs, SVG, CSV."""
