"""Computing time of a pose: warm, against the same fit in numpy and scipy, and in a Monte-Carlo study."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from functools import partial
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
    sample_prior,
)
from sim.studies.running import open_study_executor, run_chunks
from sim.studies.study import Chunk, Columns, Options, Outcome, Study, cut_chunks, make_rng
from smolbot.core.arrays import FloatArray
from smolbot.core.pose import Pose
from smolbot.core.rotations import multiply_quaternions, quaternion_from_rotation_vector
from smolbot.core.sensing import Recording
from smolbot.localization.forward import compute_deflection, compute_sensor_field
from smolbot.localization.localizer import Localizer

HALF_PERIODS = (2, 20)
SCALES = np.array([1e-3, 1e-3, 1e-3, 0.1, 0.1, 0.1, 0.1, 0.05])
"""Units of the reference fit's parameters: m, rad, rad of phase, rad of amplitude."""

REPEATS = {2: (300, 12), 20: (100, 6)}
"""Timed poses of `locate` and of the reference fit, for each number of half-periods."""

LEAD = 0.003
"""Time, in s, computed before the first sample: the low pass starts in steady state."""

RECORDINGS, COLD_REPEATS, COMPARED, WARM_UP = 50, 6, 5, 20
"""Recordings used in turn, timed cold starts, poses compared with the reference fit, and poses before timing."""

MAX_JOBS, DEFAULT_POSES = 2, 2000
"""Processes of the Monte-Carlo run, and poses of each."""


def fit_plainly(localizer: Localizer, recording: Recording, prior: Pose) -> tuple[FloatArray, FloatArray]:
    """Fit as one would write it first: numpy, and scipy's Levenberg-Marquardt with finite differences.

    Same data, same whitening, same eight unknowns and prior of the amplitude. The model is evaluated at every sample,
    low-passed as the sensors are, averaged over the same blocks.

    Parameters
    ----------
    localizer : Localizer
    recording : Recording
    prior : Pose

    Returns
    -------
    position : ndarray, shape (3,), in m
    orientation : ndarray, shape (4,)
    """
    from scipy.optimize import least_squares
    from scipy.signal import lfilter

    problem = localizer.prepare(recording)
    model, device = problem.model, localizer.device
    rate, n = recording.sample_rate, recording.field.shape[1]
    lead = int(LEAD * rate)
    times = recording.time_since_drive + np.arange(-lead, n) / rate
    keep = np.exp(-2 * np.pi * localizer.sensors.bandwidth / rate)
    size = model.chain.weights.shape[1]
    count = len(model.chain.first)
    mean, std = device.amplitude_prior
    start, _ = problem.estimate_phase_and_amplitude(prior.position, prior.rotation)

    def unpack(x: FloatArray) -> tuple[FloatArray, FloatArray, float, float]:
        move = x * SCALES
        turned = multiply_quaternions(quaternion_from_rotation_vector(move[3:6]), np.array(prior.orientation))
        return prior.position + move[:3], turned, start + float(move[6]), mean + float(move[7])

    def residual(x: FloatArray) -> FloatArray:
        position, orientation, phase, amplitude = unpack(x)
        field = compute_sensor_field(
            localizer.sensors, device, position, orientation, compute_deflection(device, times, amplitude, phase)
        )
        low = lfilter([0.5 * (1 - keep), 0.5 * (1 - keep)], [1.0, -keep], field - field[:, :1], axis=1)[:, lead:]
        blocks = low[:, : count * size].reshape(len(low), count, size).mean(axis=2)
        whitened = model.mixing @ blocks.reshape(-1) - problem.data
        return np.append(whitened, (amplitude - mean) / std)

    found = least_squares(residual, np.zeros(8), method="lm")
    position, orientation, _, _ = unpack(found.x)
    return position, orientation


def measure_seconds(action: Callable[[int], Any], repeats: int) -> FloatArray:
    """Measure processor times of single calls; the first, to warm up, is not counted.

    Other programs that share the core do not enter.

    Parameters
    ----------
    action : callable
        Called with the number of the call.
    repeats : int

    Returns
    -------
    ndarray, shape (repeats,), in s
    """
    action(0)
    out = np.empty(repeats)
    for i in range(repeats):
        begin = time.thread_time_ns()
        action(i)
        out[i] = 1e-9 * (time.thread_time_ns() - begin)
    return out


