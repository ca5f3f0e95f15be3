#!/usr/bin/env python3
"""Rooms of a checkout, floors they stand on, arrows between them, and cycles: ``tools/rooms.py [CHECKOUT] [--list]``.

A room is what a newcomer sees one level down: a folder or a file in `smolbot/` and `sim/`, and `controllers/` and
`lookup_tables/`, which have no folders, as they are. An arrow says that some file of a room imports one of another;
imports inside functions and for the type checker alone count like others. Rooms of one cycle share a floor. Exits with
1 if modules or rooms import one another in a cycle.
"""

from __future__ import annotations

import argparse
import ast
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

PACKAGES = ("smolbot", "controllers", "lookup_tables", "sim")
Graph = Mapping[str, set[str]]


def find_modules(checkout: Path) -> dict[str, Path]:
    """Find every module of the four packages.

    Parameters
    ----------
    checkout : Path

    Returns
    -------
    dict
        The file of each module by its dotted name; a package has the name of its folder.
    """
    files = (f for package in PACKAGES for f in sorted((checkout / package).rglob("*.py")))
    return {".".join(f.relative_to(checkout).with_suffix("").parts).removesuffix(".__init__"): f for f in files}


def read_imports(checkout: Path) -> dict[str, set[str]]:
    """Read which modules each module imports.

    Parameters
    ----------
    checkout : Path

    Returns
    -------
    dict
        For each module, the set of those that it imports.
    """
    files = find_modules(checkout)

    def targets(node: ast.Import | ast.ImportFrom) -> Iterator[str]:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        else:
            names = [f"{node.module}.{alias.name}" for alias in node.names]
            yield from (name if name in files else str(node.module) for name in names)

    def imported(module: str) -> set[str]:
        nodes = ast.walk(ast.parse(files[module].read_text(encoding="utf-8")))
        statements = (node for node in nodes if isinstance(node, ast.Import | ast.ImportFrom))
        return {target for statement in statements for target in targets(statement) if target in files} - {module}

    return {module: imported(module) for module in files}


def find_room(module: str, graph: Graph) -> str:
    """Find the room of a module: itself or the folder it lies in, as seen from its package.

    Parameters
    ----------
    module : str
    graph : mapping of str to set of str
        For each node, those that it imports.

    Returns
    -------
    str
    """
    package = module.split(".", 1)[0]
    has_folders = any(name.count(".") > 1 for name in graph if name.startswith(f"{package}."))
    return ".".join(module.split(".")[:2]) if has_folders else package


def read_room_imports(graph: Graph) -> dict[str, set[str]]:
    """Reduce imports between modules to those between rooms; the packages themselves are no rooms.

    Parameters
    ----------
    graph : mapping of str to set of str
        For each node, those that it imports.

    Returns
    -------
    dict
        For each room, the set of those that it imports.
    """
    rooms = {module: find_room(module, graph) for module in graph}
    faces = {package for package in PACKAGES if any(room.startswith(f"{package}.") for room in rooms.values())}
    arrows: dict[str, set[str]] = {room: set() for room in rooms.values() if room not in faces}
    for module, imported in graph.items():
        if rooms[module] not in faces:
            arrows[rooms[module]] |= {rooms[i] for i in imported} - {rooms[module]} - faces
    return arrows


def find_imported(start: str, graph: Graph) -> set[str]:
    """Find everything that a node imports, directly or through others; itself, if it lies on a cycle.

    Parameters
    ----------
    start : str
    graph : mapping of str to set of str
        For each node, those that it imports.

    Returns
    -------
    set of str
    """
    found: set[str] = set()
    ahead = [start]
    while ahead:
        fresh = graph[ahead.pop()] - found
        found |= fresh
        ahead += fresh
    return found


def find_cycles(graph: Graph) -> list[tuple[str, ...]]:
    """Find groups of nodes of which each imports each other one, directly or through others.

    Parameters
    ----------
    graph : mapping of str to set of str
        For each node, those that it imports.

    Returns
    -------
    list of tuple of str
    """
    found = {node: find_imported(node, graph) for node in graph}
    return sorted({tuple(sorted(o for o in found[n] if n in found[o])) for n in graph if n in found[n]})


def compute_floors(graph: Graph) -> dict[str, int]:
    """Compute the floor of each room: one above the highest room that it imports, 0 if it imports none.

    Parameters
    ----------
    graph : mapping of str to set of str
        For each node, those that it imports.

    Returns
    -------
    dict
        Floor by room; rooms of one cycle share a floor.
    """
    found = {room: find_imported(room, graph) for room in graph}
    height: dict[str, int] = {}
    for room in sorted(graph, key=lambda r: len(found[r] | {r})):
        height[room] = 1 + max((height[other] for other in found[room] if room not in found[other]), default=-1)
    return height


def main() -> int:
    """Print the figures of a checkout.

    Returns
    -------
    int
        1 if there are cycles.
    """
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("checkout", nargs="?", type=Path, default=Path(__file__).resolve().parent.parent)
    parser.add_argument("--list", action="store_true", help="each floor with its rooms, the highest first")
    options = parser.parse_args()
    modules = read_imports(options.checkout)
    rooms = read_room_imports(modules)
    height = compute_floors(rooms)
    knots = {"modules": find_cycles(modules), "rooms": find_cycles(rooms)}
    print(f"{len(modules)} modules, {len(rooms)} rooms on {len(set(height.values()))} floors, "
          f"{sum(map(len, rooms.values()))} arrows between rooms")  # fmt: skip
    if options.list:
        for floor in sorted(set(height.values()), reverse=True):
            print(f"{floor:3d}  {', '.join(room for room in sorted(rooms) if height[room] == floor)}")
    for kind, groups in knots.items():
        print(f"cycles between {kind}: {len(groups) or 'none'}")
        for group in groups:
            print(f"    {', '.join(group)}: move what two of them share below both")
    return int(any(knots.values()))


if __name__ == "__main__":
    sys.exit(main())
