"""Field tables: COMSOL's text export, tables computed from coils, their interpolation, and a cache for built ones."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
