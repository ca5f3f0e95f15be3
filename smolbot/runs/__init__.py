"""Results of a run: its folder, record, summary, pictures and report."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
