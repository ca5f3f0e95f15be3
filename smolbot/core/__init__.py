"""What all rooms share: arrays, rotations, poses, shots, sensors, limits, the protocol of a rig."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
