"""Decaying current of the actuation coils during listening: identified once, and subtracted from every recording.

An air coil of some millitesla a few centimetres from a fluxgate is measurable for more than ten of its time
constants. If listening begins early, about a nanotesla is left of an actuation's field and decays within the window;
it resembles a turn of the device, and biases all poses in the same way. A free decay in every channel would cost
half of the window's information. But the decay is the same every time: size and time constant are learned from a
weak actuation of each coil before the flight, and the remaining field follows from the commands of a shot.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from smolbot.core.arrays import FloatArray
from smolbot.core.sensing import Recording
from smolbot.core.shots import Actuate, Listen, Shot
from smolbot.errors import InputError
from smolbot.localization.noise.excitation_transients import fit_decay_sizes, learn_time_constant
from smolbot.localization.problem import find_constant_channels

MIN_FIELD = 1e-12
"""Field, in T, below which a decay is not subtracted: a hundredth of the noise of a window."""


@dataclass(frozen=True, eq=False)
class CoilDecay:
    """Decay of one actuation coil's field.

    Attributes
    ----------
    time_constant : float, in s
    size : ndarray, shape (n_sensors,), in T per A
        As measured when the current is cut, with the true gains, positions and axes of the sensors.
    """

    time_constant: float
    size: FloatArray


@dataclass(frozen=True)
class CoilDecays:
    """Decays of all actuation coils.

    Attributes
    ----------
    decays : tuple of CoilDecay or None
        In the order of a window's currents; None for a coil without a measurable decay.
    """

    decays: tuple[CoilDecay | None, ...] = ()

    def compute_field(self, shot: Shot, n: int, sample_rate: float) -> FloatArray | None:
        """Compute the field of a shot's decaying actuation currents during its `Listen` window.

        Between shots more than ten time constants pass, so earlier shots do not matter.

        Parameters
        ----------
        shot : Shot
        n : int
            Number of samples.
        sample_rate : float, in Hz

        Returns
        -------
        ndarray, shape (n_sensors, n), in T, or None
            None if the field is negligible.
        """
        listens = next((at for at, window in shot.timed() if isinstance(window, Listen)), None)
        out: FloatArray | None = None
        for at, window in shot.timed():
            if listens is None or not isinstance(window, Actuate):
                continue
            since = listens - at - window.duration
            for tail, current in zip(self.decays, window.currents, strict=True):
                if tail is None or current == 0.0 or since < 0.0:
                    continue
                # current at the end of the window, then its decay until listening begins
                reached = current * -np.expm1(-window.duration / tail.time_constant)
                sizes = reached * np.exp(-since / tail.time_constant) * tail.size
                if np.abs(sizes).max() < MIN_FIELD:
                    continue
                field = np.outer(sizes, np.exp(-np.arange(n) / (sample_rate * tail.time_constant)))
                out = field if out is None else out + field
        return out

    def subtract_from(self, shot: Shot, recording: Recording) -> Recording:
        """Subtract from a recording the field of its shot's decaying actuation currents.

        A channel that is constant measures no decay, and stays as it is.

        Parameters
        ----------
        shot : Shot
        recording : Recording

        Returns
        -------
        Recording
        """
        if not self.decays:
            return recording
        field = self.compute_field(shot, recording.field.shape[1], recording.sample_rate)
        if field is None:
            return recording
        field[find_constant_channels(recording.field)] = 0.0
        return replace(recording, field=recording.field - field)


def identify_decay(shot: Shot, recordings: Sequence[Recording], frequency: float) -> CoilDecay | None:
    """Identify the decay of the one coil that was driven in a shot.

    Parameters
    ----------
    shot : Shot
    recordings : sequence of Recording
        Of `shot`, or of others like it. Saturated ones are ignored: every channel is needed.
    frequency : float, in Hz
        The device's resonance, since an actuation excites it.

    Returns
    -------
    CoilDecay or None
        None if no decay can be measured.

    Raises
    ------
    InputError
        If the shot has no `Actuate` before a `Listen`, or drives more than one coil.
    """
    ends = [(at, window) for at, window in shot.timed() if isinstance(window, Actuate)]
    listens = [at for at, window in shot.timed() if isinstance(window, Listen)]
    driven = [current for _, window in ends for current in window.currents if current]
    if len(ends) != 1 or len(listens) != 1 or len(driven) != 1 or listens[0] < ends[0][0]:
        raise InputError(
            "A coil's decay is learned from a shot in which one coil is driven once and which then listens."
        )
    usable = [recording for recording in recordings if not recording.saturated.any()]
    if not usable:
        return None
    try:
        tau = learn_time_constant(usable, frequency)
    except InputError:  # no decay: the supply stops at once, or the coil is too far from the sensors
        return None
    at, window = ends[0]
    reached = driven[0] * -np.expm1(-window.duration / tau) * np.exp(-(listens[0] - at - window.duration) / tau)
    return CoilDecay(tau, np.mean([fit_decay_sizes(r, tau, frequency) for r in usable], axis=0) / reached)
