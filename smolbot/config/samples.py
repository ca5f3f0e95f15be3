"""A lab's own samples: read volts from .npz, .mat, .h5 or .csv and make recordings of them.

A file holds `volts`, shape (n_channels, n) or (n_shots, n_channels, n), `sample_rate_hz`,
`time_since_drive_ms` (from the end of the drive to the first sample; one number, or one for each shot) and,
if known, `clock_s` (time of the first sample, likewise). HDF5 files hold them as datasets or attributes of
the root. A .csv file is one shot: a column per channel, in V, after header lines such as
``# sample_rate_hz = 50000``.
"""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from smolbot.config.sample_checks import check_units, find_invalid_channels
from smolbot.core.arrays import FloatArray
from smolbot.core.sensing import Recording
from smolbot.core.text_table import read_table
from smolbot.errors import InputError, MissingFileError, suggest_name

if TYPE_CHECKING:
    from smolbot.config.rig import RigConfig

KEYS = ("volts", "sample_rate_hz", "time_since_drive_ms", "clock_s")
"""What a file of samples may hold; all but the last are needed."""

SUFFIXES = (".npz", ".mat", ".h5", ".hdf5", ".csv")


@dataclass(frozen=True, eq=False)
class Samples:
    """Content of a file of samples.

    Attributes
    ----------
    path : Path
    volts : ndarray, shape (n_shots, n_channels, n), in V
    sample_rate : float, in Hz
    time_since_drive : ndarray, shape (n_shots,), in s
        Infinite in a file of background noise.
    clock : ndarray, shape (n_shots,), in s
        Time of the first sample; 0 for each shot where the file does not state it.
    """

    path: Path
    volts: FloatArray
    sample_rate: float
    time_since_drive: FloatArray
    clock: FloatArray


@dataclass(frozen=True, eq=False)
class SampleRecordings:
    """Recordings of a file of samples.

    Attributes
    ----------
    recordings : tuple of Recording
        One for each shot, in T.
    notes : tuple of str
        For each shot, the channels left out and why; empty if there are none.
    """

    recordings: tuple[Recording, ...]
    notes: tuple[str, ...]


def read_samples(path: str | Path, *, background_noise: bool = False) -> Samples:
    """Read a file of samples.

    Parameters
    ----------
    path : str or Path
        The suffix gives the format: .npz, .mat (also v7.3), .h5, .hdf5 or .csv.
    background_noise : bool
        Background noise: no drive preceded these samples, so that `time_since_drive_ms` may be missing.

    Returns
    -------
    Samples

    Raises
    ------
    InputError
        For an unknown suffix, an unreadable file, unknown or missing keys, wrong shapes, or values that are not
        numbers; the message names which, and what is needed.
    MissingFileError
        If there is no such file.
    """
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"{path}: samples are read from {', '.join(SUFFIXES)}; got '{path.suffix or 'no suffix'}'.")
    if path.is_dir():
        raise InputError(f"{path}: is a folder; name a file of samples.")
    if not path.is_file():
        raise MissingFileError(f"{path}: no such file.", name=str(path))
    suffix = path.suffix.lower()
    reader = {".npz": _read_npz, ".mat": _read_mat, ".csv": _read_csv}.get(suffix, _read_hdf5)
    values = reader(path)
    _check_keys(path, values, background_noise)
    volts = _parse_numbers(path, "volts", values["volts"])
    if volts.ndim == 2:
        volts = volts[None]
    if volts.ndim != 3 or 0 in volts.shape:
        raise InputError(
            f"{path}: volts must have shape (n_channels, n) or (n_shots, n_channels, n); got {volts.shape}."
        )
    rate = _parse_per_shot(path, "sample_rate_hz", values, 1)
    if not rate[0] > 0:
        raise InputError(f"{path}: sample_rate_hz must be positive; got {rate[0]:g}.")
    since = np.full(len(volts), np.inf)
    if "time_since_drive_ms" in values:
        since = 1e-3 * _parse_per_shot(path, "time_since_drive_ms", values, len(volts))
        if np.any(since < 0):
            raise InputError(
                f"{path}: time_since_drive_ms must not be negative; got {1e3 * since.min():g}. It counts from the end "
                "of the drive to the first sample."
            )
    clock = _parse_per_shot(path, "clock_s", values, len(volts)) if "clock_s" in values else np.zeros(len(volts))
    return Samples(path, volts, float(rate[0]), since, clock)


def make_recordings(samples: Samples, rig: RigConfig) -> SampleRecordings:
    """Make recordings in T, with saturated and dead channels named and marked to be left out.

    Parameters
    ----------
    samples : Samples
    rig : RigConfig
        Gives sensitivity, range and sensor gains.

    Returns
    -------
    SampleRecordings

    Raises
    ------
    InputError
        If the number of channels differs from that of sensors, a sample is not a number, or the values are too
        large or too small to be volts; the message names which.
    """
    section = rig.sections.sensors
    n_shots, n_channels, n = samples.volts.shape
    n_sensors = len(rig.sensors)
    if n_channels != n_sensors:
        hint = " The array looks transposed: channels come before samples." if n_sensors in (n, n_shots) else ""
        raise InputError(
            f"{samples.path}: volts has {n_channels} channels; rig '{rig.name}' has {n_sensors} sensors.{hint}"
        )
    if not np.isfinite(samples.volts).all():
        shot, channel, sample = (int(i) for i in np.argwhere(~np.isfinite(samples.volts))[0])
        where = f"channel {channel}, sample {sample}" + (f" of shot {shot}" if n_shots > 1 else "")
        raise InputError(
            f"{samples.path}: {where} is {samples.volts[shot, channel, sample]}; every sample must be a number. "
            f"{int(np.sum(~np.isfinite(samples.volts)))} of {samples.volts.size} are not."
        )
    check_units(samples.path, samples.volts, rig)
    field = samples.volts * (1e-6 / section.sensitivity_v_per_ut) / rig.sensor_gains[:, None]
    recordings, notes = [], []
    for shot in range(n_shots):
        unsound = find_invalid_channels(samples.volts[shot], samples.sample_rate, rig)
        notes_of_shot = []
        for why, bad in unsound.items():
            if bad.any():
                which = ", ".join(str(i) for i in np.flatnonzero(bad))
                notes_of_shot.append(f"left out: {why} channel{'s' if bad.sum() > 1 else ''} {which}")
        recordings.append(
            Recording(
                field[shot], samples.sample_rate, float(samples.time_since_drive[shot]),
                np.any(list(unsound.values()), axis=0),
                clock=float(samples.clock[shot]),
            )
        )  # fmt: skip
        notes.append("; ".join(notes_of_shot))
    return SampleRecordings(tuple(recordings), tuple(notes))


