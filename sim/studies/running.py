"""Run a study over processes, resume it where it stopped, and write it into a folder of its own."""

from __future__ import annotations

import json
import math
import os
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future, as_completed
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from sim.batch.executors import open_executor
from sim.studies.study import Chunk, Columns, Options, Study
from smolbot.config.rig import RigConfig
from smolbot.core.sensing import Device, SensorArray
from smolbot.core.text_table import write_table
from smolbot.errors import InputError, PluginError, report_plugin_errors, report_write_errors


class StudyFolder:
    """Folder of a study: its chunks, rows, options and figure.

    Parameters
    ----------
    path : Path
    deciding : mapping
        The options that decide the result (`Options.list_deciding`).
    resume : bool
        Go on with what is there; without it the folder must be new or empty.

    Raises
    ------
    InputError
        If the folder holds something else than this study, or cannot be made.
    """

    def __init__(self, path: Path, deciding: Mapping[str, Any], *, resume: bool = False) -> None:
        self.path, self.deciding = path, dict(deciding)
        if path.exists() and not path.is_dir():
            raise InputError(f"{path}: is a file; name a folder for the study.")
        if path.is_dir() and any(path.iterdir()):
            if not resume:
                raise InputError(f"{path}: is not empty; name a new folder, or continue with --resume.")
            self._check()
        with report_write_errors(path, "the study's folder", "made"):
            (path / "chunks").mkdir(parents=True, exist_ok=True)
        self._write_json("asked.json", self.deciding)

    def _check(self) -> None:
        try:
            found = json.loads((self.path / "asked.json").read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise InputError(f"{self.path}: contains no study that can be resumed (asked.json: {error}).") from error
        ours = json.loads(json.dumps(self.deciding))
        keys = [k for k in {**ours, **found} if ours.get(k) != found.get(k)]
        if keys:
            differ = "; ".join(f"{k} was {found.get(k)!r}, is {ours.get(k)!r}" for k in sorted(keys))
            raise InputError(f"{self.path}: contains another study: {differ}. Resume with the same options.")

    def load(self, name: str) -> Columns | None:
        """Read the rows of a finished chunk.

        Parameters
        ----------
        name : str

        Returns
        -------
        Columns or None
            None where the chunk is not finished, or its file is broken.
        """
        try:
            with np.load(self.path / "chunks" / f"{name}.npz", allow_pickle=False) as file:
                return {key: file[key] for key in file.files}
        except (OSError, ValueError, zipfile.BadZipFile):
            return None

    def save(self, name: str, columns: Columns) -> None:
        """Write the rows of a chunk; a kill in between leaves no half file.

        Parameters
        ----------
        name : str
        columns : Columns
        """
        target = self.path / "chunks" / f"{name}.npz"
        with target.with_suffix(".part").open("wb") as file:
            np.savez_compressed(file, **columns)
        os.replace(target.with_suffix(".part"), target)

    def finish(self, figures: Mapping[str, Any], columns: Columns) -> None:
        """Write ``study.json`` and ``results.csv``.

        Parameters
        ----------
        figures : mapping
        columns : Columns
        """
        self._write_json("study.json", figures)
        shown = {key: column for key, column in columns.items() if not key.startswith("_")}
        write_table(self.path / "results.csv", shown, zip(*map(_format_column, shown.values()), strict=True))

    def _write_json(self, name: str, data: Any) -> None:
        from smolbot.core.results import format_json

        (self.path / name).write_text(format_json(data), encoding="utf-8")


def _format_column(column: Any) -> list[str]:
    values = np.atleast_1d(column)
    return [f"{v:.8g}" if values.dtype.kind == "f" else str(v) for v in values]


@contextmanager
def open_study_executor(jobs: int) -> Iterator[Executor | None]:
    """Open processes for chunks.

    Parameters
    ----------
    jobs : int
        0: one per core. 1: run in this process.

    Yields
    ------
    Executor or None
        None where chunks run in this process.
    """
    if (jobs or os.cpu_count() or 1) == 1:
        yield None
        return
    with open_executor(jobs) as pool:
        yield pool


def run_chunks(
    chunks: Sequence[Chunk],
    folder: StudyFolder | None = None,
    executor: Executor | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[Columns]:
    """Compute the rows of all chunks; those that a folder already holds are read, not computed.

    Parameters
    ----------
    chunks : sequence of Chunk
    folder : StudyFolder, optional
    executor : concurrent.futures.Executor, optional
        Any; without one the chunks run in this process.
    progress : callable, optional
        Called with how many are done, of how many.

    Returns
    -------
    list of Columns
        In the order of the chunks.
    """
    found: dict[int, Columns] = {}
    for index, chunk in enumerate(chunks):
        kept = folder.load(chunk.name) if folder is not None else None
        if kept is not None:
            found[index] = kept
    report = progress or (lambda done, total: None)
    report(len(found), len(chunks))

    def done(index: int, columns: Columns) -> None:
        if not isinstance(columns, Mapping):
            work = chunks[index].work
            where = f"{work.__module__}:{work.__qualname__}"
            raise PluginError(f"Study {where} must return columns by their name; got {columns!r}.")
        found[index] = columns
        if folder is not None:
            folder.save(chunks[index].name, columns)
        report(len(found), len(chunks))

    left = [i for i in range(len(chunks)) if i not in found]
    if executor is None:
        for index in left:
            with report_plugin_errors("Study", chunks[index].work, ""):
                columns = chunks[index].work(chunks[index])
            done(index, columns)
    else:
        futures: dict[Future[Columns], int] = {executor.submit(chunks[i].work, chunks[i]): i for i in left}
        try:
            for future in as_completed(futures):
                with report_plugin_errors("Study", chunks[futures[future]].work, ""):
                    columns = future.result()
                done(futures[future], columns)
        finally:
            for future in futures:
                future.cancel()
    return [found[i] for i in range(len(chunks))]


def describe_study(options: Options, study: Study, rig: RigConfig) -> dict[str, Any]:
    """Describe a study for ``study.json``: seed, noise, layout, devices, mismatch, versions.

    Parameters
    ----------
    options : Options
    study : Study
    rig : RigConfig

    Returns
    -------
    dict
    """
    from smolbot.runs.folder import collect_provenance

    origin = collect_provenance(options.seed, {}, {})
    noise = rig.sections.noise.model_dump()
    return {
        **options.list_deciding(),
        "title": study.title,
        "noise": noise,
        "layout": describe_layout(rig.sensors),
        "devices": {name: describe_device(device) for name, device in study.devices().items()},
        "mismatch_section": rig.sections.tank.get("mismatch", {}),
        "notes": dict(study.notes),
        "versions": {key: origin[key] for key in ("smolbot", "commit", "python", "platform", "packages")},
    }


def describe_layout(sensors: SensorArray) -> dict[str, Any]:
    """Return positions and axes of an array as plain lists.

    Parameters
    ----------
    sensors : SensorArray

    Returns
    -------
    dict
    """
    return {
        "positions_mm": np.round(1e3 * sensors.positions, 4).tolist(),
        "axes": np.round(sensors.axes, 6).tolist(),
        "bandwidth_hz": sensors.bandwidth,
    }


def describe_device(device: Device) -> dict[str, Any]:
    """Return a device's values, with units in their keys.

    Parameters
    ----------
    device : Device

    Returns
    -------
    dict
    """
    return {
        "moment_ma_m2": 1e3 * device.moment,
        "moment_in_body": device.moment_in_body.tolist(),
        "l0_mm": 1e3 * device.l0,
        "theta_max_deg": math.degrees(device.theta_max),
        "frequency_hz": device.frequency,
        "damping_per_s": device.damping,
        "damping_model": device.damping_model,
    }
