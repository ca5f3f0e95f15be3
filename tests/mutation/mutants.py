"""Mutation testing: how many small faults in what keeps a robot safe and tracked do the fast tests see?

``make mutants SEED=1 SAMPLE=200`` draws that many places of the modules below, puts one of cosmic-ray's mutations at
each, and runs the tests of that module against it. One process imports what no mutation can change and forks for
every mutant: no file is touched. A place counts once, however many mutations there are of it. Annotations are left
out: nobody evaluates them.

Mutants that cannot change what a program does stand in `equivalent_mutants.toml`, each with its reason; the score is
told with them (as if they had survived) and without.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import gc
import importlib
import importlib.machinery
import importlib.util
import math
import os
import random
import resource
import signal
import sys
import tomllib
from collections import Counter, defaultdict
from collections.abc import Iterator
from difflib import SequenceMatcher
from pathlib import Path
from typing import Any

import grimp
import pytest
from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator, operator_names

ROOT = Path(__file__).parents[2]
TESTS = {
    "smolbot.flight.safety.supervisor": ("test_safety_bounds", "test_safety"),
    "smolbot.core.limits": ("test_limits",),
    "smolbot.flight.safety.duty_cycle": ("test_duty_and_latch",),
    "smolbot.flight.safety.stop_latch": ("test_duty_and_latch",),
    "smolbot.bench.hardware.guard": ("test_guard",),
    "smolbot.flight.tracking.tracker": ("test_tracker_reference", "test_tracking_laws"),
    "smolbot.flight.tracking.resonance_filter": ("test_resonance",),
}
"""Modules, and the files of tests that concern each; those that see most come first."""

FLYING = {"brief", "flown"}
"""Fixtures whose tests fly whole missions, which takes seconds: they are left out."""

CPU_S, WALL_S = 60, 600
"""A mutant that computes or waits for longer is found: its tests do not end."""


class Selection:
    """What pytest is told to leave out."""

    def pytest_collection_modifyitems(self, items: list[Any]) -> None:
        items[:] = [item for item in items if not FLYING & set(getattr(item, "fixturenames", ()))]


class Mutated(importlib.machinery.SourceFileLoader):
    """Loads a module from other source than its file's."""

    def __init__(self, name: str, path: str, source: str) -> None:
        super().__init__(name, path)
        self.source = source

    def find_spec(self, name: str, path: object = None, target: object = None) -> importlib.machinery.ModuleSpec | None:
        return importlib.util.spec_from_file_location(name, self.path, loader=self) if name == self.name else None

    def get_code(self, fullname: str) -> Any:
        return compile(self.source, self.path, "exec")


def path_of(module: str) -> Path:
    return ROOT / (module.replace(".", "/") + ".py")


def annotated(source: str) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
    """Where annotations begin and end."""
    for node in ast.walk(ast.parse(source)):
        for found in (getattr(node, "annotation", None), getattr(node, "returns", None)):
            if found is not None:
                yield (found.lineno, found.col_offset), (found.end_lineno, found.end_col_offset)


def places(source: str) -> list[list[tuple[str, int]]]:
    """For each place that can be mutated, its mutations: operator and occurrence."""
    spans, nodes = list(annotated(source)), list(ast_nodes(get_ast(source)))
    found: dict[tuple[object, str], list[tuple[str, int]]] = defaultdict(list)
    for name in operator_names():
        operator = get_operator(name)
        if operator.arguments():  # such as mutate variables that one has to name
            continue
        spots = [(node, begin) for node in nodes for begin, _ in operator().mutation_positions(node)]
        for occurrence, (node, begin) in enumerate(spots):
            bare = node.parent is not None and node.parent.type == "parameters"  # the * before names that must be given
            if not bare and not any(low <= begin < high for low, high in spans):
                found[begin, name.partition("_")[0]].append((name, occurrence))
    return [found[key] for key in sorted(found, key=str)]


def draw(seed: int, size: int) -> list[tuple[str, str]]:
    """Modules and mutated sources, in the order of modules."""
    rng, drawn = random.Random(seed), []
    pool = [(module, here) for module in TESTS for here in places(path_of(module).read_text())]
    for module, here in rng.sample(pool, len(pool)):
        operator, occurrence = rng.choice(here)
        source = mutate_code(path_of(module).read_text(), get_operator(operator)(), occurrence)
        with contextlib.suppress(SyntaxError):  # no program
            compile(source, module, "exec")
            drawn.append((module, source))
        if len(drawn) == size:
            break
    print(f"{len(drawn)} of {len(pool)} places, seed {seed}")
    return sorted(drawn, key=lambda one: list(TESTS).index(one[0]))


