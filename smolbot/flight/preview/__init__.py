"""Missions timed and simulated before the flight on the controller's own model."""
