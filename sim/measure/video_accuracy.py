"""Measure how well ``smolbot track`` finds the robot in the tank's own videos, compared with ground truth."""

from __future__ import annotations

import argparse
import contextlib
import csv
import io
import json
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from smolbot.core.arrays import FloatArray

ALLOWED_MM, ALLOWED_DEG = 0.1, 2.0


@dataclass(frozen=True)
class Accuracy:
    """Errors of one tracked video, frame by frame: centre (n,) in mm, in the plane, and heading (n,) in deg."""

    run: str
    seed: int
    frames: int
    center: FloatArray
    heading: FloatArray

    def __str__(self) -> str:
        center = f"centre {compute_rms(self.center):.3f} mm rms, {self.center.max():.3f} at most"
        heading = f"heading {compute_rms(self.heading):.2f} deg rms, {np.abs(self.heading).max():.2f} at most"
        return f"{self.run}, camera {self.seed}: {len(self.center)} of {self.frames} frames; {center}; {heading}"


def compute_rms(values: FloatArray) -> float:
    """Compute the root mean square.

    Parameters
    ----------
    values : ndarray

    Returns
    -------
    float
    """
    return float(np.sqrt(np.mean(np.square(values))))


def measure_accuracy(run: Path, seed: int, folder: Path, fps: float = 12.0, size: str = "1280x960") -> Accuracy:
    """Film `run` with the camera of `seed`, track the video, and compare the track with ground truth.

    Parameters
    ----------
    run : Path
    seed : int
    folder : Path
    fps : float
    size : str
        Such as ``1280x960``.

    Returns
    -------
    Accuracy
    """
    from sim.film.command import film
    from smolbot.ui.cli.track import track

    video, truth, out = folder / f"film{seed}.avi", folder / f"truth{seed}.csv", folder / f"track{seed}"
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        film(run, video, fps=fps, seed=seed, size=size, truth=truth)
        track(video, fiducials=video.with_suffix(".toml"), run=run, out=out)
    return compare_track(truth, out / "track.csv", run.name, seed)


def compare_track(truth: Path, track: Path, run: str, seed: int) -> Accuracy:
    """Compare the track of a video of `run` by the camera of `seed` with ground truth.

    Parameters
    ----------
    truth : Path
    track : Path
    run : str
    seed : int

    Returns
    -------
    Accuracy
    """
    from smolbot.runs.optics.optical_track import read_optical_track

    with truth.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    found = read_optical_track(track)
    there = [rows[frame] for frame in found.frames]
    places = np.array([[float(row["x_m"]), float(row["y_m"])] for row in there])
    headings = np.array([float(row["heading_rad"]) for row in there])
    turned = found.headings - headings
    return Accuracy(
        run,
        seed,
        found.total,
        1e3 * np.linalg.norm(found.positions[:, :2] - places, axis=1),
        np.degrees(np.arctan2(np.sin(turned), np.cos(turned))),
    )


def measure_runs(runs: list[Path], seeds: list[int], fps: float) -> Iterator[Accuracy]:
    """Measure every run with every camera.

    Parameters
    ----------
    runs : list of Path
    seeds : list of int
    fps : float

    Yields
    ------
    Accuracy
    """
    for run in runs:
        for seed in seeds:
            with tempfile.TemporaryDirectory() as folder:
                yield measure_accuracy(run, seed, Path(folder), fps)


def main() -> None:
    """Measure, print, and end with 1 where a frame is further off than is allowed."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("runs", nargs="+", type=Path, help="folders of runs in the tank")
    parser.add_argument("--seeds", default="1..3", help="of the cameras")
    parser.add_argument("--fps", type=float, default=12.0)
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    first, _, last = given.seeds.partition("..")
    found = []
    for one in measure_runs(given.runs, list(range(int(first), int(last or first) + 1)), given.fps):
        found.append(one)
        if not given.json:
            print(one, flush=True)
    centers = np.concatenate([f.center for f in found])
    headings = np.abs(np.concatenate([f.heading for f in found]))
    within = (centers <= ALLOWED_MM) & (headings <= ALLOWED_DEG)
    figures = {
        "frames": len(centers),
        "within": float(within.mean()),
        "center_mm": _compute_figures(centers),
        "heading_deg": _compute_figures(headings),
    }
    if given.json:
        print(json.dumps(figures, indent=2))
    else:
        print(f"{100 * within.mean():.1f} % of {len(centers)} frames within {ALLOWED_MM:g} mm and {ALLOWED_DEG:g} deg")
        for name, values in (("centre, mm", centers), ("heading, deg", headings)):
            print(f"{name:13}", ", ".join(f"{key} {value:.3f}" for key, value in _compute_figures(values).items()))
    sys.exit(0 if within.all() else 1)


def _compute_figures(values: FloatArray) -> dict[str, float]:
    percentiles = zip(("median", "p95", "p99"), np.percentile(values, (50, 95, 99)).tolist(), strict=True)
    return {"rms": compute_rms(values), **dict(percentiles), "max": float(values.max())}


if __name__ == "__main__":
    main()
