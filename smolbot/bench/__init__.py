"""A lab's bench: its devices, the check of a rig, calibration of device and sensors."""
