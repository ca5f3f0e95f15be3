"""Write a recorded run for other programs: HDF5, MATLAB, or a folder of CSV tables."""

from __future__ import annotations

import csv
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smolbot.errors import InputError
from smolbot.runs.recording.reader import RecordedRun
from smolbot.runs.recording.tables import (
    Column,
    RunTable,
    collect_facts,
    compute_volts,
    make_samples_table,
    make_tables,
)

FORMATS = ("h5", "csv", "mat")

LARGEST_MAT = 2**31 - 1
"""Bytes of a variable beyond which a MATLAB file is written as v7.3, which is HDF5."""

_ABOUT = (
    "A run of smolbot. SI units, in the names where there are any. Vectors in the world frame, quaternions scalar "
    "first. Rows of equal cycle or shot belong together. Covariances are of position in m and rotation in rad."
)


def export_run(run: RecordedRun, kind: str, out: Path, *, force: bool = False, with_samples: bool = True) -> None:
    """Write a run to a file or (csv) a folder; the numbers equal those of the record bit for bit.

    Parameters
    ----------
    run : RecordedRun
    kind : {"h5", "csv", "mat"}
    out : Path
        File or folder to write.
    force : bool
        Overwrite an earlier export.
    with_samples : bool
        Whether to include the samples of all sensors.

    Raises
    ------
    InputError
        For an unknown format, if `out` exists (unless `force`), or if it cannot be written.
    """
    writers: dict[str, Callable[[RecordedRun, Path, bool], None]] = {
        "h5": _write_hdf5,
        "csv": _write_csv,
        "mat": _write_mat,
    }
    if kind not in writers:
        raise InputError(f"--format {kind}: is not known; known: {', '.join(FORMATS)}.")
    write_via_temporary(out, lambda part: writers[kind](run, part, with_samples), force=force)


def write_via_temporary(out: Path, write: Callable[[Path], None], *, force: bool) -> None:
    """Write a file or folder under another name first, so that `out` is complete or absent.

    Parameters
    ----------
    out : Path
    write : callable
        Called with the temporary path.
    force : bool
        Overwrite an earlier export.

    Raises
    ------
    InputError
        If `out` exists (unless `force`), or cannot be written.
    """
    if out.exists() and not force:
        raise InputError(f"{out}: stands there already; name another with --out, or write over it with --force.")
    if out.is_dir() and any(out.iterdir()) and not (out / _INDEX).is_file():
        raise InputError(f"{out}: is a folder that no export made; it is not written over.")
    part = out.with_name(f"{out.stem}.part{out.suffix}")
    try:
        _remove(part)
        part.parent.mkdir(parents=True, exist_ok=True)
        write(part)
        _remove(out)
        part.replace(out)
    except OSError as error:
        _remove(part)
        raise InputError(f"{out}: cannot be written: {error}.") from error


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def _write_hdf5(run: RecordedRun, path: Path, with_samples: bool) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        file.attrs["about"] = _ABOUT
        for name, fact in collect_facts(run).items():
            if name.endswith("_json"):  # may be longer than an attribute
                file.create_dataset(name, data=fact, dtype=h5py.string_dtype())
            else:
                file.attrs[name] = fact
        file["sensor_gains"] = run.converter.gains
        kept = file.create_group("files")
        for name, content in sorted(run.begin.files.items()):
            kept[name] = np.frombuffer(content, np.uint8)
        found = make_tables(run)
        if with_samples:
            found["recordings"], field = make_samples_table(run)
            packed: dict[str, Any] = {
                "compression": "gzip",
                "compression_opts": 4,
                "chunks": (min(len(field), 8192), 1),
            }
            file.create_dataset("field_t", data=field, **(packed if field.size else {}))
            file["field_t"].attrs["about"] = "(samples, sensors), in T: recording k has rows first to first + samples"
        for name, table in found.items():
            group = file.create_group(name)
            group.attrs["row"] = table.what
            for column, values in table.columns.items():
                text = h5py.string_dtype() if isinstance(values, list) else None
                group.create_dataset(column, data=values, dtype=text)
                if unit := _get_unit(column):
                    group[column].attrs["unit"] = unit


