"""The mission file: robot, path, rig, control law, and when the mission counts as passed."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from pydantic import Field

from smolbot.config.document import Document, Fault, FileModel
from smolbot.config.feasibility import find_fitness_faults
from smolbot.config.mission_base import MissionBase, MissionBaseFile, load_parts, open_document
from smolbot.config.path_section import PathSection, read_path
from smolbot.config.plugins import list_plugins, load_plugin
from smolbot.config.rig import RigConfig
from smolbot.config.robot import RobotConfig
from smolbot.config.units import Point, Positive, Share
from smolbot.core.arrays import FloatArray
from smolbot.errors import PluginError
from smolbot.motion.controller import Gain, HelixSetup, Setup, find_gain_fault, robot_kinds
from smolbot.motion.helix import Helix
from smolbot.motion.robot import Robot
from smolbot.paths.curve import Curve
from smolbot.paths.visits import Visits, find_visits


class StartSection(FileModel):
    """The robot's start position, relative to the start of the path."""

    offset_mm: Point = (0.0, 0.0)


class ControllerSection(FileModel):
    """The control law, when a goal counts as reached, and gains that differ from the law's defaults."""

    law: str
    tolerance_mm: Positive = 0.8
    gains: dict[str, float] = Field(default_factory=dict)


VISIT_TOLERANCE_FACTOR = 1.5
"""Distance from the path that counts as a visit, over that at which a law counts a goal as reached: a law knows the
tracked pose only, whose error comes on top."""


class VerdictSection(FileModel):
    """Limits that a completed mission must keep to pass.

    Attributes
    ----------
    mean_tracking_mm, mean_localization_mm : float
        Largest mean errors; checked where the ground truth is known.
    min_visited_share : float
        Least share of the path that is visited in its order, within 1.5 times `tolerance_mm`: by the true robot where
        the ground truth is known, else by the tracked one.
    """

    mean_tracking_mm: Positive | None = None
    mean_localization_mm: Positive | None = None
    min_visited_share: Share = 0.98


class MissionFile(MissionBaseFile):
    """Content of the file of a mission that steers a robot.

    Attributes
    ----------
    extends : str
        A shipped mission by name, or a file by path: all that does not stand here is as there.
    """

    path: PathSection
    start: StartSection = StartSection()
    controller: ControllerSection
    verdict: VerdictSection = VerdictSection()


class Mission(MissionBase):
    """A mission that steers, whose files hold together: path, rig, robot and law fit each other.

    Parameters
    ----------
    document : Document
        The mission file, resolved.
    sections : MissionFile
    rig : RigConfig
    robot : RobotConfig
    path : Curve
    path_remarks : tuple of str
        What was changed of a drawn path.

    Examples
    --------
    >>> import smolbot
    >>> mission = smolbot.load_mission("line")
    >>> mission.law, mission.rig.name, f"{1e3 * mission.path.length:.1f} mm"
    ('current_ratio', 'tank', '8.0 mm')
    """

    def __init__(
        self,
        document: Document,
        sections: MissionFile,
        rig: RigConfig,
        robot: RobotConfig,
        path: Curve,
        path_remarks: tuple[str, ...] = (),
    ) -> None:
        super().__init__(document, sections, rig, robot)
        self.sections = sections
        self.path = path
        self.path_remarks = path_remarks

    @property
    def tolerance(self) -> float:
        """Distance at which a goal counts as reached, in m."""
        return self.sections.controller.tolerance_mm * 1e-3

    @property
    def visit_tolerance(self) -> float:
        """Distance within which a place of the path counts as visited, in m."""
        return VISIT_TOLERANCE_FACTOR * self.tolerance

    def find_visits(self, positions: FloatArray) -> Visits:
        """Find the parts of the path that a robot visited in order, within `visit_tolerance`.

        Parameters
        ----------
        positions : ndarray, shape (n, 3), in m, world frame
            In the order of time.

        Returns
        -------
        Visits
        """
        return find_visits(self.path, positions, self.visit_tolerance)

    def find_skip_fault(self, visits: Visits) -> str | None:
        """Explain which part of the path a robot left out, against the limit of the verdict.

        Parameters
        ----------
        visits : Visits
            As of `find_visits`.

        Returns
        -------
        str or None
            None if enough of the path was visited.
        """
        least = self.sections.verdict.min_visited_share
        if visits.share >= least:
            return None
        share = f"{100.0 * visits.share:.1f} % of the path visited in order, less than {100.0 * least:g} %"
        return f"{share}; skipped {visits.describe_longest_skip(self.path)}"

    @property
    def law(self) -> str:
        """Entry-point name of the control law."""
        return self.sections.controller.law

    @property
    def gains(self) -> Mapping[str, float]:
        """Gains that differ from the law's defaults."""
        return self.sections.controller.gains

    @property
    def start(self) -> tuple[float, float]:
        """Start position (x, y) of the robot in the world frame, in m."""
        offset = self.sections.start.offset_mm
        return self.path.points[0, 0] + offset[0] * 1e-3, self.path.points[0, 1] + offset[1] * 1e-3

    @property
    def start_placement(self) -> tuple[float, ...]:
        """Start position (x, y) in m; for a helical robot also its heading in rad, along the path."""
        if self.robot.kind != "helical":
            return self.start
        ahead = self.path.tangent(np.zeros(1))[0]
        return (*self.start, float(np.arctan2(ahead[1], ahead[0])))

    def helix_setup(self) -> HelixSetup:
        """Build the inputs of the controller of a helical robot.

        Returns
        -------
        HelixSetup
            Assumed parameters of robot, gel, magnet and cycle, in SI units.
        """
        helix, device, medium, magnet = self.robot.helix, self.robot.device, self.rig.sections.medium, self.rig.magnet
        box, center = self.rig.container, magnet.center
        return HelixSetup(
            helix=Helix.in_gel(
                pitch=helix.pitch,
                slip=helix.slip,
                diameter=self.robot.size[0],
                length=self.robot.size[2],
                center_ahead=self.robot.center[2],
                moment=device.moment,
                l0=device.l0,
                theta_max=device.theta_max,
                frequency=device.frequency,
                yield_stress=medium.yield_stress_pa,
                viscosity=medium.viscosity_pa_s,
                magnet=(float(center[0]), float(center[1]), float(center[2])),
                field=1e-3 * magnet.field_mt,
                distance=magnet.distance,
                steering_rate=self.rig.limits.max_steering_rate,
                floor=box.floor_z,
                plate=box.surface_z,
                steering=helix.steering,
                drift=helix.drift,
            ),
            limits=self.rig.limits,
            device=device,
            cycle=self.cycle,
            move=magnet.move_s,
            tolerance=self.tolerance,
        )

    def setup(self) -> Setup:
        """Build the inputs of the controller of a gradient-driven robot.

        Returns
        -------
        Setup
            Field table, limits, and assumed parameters of robot, device and cycle, in SI units.
        """
        medium = self.rig.sections.medium
        device = self.robot.device
        return Setup(
            table=self.rig.table(),
            limits=self.rig.limits,
            device=device,
            robot=Robot.in_liquid(
                device.moment,
                self.robot.drag_radius,
                medium.viscosity_pa_s,
                frequency=device.frequency,
                l0=device.l0,
                theta_max=device.theta_max,
                center_ahead=self.robot.center[2],
            ),
            cycle=self.cycle,
            tolerance=self.tolerance,
        )


