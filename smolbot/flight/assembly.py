"""The parts of a flight, each built from the mission's files, and the loop that they form."""

from __future__ import annotations

from datetime import date

import numpy as np

from smolbot.config.load import AnyMission
from smolbot.config.mission import Mission
from smolbot.config.mission_base import MissionBase
from smolbot.config.observation import Observation
from smolbot.config.plugins import load_plugin
from smolbot.config.sensors import SensorsFile, UncertaintySection
from smolbot.core.arrays import FloatArray
from smolbot.core.coil_heat import CoilHeat
from smolbot.core.rig import Rig
from smolbot.errors import report_plugin_errors
from smolbot.flight.device_belief import DeviceBelief
from smolbot.flight.loop import Loop, StopRules
from smolbot.flight.pause import Pause
from smolbot.flight.pilots import Follower, Measurer, Pilot, Watcher
from smolbot.flight.preparation import PreparationSettings
from smolbot.flight.safety.duty_cycle import DutyCycle
from smolbot.flight.safety.heat_store import HeatMemory
from smolbot.flight.safety.sensor_monitor import NO_LIMIT, SensorMonitor
from smolbot.flight.safety.stop_latch import Latch
from smolbot.flight.safety.supervisor import Safety, SafetyRules
from smolbot.flight.scheduler import Scheduler
from smolbot.flight.tracking.channel_watch import ChannelWatch
from smolbot.flight.tracking.passive_trackers import SingleShotTracker, VelocityTracker
from smolbot.flight.tracking.pose_gate import PoseGate
from smolbot.flight.tracking.tracker import Tracker
from smolbot.localization.array.filter import ArrayFilter, ArrayPrior, compute_tilt_frames
from smolbot.localization.array.terms import DEVIATIONS_OF_DEVICE
from smolbot.localization.cold_start import SearchVolume
from smolbot.localization.estimator import PoseEstimator
from smolbot.localization.synthetic import SyntheticPoseRig
from smolbot.motion.controller import Controller
from smolbot.runs.run import Listener, RecorderSink

TYPICAL_TOLERANCES = np.array([5e-3, 5e-3, 5e-3, 2e-4, 2e-4, 2e-4])
"""Standard deviations of a sensor's gain (relative), two tilts (rad) and position (m) where no file states them: those
of a laser-cut plate and of a data sheet."""


def make_loop(
    rig: Rig,
    mission: AnyMission,
    listeners: tuple[Listener, ...] = (),
    latch: Latch | None = None,
    heat_memory: HeatMemory | None = None,
    tape: RecorderSink | None = None,
    pause: Pause | None = None,
    *,
    controller: Controller | None = None,
) -> Loop:
    """Make the loop of a mission on an open rig, with every part built from the mission's files.

    Parameters
    ----------
    rig : Rig
        As `open_rig` returns it.
    mission : Mission or Observation
    listeners : tuple of callable
        Called with the record of every cycle.
    latch : Latch, optional
        Tripping it stops the run, from any thread.
    heat_memory : HeatMemory, optional
        Coil temperatures at the end of earlier runs; without it, the coils start cold.
    tape : RecorderSink, optional
        Receives every shot and every event.
    pause : Pause, optional
        Holding it pauses the run, from any thread.
    controller : Controller, optional
        Controller to use instead of the one that the mission names.

    Returns
    -------
    Loop
        Run it with `Loop.fly`, or step it in a ``with`` block.
    """
    device, cycle = mission.robot.device, mission.cycle
    tracker, pilot = (
        _make_watching_parts(mission) if isinstance(mission, Observation) else _make_steering_parts(mission, controller)
    )
    scheduler = Scheduler(cycle, rig.limits, DeviceBelief(device), rig.excitation_field, rig.now)
    listening = mission.base.localization
    make_estimator = load_plugin("estimators", listening.estimator)
    with report_plugin_errors("Estimator", make_estimator, ""):
        localizer = make_estimator(rig.sensors, device, volume=make_search_volume(mission))
    preparation = PreparationSettings(
        listening.background_noise_duration, mission.rig.sample_rate, listening.learns_ring_down
    )
    stop = mission.base.stop
    rules = StopRules(stop.max_duration_s, stop.lost_shots, stop.lost_s)
    locator: PoseEstimator = rig.make_synthetic_localizer(localizer) if isinstance(rig, SyntheticPoseRig) else localizer
    return Loop(
        rig, scheduler, locator, tracker, pilot, rules, preparation, listeners,
        independent=isinstance(tracker, SingleShotTracker), externally_guided=isinstance(tracker, VelocityTracker),
        array_filter=None if isinstance(tracker, SingleShotTracker) else make_array_filter(mission, locator),
        channels=make_channel_watch(mission),
        safety=make_safety(rig, mission, latch, heat_memory), tape=tape, pause=pause,
    )  # fmt: skip