def tests_of(module: str) -> list[str]:
    """Files of tests, wherever under `tests` they lie, then the module itself for its examples."""
    files = [str(path) for name in TESTS[module] for path in (ROOT / "tests").rglob(f"{name}.py")]
    if len(files) != len(TESTS[module]):
        raise SystemExit(f"{module}: TESTS names {', '.join(TESTS[module])}; under tests there are {files}.")
    return [*files, str(path_of(module))] if ">>>" in path_of(module).read_text() else files


def fate(module: str, source: str) -> bytes:
    """What becomes of this source in a module's place, in a process of its own: s(een), u(nseen), e(ndless)."""
    child = os.fork()
    if child == 0:
        resource.setrlimit(resource.RLIMIT_CPU, (CPU_S, CPU_S))
        signal.alarm(WALL_S)
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, 1), os.dup2(nowhere, 2)
        status = 1
        try:
            sys.meta_path.insert(0, Mutated(module, str(path_of(module)), source))
            importlib.import_module(module)  # before pytest would read its file
            quick = ["-x", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", "-m", "not slow and not realtime"]
            status = next((bad for one in tests_of(module) if (bad := pytest.main([*quick, one], [Selection()]))), 0)
        finally:
            os._exit(status)
    status = os.waitpid(child, 0)[1]
    return b"e" if os.WIFSIGNALED(status) else b"s" if status else b"u"


def warm_up(module: str) -> None:
    """Import what does not know a module."""
    graph = grimp.build_graph("smolbot", "lookup_tables", exclude_type_checking_imports=True)
    changed = {module, *graph.find_downstream_modules(module)}
    changed |= {package for package in graph.modules if any(one.startswith(f"{package}.") for one in changed)}
    for name in graph.modules - changed - {"smolbot.__main__"}:
        importlib.import_module(name)
    gc.freeze()


def fates(module: str, sources: list[str]) -> Iterator[str]:
    """What becomes of each source, from a process that is warm."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reader)
        warm_up(module)
        for source in [path_of(module).read_text(), *sources]:
            os.write(writer, fate(module, source))
        os._exit(0)
    os.close(writer)
    with open(reader) as told:
        if told.read(1) != "u":
            raise SystemExit(f"The tests of {module} fail without a mutation: pytest {' '.join(tests_of(module))}")
        yield from (told.read(1) for _ in sources)
    os.waitpid(child, 0)


def difference(module: str, source: str) -> list[str]:
    """The changed lines, before and after; where one is gone, with the next."""
    both = path_of(module).read_text().splitlines(), source.splitlines()
    changes = [one for one in SequenceMatcher(None, *both).get_opcodes() if one[0] != "equal"]
    was, now = both[0][changes[0][1] : changes[-1][2]], both[1][changes[0][3] : changes[-1][4]]
    more = [] if any(line.strip() for line in now) else both[0][changes[-1][2] :][:1]
    return [" ".join(line.strip() for line in (*lines, *more)).strip() for lines in (was, now)]


def wilson(share: float, n: int, z: float = 1.96) -> tuple[float, float]:
    """Bounds of a share that was seen in n trials, with 95 % confidence."""
    middle, half = share + z * z / (2 * n), z * math.sqrt(share * (1 - share) / n + z * z / (4 * n * n))
    return (middle - half) / (1 + z * z / n), (middle + half) / (1 + z * z / n)


def tell(what: str, seen: int, n: int) -> None:
    low, high = wilson(seen / n, n)
    print(f"{what}: {seen} of {n} seen, {100 * seen / n:.1f} % (95 %: {100 * low:.1f} to {100 * high:.1f})")


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--sample", type=int, default=200)
    options = parser.parse_args()
    drawn = draw(options.seed, max(options.sample, 1))
    same = tomllib.loads((Path(__file__).with_name("equivalent_mutants.toml")).read_text())["mutant"]
    told: Counter[str] = Counter()
    for module in dict.fromkeys(module for module, _ in drawn):
        sources = [source for one, source in drawn if one == module]
        print(f"{module}: {len(sources)}", flush=True)
        for source, what in zip(sources, fates(module, sources), strict=True):
            before, after = difference(module, source)
            known = any((one["was"], one["is"]) == (before, after) for one in same)
            told["same" if what == "u" and known else what] += 1
            if what == "u":
                print(f"  - {before}\n  + {after}{'   (changes nothing)' if known else ''}", flush=True)
    seen = told["s"] + told["e"]
    tell(f"all, {told['e']} of them by not ending", seen, len(drawn))
    tell(f"without {told['same']} that change nothing", seen, len(drawn) - told["same"])


if __name__ == "__main__":
    main()
