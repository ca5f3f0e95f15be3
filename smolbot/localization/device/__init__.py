"""Measurement of the device itself: frequency, damping and amplitude of its oscillation."""
