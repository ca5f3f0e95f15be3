"""Programs that measure this project itself, from a checkout: kills, faults, speed, accuracy of the video track."""
