"""Preview of a helical robot's mission: turns and pauses, feasible bends, torque margin, go or no-go."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from smolbot.config.expected_errors import ExpectedErrors, compute_horizontal_rms
from smolbot.config.feasibility import compute_states_along
from smolbot.config.mission import Mission
from smolbot.config.plugins import load_plugin
from smolbot.core.arrays import FloatArray
from smolbot.core.pose import Pose
from smolbot.core.results import Readable
from smolbot.core.rotations import quaternion_from_axes
from smolbot.core.shots import Rotate, Shot, is_magnet_near_after
from smolbot.errors import report_plugin_errors
from smolbot.flight.pilots import check_command
from smolbot.motion.controller import BendForecast, Controller, HelixSetup
from smolbot.paths.curve import Curve

BEND_SPAN = 4e-3
"""Length, in m, over which a path's bend is measured: a robot of 7 mm rounds off sharper corners."""

N_ERROR_POINTS = 9
"""Points of the path at which the error of a pose is computed."""

MAX_PATH_DISTANCE = 1.5e-3
"""Distance from the path, in m, beyond which a simulated mission counts as not feasible."""

PAUSE_COVARIANCE = np.diag([1e-4] * 3 + [math.radians(1.0)] * 3) ** 2
"""Covariance of a pose after a pause, in m and rad."""


@dataclass(frozen=True, repr=False)
class HelixPreview(Readable):
    """Prediction for a helical robot's mission before it is flown. SI units.

    Attributes
    ----------
    maneuver, listening : Shot
        A typical mechanical shot, and the shot that listens.
    turns : tuple of float
        Of the magnet, before each pause.
    length : float, in m
        Of the path.
    duration : float, in s
        Expected; nan if the end is not reached.
    trail : ndarray, shape (n, 3), in m
        Where the robot is expected to be in the pauses.
    min_radius, tightest_radius : float, in m
        Of the tightest bend that the robot can make (None if its controller does not compute it), and of the
        tightest bend of the path.
    torque_margin : ndarray, shape (n,)
        Least torque of the field over the torque that the gel requires, along the path; below 1 the robot steps out.
    localization_error : ndarray, shape (n,), in m
        Horizontal rms error of one pose along the path, with sensors and device as uncertain as half the flight leaves
        them.
    noise_error : ndarray, shape (n,), in m
        The same by noise alone.
    reasons : list of str
        Why not to fly; empty means go.
    """

    maneuver: Shot
    listening: Shot
    turns: tuple[float, ...]
    length: float
    duration: float
    trail: FloatArray
    min_radius: float | None
    tightest_radius: float
    torque_margin: FloatArray
    localization_error: FloatArray
    noise_error: FloatArray
    reasons: list[str] = field(default_factory=list)

    @property
    def go(self) -> bool:
        """True if there is no reason not to fly."""
        return not self.reasons