def _check_keys(path: Path, values: Mapping[str, Any], quiet: bool) -> None:
    unknown = sorted(set(values) - set(KEYS))
    if unknown:
        hint = suggest_name(unknown[0], KEYS)
        raise InputError(f"{path}: unknown key {', '.join(unknown)}; known keys: {', '.join(KEYS)}.{hint}")
    needed = KEYS[:2] if quiet else KEYS[:3]
    missing = [key for key in needed if key not in values]
    if missing:
        how = {
            "volts": "the samples, shape (n_channels, n) or (n_shots, n_channels, n), in V",
            "sample_rate_hz": "samples per second of each channel",
            "time_since_drive_ms": "from the end of the excitation to the first sample",
        }
        spoken = [key for key in missing if key != "volts"]
        header = f" Put it into a header line, such as '# {spoken[0]} = 20'." if spoken else ""
        header = header if path.suffix.lower() == ".csv" else ""
        missing_keys = "; ".join(f"{key} ({how[key]})" for key in missing)
        raise InputError(f"{path}: missing {missing_keys}.{header}")


def _parse_numbers(path: Path, key: str, value: Any) -> FloatArray:
    try:
        array = np.asarray(value)
        if array.dtype.kind not in "iuf":
            raise ValueError(f"they are of type {array.dtype}")
        return array.astype(np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{path}: {key} must be real numbers: {error}.") from error


def _parse_per_shot(path: Path, key: str, values: Mapping[str, Any], n_shots: int) -> FloatArray:
    """Read one number for each shot, shape (n_shots,), from one number or as many."""
    given = np.ravel(_parse_numbers(path, key, values[key]))
    if given.size not in (1, n_shots) or not np.isfinite(given).all():
        many = f"one finite number, or one for each of {n_shots} shots" if n_shots > 1 else "one finite number"
        raise InputError(f"{path}: {key} must be {many}; got {given.tolist() if given.size < 6 else given.shape}.")
    return np.broadcast_to(given, (n_shots,)).copy()


def _read_npz(path: Path) -> dict[str, Any]:
    try:
        with np.load(path, allow_pickle=False) as held:
            return {key: held[key] for key in held.files}
    except EOFError as error:
        raise InputError(f"{path}: cannot be read as .npz: the file is empty.") from error
    except (OSError, ValueError, zipfile.BadZipFile, AttributeError) as error:
        raise InputError(f"{path}: cannot be read as .npz: {error}.") from error


def _read_mat(path: Path) -> dict[str, Any]:
    """Read a MATLAB file; those of v7.3 are HDF5, with axes in reverse order."""
    import h5py
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    if h5py.is_hdf5(path):
        return {key: np.asarray(value).T for key, value in _read_hdf5(path).items()}
    try:
        held = loadmat(path)
    except (OSError, ValueError, TypeError, NotImplementedError, MatReadError) as error:
        raise InputError(f"{path}: cannot be read as a MATLAB file: {error}.") from error
    return {key: value for key, value in held.items() if not key.startswith("__")}


def _read_hdf5(path: Path) -> dict[str, Any]:
    import h5py

    try:
        with h5py.File(path, "r") as held:
            groups = [key for key, value in held.items() if not isinstance(value, h5py.Dataset)]
            own = [key for key in groups if not key.startswith("#")]  # MATLAB keeps '#refs#' beside the data
            if own:
                raise InputError(f"{path}: {own[0]} is a group; {', '.join(KEYS)} must stand at the root.")
            values = {key: value[()] for key, value in held.items() if key not in groups}
            return {key: value for key, value in held.attrs.items() if key in KEYS} | values
    except OSError as error:
        raise InputError(f"{path}: cannot be read as HDF5: {error}.") from error


def _read_csv(path: Path) -> dict[str, Any]:
    """Read header lines ``# key = value``, an optional line of column names, then a row per sample."""
    table = read_table(path)
    values: dict[str, Any] = {}
    for comment in table.comments:
        key, equals, text = comment.text.lstrip("# \t").partition("=")
        if equals:
            values[key.strip()] = comment.parse_number(text, key.strip())
    rows = [[row.parse_number(cell, f"column {i}") for i, cell in enumerate(row.cells)] for row in table.rows]
    for row, numbers in zip(table.rows, rows, strict=True):
        if len(numbers) != len(rows[0]):
            raise row.make_error(f"has {len(numbers)} columns; the rows above have {len(rows[0])}.")
    if rows:
        values["volts"] = np.array(rows).T
    return values
