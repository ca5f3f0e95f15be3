"""Drawn paths that cross themselves, flown by each law: ``python -m tests.sim.reduced.drawn_paths [LAW …]``.

Prints, for each path and law, what `preview` says, and of the flight its verdict, the share of the path that was
visited in order, and the tracking error. Flights are those of the reduced plant: motion, with pose noise in place of
signals.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from smolbot.core import FloatArray
from smolbot.paths.polylines import find_crossings

SEEDS = range(40)
LAWS = ("predictive", "force_pursuit", "current_ratio")
HALF_SIZE_MM = (4.0, 9.0)
"""Half the larger side of a drawn path."""

MAX_DURATION_S = 400.0
NEIGHBOURS_MM = 1e-3
"""Crossings closer than this, along the path, are two segments that share a point."""


@dataclass(frozen=True)
class DrawnFlight:
    """What became of one drawn path under one law."""

    seed: int
    law: str
    refusal: str
    """What preview says against it; empty for a go."""

    figures: dict[str, Any]


def draw_path(seed: int) -> FloatArray:
    """Draw a path (n, 2), in mm, that crosses itself: closed curves, polylines, small loops, random walks in turn."""
    rng = np.random.default_rng([16, seed])
    while True:
        z = (_draw_closed_curve, _draw_polyline, _draw_loops, _draw_walk)[seed % 4](rng)
        xy = np.column_stack([z.real, z.imag])
        xy -= 0.5 * (xy.min(axis=0) + xy.max(axis=0))
        xy *= rng.uniform(*HALF_SIZE_MM) / np.abs(xy).max()
        crossings = [(a, b) for a, b in find_crossings(xy, xy) if abs(a - b) > NEIGHBOURS_MM]
        if crossings and np.linalg.norm(np.diff(xy, axis=0), axis=1).min() > NEIGHBOURS_MM:
            return xy


def _draw_closed_curve(rng: np.random.Generator) -> Any:
    t = rng.uniform(0.0, 2.0 * np.pi) + np.linspace(0.0, 2.0 * np.pi, 240)  # begun anywhere
    orders = [k * sign for k in (1, 2, 3) for sign in (1, -1)]
    return sum((rng.normal() + 1j * rng.normal()) / abs(k) ** 1.2 * np.exp(1j * k * t) for k in orders)


def _draw_polyline(rng: np.random.Generator) -> Any:
    corners = rng.uniform(-1.0, 1.0, (rng.integers(4, 8), 2))
    return corners[:, 0] + 1j * corners[:, 1]


def _draw_loops(rng: np.random.Generator) -> Any:
    t = rng.uniform(0.0, 2.0 * np.pi) + np.linspace(0.0, 2.0 * np.pi, 300)
    return np.exp(1j * t) + rng.uniform(0.2, 0.7) * np.exp(1j * rng.integers(3, 7) * t + 1j * rng.uniform(0.0, 6.0))


def _draw_walk(rng: np.random.Generator) -> Any:
    headings = np.cumsum(rng.normal(0.0, 0.25, 200) + rng.normal(0.0, 0.12))
    return np.cumsum(np.exp(1j * headings))


def fly(seed: int, law: str, folder: Path) -> DrawnFlight:
    """Preview one drawn path, and fly it whatever preview says."""
    from sim.batch.flights import PlantModel, fly_one
    from smolbot.config.mission import load_steering_mission
    from smolbot.flight.preview.gradient import preview

    np.savetxt(folder / f"{seed}.csv", draw_path(seed), fmt="%.4f", delimiter=",")
    mission = folder / f"{seed}.toml"
    mission.write_text(f'extends = "r_path"\n[path]\nfile = "{seed}.csv"\n[stop]\nmax_duration_s = {MAX_DURATION_S}\n')
    settings = {"controller.law": law}
    shown = preview(load_steering_mission(str(mission), settings=settings))
    flight = fly_one(str(mission), None, settings, seed, PlantModel.REDUCED)
    return DrawnFlight(seed, law, " ".join(shown.reasons), flight.summary)


def fly_all(seeds: range, laws: tuple[str, ...] = LAWS) -> Iterator[DrawnFlight]:
    """Fly every drawn path under every law."""
    with TemporaryDirectory() as folder:
        for law in laws:
            for seed in seeds:
                yield fly(seed, law, Path(folder))


def main() -> None:
    """Print a line for each flight."""
    for f in fly_all(SEEDS, tuple(sys.argv[1:]) or LAWS):
        s = f.figures
        rms = s.get("tracking_error_mm", {}).get("rms", np.nan)
        print(
            f"{f.law:14s} path {f.seed:2d}  {'no-go' if f.refusal else 'go':5s}  {s['status']:9s} {s['verdict']:6s}  "
            f"visited {100 * s['visited_share']:5.1f} %  rms {rms:.2f} mm  "
            f"{f.refusal or '; '.join(s['verdict_reasons'])}",
            flush=True,
        )


if __name__ == "__main__":
    main()
