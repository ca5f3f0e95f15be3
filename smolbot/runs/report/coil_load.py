"""Temperature and duty of every coil over a run, computed from the commands as by the safety supervisor in flight."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.core.coil_heat import CoilHeat, compute_mean_square_currents
from smolbot.core.shots import Window
from smolbot.runs.report.recorded_flight import RecordedFlight


@dataclass(frozen=True)
class CoilLoad:
    """Heat and duty of the coils over time.

    Attributes
    ----------
    names : tuple of str
        Actuation coils, then excitation coils.
    time : ndarray, shape (n,), in s
        Start and end of every window.
    duty : ndarray, shape (n, n_coils)
        Fraction of the last `window` seconds in which a coil was driven.
    temperature : ndarray, shape (n, n_coils), in °C
        nan for coils whose thermal constants are not known.
    limits : tuple of float or None, in °C
        Highest allowed temperatures.
    max_duty : float
        Highest allowed duty.
    window : float, in s
        Time over which the duty is computed.
    """

    names: tuple[str, ...]
    time: FloatArray
    duty: FloatArray
    temperature: FloatArray
    limits: tuple[float | None, ...]
    max_duty: float
    window: float


def compute_coil_load(flight: RecordedFlight) -> CoilLoad:
    """Compute heat and duty over a run, from the start temperatures in the record.

    Parameters
    ----------
    flight : RecordedFlight

    Returns
    -------
    CoilLoad
    """
    rig = flight.mission.rig
    safety = rig.sections.safety
    names = rig.driven
    heat = CoilHeat(rig.thermal, safety.ambient_c)
    initial: Any = flight.run.safety.get("coil_temperature_begin_c", {})
    heat.temperatures = [float(initial.get(name, safety.ambient_c)) for name in names]
    times, driven, temperatures = [0.0], [[0.0] * len(names)], [list(heat.temperatures)]
    for start, window in _iterate_windows(flight):
        if start > times[-1]:
            heat.advance((), start - times[-1])
            times.append(start)
            driven.append(driven[-1])
            temperatures.append(list(heat.temperatures))
        squares = compute_mean_square_currents(window, len(rig.coil_names), len(names) - len(rig.coil_names))
        heat.advance(squares, window.duration)
        times.append(start + window.duration)
        driven.append(
            [t + window.duration * (s > 0.0) for t, s in zip(driven[-1], squares or [0.0] * len(names), strict=True)]
        )
        temperatures.append(list(heat.temperatures))
    time, total = np.array(times), np.array(driven)
    before = np.stack([np.interp(time - safety.duty_window_s, time, total[:, i]) for i in range(len(names))], axis=1)
    known = np.array([coil is not None for coil in heat.coils], dtype=bool)
    return CoilLoad(
        names,
        time,
        (total - before) / safety.duty_window_s,
        np.where(known, np.array(temperatures), np.nan),
        tuple(None if coil is None else coil.limit for coil in heat.coils),
        safety.max_duty,
        safety.duty_window_s,
    )


def _iterate_windows(flight: RecordedFlight) -> Iterator[tuple[float, Window]]:
    """Yield every played window with its start in s."""
    for played in flight.record.played:
        for at, window in played.shot.timed():
            yield played.shot.start + at, window