def run_chunk(chunk: Chunk) -> Columns:
    """Measure times on this core, then the throughput of a Monte-Carlo on two.

    Parameters
    ----------
    chunk : Chunk

    Returns
    -------
    Columns
    """
    bench = open_bench(chunk, make_characterised_device(), 0.0)
    found, rng = make_localizers(bench, ("whitened", "paper")), make_rng(chunk)
    position, orientation = np.array(REFERENCE_POSITION), make_reference_orientation()
    out: Columns = {}
    for n in HALF_PERIODS:
        fast, slow = REPEATS[n]
        recordings = [bench.record(position, orientation, n, RING_DOWN) for _ in range(min(fast, RECORDINGS))]
        priors = [sample_prior(position, orientation, rng) for _ in recordings]
        for name, localizer in found.items():
            locate = partial(_locate, localizer, recordings, priors)
            out[f"_{name}_{n}"] = measure_seconds(locate, fast)
            cold = partial(_locate, localizer, recordings, [None] * len(recordings))
            out[f"_{name}_cold_{n}"] = measure_seconds(cold, COLD_REPEATS)
        plain = partial(_fit_plainly_at, found["whitened"], recordings, priors)
        out[f"_plain_{n}"] = measure_seconds(plain, slow)
        apart = []
        for recording, prior in zip(recordings[:COMPARED], priors[:COMPARED], strict=True):
            ours = found["whitened"].locate(recording, prior)
            apart.append(np.abs(fit_plainly(found["whitened"], recording, prior)[0] - ours.position).max())
        out[f"_apart_{n}"] = np.array(apart)
    out |= measure_throughput(chunk)
    return out


def _locate(localizer: Localizer, recordings: list[Recording], priors: Sequence[Pose | None], i: int) -> Pose:
    return localizer.locate(recordings[i % len(recordings)], priors[i % len(priors)])


def _fit_plainly_at(
    localizer: Localizer, recordings: list[Recording], priors: list[Pose], i: int
) -> tuple[FloatArray, FloatArray]:
    return fit_plainly(localizer, recordings[i % len(recordings)], priors[i % len(priors)])


def run_monte_carlo(chunk: Chunk) -> Columns:
    """Record and locate at N = 2, as every study does, and measure the time; learning of the noise is left out.

    Parameters
    ----------
    chunk : Chunk

    Returns
    -------
    Columns
    """
    bench = open_bench(chunk, make_characterised_device(), 0.0)
    localizer = make_localizers(bench, ("whitened",))["whitened"]
    position, orientation = np.array(REFERENCE_POSITION), make_reference_orientation()
    prior = sample_prior(position, orientation, make_rng(chunk))
    for _ in range(WARM_UP):
        localizer.locate(bench.record(position, orientation, 2), prior)
    wall, processor = time.perf_counter(), time.thread_time()
    begun = time.time()
    for _ in range(chunk["poses"]):
        localizer.locate(bench.record(position, orientation, 2), prior)
    return {
        "_wall": np.array([time.perf_counter() - wall]),
        "_processor": np.array([time.thread_time() - processor]),
        "_span": np.array([[begun, time.time()]]),
    }


def measure_throughput(chunk: Chunk) -> Columns:
    """Measure poses per second of a Monte-Carlo over two processes.

    Parameters
    ----------
    chunk : Chunk

    Returns
    -------
    Columns
    """
    jobs = min(MAX_JOBS, os.cpu_count() or 1)
    options = Options("speed", chunk.seed % 2**32, jobs, rig=chunk["rig"])
    pieces = cut_chunks(options, run_monte_carlo, [(f"throughput-{i}", {"poses": chunk["poses"]}) for i in range(jobs)])
    with open_study_executor(jobs) as executor:
        parts = run_chunks(pieces, None, executor)
    spans = np.concatenate([p["_span"] for p in parts])
    return {
        "_poses": np.array([jobs * chunk["poses"]]),
        "_jobs": np.array([jobs]),
        "_wall": np.array([spans[:, 1].max() - spans[:, 0].min()]),
        "_processor": np.concatenate([p["_processor"] for p in parts]),
    }


def make_chunks(options: Options) -> list[Chunk]:
    """Make one chunk, which runs in this process: times are of one core.

    Parameters
    ----------
    options : Options

    Returns
    -------
    list of Chunk
    """
    return cut_chunks(options, run_chunk, [("speed", {"poses": options.poses or DEFAULT_POSES})])


