from .assembly import make_loop as make_loop
from .loop import Loop as Loop
from .pilots import Pilot as Pilot
from .preview.gradient import Preview as Preview
from .preview.helix import HelixPreview as HelixPreview
from .preview.observation import ObservationPreview as ObservationPreview
from .replay import Replay as Replay
from .session import fly as fly
