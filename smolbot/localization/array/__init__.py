"""Calibration of the sensor array: sensor deviations as unknowns of a fit."""
