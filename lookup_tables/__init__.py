"""Field tables: COMSOL's text export, tables computed from coils, interpolation, and a cache of computed tables."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
