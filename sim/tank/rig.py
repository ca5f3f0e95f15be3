"""The simulated rig: implements `smolbot.core.rig.Rig` with a tank behind it."""

from __future__ import annotations

import math
from typing import Any

from sim.tank.history import TankWitness
from sim.tank.magnetics.tank_coils import TabulatedExcitation
from sim.tank.settings import TankSettings
from sim.tank.tank import HoldCoil, Tank
from smolbot.config.rig import RigConfig
from smolbot.config.robot import RobotConfig
from smolbot.core.arrays import FloatArray, as_floats
from smolbot.core.closeable import Closeable
from smolbot.core.coil_probe import BASELINE_DURATION, DECAY_DURATION, HOLD_DURATION, Probe, make_probe_shot
from smolbot.core.rig import Witness
from smolbot.core.sensing import Recording
from smolbot.core.shots import Excite, Listen, MoveMagnet, Rest, Shot, is_magnet_near_after
from smolbot.errors import RigError

WINDOW_FAULTS = ("windows_lost", "read_timeout")

MIN_REST = 1e-3
"""Rest after a probe, in s, where the rig file has no turnaround."""


class TankRig(Closeable):
    """A rig whose world is simulated. What it reports of itself is nominal; only the witness knows the truth.

    Parameters
    ----------
    rig : RigConfig
    robot : RobotConfig
    settings : TankSettings
    start : ndarray, shape (2,), in m
        Requested start position (x, y), world frame.
    seed : int
    gui : bool
        Show Bullet's window.
    ideal : bool
        Sample no mismatch.

    Attributes
    ----------
    sensors : SensorArray
        At their nominal positions.
    limits : Limits
    witness : Witness or None
        Reports true poses; may be set to None, which changes nothing else.

    Examples
    --------
    >>> from smolbot.config.rig import load_rig
    >>> from smolbot.config.robot import load_robot
    >>> from smolbot.core.shots import RingDown, Shot
    >>> from sim.tank.world import TankWorld
    >>> with TankWorld.open(load_rig("tank"), load_robot("gradient"), (0.0, 0.0), seed=1) as rig:
    ...     recording = rig.play(Shot((Excite((2.0, 2.0), 103.5, 5), RingDown(0.02), Listen(2, 103.5))))
    >>> print(recording.field.shape, bool(recording.saturated.any()))
    (10, 483) False
    """

    def __init__(
        self,
        rig: RigConfig,
        robot: RobotConfig,
        settings: TankSettings,
        start: FloatArray,
        seed: int,
        *,
        gui: bool = False,
        ideal: bool = False,
    ) -> None:
        self.sensors = rig.sensors
        self.limits = rig.limits
        self._tank = Tank(rig, robot, settings, start, seed, gui=gui, ideal=ideal)
        self.witness: Witness | None = TankWitness(self._tank.history)
        self._excitation = TabulatedExcitation(rig)
        self._driven = rig.driven
        self._rate, self._gains = rig.sample_rate, rig.sensor_gains[:, None]
        self._turnaround = rig.turnaround
        self._seed, self._ideal = seed, ideal or settings.mismatch.scale == 0.0
        self._last_drive: tuple[Excite, float] | None = None
        self._magnet_near = False
        self._open, self._stopped = True, False

    def now(self) -> float:
        """Return the time on the tank's virtual clock.

        Returns
        -------
        float, in s
        """
        return self._tank.time

    def play(self, shot: Shot) -> Recording | None:
        """Play the windows of one shot in order and return the recording.

        The turnaround follows: the tank runs on with every command at zero while the loop computes.

        Parameters
        ----------
        shot : Shot

        Returns
        -------
        Recording or None
            None if the shot has no `Listen`.

        Raises
        ------
        InterlockError
            Before anything moves, if the shot breaks a limit.
        RigError
            If the rig is closed, was stopped during the shot, or the robot left the container.
        """
        if not self._open:
            raise RigError("This tank is closed; nothing was played.")
        self.limits.check(shot, magnet_near=self._magnet_near)
        tank, begin = self._tank, self._tank.time
        if tank.faults is not None:
            tank.faults.begin_shot(shot, begin)
        windows = (*shot.windows, Rest(self._turnaround)) if self._turnaround > 0 else shot.windows
        for window in shot.windows:
            if isinstance(window, MoveMagnet):  # an interrupted move leaves the magnet near
                self._magnet_near = True
        self._stopped, recording = False, None
        played = tank.advance(windows)
        if played:
            self._magnet_near = is_magnet_near_after(shot, near=self._magnet_near)
            recording = self._make_recording(shot, begin)
        if self._stopped or not played:  # during motion, or while samples were computed
            raise RigError(f"Stopped at {tank.time:.3f} s, during a shot; every output is at zero.")
        return recording

    def probe(self, coil: str, current: float) -> Probe:
        """Hold one coil at a small current and record the sensors meanwhile.

        Parameters
        ----------
        coil : str
            Name of the coil: ``+x``, ``excitation x``.
        current : float, in A

        Returns
        -------
        Probe

        Raises
        ------
        InterlockError
            Before anything is driven, if the current breaks a limit.
        RigError
            If the tank is closed, or was stopped meanwhile.
        """
        if not self._open:
            raise RigError("This tank is closed; nothing was driven.")
        self.limits.check(make_probe_shot(self.limits, coil, current), magnet_near=self._magnet_near)
        tank, begin = self._tank, self._tank.time
        self._stopped = False
        step = HoldCoil(HOLD_DURATION, self._driven.index(coil), current)
        played = tank.advance(
            (Rest(BASELINE_DURATION), step, Rest(DECAY_DURATION), Rest(max(self._turnaround, MIN_REST)))
        )
        if self._stopped or not played:
            raise RigError(
                f"Stopped at {tank.time:.3f} s, while {coil} was probed; every output is at zero.", channel=coil
            )
        field, saturated = tank.measure(begin, round((BASELINE_DURATION + HOLD_DURATION + DECAY_DURATION) * self._rate))
        recording = Recording(field / self._gains, self._rate, math.inf, saturated, None, begin)
        return Probe(recording, BASELINE_DURATION, BASELINE_DURATION + HOLD_DURATION)

    def excitation_field(self, position: FloatArray) -> FloatArray:
        """Return the nominal field of the excitation coils at a point.

        Parameters
        ----------
        position : ndarray, shape (3,), in m
            World frame.

        Returns
        -------
        ndarray, shape (n_exc, 3), in T per A
            World frame.
        """
        return self._excitation.compute_field(as_floats(position, (3,), "excitation_field position"))

    def stop(self) -> None:
        """Bring every output to zero now and end a shot under way. Safe from any thread, any number of times."""
        self._stopped, self._tank.running = True, False
        self._tank.zero_commands()

    def close(self) -> None:
        """Stop, then release what carries the robot; harmless when repeated."""
        self.stop()
        self._open = False
        self._tank.carrier.close()

    def provenance(self) -> dict[str, Any]:
        """Return how this tank was sampled: seed, whether ideal, and every mismatch.

        Returns
        -------
        dict
            Plain lists and numbers.
        """
        return {"seed": self._seed, "ideal": self._ideal, **self._tank.list_mismatches()}

    def _loses_window(self, time: float) -> bool:
        """Return whether a fault loses the listening window that begins at `time` s."""
        faults = self._tank.faults
        return faults is not None and any(
            fault.name in WINDOW_FAULTS and faults.is_active(i, time) for i, fault in enumerate(faults.faults)
        )

    def _make_recording(self, shot: Shot, begin: float) -> Recording | None:
        recording: Recording | None = None
        for at, window in shot.timed():
            start = begin + at
            if isinstance(window, Excite):
                self._last_drive = (window, start + window.duration)
            elif isinstance(window, Listen):
                drive = shot.excite
                since = start - self._last_drive[1] if drive is not None and self._last_drive else math.inf
                n = round(window.duration * self._rate)
                if self._loses_window(start):
                    return None
                field, saturated = self._tank.measure(start, n)
                recording = Recording(field / self._gains, self._rate, since, saturated, drive, start)
        return recording
