"""Controllers: each turns poses into commands, and is registered as an entry point of ``smolbot.controllers``."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
