"""Export recordings of a run as a file of samples, which ``smolbot localize`` reads like a lab's own."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from smolbot.errors import InputError
from smolbot.runs.recording.exporting import FORMATS, write_samples_csv, write_via_temporary
from smolbot.runs.recording.reader import RecordedRun
from smolbot.runs.recording.tables import compute_volts


def parse_shots(text: str) -> list[int]:
    """Parse numbers of shots.

    Parameters
    ----------
    text : str
        Numbers and ranges, separated by commas.

    Returns
    -------
    list of int

    Raises
    ------
    InputError
        For anything but numbers and ranges.

    Examples
    --------
    >>> parse_shots("3, 7-9")
    [3, 7, 8, 9]
    """
    found: list[int] = []
    for part in text.split(","):
        first, dash, last = part.strip().partition("-")
        if not first.isdigit() or (dash and not last.isdigit()):
            raise InputError(f"--shots wants numbers and ranges, such as 12,20-40; got '{text}'.")
        found += range(int(first), int(last if dash else first) + 1)
    return found


def export_samples(run: RecordedRun, kind: str, out: Path, shots: list[int], *, force: bool = False) -> None:
    """Write the samples of some shots in V, with sample rate, time and time since the drive.

    Parameters
    ----------
    run : RecordedRun
    kind : {"h5", "csv", "mat"}
    out : Path
        File to write.
    shots : list of int
        Numbers of the shots.
    force : bool
        Overwrite an earlier export.

    Raises
    ------
    InputError
        For an unknown format, shots without a recording, or shots that do not fit into one file; if `out` exists
        (unless `force`), or cannot be written.
    """
    if kind not in FORMATS:
        raise InputError(f"--format {kind}: is not known; known: {', '.join(FORMATS)}.")
    recorded = {played.number: recording for played, recording in run.recordings()}
    missing = [number for number in shots if number not in recorded]
    if missing or not shots:
        span = f"{min(recorded)} to {max(recorded)}" if recorded else "none"
        raise InputError(
            f"{run.path}: shot {missing[0] if missing else 'none'} has no recording; recorded were {span}."
        )
    recordings = [recorded[number] for number in shots]
    lengths = sorted({(r.field.shape[1], r.sample_rate) for r in recordings})
    if len(lengths) > 1:
        lengths_text = ", ".join(f"{n} at {rate:g} Hz" for n, rate in lengths[:4])
        raise InputError(
            f"--shots: these have unequal numbers of samples ({lengths_text}); a file of samples holds equal ones."
        )
    driven = [bool(np.isfinite(r.time_since_drive)) for r in recordings]
    if any(driven) and not all(driven):
        raise InputError("--shots: some of these were driven and some were quiet; export them one kind at a time.")
    if kind == "csv" and len(shots) > 1:
        raise InputError(f"--shots: a .csv file holds one shot, not {len(shots)}; use --format h5 or mat.")
    held: dict[str, Any] = {
        "volts": np.array([compute_volts(run, r) for r in recordings]),
        "sample_rate_hz": recordings[0].sample_rate,
        "clock_s": np.array([r.clock for r in recordings]),
    }
    if all(driven):
        held["time_since_drive_ms"] = np.array([1e3 * r.time_since_drive for r in recordings])
    write_via_temporary(out, lambda part: _write(part, kind, held), force=force)


def _write(path: Path, kind: str, held: dict[str, Any]) -> None:
    if kind == "csv":
        head = {name: float(np.ravel(value)[0]) for name, value in held.items() if name != "volts"}
        write_samples_csv(path, held["volts"][0], head)
    elif kind == "mat":
        from scipy.io import savemat

        with path.open("wb") as file:
            savemat(file, held, do_compression=True)
    else:
        import h5py

        with h5py.File(path, "w") as file:
            for name, value in held.items():
                file[name] = value
