"""Check before anything moves that mission, rig and robot fit each other."""

from __future__ import annotations

import math

import numpy as np

from smolbot.config.document import Fault
from smolbot.config.drive_feasibility import find_drive_faults
from smolbot.config.mission_base import MissionBase
from smolbot.config.rig import RigConfig
from smolbot.config.sensor_feasibility import find_range_faults, find_sensor_faults
from smolbot.core.arrays import FloatArray
from smolbot.core.drive import compute_drive
from smolbot.core.pose import Pose
from smolbot.core.rotations import matrix_from_quaternion, quaternion_from_axes
from smolbot.core.sensing import Device
from smolbot.core.shots import Shot
from smolbot.errors import ConfigError
from smolbot.localization.bounds import ListeningWindow, Response
from smolbot.localization.expected_covariance import compute_expected_covariance
from smolbot.localization.noise.room import NoiseLevels
from smolbot.motion.robot import compute_magnet_inertia
from smolbot.paths.curve import Curve

Point = tuple[float, float]

UP = np.array([0.0, 0.0, 1.0])
"""Unit vector against gravity, world frame."""

N_PATH_POINTS = 5
"""Of a path, at which a tolerance is held against the error to be expected, and sensors against their range."""

MIN_AMPLITUDE = 1e-3
"""Least amplitude, in rad, for which an error is computed: a device that no coil drives swings by none."""

N_MAINS_DIRECTIONS = 3
"""Drawn directions of the mains that an expected error is averaged over."""


def find_fitness_faults(mission: MissionBase, path: Curve, start: Point, tolerance: float) -> list[Fault]:
    """Find every reason why a mission cannot be flown.

    Parameters
    ----------
    mission : MissionBase
    path : Curve
        In the world frame.
    start : tuple of float, in m
        Start position (x, y) of the robot, in the world frame.
    tolerance : float, in m
        Distance at which a goal counts as reached.

    Returns
    -------
    list of Fault
        Empty if there is none.
    """
    arc = np.linspace(0.0, path.length, N_PATH_POINTS)
    points, headings = path.at(arc), _compute_orientations(mission, path, arc)
    faults = [
        *_find_container_faults(mission, path, start),
        *(_find_table_faults(mission, path, start) if mission.robot.kind == "gradient" else ()),
        *_find_limit_faults(mission),
        *(find_sensor_faults(mission) or find_range_faults(mission, points, headings)),
        *find_drive_faults(mission, points, headings),
    ]
    # the bound of a window longer than the rig may listen could take minutes
    return faults or _find_tolerance_faults(mission, path, tolerance)


def find_listening_faults(mission: MissionBase) -> list[Fault]:
    """Find every reason why the rig cannot record this device with the mission's cycle.

    Parameters
    ----------
    mission : MissionBase

    Returns
    -------
    list of Fault
        Empty if there is none.
    """
    return [*_find_limit_faults(mission), *find_sensor_faults(mission)]


def _find_container_faults(mission: MissionBase, path: Curve, start: Point) -> list[Fault]:
    box = mission.rig.sections.container
    margin = 0.5e3 * math.hypot(*sorted(mission.robot.size)[1:])  # it may lie at any angle
    low = np.array(box.center_mm) - 0.5 * np.array(box.size_mm) + margin
    high = np.array(box.center_mm) + 0.5 * np.array(box.size_mm) - margin
    if np.any(low > high):
        width, depth = box.size_mm
        message = (
            f"the container of {width:g} x {depth:g} mm is too small for this robot, which needs {2 * margin:.1f} mm."
        )
        return [Fault(("rig",), message)]
    room = f"the robot's centre can go from ({low[0]:.1f}, {low[1]:.1f}) to ({high[0]:.1f}, {high[1]:.1f}) mm"
    faults = []
    for key, points in (("path", path.points[:, :2] * 1e3), ("start", 1e3 * np.array([start]))):
        outside = np.flatnonzero(np.any((points < low - 1e-9) | (points > high + 1e-9), axis=1))
        if outside.size:
            x, y = points[outside[0]]
            faults.append(Fault((key,), f"({x:.1f}, {y:.1f}) mm lies outside the tank; {room}."))
    return faults


