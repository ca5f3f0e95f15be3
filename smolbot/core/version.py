"""Version number of smolbot."""

__version__ = "0.1.0"
