"""Studies of localization: Monte-Carlo on a bench of the tank's own sensors, each with a table and a figure."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
