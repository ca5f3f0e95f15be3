"""Superfast localization: one excitation, cut into segments, while the device steps along a line (Figs. 2H, S6)."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from sim.studies.benches import (
    REFERENCE_POSITION,
    RING_DOWN,
    make_characterised_device,
    make_localizers,
    make_reference_orientation,
    open_bench,
)
from sim.studies.columns import compute_rms, join_columns, make_columns, select_rows, stack_position_errors
from sim.studies.study import Chunk, Columns, Options, Outcome, Study, cut_chunks
from smolbot.core.arrays import FloatArray
from smolbot.core.pose import Pose
from smolbot.core.sensing import Device, Recording
from smolbot.localization.localizer import Localizer

SEGMENTS = (1, 2, 4, 8)
"""Half-periods of a segment."""

SECONDS = 2.4
"""Length of the paper's record."""

TOP_SPEED, STEP, TRAVEL = 0.200, 0.005, 0.050
"""Top speed (m/s), step and travel (m) of the stage. A step takes 50 ms with a squared sine as speed."""

OUTLIERS_MM = (-1.0, 60.0)
"""Range of x, from the start of the motion, outside which the paper counts an outlier."""

BENCHES = 6
BIN, MIN_SEGMENTS = 0.1, 5.0
"""Time, in s, over which sigma is computed, and at least in segments."""

LIMIT_MM = 1.0
"""Sigma up to which a device counts as localized."""

LINEAR_SECONDS = 0.85
"""Length of a recording with linear damping, in s: the oscillation ends soon after."""

SPEED_STEP = 1e-3
"""Step, in s, of the difference quotient for the true speed."""

MOVING_MM_S, EARLY = 10.0, 1.2
"""Speed above which the stage moves, and the part of a recording, in s, whose errors are compared with the paper."""

DRAG_RADIUS, VISCOSITY = 1.7e-3, 1.2
"""Of the robot for the tracker, in m and Pa·s."""

TRACKED_SEGMENT = 4
"""Half-periods of the segments that are tracked."""


def make_damped_devices() -> dict[str, Device]:
    """Make the device in air: the paper's exponential fit, and its linear one, which ends after 0.9 s.

    Returns
    -------
    dict of str to Device
    """
    return {
        "exponential": make_characterised_device(1.6, "exponential"),
        "linear": make_characterised_device(1.1, "linear"),
    }


