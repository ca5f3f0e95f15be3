"""Check of wiring and polarity: responses of all sensors to all coils compared with the predicted ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smolbot.core.arrays import BoolArray, FloatArray

COIL_GAIN_TOLERANCE = 0.15
"""Relative tolerance of a coil's field: turns, amplifier, position, and the resolution of an output at a few mA."""

SENSOR_GAIN_TOLERANCE = 0.10
"""Relative tolerance of a sensor's scale factor; twice the effect of position and axis errors is added to it."""

POSITION_STD, TILT_STD = 0.5e-3, 0.009
"""Standard deviation of a sensor's position and angle relative to a coil: m (ruler, printed frame) and rad (half a
degree)."""

MAX_UNEXPLAINED = 0.15
"""Highest share of a response that its predicted pattern may leave unexplained."""

MIN_RESPONSE = 0.2
"""A sensor whose response is below this share of the predicted one measures no coil."""

N_PASSES = 3
"""Number of alternating checks of coils and sensors, so that a fault of one is not attributed to the other."""


@dataclass(frozen=True)
class ResponseMatch:
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


def match_responses(
    measured: FloatArray,
    predicted: FloatArray,
    coils: tuple[str, ...],
    usable: BoolArray,
    spread: FloatArray | None = None,
) -> tuple[list[ResponseMatch], list[ResponseMatch]]:
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
    coils : list of ResponseMatch
    sensors : list of ResponseMatch
    """
    spread = np.zeros_like(predicted) if spread is None else spread
    live, detected = usable.copy(), np.any(measured != 0.0, axis=1)
    found_coils: list[ResponseMatch] = []
    found_sensors: list[ResponseMatch] = []
    for _ in range(N_PASSES):
        found_coils = [
            _check_coil(row, predicted, k, coils, live) if detected[k] else ResponseMatch(0.0, 1.0, "makes no field")
            for k, row in enumerate(measured)
        ]
        sources = _predict_wired_responses(measured, predicted, live, detected)
        power = np.maximum((predicted[detected] ** 2).sum(axis=0), 1e-300)
        doubt = np.sqrt(((predicted[detected] * spread[detected]) ** 2).sum(axis=0)) / power
        found_sensors = [
            _check_sensor(measured[detected], sources[detected], s, SENSOR_GAIN_TOLERANCE + 2 * doubt[s])
            for s in range(measured.shape[1])
        ]
        live = usable & np.array([not s.fault for s in found_sensors])
        if live.sum() < 3:  # so many are off that the prediction itself is in doubt: blame no sensor
            live = usable.copy()
    return found_coils, found_sensors


def compute_response_std(fields: FloatArray, gradients: FloatArray, axes: FloatArray) -> FloatArray:
    """Compute the standard deviation of each response for position and angle errors `POSITION_STD` and `TILT_STD`.

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
    return np.hypot(POSITION_STD * along, TILT_STD * across)


def _fit_robustly(row: FloatArray, pattern: FloatArray) -> tuple[float, float]:
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


def _check_coil(
    row: FloatArray, predicted: FloatArray, k: int, coils: tuple[str, ...], live: BoolArray
) -> ResponseMatch:
    fits = [_fit_robustly(row[live], pattern[live]) for pattern in predicted]
    gain, residual = fits[k]
    best = min(range(len(fits)), key=lambda j: fits[j][1])
    if best != k and fits[best][1] < min(residual, 2 * MAX_UNEXPLAINED):
        way = "" if fits[best][0] > 0 else ", reversed"
        return ResponseMatch(gain, residual, f"this is the field of {coils[best]}{way}")
    if gain < 0 and residual < 2 * MAX_UNEXPLAINED:
        return ResponseMatch(gain, residual, "reversed")
    if residual > MAX_UNEXPLAINED:
        return ResponseMatch(gain, residual, "no coil of the rig file makes this field")
    if abs(gain - 1.0) > COIL_GAIN_TOLERANCE:
        return ResponseMatch(gain, residual, f"makes {gain:.2f} times its field")
    return ResponseMatch(gain, residual)


def _predict_wired_responses(
    measured: FloatArray, predicted: FloatArray, live: BoolArray, detected: BoolArray
) -> FloatArray:
    """Predict the response of each sensor to the coils as they are actually wired: (n_coils, n_sensors)."""
    found = np.zeros_like(predicted)
    for k in np.flatnonzero(detected):
        fits = [_fit_robustly(measured[k, live], pattern[live]) for pattern in predicted]
        best = min(range(len(fits)), key=lambda j: fits[j][1])
        found[k] = fits[best][0] * predicted[best]
    return found


def _check_sensor(measured: FloatArray, sources: FloatArray, s: int, tolerance: float) -> ResponseMatch:
    column = measured[:, s]
    gain, residual = _fit(column, sources[:, s])
    if len(column) == 0:
        return ResponseMatch(gain, residual)
    if np.linalg.norm(column) < MIN_RESPONSE * np.linalg.norm(sources[:, s]):
        return ResponseMatch(gain, residual, "measures no coil")
    if gain < 0 and residual < 2 * MAX_UNEXPLAINED:
        return ResponseMatch(gain, residual, "reversed")
    others = [(j, *_fit(column, sources[:, j])) for j in range(measured.shape[1]) if j != s]
    if len(column) >= 4 and residual > MAX_UNEXPLAINED and others:
        j, other, rest = min(others, key=lambda entry: entry[2])
        if rest < MAX_UNEXPLAINED and abs(abs(other) - 1.0) < 2 * SENSOR_GAIN_TOLERANCE:
            return ResponseMatch(gain, residual, f"measures what sensor {j} should{', reversed' if other < 0 else ''}")
    if abs(gain - 1.0) > tolerance:
        return ResponseMatch(gain, residual, f"says {gain:.2f} times the field")
    if residual > 2 * MAX_UNEXPLAINED:
        return ResponseMatch(gain, residual, "is not where or how the rig file says")
    return ResponseMatch(gain, residual)
