"""Field tables: COMSOL's text export, tables computed from coils, their interpolation, and a cache for built ones."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lookup_tables.builder import build, mesh_axis
    from lookup_tables.cache import cached_table
    from lookup_tables.coils import FlatCoil, RoundCoil
    from lookup_tables.errors import OutsideTableError, TableError
    from lookup_tables.table import FieldTable

_HOMES = {
    "FieldTable": "table",
    "FlatCoil": "coils",
    "OutsideTableError": "errors",
    "RoundCoil": "coils",
    "TableError": "errors",
    "build": "builder",
    "cached_table": "cache",
    "mesh_axis": "builder",
}

__all__ = [
    "FieldTable",
    "FlatCoil",
    "OutsideTableError",
    "RoundCoil",
    "TableError",
    "build",
    "cached_table",
    "mesh_axis",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}; it has {', '.join(__all__)}")
    value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value
