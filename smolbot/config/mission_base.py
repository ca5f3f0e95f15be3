"""Sections that every mission file has, whether a robot is steered or only localized."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from pydantic import Field, field_validator

from smolbot.config.document import Document, Fault, FileModel, Model
from smolbot.config.library import open_file
from smolbot.config.plugins import list_plugins, load_plugin
from smolbot.config.rig import RigConfig, load_rig
from smolbot.config.robot import RobotConfig, load_robot
from smolbot.config.units import NotNegative, Positive
from smolbot.errors import ConfigError, PluginError, SmolbotError, suggest_name
from smolbot.motion.controller import Cycle


class CycleSection(FileModel):
    """The localization part of a cycle."""

    excite_cycles: Annotated[int, Field(ge=1, le=100)] = 5
    ring_down_ms: Positive = 20.0
    half_periods: Annotated[int, Field(ge=1, le=400)] = 2
    excite_current_a: Positive | None = None


class LocalizationSection(FileModel):
    """How poses are estimated."""

    estimator: str = "whitened"
    quiet_s: NotNegative = 10.0
    learn_ring_down: bool = False

    @field_validator("estimator")
    @classmethod
    def _installed(cls, name: str) -> str:
        known = list_plugins("estimators")
        if name not in known:
            hint = suggest_name(name, known)
            raise ValueError(f"no estimator is named '{name}'; installed: {', '.join(known)}.{hint}")
        load_plugin("estimators", name)  # one that breaks its protocol is refused here
        return name

    @property
    def background_noise_duration(self) -> float:
        """Seconds that are listened to before the first cycle; 0 where the estimator learns nothing from them."""
        return self.quiet_s if "noise" in load_plugin("estimators", self.estimator).learns else 0.0

    @property
    def learns_ring_down(self) -> bool:
        """Whether the excitation coils' decay is learned, so that listening may start before it is over."""
        return self.learn_ring_down and "transients" in load_plugin("estimators", self.estimator).learns


class StopSection(FileModel):
    """When a flight is given up: the signal is lost after `lost_shots` shots and `lost_s` without a trusted pose."""

    max_duration_s: Positive = 600.0
    lost_shots: Annotated[int, Field(ge=1)] = 20
    lost_s: NotNegative = 15.0


class MissionBaseFile(FileModel):
    """The sections that every mission file has.

    Attributes
    ----------
    extends : str
        A shipped mission by name, or a file by path: all that does not stand here is as there.
    """

    extends: str | None = None
    name: str
    description: str = ""
    rig: str
    robot: str
    cycle: CycleSection = CycleSection()
    localization: LocalizationSection = LocalizationSection()
    stop: StopSection = StopSection()


class MissionBase:
    """A mission file with the rig and the robot that it names.

    Parameters
    ----------
    document : Document
        The mission file.
    base : MissionBaseFile
        Its sections.
    rig : RigConfig
    robot : RobotConfig
    """

    def __init__(self, document: Document, base: MissionBaseFile, rig: RigConfig, robot: RobotConfig) -> None:
        self.document = document
        self.base = base
        self.rig = rig
        self.robot = robot
        self.name = base.name

    @property
    def cycle(self) -> Cycle:
        """The localization part of a cycle, in SI units."""
        section = self.base.cycle
        current = section.excite_current_a or self.rig.limits.max_excitation_current
        return Cycle(section.excite_cycles, section.ring_down_ms * 1e-3, section.half_periods, current)


def open_document(name: str, settings: dict[str, str]) -> Document:
    """Read a mission file with settings applied.

    Parameters
    ----------
    name : str
        Name of a shipped mission, or the path of a user's own.
    settings : dict of str to str
        Those that begin with ``rig.`` are left out.

    Returns
    -------
    Document

    Raises
    ------
    MissingFileError
        If there is no such file.
    ConfigError
        If it is not valid TOML, or a setting does not fit it.
    """
    document = open_file(name, "missions")
    return document.override({k: v for k, v in settings.items() if not k.startswith("rig.")})


def load_parts(
    document: Document,
    model: type[Model],
    rig: str | None,
    settings: dict[str, str],
    extra_faults: Sequence[Fault] = (),
) -> tuple[Model, RigConfig, RobotConfig]:
    """Validate a mission file and read the rig and robot that it names.

    Parameters
    ----------
    document : Document
        The mission file.
    model : type of FileModel
    rig : str or None
        A rig to use instead of the mission's own.
    settings : dict of str to str
        Those that begin with ``rig.`` are applied to the rig file.
    extra_faults : sequence of Fault, optional
        Further faults of the mission file, reported with the others.

    Returns
    -------
    FileModel
        The mission file as `model`.
    RigConfig
    RobotConfig

    Raises
    ------
    ConfigError
        With a line for every fault of the three files, and for `extra_faults`.
    """
    sections, faults = document.validate(model)
    messages = [document.error(faults)] if faults else []
    rig_name = rig or _get_text(document, "rig")
    rig_config = robot_config = None
    try:
        if rig_name:
            rig_settings = {k.removeprefix("rig."): v for k, v in settings.items() if k.startswith("rig.")}
            own = document.folder(("rig",)) / rig_name
            rig_config = load_rig(str(own) if rig is None and own.is_file() else rig_name, rig_settings)
    except PluginError:  # no fault of the file
        raise
    except SmolbotError as error:
        messages.append(_as_config_error(document, ("rig",), error))
    try:
        robot_name = _get_text(document, "robot")
        if robot_name:
            robot_config = load_robot(robot_name, beside=document.folder(("robot",)))
    except SmolbotError as error:
        messages.append(_as_config_error(document, ("robot",), error))
    _raise_all(messages + ([document.error(list(extra_faults))] if extra_faults else []))
    assert sections is not None
    assert rig_config is not None
    assert robot_config is not None
    return sections, rig_config, robot_config


def _raise_all(messages: list[ConfigError]) -> None:
    """Raise one error with every distinct line of `messages`; do nothing if there are none."""
    if messages:
        raise ConfigError("\n".join(dict.fromkeys("\n".join(str(m) for m in messages).splitlines())))


def _get_text(document: Document, key: str) -> str | None:
    value = document.data.get(key)
    return value if isinstance(value, str) else None


def _as_config_error(document: Document, key: tuple[str, ...], error: SmolbotError) -> ConfigError:
    """Keep a ConfigError as it is; turn any other error into a fault of the key that names the file."""
    return error if isinstance(error, ConfigError) else document.error([Fault(key, str(error))])
