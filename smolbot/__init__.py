"""smolbot steers a magnetic millirobot along a path, and localizes it only from magnetic sensors.

What a notebook and a lab's own parts need is importable from here; each name loads its own module when first used.
The names, and where each is defined, stand in ``__init__.pyi``.
"""

from lazy_loader import attach_stub

from smolbot import deprecated

deprecated.install()
__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
