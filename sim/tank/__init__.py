"""The tank as it truly is: bodies, coils, sensors, noise, and the rig in front of it."""
