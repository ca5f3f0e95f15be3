"""A magnetic tool passes by: SMOL against static magnets localized by their own field (Fig. S10)."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from sim.studies.benches import (
    load_rig_once,
    make_characterised_device,
    make_localizers,
    make_reference_orientation,
    open_bench,
    sample_prior,
)
from sim.studies.columns import join_columns, make_columns, select_rows
from sim.studies.study import Chunk, Columns, Options, Outcome, Study, cut_chunks, make_rng, split_evenly
from sim.tank.static_bench import Disturbance, StaticBench
from smolbot.config.rig import RigConfig
from smolbot.core.arrays import FloatArray
from smolbot.core.rotations import matrix_from_quaternion
from smolbot.core.sensing import Device, SensorArray
from smolbot.localization.array.fit import compute_transverse_axes
from smolbot.localization.forward import compute_dipole_field
from smolbot.localization.statistics import compute_differential_mae

HEIGHTS = (0.080, 0.085, 0.090, 0.095, 0.100)
"""Heights of the device above the sensors, in m."""

REPEATS = 20
HALF_PERIODS = 10

SCALPEL_MOMENT = np.array([0.0, 0.0, 15.97e-3])
"""Moment of the scalpel, in A·m²: upright, as it is held, which is the worst case for the field at the sensors."""

SCALPEL_SPEED = 0.030
"""Speed of the scalpel toward -y, in m/s."""

SCALPEL_PLACE = (0.040, 0.080)
"""x and z of the scalpel, in m."""

FIRST_START, START_STEP = 0.040, 0.004
"""y of the scalpel at the start of the first repeat, and its advance from one repeat to the next, in m."""

MAGNETS = (0.89e-3, 3.0e-3, 10.0e-3)
"""Moments of the static magnets in A·m²: the device's own, a cube of 1.4 mm, and one of 2.1 mm (N52)."""

STATIC_SECONDS = 0.1
"""Length of a recording of a static magnet, in s."""

PLACE_SCALE, FIELD_SCALE = 0.01, 1e9
"""Units of the fit: position in 10 mm, field in nT."""

REPEATS_PER_CHUNK = 5


def make_disturbance(repeat: int) -> Disturbance:
    """Return the field of the passing scalpel in one repeat.

    Parameters
    ----------
    repeat : int

    Returns
    -------
    Disturbance
    """
    return partial(_compute_scalpel_field, FIRST_START - repeat * START_STEP)


def _compute_scalpel_field(start: float, times: FloatArray, places: FloatArray) -> FloatArray:
    x, z = SCALPEL_PLACE
    y = start - SCALPEL_SPEED * times
    track = np.stack([np.full_like(y, x), y, np.full_like(y, z)], axis=-1)
    return compute_dipole_field(places[:, None, :] - track[None], SCALPEL_MOMENT)


def run_chunk(chunk: Chunk) -> Columns:
    """Localize with SMOL and with static magnets in some repeats at every height, with and without scalpel.

    Parameters
    ----------
    chunk : Chunk

    Returns
    -------
    Columns
    """
    rng = make_rng(chunk)
    orientation = make_reference_orientation()
    bench = open_bench(chunk, make_characterised_device(), chunk["mismatch"])
    found = make_localizers(bench, chunk["estimators"])
    magnets = [_make_magnet_bench(chunk, moment) for moment in MAGNETS]
    rows: list[dict[str, Any]] = []
    for repeat in range(chunk["first"], chunk["first"] + chunk["repeats"]):
        for height in HEIGHTS:
            position = np.array([0.0, 0.0, height])
            for passing in (False, True):
                disturbance = make_disturbance(repeat) if passing else None
                case = {"bench": chunk["first"], "repeat": repeat, "height_mm": 1e3 * height, "scalpel": passing}
                recording = bench.record(position, orientation, HALF_PERIODS, disturbance=disturbance)
                prior = sample_prior(position, orientation, rng)
                for name, localizer in found.items():
                    pose = localizer.locate(recording, prior)
                    error = pose.position - position
                    rows.append({"method": name, "moment_ma_m2": 1e3 * bench.device.moment, **case,
                                 **_make_error_row(error), "trusted": pose.trusted})  # fmt: skip
                for magnet in magnets:
                    error = compute_static_error(magnet, position, orientation, disturbance)
                    rows.append({"method": "static", "moment_ma_m2": 1e3 * magnet.device.moment, **case,
                                 **_make_error_row(error), "trusted": True})  # fmt: skip
    return make_columns(rows)


def _make_error_row(error: FloatArray) -> dict[str, float]:
    return {f"error_{axis}_mm": 1e3 * float(e) for axis, e in zip("xyz", error, strict=True)}


