"""The live figures of a flight: a table, and plots of four of them over the last seconds."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup

from smolbot.core.arrays import FloatArray
from smolbot.ui.console.flight_state import FlightState
from smolbot.ui.console.preview_process import panel

if TYPE_CHECKING:
    from viser import ViserServer

MAX_POINTS = 400
"""Largest number of points of a plot; more are thinned."""

CURRENT_DURATION = 20.0
"""Seconds of currents that are shown, since they change with every actuation."""

ALLOWED, FONT = "allowed", "11px sans-serif"

UNKNOWN = "–"

COLORS = ("#2563eb", "#ea580c", "#16a34a", "#9333ea", "#0891b2", "#be123c")


def get_color(name: str, place: int) -> str:
    """Return the colour of a line; a coil has the same one everywhere.

    Parameters
    ----------
    name : str
    place : int
        Index of the colour for a line that is no coil.

    Returns
    -------
    str
        As in CSS.
    """
    known = {"+x": 0, "-x": 1, "+y": 2, "-y": 3, "excitation x": 4, "excitation y": 5}
    return COLORS[known.get(name, place) % len(COLORS)]


class FiguresPanel:
    """A table and four plots in the current GUI container.

    Parameters
    ----------
    server : viser.ViserServer
    """

    def __init__(self, server: ViserServer) -> None:
        self._gui: Any = server.gui
        self._table = self._gui.add_html("")
        self._plots: dict[str, Any] = {}
        self._shape: tuple[Any, ...] = ()
        self._folder = self._gui.add_folder("Over time, s")

    def show(self, flight: FlightState, time: float | None = None) -> None:
        """Show the figures of a flight.

        Parameters
        ----------
        flight : FlightState
        time : float, in s, optional
            On the rig's clock; the latest unless given.
        """
        self._table.content = format_table(flight, time)
        shape = (flight.steers, flight.coils, flight.heated)
        if shape != self._shape:
            self._shape = shape
            self._lay_out(flight)
        for name, (times, values) in collect_series(flight, time).items():
            plot = self._plots.get(name)
            if plot is not None and len(times) > 1:
                plot.data = (times, *values.T)

    def _lay_out(self, flight: FlightState) -> None:
        for plot in self._plots.values():
            plot.remove()
        self._plots = {}
        lines = {
            "error to path, mm (dashed: allowed)" if flight.steers else "uncertainty, mm": (
                ("error", ALLOWED) if flight.steers else ("sigma",)
            ),
            "R²": ("R²",),
            "currents, A" if "magnet" not in flight.coils else "magnet, turns a second": flight.coils,
            "coils, °C": flight.heated,
        }
        with self._folder:
            for (title, names), key in zip(lines.items(), ("error", "squared", "currents", "heat"), strict=True):
                if names:
                    self._plots[key] = self._plot(title, names)

    def _plot(self, title: str, names: tuple[str, ...]) -> Any:
        series: list[dict[str, Any]] = [{"label": "s"}]
        for i, name in enumerate(names):
            dashed = {"dash": [6, 4], "stroke": "#dc2626", "points": {"show": False}}
            line = {"label": name, "width": 1.5, "stroke": get_color(name, i), "points": {"show": False}}
            series.append(line | (dashed if name == ALLOWED else {}))
        empty = tuple(np.array([0.0, 1.0]) for _ in range(len(names) + 1))
        return self._gui.add_uplot(
            empty, tuple(series), title=title, height=118, padding=(2, 10, 2, 0), scales={"x": {"time": False}},
            legend={"show": False}, axes=({"size": 32, "font": FONT}, {"size": 44, "font": FONT}),
        )  # fmt: skip


def collect_series(flight: FlightState, time: float | None) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Collect the data of each plot, thinned.

    Parameters
    ----------
    flight : FlightState
    time : float or None, in s
        On the rig's clock; None for the latest.

    Returns
    -------
    dict
        Times (n,) in s and values (n, lines) by the name of the plot.
    """
    with flight.lock:
        cycles, at = flight.cycles.get_values(time), flight.cycles.get_times(time)
        if flight.steers:
            known = np.isfinite(cycles[:, 0])
            first = (at[known], np.column_stack([cycles[known, 0], np.full(known.sum(), flight.tolerance)]))
        else:
            first = (flight.tracked.get_times(time), flight.tracked.get_values(time)[:, 7:8])
        found = {
            "error": first,
            "squared": (at[np.isfinite(cycles[:, 1])], cycles[np.isfinite(cycles[:, 1]), 1:2]),
            "currents": _cut_to_last(flight.currents.get_times(time), flight.currents.get_values(time)),
            "heat": (flight.heat.get_times(time), flight.heat.get_values(time)),
        }
        return {name: thin_rows(times, values) for name, (times, values) in found.items()}


