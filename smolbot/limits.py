"""Limits of a rig, and the one check that every rig applies to a shot before it plays any of it."""

from __future__ import annotations

from dataclasses import dataclass

from smolbot.errors import InterlockError
from smolbot.shots import Actuate, Excite, Listen, MoveMagnet, Rotate, Shot


@dataclass(frozen=True)
class Limits:
    """What a rig may be asked to do. SI units.

    Attributes
    ----------
    coils : tuple of str
        Names of the actuation coils, in the order of every current vector; empty without such coils.
    max_current : float, in A
        Per actuation coil.
    unipolar : bool
        True where a coil's supply cannot reverse.
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

    def faults(self, shot: Shot) -> list[str]:
        """Every limit that the shot breaks, a sentence each; empty if it may be played."""
        found: list[str] = []
        quiet_since = float("inf")
        for at, window in shot.timed():
            if isinstance(window, Actuate):
                found += self._actuation_faults(window)
                quiet_since = 0.0
            elif isinstance(window, Excite):
                found += self._excitation_faults(window)
                quiet_since = 0.0
            elif isinstance(window, Listen):
                if quiet_since < self.min_ring_down - 1e-9:
                    found.append(
                        f"Listening at {at * 1e3:.1f} ms follows a drive after {quiet_since * 1e3:.1f} ms; "
                        f"the coils need {self.min_ring_down * 1e3:.1f} ms of ring-down."
                    )
                if window.duration > self.max_listen + 1e-9:
                    found.append(f"Listen window must last at most {self.max_listen:g} s; got {window.duration:.3f} s.")
            elif isinstance(window, Rotate | MoveMagnet):
                found += self._mechanical_faults(window)
            if not isinstance(window, Actuate | Excite):
                quiet_since += window.duration
        return found

    def check(self, shot: Shot) -> None:
        """Raise `InterlockError`, naming every broken limit, unless the shot may be played."""
        found = self.faults(shot)
        if found:
            raise InterlockError(" ".join([*found, "Nothing was played."]))

    def _actuation_faults(self, window: Actuate) -> list[str]:
        if len(window.currents) != len(self.coils):
            coils = f"{len(self.coils)} coils ({', '.join(self.coils)})"
            return [f"Actuate has {len(window.currents)} currents; this rig has {coils}."]
        low = 0.0 if self.unipolar else -self.max_current
        found = [
            f"Coil '{name}' current must lie within {low:g} to {self.max_current:g} A; got {current:.2f} A."
            for name, current in zip(self.coils, window.currents, strict=True)
            if not low - 1e-9 <= current <= self.max_current + 1e-9
        ]
        if window.duration > self.max_actuation + 1e-9:
            found.append(
                f"Actuate must last at most {self.max_actuation * 1e3:g} ms; got {window.duration * 1e3:.1f} ms."
            )
        return found

    def _excitation_faults(self, window: Excite) -> list[str]:
        found = [
            f"Excitation coil '{name}' current must lie within ±{self.max_excitation_current:g} A; got {current:.2f} A."
            for name, current in zip("xy", window.currents, strict=True)
            if not abs(current) <= self.max_excitation_current + 1e-9
        ]
        if window.duration > self.max_excitation + 1e-9:
            found.append(
                f"Excite must last at most {self.max_excitation * 1e3:g} ms; got {window.duration * 1e3:.1f} ms."
            )
        return found

    def _mechanical_faults(self, window: Rotate | MoveMagnet) -> list[str]:
        if self.max_rotation_frequency <= 0:
            return ["This rig has no rotating magnet; Rotate and MoveMagnet cannot be played."]
        if isinstance(window, Rotate) and not 0 < window.frequency <= self.max_rotation_frequency:
            return [f"Rotate must stay within {self.max_rotation_frequency:g} Hz; got {window.frequency:g} Hz."]
        return []
