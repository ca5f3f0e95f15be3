"""A helix in a gel, turned by a rotating magnet, as it truly goes."""
