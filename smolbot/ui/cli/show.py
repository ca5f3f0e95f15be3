"""Tables for people, JSON for programs."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Sequence
from typing import Any


def table(title: str, rows: Sequence[tuple[str, str]], *, err: bool = False) -> None:
    """A two-column table on standard output, or on standard error where that is kept for JSON."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    shown = Table(title=title, title_justify="left", title_style="bold", show_header=False, box=None, pad_edge=False)
    shown.add_column(style="cyan", no_wrap=True)
    shown.add_column(overflow="fold")
    for name, value in rows:
        shown.add_row(Text(name), Text(value))
    console = Console(stderr=err, highlight=False)
    if not console.is_terminal:
        console = Console(stderr=err, highlight=False, width=120)
    console.print(shown)


def as_json(value: Any) -> Any:
    """A value that JSON can hold: nan and infinity become null, arrays lists."""
    if isinstance(value, dict):
        return {str(k): as_json(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [as_json(v) for v in value]
    if hasattr(value, "tolist"):
        return as_json(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def echo_json(data: Any) -> None:
    """One JSON object on standard output."""
    sys.stdout.write(json.dumps(as_json(data), indent=2, default=str) + "\n")


def columns(title: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """A table with a header on standard output; the first column names, the others hold figures."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    shown = Table(title=title, title_justify="left", title_style="bold", box=None, pad_edge=False)
    for index, name in enumerate(header):
        shown.add_column(name, style="cyan" if index == 0 else None, justify="left" if index == 0 else "right")
    for row in rows:
        shown.add_row(*(Text(cell) for cell in row))
    console = Console(highlight=False)
    if not console.is_terminal:
        console = Console(highlight=False, width=120)
    console.print(shown)
