from .force_allocator import Allocation as Allocation
from .force_allocator import ForceAllocator as ForceAllocator
from .force_allocator import ForceReach as ForceReach
from .force_allocator import UnreachableForceError as UnreachableForceError