def _find_table_faults(mission: MissionBase, path: Curve, start: Point) -> list[Fault]:
    try:
        table = mission.rig.table()
    except ConfigError as error:
        return [Fault(("rig",), line) for line in str(error).splitlines()]
    if table.n_coils != len(mission.rig.coil_names):
        message = f"the table holds {table.n_coils} coils, rig '{mission.rig.name}' has {len(mission.rig.coil_names)}."
        return [Fault(("rig",), message)]
    faults = []
    put_down = np.array([[*start, mission.rig.surface_z]])
    for key, points in (("path", path.points), ("start", put_down)):
        outside = np.flatnonzero(~table.contains(points))
        if outside.size:
            x, y, z = points[outside[0]] * 1e3
            low, high = (1e3 * np.array(bound) for bound in table.bounds)
            message = (
                f"({x:.1f}, {y:.1f}, {z:.1f}) mm lies outside the field table, "
                f"which covers x {low[0]:g} to {high[0]:g}, y {low[1]:g} to {high[1]:g}, "
                f"z {low[2]:g} to {high[2]:g} mm."
            )
            faults.append(Fault((key,), message))
    return faults


def _find_limit_faults(mission: MissionBase) -> list[Fault]:
    shot = Shot(mission.cycle.windows(mission.robot.device.frequency))
    return [Fault(("cycle",), message) for message in mission.rig.limits.faults(shot)]


def _find_tolerance_faults(mission: MissionBase, path: Curve, tolerance: float) -> list[Fault]:
    expected = float(np.max(compute_expected_errors(mission, path, np.linspace(0.0, path.length, N_PATH_POINTS))))
    if tolerance >= expected:
        return []
    message = (
        f"{tolerance * 1e3:g} mm lies under the localization error to be expected on this path, "
        f"{expected * 1e3:.2f} mm in the plane; raise it, or listen longer ([cycle] half_periods)."
    )
    return [Fault(("controller", "tolerance_mm"), message)]


def make_noise_levels(rig: RigConfig) -> NoiseLevels:
    """Build the noise levels that the rig file expects.

    Parameters
    ----------
    rig : RigConfig

    Returns
    -------
    NoiseLevels
        In SI units.
    """
    section = rig.sections.noise
    return NoiseLevels(
        floor=section.floor,
        at_1hz=section.at_1hz,
        mains_frequency=section.mains_hz,
        mains=section.mains,
        mains_gradient=section.mains_gradient,
        harmonics={int(order): size for order, size in section.harmonics.items()},
    )


def compute_expected_errors(mission: MissionBase, path: Curve, arc: FloatArray) -> FloatArray:
    """Compute the expected horizontal rms error of one pose at points of a path.

    The robot heads along the path.

    Parameters
    ----------
    mission : MissionBase
    path : Curve
    arc : ndarray, shape (n,), in m
        Arc lengths.

    Returns
    -------
    ndarray, shape (n,), in m
    """
    covariances = compute_covariances_along(mission, path, arc)
    errors: FloatArray = np.sqrt(covariances[:, 0, 0] + covariances[:, 1, 1])
    return errors


def compute_covariances_along(mission: MissionBase, path: Curve, arc: FloatArray) -> FloatArray:
    """Compute the expected covariance of one pose at points of a path, by noise alone.

    The robot heads along the path.

    Parameters
    ----------
    mission : MissionBase
    path : Curve
    arc : ndarray, shape (n,), in m
        Arc lengths.

    Returns
    -------
    ndarray, shape (n, 6, 6), in m and rad
        Position, then rotation, in the world frame.
    """
    return compute_expected_covariances(mission, *compute_states_along(mission, path, arc))


def compute_states_along(
    mission: MissionBase, path: Curve, arc: FloatArray
) -> tuple[FloatArray, list[FloatArray], FloatArray]:
    """Compute where a robot is along a path, how it lies, and how far its device swings there.

    Parameters
    ----------
    mission : MissionBase
    path : Curve
    arc : ndarray, shape (n,), in m
        Arc lengths.

    Returns
    -------
    points : ndarray, shape (n, 3), in m, world frame
    orientations : list of ndarray, shape (4,)
        Unit quaternions, body to world.
    amplitudes : ndarray, shape (n,), in rad
        At the end of the excitation, by the coils' nominal field.
    """
    device, cycle, points = mission.robot.device, mission.cycle, path.at(arc)
    orientations = _compute_orientations(mission, path, arc)
    fields = np.stack([coil.field(points) for coil in mission.rig.flat_coils()], axis=1)
    inertia = compute_magnet_inertia(device.moment, device.l0)
    poses = [Pose(0.0, at, q, np.eye(6)) for at, q in zip(points, orientations, strict=True)]
    drives = [
        compute_drive(field, pose, device, inertia, cycle.excite_cycles, cycle.excite_current)
        for field, pose in zip(fields, poses, strict=True)
    ]
    return points, orientations, np.array([max(drive.amplitude, MIN_AMPLITUDE) for drive in drives])


