"""What all rooms share: arrays, rotations, poses, shots, sensors, limits, the protocol of a rig."""
