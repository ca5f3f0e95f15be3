"""``smolbot track --deflection``: the swing of a cantilever in a high-speed clip."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from smolbot.core.text_table import write_table
from smolbot.errors import InputError, report_write_errors

if TYPE_CHECKING:
    from smolbot.runs.optics.deflection import ObservedSwing
    from smolbot.runs.optics.ringing import Ringing
    from smolbot.runs.optics.video import Video

MIN_FRAME_RATE = 400.0  # frames per second: less is a rate of playing, not of recording


def measure_swing(
    clip: Video, rate_given: bool, from_s: float | None, to_s: float | None, folder: Path, json: bool
) -> None:  # fmt: skip
    """Measure the swing, print the figures, and write swing.csv, swing.json and swing.png.

    Parameters
    ----------
    clip : Video
    rate_given : bool
        Whether the frame rate was given by the user.
    from_s : float or None, in s
        Start of the free swing; None to find it.
    to_s : float or None, in s
        End of the free swing; None to find it.
    folder : Path
    json : bool
        Also print one JSON object on standard output.

    Raises
    ------
    InputError
        If the clip has a frame rate of playback, not of recording.
    """
    from smolbot.core.results import format_json
    from smolbot.runs.optics.deflection import follow_swing
    from smolbot.runs.optics.ringing import fit_ringing
    from smolbot.runs.optics.swing_picture import draw_swing
    from smolbot.ui.cli.show import echo_json, print_table

    if not rate_given and clip.fps < MIN_FRAME_RATE:
        raise InputError(
            f"{clip.path}: tells {clip.fps:g} frames per second, at which it is to be played; say with --fps what "
            "it was recorded "
            "at, such as --fps 5000."
        )
    swing = follow_swing(clip)
    ringing = fit_ringing(swing.times, swing.angles, from_s, to_s)
    figures = _compute_figures(swing, ringing, clip)
    with report_write_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        _write(folder / "swing.csv", swing)
        (folder / "swing.json").write_text(format_json(figures), encoding="utf-8")
    f, a, d = (figures[k] for k in ("frequency_hz", "amplitude_deg", "damping_per_s"))
    largest = f"{figures['largest_deg']:.1f}° at most"
    line = f"{f['value']:.2f} Hz   ·   {largest}   ·   damping {d['value']:.2f} 1/s, {ringing.model}"
    draw_swing(swing, ringing, folder / "swing.png", title=f"Swing in {clip.path.name}", line=line)
    rows = [
        ("frames", f"{swing.total} at {clip.fps:g} per second; magnet seen in {len(swing.frames)}"),
        ("angles", _describe_angles(swing)),
        ("largest", f"{figures['largest_deg']:.2f}°"),
        (
            "free swing",
            f"from {1e3 * ringing.begin:.1f} to {1e3 * ringing.end:.1f} ms, rms left {figures['rms_deg']:.3f}°",
        ),
        ("resonance", f"{f['value']:.3f} ± {f['std']:.1g} Hz"),
        ("amplitude", f"{a['value']:.2f} ± {a['std']:.1g}° when it is let go"),
        (
            "damping",
            f"{d['value']:.3f} ± {d['std']:.1g} 1/s, {ringing.model}; {figures['loss_deg_per_s']:.1f}°/s at first",
        ),
        ("other model", f"rms left {figures['other_model_rms_deg']:.3f}°"),
        ("written", f"{folder}: swing.csv, swing.json, swing.png"),
    ]
    print_table(clip.path.name, rows, err=json)
    if json:
        echo_json(figures)


def _describe_angles(swing: ObservedSwing) -> str:
    if swing.by_arc:
        return (
            f"by the arc of the magnet's centre, {swing.radius:.1f} ± {swing.radius_sigma:.2f} pixels about its pivot"
        )
    return "by how the magnet is turned: its arc is too short to tell the pivot"


def _compute_figures(swing: ObservedSwing, ringing: Ringing, clip: Video) -> dict[str, Any]:
    import numpy as np

    std = ringing.std
    agree = np.degrees(np.abs(swing.arc - swing.turn)) if swing.by_arc else np.full(1, math.nan)
    return {
        "video": str(clip.path), "fps": clip.fps, "frames": swing.total, "seen": len(swing.frames),
        "by": "arc" if swing.by_arc else "turn", "radius_px": swing.radius,
        "arc_less_turn_deg": float(np.mean(agree)),
        "largest_deg": float(np.degrees(np.max(np.abs(swing.angles - ringing.rest)))),
        "frequency_hz": {"value": ringing.frequency, "std": std["frequency"]},
        "amplitude_deg": {"value": math.degrees(ringing.amplitude), "std": math.degrees(std["amplitude"])},
        "damping_per_s": {"value": ringing.damping, "std": std["damping"]},
        "damping_model": ringing.model, "loss_deg_per_s": math.degrees(ringing.amplitude * ringing.damping),
        "rms_deg": math.degrees(ringing.rms), "other_model_rms_deg": math.degrees(ringing.other_rms),
        "free_from_s": ringing.begin, "free_to_s": ringing.end,
    }  # fmt: skip


def _write(path: Path, swing: ObservedSwing) -> None:
    table = zip(swing.frames, swing.times, *swing.centers.T, swing.arc, swing.turn, strict=True)
    rows = ([int(number), *("" if math.isnan(v) else f"{v:.9g}" for v in values)] for number, *values in table)
    write_table(path, ["frame", "time_s", "x_px", "y_px", "arc_rad", "turn_rad"], rows)
