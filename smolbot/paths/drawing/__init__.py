"""Sources of paths: a single-stroke font, SVG drawings, and how both are prepared for a robot."""
