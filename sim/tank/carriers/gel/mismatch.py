"""Sample the true parameters of gel, helix and magnet, and pack them for the kernels."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sim.tank.carriers.gel import gel_kernels
from sim.tank.mismatch import SampledValues
from sim.tank.settings import TankSettings
from smolbot.config.mismatch import MAX_SIGMAS, MismatchSampler
from smolbot.config.rig import RigConfig
from smolbot.config.robot import RobotConfig
from smolbot.core.arrays import FloatArray
from smolbot.core.rotations import matrix_from_quaternion, quaternion_from_rotation_vector

STREAM = 5
"""Random stream of a seed for the gel; the tank uses 0 to 4."""


@dataclass(frozen=True, eq=False)
class GelTruth(SampledValues):
    """Sampled mismatches of one gel. Those without a unit are factors on the nominal value.

    Attributes
    ----------
    strength, viscosity : float
        Of the gel.
    cutting : float
        On the strength against cutting at the nose.
    friction : float
        Of the plates.
    thread, across, tilt : float
        Further factors on the strength of the gel against slip along the thread, drift and tilt.
    pitch, remanence : float
    magnet_place : ndarray, shape (3,), in m
        Displacement of the magnet, world frame.
    magnet_tilt : ndarray, shape (3,), in rad
        Rotation vector.
    steering, home : float, in rad
        Offsets of the stage's heading and of the magnet's turn.
    start_heading : float, in rad
        Offset of the start heading from the requested one. Sampled at every scale, like roll and height.
    start_roll : float, in rad
    start_height : float
        Of the start position above the middle between the plates, as a fraction of the gap.
    """

    strength: float
    viscosity: float
    cutting: float
    friction: float
    thread: float
    across: float
    tilt: float
    pitch: float
    remanence: float
    magnet_place: FloatArray
    magnet_tilt: FloatArray
    steering: float
    home: float
    start_heading: float
    start_roll: float
    start_height: float


def make_gel_generators(seed: int) -> tuple[np.random.Generator, np.random.Generator]:
    """Make the random generators of the mismatches and of the operator, independent of all others of a tank.

    Parameters
    ----------
    seed : int

    Returns
    -------
    mismatches : numpy.random.Generator
    operator : numpy.random.Generator
    """
    drawn, hand = np.random.SeedSequence([seed, STREAM]).spawn(2)
    return np.random.Generator(np.random.SFC64(drawn)), np.random.Generator(np.random.SFC64(hand))


def sample_gel(settings: TankSettings, rng: np.random.Generator, *, ideal: bool = False) -> GelTruth:
    """Sample gel, helix and magnet.

    The order of the samples is fixed, and the scale only multiplies them.

    Parameters
    ----------
    settings : TankSettings
    rng : numpy.random.Generator
    ideal : bool
        Use the scale 0.

    Returns
    -------
    GelTruth
    """
    section = settings.gel.mismatch
    spreads = MismatchSampler(rng, 0.0 if ideal else settings.mismatch.scale)
    spread, factor = spreads.sample_offsets, spreads.sample_factor
    return GelTruth(
        strength=factor(section.strength),
        viscosity=factor(section.viscosity),
        cutting=factor(section.cutting),
        friction=factor(section.friction),
        thread=factor(section.anisotropy),
        across=factor(section.anisotropy),
        tilt=factor(section.anisotropy),
        pitch=factor(section.pitch),
        remanence=factor(section.remanence),
        magnet_place=spread(section.magnet_place, 3),
        magnet_tilt=spread(section.magnet_axis, 3),
        steering=float(spread(section.steering, 1)[0]),
        home=float(spread(section.home, 1)[0]),
        start_heading=float(settings.gel.start_heading * np.clip(rng.standard_normal(), -MAX_SIGMAS, MAX_SIGMAS)),
        start_roll=float(rng.uniform(-np.pi, np.pi)),
        start_height=float(rng.uniform(-0.5, 0.5)),
    )


def pack_gel(rig: RigConfig, robot: RobotConfig, settings: TankSettings, truth: GelTruth) -> FloatArray:
    """Pack the `gel` array of the kernels, from the yield stress and the helix's size.

    A cylinder of radius r and length L in a gel of yield stress tau resists turning about its axis with its skin
    and ends, ``tau (2 pi r² L + 4/3 pi r³)``. Across the axis the gel supports ``N tau`` on the projected area ``2
    r L`` (N about 10, the bearing factor of a cylinder in a perfectly plastic body), with the lever ``L / 4``
    against tilting. The flights of the thread rest on unbroken gel, which holds several times the skin's friction;
    the core's nose cuts against ``N' tau``. At the rate ``tau / (2 mu)`` the viscous part equals the yield stress:
    the skin shears at twice the spin.

    Parameters
    ----------
    rig : RigConfig
    robot : RobotConfig
    settings : TankSettings
    truth : GelTruth

    Returns
    -------
    ndarray
        As laid out in `sim.tank.carriers.gel.gel_kernels`.
    """
    section, medium, helix = settings.gel, rig.sections.medium, robot.helix
    radius, length = 0.5 * robot.size[0], robot.size[2]
    tau = medium.yield_stress_pa * truth.strength
    box = rig.container
    gel = np.empty(gel_kernels.GEL_LENGTH)
    gel[gel_kernels.THREAD] = section.thread_hold * truth.thread * tau * 2 * math.pi * radius * length
    gel[gel_kernels.ACROSS] = section.bearing * truth.across * tau * 2 * radius * length
    gel[gel_kernels.SPIN] = tau * (2 * math.pi * radius**2 * length + 4 / 3 * math.pi * radius**3)
    gel[gel_kernels.TILT] = section.bearing * truth.tilt * tau * 2 * radius * length * length / 4
    gel[gel_kernels.RATE] = tau / (2 * medium.viscosity_pa_s * truth.viscosity)
    gel[gel_kernels.CUT] = section.nose_bearing * truth.cutting * tau * math.pi * (0.5 * helix.core_diameter) ** 2
    gel[gel_kernels.BACK] = section.way_back
    gel[gel_kernels.LEAD] = helix.pitch * truth.pitch / (2 * math.pi)
    gel[gel_kernels.RADIUS], gel[gel_kernels.REACH] = radius, 0.5 * length
    gel[gel_kernels.LOW] = box.floor_z + radius
    gel[gel_kernels.HIGH] = box.surface_z - radius
    gel[gel_kernels.PLATE] = section.plate_stiffness_n_per_m
    gel[gel_kernels.FRICTION] = section.plate_friction * truth.friction
    return gel


def pack_cube(rig: RigConfig, truth: GelTruth) -> FloatArray:
    """Pack the `cube` array of the kernels.

    Parameters
    ----------
    rig : RigConfig
    truth : GelTruth

    Returns
    -------
    ndarray
        As laid out in `sim.tank.carriers.gel.gel_kernels`.
    """
    magnet = rig.magnet
    off = quaternion_from_rotation_vector(np.array([0.0, 0.0, truth.steering]))
    turned = matrix_from_quaternion(quaternion_from_rotation_vector(truth.magnet_tilt)) @ matrix_from_quaternion(off)
    center = magnet.center + truth.magnet_place
    return np.array([0.5 * magnet.side, magnet.remanence_t * truth.remanence, *center, *turned.ravel(), truth.home])


def pack_inclusions(settings: TankSettings) -> FloatArray:
    """Pack the `inclusions` array of the kernels.

    Parameters
    ----------
    settings : TankSettings

    Returns
    -------
    ndarray, shape (k, 4)
        Centre x, y (m), radius (m) and factor of each.
    """
    rows = [(*i.center, i.radius, i.factor) for i in settings.gel.inclusions]
    return np.array(rows).reshape(-1, 4)
