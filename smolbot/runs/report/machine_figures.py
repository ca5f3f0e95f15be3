"""Figures of the load on the hardware: currents, duty and heat of coils; the timeline of a cycle."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any

import numpy as np

from smolbot.core.shots import Actuate, Excite, Listen, MoveMagnet, Rest, RingDown, Rotate, Shot, Window
from smolbot.runs.pictures.gradient_run import draw_currents
from smolbot.runs.pictures.style import COILS, LOCATED, PLANNED, TRUE, draw_dots, draw_empty_note, escape_name
from smolbot.runs.report.coil_load import CoilLoad
from smolbot.runs.report.recorded_flight import RecordedFlight
from smolbot.runs.report.svg import FAINT, INK, make_wide_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WINDOW_STYLES: dict[type, tuple[str, str]] = {
    Actuate: ("actuate", TRUE),
    Excite: ("excite", "#f2a541"),
    RingDown: ("ring-down", PLANNED),
    Listen: ("listen", LOCATED),
    Rest: ("rest", PLANNED),
    Rotate: ("rotate", "#7b2d8b"),
    MoveMagnet: ("move magnet", "#4c956c"),
}
"""Name and colour of each kind of window."""


_LETTER_HALF_WIDTH = 0.0042
"""Half the width of a letter of a label, as a share of a figure's width."""


def draw_coils_figure(flight: RecordedFlight, strain: CoilLoad) -> Figure:
    """Draw currents, duty and heat over time, each with its limit.

    Parameters
    ----------
    flight : RecordedFlight
    strain : CoilLoad

    Returns
    -------
    Figure
    """
    mission = flight.mission
    figure = make_wide_figure(6.2)
    currents, duty, heat = figure.subplots(3, 1, sharex=True)
    if mission.rig.coil_names and flight.steered is not None and not flight.is_helical:
        draw_currents(currents, flight.steered, flight.trace)
        currents.set_xlabel("")
        currents.set_title("Coil currents while actuating, in A", fontsize=10.5)
        _draw_limit(currents, mission.rig.limits.max_current, f"limit {mission.rig.limits.max_current:g} A")
    else:
        _draw_bursts(currents, flight)
    for i, name in enumerate(strain.names):
        color = COILS[i % len(COILS)]
        style = "--" if name.startswith("excitation") else "-"
        duty.plot(strain.time, 100.0 * strain.duty[:, i], color=color, lw=1.2, ls=style, label=escape_name(name))
        heat.plot(strain.time, strain.temperature[:, i], color=color, lw=1.2, ls=style)
    duty.set_title(f"Duty: share of the last {strain.window:g} s in which a coil is driven, in %")
    _draw_limit(duty, 100.0 * strain.max_duty, f"limit {100 * strain.max_duty:g} %")
    duty.set_ylim(0.0, 108.0 * strain.max_duty)
    duty.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncol=6, borderaxespad=0.0)
    limits = sorted({limit for limit in strain.limits if limit is not None})
    for limit in limits:
        those = [escape_name(name) for name, own in zip(strain.names, strain.limits, strict=True) if own == limit]
        _draw_limit(heat, limit, f"limit {limit:g} °C{'' if len(limits) == 1 else ' of ' + ', '.join(those)}")
    if limits:
        heat.set_ylim(top=1.06 * max(limits))
    else:
        draw_empty_note(heat, "thermal constants of these coils are not known")
    heat.set_title("Temperature computed from commanded currents, in °C")
    heat.set_xlabel("time in s")
    for axes in (currents, duty, heat):
        axes.grid(axis="y")
    return figure


MOST_SHOWN = 1.3
"""Length of a cycle's axis over the cycle: a slow machine's compute time would make the windows narrow."""


def draw_cycle_figure(flight: RecordedFlight) -> Figure:
    """Draw the timelines of typical shots, each followed by the computing time of its cycle.

    Parameters
    ----------
    flight : RecordedFlight

    Returns
    -------
    Figure
    """
    shown = find_typical_shots(flight)
    figure = make_wide_figure(0.5 + 1.25 * max(len(shown), 1))
    rows: Any = figure.subplots(max(len(shown), 1), 1, squeeze=False)
    compute = np.array([cycle.compute for cycle in flight.run.cycles])
    for axes, (shot, times) in zip(rows[:, 0], shown, strict=False):
        _draw_shot(axes, shot, times, compute, flight.mission.rig.turnaround)
    if not shown:
        draw_empty_note(rows[0, 0], "no cycle was played")
    return figure


