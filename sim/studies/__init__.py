"""Studies of localization: Monte-Carlo on a bench of the tank's own sensors, each with a table and a figure.

A lab's own study is made of the names below, and installed as an entry point of ``smolbot.studies``.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sim.studies.study import Chunk, Columns, Options, Outcome, Study, cut, rng_of

__all__ = ["Chunk", "Columns", "Options", "Outcome", "Study", "cut", "rng_of"]


def __getattr__(name: str) -> Any:
    if name in __all__:
        return getattr(import_module("sim.studies.study"), name)
    raise AttributeError(f"module 'sim.studies' has no attribute {name!r}")