def _cut_to_last(times: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    begin = np.searchsorted(times, times[-1] - CURRENT_DURATION) if len(times) else 0
    return times[begin:], values[begin:]


def thin_rows(times: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Keep at most `MAX_POINTS` evenly spaced rows, with the last one; returns copies.

    Parameters
    ----------
    times : ndarray, shape (n,)
    values : ndarray, shape (n, lines)

    Returns
    -------
    times : ndarray, shape (m,)
    values : ndarray, shape (m, lines)
    """
    step = max(-(-len(times) // MAX_POINTS), 1)
    keep = np.arange(len(times) - 1, -1, -step)[::-1]
    return times[keep].copy(), values[keep].copy()


def format_table(flight: FlightState, time: float | None) -> str:
    """Format the current figures as HTML.

    Parameters
    ----------
    flight : FlightState
    time : float or None, in s
        On the rig's clock; None for the latest.

    Returns
    -------
    str
    """
    with flight.lock:
        tracked, cycles = flight.tracked.get_values(time)[-1:], flight.cycles.get_values(time)
        currents, heat = flight.currents.get_values(time)[-1:], flight.heat.get_values(time)[-1:]
    text = flight.find_text(time)
    rows: list[tuple[str, object, str, bool]] = []
    if flight.steers:
        errors = cycles[:, 0][np.isfinite(cycles[:, 0])]
        allowed = flight.tolerance or math.inf
        now = f"{errors[-1]:.2f} mm" if len(errors) else UNKNOWN
        rms = f", rms {np.sqrt(np.mean(errors**2)):.2f} mm" if len(errors) else ""
        rows.append(("error to path", now, f" of {allowed:g} mm{rms}", bool(len(errors) and errors[-1] > allowed)))
    rate = flight.compute_rate(time)
    rows.append(("rate", f"{rate:.1f} Hz" if math.isfinite(rate) else UNKNOWN, "", False))
    squared = cycles[-1, 1] if len(cycles) else math.nan
    rows.append(("R²", f"{squared:.4f}" if math.isfinite(squared) else UNKNOWN, "", squared < 0.9))
    for place in tracked:
        x, y, z = place[:3]
        rows.append(("position", f"{x:+.1f}, {y:+.1f}, {z:.1f} mm", f" ± {place[7]:.2f} mm", not place[8]))
    for driven in currents:
        if flight.coils == ("magnet",):
            rows.append(("magnet", f"{driven[0]:g} Hz", "", False))
        elif flight.coils:
            named = enumerate(zip(flight.coils, driven, strict=True))
            coils = [(get_color(name, i), name, f"{a:.1f}") for i, (name, a) in named]
            rows.append(("currents", "", Markup(panel("currents", coils)), False))
    for warm in heat:
        limits = flight.get_heat_limits()
        worst = int(np.argmax((warm - 20.0) / (limits - 20.0))) if len(warm) else -1
        if worst >= 0:
            more = f" of {limits[worst]:g} °C ({flight.heated[worst]})"
            rows.append(("hottest coil", f"{warm[worst]:.0f} °C", more, warm[worst] > 0.9 * limits[worst]))
    compute = cycles[:, 3]
    if len(compute):
        rows.append(("computing", f"{np.median(compute):.1f} ms", " a cycle, median", False))
    if flight.dropped:
        rows.append(("not shown", flight.dropped, " messages were dropped", True))
    if text is not None and text.rig:
        rows.append(("rig", "", text.rig, False))
    return panel("figures", rows)