def _write_mat(run: RecordedRun, path: Path, with_samples: bool) -> None:
    held: dict[str, Any] = {
        "about": _ABOUT,
        "facts": collect_facts(run),
        "sensor_gains": run.converter.gains,
        "files": [{"name": n, "content": np.frombuffer(c, np.uint8)} for n, c in sorted(run.begin.files.items())],
    }
    found = make_tables(run)
    if with_samples:
        found["recordings"], held["field_t"] = make_samples_table(run)
    held |= {name: table.columns for name, table in found.items()}
    if max((v.nbytes for v in held.values() if isinstance(v, np.ndarray)), default=0) > LARGEST_MAT:
        from smolbot.runs.recording.matlab73 import write_matlab73

        write_matlab73(path, held)
        return
    from scipy.io import savemat

    with path.open("wb") as file:
        savemat(file, _to_matlab(held), long_field_names=True, do_compression=True, oned_as="column")


def _to_matlab(value: Any) -> Any:
    """Convert to MATLAB's types: a list of text to a cell column, a list of dictionaries to a struct array."""
    if isinstance(value, dict):
        return {name: _to_matlab(part) for name, part in value.items()}
    if isinstance(value, list):
        cells: NDArray[np.object_] = np.empty((len(value), 1), object)
        for index, part in enumerate(value):
            cells[index, 0] = _to_matlab(part)
        return cells
    return value


_INDEX = "facts.csv"


def _write_csv(run: RecordedRun, path: Path, with_samples: bool) -> None:
    path.mkdir()
    _write_rows(path / _INDEX, [("name", "value"), *collect_facts(run).items()])
    for name, content in sorted(run.begin.files.items()):
        (path / name).write_bytes(content)
    found = make_tables(run)
    for name, table in found.items():
        _write_table(path / f"{name}.csv", table)
    if with_samples:
        recordings, _ = make_samples_table(run)
        _write_table(path / "recordings.csv", recordings)
        (path / "samples").mkdir()
        for played, recording in run.recordings():
            head = {"sample_rate_hz": recording.sample_rate, "clock_s": recording.clock}
            if np.isfinite(recording.time_since_drive):
                head["time_since_drive_ms"] = 1e3 * recording.time_since_drive
            write_samples_csv(path / "samples" / f"shot_{played.number:05d}.csv", compute_volts(run, recording), head)


def write_samples_csv(path: Path, voltages: NDArray[np.float64], head: dict[str, float]) -> None:
    """Write one recording in the format that ``smolbot localize`` reads.

    Parameters
    ----------
    path : Path
    voltages : ndarray, shape (n_sensors, n), in V
    head : dict of str to float
        Values of the header lines.
    """
    lines = [f"# {name} = {value!r}" for name, value in head.items()]
    lines.append(",".join(f"sensor_{i}_v" for i in range(len(voltages))))
    lines += [",".join(map(repr, row)) for row in voltages.T.tolist()]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _write_table(path: Path, table: RunTable) -> None:
    names: list[str] = []
    columns: list[Sequence[Any]] = []
    for name, values in table.columns.items():
        parts = _split_columns(name, values)
        names += [part for part, _ in parts]
        columns += [column for _, column in parts]
    _write_rows(path, [tuple(names), *zip(*columns, strict=True)])


def _split_columns(name: str, values: Column) -> list[tuple[str, Sequence[Any]]]:
    """Split a column of vectors or matrices into several of numbers, the unit at the end of each name."""
    if isinstance(values, list):
        return [(name, values)]
    if values.ndim == 1:
        return [(name, [_format_cell(v) for v in values.tolist()])]
    unit = f"_{name.rsplit('_', 1)[1]}" if _get_unit(name) else ""
    parts: list[tuple[str, Sequence[Any]]] = []
    for index in np.ndindex(*values.shape[1:]):
        part = values[(slice(None), *index)]
        parts.append(
            (
                f"{name.removesuffix(unit)}_{_label_component(name, index)}{unit}",
                [_format_cell(v) for v in part.tolist()],
            )
        )
    return parts


def _label_component(name: str, index: tuple[int, ...]) -> str:
    """Label a component: x, y, z of a vector, w, x, y, z of a quaternion, else its index from 0."""
    if name == "orientation":
        return "wxyz"[index[0]]
    if name in ("position_m", "axis", "excite_a"):
        return "xyz"[index[0]]
    return "".join(map(str, index))


def _format_cell(value: Any) -> Any:
    """Format a value as text that reads back to the same number; empty for nan."""
    if isinstance(value, bool):
        return int(value)
    if isinstance(value, float):
        return "" if np.isnan(value) else repr(value)
    return value


def _write_rows(path: Path, rows: Sequence[Sequence[Any]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows(rows)


_UNITS = {"s": "s", "m": "m", "a": "A", "hz": "Hz", "t": "T", "v": "V"}


def _get_unit(column: str) -> str:
    return _UNITS.get(column.rsplit("_", 1)[1], "") if "_" in column else ""