def conclude(options: Options, parts: list[Columns]) -> Outcome:
    """Compute medians and ratios.

    Parameters
    ----------
    options : Options
    parts : list of Columns
        One per chunk, in order.

    Returns
    -------
    Outcome
    """
    part = parts[0]
    figures: dict[str, Any] = {"cases": []}
    rows: list[tuple[str, str]] = []
    for n in HALF_PERIODS:
        ms = {key: 1e3 * float(np.median(part[f"_{key}_{n}"])) for key in ("whitened", "paper", "plain")}
        least = 1e3 * float(np.min(part[f"_whitened_{n}"]))
        p95 = 1e3 * float(np.percentile(part[f"_whitened_{n}"], 95))
        cold = 1e3 * float(np.median(part[f"_whitened_cold_{n}"]))
        ratio, apart = ms["plain"] / ms["whitened"], 1e6 * float(np.max(part[f"_apart_{n}"]))
        figures["cases"].append(
            {"half_periods": n, "locate_ms": ms["whitened"], "locate_least_ms": least, "locate_p95_ms": p95,
             "cold_ms": cold, "paper_ms": ms["paper"], "plain_ms": ms["plain"], "ratio": ratio, "apart_um": apart}
        )  # fmt: skip
        rows += [
            (
                f"locate, N = {n}",
                f"{ms['whitened']:.3f} ms (minimum {least:.3f} ms, p95 {p95:.3f} ms), cold {cold:.1f} ms; "
                f"estimator paper {ms['paper']:.3f} ms",
            ),
            (
                f"numpy and scipy, N = {n}",
                f"{ms['plain']:.1f} ms, {ratio:.0f} times as long; poses {apart:.2f} µm apart",
            ),
        ]
    poses, jobs = int(part["_poses"][0]), int(part["_jobs"][0])
    wall, each = float(part["_wall"][0]), float(np.mean(part["_processor"])) / poses * jobs
    figures |= {
        "jobs": jobs,
        "monte_carlo_poses_per_s": poses / wall,
        "monte_carlo_poses_per_processor_s": 1.0 / each,
        "load_average": os.getloadavg()[0],
    }
    rows.append(
        (
            "Monte-Carlo, N = 2",
            f"{poses / wall:.0f} poses/s with {jobs} processes; {1.0 / each:.0f} per second of processor time",
        )
    )
    rows.append(
        ("load average", f"{os.getloadavg()[0]:.1f}, with other programs; times are processor time, not wall time")
    )
    columns = {key: np.array([c[key] for c in figures["cases"]]) for key in figures["cases"][0]}
    return Outcome(rows, figures, columns)


def draw(outcome: Outcome, path: Path) -> None:
    """Draw bars on a logarithmic scale.

    Parameters
    ----------
    outcome : Outcome
    path : Path
        PNG to write.
    """
    from sim.batch.slide import BOUND, COLORS, LIMIT, open_slide, set_titles

    cases = outcome.figures["cases"]
    fast, ratio = cases[0]["locate_ms"], cases[0]["ratio"]
    headline = f"A pose in {fast:.2f} ms, {ratio:.0f} times as fast as the same fit in numpy and scipy"
    subline = (
        f"warm, raw samples to pose with covariance, one core; Monte-Carlo with recording: "
        f"{outcome.figures['monte_carlo_poses_per_processor_s']:.0f} poses per second of processor time"
    )
    with open_slide(path, headline, subline, 1, 2) as axes:
        for panel, case, limits in zip(axes, cases, ((1.0, 50.0), (3.0, 360.0)), strict=True):
            names = ["smolbot", "estimator paper,\nin smolbot", "numpy and scipy"]
            values = [case["locate_ms"], case["paper_ms"], case["plain_ms"]]
            panel.bar(names, values, color=[COLORS["whitened"], COLORS["paper"], BOUND], width=0.6)
            for i, v in enumerate(values):
                panel.text(i, v * 1.07, f"{v:.2f} ms" if v < 10 else f"{v:.0f} ms", ha="center", fontweight="bold")
            panel.set_yscale("log")
            panel.set_ylim(0.05, 2000)
            panel.set_yticks([0.1, 1, 10, 100, 1000], ["0.1", "1", "10", "100", "1000"])
            panel.set_xlim(-1.25, 2.5)
            paper = "40 to 60 ms" if limits[1] == 50.0 else "360 ms"
            for value, text in ((limits[0], f"goal:\n{limits[0]:g} ms"), (limits[1], f"the paper:\n{paper}")):
                panel.axhline(value, color=LIMIT, lw=1, ls="--", zorder=0)
                panel.text(-1.2, value * 1.1, text, color="#777777", fontsize=10, va="bottom")
            set_titles(panel, f"Time of one pose in ms, N = {case['half_periods']}")


STUDY = Study(
    name="speed",
    title="Time of a pose",
    devices=lambda: {"characterised": make_characterised_device()},
    chunks=make_chunks,
    conclude=conclude,
    draw=draw,
    estimators=("whitened",),
    notes={"clock": "processor time of the thread", "plain": "numpy model, scipy.optimize.least_squares(method='lm')"},
)
