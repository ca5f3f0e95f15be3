from .command import carry_out as carry_out
from .study import Chunk as Chunk
from .study import Columns as Columns
from .study import Options as Options
from .study import Outcome as Outcome
from .study import Study as Study
from .study import cut as cut
from .study import rng_of as rng_of
