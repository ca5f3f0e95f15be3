"""What all studies share: devices, poses, chunks of Monte-Carlo that run anywhere and resume, folders and tables.

A study is cut into chunks. Each has its own seed and draws its own bench, so the result is the same whatever the
number of processes; each leaves its rows in ``chunks/NAME.npz`` when it is done, so that a study resumes.
"""

from __future__ import annotations

import csv
import json
import math
import os
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import datetime
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from sim.static_bench import StaticBench, with_sensors
from smolbot.arrays import FloatArray
from smolbot.errors import InputError
from smolbot.localization.localizer import Estimator, Localizer
from smolbot.localization.noise import NoiseModel
from smolbot.poses import Pose
from smolbot.rigfile import RigConfig, load_rig
from smolbot.rotations import (
    quaternion_from_axes,
    quaternion_from_rotation_vector,
    quaternion_product,
    rotation_error,
)
from smolbot.sensing import Device, Recording, SensorArray

Columns = dict[str, Any]
"""Rows of a study: one-dimensional arrays of equal length, named with their unit. Keys with a leading underscore hold
arrays of any shape, which figures may use and ``results.csv`` leaves out."""

QUIET_SECONDS = 10.0
"""Quiet time that a noise model is learned from."""

RING_DOWN = 0.02
"""From the end of the drive to the first sample, in s."""

CYCLES = 5
"""Length of a drive, in periods of the resonance."""

REFERENCE_POSITION = (0.0, 0.0, 0.08)
"""The paper's reference place, in m."""

PRIOR_OFF = (1e-3, math.radians(3.0))
"""How far a warm start is from the truth, standard deviation per axis in m and rad."""


def reference_orientation() -> FloatArray:
    """The paper's reference: main axis (body z) along world y, oscillating in the x-y plane; quaternion (4,)."""
    return quaternion_from_axes(np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0]), "zy")


def characterised(damping: float = 1.1, model: Any = "linear") -> Device:
    """The paper's calibrated device: 17.8 deg, 103.5 Hz, moment across the cantilever."""
    return Device(0.89e-3, np.array([1.0, 0.0, 0.0]), 1.5e-3, math.radians(17.8), 103.5, damping, model)


def optimised() -> Device:
    """The paper's optimised device: 30 deg, 160 Hz."""
    return Device(0.89e-3, np.array([1.0, 0.0, 0.0]), 1.5e-3, math.radians(30.0), 160.0, 1.1, "linear")


def in_glycerol() -> Device:
    """The gradient robot's device: moment along the cantilever, 31.7 1/s."""
    return Device(0.89e-3, np.array([0.0, 0.0, 1.0]), 1.5e-3, math.radians(17.8), 103.5, 31.7, "exponential")


@dataclass(frozen=True)
class Options:
    """What a study was asked for; `poses` and `mismatch` None mean the study's own choice."""

    name: str
    seed: int = 1
    jobs: int = 0
    poses: int | None = None
    rig: str = "tank"
    mismatch: float | None = None
    estimators: tuple[Estimator, ...] = ("whitened", "paper")

    def asked(self) -> dict[str, Any]:
        """What decides the result, and must be the same when a study resumes."""
        return {
            "study": self.name,
            "seed": self.seed,
            "poses": self.poses,
            "rig": self.rig,
            "mismatch": self.mismatch,
            "estimators": list(self.estimators),
        }


@dataclass(frozen=True)
class Chunk:
    """One piece of a study: `work(chunk)` returns its rows, in whatever process it runs.

    Attributes
    ----------
    name : str
        Unique within the study, fit for a file name.
    work : callable
        A module's function, so that it can be sent to another process.
    seed : int
        All that the piece draws follows from it.
    arguments : mapping
        Plain values.
    """

    name: str
    work: Callable[[Chunk], Columns]
    seed: int
    arguments: Mapping[str, Any] = field(default_factory=dict)

    def __getitem__(self, key: str) -> Any:
        return self.arguments[key]


@dataclass(frozen=True)
class Outcome:
    """What a study found.

    Attributes
    ----------
    rows : list of (str, str)
        The table.
    figures : dict
        The same as numbers, for ``study.json`` and ``--json``.
    columns : Columns
        For ``results.csv``.
    """

    rows: list[tuple[str, str]]
    figures: dict[str, Any]
    columns: Columns


@dataclass(frozen=True)
class Study:
    """One study: how it is cut into chunks, what they add up to, and how that is drawn.

    `estimators` are those that are used where none is asked for.
    """

    name: str
    title: str
    devices: Callable[[], Mapping[str, Device]]
    chunks: Callable[[Options], list[Chunk]]
    conclude: Callable[[Options, list[Columns]], Outcome]
    draw: Callable[[Outcome, Path], None]
    estimators: tuple[Estimator, ...] = ("whitened", "paper")
    notes: Mapping[str, Any] = field(default_factory=dict)


