"""What a rig may offer beyond shots: one coil is driven faintly, and the sensors are heard meanwhile."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from smolbot.core.limits import Limits
from smolbot.core.sensing import Recording
from smolbot.core.shots import Actuate, Excite, Shot
from smolbot.errors import InputError

BEFORE, HELD, AFTER = 0.020, 0.040, 0.040
"""Durations of a probe's parts, in s: baseline, current on, decay; 20 ms is one period of 50 Hz mains."""


@dataclass(frozen=True, eq=False)
class Probe:
    """What was heard while a coil was switched on and off.

    Attributes
    ----------
    recording : Recording
        From `BEFORE` s before the coil was told to come on, to `AFTER` s after it was told to go.
    on, off : float, in s from the first sample
        When it was told to.
    close_limit, open_limit : float, in s
        How late its relay may be; 0 where there is none.
    """

    recording: Recording
    on: float
    off: float
    close_limit: float = 0.0
    open_limit: float = 0.0


@runtime_checkable
class Prober(Protocol):
    """A rig that can hear its own coils."""

    def probe(self, coil: str, current: float) -> Probe:
        """Hold one coil (``+x``, ``excitation x``) at `current` A for `HELD` s and hear the sensors all the while.

        It is switched by its relay where it has one: the source stands at the current when the relay opens.

        Raises
        ------
        InterlockError
            Before anything is driven, if the current breaks a limit.
        RigError
            If the world fails meanwhile; every output is at zero and every relay open.
        """


def probe_shot(limits: Limits, coil: str, current: float) -> Shot:
    """The shot that drives a coil like its probe; what limits say of the one, they say of the other.

    Raises
    ------
    InputError
        For a coil that the rig has not.
    """
    if coil in limits.coils:
        return Shot((Actuate(tuple(current if name == coil else 0.0 for name in limits.coils), HELD),))
    if coil in ("excitation x", "excitation y"):
        x = coil.endswith("x")
        return Shot((Excite((current if x else 0.0, 0.0 if x else current), 1.0 / HELD, 1),))
    known = ", ".join([*limits.coils, "excitation x", "excitation y"])
    raise InputError(f"No coil '{coil}' can be probed; coils are {known}.")
