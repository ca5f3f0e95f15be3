"""Measures device and sensors before the first mission."""