def _compute_orientations(mission: MissionBase, path: Curve, arc: FloatArray) -> list[FloatArray]:
    """Compute the orientations of a robot that heads along the path, as unit quaternions."""
    if mission.robot.kind == "gradient":
        return [compute_swimming_orientation(mission.robot.device, ahead) for ahead in path.tangent(arc)]
    return [quaternion_from_axes(ahead, UP, "zy") for ahead in path.tangent(arc)]


def compute_swimming_orientation(device: Device, ahead: FloatArray) -> FloatArray:
    """Compute the orientation of a floating robot whose moment points ahead, with the axis of its swing upright.

    Parameters
    ----------
    device : Device
    ahead : ndarray, shape (3,)
        Unit vector in the horizontal plane.

    Returns
    -------
    ndarray, shape (4,)
        Unit quaternion, scalar first, from body to world.
    """
    across, _, along = device.moment_in_body
    return quaternion_from_axes(along * ahead - across * np.cross(UP, ahead), UP, "zy")


def make_listening_window(mission: MissionBase) -> ListeningWindow:
    """Make the listening window of a mission's cycle.

    Parameters
    ----------
    mission : MissionBase

    Returns
    -------
    ListeningWindow
    """
    return ListeningWindow(mission.cycle.half_periods, mission.rig.sample_rate, mission.cycle.ring_down)


def compute_expected_covariances(
    mission: MissionBase, points: FloatArray, orientations: list[FloatArray], amplitudes: FloatArray | None = None
) -> FloatArray:
    """Compute the covariance that the estimator of a mission reaches at each pose, by noise alone.

    Of the mission's own estimator: ``whitened`` reaches the bound, averaged here over rooms whose mains it has learned;
    a lab's own is not known to, and can do no better.

    Parameters
    ----------
    mission : MissionBase
    points : ndarray, shape (n, 3), in m
        In the world frame.
    orientations : list of ndarray, shape (4,)
        Unit quaternions, one for each point.
    amplitudes : ndarray, shape (n,), in rad, optional
        Of the swing at the end of the excitation; up to the device's stops unless given.

    Returns
    -------
    ndarray, shape (n, 6, 6), in m and rad
    """
    find = (
        _compute_paper_covariances if mission.base.localization.estimator == "paper" else _compute_whitened_covariances
    )
    if amplitudes is None:
        amplitudes = np.full(len(points), mission.robot.device.theta_max)
    return find(mission, points, orientations, amplitudes)


def _compute_whitened_covariances(
    mission: MissionBase, points: FloatArray, headings: list[FloatArray], amplitudes: FloatArray
) -> FloatArray:
    """Compute covariances (n, 6, 6) of the whitened estimator."""
    rig, device = mission.rig, mission.robot.device
    window = make_listening_window(mission)
    rotations = np.array([matrix_from_quaternion(q) for q in headings])
    learned = mission.base.localization.quiet_s > 0.0
    rooms = (
        [make_noise_levels(rig).sample_room_model(rig.sensors, seed) for seed in range(N_MAINS_DIRECTIONS)]
        if learned
        else []
    )
    found = np.zeros((len(points), 6, 6))
    models = rooms or [make_noise_levels(rig).make_model(rig.sensors)]
    for noise in models:
        response = Response(rig.sensors, device, noise, window)
        for amplitude in np.unique(amplitudes):
            here = amplitudes == amplitude
            bound = response.with_amplitude(float(amplitude)).compute_bound(points[here], rotations[here])
            found[here] += bound.covariance[:, :6, :6] / len(models)
    return found


def _compute_paper_covariances(
    mission: MissionBase, points: FloatArray, headings: list[FloatArray], amplitudes: FloatArray
) -> FloatArray:
    """Compute covariances (n, 6, 6) of the paper's estimator."""
    rig, cycle = mission.rig, mission.cycle
    found = [
        compute_expected_covariance(
            rig.sensors,
            mission.robot.device,
            make_noise_levels(rig),
            Pose(0.0, point, heading, np.eye(6)),
            cycle.half_periods,
            rig.sample_rate,
            cycle.ring_down,
            float(amplitude),
        )
        for point, heading, amplitude in zip(points, headings, amplitudes, strict=True)
    ]
    return np.array(found)
