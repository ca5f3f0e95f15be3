"""Where paths come from: a font of single strokes, drawings in SVG, and what is done to them before a robot follows."""