def preview_helix(mission: Mission) -> HelixPreview:
    """Time a helical robot's mission and simulate it once on the controller's own model, without noise.

    Parameters
    ----------
    mission : Mission
        With a helical robot.

    Returns
    -------
    HelixPreview
    """
    setup = mission.helix_setup()
    make = load_plugin("controllers", mission.law)
    with report_plugin_errors("Controller", make, ""):
        controller = make(setup, mission.gains)
    frequency = setup.limits.max_rotation_frequency
    arc = np.linspace(0.0, mission.path.length, 25)
    margin = np.array([setup.helix.torque_margin(p, frequency) for p in mission.path.at(arc)])
    radius = controller.tightest_bend() if isinstance(controller, BendForecast) else None
    bend = compute_tightest_bend(mission.path)
    shots, clock, trail, reasons = _simulate_flight(mission, setup, controller)
    worst = int(np.argmin(margin))
    if margin[worst] < 1.0:
        reasons.append(
            f"the field would lose the robot near {_format_mm(mission.path.at(arc[worst]))}: "
            f"its torque is {margin[worst]:.2f} of what the gel requires at {frequency:g} Hz."
        )
    if radius is not None and bend < radius:
        reasons.insert(
            0,
            f"the path bends with a radius of {bend * 1e3:.1f} mm; "
            f"this robot turns with {radius * 1e3:.1f} mm at least.",
        )
    states = compute_states_along(mission, mission.path, np.linspace(0.0, mission.path.length, N_ERROR_POINTS))
    expected = ExpectedErrors.expect(mission, *states)
    turns = [sum(w.turns for w in shot.windows if isinstance(w, Rotate)) for shot in shots]
    listening = Shot(setup.cycle.windows(setup.device.frequency))
    return HelixPreview(
        maneuver=shots[len(shots) // 2] if shots else listening,
        listening=listening,
        turns=tuple(turns),
        length=mission.path.length,
        duration=float("nan") if reasons else clock,
        trail=trail,
        min_radius=radius,
        tightest_radius=bend,
        torque_margin=margin,
        localization_error=compute_horizontal_rms(expected.compute_covariances(0.5 * len(shots))),
        noise_error=compute_horizontal_rms(expected.noise),
        reasons=reasons,
    )


def compute_tightest_bend(path: Curve) -> float:
    """Compute the radius of the tightest bend of a path, measured over the length `BEND_SPAN`.

    Parameters
    ----------
    path : Curve

    Returns
    -------
    float, in m
        Infinite for a straight path.
    """
    span = min(BEND_SPAN, 0.5 * path.length)
    arc = np.arange(0.0, path.length - span, 0.25e-3)
    first, last = path.tangent(arc), path.tangent(arc + span)
    turned = np.arccos(np.clip(np.sum(first * last, axis=1), -1.0, 1.0))
    most = float(np.max(turned, initial=0.0))
    return span / most if most > 0 else math.inf


def _simulate_flight(
    mission: Mission, setup: HelixSetup, controller: Controller
) -> tuple[list[Shot], float, FloatArray, list[str]]:
    """Simulate the mission; return mechanical shots, time in s, positions in pauses, and why it fails."""
    x, y, heading = mission.start_placement
    position = np.array([x, y, setup.helix.high])
    orientation = quaternion_from_axes(
        np.array([math.cos(heading), math.sin(heading), 0.0]), np.array([0, 0, 1.0]), "zx"
    )
    rest = setup.cycle.duration(setup.device.frequency) + mission.rig.turnaround
    clock = mission.sections.localization.background_noise_duration + 2.0 * rest
    begun, limit = clock, mission.sections.stop.max_duration_s
    with report_plugin_errors("Controller", controller, "reset"):
        controller.reset(mission.path, Pose(clock, position, orientation, PAUSE_COVARIANCE))
    shots: list[Shot] = []
    trail, way = [position], [position]
    while True:
        with report_plugin_errors("Controller", controller, "command"):
            command = check_command(
                controller.command(Pose(clock, position, orientation, PAUSE_COVARIANCE)), controller
            )
        if command.done:
            fault = mission.find_skip_fault(mission.find_visits(np.array(way)))
            reasons = [] if fault is None else [f"{mission.law} would leave out a part: {fault}."]
            return shots, clock, np.array(trail), reasons
        if command.stuck:
            return shots, clock, np.array(trail), [command.note]
        if command.mechanical:
            shot = Shot(command.mechanical)
            broken = setup.limits.faults(shot)
            if broken:
                return shots, clock, np.array(trail), [" ".join(broken)]
            assert not is_magnet_near_after(shot, near=False)
            way += [
                setup.helix.carry(shot.windows[: i + 1], position, orientation)[0] for i in range(len(shot.windows))
            ]
            position, orientation, _, _ = setup.helix.carry(shot.windows, position, orientation)
            clock += shot.duration
            shots.append(shot)
            trail.append(position)
            off = float(mission.path.project(position[None, :])[1][0])
            if command.phase == "follow" and off > MAX_PATH_DISTANCE:
                return shots, clock, np.array(trail), [f"the robot would leave the path near {_format_mm(position)}."]
        clock += rest
        if clock - begun > limit:
            done = f"{command.progress * 1e3:.1f} of {mission.path.length * 1e3:.1f} mm"
            reason = f"it would not end within max_duration_s = {limit:g} s: {done} would be done."
            return shots, clock, np.array(trail), [reason]


def _format_mm(position: FloatArray) -> str:
    return f"({position[0] * 1e3:.1f}, {position[1] * 1e3:.1f}) mm"
