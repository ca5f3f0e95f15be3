from .device import Uncertainty as Uncertainty
from .document import Document as Document
from .document import Fault as Fault
from .library import find_file as find_file
from .rig import RigConfig as RigConfig
from .robot import RobotConfig as RobotConfig
from .sensors import CalibratedSensors as CalibratedSensors
from .world import World as World
