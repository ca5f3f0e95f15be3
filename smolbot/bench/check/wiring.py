"""Check of wiring and polarity: responses of all sensors to all coils compared with the predicted ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smolbot.core.arrays import BoolArray, FloatArray

GAIN_TOLERANCE = 0.15
"""Relative tolerance of a coil's field: turns, amplifier, position, and the resolution of an output at a few mA."""

SENSOR_TOLERANCE = 0.10
"""Relative tolerance of a sensor's scale factor; twice the effect of position and axis errors is added to it."""

PLACE, TILT = 0.5e-3, 0.009
"""Standard deviation of a sensor's position and angle relative to a coil: m (ruler, printed frame) and rad (half a
degree)."""

LIKENESS = 0.15
"""Highest share of a response that its predicted pattern may leave unexplained."""

DEAF = 0.2
"""A sensor whose response is below this share of the predicted one measures no coil."""

PASSES = 3
"""Number of alternating checks of coils and sensors, so that a fault of one is not attributed to the other."""


@dataclass(frozen=True)
class Likeness:
    """A coil or a sensor compared with its prediction.

    Attributes
    ----------
    gain : float
        Measured response over the predicted one.
    unexplained : float
        Share of the response that the predicted pattern does not explain.
    fault : str
        Empty if there is none.
    """

    gain: float
    unexplained: float
    fault: str = ""


def match(
    measured: FloatArray,
    predicted: FloatArray,
    coils: tuple[str, ...],
    usable: BoolArray,
    spread: FloatArray | None = None,
) -> tuple[list[Likeness], list[Likeness]]:
    """Compare the measured responses of coils and sensors with the predicted ones.

    Parameters
    ----------
    measured : ndarray, shape (n_coils, n_sensors), in T/A
        A row of zeros is a coil without a detected field.
    predicted : ndarray, shape (n_coils, n_sensors), in T/A
    coils : tuple of str
        Names of the coils.
    usable : ndarray of bool, shape (n_sensors,)
        Sensors that are not dead or saturated.
    spread : ndarray, shape (n_coils, n_sensors), in T/A, optional
        Standard deviation of the prediction if coils and sensors are slightly misplaced; zero unless given.

    Returns
    -------
    coils : list of Likeness
    sensors : list of Likeness
    """
    spread = np.zeros_like(predicted) if spread is None else spread
    live, heard = usable.copy(), np.any(measured != 0.0, axis=1)
    found_coils: list[Likeness] = []
    found_sensors: list[Likeness] = []
    for _ in range(PASSES):
        found_coils = [
            _judge_coil(row, predicted, k, coils, live) if heard[k] else Likeness(0.0, 1.0, "makes no field")
            for k, row in enumerate(measured)
        ]
        sources = _sources(measured, predicted, live, heard)
        power = np.maximum((predicted[heard] ** 2).sum(axis=0), 1e-300)
        doubt = np.sqrt(((predicted[heard] * spread[heard]) ** 2).sum(axis=0)) / power
        found_sensors = [
            _judge_sensor(measured[heard], sources[heard], s, SENSOR_TOLERANCE + 2 * doubt[s])
            for s in range(measured.shape[1])
        ]
        live = usable & np.array([not s.fault for s in found_sensors])
        if live.sum() < 3:  # so many are off that the prediction itself is in doubt: blame no sensor
            live = usable.copy()
    return found_coils, found_sensors


def spread_of(fields: FloatArray, gradients: FloatArray, axes: FloatArray) -> FloatArray:
    """Compute the standard deviation of each response for the errors `PLACE` and `TILT` of position and angle.

    Parameters
    ----------
    fields : ndarray, shape (n_coils, n_sensors, 3), in T/A
        In the world frame.
    gradients : ndarray, shape (n_coils, n_sensors, 3, 3), in T/(A m)
        ``[..., i, j]`` is dB_i / dx_j.
    axes : ndarray, shape (n_sensors, 3)
        Sensitive directions in the world frame.

    Returns
    -------
    ndarray, shape (n_coils, n_sensors), in T/A
    """
    along = np.linalg.norm(np.einsum("csij,si->csj", gradients, axes), axis=2)
    across = np.linalg.norm(np.cross(fields, axes), axis=2)
    return np.hypot(PLACE * along, TILT * across)


