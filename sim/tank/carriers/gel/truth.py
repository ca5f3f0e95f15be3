"""Draws what gel, helix and magnet truly are, and packs it for the kernels."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sim.tank.carriers.gel import kernels
from sim.tank.mismatch import CLIP, DrawnValues, Spreads
from sim.tank.settings import TankSettings
from smolbot.config.rig import RigConfig
from smolbot.config.robot import RobotConfig
from smolbot.core.arrays import FloatArray
from smolbot.core.rotations import matrix_from_quaternion, quaternion_from_rotation_vector

STREAM = 5
"""Random stream of a seed for the gel; the tank uses 0 to 4."""


@dataclass(frozen=True, eq=False)
class GelTruth(DrawnValues):
    """What was drawn. Places in m, angles in rad, everything else a factor on the nominal value.

    Attributes
    ----------
    strength, viscosity, cutting, friction : float
        Of the gel as a whole, of its nose, of the plates.
    thread, across, tilt : float
        Further factors on the strength of the gel against slip along the thread, drift and tilt.
    pitch, remanence : float
    magnet_place, magnet_tilt : ndarray, shape (3,)
    steering, home : float
        By how much the stage's heading and the magnet's turn are off.
    start_heading, start_roll, start_height : float
        Put down by hand: heading off the wanted one, roll, and share of the gap below the middle. Drawn at every scale.
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


def gel_generators(seed: int) -> tuple[np.random.Generator, np.random.Generator]:
    """Streams of the mismatches and of the operator's hand, apart from all others of a tank."""
    drawn, hand = np.random.SeedSequence([seed, STREAM]).spawn(2)
    return np.random.Generator(np.random.SFC64(drawn)), np.random.Generator(np.random.SFC64(hand))


def draw_gel(settings: TankSettings, rng: np.random.Generator, *, ideal: bool = False) -> GelTruth:
    """Draw gel, helix and magnet; the order of draws is fixed, and the scale only multiplies them."""
    section = settings.gel.mismatch
    spreads = Spreads(rng, 0.0 if ideal else settings.mismatch.scale)
    spread, factor = spreads.spread, spreads.one
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
        start_heading=float(settings.gel.start_heading * np.clip(rng.standard_normal(), -CLIP, CLIP)),
        start_roll=float(rng.uniform(-np.pi, np.pi)),
        start_height=float(rng.uniform(-0.5, 0.5)),
    )


def pack_gel(rig: RigConfig, robot: RobotConfig, settings: TankSettings, truth: GelTruth) -> FloatArray:
    """The `gel` array of the kernels, from the yield stress and the helix' size.

    A cylinder of radius r and length L in a gel of yield stress tau turns about its axis against its skin and ends,
    ``tau (2 pi r² L + 4/3 pi r³)``; across it the gel bears ``N tau`` on the projected area ``2 r L`` (N about 10, the
    bearing of a cylinder in a perfectly plastic body), with the lever ``L / 4`` against tilting. The flights of the
    thread rest on unbroken gel and hold several times its skin's friction; the core's nose cuts against ``N' tau``.
    At the rate ``tau / (2 mu)`` the viscous part is as large as the yield stress: the skin shears at twice the spin.
    """
    section, medium, helix = settings.gel, rig.sections.medium, robot.helix
    radius, length = 0.5 * robot.size[0], robot.size[2]
    tau = medium.yield_stress_pa * truth.strength
    box = rig.container
    gel = np.empty(kernels.GEL_LENGTH)
    gel[kernels.THREAD] = section.thread_hold * truth.thread * tau * 2 * math.pi * radius * length
    gel[kernels.ACROSS] = section.bearing * truth.across * tau * 2 * radius * length
    gel[kernels.SPIN] = tau * (2 * math.pi * radius**2 * length + 4 / 3 * math.pi * radius**3)
    gel[kernels.TILT] = section.bearing * truth.tilt * tau * 2 * radius * length * length / 4
    gel[kernels.RATE] = tau / (2 * medium.viscosity_pa_s * truth.viscosity)
    gel[kernels.CUT] = section.nose_bearing * truth.cutting * tau * math.pi * (0.5 * helix.core_diameter) ** 2
    gel[kernels.BACK] = section.way_back
    gel[kernels.LEAD] = helix.pitch * truth.pitch / (2 * math.pi)
    gel[kernels.RADIUS], gel[kernels.REACH] = radius, 0.5 * length
    gel[kernels.LOW] = box.floor_z + radius
    gel[kernels.HIGH] = box.surface_z - radius
    gel[kernels.PLATE] = section.plate_stiffness_n_per_m
    gel[kernels.FRICTION] = section.plate_friction * truth.friction
    return gel


def pack_cube(rig: RigConfig, truth: GelTruth) -> FloatArray:
    """The `cube` array of the kernels."""
    magnet = rig.magnet
    off = quaternion_from_rotation_vector(np.array([0.0, 0.0, truth.steering]))
    turned = matrix_from_quaternion(quaternion_from_rotation_vector(truth.magnet_tilt)) @ matrix_from_quaternion(off)
    center = magnet.center + truth.magnet_place
    return np.array([0.5 * magnet.side, magnet.remanence_t * truth.remanence, *center, *turned.ravel(), truth.home])


def pack_inclusions(settings: TankSettings) -> FloatArray:
    """The `inclusions` array (k, 4) of the kernels."""
    rows = [(*i.center, i.radius, i.factor) for i in settings.gel.inclusions]
    return np.array(rows).reshape(-1, 4)