def cut(
    options: Options, work: Callable[[Chunk], Columns], pieces: Sequence[tuple[str, Mapping[str, Any]]]
) -> list[Chunk]:
    """Chunks with seeds spawned from the study's own, in order of `pieces` (name, arguments)."""
    seeds = np.random.SeedSequence(options.seed).spawn(len(pieces))
    states = [int(s.generate_state(1, np.uint64)[0] >> np.uint64(1)) for s in seeds]
    shared = {"rig": options.rig, "estimators": options.estimators}
    return [
        Chunk(name, work, seed, {**shared, **arguments}) for (name, arguments), seed in zip(pieces, states, strict=True)
    ]


def split(total: int, size: int) -> list[int]:
    """Sizes of the fewest, nearly equal pieces of at most `size`.

    Examples
    --------
    >>> split(1000, 400)
    [334, 333, 333]
    """
    count = max(math.ceil(total / size), 1)
    return [total // count + (i < total % count) for i in range(count)]


@lru_cache(maxsize=8)
def rig_named(name: str) -> RigConfig:
    """A rig file, read once per process."""
    return load_rig(name)


def open_bench(chunk: Chunk, device: Device, mismatch: float, *, spread: float = 1.0) -> StaticBench:
    """The bench of a chunk, drawn from its seed; `spread` scales the sensors' places about the origin."""
    rig = rig_named(chunk["rig"])
    if spread != 1.0:
        rig = with_sensors(rig, spread * rig.sensors.positions, rig.sensors.axes)
    return StaticBench(rig, device, chunk.seed, mismatch)


def localizers(
    bench: StaticBench,
    estimators: Sequence[Estimator],
    quiet: float = QUIET_SECONDS,
    reach: float | None = None,
) -> dict[str, Localizer]:
    """Localizers that know what may be known: nominal sensors and device, noise from `quiet` s of quiet.

    `reach` is the height, in m, up to which poses are looked for, where the default is not enough.
    """
    from smolbot.localization.cold_start import SearchVolume

    volume = SearchVolume()
    if reach is not None:
        wide = max(0.05, 0.4 * reach)
        volume = SearchVolume((-wide, -wide, 0.03), (wide, wide, max(reach, 0.12)), max(0.008, 0.06 * reach))
    noise = NoiseModel.learn(bench.quiet(quiet)) if "whitened" in estimators else None
    return {e: Localizer(bench.sensors, bench.device, noise, e, volume) for e in estimators}


def true_noise_model(bench: StaticBench, top: float = 2500.0, spacing: float = 0.5) -> NoiseModel:
    """The noise as it truly is, as a localizer takes it: lines, and the spectrum of the sensors' own noise."""
    noise = bench.true_sensors.field_noise
    frequencies = np.arange(0.0, top + 0.5 * spacing, spacing)
    corners, deviations = bench.true_sensors.sensor_noise.processes
    power = 2.0 / np.pi * deviations**2 / corners  # of a first-order process, one-sided, at 0 Hz
    density = np.sum(power / (1.0 + (frequencies[:, None] / corners) ** 2), axis=1)
    density += bench.true_sensors.converter_step**2 / 6.0 / bench.rate
    phasors = noise.amplitudes
    eye = np.eye(len(bench.sensors), dtype=np.complex128)
    return NoiseModel(
        line_frequencies=np.array(noise.frequencies),
        lines=np.einsum("lj,lk->ljk", phasors, phasors.conj()),
        frequencies=frequencies,
        spectrum=density[:, None, None] * eye,
        block=1.0 / bench.rate,
    )


def prior_near(position: FloatArray, orientation: FloatArray, rng: np.random.Generator) -> Pose:
    """A warm start: the truth, moved and turned by as much as `PRIOR_OFF` says."""
    off, turn = PRIOR_OFF
    moved = position + off * rng.standard_normal(3)
    turned = quaternion_product(quaternion_from_rotation_vector(turn * rng.standard_normal(3)), orientation)
    return Pose(0.0, moved, turned, np.diag([off**2] * 3 + [turn**2] * 3))


def pose_row(pose: Pose, position: FloatArray, orientation: FloatArray) -> dict[str, float]:
    """One row of `Columns`: errors, expected deviations, NEES, and what the pose says of itself."""
    error = np.concatenate([pose.position - position, rotation_error(pose.orientation, orientation)])
    expected = np.sqrt(np.diag(pose.covariance))
    scale = np.where(expected > 0, expected, 1.0)
    nees = float((error / scale) @ np.linalg.solve(pose.covariance / np.outer(scale, scale), error / scale))
    row = {f"error_{axis}_mm": 1e3 * float(error[i]) for i, axis in enumerate("xyz")}
    row |= {f"error_r{axis}_deg": math.degrees(float(error[3 + i])) for i, axis in enumerate("xyz")}
    row |= {f"sigma_{axis}_mm": 1e3 * float(expected[i]) for i, axis in enumerate("xyz")}
    row |= {"nees": nees, "r_squared": pose.r_squared, "flip_margin": pose.flip_margin, "trusted": float(pose.trusted)}
    return row


def columns_of(rows: Sequence[Mapping[str, Any]]) -> Columns:
    """Rows as columns; every row has the same keys."""
    return {key: np.array([row[key] for row in rows]) for key in rows[0]} if rows else {}


def joined(parts: Sequence[Columns]) -> Columns:
    """Columns of several chunks one after the other; keys with a leading underscore are left out."""
    filled = [p for p in parts if p]
    keys = [k for k in (filled[0] if filled else {}) if not k.startswith("_")]
    return {key: np.concatenate([np.atleast_1d(p[key]) for p in filled]) for key in keys}


def chosen(columns: Columns, **values: Any) -> Columns:
    """The rows in which the named columns have these values."""
    keep = np.ones(len(next(iter(columns.values()))), dtype=np.bool_)
    for key, value in values.items():
        keep &= columns[key] == value
    return {key: column[keep] for key, column in columns.items()}


def position_errors(columns: Columns) -> FloatArray:
    """Position errors (n, 3) in mm."""
    return np.stack([columns[f"error_{axis}_mm"] for axis in "xyz"], axis=1)


def rotation_errors(columns: Columns) -> FloatArray:
    """Rotation errors (n, 3) in degrees."""
    return np.stack([columns[f"error_r{axis}_deg"] for axis in "xyz"], axis=1)


def rms(values: FloatArray) -> float:
    """Root mean square of all values; nan where there is none."""
    return float(np.sqrt(np.mean(np.square(values)))) if values.size else math.nan


class StudyFolder:
    """Where a study leaves its chunks, its rows, what it was, and its figure.

    Parameters
    ----------
    path : Path
    asked : mapping
        What decides the result (`Options.asked`).
    resume : bool
        Go on with what is there; without it the folder must be new or empty.

    Raises
    ------
    InputError
        If the folder holds something else than this study, or cannot be made.
    """

    def __init__(self, path: Path, asked: Mapping[str, Any], *, resume: bool = False) -> None:
        self.path, self.asked = path, dict(asked)
        if path.exists() and not path.is_dir():
            raise InputError(f"{path}: is a file; name a folder for the study.")
        if path.is_dir() and any(path.iterdir()):
            if not resume:
                raise InputError(f"{path}: is not empty; name a new folder, or go on with --resume.")
            self._check()
        try:
            (path / "chunks").mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"{path}: the study's folder cannot be made: {error}.") from error
        self._write_json("asked.json", self.asked)

    def _check(self) -> None:
        try:
            found = json.loads((self.path / "asked.json").read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise InputError(f"{self.path}: holds no study that can be resumed (asked.json: {error}).") from error
        ours = json.loads(json.dumps(self.asked))
        keys = [k for k in {**ours, **found} if ours.get(k) != found.get(k)]
        if keys:
            differ = "; ".join(f"{k} was {found.get(k)!r}, is {ours.get(k)!r}" for k in sorted(keys))
            raise InputError(f"{self.path}: holds another study: {differ}. Resume with the same options.")

    def load(self, name: str) -> Columns | None:
        """Rows of a finished chunk; None where it is not finished, or its file is broken."""
        try:
            with np.load(self.path / "chunks" / f"{name}.npz", allow_pickle=False) as file:
                return {key: file[key] for key in file.files}
        except (OSError, ValueError, zipfile.BadZipFile):
            return None

    def save(self, name: str, columns: Columns) -> None:
        """Keep the rows of a chunk; a kill in between leaves no half file."""
        target = self.path / "chunks" / f"{name}.npz"
        with target.with_suffix(".part").open("wb") as file:
            np.savez_compressed(file, **columns)
        os.replace(target.with_suffix(".part"), target)

    def finish(self, figures: Mapping[str, Any], columns: Columns) -> None:
        """Write ``study.json`` and ``results.csv``."""
        self._write_json("study.json", figures)
        shown = {key: column for key, column in columns.items() if not key.startswith("_")}
        with (self.path / "results.csv").open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(shown)
            writer.writerows(zip(*(_texts(column) for column in shown.values()), strict=True))

    def _write_json(self, name: str, data: Any) -> None:
        from smolbot.cli.show import as_json

        (self.path / name).write_text(json.dumps(as_json(data), indent=2, default=str) + "\n", encoding="utf-8")


def _texts(column: Any) -> list[str]:
    values = np.atleast_1d(column)
    return [f"{v:.8g}" if values.dtype.kind == "f" else str(v) for v in values]


def new_folder(name: str) -> Path:
    """A new folder in runs/."""
    return Path("runs") / f"study-{name}-{datetime.now():%Y%m%d-%H%M%S}"


@contextmanager
def executor_for(jobs: int) -> Iterator[Executor | None]:
    """Processes for chunks: 0 for one per core; None for 1, which stays in this process."""
    import multiprocessing

    count = jobs or os.cpu_count() or 1
    if count == 1:
        yield None
        return
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    pool = ProcessPoolExecutor(count, mp_context=multiprocessing.get_context("spawn"))
    try:
        yield pool
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def run_chunks(
    chunks: Sequence[Chunk],
    folder: StudyFolder | None = None,
    executor: Executor | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[Columns]:
    """Rows of all chunks, in their order; those that a folder already holds are read, not run.

    Parameters
    ----------
    chunks : sequence of Chunk
    folder : StudyFolder, optional
    executor : concurrent.futures.Executor, optional
        Any; without one the chunks run here.
    progress : callable, optional
        Told how many are done, of how many.
    """
    found: dict[int, Columns] = {}
    for index, chunk in enumerate(chunks):
        kept = folder.load(chunk.name) if folder is not None else None
        if kept is not None:
            found[index] = kept
    tell = progress or (lambda done, total: None)
    tell(len(found), len(chunks))

    def done(index: int, columns: Columns) -> None:
        found[index] = columns
        if folder is not None:
            folder.save(chunks[index].name, columns)
        tell(len(found), len(chunks))

    left = [i for i in range(len(chunks)) if i not in found]
    if executor is None:
        for index in left:
            done(index, chunks[index].work(chunks[index]))
    else:
        futures: dict[Future[Columns], int] = {executor.submit(chunks[i].work, chunks[i]): i for i in left}
        try:
            for future in as_completed(futures):
                done(futures[future], future.result())
        finally:
            for future in futures:
                future.cancel()
    return [found[i] for i in range(len(chunks))]


def described(options: Options, study: Study, rig: RigConfig) -> dict[str, Any]:
    """What ``study.json`` says of a study beside its figures: seed, noise, layout, devices, mismatch, versions."""
    from smolbot.records.folder import provenance

    origin = provenance(options.seed, {}, {})
    noise = rig.sections.noise.model_dump()
    return {
        **options.asked(),
        "title": study.title,
        "noise": noise,
        "layout": layout_of(rig.sensors),
        "devices": {name: device_of(device) for name, device in study.devices().items()},
        "mismatch_section": rig.sections.tank.get("mismatch", {}),
        "notes": dict(study.notes),
        "versions": {key: origin[key] for key in ("smolbot", "commit", "python", "platform", "packages")},
    }


def layout_of(sensors: SensorArray) -> dict[str, Any]:
    """Places and axes of an array, as plain lists."""
    return {
        "positions_mm": np.round(1e3 * sensors.positions, 4).tolist(),
        "axes": np.round(sensors.axes, 6).tolist(),
        "bandwidth_hz": sensors.bandwidth,
    }


def device_of(device: Device) -> dict[str, Any]:
    """A device's values, with units in their names."""
    return {
        "moment_ma_m2": 1e3 * device.moment,
        "moment_in_body": device.moment_in_body.tolist(),
        "l0_mm": 1e3 * device.l0,
        "theta_max_deg": math.degrees(device.theta_max),
        "frequency_hz": device.frequency,
        "damping_per_s": device.damping,
        "damping_model": device.damping_model,
    }


def locate_all(
    found: Mapping[str, Localizer],
    recording: Recording,
    position: FloatArray,
    orientation: FloatArray,
    prior: Pose | None,
) -> list[dict[str, Any]]:
    """One row per estimator for one recording."""
    return [
        {"estimator": name, **pose_row(localizer.locate(recording, prior), position, orientation)}
        for name, localizer in found.items()
    ]


def rng_of(chunk: Chunk) -> np.random.Generator:
    """Generator for what a study itself draws, apart from the bench's."""
    return np.random.Generator(np.random.SFC64(np.random.SeedSequence([chunk.seed, 2])))
