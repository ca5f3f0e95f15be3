"""Differential accuracy over translations and rotations, as measured on the paper's stages (Figs. 2A-D, S4, S5)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from sim.studies.benches import (
    FLIP_DEG,
    QUIET_SECONDS,
    REFERENCE_POSITION,
    make_characterised_device,
    make_localizers,
    make_pose_row,
    make_reference_orientation,
    open_bench,
    sample_prior,
)
from sim.studies.columns import join_columns, make_columns, select_rows
from sim.studies.study import Chunk, Columns, Options, Outcome, Study, cut_chunks, make_rng
from sim.tank.static_bench import StaticBench
from smolbot.core.arrays import FloatArray
from smolbot.core.pose import Pose
from smolbot.core.rotations import multiply_quaternions, quaternion_from_rotation_vector
from smolbot.core.sensing import Recording
from smolbot.localization.array.calibration import ArrayCalibration, calibrate_sensors
from smolbot.localization.device.ringdown import measure_ring_down
from smolbot.localization.localizer import Localizer
from smolbot.localization.noise.model import NoiseModel
from smolbot.localization.statistics import (
    compute_circular_standard_deviation,
    compute_differential_circular_mae,
    compute_differential_mae,
    compute_standard_deviation,
)

AXES = ("x", "y", "z", "rx", "ry", "rz")
WIDE, FINE = "wide", "fine"
HALF_PERIODS = {WIDE: 2, FINE: 20}
REPEATS = 20
BENCHES = {"ideal": 4, "mismatched": 12, "calibrated": 12}
STAGE_POSES = 60
STAGE_HALF_PERIODS = 20
RINGS, RING_HALF_PERIODS = 8, 80
"""Recordings from which frequency and damping are calibrated, and their half-periods."""

STAGE_WIDTH, STAGE_HEIGHTS = 0.03, (0.055, 0.095)
"""Half width, and lowest and highest z, of the stage poses, in m."""


def list_steps(axis: str, span: str) -> FloatArray:
    """Return true displacements from the reference; the reference (0) is among them.

    Parameters
    ----------
    axis : str
    span : str

    Returns
    -------
    ndarray, shape (n,), in m or rad
    """
    if len(axis) == 2:
        return np.radians(np.arange(0.0, 360.0, 20.0) if span == WIDE else np.arange(0.0, 5.1, 1.0))
    if span == FINE:
        return 1e-3 * np.arange(0.0, 1.01, 0.2)
    return 1e-3 * (np.arange(-10.0, 40.1, 5.0) if axis == "z" else np.arange(-25.0, 25.1, 5.0))


def displace_pose(axis: str, step: float) -> tuple[FloatArray, FloatArray]:
    """Return the pose after a displacement: translations along world axes, rotations about the device's own.

    Parameters
    ----------
    axis : str
    step : float, in m or rad

    Returns
    -------
    position : ndarray, shape (3,), in m
    orientation : ndarray, shape (4,)
    """
    position, orientation = np.array(REFERENCE_POSITION), make_reference_orientation()
    along = np.eye(3)["xyz".index(axis[-1])]
    if len(axis) == 1:
        return position + step * along, orientation
    return position, multiply_quaternions(orientation, quaternion_from_rotation_vector(step * along))


def measure_displacement(axis: str, pose: Pose) -> float:
    """Return the displacement along or about `axis` that a pose measures.

    Parameters
    ----------
    axis : str
    pose : Pose

    Returns
    -------
    float, in m, or in rad about the reference's own axis
    """
    index = "xyz".index(axis[-1])
    if len(axis) == 1:
        return float(pose.position[index] - REFERENCE_POSITION[index])
    w, *v = make_reference_orientation()
    relative = multiply_quaternions(np.array([w, *(-np.array(v))]), np.array(pose.orientation))
    return float(2.0 * np.arctan2(relative[1 + index], relative[0]))


def run_chunk(chunk: Chunk) -> Columns:
    """Measure every axis and span on one bench, each step `repeats` times.

    Parameters
    ----------
    chunk : Chunk

    Returns
    -------
    Columns
    """
    kind = chunk["kind"]
    bench = open_bench(chunk, make_characterised_device(), chunk["mismatch"])
    rng = make_rng(chunk)
    found: Mapping[str, Localizer]
    correction: ArrayCalibration | None = None
    if kind == "calibrated":
        found, correction = calibrate_localizers(bench, chunk["estimators"], rng)
    else:
        found = make_localizers(bench, chunk["estimators"])
    rows: list[dict[str, Any]] = []
    for span, half_periods in HALF_PERIODS.items():
        for axis in AXES:
            for step in list_steps(axis, span):
                position, orientation = displace_pose(axis, float(step))
                for _ in range(chunk["repeats"]):
                    recording = bench.record(position, orientation, half_periods)
                    if correction is not None:
                        recording = correction.correct_recording(recording)
                    prior = sample_prior(position, orientation, rng)
                    for name, localizer in found.items():
                        pose = localizer.locate(recording, prior)
                        rows.append(
                            {
                                "kind": kind,
                                "bench": chunk["bench"],
                                "estimator": name,
                                "span": span,
                                "axis": axis,
                                "true": float(step),
                                "measured": measure_displacement(axis, pose),
                                **make_pose_row(pose, position, orientation),
                            }
                        )
    return make_columns(rows)


def calibrate_localizers(
    bench: StaticBench, estimators: Any, rng: np.random.Generator
) -> tuple[dict[str, Localizer], ArrayCalibration]:
    """Make localizers after a calibration on a stage: resonance, damping, gains, axes and positions.

    The stage visits random positions and headings in the volume, none of them the study's own.

    Parameters
    ----------
    bench : StaticBench
    estimators : sequence of str
    rng : numpy.random.Generator

    Returns
    -------
    localizers : dict of str to Localizer
    correction : ArrayCalibration
    """
    places, turns = np.array(REFERENCE_POSITION), make_reference_orientation()
    long = [bench.record(places, turns, RING_HALF_PERIODS) for _ in range(RINGS)]
    rang = [measure_ring_down(recording, bench.sensors, bench.device) for recording in long]
    device = replace(
        bench.device,
        frequency=float(np.mean([r.frequency for r in rang])),
        damping=float(np.mean([r.damping for r in rang])),
    )
    track: list[Pose] = []
    recordings: list[Recording] = []
    for _ in range(STAGE_POSES):
        position = np.array([*rng.uniform(-STAGE_WIDTH, STAGE_WIDTH, 2), rng.uniform(*STAGE_HEIGHTS)])
        turn = rng.standard_normal(4)
        orientation = turn / np.linalg.norm(turn)
        recordings.append(bench.record(position, orientation, STAGE_HALF_PERIODS))
        track.append(Pose(recordings[-1].middle, position, orientation, np.eye(6) * 1e-12))
    correction = calibrate_sensors(recordings, track, bench.sensors, device)
    noise = NoiseModel.learn([correction.correct_recording(q) for q in bench.record_background(QUIET_SECONDS)])
    return {e: Localizer(correction.sensors, device, noise, e) for e in estimators}, correction


def make_chunks(options: Options) -> list[Chunk]:
    """Make one chunk per bench; `poses` is the number of repeats of each step.

    Parameters
    ----------
    options : Options

    Returns
    -------
    list of Chunk
    """
    repeats = options.poses or REPEATS
    scale = 1.0 if options.mismatch is None else options.mismatch
    kinds = ("ideal", "mismatched", "calibrated") if scale > 0 else ("ideal",)
    pieces = [
        (
            f"{kind}-{i:02d}",
            {"kind": kind, "mismatch": 0.0 if kind == "ideal" else scale, "repeats": repeats, "bench": i},
        )
        for kind in kinds
        for i in range(max(BENCHES[kind] * min(repeats, REPEATS) // REPEATS, 1))
    ]
    return cut_chunks(options, run_chunk, pieces)


def conclude(options: Options, parts: list[Columns]) -> Outcome:
    """Compute mean absolute error and standard deviation per axis, averaged over benches.

    Each bench has its own reference.

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
    figures: dict[str, Any] = {"cases": []}
    rows: list[tuple[str, str]] = []
    for kind in dict.fromkeys(columns["kind"].tolist()):
        for name in options.estimators:
            for span in (WIDE, FINE):
                case = summarize_case(select_rows(columns, kind=kind, estimator=name, span=span))
                figures["cases"].append({"kind": kind, "estimator": name, "span": span, **case})
                rows.append((f"{kind}, {name}, N = {HALF_PERIODS[span]}", format_case(case)))
    return Outcome(rows, figures, columns)