def make_safety(
    rig: Rig, mission: AnyMission, latch: Latch | None = None, heat_memory: HeatMemory | None = None
) -> Safety:
    """Build the safety supervisor of a mission from the ``[safety]`` section of its rig file.

    Parameters
    ----------
    rig : Rig
    mission : Mission or Observation
    latch : Latch, optional
        Stop latch of the run; a new one unless given.
    heat_memory : HeatMemory, optional
        Coil temperatures at the end of earlier runs; without it, the coils start cold.

    Returns
    -------
    Safety
    """
    section = mission.rig.sections.safety
    rules = SafetyRules(
        max_duty=section.max_duty,
        max_sigma=section.max_sigma,
        uncertain_shots=section.uncertain_shots,
        stale_shots=section.stale_shots,
        max_age=section.max_age + mission.rig.turnaround,
        allowed_box=None if isinstance(mission, Observation) else _compute_allowed_box(mission, section.reach_margin),
    )
    return Safety(
        rig.limits,
        rules,
        DutyCycle(mission.rig.driven, section.duty_window_s),
        CoilHeat(mission.rig.thermal, section.ambient_c),
        SensorMonitor(
            len(rig.sensors),
            NO_LIMIT if mission.rig.may_leave_out_sensors else section.sensor_shots,
            section.broken_sensors,
        ),
        latch,
        heat_memory,
    )


