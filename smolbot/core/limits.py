"""Limits of a rig, and the one check that every rig applies to a shot before it plays any of it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from smolbot.core.shots import Actuate, Excite, Listen, MoveMagnet, Rotate, Shot
from smolbot.errors import InterlockError

ROUNDING = 1e-9
"""Slack on every limit, in its SI unit: values that differ by rounding are equal."""

AXIS_TOLERANCE = 1e-6
"""Slack on the direction of the stage's axis, in rad."""


@dataclass(frozen=True)
class BrokenLimit:
    """One limit that a shot breaks: a sentence for people, and the fields of an `InterlockError`."""

    said: str
    limit: float | None = None
    value: float | None = None
    unit: str = ""
    channel: str = ""


@dataclass(frozen=True)
class Limits:
    """Limits of a rig, within which every shot must stay. SI units.

    Attributes
    ----------
    coils : tuple of str
        Names of the actuation coils, in the order of every current vector; empty without such coils.
    max_current : float, in A
        Per actuation coil.
    unipolar : bool
        True if a coil's supply cannot reverse its current.
    max_actuation : float, in s
        Longest single actuation window.
    max_excitation_current : float, in A
        Peak, per excitation coil.
    max_excitation : float, in s
        Longest burst.
    min_ring_down : float, in s
        Between the end of an excitation and the start of listening.
    max_listen : float, in s
    max_rotation_frequency : float, in Hz
        Of the rotating magnet; 0 without one.
    max_steering_rate : float, in rad/s
        Of the stage that turns the magnet's axis about the vertical, while the magnet is near.

    Examples
    --------
    >>> import smolbot
    >>> limits = smolbot.Limits(coils=("+x", "-y"), max_current=8.0)
    >>> limits.faults(smolbot.Shot((smolbot.Actuate((9.0, 0.0), 0.03),)))
    ["Coil '+x' current must lie within 0 to 8 A; got 9.00 A."]
    """

    coils: tuple[str, ...]
    max_current: float
    unipolar: bool = True
    max_actuation: float = 0.2
    max_excitation_current: float = 10.0
    max_excitation: float = 0.5
    min_ring_down: float = 0.0
    max_listen: float = 3.0
    max_rotation_frequency: float = 0.0
    max_steering_rate: float = 0.0

    def faults(self, shot: Shot, *, magnet_near: bool = False) -> list[str]:
        """List every limit that a shot breaks.

        Parameters
        ----------
        shot : Shot
        magnet_near : bool
            Whether the actuation magnet is near when the shot begins.

        Returns
        -------
        list of str
            One sentence per broken limit; empty if the shot may be played.
        """
        return [one.said for one in self.broken(shot, magnet_near=magnet_near)]

    def broken(self, shot: Shot, *, magnet_near: bool = False) -> list[BrokenLimit]:
        """List every limit that a shot breaks, as `faults` does, with value and limit of each.

        Parameters
        ----------
        shot : Shot
        magnet_near : bool
            Whether the actuation magnet is near when the shot begins.

        Returns
        -------
        list of BrokenLimit
            Empty if the shot may be played.
        """
        found: list[BrokenLimit] = []
        quiet_since = float("inf")
        axis: tuple[float, float, float] | None = None
        for at, window in shot.timed():
            if magnet_near and isinstance(window, Actuate | Excite | Listen):
                found.append(
                    BrokenLimit(
                        f"{type(window).__name__} at {at * 1e3:.1f} ms needs the actuation magnet away: near, it "
                        "saturates the sensors and stops the oscillation; move it away first."
                    )
                )
            if isinstance(window, Actuate):
                found += self._find_actuation_faults(window)
                quiet_since = 0.0
            elif isinstance(window, Excite):
                found += self._find_excitation_faults(window)
                quiet_since = 0.0
            elif isinstance(window, Listen):
                if quiet_since < self.min_ring_down - ROUNDING:
                    said = (
                        f"Listening at {at * 1e3:.1f} ms follows a drive after {quiet_since * 1e3:.1f} ms; "
                        f"the coils need {self.min_ring_down * 1e3:.1f} ms of ring-down."
                    )
                    found.append(BrokenLimit(said, self.min_ring_down, quiet_since, "s"))
                if window.duration > self.max_listen + ROUNDING:
                    said = f"Listen window must last at most {self.max_listen:g} s; got {window.duration:.3f} s."
                    found.append(BrokenLimit(said, self.max_listen, window.duration, "s"))
            elif isinstance(window, Rotate | MoveMagnet):
                found += self._find_mechanical_faults(window, axis, near=magnet_near)
                axis = window.axis if isinstance(window, Rotate) else None
                magnet_near = window.to == "near" if isinstance(window, MoveMagnet) else magnet_near
            if not isinstance(window, Actuate | Excite):
                quiet_since += window.duration
        return found

    def check(self, shot: Shot, *, magnet_near: bool = False) -> None:
        """Raise an error that names every broken limit, unless the shot may be played.

        Parameters
        ----------
        shot : Shot
        magnet_near : bool
            Whether the actuation magnet is near when the shot begins.

        Raises
        ------
        InterlockError
            If the shot breaks a limit.
        """
        found = self.broken(shot, magnet_near=magnet_near)
        if found:
            one = found[0]
            raise InterlockError(
                " ".join([*(each.said for each in found), "Nothing was played."]),
                limit=one.limit, value=one.value, unit=one.unit, channel=one.channel,
            )  # fmt: skip

    def _find_actuation_faults(self, window: Actuate) -> list[BrokenLimit]:
        if len(window.currents) != len(self.coils):
            coils = f"{len(self.coils)} coils ({', '.join(self.coils)})"
            return [BrokenLimit(f"Actuate has {len(window.currents)} currents; this rig has {coils}.")]
        low = 0.0 if self.unipolar else -self.max_current
        found = [
            BrokenLimit(
                f"Coil '{name}' current must lie within {low:g} to {self.max_current:g} A; got {current:.2f} A.",
                self.max_current if current > low else low,
                current,
                "A",
                name,
            )
            for name, current in zip(self.coils, window.currents, strict=True)
            if not low - ROUNDING <= current <= self.max_current + ROUNDING
        ]
        if window.duration > self.max_actuation + ROUNDING:
            said = f"Actuate must last at most {self.max_actuation * 1e3:g} ms; got {window.duration * 1e3:.1f} ms."
            found.append(BrokenLimit(said, self.max_actuation, window.duration, "s"))
        return found

    def _find_excitation_faults(self, window: Excite) -> list[BrokenLimit]:
        most = self.max_excitation_current
        found = [
            BrokenLimit(
                f"Excitation coil '{name}' current must lie within ±{most:g} A; got {current:.2f} A.",
                most,
                current,
                "A",
                f"excitation {name}",
            )
            for name, current in zip("xy", window.currents, strict=True)
            if not abs(current) <= most + ROUNDING
        ]
        if window.duration > self.max_excitation + ROUNDING:
            said = f"Excite must last at most {self.max_excitation * 1e3:g} ms; got {window.duration * 1e3:.1f} ms."
            found.append(BrokenLimit(said, self.max_excitation, window.duration, "s"))
        return found

    def _find_mechanical_faults(
        self, window: Rotate | MoveMagnet, previous_axis: tuple[float, float, float] | None, *, near: bool
    ) -> list[BrokenLimit]:
        """List the limits that a move of the magnet breaks; `previous_axis` is the axis of the preceding rotation."""
        if self.max_rotation_frequency <= 0:
            return [BrokenLimit("This rig has no rotating magnet; Rotate and MoveMagnet cannot be played.")]
        if isinstance(window, MoveMagnet):
            return []
        found = []
        if not near:
            found.append(BrokenLimit("Rotate needs the actuation magnet near; it is away."))
        fastest = self.max_rotation_frequency
        if not 0 < window.frequency <= fastest + ROUNDING:
            said = f"Rotate must stay within {fastest:g} Hz; got {window.frequency:g} Hz."
            found.append(BrokenLimit(said, fastest, window.frequency, "Hz"))
        length = math.sqrt(sum(a * a for a in window.axis))
        if not length > 0 or abs(window.axis[2]) > AXIS_TOLERANCE * length:
            found.append(BrokenLimit(f"The stage's axis lies in the horizontal plane; got {window.axis}."))
        elif previous_axis is not None:
            along = abs(sum(a * b for a, b in zip(window.axis, previous_axis, strict=True)))
            change = math.acos(min(along / length / math.sqrt(sum(a * a for a in previous_axis)), 1.0))
            most = self.max_steering_rate * window.duration
            if change > most + AXIS_TOLERANCE:
                said = (
                    f"The stage steers at most {math.degrees(most):.1f}° within {window.duration:g} s; "
                    f"got {math.degrees(change):.1f}°."
                )
                found.append(BrokenLimit(said, most, change, "rad"))
        return found
