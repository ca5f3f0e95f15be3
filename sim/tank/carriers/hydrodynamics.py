"""Forces of the liquid on the floating robot: weight, buoyancy, surface tension, and implicit Stokes drag."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from sim.tank.carriers.bullet import compute_box_inertia
from sim.tank.mismatch import TankTruth
from sim.tank.settings import TankSettings
from smolbot.config.rig import RigConfig
from smolbot.config.robot import RobotConfig
from smolbot.core.arrays import FloatArray

GRAVITY = 9.81  # m/s²
Triple = tuple[float, float, float]
# Entries of `Hull.values`; inertia and the two drags have one for each body axis
MASS, INERTIA, DRAG, TURN_DRAG, WEIGHT, BUOYANCY = 0, 1, 4, 7, 10, 11
HEIGHT, SURFACE, MENISCUS, RIGHTING_X, RIGHTING_Z = range(12, 17)
FLOW_X, FLOW_Y, SWIRL = range(17, 20)


@dataclass(frozen=True, eq=False)
class Hull:
    """The floating housing, in SI.

    Attributes
    ----------
    values : ndarray, shape (20,)
        Mass, inertia (3), drag along (3) and about (3) the body axes, weight, buoyancy of the complete box, height
        of the box, height of the surface, stiffness of the meniscus (N/m), righting stiffness about body x and z
        (N·m/rad); velocity of the liquid at the world's origin along x and y (m/s), and its rate of rotation about
        z (rad/s).
    float_height : float, in m
        Height of the housing's middle, world frame, where it floats (or rests on the floor, if too heavy).
    """

    values: FloatArray
    float_height: float

    @classmethod
    def build(cls, rig: RigConfig, robot: RobotConfig, settings: TankSettings, truth: TankTruth) -> Hull:
        """Build the true hull of a robot in a rig's liquid.

        Drag is that of a sphere, ``6 pi mu r`` and ``8 pi mu r³``, times a sampled factor for each axis. A floating
        body rights itself by ``rho g (I_waterplane + V (z_B - z_G))``; around its waterline the pinned meniscus
        adds a spring of ``sqrt(sigma rho g)`` for each metre of line.

        Parameters
        ----------
        rig : RigConfig
        robot : RobotConfig
        settings : TankSettings
        truth : TankTruth

        Returns
        -------
        Hull
        """
        x, y, z = robot.size
        density = rig.sections.medium.density_kg_m3 * truth.density
        viscosity, radius = rig.sections.medium.viscosity_pa_s, robot.drag_radius
        pull = density * GRAVITY
        draft = min(robot.mass / (density * x * z), y)
        lever = 0.5 * draft - 0.5 * y  # of the centre of buoyancy above the housing's middle
        line = settings.surface.meniscus_n_per_m2
        # righting stiffness (N·m/rad): waterplane and lever of the buoyancy, and the line of the meniscus
        about_x = pull * (x * z**3 / 12 + x * z * draft * lever) + line * (x * z**2 / 2 + z**3 / 6)
        about_z = pull * (z * x**3 / 12 + x * z * draft * lever) + line * (z * x**2 / 2 + x**3 / 6)
        values = [
            robot.mass,
            *compute_box_inertia(robot),
            *(6 * np.pi * viscosity * radius * truth.drag),
            *(8 * np.pi * viscosity * radius**3 * truth.rotation_drag),
            robot.mass * GRAVITY,
            pull * x * y * z,
            y,
            rig.surface_z,
            line * 2 * (x + z),
            about_x,
            about_z,
            *compute_flow(rig, settings, truth),
        ]
        if draft < y:
            return cls(np.array(values), rig.surface_z - draft + 0.5 * y)
        return cls(np.array(values), rig.container.floor_z + 0.5 * y)


def compute_flow(rig: RigConfig, settings: TankSettings, truth: TankTruth) -> FloatArray:
    """Compute how the liquid flows: a uniform current, and a rotation of the whole liquid about the container's middle.

        u(r) = (1 - s) u_0 + omega e_z x (r - c),   |omega| = s |u_0| / (half of the container's smaller side)

    with the share s of `TankSettings.flow` that rotates: nowhere inside that circle does it flow faster than
    ``|u_0|``, the rig file's ``flow_mm_s``.

    Parameters
    ----------
    rig : RigConfig
    settings : TankSettings
    truth : TankTruth
        With the sampled direction, and the sense of the rotation.

    Returns
    -------
    ndarray, shape (3,)
        Velocity at the world's origin along x and y (m/s), and omega (rad/s).
    """
    speed, (x, y) = rig.sections.medium.flow, rig.container.center
    rotating = settings.flow.rotating_percent / 100.0 * speed
    omega = truth.flow_sense * rotating / (0.5 * float(np.min(rig.container.size)))
    direction = truth.flow_direction if settings.flow.direction is None else settings.flow.direction
    uniform = speed - rotating
    return np.array([uniform * np.cos(direction) + omega * y, uniform * np.sin(direction) - omega * x, omega])


@njit(cache=True, error_model="numpy")
def compute_float_step(
    position: Triple,
    quaternion: tuple[float, float, float, float],
    velocity: Triple,
    spin: Triple,
    magnetic: tuple[float, float, float, float, float, float],
    hull: FloatArray,
    float_height: float,
    step: float,
) -> tuple[Triple, Triple]:
    """Compute velocity and spin after one step, with drag taken at its end (implicit Euler).

        v' = (v + F dt / m) / (1 + gamma dt / m)   along each body axis, and likewise for the spin

    The terminal velocity ``F / gamma`` is exact at any step, even one much longer than the decay of momentum. In a
    liquid that flows, drag acts on the velocity relative to it.

    Parameters
    ----------
    position : tuple of 3, in m
        Middle of the housing, world frame.
    quaternion : tuple of 4
        Orientation, scalar first.
    velocity : tuple of 3, in m/s
        World frame.
    spin : tuple of 3, in rad/s
        World frame.
    magnetic : tuple of 6
        Force (N) and torque (N·m), body frame, as `sim.tank.magnetics.cantilever.advance_cantilever` returns them.
    hull : ndarray, shape (20,)
        `Hull.values`.
    float_height : float, in m
        `Hull.float_height`.
    step : float, in s

    Returns
    -------
    velocity : tuple of 3, in m/s
        World frame.
    spin : tuple of 3, in rad/s
        World frame.
    """
    w, x, y, z = quaternion
    xx, xy, xz = 1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)
    yx, yy, yz = 2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)
    zx, zy, zz = 2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)
    height = hull[HEIGHT]
    wet = min(max((hull[SURFACE] - position[2]) / height + 0.5, 0.0), 1.0)
    lift = hull[BUOYANCY] * wet - hull[WEIGHT]
    tip_x = tip_z = 0.0
    if 0.0 < wet < 1.0:
        lift -= hull[MENISCUS] * (position[2] - float_height)
        tip_x, tip_z = hull[RIGHTING_X] * zz, -hull[RIGHTING_Z] * zx  # turns body y toward the world's up
    force_x, force_y, force_z = magnetic[0] + lift * zx, magnetic[1] + lift * zy, magnetic[2] + lift * zz
    # the liquid pulls along: its velocity and rotation, in the body frame, times the drag
    flow_x, flow_y, swirl = (
        hull[FLOW_X] - hull[SWIRL] * position[1],
        hull[FLOW_Y] + hull[SWIRL] * position[0],
        hull[SWIRL],
    )
    force_x += hull[DRAG] * (flow_x * xx + flow_y * yx)
    force_y += hull[DRAG + 1] * (flow_x * xy + flow_y * yy)
    force_z += hull[DRAG + 2] * (flow_x * xz + flow_y * yz)
    turn_x = magnetic[3] + tip_x + hull[TURN_DRAG] * swirl * zx
    turn_y = magnetic[4] + hull[TURN_DRAG + 1] * swirl * zy
    turn_z = magnetic[5] + tip_z + hull[TURN_DRAG + 2] * swirl * zz
    # velocities in the body frame, with implicit drag: v_new = (v + step F / m) / (1 + step drag / m)
    mass = step / hull[MASS]
    u = (velocity[0] * xx + velocity[1] * yx + velocity[2] * zx + mass * force_x) / (1 + mass * hull[DRAG])
    v = (velocity[0] * xy + velocity[1] * yy + velocity[2] * zy + mass * force_y) / (1 + mass * hull[DRAG + 1])
    t = (velocity[0] * xz + velocity[1] * yz + velocity[2] * zz + mass * force_z) / (1 + mass * hull[DRAG + 2])
    ix, iy, iz = step / hull[INERTIA], step / hull[INERTIA + 1], step / hull[INERTIA + 2]
    p = (spin[0] * xx + spin[1] * yx + spin[2] * zx + ix * turn_x) / (1 + ix * hull[TURN_DRAG])
    q = (spin[0] * xy + spin[1] * yy + spin[2] * zy + iy * turn_y) / (1 + iy * hull[TURN_DRAG + 1])
    r = (spin[0] * xz + spin[1] * yz + spin[2] * zz + iz * turn_z) / (1 + iz * hull[TURN_DRAG + 2])
    return (
        (xx * u + xy * v + xz * t, yx * u + yy * v + yz * t, zx * u + zy * v + zz * t),
        (xx * p + xy * q + xz * r, yx * p + yy * q + yz * r, zx * p + zy * q + zz * r),
    )