def _make_magnet_bench(chunk: Chunk, moment: float) -> StaticBench:
    """A bench without constants, and on it a magnet that is fixed: its frequency only sets the length of a window."""
    rig = load_rig_once(chunk["rig"])
    noise = rig.sections.noise.model_copy(update={"constant_nt": 0.0})
    nulled = RigConfig(rig.document, rig.sections.model_copy(update={"noise": noise}))
    device = Device(moment, np.array([1.0, 0.0, 0.0]), 0.0, 0.1, 0.5 / STATIC_SECONDS, 0.0)
    return StaticBench(nulled, device, chunk.seed, chunk["mismatch"])


def compute_static_error(
    bench: StaticBench, position: FloatArray, orientation: FloatArray, disturbance: Disturbance | None
) -> FloatArray:
    """Compute the position error of one static localization: null without the magnet, listen, average, fit.

    Parameters
    ----------
    bench : StaticBench
    position : ndarray, shape (3,), in m
    orientation : ndarray, shape (4,)
    disturbance : Disturbance or None

    Returns
    -------
    ndarray, shape (3,), in m
    """
    null = bench.record_background(STATIC_SECONDS)[0].field.mean(axis=1)
    measured = bench.record(position, orientation, 1, amplitude=0.0, disturbance=disturbance).field.mean(axis=1)
    direction = matrix_from_quaternion(orientation) @ bench.device.moment_in_body
    found, _ = fit_static(bench.sensors, measured - null, bench.device.moment, position, direction)
    return found - position


