"""Files that a user writes, read strictly: missions, rigs, robots, devices, sensors, samples, tracks."""
