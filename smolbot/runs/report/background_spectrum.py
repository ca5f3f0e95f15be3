"""The background noise recorded before the first cycle, with nothing driven."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.core.sensing import Recording
from smolbot.core.shots import Listen
from smolbot.localization.noise.model import NoiseModel
from smolbot.localization.noise.spectra import BLOCK_RATE, average_blocks
from smolbot.runs.report.recorded_flight import RecordedFlight


@dataclass(frozen=True)
class BackgroundSpectrum:
    """Background noise of every channel.

    Attributes
    ----------
    seconds : float, in s
        Total length of the recordings.
    frequencies : ndarray, shape (n,), in Hz
    density : ndarray, shape (n_sensors, n), in T/√Hz
        Mains lines included; their height depends on the length of the recording.
    line_frequencies : ndarray, shape (n_lines,), in Hz
    lines : ndarray, shape (n_lines, n_sensors), in T
        Peak of each mains line in each channel, rms over the recordings.
    floor : ndarray, shape (n_sensors,), in T/√Hz
        Median between the lines, from 20 Hz to 200 Hz.
    """

    seconds: float
    frequencies: FloatArray
    density: FloatArray
    line_frequencies: FloatArray
    lines: FloatArray
    floor: FloatArray


def find_background_recordings(flight: RecordedFlight) -> list[Recording]:
    """Return the background noise recordings of a run; a reduced world has none.

    Parameters
    ----------
    flight : RecordedFlight

    Returns
    -------
    list of Recording
    """
    return [
        recording
        for played, recording in flight.record.recordings()
        if played.shot.mode == "quiet"
        and recording.duration > 0.0
        and all(isinstance(window, Listen) for window in played.shot.windows)
    ]


def estimate_background_spectrum(recordings: list[Recording]) -> BackgroundSpectrum | None:
    """Estimate the background noise from recordings.

    Parameters
    ----------
    recordings : list of Recording

    Returns
    -------
    QuietNoise or None
        None without any recording.

    Raises
    ------
    InputError
        If nothing can be learned from them; see `NoiseModel.learn`.
    """
    if not recordings:
        return None
    from scipy.signal import periodogram

    model = NoiseModel.learn(recordings)
    rate = recordings[0].sample_rate
    size = max(round(rate / BLOCK_RATE), 1)
    pieces = [average_blocks(recording.field, size) for recording in recordings]
    n = min(piece.shape[1] for piece in pieces)
    grid, power = periodogram(np.array([piece[:, :n] for piece in pieces]), rate / size, "hann", detrend=False)
    own = np.sqrt(np.real(np.einsum("fjj->jf", model.spectrum)))
    middle = (model.frequencies >= 20.0) & (model.frequencies <= 200.0)
    return BackgroundSpectrum(
        float(sum(recording.duration for recording in recordings)),
        grid[1:],
        np.sqrt(power.mean(axis=0)[:, 1:]),
        model.line_frequencies,
        np.sqrt(np.real(np.einsum("ljj->lj", model.lines))),
        np.median(own[:, middle], axis=1),
    )
