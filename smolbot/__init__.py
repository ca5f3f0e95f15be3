"""smolbot steers a magnetic millirobot along a path and localizes it only from magnetic sensors.

What a notebook and a lab's own parts need is importable from here; each name loads its own module when first used.
The names, and where each is defined, stand in ``__init__.pyi``.

The logger ``smolbot`` tells what happens in a flight (info) and what went wrong and was made up for (warning); it is
silent until a program gives it a handler.
"""

import logging

from lazy_loader import attach_stub

from smolbot.core import deprecated

logging.getLogger(__name__).addHandler(logging.NullHandler())
deprecated.install()
__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
