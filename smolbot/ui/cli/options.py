"""Arguments and options that several commands share, and the parsing of ``--set``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from smolbot.errors import InputError
from smolbot.functions.settings import DEFAULT_ROBOT

if TYPE_CHECKING:
    from smolbot.config.rig import RigConfig

MissionArgument = Annotated[
    str, typer.Argument(help="Shipped mission by name, or your own by path.", metavar="MISSION")
]
RigOption = Annotated[
    str | None, typer.Option("--rig", help="Rig to use instead of the mission's own, by name or path.")
]
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        help="key=value overrides the mission file; rig.key=value the rig file; @FILE: all values of a TOML file.",
    ),
]
FaultOption = Annotated[
    list[str] | None,
    typer.Option(
        "--fault",
        help="Fault of a simulated tank: NAME[.CHANNEL][=VALUE][@MOMENT][:once|good|SECONDS], such as "
        "sensor_gain.3=0.5@30s:10; smolbot simulate --list-faults lists them.",
    ),
]
RobotOption = Annotated[
    str | None,
    typer.Option("--robot", help=f"Robot, by name or path; default: the device file's, or {DEFAULT_ROBOT}."),
]
DeviceOption = Annotated[Path | None, typer.Option("--device", help="Device file, from smolbot calibrate.")]
ForceOption = Annotated[
    Literal["preview"] | None, typer.Option("--force", help="Fly even where the preview says no-go.", metavar="preview")
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object on standard output.")]


def parse_settings(pairs: list[str] | None) -> dict[str, str]:
    """Parse the options ``--set``; ``@gains.toml`` means all settings in the file.

    Parameters
    ----------
    pairs : list of str or None
        Each ``key=value`` or ``@FILE``.

    Returns
    -------
    dict of str

    Raises
    ------
    InputError
        For an option without ``=``, or a file that cannot be read.
    """
    found: dict[str, str] = {}
    for pair in pairs or []:
        if pair.startswith("@"):
            found |= _read_settings(Path(pair[1:]))
            continue
        key, equals, value = pair.partition("=")
        if not equals or not key.strip():
            raise InputError(f"--set needs key=value, such as controller.tolerance_mm=0.5; got '{pair}'.")
        found[key.strip()] = value.strip()
    return found


FAULTS_KEY = "rig.tank.faults"
"""Setting that injects faults into a simulated tank."""


def add_faults(settings: dict[str, str], faults: list[str] | None) -> dict[str, str]:
    """Add the options ``--fault`` to the settings, as the key of the rig file that they stand for.

    Parameters
    ----------
    settings : dict of str
    faults : list of str or None

    Returns
    -------
    dict of str

    Examples
    --------
    >>> add_faults({}, ["drag=0.5"])
    {'rig.tank.faults': '["drag=0.5"]'}
    """
    import json

    return {**settings, FAULTS_KEY: json.dumps(faults)} if faults else settings


def require_tank(rig: RigConfig, faults: list[str] | None) -> None:
    """Raise `InputError` if faults are to be injected into anything but a simulated tank.

    Parameters
    ----------
    rig : RigConfig
    faults : list of str or None
        The options ``--fault``.
    """
    if faults and rig.world != "tank":
        raise InputError(
            f"--fault needs a rig of world 'tank'; '{rig.name}' is of world '{rig.world}'. A twin takes its faults "
            "itself: smolbot twin --fault."
        )


def _read_settings(path: Path) -> dict[str, str]:
    """Read the settings of a TOML file."""
    import json
    import tomllib

    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"--set @{path}: cannot be read as TOML: {error}.") from error
    found: dict[str, str] = {}

    def lay(prefix: str, values: dict[str, Any]) -> None:
        for key, value in values.items():
            if isinstance(value, dict):
                lay(f"{prefix}{key}.", value)
            else:
                found[f"{prefix}{key}"] = json.dumps(value, default=str)

    lay("", data)
    return found
