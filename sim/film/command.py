"""The command ``smolbot film``: a camera's video of a simulated run, or of an oscillating cantilever."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from smolbot.errors import InputError
from smolbot.ui.cli.options import JsonOption
from smolbot.ui.cli.show import echo_json, print_table

FPS, SWING_FPS = 25.0, 5000.0
"""Frames per second of a run's film, and of one of a cantilever."""

MIN_PIXELS = 64
"""Smallest width or height of a film."""


def film(
    run: Annotated[Path | None, typer.Argument(help="Folder of a run in the simulated tank.", metavar="RUN")] = None,
    out: Annotated[Path, typer.Option("--out", help="Video to write: .avi, or .mp4 (smaller, more artefacts).")] = Path(
        "film.avi"
    ),
    fps: Annotated[float | None, typer.Option(help="Frames per second; default: 25, or 5000 with --swing.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Random seed of camera, print, light, colours and noise.")] = 1,
    begin_s: Annotated[float | None, typer.Option(help="First time to film, in s on the run's clock.")] = None,
    end_s: Annotated[float | None, typer.Option(help="Last time to film, in s.")] = None,
    size: Annotated[str, typer.Option(help="Width and height in pixels.")] = "1280x960",
    hide: Annotated[list[str] | None, typer.Option("--hide", help="FROM..TO in s: a rod covers the robot.")] = None,
    flat: Annotated[
        bool, typer.Option("--flat", help="Markers only on the plate, none at the robot's height.")
    ] = False,
    swing: Annotated[
        str | None, typer.Option(help="Film the cantilever of this robot, excited and released, instead of a run.")
    ] = None,
    rig: Annotated[str, typer.Option(help="With --swing: the rig whose excitation coils drive it.")] = "tank",
    truth: Annotated[Path | None, typer.Option(help="CSV file for the true poses, to evaluate a tracker.")] = None,
    json: JsonOption = False,
) -> None:
    """Film a run from above, with a lab camera's tilt, print, uneven light, meniscus, blur, noise and compression.

    Beside the video a TOML file gives the positions of its markers, for smolbot track --fiducials.
    """
    if (run is None) == (swing is None):
        raise InputError("Name the folder of a run, or --swing ROBOT.")
    if swing is not None:
        _film_swing(swing, rig, out, fps, seed, truth, json)
        return
    from sim.film.filming import film_run as shoot
    from sim.film.trail import read_trail

    assert run is not None
    trail, mission = read_trail(run)
    made = shoot(
        trail, mission.rig, mission.robot, out, seed=seed, fps=FPS if fps is None else fps, begin=begin_s, end=end_s,
        size=_parse_size(size), hidden=[_parse_span(text) for text in hide or []], posts=not flat,
    )  # fmt: skip
    fiducials = out.with_suffix(".toml")
    fiducials.write_text(made.format_fiducials(), encoding="utf-8")
    if truth is not None:
        made.write_truth(truth)
    rows = [
        ("video", f"{out}, {len(made.times)} frames"),
        ("from, to", f"{made.times[0]:.3f} to {made.times[-1]:.3f} s on the run's clock"),
        ("markers", str(fiducials)),
        ("to track it", f"smolbot track {out} --fiducials {fiducials} --run {run}"),
    ]
    print_table(f"film of {run.name}", rows, err=json)
    if json:
        echo_json({"video": str(out), "fiducials": str(fiducials), "frames": len(made.times), "begin_s": made.times[0]})


def _film_swing(name: str, rig: str, out: Path, fps: float | None, seed: int, truth: Path | None, json: bool) -> None:
    from sim.film.swing import film_swing
    from smolbot.config.rig import load_rig
    from smolbot.config.robot import load_robot

    rate = SWING_FPS if fps is None else fps
    made = film_swing(load_rig(rig), load_robot(name), out, seed=seed, fps=rate)
    if truth is not None:
        made.write_truth(truth)
    rows = [
        ("clip", f"{out}, {len(made.times)} frames, recorded at {rate:g} frames/s"),
        ("drive", f"until {1e3 * made.released:.0f} ms, then free"),
        ("to measure it", f"smolbot track {out} --deflection --fps {rate:g}"),
    ]
    print_table(f"cantilever of {name}", rows, err=json)
    if json:
        echo_json({"video": str(out), "frames": len(made.times), "fps": rate, "released_s": made.released})


def _parse_size(text: str) -> tuple[int, int]:
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal() and min(int(width), int(height)) >= MIN_PIXELS):
        raise InputError(f"--size needs WIDTHxHEIGHT in pixels, {MIN_PIXELS} or more each; got '{text}'.")
    return int(width), int(height)


def _parse_span(text: str) -> tuple[float, float]:
    first, _, last = text.partition("..")
    try:
        return float(first), float(last)
    except ValueError:
        raise InputError(f"--hide needs FROM..TO in seconds, such as 20..22.5; got '{text}'.") from None
