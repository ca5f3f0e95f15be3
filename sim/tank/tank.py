"""The simulated tank: a robot, its liquid, its coils and its sensors on one virtual clock."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from sim.tank.carriers.carrier import Carrier, Immersed, MagnetDriven, Magnetised, Sampled
from sim.tank.carriers.selection import make_carrier
from sim.tank.faults import FaultSchedule
from sim.tank.history import History
from sim.tank.magnetics.cantilever import DEFLECTION, DRIVE, MIDDLE, RATE, STATE_LENGTH, TIME, advance_cantilever
from sim.tank.magnetics.coil_fields import COMMAND, CURRENT, SINE
from sim.tank.magnetics.device_packing import pack_true_device
from sim.tank.magnetics.tank_coils import TankCoils, find_magnet_volume
from sim.tank.magnetics.true_sensors import TrueSensors
from sim.tank.mismatch import RandomStreams, TankTruth, sample_truth
from sim.tank.plant_faults import PlantFaults
from sim.tank.sensor_faults import SensorFaults
from sim.tank.settings import TankSettings
from sim.tank.tank_faults import parse_tank_faults
from smolbot.config.rig import RigConfig
from smolbot.config.robot import RobotConfig
from smolbot.core.arrays import BoolArray, FloatArray
from smolbot.core.rotations import matrix_from_quaternion
from smolbot.core.shots import Actuate, Excite, MoveMagnet, Rest, Rotate, Window
from smolbot.errors import InputError, RigError

STEPS_PER_STOP_CHECK = 500  # steps of a mechanical window between two checks whether to stop
SUBSTEP = 2e-5  # s: period of the sample clock; the cantilever's period is 500 times longer
ROUNDING = 1e-9  # share of a step below which a remainder is rounding, not one more step
NO_SAMPLES = np.zeros((0, 1))
FAULT_STREAM = 6
"""Random stream of a seed for spikes; the tank's mismatches and noise use 0 to 4, the twin's operator 5."""


@dataclass(frozen=True)
class HoldCoil(Rest):
    """Hold one coil at a constant current.

    Attributes
    ----------
    duration : float, in s
    coil : int
        Index of the coil; actuation coils come first, then excitation coils.
    current : float, in A
    """

    coil: int = 0
    current: float = 0.0


class Tank:
    """Plays windows: advances the robot in steps of at most 1 ms, the cantilever in steps of the sample clock.

    Parameters
    ----------
    rig, robot : RigConfig, RobotConfig
        Nominal values; the true values are sampled around them.
    settings : TankSettings
    start : ndarray, shape (2,), in m
        Requested start position (x, y), world frame.
    seed : int
    gui : bool
        Show Bullet's window.
    ideal : bool
        Sample no mismatch.
    """

    def __init__(
        self, rig: RigConfig, robot: RobotConfig, settings: TankSettings, start: FloatArray, seed: int,
        *, gui: bool = False, ideal: bool = False,
    ) -> None:  # fmt: skip
        streams = RandomStreams.from_seed(seed)
        self.truth: TankTruth = sample_truth(settings, len(rig.driven), len(rig.sensors), streams, ideal=ideal)
        self.sensors = TrueSensors(rig, self.truth, streams.field_noise, streams.sensor_noise, streams.constants)
        self.coils = TankCoils.build(rig, settings, self.truth, self.sensors.positions, self.sensors.axes)
        self.device = pack_true_device(robot, settings, self.truth)
        self.carrier: Carrier = make_carrier(rig, robot, settings, self.truth, start, seed, gui=gui, ideal=ideal)
        self._magnetised = self.carrier if isinstance(self.carrier, Magnetised) else None
        self.history = History()
        self.time = 0.0
        self.running = False
        self.faults: FaultSchedule | None = None
        if settings.faults:
            self.faults = FaultSchedule(parse_tank_faults(settings.faults))
            self.sensors.faults = SensorFaults(
                self.faults, rig, self.sensors.axes, np.random.default_rng([seed, FAULT_STREAM])
            )
            self._plant_faults = PlantFaults(self.faults, rig, robot, settings, self.truth)
            if self._plant_faults.changes_liquid and not isinstance(self.carrier, Immersed):
                raise InputError(
                    f"--fault: robot '{robot.name}' of kind '{robot.kind}' swims in no liquid that could change."
                )
        self._step = settings.physics_step
        self._low, self._high = find_magnet_volume(rig)
        self._state = np.zeros(STATE_LENGTH)
        self._trace_times = np.zeros(1)
        self._trace = np.zeros((1, 1 + len(self.coils.circuits)))
        self._trace[0, 1:] = self.coils.circuits[:, CURRENT]
        self._used = 1
        self._record_pose(*self.history.append_rows(1))

    def advance(self, windows: tuple[Window, ...]) -> bool:
        """Play windows one after the other, then set every command to zero.

        Parameters
        ----------
        windows : tuple of Window

        Returns
        -------
        bool
            False if `running` was set to False before the end.

        Raises
        ------
        RigError
            If the robot left the container.
        """
        lengths = [(w, *self._divide_window(w)) for w in windows]
        steps = sum(n for _, n, _ in lengths)
        self.history.drop_last()  # the first row of this shot repeats the last row of the one before
        times, poses = self.history.append_rows(steps + 1)
        self._begin_trace(sum(1 if _is_mechanical(w) else n * _count_substeps(h) for w, n, h in lengths))
        done, self.running = 0, True
        try:
            for window, n, step in lengths:
                self._apply_command(window)
                run = self._run_mechanical if isinstance(window, Rotate | MoveMagnet) else self._run
                done += run(n, step, times[done:], poses[done:])
                if isinstance(self.carrier, MagnetDriven) and _is_mechanical(window):
                    self.carrier.end_window(window)
                if not self.running:
                    break
        finally:
            self.running = False
            self.zero_commands()
            self._record_pose(times[done : done + 1], poses[done : done + 1])
            self.history.drop_last(steps - done)
        self._check_inside(poses[done, :3])
        return done == steps

    def measure(self, clock: float, n: int) -> tuple[FloatArray, BoolArray]:
        """Sample the sensors during the windows just played.

        Parameters
        ----------
        clock : float, in s
            Time of the first sample.
        n : int
            Number of samples.

        Returns
        -------
        field : ndarray, shape (n_sensors, n), in T
            Along the sensors' axes.
        saturated : ndarray of bool, shape (n_sensors,)
        """
        pose_times, poses = self.history.find_rows_since(clock - self.sensors.lead)
        end, sensors = self._used, self.sensors
        field = sensors.compute_clean_readings(
            clock, n, self.device, self.coils.coupling, self._trace_times[:end], self._trace[:end], pose_times, poses
        )
        if self._magnetised is not None:
            field += self._magnetised.compute_sensor_field(
                clock, n, sensors.rate, sensors.time_constant, sensors.positions, sensors.axes
            )
        return field, sensors.measure(field, clock)

    def list_mismatches(self) -> dict[str, Any]:
        """Return every sampled mismatch of this tank, as plain lists and numbers.

        Returns
        -------
        dict
        """
        own = {"carrier": self.carrier.as_dict()} if isinstance(self.carrier, Sampled) else {}
        faults = {} if self.faults is None else {"faults": [fault.text for fault in self.faults.faults]}
        return {"truth": self.truth.as_dict(), **own, **faults}

    def zero_commands(self) -> None:
        """Set the command of every driven coil to zero; its current decays."""
        driven = self.coils.n_actuation + self.coils.n_excitation
        self.coils.circuits[:driven, COMMAND : SINE + 1] = 0.0

    def _run(self, n: int, step: float, times: FloatArray, poses: FloatArray, commands: FloatArray = NO_SAMPLES) -> int:
        """Advance by `n` steps, with the window's command or with one row of `commands` (in A) per substep."""
        substeps = _count_substeps(step)
        device, earth, state = self.device, self.coils.earth, self._state
        rows, table, circuits = self.coils.fields.rows, self.coils.fields.coefficients, self.coils.circuits
        read, move = self.carrier.read_state, self.carrier.advance
        used, start = self._used, self.time
        trace = self._trace
        near = None if self._magnetised is None else self._magnetised.field_at_magnet
        steady = earth
        played = 0
        for i in range(n):
            if not self.running:
                break
            body = read()
            if near is not None:
                earth = steady + matrix_from_quaternion(np.array(body[1])) @ near
            magnetic = advance_cantilever(
                body[0], body[1], device, earth, rows, table, circuits, state, poses, i, trace, used, step, substeps,
                commands, i * substeps,
            )  # fmt: skip
            move(body, magnetic, start + i * step, step)
            used += substeps
            played += 1
        times[:played] = start + step * np.arange(played)
        count = played * substeps
        self._trace_times[self._used : used] = start + step / substeps * np.arange(1, count + 1)
        self._used = used
        self.time = start + played * step
        return played

    def _run_mechanical(self, n: int, step: float, times: FloatArray, poses: FloatArray) -> int:
        """Play a mechanical window: the magnet's field stops the oscillation, and no samples are recorded."""
        carrier, start, played = self.carrier, self.time, 0
        assert isinstance(carrier, MagnetDriven)  # other rigs refuse such windows by their limits
        while self.running and played < n:
            stride = min(STEPS_PER_STOP_CHECK, n - played)
            carrier.advance_mechanical(step, poses[played : played + stride])
            played += stride
        times[:played] = start + step * np.arange(played)
        self.time = start + played * step
        self._state[DEFLECTION : RATE + 1] = 0.0
        self._trace_times[self._used], self._trace[self._used] = self.time, 0.0
        self._trace[self._used, 1:] = self.coils.circuits[:, CURRENT]
        self._used += 1
        return played

    def _divide_window(self, window: Window) -> tuple[int, float]:
        if isinstance(self.carrier, MagnetDriven) and _is_mechanical(window):
            return _divide_duration(self.carrier.sample_duration(window), self.carrier.longest_step)
        return _divide_duration(window.duration, self._step)

    def _apply_command(self, window: Window) -> None:
        self.zero_commands()
        self.carrier.begin_window(window, self.time)
        self._state[TIME : DRIVE + 1] = 0.0
        actuation = self.coils.n_actuation
        if isinstance(window, HoldCoil):
            self.coils.circuits[window.coil, COMMAND] = window.current
        elif isinstance(window, Actuate):
            self.coils.circuits[:actuation, COMMAND] = window.currents
        elif isinstance(window, Excite):
            n = self.coils.n_excitation
            self.coils.circuits[actuation : actuation + n, SINE] = window.currents[:n]
            self._state[DRIVE] = 2 * math.pi * window.frequency
        if self.faults is not None:
            self._apply_plant_faults()

    def _apply_plant_faults(self) -> None:
        """Change currents, liquid and device as the faults that are present now demand."""
        faults = self._plant_faults
        factors = faults.compute_current_factors(self.time)
        self.coils.circuits[: len(factors), COMMAND : SINE + 1] *= factors[:, None]
        self.device = faults.pack_device(self.time)
        if faults.changes_liquid and isinstance(self.carrier, Immersed):
            self.carrier.scale_drag(*faults.compute_drag_factors(self.time))
            self.carrier.add_flow(*faults.compute_flow(self.time))

    def _begin_trace(self, rows: int) -> None:
        """Keep the history that the sensors' low pass still needs, and reserve `rows` more rows."""
        end = self._used
        first = max(int(np.searchsorted(self._trace_times[:end], self.time - self.sensors.lead)) - 1, 0)
        kept = end - first
        times, trace = self._trace_times[first:end].copy(), self._trace[first:end].copy()
        if kept + rows > len(self._trace_times):
            self._trace_times = np.zeros(kept + rows)
            self._trace = np.zeros((kept + rows, self._trace.shape[1]))
        self._trace_times[:kept], self._trace[:kept] = times, trace
        self._used = kept

    def _check_inside(self, place: FloatArray) -> None:
        if not (np.all(place > self._low) and np.all(place < self._high)):
            raise RigError(f"The robot left the container, to {np.round(1e3 * place, 2)} mm, at {self.time:.3f} s.")

    def _record_pose(self, time: FloatArray, pose: FloatArray) -> None:
        position, quaternion, _, _ = self.carrier.read_state()
        turn = matrix_from_quaternion(np.array(quaternion))
        time[0] = self.time
        pose[0, :3] = position - turn @ self.device[MIDDLE : MIDDLE + 3]
        pose[0, 3:] = quaternion


def _is_mechanical(window: Window) -> bool:
    return isinstance(window, Rotate | MoveMagnet)


def _divide_duration(duration: float, longest: float) -> tuple[int, float]:
    """Return number and length of equal steps that exactly fill `duration`, none longer than `longest`."""
    n = max(math.ceil(duration / longest - ROUNDING), 1)
    return n, duration / n


def _count_substeps(step: float) -> int:
    return max(math.ceil(step / SUBSTEP - ROUNDING), 1)
