"""Fit frequency, damping and amplitude of a free swing (Eqs. S2 to S4) to angles over time."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.errors import InputError

MIN_PERIODS = 4  # of free swing that a fit needs
MIN_FRAMES_PER_PERIOD = 6  # a period, likewise
DRIVEN_SHARE = 0.97  # share of the largest envelope down to which the drive may still be on


@dataclass(frozen=True, eq=False)
class Ringing:
    """A free swing.

        theta(t) = amplitude D(t - begin) cos(2 pi f (t - begin) + phase) + rest        (Eq. S2)

    Attributes
    ----------
    begin, end : float, in s
        Fitted time span.
    frequency : float, in Hz
    amplitude : float, in rad
    damping : float, in 1/s
        D is ``exp(-damping t)`` (Eq. S4) or ``1 - damping t`` (Eq. S3), whichever fits better.
    rest : float, in rad
    model : str
        ``exponential`` or ``linear``.
    std : dict of str to float
        Standard deviations of frequency, amplitude and damping.
    rms : float, in rad
        Rms of the residuals.
    other_rms : float, in rad
        Rms of the residuals of the other model.
    largest : float, in rad
        Largest amplitude of all periods, driven ones too.
    fitted : ndarray, shape (n,), in rad
        The model at `times`.
    times : ndarray, shape (n,), in s
        Times of the fitted frames.
    """

    begin: float
    end: float
    frequency: float
    amplitude: float
    damping: float
    rest: float
    model: str
    std: dict[str, float]
    rms: float
    other_rms: float
    largest: float
    fitted: FloatArray
    times: FloatArray


def fit_ringing(times: FloatArray, angles: FloatArray, begin: float | None = None, end: float | None = None) -> Ringing:
    """Fit the free part of a swing.

    Parameters
    ----------
    times : ndarray, shape (n,), in s
    angles : ndarray, shape (n,), in rad
    begin, end : float, in s, optional
        Time span to fit; by default from one period after the last frame of nearly the largest amplitude to the
        end.

    Returns
    -------
    Ringing

    Raises
    ------
    InputError
        If there are too few periods, or too few frames in each.
    """
    from scipy.optimize import least_squares

    rough = _find_frequency(times, angles)
    step = float(np.median(np.diff(times)))
    if rough * step * MIN_FRAMES_PER_PERIOD > 1.0:
        raise InputError(
            f"The angles vary at {rough:.1f} Hz or more, with {1.0 / (rough * step):.1f} frames a period; "
            f"{MIN_FRAMES_PER_PERIOD} or more are needed. Is --fps what the clip was recorded at?"
        )
    envelope = _compute_envelope(times, angles, rough)
    inner = slice(int(0.5 / (rough * step)), len(times) - int(0.5 / (rough * step)))
    largest = float(np.max(envelope[inner])) if envelope[inner].size else float(np.max(envelope))
    if begin is None:
        full = np.nonzero(envelope[inner] >= DRIVEN_SHARE * largest)[0]
        begin = float(times[inner][full[-1]]) + 1.0 / rough
    end = float(times[-1]) if end is None else end
    kept = (times >= begin) & (times <= end)
    if (end - begin) * rough < MIN_PERIODS or np.count_nonzero(kept) < MIN_FRAMES_PER_PERIOD * MIN_PERIODS:
        raise InputError(
            f"From {begin:.4f} to {end:.4f} s there are {max((end - begin) * rough, 0.0):.1f} periods of free "
            f"swing; {MIN_PERIODS} or more "
            "are needed. Say with --from-s and --to-s where it is free."
        )
    t, y = times[kept] - begin, angles[kept]
    fits = {}
    for model in ("exponential", "linear"):
        best = None
        for damping in (0.3, 3.0, 30.0):
            start = _guess_start(t, y, rough, damping, model)
            found = least_squares(lambda p, m=model: _evaluate_swing(p, t, m) - y, start, x_scale="jac", method="lm")
            if best is None or found.cost < best.cost:
                best = found
        assert best is not None
        fits[model] = best
    model = min(fits, key=lambda name: fits[name].cost)
    best, other = fits[model], fits["linear" if model == "exponential" else "exponential"]
    amplitude, phase, frequency, damping, rest = best.x
    rms = math.sqrt(2.0 * best.cost / len(t))
    covariance = rms**2 * np.linalg.pinv(best.jac.T @ best.jac)
    names = {"amplitude": 0, "frequency": 2, "damping": 3}
    del phase
    return Ringing(
        begin, end, abs(float(frequency)), abs(float(amplitude)), float(damping), float(rest), model,
        {name: math.sqrt(max(float(covariance[i, i]), 0.0)) for name, i in names.items()},
        rms, math.sqrt(2.0 * other.cost / len(t)), largest, y + best.fun, times[kept],
    )  # fmt: skip


def _evaluate_swing(p: FloatArray, t: FloatArray, model: str) -> FloatArray:
    amplitude, phase, frequency, damping, rest = p
    decay = np.exp(-damping * t) if model == "exponential" else np.maximum(1.0 - damping * t, 0.0)
    return np.asarray(amplitude * decay * np.cos(2.0 * math.pi * frequency * t + phase) + rest)


def _guess_start(t: FloatArray, y: FloatArray, frequency: float, damping: float, model: str) -> FloatArray:
    """Compute start values for a guessed damping and frequency, by linear least squares."""
    rate = damping if model == "exponential" else min(damping, 0.5 / max(float(t[-1]), 1e-9))
    decay = np.exp(-rate * t) if model == "exponential" else 1.0 - rate * t
    angle = 2.0 * math.pi * frequency * t
    basis = np.column_stack([decay * np.cos(angle), -decay * np.sin(angle), np.ones_like(t)])
    c, s, rest = np.linalg.lstsq(basis, y, rcond=None)[0]
    return np.array([math.hypot(c, s), math.atan2(s, c), frequency, rate, rest])


def _find_frequency(times: FloatArray, angles: FloatArray) -> float:
    """Find the frequency of the strongest line in Hz, by a padded spectrum and a parabola through its maximum."""
    step = float(np.median(np.diff(times)))
    even = np.interp(np.arange(times[0], times[-1], step), times, angles)
    even = (even - even.mean()) * np.hanning(len(even))
    size = 8 * len(even)
    power = np.abs(np.fft.rfft(even, size))
    first = max(int(1.5 * size / len(even)), 1)  # below one and a half periods there is no swing
    top = first + int(np.argmax(power[first:-1]))
    low, middle, high = power[top - 1 : top + 2]
    shift = 0.5 * (low - high) / (low - 2.0 * middle + high) if low - 2.0 * middle + high < 0 else 0.0
    return float((top + shift) / (size * step))


def _compute_envelope(times: FloatArray, angles: FloatArray, frequency: float) -> FloatArray:
    """Compute the amplitude (n,) over one period around each frame."""
    step = float(np.median(np.diff(times)))
    n = max(round(1.0 / (frequency * step)), 3)
    kernel = np.ones(n) / n
    turned = (angles - angles.mean()) * np.exp(-2j * math.pi * frequency * times)
    return np.asarray(2.0 * np.abs(np.convolve(turned, kernel, mode="same")))
