"""Coil probing, which a rig may offer beyond shots: one coil is driven weakly while the sensors record."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from smolbot.core.limits import Limits
from smolbot.core.sensing import Recording
from smolbot.core.shots import Actuate, Excite, Shot
from smolbot.errors import InputError

BASELINE_DURATION, HOLD_DURATION, DECAY_DURATION = 0.020, 0.040, 0.040
"""Durations of a probe's parts, in s: baseline, current on, decay; 20 ms is one period of 50 Hz mains."""


@dataclass(frozen=True, eq=False)
class Probe:
    """Recording made while a coil was switched on and off.

    Attributes
    ----------
    recording : Recording
        From `BASELINE_DURATION` s before the coil was commanded on to `DECAY_DURATION` s after it was commanded off.
    on, off : float, in s from the first sample
        Times of the two commands.
    close_limit, open_limit : float, in s
        Longest allowed delay of its relay; 0 where there is none.
    """

    recording: Recording
    on: float
    off: float
    close_limit: float = 0.0
    open_limit: float = 0.0


@runtime_checkable
class Prober(Protocol):
    """A rig that can record its own coils with its sensors."""

    def probe(self, coil: str, current: float) -> Probe:
        """Hold one coil at a constant current for `HOLD_DURATION` s; record the sensors before, during and after.

        A coil with a relay is switched by the relay: the source still supplies the current when it opens.

        Parameters
        ----------
        coil : str
            Name of the coil, such as ``+x`` or ``excitation x``.
        current : float, in A

        Returns
        -------
        Probe

        Raises
        ------
        InterlockError
            Before anything is driven, if the current breaks a limit.
        RigError
            If the rig fails during the probe; every output is at zero and every relay open.
        """


def make_probe_shot(limits: Limits, coil: str, current: float) -> Shot:
    """Make the shot that drives a coil like its probe does, to check the probe against the limits of shots.

    Parameters
    ----------
    limits : Limits
    coil : str
        Name of the coil, such as ``+x`` or ``excitation x``.
    current : float, in A

    Returns
    -------
    Shot

    Raises
    ------
    InputError
        If the rig has no such coil.
    """
    if coil in limits.coils:
        return Shot((Actuate(tuple(current if name == coil else 0.0 for name in limits.coils), HOLD_DURATION),))
    if coil in ("excitation x", "excitation y"):
        x = coil.endswith("x")
        return Shot((Excite((current if x else 0.0, 0.0 if x else current), 1.0 / HOLD_DURATION, 1),))
    known = ", ".join([*limits.coils, "excitation x", "excitation y"])
    raise InputError(f"No coil '{coil}' can be probed; coils are {known}.")
