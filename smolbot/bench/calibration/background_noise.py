"""Background noise recordings of a lab: the noise model learned from them, and channels that are broken."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from smolbot.config.samples import SampleRecordings, make_recordings, read_samples
from smolbot.core.arrays import BoolArray
from smolbot.errors import InputError
from smolbot.localization.noise.model import NoiseModel
from smolbot.localization.noise.spectra import BLOCK_RATE
from smolbot.localization.problem import MIN_OUTPUTS

if TYPE_CHECKING:
    from smolbot.config.rig import RigConfig


@dataclass(frozen=True, eq=False)
class BackgroundNoise:
    """Noise model and broken channels from background noise recordings.

    Attributes
    ----------
    noise : NoiseModel
    broken : ndarray of bool, shape (n_sensors,)
        Channels that were saturated, dead or stuck in every shot.
    remark : str
        Note for the report: the file, and what was left out.
    """

    noise: NoiseModel
    broken: BoolArray
    remark: str

    def remove_broken_channels(self, shots: SampleRecordings) -> SampleRecordings:
        """Leave the broken channels out of some shots, with a note in each.

        Parameters
        ----------
        shots : SampleRecordings

        Returns
        -------
        SampleRecordings
        """
        if not self.broken.any():
            return shots
        note = f"left out: {_format_channels(self.broken)}, of no use in the quiet samples"
        recordings = tuple(replace(r, saturated=r.saturated | self.broken) for r in shots.recordings)
        return SampleRecordings(recordings, tuple("; ".join(filter(None, [known, note])) for known in shots.notes))


def learn_background_noise(path: Path, rig: RigConfig, rate: float) -> BackgroundNoise:
    """Learn the noise from a file of background noise recordings.

    Shots are left out if a channel fails in them that works in others. A channel that fails in all is broken.

    Parameters
    ----------
    path : path
    rig : RigConfig
    rate : float, in Hz
        Sample rate of the recordings for which the noise model is used.

    Returns
    -------
    BackgroundNoise

    Raises
    ------
    InputError
        If the samples cannot be read, are too slow, or too few of them are usable.
    """
    held = read_samples(path, background_noise=True)
    shots = make_recordings(held, rig)
    least = min(rate, BLOCK_RATE)
    if held.sample_rate < 0.999 * least:
        raise InputError(
            f"{path}: has {held.sample_rate:g} samples per second; for samples of {rate:g} Hz the noise must be known "
            f"up to {0.5 * least:g} Hz, which takes {least:g}."
        )
    bad = np.array([r.saturated for r in shots.recordings])
    broken: BoolArray = np.asarray(bad.all(axis=0))
    if np.sum(~broken) < MIN_OUTPUTS:
        raise InputError(
            f"{path}: only {int(np.sum(~broken))} channels are of use, at least {MIN_OUTPUTS} are needed; "
            f"{shots.notes[0]}."
        )
    used = [number for number, each in enumerate(bad) if not np.any(each & ~broken)]
    if not used:
        notes = "; ".join(f"shot {i}: {note}" for i, note in enumerate(shots.notes) if note)
        raise InputError(f"{path}: no shot is quiet in all channels that work. {notes[:300]}")
    try:
        noise = NoiseModel.learn([shots.recordings[i] for i in used])
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    source = str(path)
    if broken.any():
        source += f"; {shots.notes[used[0]]}"
    if len(used) < len(bad):
        source += f"; {len(bad) - len(used)} of {len(bad)} shots left out: " + "; ".join(
            f"shot {i}, {shots.notes[i].removeprefix('left out: ')}" for i in range(len(bad)) if i not in used
        )
    return BackgroundNoise(noise, broken, source)


def _format_channels(channels: BoolArray) -> str:
    which = np.flatnonzero(channels)
    return f"channel{'s' if len(which) > 1 else ''} {', '.join(map(str, which))}"
