from .localize import Localization as Localization
from .localize import LocatedShot as LocatedShot
from .simulate import Flight as Flight
from .simulate import Simulation as Simulation
from .track import VideoTrack as VideoTrack
from .tune import HeldOut as HeldOut
from .tune import Trial as Trial
from .tune import Tuning as Tuning
