from .reduced.rig import open_reduced as open_reduced
from .tank.world import TankWorld as TankWorld
