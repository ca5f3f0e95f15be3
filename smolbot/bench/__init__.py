"""The bench of a lab: its devices, the check of a rig, calibration of device and sensors."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
