"""The simulated tank: true bodies, coils, sensors and noise, and the rig that exposes them."""