def _compute_allowed_box(
    mission: MissionBase, margin: float
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Compute the allowed box: the container from its floor to the surface, `margin` m larger on every side."""
    box = mission.rig.container
    half = 0.5 * box.size + margin
    (x, y), (right, back) = box.center - half, box.center + half
    return (x, y, box.floor_z - margin), (right, back, box.surface_z + margin)


def make_channel_watch(mission: AnyMission) -> ChannelWatch:
    """Build the watch that leaves out sensors which disagree with the others, and rejects poses that cannot be.

    Parameters
    ----------
    mission : Mission or Observation
        Its rig file gives the sensors' tolerances, and whether a flight may go on without one.

    Returns
    -------
    ChannelWatch
    """
    section = mission.rig.sections.safety
    if isinstance(mission, Observation):
        gate = PoseGate(None, None, None)
    else:
        box = _compute_allowed_box(mission, section.reach_margin)
        if mission.robot.kind == "helical":
            gate = PoseGate(box, mission.helix_setup().helix, None)
        else:
            setup = mission.setup()
            gate = PoseGate(box, setup.robot, setup.table)
    guided = isinstance(mission, Observation) and mission.motion is not None
    frames = compute_tilt_frames(mission.rig.sections.sensors.array)
    return ChannelWatch(
        gate, frames, None if guided else _compute_deviations(mission), section.broken_sensors,
        may_leave_out=mission.rig.may_leave_out_sensors, max_windows=section.sensor_shots,
    )  # fmt: skip


def _compute_deviations(mission: MissionBase) -> FloatArray:
    """Compute the covariance of the deviations of sensors and device, typical ones where the rig file has none."""
    sensors = mission.rig.sensor_covariance
    if sensors is None:
        sensors = np.diag(np.tile(TYPICAL_TOLERANCES, len(mission.rig.sections.sensors.array)) ** 2)
    n = len(sensors)
    out = np.zeros((n + DEVIATIONS_OF_DEVICE, n + DEVIATIONS_OF_DEVICE))
    out[:n, :n] = sensors
    out[n:, n:] = np.diag(np.array(mission.robot.device_tolerances) ** 2)
    return out


def make_array_filter(mission: MissionBase, locator: PoseEstimator) -> ArrayFilter | None:
    """Build the filter that estimates sensor errors in flight.

    Parameters
    ----------
    mission : Mission or Observation
        Its rig file gives the tolerances of sensor positions, axes and gains.
    locator : PoseEstimator

    Returns
    -------
    ArrayFilter or None
        None if the rig file gives no tolerances, or if the estimator does not learn sensors.
    """
    if mission.rig.sensor_covariance is None or "sensors" not in locator.learns:
        return None
    frames = compute_tilt_frames(mission.rig.sections.sensors.array)
    return ArrayFilter(ArrayPrior(locator.sensors, locator.device, _compute_deviations(mission), frames))


def make_learned_sensors_file(mission: MissionBase, learned: ArrayFilter) -> SensorsFile:
    """Convert the sensor array that a flight has estimated to a sensors file, from which the next flight can start.

    Parameters
    ----------
    mission : Mission or Observation
        Mission of that flight.
    learned : ArrayFilter
        Filter at the end of the flight.

    Returns
    -------
    SensorsFile
        Positions, axes and gains with their remaining uncertainty.
    """
    rig, array = mission.rig, learned.prior.make_array(learned.deviations)
    gains = rig.sensor_gains * (1.0 if array.gains is None else array.gains)
    section = rig.sections.sensors.model_copy(
        update={
            "positions_mm": [(x, y, z) for x, y, z in (1e3 * array.positions).tolist()],
            "axes": [(x, y, z) for x, y, z in array.axes.tolist()],
            "gains": gains.tolist(),
            "calibrated": None,
        }
    )
    left = UncertaintySection.from_covariance(
        learned.covariance[:-DEVIATIONS_OF_DEVICE, :-DEVIATIONS_OF_DEVICE], learned.recordings
    )
    return SensorsFile(
        rig=rig.name, date=date.today(), description="learned in flight", sensors=section, uncertainty=left
    )


def _make_steering_parts(mission: Mission, controller: Controller | None = None) -> tuple[Tracker, Pilot]:
    """Build tracker and pilot of a mission that steers a robot along a path."""
    make = load_plugin("controllers", mission.law)
    if mission.robot.kind == "helical":
        screwed = mission.helix_setup()
        tracker = Tracker(screwed.helix, screwed.device, None)
        with report_plugin_errors("Controller", make, ""):
            return tracker, Follower(mission.path, controller or make(screwed, mission.gains))
    setup = mission.setup()
    tracker = Tracker(setup.robot, setup.device, setup.table)
    with report_plugin_errors("Controller", make, ""):
        return tracker, Follower(mission.path, controller or make(setup, mission.gains))


def _make_watching_parts(mission: Observation) -> tuple[Tracker, Pilot]:
    """Build tracker and pilot of an observation, which steers nothing."""
    section = mission.sections.observe
    if section.measurements is not None:
        single_shot = SingleShotTracker(mission.robot.device)
        return single_shot, Measurer(single_shot, section.measurements)
    assert section.duration_s is not None
    device, motion = mission.robot.device, mission.motion
    tracker = Tracker(None, device, None) if motion is None else VelocityTracker(device, motion)
    return tracker, Watcher(section.duration_s)


def make_search_volume(mission: MissionBase) -> SearchVolume:
    """Compute the volume to search for the robot: the container, from its floor to 10 mm above the surface.

    Parameters
    ----------
    mission : Mission or Observation

    Returns
    -------
    SearchVolume
        Corners in m in the world frame, and the grid's spacing in m.
    """
    low, (right, back, surface) = mission.rig.container.low, mission.rig.container.high
    return SearchVolume((low[0], low[1], low[2]), (right, back, surface + 0.01), spacing=5e-3)