def find_typical_shots(flight: RecordedFlight) -> list[tuple[Shot, int]]:
    """Find typical shots: of median length, for the two most frequent sequences of windows.

    Parameters
    ----------
    flight : RecordedFlight

    Returns
    -------
    list of tuple
        Shot, and how often its sequence was played.
    """

    def order(shot: Shot) -> tuple[type, ...]:
        found: list[type] = []
        for window in shot.windows:
            if not (isinstance(window, Rotate) and found and found[-1] is Rotate):
                found.append(type(window))
        return tuple(found)

    shots = [cycle.shot for cycle in flight.run.cycles]
    out = []
    for kind, times in Counter(map(order, shots)).most_common(2):
        alike = sorted((shot for shot in shots if order(shot) == kind), key=lambda shot: shot.duration)
        if times >= 0.02 * len(shots):
            out.append((alike[len(alike) // 2], times))
    return out


def _draw_shot(axes: Axes, shot: Shot, times: int, compute: Any, turnaround: float) -> None:
    slow = shot.duration > 5.0
    scale, unit = (1.0, "s") if slow else (1e3, "ms")
    whole = scale * (shot.duration + max(turnaround, float(np.median(compute))))

    free = [-np.inf, -np.inf, -np.inf]  # end of the labels placed so far: above, below, and further below
    for at, window in shot.timed():
        name, color = WINDOW_STYLES[type(window)]
        start, length = scale * at, scale * window.duration
        axes.barh(0.0, length, left=start, height=0.6, color=color, lw=0)
        text = _format_window(window, name, length, unit)
        middle, half = start + 0.5 * length, _LETTER_HALF_WIDTH * len(text) * whole
        row = next((i for i, taken in enumerate(free) if middle - half > taken), 2)
        free[row] = middle + half
        side, away = (1, 4) if row == 0 else (-1, 4 if row == 1 else 15)
        axes.annotate(text, (middle, 0.3 * side), xytext=(0, away * side), textcoords="offset points", ha="center",
                      va="bottom" if row == 0 else "top", fontsize=8.5)  # fmt: skip
    end = scale * shot.duration
    median, slowest = scale * float(np.median(compute)), scale * float(np.percentile(compute, 99))
    axes.barh(0.0, scale * turnaround, left=end, height=0.6, fill=False, ec=FAINT, lw=1, ls=":")
    axes.barh(0.0, median, left=end, height=0.6, color=INK, lw=0)
    axes.plot([end + median, end + slowest], [0.0, 0.0], color=INK, lw=1.2)
    axes.annotate(
        f"compute time {median:.3g} {unit}, 99th percentile {slowest:.3g} {unit}",
        (end, -0.3), xytext=(0, -4), textcoords="offset points", ha="left", va="top", fontsize=8.5,
    )  # fmt: skip
    axes.set_title(
        f"{shot.mode}: {scale * shot.duration:.1f} {unit}, played {times} times in this order", fontsize=9.5, pad=18
    )
    axes.set_ylim(-0.75, 0.75)
    axes.set_xlim(-0.005 * whole, MOST_SHOWN * whole)
    axes.set_yticks([])
    axes.spines["left"].set_visible(False)
    axes.set_xlabel(f"time in {unit}")


def _format_window(window: Window, name: str, length: float, unit: str) -> str:
    if isinstance(window, Rotate):
        return f"{window.turns:g} turn{'' if window.turns == 1 else 's'}"
    if isinstance(window, MoveMagnet):
        return f"magnet {window.to} {length:.3g} {unit}"
    return f"{name} {length:.3g} {unit}"


def _draw_bursts(axes: Axes, flight: RecordedFlight) -> None:
    """Draw the peak currents of excitation, for a run without actuation coils."""
    for index, name in enumerate("xy"):
        found = [
            (cycle.shot.start, abs(window.currents[index]))
            for cycle in flight.run.cycles
            for window in cycle.shot.windows
            if isinstance(window, Excite)
        ]
        if found:
            starts, sizes = np.array(found).T
            draw_dots(axes, starts, sizes, 2.2, COILS[index], label=f"excitation {name}")
    most = flight.mission.rig.limits.max_excitation_current
    _draw_limit(axes, most, f"limit {most:g} A")
    axes.set_ylim(0.0, 1.12 * most)
    axes.set_title("Excitation currents, peak, in A")
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncol=2, borderaxespad=0.0)


def _draw_limit(axes: Axes, value: float, text: str) -> None:
    axes.axhline(value, color="#999999", lw=1, ls="--", zorder=1)
    axes.text(0.0, value, f" {text}", color="#777777", fontsize=8.5, va="bottom", ha="left",
              transform=axes.get_yaxis_transform())  # fmt: skip