def load_steering_mission(name: str, rig: str | None = None, settings: dict[str, str] | None = None) -> Mission:
    """Read a mission that steers, with the rig and robot that it names.

    Parameters
    ----------
    name : str
        Name of a shipped mission, or the path of a user's own.
    rig : str, optional
        A rig to fly on instead of the mission's own.
    settings : dict, optional
        ``{"controller.tolerance_mm": "0.5"}``: values that replace those of the mission file; keys that begin with
        ``rig.`` replace those of the rig file.

    Returns
    -------
    Mission

    Raises
    ------
    ConfigError
        With a line for every fault of the files, before anything moves.
    """
    settings = settings or {}
    document = open_document(name, settings)
    if "observe" in document.data:
        message = "this mission only looks, and steers nothing; smolbot run and smolbot simulate carry it out."
        raise document.error([Fault(("observe",), message)])
    laws = _find_law_faults(document)
    sections, rig_config, robot_config = load_parts(document, MissionFile, rig, settings, laws)
    if robot_config.kind == "device":
        message = f"'{robot_config.name}' is of kind 'device', which nothing moves; a path needs a robot that swims."
        raise document.error([Fault(("robot",), message)])
    _check_kind(document, sections, rig_config, robot_config)
    under = 0.5 * robot_config.size[0] if robot_config.kind == "helical" else 0.0  # a helix is pulled up to the plate
    path, remarks = read_path(document, sections.path, rig_config.surface_z - under)
    mission = Mission(document, sections, rig_config, robot_config, path, remarks)
    unfit = find_fitness_faults(mission, path, mission.start, mission.tolerance)
    if unfit:
        raise document.error(unfit)
    return mission


def _check_kind(document: Document, sections: MissionFile, rig: RigConfig, robot: RobotConfig) -> None:
    """Raise if the law does not drive this kind of robot, or if a helix lacks its rotating magnet or its gel."""
    kinds = robot_kinds(load_plugin("controllers", sections.controller.law))
    faults = []
    if robot.kind not in kinds:
        message = (
            f"'{sections.controller.law}' drives robots of kind {', '.join(kinds)}; '{robot.name}' is {robot.kind}."
        )
        faults.append(Fault(("controller", "law"), message))
    if robot.kind == "helical" and rig.sections.magnet is None:
        faults.append(Fault(("rig",), f"'{rig.name}' has no [magnet], which a helical robot needs."))
    if robot.kind == "helical" and rig.sections.medium.yield_stress_pa == 0:
        faults.append(Fault(("rig",), f"the medium of '{rig.name}' has no yield_stress_pa: a helix needs a gel."))
    if faults:
        raise document.error(faults)


def _find_law_faults(document: Document) -> list[Fault]:
    section = document.data.get("controller")
    law = section.get("law") if isinstance(section, dict) else None
    if not isinstance(law, str):
        return []
    known = list_plugins("controllers")
    if law not in known:
        return [Fault(("controller", "law"), f"no controller is named '{law}'; installed: {', '.join(known)}.")]
    gains = load_plugin("controllers", law).gains
    if not isinstance(gains, Mapping):
        raise PluginError(f"Controller '{law}' breaks its protocol: gains must map names to Gains; got {gains!r}.")
    for name, gain in gains.items():
        if not isinstance(gain, Gain):
            raise PluginError(f"Controller '{law}' breaks its protocol: gains['{name}'] must be a Gain; got {gain!r}.")
    given = section.get("gains", {}) if isinstance(section, dict) else {}
    faults = [
        (name, find_gain_fault(gains, name, value, law))
        for name, value in (given.items() if isinstance(given, dict) else ())
        if isinstance(value, int | float)
    ]
    return [Fault(("controller", "gains", name), message) for name, message in faults if message]
