"""A command of the lab's own: where the sensors of a rig are."""

from __future__ import annotations

from typing import Annotated

import typer

from smolbot import load_rig


def places(rig: Annotated[str, typer.Argument(help="A rig, by name or path.")] = "tank") -> None:
    """Print where each sensor of a rig is, in mm."""
    for number, (x, y, z) in enumerate(1e3 * load_rig(rig).sensors.positions):
        typer.echo(f"{number}: {x:.1f} {y:.1f} {z:.1f}")