def _robust(row: FloatArray, pattern: FloatArray) -> tuple[float, float]:
    """Fit as `_fit`, but with the least sum of absolute residuals: one faulty sensor does not spoil the fit."""
    weight, total = np.abs(pattern), float(np.abs(row).sum())
    order = np.argsort(np.divide(row, pattern, out=np.zeros_like(row), where=weight > 0))
    share = np.cumsum(weight[order])
    if not len(row) or share[-1] == 0.0 or total == 0.0:
        return 0.0, 1.0
    middle = order[np.searchsorted(share, 0.5 * share[-1])]
    gain = float(row[middle] / pattern[middle])
    return gain, float(np.abs(row - gain * pattern).sum()) / total


def _fit(row: FloatArray, pattern: FloatArray) -> tuple[float, float]:
    """Fit the gain of `pattern` in `row`; return it with the unexplained share of the amplitude."""
    power = float(pattern @ pattern)
    if power == 0.0:
        return 0.0, 1.0
    gain = float(row @ pattern) / power
    total = float(np.linalg.norm(row))
    return gain, float(np.linalg.norm(row - gain * pattern)) / total if total else 1.0


def _judge_coil(row: FloatArray, predicted: FloatArray, k: int, coils: tuple[str, ...], live: BoolArray) -> Likeness:
    fits = [_robust(row[live], pattern[live]) for pattern in predicted]
    gain, left = fits[k]
    best = min(range(len(fits)), key=lambda j: fits[j][1])
    if best != k and fits[best][1] < min(left, 2 * LIKENESS):
        way = "" if fits[best][0] > 0 else ", reversed"
        return Likeness(gain, left, f"this is the field of {coils[best]}{way}")
    if gain < 0 and left < 2 * LIKENESS:
        return Likeness(gain, left, "reversed")
    if left > LIKENESS:
        return Likeness(gain, left, "no coil of the rig file makes this field")
    if abs(gain - 1.0) > GAIN_TOLERANCE:
        return Likeness(gain, left, f"makes {gain:.2f} times its field")
    return Likeness(gain, left)


def _sources(measured: FloatArray, predicted: FloatArray, live: BoolArray, heard: BoolArray) -> FloatArray:
    """Predict the response of each sensor to the coils as they are actually wired: (n_coils, n_sensors)."""
    found = np.zeros_like(predicted)
    for k in np.flatnonzero(heard):
        fits = [_robust(measured[k, live], pattern[live]) for pattern in predicted]
        best = min(range(len(fits)), key=lambda j: fits[j][1])
        found[k] = fits[best][0] * predicted[best]
    return found


def _judge_sensor(measured: FloatArray, sources: FloatArray, s: int, tolerance: float) -> Likeness:
    column = measured[:, s]
    gain, left = _fit(column, sources[:, s])
    if len(column) == 0:
        return Likeness(gain, left)
    if np.linalg.norm(column) < DEAF * np.linalg.norm(sources[:, s]):
        return Likeness(gain, left, "hears no coil")
    if gain < 0 and left < 2 * LIKENESS:
        return Likeness(gain, left, "reversed")
    others = [(j, *_fit(column, sources[:, j])) for j in range(measured.shape[1]) if j != s]
    if len(column) >= 4 and left > LIKENESS and others:
        j, other, rest = min(others, key=lambda entry: entry[2])
        if rest < LIKENESS and abs(abs(other) - 1.0) < 2 * SENSOR_TOLERANCE:
            return Likeness(gain, left, f"hears what sensor {j} should{', reversed' if other < 0 else ''}")
    if abs(gain - 1.0) > tolerance:
        return Likeness(gain, left, f"says {gain:.2f} times the field")
    if left > 2 * LIKENESS:
        return Likeness(gain, left, "is not where or how the rig file says")
    return Likeness(gain, left)
