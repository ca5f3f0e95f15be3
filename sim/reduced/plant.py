"""The sampled tank, reduced: the same samples from the same seed, moved by one compiled overdamped kernel."""

from __future__ import annotations

import math

import numpy as np

from sim.reduced.kernel import DRIVEN_STEP, STATE_LENGTH, advance_motion, write_pose
from sim.tank.carriers.floating import compute_start_pose
from sim.tank.carriers.hydrodynamics import Hull
from sim.tank.history import History
from sim.tank.magnetics.coil_fields import COMMAND, TIME_CONSTANT, CoilSet
from sim.tank.magnetics.device_packing import pack_true_device
from sim.tank.magnetics.tank_coils import TankCoils, find_magnet_volume
from sim.tank.magnetics.true_sensors import TrueSensors
from sim.tank.mismatch import RandomStreams, TankTruth, sample_truth
from sim.tank.settings import TankSettings
from smolbot.config.rig import RigConfig
from smolbot.config.robot import RobotConfig
from smolbot.core.arrays import FloatArray
from smolbot.core.shots import Actuate, Excite, Window

PLANE_SPACING = 1e-3
"""Spacing of the plane's table, in m: its cubic splines are exact to a few nT/A between coils 84 mm apart."""


class ReducedPlant:
    """Plays windows for the robot's motion alone; takes the arguments of `sim.tank.tank.Tank`.

    Left out: inertia, effects of the excitation on the housing, oscillation of the cantilever when a field changes,
    friction and turning at walls. The residual oscillation after an excitation, which turns a pulled robot a
    little, is included.

    Parameters
    ----------
    rig, robot : RigConfig, RobotConfig
        Nominal values; the true values are sampled around them.
    settings : TankSettings
    start : ndarray, shape (2,), in m
        Requested start position (x, y), world frame.
    seed : int
    ideal : bool
        Sample no mismatch.

    Attributes
    ----------
    truth : Truth
    sensors : TrueSensors
        With true positions; nothing is recorded.
    device : ndarray
        As `sim.tank.magnetics.cantilever.advance_cantilever` takes it.
    history : History
    time : float, in s
    """

    def __init__(
        self, rig: RigConfig, robot: RobotConfig, settings: TankSettings, start: FloatArray, seed: int,
        *, ideal: bool = False,
    ) -> None:  # fmt: skip
        streams = RandomStreams.from_seed(seed)
        self.truth: TankTruth = sample_truth(settings, len(rig.driven), len(rig.sensors), streams, ideal=ideal)
        self.sensors = TrueSensors(rig, self.truth, streams.field_noise, streams.sensor_noise, streams.constants)
        hull = Hull.build(rig, robot, settings, self.truth)
        self.device = pack_true_device(robot, settings, self.truth)
        nobody = np.zeros((0, 3))  # no sensors: nothing is recorded
        coils = TankCoils.build(rig, settings, self.truth, nobody, nobody)
        self._hull, self._float_height = hull.values, hull.float_height
        self._n, self._n_excitation = coils.n_actuation, coils.n_excitation
        self._constants = coils.circuits[: self._n, TIME_CONSTANT].copy()
        self._lags = coils.circuits[self._n : self._n + self._n_excitation, TIME_CONSTANT].copy()
        self._grid, tables = _tabulate_plane(coils, rig, hull.float_height - robot.center[1])
        # the earth's field and its compensation coil are one constant source; excitation does not move the robot
        moving = [*range(self._n), tables.shape[2] - 1]
        self._table = np.ascontiguousarray(tables[:, :, moving])
        self._excitation = np.ascontiguousarray(tables[:, :, self._n : self._n + self._n_excitation])
        self._currents = np.zeros(self._n + 1)
        self._currents[self._n] = 1.0
        (left, front, _), (right, back, _) = rig.container.low, rig.container.high
        self._box = np.array([left, right, front, back, 0.5 * robot.size[2], 0.5 * robot.size[0]])
        position, orientation = compute_start_pose(rig, robot, self.truth, hull, start)
        self._state = np.zeros(STATE_LENGTH)
        self._state[:3], self._state[3:7] = position, orientation
        self.history = History()
        self.time = 0.0
        times, poses = self.history.append_rows(1)
        times[0], poses[0] = 0.0, self.compute_pose(self._state)

    def advance(self, windows: tuple[Window, ...]) -> FloatArray:
        """Play windows one after the other, and add the poses to the history.

        Parameters
        ----------
        windows : tuple of Window

        Returns
        -------
        ndarray, shape (n_windows, 10)
            State at the start of each, as laid out in `sim.reduced.kernel`.
        """
        lengths = np.array([w.duration for w in windows])
        commands, drives = np.zeros((len(windows), self._n)), np.zeros((len(windows), self._n_excitation))
        for row, window in enumerate(windows):
            if isinstance(window, Actuate):
                commands[row] = window.currents
            elif isinstance(window, Excite):
                drives[row] = window.currents[: self._n_excitation]
        states = np.empty((len(windows), STATE_LENGTH))
        self.history.drop_last()  # the last row is repeated as the first of the next
        room = sum(math.ceil(w.duration / DRIVEN_STEP) + 1 for w in windows) + 1
        times, poses = self.history.append_rows(room)
        rows = advance_motion(
            self._state, self._currents, commands, drives, lengths, self._constants, self._lags,
            self._grid, self._table, self._excitation, self.device, self._hull, self._float_height, self._box,
            self.time, times, poses, states,
        )  # fmt: skip
        self.time = float(times[rows - 1])
        self.history.drop_last(room - rows)
        return states

    def zero_currents(self) -> None:
        """Set every current to zero, at once."""
        self._currents[: self._n] = 0.0

    def compute_pose(self, state: FloatArray) -> FloatArray:
        """Compute the pose of a state.

        Parameters
        ----------
        state : ndarray, shape (10,)
            As laid out in `sim.reduced.kernel`.

        Returns
        -------
        ndarray, shape (7,)
            Rotation centre (m) and orientation (scalar first), world frame.
        """
        pose = np.empty(7)
        write_pose(state, self.device, pose)
        return pose


def _tabulate_plane(coils: TankCoils, rig: RigConfig, height: float) -> tuple[FloatArray, FloatArray]:
    """Return grid (4,) and spline coefficients (nx, ny, n_coils + 1, 3) of every true coil on a plane, in T per A.

    The last source, in T, is the earth's field with its compensation coil.
    """
    from scipy.ndimage import spline_filter1d

    from sim.tank.magnetics.cantilever import compute_fields

    low, high = find_magnet_volume(rig)
    x, y = (np.arange(low[k], high[k] + 2 * PLANE_SPACING, PLANE_SPACING) for k in (0, 1))
    points = np.stack(np.meshgrid(x, y, [height], indexing="ij"), axis=-1).reshape(-1, 3)
    fields: CoilSet = coils.fields
    values = compute_fields(points, fields.rows, fields.coefficients)
    driven = coils.n_actuation + coils.n_excitation
    still = np.tile(coils.earth, (len(points), 1))
    for c in range(driven, len(values)):
        still += coils.circuits[c, COMMAND] * values[c]
    sources = np.concatenate([values[:driven], still[None]]).transpose(1, 0, 2)
    table = sources.reshape(len(x), len(y), driven + 1, 3)
    for axis in (0, 1):
        table = spline_filter1d(table, order=3, axis=axis, mode="mirror")
    return np.array([x[0], y[0], 1.0 / PLANE_SPACING, height]), np.ascontiguousarray(table)
