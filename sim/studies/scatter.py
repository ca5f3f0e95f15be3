"""Scatter of poses at one place: what the studies of precision, damping and depth have in common."""

from __future__ import annotations

from typing import Any

import numpy as np

from sim.studies.benches import FLIP_DEG, make_reference_orientation, sample_prior
from sim.studies.columns import compute_rms, stack_position_errors
from sim.studies.cramer_rao import compute_bound
from sim.studies.study import Columns
from sim.tank.static_bench import StaticBench
from smolbot.localization.localizer import Localizer
from smolbot.localization.statistics import compute_standard_deviation

PHASES = 6
"""Phases of the oscillation, over half a turn, across which the bound is averaged."""


def locate_repeatedly(
    bench: StaticBench,
    found: dict[str, Localizer],
    height: float,
    half_periods: int,
    repeats: int,
    rng: np.random.Generator,
    labels: dict[str, Any],
) -> list[dict[str, Any]]:
    """Locate at (0, 0, `height`) in the reference orientation, all estimators on the same recordings.

    Parameters
    ----------
    bench : StaticBench
    found : dict of str to Localizer
    height : float, in m
    half_periods : int
    repeats : int
    rng : numpy.random.Generator
    labels : dict
        Columns that every row gets.

    Returns
    -------
    list of dict
    """
    from sim.studies.benches import locate_all

    position, orientation = np.array([0.0, 0.0, height]), make_reference_orientation()
    rows: list[dict[str, Any]] = []
    for _ in range(repeats):
        recording = bench.record(position, orientation, half_periods)
        prior = sample_prior(position, orientation, rng)
        kind = {**labels, "height_mm": 1e3 * height, "half_periods": half_periods}
        rows += [{**kind, **row} for row in locate_all(found, recording, position, orientation, prior)]
    return rows


def compute_mean_bound(bench: StaticBench, height: float, half_periods: int) -> float:
    """Compute the Cramer-Rao bound at (0, 0, `height`) for the sigma_xyz of `compute_scatter`.

    Parameters
    ----------
    bench : StaticBench
    height : float, in m
    half_periods : int

    Returns
    -------
    float, in mm
        Mean over the three axes.
    """
    position, orientation = np.array([0.0, 0.0, height]), make_reference_orientation()
    phases = np.pi * np.arange(PHASES) / PHASES
    covariance = np.mean([compute_bound(bench, position, orientation, half_periods, float(p)) for p in phases], axis=0)
    return 1e3 * float(np.mean(np.sqrt(np.diag(covariance)[:3])))


def compute_scatter(columns: Columns) -> dict[str, Any]:
    """Compute the mean over the axes of the standard deviation (Eq. S26), and figures beside it; lengths in mm.

    Parameters
    ----------
    columns : Columns

    Returns
    -------
    dict
    """
    errors = stack_position_errors(columns)
    sigmas = [compute_standard_deviation(errors[:, i]) if len(errors) > 1 else float("nan") for i in range(3)]
    right = np.max(np.abs([columns[f"error_r{a}_deg"] for a in "xyz"]), axis=0) <= FLIP_DEG
    kept = errors[right]
    apart = [compute_standard_deviation(kept[:, i]) if len(kept) > 1 else float("nan") for i in range(3)]
    return {
        "n": len(errors),
        "sigma_xyz_mm": float(np.mean(sigmas)),
        "sigma_by_axis_mm": sigmas,
        "mean_by_axis_mm": errors.mean(axis=0).tolist(),
        "rms_mm": compute_rms(errors),
        "untrusted": int(np.sum(columns["trusted"] == 0.0)),
        "flipped": int(np.sum(~right)),
        "sigma_xyz_without_flips_mm": float(np.mean(apart)),
    }
