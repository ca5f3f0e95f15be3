from .current_ratio import CurrentRatio as CurrentRatio
from .force_allocator import Allocation as Allocation
from .force_allocator import ForceAllocator as ForceAllocator
from .force_allocator import ForceReach as ForceReach
from .force_allocator import UnreachableForceError as UnreachableForceError
from .force_pursuit import ForcePursuit as ForcePursuit
from .helical import Helical as Helical
from .predictive import Predictive as Predictive
