"""The words that everything else speaks: arrays, rotations, poses, shots, sensing, limits, what a rig promises."""
