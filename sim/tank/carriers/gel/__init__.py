"""The true motion of a helix in a gel, turned by a rotating magnet."""