def summarize_case(columns: Columns) -> dict[str, Any]:
    """Compute the figures of one estimator on all benches of one kind, over one span.

    Parameters
    ----------
    columns : Columns

    Returns
    -------
    dict
    """
    benches = np.unique(columns["bench"])
    mae: dict[str, list[float]] = {axis: [] for axis in AXES}
    sigma: dict[str, list[float]] = {axis: [] for axis in AXES}
    for axis in AXES:
        for bench in benches:
            part = select_rows(columns, axis=axis, bench=bench)
            places = np.unique(part["true"])
            measured = np.stack([part["measured"][part["true"] == p] for p in places], axis=1)  # (repeats, places)
            truth = np.broadcast_to(places, measured.shape)
            reference = part["measured"][part["true"] == 0.0]
            if len(axis) == 1:
                mae[axis].append(1e3 * compute_differential_mae(measured, truth, reference))
                sigma[axis].append(1e3 * compute_standard_deviation(measured) if measured.size > 1 else np.nan)
            else:
                error = compute_differential_circular_mae(measured, truth, reference)
                mae[axis].append(float(np.degrees(error)))
                sigma[axis].append(float(np.degrees(compute_circular_standard_deviation(measured))))
    untrusted = int(np.sum(columns["trusted"] == 0.0))
    flipped = int(np.sum(np.max(np.abs([columns[f"error_r{a}_deg"] for a in "xyz"]), axis=0) > FLIP_DEG))
    mean = {axis: float(np.mean(mae[axis])) for axis in AXES}
    return {
        "benches": len(benches),
        "poses": len(columns["nees"]),
        "untrusted": untrusted,
        "flipped": flipped,
        "mae": mean,
        "std": {axis: float(np.mean(sigma[axis])) for axis in AXES},
        "mae_by_bench": mae,
        "mae_position_mm": float(np.mean([mean[a] for a in AXES[:3]])),
        "mae_rotation_deg": float(np.mean([mean[a] for a in AXES[3:]])),
        "std_position_mm": float(np.mean([np.mean(sigma[a]) for a in AXES[:3]])),
        "std_rotation_deg": float(np.mean([np.mean(sigma[a]) for a in AXES[3:]])),
    }


