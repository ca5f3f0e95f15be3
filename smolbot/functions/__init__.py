"""What a program or a notebook calls; the command line is a shell over it. Public as names of `smolbot` itself."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
