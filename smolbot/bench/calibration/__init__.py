"""Calibration of device and sensors before the first mission."""
