"""The tank behind the twin: commanded sample by sample, and read in blocks."""

from __future__ import annotations

import numpy as np

from sim.tank.carriers.gel.embedded import Embedded
from sim.tank.magnetics.cantilever import DEFLECTION, RATE
from sim.tank.settings import TankSettings
from sim.tank.tank import SUBSTEP, Tank
from sim.twin.magnet_field_history import MagnetFieldHistory
from smolbot.config.rig import RigConfig
from smolbot.config.robot import RobotConfig
from smolbot.core.arrays import FloatArray, as_floats
from smolbot.errors import InputError

HISTORY_DURATION = 4.0
"""Time, in s, for which currents, deflection and poses are kept: the longest recording, and a slow reader."""

RATE_TOLERANCE = 1e-9
"""Relative difference of the sample rate from the tank's clock that is rounding."""


class TwinPlant(Tank):
    """A tank whose coils get a command for every sample of the card's clock.

    Not to be shared between threads. One substep of the tank is one sample.

    Parameters
    ----------
    rig, robot, settings, start, seed, ideal
        As `sim.tank.tank.Tank` takes them.

    Attributes
    ----------
    rate : float, in Hz
    loads : tuple of str
        Driven coils: actuation coils in the rig file's order, then excitation coils as ``excitation x``.
    played : int
        Samples since the beginning.

    Raises
    ------
    InputError
        If the rig's sample rate is not the tank's own, or if its file injects faults into a tank.
    """

    def __init__(
        self, rig: RigConfig, robot: RobotConfig, settings: TankSettings, start: FloatArray, seed: int,
        *, ideal: bool = False,
    ) -> None:  # fmt: skip
        if settings.faults:
            raise InputError("tank.faults are those of a simulated tank; the twin takes its own: smolbot twin --fault.")
        super().__init__(rig, robot, settings, start, seed, ideal=ideal)
        self.rate = self.sensors.rate
        if abs(self.rate * SUBSTEP - 1.0) > RATE_TOLERANCE:
            raise InputError(f"The twin samples at {1 / SUBSTEP:g} Hz; got sensors.sample_rate_hz = {self.rate:g}.")
        self.loads = rig.driven
        self.played = 0
        self._embedded = self.carrier if isinstance(self.carrier, Embedded) else None
        self._target: tuple[float, float, bool] | None = None
        self._near = False
        self._magnet_field = MagnetFieldHistory(self.sensors.axes, HISTORY_DURATION)
        self._constants = self.sensors.sample_constants()
        self._volts_per_tesla = rig.sections.sensors.volts_per_tesla
        self._keep = round(HISTORY_DURATION * self.rate)
        size = 2 * self._keep
        times, trace = np.zeros(size), np.zeros((size, self._trace.shape[1]))
        times[: self._used], trace[: self._used] = self._trace_times[: self._used], self._trace[: self._used]
        self._trace_times, self._trace = times, trace
        self._longest = max(round(self._step * self.rate), 1)
        self.running = True

    def advance(self, currents: FloatArray) -> None:  # type: ignore[override]
        """Advance by as many samples as `currents` has columns.

        Parameters
        ----------
        currents : ndarray, shape (n_loads, n), in A

        Raises
        ------
        InputError
            For another shape, for values that are not finite, or for more samples than are stored.
        RigError
            If the robot has left the container.
        """
        commands = np.ascontiguousarray(as_floats(currents, (len(self.loads), None), "currents").T)
        count = len(commands)
        if not count:
            return
        self._wrap_arrays(count)
        turned = self._embedded
        if turned is not None and self._target is not None:
            turn, steering, near = self._target
            turned.set_measured_magnet(turn, steering, near, count / self.rate)
            if near != self._near:
                self._near = near
                self._magnet_field.append(self.time, turned.compute_magnet_field(self.sensors.positions))
        at = 0
        while at < count:
            steps = (count - at) // self._longest
            n, length = (steps, self._longest) if steps else (1, count - at)
            place = self._play_steps(n, length, commands[at : at + n * length])
            self._copy_to_first_half(n * length)
            at += n * length
            self.played += n * length
            self.time = self.played / self.rate  # no accumulated rounding
        if turned is not None:
            self._magnet_field.append(self.time, turned.compute_magnet_field(self.sensors.positions))
        self._check_inside(place)

    def _play_steps(self, n: int, length: int, commands: FloatArray) -> FloatArray:
        """Play `n` steps of `length` samples; return the robot's final position."""
        self.history.drop_last()  # the first row repeats the last row of the steps before
        times, poses = self.history.append_rows(n + 1)
        self._run(n, length / self.rate, times, poses, commands)
        if self._near:
            self._state[DEFLECTION : RATE + 1] = 0.0  # the magnet's field stops the oscillation
        self._record_pose(times[n:], poses[n:])
        return poses[n, :3]

    def set_magnet(self, turn: float, steering: float, near: bool | None) -> None:
        """Set the magnet stage's present angles; the next `advance` moves the magnet there.

        Parameters
        ----------
        turn : float, in rad
            About the motor's axis.
        steering : float, in rad
            Heading of that axis.
        near : bool or None
            None while it is being moved.
        """
        self._target = (turn, steering, bool(near))

    def begin_acquisition(self) -> None:
        """Begin a new recording, with new residual offsets of the channels."""
        self._constants = self.sensors.sample_constants()

    def read_volts(self, first: int, n: int) -> FloatArray:
        """Return converter readings of samples that were played.

        Parts of one acquisition must be read in order.

        Parameters
        ----------
        first : int
            Index of the first sample.
        n : int

        Returns
        -------
        ndarray, shape (n_sensors, n), in V

        Raises
        ------
        InputError
            For samples that were not played yet, or are no longer stored.
        """
        clock, sensors = first / self.rate, self.sensors
        oldest = max(self.played - round((HISTORY_DURATION - 2 * sensors.lead) * self.rate), 0)
        if not oldest <= first <= first + n <= self.played:
            raise InputError(f"The plant keeps samples {oldest} to {self.played}; got {first} to {first + n}.")
        since = clock - 2 * sensors.lead
        begin = max(int(np.searchsorted(self._trace_times[: self._used], since)) - 1, 0)
        end = min(int(np.searchsorted(self._trace_times[: self._used], clock + n / self.rate)) + 2, self._used)
        pose_times, poses = self.history.find_rows_since(since)
        field = sensors.compute_clean_readings(
            clock, n, self.device, self.coils.coupling, self._trace_times[begin:end], self._trace[begin:end],
            pose_times, poses,
        )  # fmt: skip
        if self._embedded is not None:
            self._magnet_field.add_to_readings(field, clock, self.rate)
        sensors.measure(field, clock, self._constants)
        return np.asarray(field * self._volts_per_tesla)

    def _copy_to_first_half(self, count: int) -> None:
        """Copy the last `count` rows into the first half as well, so that no large copy is needed later."""
        first = max(self._used - count, self._keep)
        if first < self._used:
            to = slice(first - self._keep, self._used - self._keep)
            self._trace_times[to] = self._trace_times[first : self._used]
            self._trace[to] = self._trace[first : self._used]

    def _wrap_arrays(self, count: int) -> None:
        """At the end of the arrays continue in their first half, which holds the same rows."""
        if count > self._keep:
            raise InputError(f"The plant advances by at most {self._keep} samples at once; got {count}.")
        if self._used + count > len(self._trace_times):
            self._used -= self._keep
            self.history.forget_before(self.time - HISTORY_DURATION)
