#!/usr/bin/env python3
"""Rooms of a checkout, floors they stand on, arrows between them, and cycles: ``tools/rooms.py [CHECKOUT] [--list]``.

A room is what a newcomer sees one level down: a folder or a file in `smolbot/` and `sim/`, and `controllers/` and
`lookup_tables/`, which have no folders, as they are. An arrow says that some file of a room imports one of another;
imports inside functions and for the type checker alone count like others. Rooms of one cycle share a floor. Exits with
1 if modules or rooms import one another in a circle.
"""

from __future__ import annotations

import argparse
import ast
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

PACKAGES = ("smolbot", "controllers", "lookup_tables", "sim")
Graph = Mapping[str, set[str]]


def module_files(checkout: Path) -> dict[str, Path]:
    """Every module of the four packages by its dotted name; a package goes by the name of its folder."""
    files = (f for package in PACKAGES for f in sorted((checkout / package).rglob("*.py")))
    return {".".join(f.relative_to(checkout).with_suffix("").parts).removesuffix(".__init__"): f for f in files}


def import_graph(checkout: Path) -> dict[str, set[str]]:
    """For each module, those that it imports."""
    files = module_files(checkout)

    def targets(node: ast.Import | ast.ImportFrom) -> Iterator[str]:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        else:
            whole = [f"{node.module}.{alias.name}" for alias in node.names]
            yield from (name if name in files else str(node.module) for name in whole)

    def imported(module: str) -> set[str]:
        nodes = ast.walk(ast.parse(files[module].read_text(encoding="utf-8")))
        statements = (node for node in nodes if isinstance(node, ast.Import | ast.ImportFrom))
        return {target for statement in statements for target in targets(statement) if target in files} - {module}

    return {module: imported(module) for module in files}


def room_of(module: str, graph: Graph) -> str:
    """The room of a module: itself or the folder it lies in, as seen from its package."""
    package = module.split(".", 1)[0]
    has_folders = any(name.count(".") > 1 for name in graph if name.startswith(f"{package}."))
    return ".".join(module.split(".")[:2]) if has_folders else package


def room_graph(graph: Graph) -> dict[str, set[str]]:
    """For each room, the rooms that it imports; packages' own faces are no rooms."""
    rooms = {module: room_of(module, graph) for module in graph}
    faces = {package for package in PACKAGES if any(room.startswith(f"{package}.") for room in rooms.values())}
    arrows: dict[str, set[str]] = {room: set() for room in rooms.values() if room not in faces}
    for module, imported in graph.items():
        if rooms[module] not in faces:
            arrows[rooms[module]] |= {rooms[i] for i in imported} - {rooms[module]} - faces
    return arrows


def reached(start: str, graph: Graph) -> set[str]:
    """Everything that `start` imports, directly or through others; itself, if it lies on a circle."""
    found: set[str] = set()
    ahead = [start]
    while ahead:
        fresh = graph[ahead.pop()] - found
        found |= fresh
        ahead += fresh
    return found


def circles(graph: Graph) -> list[tuple[str, ...]]:
    """Groups of nodes of which each reaches each other one."""
    reach = {node: reached(node, graph) for node in graph}
    return sorted({tuple(sorted(o for o in reach[n] if n in reach[o])) for n in graph if n in reach[n]})


def floors(graph: Graph) -> dict[str, int]:
    """How high each room stands: one above the highest that it reaches and that does not reach it; 0 reaches none."""
    reach = {room: reached(room, graph) for room in graph}
    height: dict[str, int] = {}
    for room in sorted(graph, key=lambda r: len(reach[r] | {r})):
        height[room] = 1 + max((height[other] for other in reach[room] if room not in reach[other]), default=-1)
    return height


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("checkout", nargs="?", type=Path, default=Path(__file__).resolve().parent.parent)
    parser.add_argument("--list", action="store_true", help="each floor with its rooms, the highest first")
    options = parser.parse_args()
    modules = import_graph(options.checkout)
    rooms = room_graph(modules)
    height = floors(rooms)
    knots = {"modules": circles(modules), "rooms": circles(rooms)}
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