def format_case(case: dict[str, Any]) -> str:
    """Format one row of the table.

    Parameters
    ----------
    case : dict

    Returns
    -------
    str
    """
    each = ", ".join(f"{axis} {case['mae'][axis]:.3f}" for axis in AXES)
    left_out = f"; {case['untrusted']} of {case['poses']} untrusted" if case["untrusted"] else ""
    left_out += f"; {case['flipped']} flipped" if case["flipped"] else ""
    return (
        f"MAE {case['mae_position_mm']:.3f} mm, {case['mae_rotation_deg']:.2f} deg "
        f"(std {case['std_position_mm']:.3f} mm, {case['std_rotation_deg']:.2f} deg); {each}{left_out}"
    )


def draw(outcome: Outcome, path: Path) -> None:
    """Draw the error against the true displacement for each axis over the wide span, and bars of all errors.

    Parameters
    ----------
    outcome : Outcome
    path : Path
        PNG to write.
    """
    from sim.batch.slide import COLORS, open_slide, set_titles

    cases = outcome.figures["cases"]
    name = cases[0]["estimator"]
    kinds = list(dict.fromkeys(c["kind"] for c in cases))
    last = next(c for c in cases if c["kind"] == kinds[-1] and c["estimator"] == name and c["span"] == WIDE)
    shade = {"ideal": "#b9bec7", "mismatched": COLORS["paper"], "calibrated": COLORS["whitened"]}
    headline = (
        f"{kinds[-1]}: {last['mae_position_mm']:.2f} mm and {last['mae_rotation_deg']:.2f}° over 50 mm and 360°, N = 2"
    )
    subline = (
        f"{name}; differences from the reference at (0, 0, 80 mm), mean of the repeats, one line per bench; "
        "the paper: 0.47 mm, 2.14°"
    )
    with open_slide(path, headline, subline, 2, 4, width_ratios=[1, 1, 1, 0.9], wspace=0.34) as axes:
        for index, axis in enumerate(AXES):
            panel = axes[index // 3 * 4 + index % 3]
            unit = 1e3 if len(axis) == 1 else float(np.degrees(1.0))
            for kind in reversed(kinds):
                part = select_rows(outcome.columns, kind=kind, estimator=name, span=WIDE, axis=axis)
                for bench in np.unique(part["bench"]):
                    own = select_rows(part, bench=bench)
                    off = own["measured"] - own["true"]
                    if len(axis) == 2:
                        off = np.angle(np.exp(1j * off))
                    places = np.unique(own["true"])
                    means = np.array([off[own["true"] == p].mean() for p in places])
                    means -= means[np.argmin(np.abs(places))]
                    panel.plot(unit * places, unit * means, "-", color=shade[kind], lw=1.0, alpha=0.55,
                               label=kind if bench == part["bench"][0] else None)  # fmt: skip
            what = f"Error along {axis}, in mm" if len(axis) == 1 else f"About body {axis[1]}, in degrees"
            set_titles(panel, what)
            if len(axis) == 2:
                panel.set_xticks([0, 90, 180, 270])
            if index == 0:
                panel.legend(frameon=False, fontsize=9, loc="best")
        for panel, key, what in ((axes[3], "mae_position_mm", "mm"), (axes[7], "mae_rotation_deg", "degrees")):
            for offset, span in enumerate((WIDE, FINE)):
                values = [next(c for c in cases if c["kind"] == k and c["estimator"] == name and c["span"] == span)[key]
                          for k in kinds]  # fmt: skip
                places = np.arange(len(kinds)) + offset * (len(kinds) + 0.7)
                panel.bar(places, values, color=[shade[k] for k in kinds], width=0.85)
                for p, v in zip(places, values, strict=True):
                    text = f"{v:.2f}" if v >= 0.1 else f"{v:.3f}"
                    panel.text(p, v, text.removeprefix("0"), ha="center", va="bottom", fontsize=9)
            middle = (len(kinds) - 1) / 2
            panel.set_xticks([middle, middle + len(kinds) + 0.7], ["N = 2, wide", "N = 20, fine"])
            panel.margins(y=0.12)
            set_titles(panel, f"MAE in {what}")


STUDY = Study(
    name="accuracy",
    title="Differential accuracy over translations and rotations",
    devices=lambda: {"characterised": make_characterised_device()},
    chunks=make_chunks,
    conclude=conclude,
    draw=draw,
    notes={
        "reference_mm": [0, 0, 80],
        "wide": "x and y -25..25 mm, z 70..120 mm in 5 mm steps, 360 deg in 20 deg steps about each own axis, N = 2",
        "fine": "1 mm in 0.2 mm steps, 5 deg in 1 deg steps, N = 20",
        "calibrated": f"{STAGE_POSES} stage poses in |x|, |y| < 30 mm, 55 < z < 95 mm, any heading",
    },
)
