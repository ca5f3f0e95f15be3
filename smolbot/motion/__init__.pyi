from .controller import Cycle as Cycle
from .controller import HelixSetup as HelixSetup
from .controller import Reach as Reach
from .controller import complete_gains as complete_gains
from .helix import Helix as Helix
from .led import Motion as Motion
from .robot import Robot as Robot
