"""Programs that measure this project itself: kills, faults, speed, accuracy of the video track."""
