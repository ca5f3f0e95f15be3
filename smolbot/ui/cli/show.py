"""Tables for people, JSON for programs."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any

from smolbot.core.results import format_json

if TYPE_CHECKING:
    from rich.console import Console


def make_console(*, err: bool = False, width: int = 120) -> Console:
    """Make a console for standard output or standard error.

    Parameters
    ----------
    err : bool
        Use standard error, since standard output is kept for JSON.
    width : int
        Width in characters, where the output is no terminal.

    Returns
    -------
    rich.console.Console
    """
    from rich.console import Console

    found = Console(stderr=err, highlight=False)
    return found if found.is_terminal else Console(stderr=err, highlight=False, width=width)


@contextmanager
def show_spinner(text: str, *, quiet: bool = False) -> Iterator[Callable[[str], None]]:
    """Show on a terminal what is going on while a ``with`` block runs.

    Parameters
    ----------
    text : str
        What to show at first.
    quiet : bool
        Show nothing.

    Yields
    ------
    callable
        To be called with a new text.
    """
    shown = make_console(err=True)
    if quiet or not shown.is_terminal:
        yield lambda _: None
        return
    with shown.status(text) as status:
        yield lambda what: status.update(what)


@contextmanager
def show_bar(
    name: str, *columns: Any, total: float | None = None, quiet: bool = False
) -> Iterator[Callable[..., None]]:
    """Show a progress bar on a terminal while a ``with`` block runs.

    Parameters
    ----------
    name : str
    *columns : rich.progress.ProgressColumn
        Those of rich unless given.
    total : float, optional
        What ``completed`` reaches at the end.
    quiet : bool
        Show nothing.

    Yields
    ------
    callable
        To be called with ``completed``, ``advance`` or ``description``.
    """
    from rich.console import Console
    from rich.progress import Progress

    there = Console(stderr=True)
    with Progress(
        *columns or Progress.get_default_columns(),
        console=there, transient=True, disable=quiet or not there.is_terminal,
    ) as shown:  # fmt: skip
        yield partial(shown.update, shown.add_task(name, total=total))


def print_table(title: str, rows: Sequence[tuple[str, str]], *, err: bool = False) -> None:
    """Print a table of two columns.

    Parameters
    ----------
    title : str
    rows : sequence of (str, str)
    err : bool
        Print on standard error, since standard output is kept for JSON.
    """
    from rich.table import Table
    from rich.text import Text

    shown = Table(title=title, title_justify="left", title_style="bold", show_header=False, box=None, pad_edge=False)
    shown.add_column(style="cyan", no_wrap=True)
    shown.add_column(overflow="fold")
    for name, value in rows:
        shown.add_row(Text(name), Text(value))
    make_console(err=err).print(shown)


def echo_json(data: Any) -> None:
    """Print one JSON object on standard output.

    Parameters
    ----------
    data : object
    """
    sys.stdout.write(format_json(data))


def print_columns(title: str, header: Sequence[str], rows: Sequence[Sequence[str]], *, err: bool = False) -> None:
    """Print a table with a header.

    Parameters
    ----------
    title : str
    header : sequence of str
    rows : sequence of sequence of str
        The first column has the names.
    err : bool
        Print on standard error, because standard output is for JSON.
    """
    from rich.table import Table
    from rich.text import Text

    shown = Table(title=title, title_justify="left", title_style="bold", box=None, pad_edge=False)
    for index, name in enumerate(header):
        shown.add_column(name, style="cyan" if index == 0 else None, justify="left" if index == 0 else "right")
    for row in rows:
        shown.add_row(*(Text(cell) for cell in row))
    make_console(err=err).print(shown)
