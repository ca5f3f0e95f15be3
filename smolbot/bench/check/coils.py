"""Check of the coils, each driven weakly in turn: identity, polarity, strength, and timing of the relay."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from smolbot.bench.check.edges import Edges, find_edges
from smolbot.bench.check.prediction import predict_responses
from smolbot.bench.check.response_match import ResponseMatch, match_responses
from smolbot.core.arrays import BoolArray
from smolbot.core.coil_probe import Probe, Prober

if TYPE_CHECKING:
    from smolbot.config.rig import RigConfig

MIN_SENSORS = 3
"""Smallest number of sensors by which the field patterns of coils can be distinguished."""

PROBE_SHARE = 0.6
"""Share of the range that a probe reaches in the sensor with the largest signal."""

RELAY_TOLERANCE = 0.5e-3
"""Seconds by which a relay may be later than the rig file specifies; edges are timed to about 0.02 ms."""

TIME_CONSTANT_TOLERANCE = 0.3
"""Relative tolerance of a coil's time constant."""


@dataclass(frozen=True)
class CoilCheck:
    """Measurements of one coil, and its faults.

    Attributes
    ----------
    name : str
    current : float, in A
        Current of the probe.
    gain : float
        Measured field over the predicted one.
    unexplained : float
        Share of the field that its predicted pattern does not explain.
    closes : float or None, in s
        Delay until the field appears after the command to close the relay; None if it never does.
    opens : float or None, in s
        Delay until the field vanishes after the command to open the relay; None if it never does.
    rise : float or None, in s
        Measured time constant.
    time_constant : float, in s
        By the rig file.
    close_limit : float, in s
        Longest delay by the rig file.
    open_limit : float, in s
        Longest delay by the rig file.
    faults : tuple of str
    """

    name: str
    current: float
    gain: float
    unexplained: float
    closes: float | None
    opens: float | None
    rise: float | None
    time_constant: float
    close_limit: float
    open_limit: float
    faults: tuple[str, ...]


def check_coils(
    rig: Prober, config: RigConfig, usable: BoolArray, sensor_range: float, report: Callable[[str], None]
) -> tuple[tuple[CoilCheck, ...], list[ResponseMatch]]:
    """Probe every coil in turn.

    Parameters
    ----------
    rig : Prober
    config : RigConfig
    usable : ndarray of bool, shape (n_sensors,)
        Sensors that work.
    sensor_range : float, in T
        Measuring range of the sensors.
    report : callable
        Called with a sentence on each step.

    Returns
    -------
    coils : tuple of CoilCheck
    sensors : list of ResponseMatch
        Response of each sensor to all coils, compared with its prediction.
    """
    prediction = predict_responses(config)
    lag = 1.0 / (2 * math.pi * config.sensors.bandwidth) if np.isfinite(config.sensors.bandwidth) else 0.0
    currents: list[float] = []
    probes: list[Probe] = []
    for name, row in zip(prediction.names, prediction.response, strict=True):
        report(f"driving {name} faintly")
        currents.append(min(PROBE_SHARE * sensor_range / float(np.abs(row).max()), _get_max_current(config, name)))
        probes.append(rig.probe(name, currents[-1]))
    overdriven = np.array([probe.recording.saturated & usable for probe in probes])
    clear = usable & ~overdriven.any(axis=0)
    trusted = clear if clear.sum() >= MIN_SENSORS else usable
    edges = [find_edges(probe, current, lag, trusted) for probe, current in zip(probes, currents, strict=True)]
    measured = np.array([edge.response if edge.detected else np.zeros_like(edge.response) for edge in edges])
    found, sensors = match_responses(measured, prediction.response, prediction.names, trusted, prediction.spread)
    coils = []
    for k, (likeness, edge, probe) in enumerate(zip(found, edges, probes, strict=True)):
        constant = prediction.constants[k]
        coils.append(
            CoilCheck(
                name=prediction.names[k],
                current=currents[k],
                gain=likeness.gain,
                unexplained=likeness.unexplained,
                closes=edge.closes,
                opens=edge.opens,
                rise=edge.rise,
                time_constant=constant,
                close_limit=probe.close_limit,
                open_limit=probe.open_limit,
                faults=tuple(_find_faults(likeness, edge, probe, constant, bool(overdriven[k].any()))),
            )
        )
    return tuple(coils), sensors


def _find_faults(likeness: ResponseMatch, edge: Edges, probe: Probe, constant: float, overdriven: bool) -> list[str]:
    found = []
    if likeness.fault:
        found.append(likeness.fault)
    elif overdriven:  # where a coil is another one, that is why
        found.append("saturates sensors at its probe's current")
    if not edge.detected:
        return found
    for what, time, limit in (("comes", edge.closes, probe.close_limit), ("goes", edge.opens, probe.open_limit)):
        if time is None:
            found.append(f"its field never {what}")
        elif time > limit + RELAY_TOLERANCE:
            found.append(f"its field {what} {1e3 * time:.1f} ms late, limit {1e3 * (limit + RELAY_TOLERANCE):.1f} ms")
        elif time < -RELAY_TOLERANCE:
            found.append(f"its field {what} {-1e3 * time:.1f} ms before it is told to")
    if edge.rise is not None and constant > 0 and abs(edge.rise / constant - 1.0) > TIME_CONSTANT_TOLERANCE:
        found.append(f"time constant {1e3 * edge.rise:.2f} ms, not {1e3 * constant:.2f} ms")
    return found


def _get_max_current(config: RigConfig, name: str) -> float:
    limits = config.limits
    return limits.max_current if name in limits.coils else limits.max_excitation_current
