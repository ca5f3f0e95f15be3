"""A study of the lab's own: how far places in the container are from the nearest sensor."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from sim.studies import Chunk, Columns, Options, Outcome, Study, cut_chunks, make_rng
from smolbot import load_rig

PIECES, PLACES = 4, 50


def chunks(options: Options) -> list[Chunk]:
    """Pieces of equal size."""
    return cut_chunks(options, measure, [(f"piece-{i}", {"places": options.poses or PLACES}) for i in range(PIECES)])


def measure(chunk: Chunk) -> Columns:
    """Distance of each drawn place to the nearest sensor, in mm."""
    rig = load_rig(chunk["rig"])
    places = make_rng(chunk).uniform(rig.container.low, rig.container.high, (chunk["places"], 3))
    apart = np.linalg.norm(places[:, None, :] - rig.sensors.positions, axis=2)
    return {"nearest_mm": 1e3 * apart.min(axis=1)}


def conclude(options: Options, parts: list[Columns]) -> Outcome:
    """Median of all."""
    nearest = np.concatenate([part["nearest_mm"] for part in parts])
    median = float(np.median(nearest))
    return Outcome([("nearest sensor", f"{median:.1f} mm, median")], {"median_mm": median}, {"nearest_mm": nearest})


def draw(outcome: Outcome, path: Path) -> None:
    """A histogram."""
    from matplotlib.figure import Figure

    figure = Figure()
    figure.add_subplot().hist(outcome.columns["nearest_mm"])
    figure.savefig(path)


NEARNESS = Study("nearness", "Distance to the nearest sensor", dict, chunks, conclude, draw)