def make_stepping_track(times: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the track of the stage: rest, then a step, eleven places within `SECONDS`; x from -25 to 25 mm.

    Parameters
    ----------
    times : ndarray, shape (n,), in s

    Returns
    -------
    positions : ndarray, shape (n, 3), in m
    orientations : ndarray, shape (n, 4)
    """
    count = round(TRAVEL / STEP)
    pause, move = SECONDS / (count + 1), 2.0 * STEP / TOP_SPEED
    x = np.full_like(times, -0.5 * TRAVEL)
    for i in range(1, count + 1):
        part = np.clip((times - i * pause) / move, 0.0, 1.0)
        x += STEP * (part - np.sin(2 * np.pi * part) / (2 * np.pi))
    y, z = REFERENCE_POSITION[1:]
    places = np.stack([x, np.full_like(x, y), np.full_like(x, z)], axis=-1)
    return places, np.tile(make_reference_orientation(), (len(times), 1))


def run_chunk(chunk: Chunk) -> Columns:
    """Locate one recording on one bench, cut into every segment length.

    Parameters
    ----------
    chunk : Chunk

    Returns
    -------
    Columns
    """
    device = make_damped_devices()[chunk["damping"]]
    bench = open_bench(chunk, device, chunk["mismatch"])
    found = make_localizers(bench, chunk["estimators"])
    half_periods = math.floor(chunk["seconds"] * 2.0 * device.frequency)
    if chunk["moving"]:
        recording = bench.record_track(make_stepping_track, half_periods, RING_DOWN)
    else:
        recording = bench.record(np.array(REFERENCE_POSITION), make_reference_orientation(), half_periods, RING_DOWN)
    rows: list[dict[str, Any]] = []
    kind = {"bench": chunk["bench"], "damping": chunk["damping"], "moving": chunk["moving"]}
    for name, localizer in found.items():
        for length in SEGMENTS:
            poses = localizer.locate_segments(recording, length)
            rows += [
                {**kind, "estimator": name, "half_periods": length, **r} for r in _make_rows(recording, poses, chunk)
            ]
            if name == "whitened" and length == TRACKED_SEGMENT and not chunk["moving"]:
                tracked = _make_rows(recording, _track_poses(localizer, recording, poses), chunk)
                rows += [{**kind, "estimator": "tracked", "half_periods": length, **r} for r in tracked]
    return make_columns(rows)


def _make_rows(recording: Recording, poses: tuple[Pose, ...], chunk: Chunk) -> list[dict[str, Any]]:
    times = np.array([pose.time - recording.clock for pose in poses])
    places = make_stepping_track(times)[0] if chunk["moving"] else np.tile(REFERENCE_POSITION, (len(times), 1))
    speed = np.linalg.norm(
        make_stepping_track(times + SPEED_STEP)[0] - make_stepping_track(times - SPEED_STEP)[0], axis=1
    ) / (2.0 * SPEED_STEP)
    rows = []
    for time, pose, place, pace in zip(times, poses, places, speed if chunk["moving"] else 0.0 * speed, strict=True):
        error = 1e3 * (pose.position - place)
        sigma = 1e3 * np.sqrt(np.diag(pose.covariance)[:3])
        rows.append({
            "time_s": time, "speed_mm_s": 1e3 * pace, "x_mm": 1e3 * (pose.position[0] + 0.5 * TRAVEL),
            "true_x_mm": 1e3 * (place[0] + 0.5 * TRAVEL),
            **{f"error_{axis}_mm": float(error[i]) for i, axis in enumerate("xyz")},
            **{f"sigma_{axis}_mm": float(sigma[i]) for i, axis in enumerate("xyz")},
            "trusted": float(pose.trusted),
        })  # fmt: skip
    return rows


def _track_poses(localizer: Localizer, recording: Recording, poses: tuple[Pose, ...]) -> tuple[Pose, ...]:
    """The same poses through the tracker of a robot that is left alone; each pose itself until it has begun."""
    from smolbot.core.shots import Listen, Shot
    from smolbot.flight.tracking.tracker import Tracker
    from smolbot.motion.robot import Robot

    device = localizer.device
    robot = Robot.in_liquid(
        device.moment, DRAG_RADIUS, VISCOSITY, frequency=device.frequency, l0=device.l0, theta_max=device.theta_max
    )
    tracker = Tracker(robot, device, None)
    shot = Shot((Listen(TRACKED_SEGMENT, device.frequency),))
    return tuple(tracker.update(shot, pose) or pose for pose in poses)


def make_chunks(options: Options) -> list[Chunk]:
    """Make sampled benches: a device at rest, with either damping, and one that steps.

    Parameters
    ----------
    options : Options

    Returns
    -------
    list of Chunk
    """
    scale = 1.0 if options.mismatch is None else options.mismatch
    pieces = []
    for bench in range(options.poses or BENCHES):
        for damping, moving, seconds in (
            ("exponential", False, SECONDS), ("exponential", True, SECONDS), ("linear", False, LINEAR_SECONDS),
        ):  # fmt: skip
            name = f"{damping}-{'steps' if moving else 'rests'}-{bench:02d}"
            arguments = {"bench": bench, "damping": damping, "moving": moving, "seconds": seconds, "mismatch": scale}
            pieces.append((name, arguments))
    return cut_chunks(options, run_chunk, pieces)


def conclude(options: Options, parts: list[Columns]) -> Outcome:
    """Compute sigma over time at rest, the time until it exceeds 1 mm, and errors and outliers while the device steps.

    Parameters
    ----------
    options : Options
    parts : list of Columns
        One per chunk, in order.

    Returns
    -------
    Outcome
    """
    columns = join_columns(parts)
    cases: list[dict[str, Any]] = []
    rows: list[tuple[str, str]] = []
    for damping in dict.fromkeys(columns["damping"].tolist()):
        rows.append((f"at rest, {damping}", "time until sigma of the worst axis exceeds 1 mm"))
        for name in dict.fromkeys(columns["estimator"].tolist()):
            for length in SEGMENTS:
                part = select_rows(columns, damping=damping, moving=False, estimator=name, half_periods=length)
                if not len(part["time_s"]):
                    continue
                case = {
                    "kind": "rest",
                    "damping": damping,
                    "estimator": name,
                    "half_periods": length,
                    **summarize_rest(part),
                }
                cases.append(case)
                rows.append((f"  {name}, N_seg = {length}", _format_rest(case)))
    title = "rms error of x; outliers as in the paper, x < -1 or > 60 mm"
    rows.append((f"stepping at up to {1e3 * TOP_SPEED:g} mm/s", title))
    for name in options.estimators:
        for length in SEGMENTS:
            part = select_rows(columns, moving=True, estimator=name, half_periods=length)
            case = {"kind": "steps", "damping": "exponential", "estimator": name, "half_periods": length}
            case |= summarize_motion(part)
            cases.append(case)
            rows.append((f"  {name}, N_seg = {length}", _format_steps(case)))
    scale = 1.0 if options.mismatch is None else options.mismatch
    rows.append(("mismatch", "none (ideal)" if scale == 0.0 else f"x {scale:g}"))
    return Outcome(rows, {"cases": cases, "mismatch": scale, "benches": len(np.unique(columns["bench"]))}, columns)


def summarize_rest(part: Columns) -> dict[str, Any]:
    """Compute sigma of each axis in bins of time, about each bench's own mean in the bin (at least two segments).

    Parameters
    ----------
    part : Columns

    Returns
    -------
    dict
    """
    length = part["half_periods"][0] / (2.0 * make_characterised_device().frequency)
    width = max(BIN, MIN_SEGMENTS * length)
    number = np.floor(part["time_s"] / width).astype(int)
    errors = stack_position_errors(part)
    times, sigmas, offs = [], [], []
    for n in range(int(number.max()) + 1):
        inside = number == n
        parts = [errors[inside & (part["bench"] == b)] for b in np.unique(part["bench"])]
        parts = [p for p in parts if len(p) > 1]
        if not parts:
            continue
        freedom = sum(len(p) - 1 for p in parts)
        sigmas.append(np.sqrt(sum(np.sum((p - p.mean(axis=0)) ** 2, axis=0) for p in parts) / freedom))
        offs.append(np.sqrt(np.mean(np.concatenate(parts) ** 2, axis=0)))
        times.append((n + 0.5) * width)
    worst = np.max(sigmas, axis=1)
    return {
        "time_s": times,
        "sigma_mm": [s.tolist() for s in sigmas],
        "rms_mm": [o.tolist() for o in offs],
        "under_limit_s": find_crossing(np.array(times), worst),
        "rms_under_limit_s": find_crossing(np.array(times), np.max(offs, axis=1)),
        "lasts_s": float(part["time_s"].max()),
        "rate_hz": 1.0 / length,
    }


def find_crossing(times: FloatArray, sigma: FloatArray, limit: float = LIMIT_MM) -> float | None:
    """Find when sigma first passes the limit, by linear interpolation of its logarithm between bins.

    Parameters
    ----------
    times : ndarray, shape (n,), in s
    sigma : ndarray, shape (n,), in mm
    limit : float, in mm

    Returns
    -------
    float or None
        None if it never does.

    Examples
    --------
    >>> print(round(find_crossing(np.array([0.5, 1.5]), np.array([0.1, 10.0])), 3))
    1.0
    """
    above = np.flatnonzero(sigma > limit)
    if not above.size:
        return None
    i = int(above[0])
    if i == 0:
        return float(times[0])
    a, b = np.log(sigma[i - 1] / limit), np.log(sigma[i] / limit)
    return float(times[i - 1] - a / (b - a) * (times[i] - times[i - 1]))


def summarize_motion(part: Columns) -> dict[str, Any]:
    """Compute errors of x at rest and in motion, and outliers, of a device that steps.

    Parameters
    ----------
    part : Columns

    Returns
    -------
    dict
    """
    x, error, moves = part["x_mm"], part["error_x_mm"], part["speed_mm_s"] > MOVING_MM_S
    outside = (x < OUTLIERS_MM[0]) | (x > OUTLIERS_MM[1])
    early = part["time_s"] < EARLY
    return {
        "n": len(x),
        "outliers": int(outside.sum()),
        "rest_rms_mm": compute_rms(error[early & ~moves]),
        "move_rms_mm": compute_rms(error[early & moves]),
        "move_z_mm": compute_rms(part["error_z_mm"][early & moves]),
        "rms_to_the_end_mm": compute_rms(error[~outside]),
        "trusted": float(part["trusted"].mean()),
    }


def _format_rest(case: dict[str, Any]) -> str:
    until, absolute = case["under_limit_s"], case["rms_under_limit_s"]
    first = case["sigma_mm"][0]
    lasting = f"{until:.2f} s" if until is not None else f"never, over {case['lasts_s']:.2f} s"
    last = max(case["rms_mm"][-1])
    near = f"{absolute:.2f} s" if absolute is not None else f"never, {last:.2f} mm at last"
    return f"{lasting} ({case['rate_hz']:.1f} poses/s; at first {max(first):.3f} mm; rms error: {near})"


def _format_steps(case: dict[str, Any]) -> str:
    return (
        f"first {EARLY:g} s: {case['rest_rms_mm']:.2f} mm at rest, {case['move_rms_mm']:.2f} mm moving (z "
        f"{case['move_z_mm']:.2f} mm); to {SECONDS:g} s {case['rms_to_the_end_mm']:.2f} mm; {case['outliers']} of "
        f"{case['n']} outliers"
    )


def draw(outcome: Outcome, path: Path) -> None:
    """Draw the steps as localized, and sigma over time.

    Parameters
    ----------
    outcome : Outcome
    path : Path
        PNG to write.
    """
    from sim.batch.slide import COLORS, LIMIT, OTHERS, label_line, open_slide, set_titles

    cases, columns = outcome.figures["cases"], outcome.columns
    best = str(next(n for n in ("whitened", "paper") if n in columns["estimator"]))
    case = _find_rest_case(cases, best, 4)
    until = case["under_limit_s"]
    headline = f"Superfast, 51.8 poses/s from one excitation: under 1 mm for {until or case['lasts_s']:.1f} s"
    scale = outcome.figures["mismatch"]
    label = f"mismatches x {scale:g}" if scale else "ideal: all mismatches off"
    subline = "z = 80 mm, exponential damping 1.6 1/s, steps of 5 mm at up to 200 mm/s; "
    subline += f"{outcome.figures['benches']} benches, {label}"
    with open_slide(path, headline, subline, 1, 2, width_ratios=[1.25, 1.0]) as (left, right):
        selected = select_rows(columns, moving=True, estimator=best, half_periods=4)
        one = select_rows(selected, bench=selected["bench"][0])
        fine = np.linspace(0.0, SECONDS, 1200)
        left.plot(fine, 1e3 * (make_stepping_track(fine)[0][:, 0] + 0.5 * TRAVEL), color="#222222", lw=1.6, zorder=1)
        left.plot(one["time_s"], np.clip(one["x_mm"], -8, 66), "o", ms=4.5, color=COLORS[best], alpha=0.85, mew=0)
        left.set(ylim=(-8, 66), xlim=(0, SECONDS))
        label_line(left, 0.1, 58, f"{best}, N_seg = 4", COLORS[best])
        label_line(left, 0.1, 53, "stage", "#222222")
        set_titles(left, "Position along the motion, in mm", "time since the first sample, in s")
        labels: list[tuple[float, str, str]] = []
        for length, shade in zip(SEGMENTS, OTHERS, strict=True):
            line = _find_rest_case(cases, best, length)
            worst = np.max(line["sigma_mm"], axis=1)
            right.plot(line["time_s"], worst, lw=2.2, color=shade)
            labels.append((float(worst[-1]), f"N_seg = {length}", shade))
        for name, color, text in (("paper", COLORS["paper"], "paper, 4"), ("tracked", "#222222", "4, tracked, rms")):
            if name != best and name in columns["estimator"]:
                line = _find_rest_case(cases, name, 4)
                # for the tracker its rms error: the scatter of a filter within a bin is not its uncertainty
                worst = np.max(line["rms_mm" if name == "tracked" else "sigma_mm"], axis=1)
                right.plot(line["time_s"], worst, lw=2, ls="--", color=color)
                labels.append((float(worst[-1]), text, color))
        height = 0.0
        for value, text, color in sorted(labels):
            height = max(value, 1.32 * height)  # labels must not overlap
            label_line(right, SECONDS, height, text, color)
        right.set(yscale="log", xlim=(0, 1.32 * SECONDS), ylim=(0.05, 20))
        right.set_yticks([0.1, 1, 10], ["0.1", "1", "10"])
        right.set_xticks([0, 0.5, 1, 1.5, 2])
        right.axhline(LIMIT_MM, color=LIMIT, lw=1, ls="--", zorder=0)
        set_titles(right, "Sigma of the worst axis at rest, in mm", "time since the first sample, in s")


def _find_rest_case(cases: list[dict[str, Any]], estimator: str, length: int) -> dict[str, Any]:
    key = {"kind": "rest", "damping": "exponential", "estimator": estimator, "half_periods": length}
    return next(c for c in cases if key.items() <= c.items())


STUDY = Study(
    name="superfast",
    title="Superfast: one excitation cut into segments",
    devices=make_damped_devices,
    chunks=make_chunks,
    conclude=conclude,
    draw=draw,
    notes={
        "segments": SEGMENTS,
        "ring_down_s": RING_DOWN,
        "stage": "11 places 5 mm apart, each step 50 ms, at most 200 mm/s",
        "outliers": "x < -1 mm or > 60 mm from the start of the motion",
    },
)
