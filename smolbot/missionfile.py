"""The mission file: which robot follows which path, on which rig, by which law, and what counts as done."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import Field

from smolbot.config import Document, Fault, FileModel
from smolbot.control import Cycle, Setup, gain_fault
from smolbot.errors import ConfigError, SmolbotError
from smolbot.library import find_file
from smolbot.motion.robot import Robot
from smolbot.paths import Curve
from smolbot.pathsection import PathSection, read_path
from smolbot.plugins import load, names
from smolbot.rigfile import RigConfig, load_rig
from smolbot.robotfile import RobotConfig, load_robot

Positive = Annotated[float, Field(gt=0)]
Point = tuple[float, float]


class StartSection(FileModel):
    """Where the robot is put down, from the path's start."""

    offset_mm: Point = (0.0, 0.0)


class ControllerSection(FileModel):
    """The law, when a goal counts as reached, and gains that differ from the law's defaults."""

    law: str
    tolerance_mm: Positive = 0.8
    gains: dict[str, float] = Field(default_factory=dict)


class CycleSection(FileModel):
    """The localization part of a cycle."""

    excite_cycles: Annotated[int, Field(ge=1, le=100)] = 5
    ring_down_ms: Positive = 20.0
    half_periods: Annotated[int, Field(ge=1, le=400)] = 2
    excite_current_a: Positive | None = None


class LocalizationSection(FileModel):
    """How poses are found."""

    estimator: Literal["whitened", "paper"] = "whitened"
    quiet_s: Annotated[float, Field(ge=0)] = 10.0
    learn_ring_down: bool = False


class VerdictSection(FileModel):
    """What a completed mission must also keep to, where the truth is known."""

    mean_tracking_mm: Positive | None = None
    mean_localization_mm: Positive | None = None


class StopSection(FileModel):
    """When to give up."""

    max_duration_s: Positive = 600.0
    lost_shots: Annotated[int, Field(ge=1)] = 20


class MissionFile(FileModel):
    """Everything a mission file says."""

    name: str
    description: str = ""
    rig: str
    robot: str
    path: PathSection
    start: StartSection = StartSection()
    controller: ControllerSection
    cycle: CycleSection = CycleSection()
    localization: LocalizationSection = LocalizationSection()
    verdict: VerdictSection = VerdictSection()
    stop: StopSection = StopSection()


class Mission:
    """A mission whose files hold together: path, rig, robot and law fit each other."""

    def __init__(
        self,
        document: Document,
        sections: MissionFile,
        rig: RigConfig,
        robot: RobotConfig,
        path: Curve,
        path_remarks: tuple[str, ...] = (),
    ) -> None:
        self.document = document
        self.sections = sections
        self.rig = rig
        self.robot = robot
        self.path = path
        self.path_remarks = path_remarks
        self.name = sections.name

    @property
    def cycle(self) -> Cycle:
        section = self.sections.cycle
        current = section.excite_current_a or self.rig.limits.max_excitation_current
        return Cycle(section.excite_cycles, section.ring_down_ms * 1e-3, section.half_periods, current)

    @property
    def tolerance(self) -> float:
        """In m."""
        return self.sections.controller.tolerance_mm * 1e-3

    @property
    def law(self) -> str:
        return self.sections.controller.law

    @property
    def gains(self) -> Mapping[str, float]:
        return self.sections.controller.gains

    @property
    def start(self) -> tuple[float, float]:
        """Where the robot is put down (x, y), in m."""
        offset = self.sections.start.offset_mm
        return self.path.points[0, 0] + offset[0] * 1e-3, self.path.points[0, 1] + offset[1] * 1e-3

    def setup(self) -> Setup:
        """What the controller may know."""
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


def load_mission(name: str, rig: str | None = None, settings: dict[str, str] | None = None) -> Mission:
    """Read a shipped mission by name, or a user's by path, with the rig and robot that it names.

    Parameters
    ----------
    rig : str, optional
        A rig to fly on instead of the mission's own.
    settings : dict, optional
        ``{"controller.tolerance_mm": "0.5"}``: settings laid over the mission file; keys that begin
        with ``rig.`` are laid over the rig file.

    Raises
    ------
    ConfigError
        With a line for every fault of the files, before anything moves.
    """
    settings = settings or {}
    document = Document.read(find_file(name, "missions"))
    document = document.override({k: v for k, v in settings.items() if not k.startswith("rig.")})
    sections, faults = document.validate(MissionFile)
    messages = [document.error(faults)] if faults else []
    folder = document.path.parent
    rig_name = rig or _text(document, "rig")
    rig_config = robot_config = None
    try:
        if rig_name:
            rig_settings = {k.removeprefix("rig."): v for k, v in settings.items() if k.startswith("rig.")}
            beside = str(folder / rig_name) if (rig is None and (folder / rig_name).is_file()) else rig_name
            rig_config = load_rig(beside, rig_settings)
    except SmolbotError as error:
        messages.append(_as_config(document, ("rig",), error))
    try:
        robot_name = _text(document, "robot")
        if robot_name:
            robot_config = load_robot(robot_name, beside=folder)
    except SmolbotError as error:
        messages.append(_as_config(document, ("robot",), error))
    messages += [document.error(found) for found in [_law_faults(document)] if found]
    if messages or sections is None or rig_config is None or robot_config is None:
        raise ConfigError("\n".join(dict.fromkeys("\n".join(str(m) for m in messages).splitlines())))
    path, remarks = read_path(document, sections.path, rig_config.surface_z)
    mission = Mission(document, sections, rig_config, robot_config, path, remarks)
    from smolbot.fitness import fitness_faults

    unfit = fitness_faults(mission)
    if unfit:
        raise document.error(unfit)
    return mission


def _text(document: Document, key: str) -> str | None:
    value = document.data.get(key)
    return value if isinstance(value, str) else None


def _as_config(document: Document, key: tuple[str, ...], error: SmolbotError) -> ConfigError:
    """Faults of another file keep their own place; a file that is missing is a fault of the key that names it."""
    return error if isinstance(error, ConfigError) else document.error([Fault(key, str(error))])


def _law_faults(document: Document) -> list[Fault]:
    section = document.data.get("controller")
    law = section.get("law") if isinstance(section, dict) else None
    if not isinstance(law, str):
        return []
    known = names("controllers")
    if law not in known:
        return [Fault(("controller", "law"), f"no controller is named '{law}'; installed: {', '.join(known)}.")]
    gains = load("controllers", law).gains
    given = section.get("gains", {}) if isinstance(section, dict) else {}
    faults = [
        (name, gain_fault(gains, name, value, law))
        for name, value in (given.items() if isinstance(given, dict) else ())
        if isinstance(value, int | float)
    ]
    return [Fault(("controller", "gains", name), message) for name, message in faults if message]
