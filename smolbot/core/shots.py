"""Windows and shots: everything that acts on the world, as data.

A shot is a short, immutable tuple of windows. It is either electrical (played by the DAQ as one
hardware-timed waveform) or mechanical (played by the magnet stage), and has at most one listening window.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from smolbot.errors import InputError

Mode = Literal["quiet", "search", "track", "lost", "hold"]


@dataclass(frozen=True)
class Actuate:
    """Hold the actuation coils at constant currents (n_coils, in A, in the rig's coil order) for `duration` s.

    Examples
    --------
    >>> import smolbot
    >>> window = smolbot.Actuate((6.2, 0.0), 0.030)
    >>> window.describe(("+x", "-y")), window.duration
    ('actuate +x 6.2 A', 0.03)
    """

    currents: tuple[float, ...]
    duration: float

    def describe(self, coils: tuple[str, ...] = ()) -> str:
        """Describe the window in a few words, for a timeline.

        Parameters
        ----------
        coils : tuple of str
            Names of the actuation coils; numbers are used without them.

        Returns
        -------
        str
        """
        names = coils or tuple(f"coil {i}" for i in range(len(self.currents)))
        driven = [f"{n} {c:.1f} A" for n, c in zip(names, self.currents, strict=True) if c]
        return "actuate " + (", ".join(driven) or "all off")


@dataclass(frozen=True)
class Excite:
    """A burst of a sine through the excitation coils: signed peak A along (x, y), Hz, number of cycles.

    Examples
    --------
    >>> import smolbot
    >>> drive = smolbot.Excite((10.0, -2.0), 103.5, cycles=5)
    >>> print(f"{drive.describe()}: {1e3 * drive.duration:.1f} ms")
    excite x +10.0 A, y -2.0 A, 5 cycles of 103.5 Hz: 48.3 ms
    """

    currents: tuple[float, float]
    frequency: float
    cycles: int

    @property
    def duration(self) -> float:
        """Length in s."""
        return self.cycles / self.frequency

    def describe(self, coils: tuple[str, ...] = ()) -> str:
        """Describe the window in a few words, for a timeline.

        Parameters
        ----------
        coils : tuple of str
            Not used.

        Returns
        -------
        str
        """
        x, y = self.currents
        return f"excite x {x:+.1f} A, y {y:+.1f} A, {self.cycles} cycles of {self.frequency:.1f} Hz"


@dataclass(frozen=True)
class RingDown:
    """Wait until the field of the excitation coils has decayed.

    Examples
    --------
    >>> import smolbot
    >>> smolbot.RingDown(0.020)
    RingDown(duration=0.02)
    """

    duration: float

    def describe(self, coils: tuple[str, ...] = ()) -> str:
        """Describe the window in a few words, for a timeline.

        Parameters
        ----------
        coils : tuple of str
            Not used.

        Returns
        -------
        str
        """
        return "ring-down"


@dataclass(frozen=True)
class Listen:
    """Record all sensors for an integer number of half-periods of `frequency` Hz.

    Examples
    --------
    >>> import smolbot
    >>> round(smolbot.Listen(half_periods=2, frequency=100.0).duration, 3)
    0.01
    """

    half_periods: int
    frequency: float

    @property
    def duration(self) -> float:
        """Length in s."""
        return self.half_periods / (2.0 * self.frequency)

    def describe(self, coils: tuple[str, ...] = ()) -> str:
        """Describe the window in a few words, for a timeline.

        Parameters
        ----------
        coils : tuple of str
            Not used.

        Returns
        -------
        str
        """
        return f"listen {self.half_periods} half-periods, {self.duration * 1e3:.1f} ms"


@dataclass(frozen=True)
class Rest:
    """Everything off for `duration` s.

    Examples
    --------
    >>> import smolbot
    >>> smolbot.Shot((smolbot.Rest(2.0),)).duration
    2.0
    """

    duration: float

    def describe(self, coils: tuple[str, ...] = ()) -> str:
        """Describe the window in a few words, for a timeline.

        Parameters
        ----------
        coils : tuple of str
            Not used.

        Returns
        -------
        str
        """
        return "rest"


@dataclass(frozen=True)
class Rotate:
    """Turn the actuation magnet about `axis` (world, 3) at `frequency` Hz for `turns` turns.

    While the magnet turns, the stage steers its axis to `axis`, or to the opposite direction if that is nearer, and
    then turns the magnet the other way. If the magnet is away, the axis is set before it turns.

    Examples
    --------
    >>> import smolbot
    >>> smolbot.Rotate((1.0, 0.0, 0.0), frequency=2.0, turns=5.0).duration
    2.5
    """

    axis: tuple[float, float, float]
    frequency: float
    turns: float

    @property
    def duration(self) -> float:
        """Length in s."""
        return self.turns / self.frequency

    def describe(self, coils: tuple[str, ...] = ()) -> str:
        """Describe the window in a few words, for a timeline.

        Parameters
        ----------
        coils : tuple of str
            Not used.

        Returns
        -------
        str
        """
        return (
            f"rotate {self.turns:g} turns at {self.frequency:g} Hz about ({', '.join(f'{a:.2f}' for a in self.axis)})"
        )


@dataclass(frozen=True)
class MoveMagnet:
    """Bring the actuation magnet near, or away.

    Examples
    --------
    >>> import smolbot
    >>> smolbot.MoveMagnet("away", expected_duration=4.0).describe()
    'move magnet away'
    """

    to: Literal["near", "away"]
    expected_duration: float

    @property
    def duration(self) -> float:
        """Expected length in s."""
        return self.expected_duration

    def describe(self, coils: tuple[str, ...] = ()) -> str:
        """Describe the window in a few words, for a timeline.

        Parameters
        ----------
        coils : tuple of str
            Not used.

        Returns
        -------
        str
        """
        return f"move magnet {self.to}"


Mechanical = Rotate | MoveMagnet | Rest
Window = Actuate | Excite | RingDown | Listen | Rest | Rotate | MoveMagnet
_ELECTRICAL = (Actuate, Excite, RingDown, Listen)
_MECHANICAL = (Rotate, MoveMagnet)


def is_magnet_near_after(shot: Shot, *, near: bool) -> bool:
    """Return whether the actuation magnet is near once a shot was played.

    Parameters
    ----------
    shot : Shot
    near : bool
        Whether it is near before the shot.

    Returns
    -------
    bool
    """
    for window in shot.windows:
        if isinstance(window, MoveMagnet):
            near = window.to == "near"
    return near


@dataclass(frozen=True)
class Shot:
    """A tuple of windows, played in order.

    Attributes
    ----------
    windows : tuple of windows
    mode : {"quiet", "search", "track", "lost", "hold"}
        Purpose: recording noise, coils or probes before the first cycle; search for the device; actuation; search
        for a lost signal; listening without actuation (until two poses agree, and in a pause).
    start : float, in s
        Start time on the rig's clock.

    Examples
    --------
    >>> print(Shot((Actuate((6.2, 8.0), 0.03), Excite((2.0, 0.0), 103.5, 5), RingDown(0.02), Listen(2, 103.5))))
    0.0 ms actuate coil 0 6.2 A, coil 1 8.0 A | 30.0 excite x +2.0 A, y +0.0 A, 5 cycles of 103.5 Hz | \
78.3 ring-down | 98.3 listen 2 half-periods, 9.7 ms | 108.0
    """

    windows: tuple[Window, ...]
    mode: Mode = "track"
    start: float = 0.0

    def __post_init__(self) -> None:
        windows = tuple(self.windows)
        object.__setattr__(self, "windows", windows)
        if not windows:
            raise InputError("A shot needs at least one window.")
        if self.mode not in get_args(Mode):
            raise InputError(f"Shot mode must be one of {', '.join(get_args(Mode))}; got {self.mode!r}.")
        for window in windows:
            if not 0 < window.duration < np.inf:
                raise InputError(
                    f"Window {window!r} lasts {window.duration} s; a duration must be positive and finite."
                )
        if sum(isinstance(w, Listen) for w in windows) > 1:
            raise InputError("A shot has at most one Listen window.")
        if any(isinstance(w, _ELECTRICAL) for w in windows) and any(isinstance(w, _MECHANICAL) for w in windows):
            raise InputError(
                "A shot is either electrical or mechanical; put Rotate and MoveMagnet into a shot of their own."
            )

    @property
    def duration(self) -> float:
        """Total length in s."""
        return sum(w.duration for w in self.windows)

    @property
    def end(self) -> float:
        """End time on the rig's clock, in s."""
        return self.start + self.duration

    @property
    def listen(self) -> Listen | None:
        """Its Listen window, if any."""
        return next((w for w in self.windows if isinstance(w, Listen)), None)

    @property
    def excite(self) -> Excite | None:
        """The last excitation before the listening window, if any."""
        found = None
        for window in self.windows:
            if isinstance(window, Listen):
                break
            if isinstance(window, Excite):
                found = window
        return found

    def timed(self) -> Iterator[tuple[float, Window]]:
        """Iterate over the windows with their start times.

        Yields
        ------
        start : float, in s
            From the start of the shot.
        window : Window
        """
        at = 0.0
        for window in self.windows:
            yield at, window
            at += window.duration

    def timeline(self, coils: tuple[str, ...] = ()) -> str:
        """Format the shot as one line: the start of each window in ms, its description, and the end.

        Parameters
        ----------
        coils : tuple of str
            Names of the actuation coils; numbers are used without them.

        Returns
        -------
        str
        """
        parts = [
            f"{at * 1e3:.1f}{' ms' if i == 0 else ''} {w.describe(coils)}" for i, (at, w) in enumerate(self.timed())
        ]
        return " | ".join([*parts, f"{self.duration * 1e3:.1f}"])

    def __str__(self) -> str:
        return self.timeline()
