"""The picture of a swing, as in the paper's Fig. S2: translation, and deflection with its free decay."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.runs.optics.deflection import ObservedSwing
from smolbot.runs.optics.ringing import Ringing
from smolbot.runs.pictures.style import open_sheet

SEEN, FIT, PALE = "#1b4965", "#e4572e", "#b9bec7"


def draw_swing(swing: ObservedSwing, ringing: Ringing, path: Path, *, title: str, line: str) -> None:
    """Write the picture of a swing (PNG, 16:9).

    Parameters
    ----------
    swing : ObservedSwing
    ringing : Ringing
    path : Path
        File to write.
    title, line : str
        The two lines above it.
    """
    times = 1e3 * swing.times
    with open_sheet(path, title, line) as figure:
        grid = figure.add_gridspec(
            3, 2, width_ratios=[3.0, 1.0], wspace=0.12, hspace=0.36, left=0.06, right=0.975, top=0.84, bottom=0.085
        )
        rows = [
            ("Translation across, in pixels", swing.centers[:, 0], None),
            ("Translation along, in pixels", swing.centers[:, 1], None),
            ("Deflection, in °", np.degrees(swing.angles), np.degrees(ringing.fitted)),
        ]
        period = 1e3 / ringing.frequency
        start = 1e3 * ringing.begin + 2 * period
        for index, (name, values, fitted) in enumerate(rows):
            wide, near = figure.add_subplot(grid[index, 0]), figure.add_subplot(grid[index, 1])
            _draw(wide, times, values, 1e3 * ringing.times, fitted)
            _draw(near, times, values, 1e3 * ringing.times, fitted, points=True)
            near.set_xlim(start, start + 2 * period)
            inside = (times >= start) & (times <= start + 2 * period)
            if np.any(inside):
                low, high = float(values[inside].min()), float(values[inside].max())
                near.set_ylim(low - 0.12 * (high - low) - 1e-9, high + 0.12 * (high - low) + 1e-9)
            wide.axvspan(start, start + 2 * period, color="#eeeeee", zorder=0)
            wide.set_title(name, loc="left", fontsize=11)
            if index == 0:
                near.set_title("two periods", loc="left", fontsize=11)
            if index < 2:
                wide.tick_params(labelbottom=False)
                near.tick_params(labelbottom=False)
            else:
                wide.set_xlabel("time in ms")
                near.set_xlabel("time in ms")
                _draw_envelope(wide, ringing)


def _draw(
    axes: Any, times: FloatArray, values: FloatArray, at: FloatArray, fitted: FloatArray | None, *, points: bool = False
) -> None:
    axes.plot(times, values, "." if points else "-", color=SEEN, lw=0.8, ms=3.5, zorder=2)
    if fitted is not None and points:
        axes.plot(at, fitted, color=FIT, lw=1.2, zorder=3)


def _draw_envelope(axes: Any, ringing: Ringing) -> None:
    t = ringing.times - ringing.begin
    decay = np.exp(-ringing.damping * t) if ringing.model == "exponential" else 1.0 - ringing.damping * t
    for sign in (1.0, -1.0):
        axes.plot(1e3 * ringing.times, np.degrees(ringing.rest + sign * ringing.amplitude * decay), color=FIT, lw=1.4,
                  label="fitted decay" if sign > 0 else None)  # fmt: skip
    axes.legend(loc="upper right", frameon=False, fontsize=9)
