"""Files that a user writes, read strictly: missions, rigs, robots, devices, sensors, samples, tracks."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