def fit_static(
    sensors: SensorArray, field: FloatArray, moment: float, position: FloatArray, direction: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Fit a dipole of known moment to static readings: five degrees of freedom.

    Parameters
    ----------
    sensors : SensorArray
    field : ndarray, shape (n_sensors,), in T
        Along each sensor's axis.
    moment : float, in A·m²
    position, direction : ndarray, shape (3,)
        Start, in m and as a unit vector.

    Returns
    -------
    position, direction : ndarray, shape (3,)
    """
    from scipy.optimize import least_squares

    side, up = compute_transverse_axes(direction)

    def pointed(p: FloatArray) -> FloatArray:
        vector: FloatArray = direction + p[3] * side + p[4] * up
        return vector / np.linalg.norm(vector)

    def residual(p: FloatArray) -> FloatArray:
        b = compute_dipole_field(sensors.positions - position - PLACE_SCALE * p[:3], moment * pointed(p))
        return (np.einsum("ij,ij->i", b, sensors.axes) - field) * FIELD_SCALE

    result = least_squares(residual, np.zeros(5), method="lm")
    return position + PLACE_SCALE * result.x[:3], pointed(result.x)


def make_chunks(options: Options) -> list[Chunk]:
    """Make pieces with a bench of their own and some of the repeats.

    Parameters
    ----------
    options : Options

    Returns
    -------
    list of Chunk
    """
    total = options.poses or REPEATS
    scale = 0.0 if options.mismatch is None else options.mismatch
    pieces, first = [], 0
    for size in split_evenly(total, REPEATS_PER_CHUNK):
        pieces.append((f"from-{first:03d}", {"first": first, "repeats": size, "mismatch": scale}))
        first += size
    return cut_chunks(options, run_chunk, pieces)


def conclude(options: Options, parts: list[Columns]) -> Outcome:
    """Compute the differential mean absolute error along z, as in Fig. 2D: relative to the lowest height.

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
    kinds = list(dict.fromkeys(zip(columns["method"].tolist(), columns["moment_ma_m2"].tolist(), strict=True)))
    for method, moment in kinds:
        for passing in (False, True):
            part = select_rows(columns, method=method, moment_ma_m2=moment, scalpel=passing)
            cases.append({
                "method": method, "moment_ma_m2": moment, "scalpel": passing,
                "degrees_of_freedom": 5 if method == "static" else 6,
                "mae_z_mm": _compute_differential_error(part),
                "rms_z_mm": float(np.sqrt(np.mean(part["error_z_mm"] ** 2))),
                "worst_z_mm": float(np.max(np.abs(part["error_z_mm"]))), "n": len(part["error_z_mm"]),
                "untrusted": int(np.sum(~part["trusted"].astype(bool))),
            })  # fmt: skip
    rows = []
    for method, moment in kinds:
        pair = [c for c in cases if (c["method"], c["moment_ma_m2"]) == (method, moment)]
        rows.append((name_case(pair[0]), _format_case(pair[0], pair[1])))
    ideal = not options.mismatch
    rows.append(("mismatch", "none (ideal)" if ideal else f"x {options.mismatch:g}"))
    return Outcome(rows, {"cases": cases, "mismatch": options.mismatch or 0.0}, columns)


def name_case(case: dict[str, Any]) -> str:
    """Return the name of a case in table and figure.

    Parameters
    ----------
    case : dict

    Returns
    -------
    str
    """
    method = case["method"]
    return f"static magnet, {case['moment_ma_m2']:.3g} mA m²" if method == "static" else f"SMOL, {method}"


def _format_case(without: dict[str, Any], passing: dict[str, Any]) -> str:
    doubtful = f", {passing['untrusted']} of {passing['n']} not trusted" if passing["untrusted"] else ""
    return (
        f"{without['mae_z_mm']:.3f} mm, with scalpel {passing['mae_z_mm']:.3f} mm (rms from the truth "
        f"{passing['rms_z_mm']:.3g} mm){doubtful}; {without['degrees_of_freedom']} degrees of freedom"
    )


def _compute_differential_error(part: Columns) -> float:
    """Eq. S25 along z, with the lowest height as reference, over the benches."""
    found = []
    for bench in np.unique(part["bench"]):
        one = select_rows(part, bench=bench)
        measured = one["height_mm"] + one["error_z_mm"]
        reference = measured[one["height_mm"] == one["height_mm"].min()]
        truth = one["height_mm"] - one["height_mm"].min()
        found.append(compute_differential_mae(measured, truth, reference))
    return float(np.mean(found))


def draw(outcome: Outcome, path: Path) -> None:
    """Draw errors along z at each height with the scalpel, and their mean with and without.

    Parameters
    ----------
    outcome : Outcome
    path : Path
        PNG to write.
    """
    from sim.batch.slide import COLORS, OTHERS, open_slide, set_titles

    cases = outcome.figures["cases"]
    names = list(dict.fromkeys(name_case(c) for c in cases))
    palette = {n: COLORS.get(n.removeprefix("SMOL, "), "") for n in names}
    for n, color in zip([n for n in names if not palette[n]], OTHERS, strict=False):
        palette[n] = color
    smol = min(c["mae_z_mm"] for c in cases if c["scalpel"] and c["method"] != "static")
    static = min(c["mae_z_mm"] for c in cases if c["scalpel"] and c["method"] == "static")
    headline = f"A scalpel passes: error of SMOL {1e3 * smol:.0f} µm, of the best static magnet {static:.1f} mm"
    scale = outcome.figures["mismatch"]
    ideal = f"mismatches x {scale:g}" if scale else "ideal: all mismatches off"
    subline = (
        f"15.97 mA m² at 30 mm/s, x = 40 mm, z = 80 mm; SMOL N = {HALF_PERIODS}, static magnets 100 ms, nulled; {ideal}"
    )
    with open_slide(path, headline, subline, 1, 2, width_ratios=[1.15, 1.0], left=0.08, wspace=0.6) as (left, right):
        shift = np.linspace(-1.2, 1.2, len(names))
        for n, offset in zip(names, shift, strict=True):
            rows = [i for i, m in enumerate(_list_names(outcome.columns)) if m == n and outcome.columns["scalpel"][i]]
            error = np.maximum(np.abs(outcome.columns["error_z_mm"][rows]), 1e-3)
            left.plot(outcome.columns["height_mm"][rows] + offset, error, "o", ms=4, alpha=0.6, mew=0, color=palette[n])
        left.set(yscale="log")
        left.set_xticks([1e3 * h for h in HEIGHTS])
        _label_plain_log(left.yaxis)
        set_titles(left, "Error along z while the scalpel passes, each repeat, in mm", "height of the device, in mm")
        for row, n in enumerate(reversed(names)):
            for passing, lift, alpha in ((False, 0.2, 0.4), (True, -0.2, 1.0)):
                case = next(c for c in cases if name_case(c) == n and c["scalpel"] == passing)
                right.barh(row + lift, case["mae_z_mm"], 0.36, color=palette[n], alpha=alpha)
                label = f" {case['mae_z_mm']:.3g}" + (" with scalpel" if passing else " without")
                right.text(case["mae_z_mm"], row + lift, label, va="center", fontsize=10, color="#444444")
        right.set_yticks(range(len(names)), list(reversed(names)))
        right.tick_params(axis="y", length=0)
        top = max(c["mae_z_mm"] for c in cases)
        right.set(xscale="log", xlim=(0.5 * min(c["mae_z_mm"] for c in cases), 12 * top))
        _label_plain_log(right.xaxis)
        set_titles(right, "Differential mean absolute error along z, in mm")


def _label_plain_log(axis: Any) -> None:
    from matplotlib.ticker import FuncFormatter, NullFormatter

    axis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
    axis.set_minor_formatter(NullFormatter())


def _list_names(columns: Columns) -> list[str]:
    pairs = zip(columns["method"].tolist(), columns["moment_ma_m2"].tolist(), strict=True)
    return [name_case({"method": m, "moment_ma_m2": a}) for m, a in pairs]


STUDY = Study(
    name="scalpel",
    title="A scalpel passes: SMOL and static magnets, error along z",
    devices=lambda: {"characterised": make_characterised_device()},
    chunks=make_chunks,
    conclude=conclude,
    draw=draw,
    notes={
        "half_periods": HALF_PERIODS,
        "scalpel_ma_m2": (1e3 * SCALPEL_MOMENT).tolist(),
        "static": "background just before subtracted, known moment, no constant in its channels, mean of 100 ms",
        "magnets_mm": [round(1e3 * (m * 4e-7 * math.pi / 1.45) ** (1 / 3), 2) for m in MAGNETS],
    },
)
