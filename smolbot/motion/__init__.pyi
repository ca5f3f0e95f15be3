from .controller import Cycle as Cycle
from .controller import ForceProfile as ForceProfile
from .controller import HelixSetup as HelixSetup
from .controller import complete_gains as complete_gains
from .external_motion import ExternalMotion as ExternalMotion
from .helix import Helix as Helix
from .robot import Robot as Robot
