from .command import run_study as run_study
from .study import Chunk as Chunk
from .study import Columns as Columns
from .study import Options as Options
from .study import Outcome as Outcome
from .study import Study as Study
from .study import cut_chunks as cut_chunks
from .study import make_rng as make_rng
