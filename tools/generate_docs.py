#!/usr/bin/env python3
"""Write the parts of the documentation that come from the code: ``tools/generate_docs.py [--check]``.

They are kept in the pages, so that the pages read wherever Markdown is shown. In a page such a part stands between
``<!-- generated: KIND ARGUMENTS -->`` and ``<!-- end -->``; KIND is one of

- ``keys``: tables of the keys of a file, from the model that checks it;
- ``commands``: the command line;
- ``decisions``: the table of decisions, from their own heads.

`docs/pictures/rooms.svg` is drawn from import-linter's contracts in ``pyproject.toml``. With ``--check`` nothing is
written: exits with 1 where a page is not what it would be.
"""

from __future__ import annotations

import argparse
import ast
import re
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined

CHECKOUT = Path(__file__).resolve().parent.parent
DOCS = CHECKOUT / "docs"
sys.path.insert(0, str(DOCS / "_ext"))

from commandline import write_commands  # noqa: E402
from filekeys import write_table, write_tables  # noqa: E402

PICTURE = DOCS / "pictures" / "rooms.svg"
TEMPLATE = Path(__file__).with_name("rooms.svg.jinja")

UNDIVIDED = ("controllers", "lookup_tables")
"""Packages that are one room each."""

_PART = re.compile(r"(<!-- generated: (\w+)(.*?) -->\n).*?(<!-- end -->)", re.DOTALL)
_HEAD = re.compile(r"# (.+)\n\n(\d{4}-\d\d-\d\d)\n(?:\n\*\*((?:Replaced|Extended) [^*]+)\.\*\*)?")


def read_floors(package: str | None = None) -> list[list[str]]:
    """Read the floors of a package from the import contracts.

    Parameters
    ----------
    package : str, optional
        None for the floors of the packages themselves.

    Returns
    -------
    list of list of str
        Rooms of each floor, the highest first.
    """
    settings = tomllib.loads((CHECKOUT / "pyproject.toml").read_text(encoding="utf-8"))
    containers = None if package is None else [package]
    contracts = settings["tool"]["importlinter"]["contracts"]
    layers = next(c["layers"] for c in contracts if c["type"] == "layers" and c.get("containers") == containers)
    floors = [[room for room in re.split(r" [|:] ", layer) if room != "__main__"] for layer in layers]
    return [floor for floor in floors if floor]


def describe_room(name: str) -> str:
    """Read the first line of a room's docstring.

    Parameters
    ----------
    name : str
        Dotted name of the room.

    Returns
    -------
    str
    """
    path = CHECKOUT / name.replace(".", "/")
    file = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    text = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or ""
    return text.split("\n")[0].replace("``", "")


def draw_rooms() -> str:
    """Draw the rooms: a band for each package, a row for each floor, a box for each room.

    Returns
    -------
    str
        The SVG.
    """
    bands = []
    for name in (room for floor in read_floors() for room in floor):
        floors = [] if name in UNDIVIDED else read_floors(name)
        described = [[(room, describe_room(f"{name}.{room}")) for room in floor] for floor in floors]
        bands.append({"name": name, "what": describe_room(name), "floors": described})
    environment = Environment(
        loader=FileSystemLoader(TEMPLATE.parent), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True,
    )  # fmt: skip
    return environment.get_template(TEMPLATE.name).render(bands=bands) + "\n"


def write_decisions() -> str:
    """Write the table of decisions: number, title, date and validity of each.

    Returns
    -------
    str
        Markdown.
    """
    rows = []
    for path in sorted((DOCS / "decisions").glob("0*.md")):
        head = _HEAD.match(path.read_text(encoding="utf-8"))
        if head is None:
            raise SystemExit(f"{path}: a decision begins with '# TITLE', its date, and **Replaced by …** where it is.")
        title, date, replaced = head.groups()
        rows.append((str(int(path.name[:4])), f"[{title}]({path.name})", date, replaced or "holds"))
    return write_table(("", "decision", "date", ""), rows)


KINDS: dict[str, Callable[..., str]] = {
    "keys": write_tables,
    "commands": write_commands,
    "decisions": write_decisions,
}


def fill(page: str) -> str:
    """Generate the parts of a page anew.

    Parameters
    ----------
    page : str
        Markdown.

    Returns
    -------
    str
    """
    return _PART.sub(lambda part: f"{part[1]}\n{KINDS[part[2]](*part[3].split())}\n\n{part[4]}", page)


def main() -> int:
    """Write all pages that changed, or check them.

    Returns
    -------
    int
        1 if a checked page is out of date.
    """
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--check", action="store_true", help="write nothing; exit with 1 if something is out of date")
    check = parser.parse_args().check
    made = {path: fill(path.read_text(encoding="utf-8")) for path in sorted(DOCS.rglob("*.md"))}
    made[PICTURE] = draw_rooms()
    stale = [path for path, text in made.items() if not path.is_file() or path.read_text(encoding="utf-8") != text]
    for path in stale:
        print(f"{path.relative_to(CHECKOUT)}: " + ("out of date; run make generated" if check else "written"))
        if not check:
            path.write_text(made[path], encoding="utf-8")
    return int(check and bool(stale))


if __name__ == "__main__":
    sys.exit(main())
