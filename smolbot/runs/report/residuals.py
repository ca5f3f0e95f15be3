"""Fit residuals of every window: the recorded field minus the forward model at the recorded pose."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from smolbot.core.arrays import BoolArray, FloatArray
from smolbot.core.pose import Pose
from smolbot.core.sensing import Recording
from smolbot.localization.forward import compute_deflection, compute_sensor_field
from smolbot.localization.localizer import Localizer
from smolbot.localization.noise.excitation_transients import make_decay_columns
from smolbot.runs.report.assumed_models import AssumedModels
from smolbot.runs.report.recorded_flight import RecordedFlight

BLOCK_DURATION = 1e-4
"""Length, in s, of the blocks to which samples are averaged before a model is compared with them."""

MAX_WINDOWS = 60
"""Number of windows of a run that are evaluated, equally spread."""

_LEAD_TIME_CONSTANTS = 10.0  # lead of the model before the recording, in time constants of the sensors' low pass
_N_ITERATIONS = 3


@dataclass(frozen=True)
class FittedWindow:
    """One recording and its model, both without the trend that is fitted in every channel.

    Attributes
    ----------
    time : float, in s
        Middle of the recording, on the rig's clock.
    seconds : ndarray, shape (n,), in s
        Since the first sample.
    measured, model : ndarray, shape (n_sensors, n), in T
    used : ndarray of bool, shape (n_sensors,)
        False for saturated channels.
    """

    time: float
    seconds: FloatArray
    measured: FloatArray
    model: FloatArray
    used: BoolArray

    @property
    def residuals(self) -> FloatArray:
        """Fit residuals, shape (n_used, n), in T."""
        return (self.measured - self.model)[self.used]

    @property
    def r_squared(self) -> float:
        """R squared of this fit with equal weights; that of the flight is of whitened samples."""
        measured = self.measured[self.used]
        return 1.0 - float(np.sum(self.residuals**2) / np.sum(measured**2))


def fit_windows(flight: RecordedFlight, most: int = MAX_WINDOWS) -> Iterator[FittedWindow]:
    """Compute model and residuals of some recordings with a trusted pose, with what was assumed at their time.

    Parameters
    ----------
    flight : RecordedFlight
    most : int
        Largest number of recordings, chosen at equal steps.

    Yields
    ------
    FittedWindow
        In order of time.
    """
    assumed, record, mission = AssumedModels.from_mission(flight.mission), flight.record, flight.mission
    events = sorted(record.events, key=lambda event: event.time)
    played = {shot.number: shot for shot in record.played}
    chosen = [
        (pose, played[number])
        for moment, number in zip(record.moments, record.shot_of_cycle, strict=True)
        if (pose := moment.cycle.trusted) is not None and played[number].samples is not None
    ]
    step = max(len(chosen) / most, 1.0)
    paper = mission.base.localization.estimator == "paper"
    degree = Localizer(assumed.sensors, assumed.device, estimator="paper" if paper else "whitened")
    for index in np.unique((np.arange(min(most, len(chosen))) * step).astype(int)):
        pose, shot = chosen[index]
        while events and events[0].time < pose.time:
            assumed = assumed.with_event(events.pop(0))
        recording = shot.recording(record.converter)
        if recording is None:
            continue
        recording = assumed.tails.subtract_from(shot.shot, recording)
        yield fit_window(recording, pose, assumed, degree.free_trend(recording))


def fit_window(recording: Recording, pose: Pose, assumed: AssumedModels, trend: int = 0) -> FittedWindow:
    """Compute the model of a recording at a given pose.

    Amplitude and phase are fitted, and a polynomial in each channel.

    Parameters
    ----------
    recording : Recording
    pose : Pose
    assumed : AssumedModels
        Sensors, device and coils as assumed.
    trend : int
        Degree of the polynomial; where coils still ring, their decays are fitted as well.

    Returns
    -------
    FittedWindow
    """
    size = max(round(BLOCK_DURATION * recording.sample_rate), 1)
    n = recording.field.shape[1] // size
    step = size / recording.sample_rate
    seconds = (np.arange(n) + 0.5) * step - 0.5 / recording.sample_rate
    used = ~recording.saturated
    blocks = recording.field[:, : n * size].reshape(len(recording.field), n, size).mean(axis=2)
    since = recording.time_since_drive + seconds
    free = np.column_stack(
        [np.linspace(-1.0, 1.0, n) ** k for k in range(trend + 1)]
        + ([make_decay_columns(since, assumed.transients)] if assumed.transients else [])
    )
    basis = np.linalg.qr(free)[0]

    def without(field: FloatArray) -> FloatArray:
        return field - (field @ basis) @ basis.T

    device, place = assumed.device, (pose.position, pose.orientation)
    lag = 1.0 / (2.0 * np.pi * assumed.sensors.bandwidth)
    before = int(np.ceil(_LEAD_TIME_CONSTANTS * lag / step))
    times = since[0] + step * np.arange(-before, n)

    def model(swing: FloatArray) -> FloatArray:
        theta = compute_deflection(device, times, float(np.hypot(*swing)), float(np.arctan2(swing[1], swing[0])))
        return without(
            apply_low_pass(compute_sensor_field(assumed.sensors, device, *place, theta), step, lag)[:, before:]
        )

    measured = without(blocks)
    swing = _fit_swing(model, measured, used, device.theta_max)
    return FittedWindow(recording.middle, seconds, measured, model(swing), used)


def _fit_swing(model: Callable[[FloatArray], FloatArray], data: FloatArray, used: BoolArray, top: float) -> FloatArray:
    """Fit amplitude times (cos, sin) of the phase, in rad, by Gauss-Newton from the linearized solution."""
    tiny = 1e-3 * top
    rest = model(np.zeros(2))[used]
    columns = np.column_stack([(model(tiny * axis)[used] - rest).ravel() / tiny for axis in np.eye(2)])
    first: FloatArray = np.asarray(np.linalg.lstsq(columns, (data[used] - rest).ravel(), rcond=None)[0])
    swing: FloatArray = first * min(1.0, top / max(float(np.hypot(*first)), 1e-12))
    for _ in range(_N_ITERATIONS):
        now = model(swing)[used]
        columns = np.column_stack([(model(swing + tiny * axis)[used] - now).ravel() / tiny for axis in np.eye(2)])
        step: FloatArray = np.asarray(np.linalg.lstsq(columns, (data[used] - now).ravel(), rcond=None)[0])
        swing = swing + step
    return swing


def apply_low_pass(field: FloatArray, step: float, lag: float) -> FloatArray:
    """Apply the sensors' first-order low pass, exact for a field that is linear between samples.

    Parameters
    ----------
    field : ndarray, shape (n_sensors, n), in T
    step : float, in s
        Between samples.
    lag : float, in s
        Time constant.

    Returns
    -------
    ndarray, shape (n_sensors, n), in T
    """
    if lag <= 0.0:
        return field
    from scipy.signal import lfilter

    decay = np.exp(-step / lag)
    gain = lag / step * (1.0 - decay)
    first = np.array([1.0 - gain, gain - decay])
    initial = field[:, :1] - first[0] * field[:, :1]
    out: FloatArray = lfilter(first, [1.0, -decay], field, axis=1, zi=initial)[0]
    return out


def compute_density(windows: list[FloatArray], rate: float) -> tuple[FloatArray, FloatArray]:
    """Compute the spectral density, rms over channels and windows.

    Parameters
    ----------
    windows : list of ndarray, shape (n_channels, n), in T
        All are cut to the length of the shortest.
    rate : float, in Hz

    Returns
    -------
    frequencies : ndarray, shape (m,), in Hz
    density : ndarray, shape (m,), in T/√Hz
    """
    from scipy.signal import periodogram

    n = min(window.shape[1] for window in windows)
    spectra = [periodogram(window[:, :n], rate, "hann", detrend=False) for window in windows]
    return spectra[0][0], np.sqrt(np.mean([power.mean(axis=0) for _, power in spectra], axis=0))


def cut_background(recordings: list[Recording], n: int, trend: int) -> list[FloatArray]:
    """Cut background noise recordings into windows, each without the polynomial that a fit leaves free.

    Parameters
    ----------
    recordings : list of Recording
    n : int
        Length of a window, in blocks.
    trend : int
        Degree of the polynomial.

    Returns
    -------
    list of ndarray, shape (n_channels, n), in T
    """
    basis = np.linalg.qr(np.column_stack([np.linspace(-1.0, 1.0, n) ** k for k in range(trend + 1)]))[0]
    found = []
    for recording in recordings:
        size = max(round(BLOCK_DURATION * recording.sample_rate), 1)
        count = recording.field.shape[1] // (size * n)
        field = recording.field[~recording.saturated, : count * n * size]
        for piece in field.reshape(len(field), count, n, size).mean(axis=3).transpose(1, 0, 2):
            found.append(piece - (piece @ basis) @ basis.T)
    return found
