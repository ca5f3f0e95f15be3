"""Controllers: each turns poses into commands, and registers as an entry point of ``smolbot.controllers``."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from controllers.force_allocator import Allocation, ForceAllocator, ForceReach, UnreachableForceError

_HOMES = {
    "Allocation": "force_allocator",
    "ForceAllocator": "force_allocator",
    "ForceReach": "force_allocator",
    "UnreachableForceError": "force_allocator",
}

__all__ = ["Allocation", "ForceAllocator", "ForceReach", "UnreachableForceError"]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}; it has {', '.join(__all__)}")
    return getattr(import_module(f"controllers.{_HOMES[name]}"), name)
