"""Recover a run after a kill: a complete record from a torn one, and the rest of the run folder from the record."""

from __future__ import annotations

import contextlib
import csv
import json
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from smolbot.config.load import AnyMission
from smolbot.errors import InputError, SmolbotError
from smolbot.runs.folder import CYCLES, PICTURE, PROVENANCE, SUMMARY, encode_json, write_atomically
from smolbot.runs.outcome import draw_run_picture, summarise_run
from smolbot.runs.recording import run_pb2 as pb
from smolbot.runs.recording.reader import RecordedRun, find_record, read_run
from smolbot.runs.recording.recorder import RECORD, McapFile, lock, make_end_message
from smolbot.runs.recording.scan import Scan
from smolbot.runs.run import Run
from smolbot.runs.trace import Trace, make_cycle_row

TORN = "run.torn.mcap"
"""What a record is kept as that was written anew."""

_FLUSH_EVERY = 500  # messages


@dataclass
class Recovery:
    """Result of a recovery.

    Attributes
    ----------
    found : RecordedRun
        The record before the recovery.
    torn : Path or None
        Where the old record is kept, if it was rewritten.
    written : list of str
        Files that were written into the folder.
    cycles_not_recorded : int
        Cycles that ``cycles.csv`` has and the record does not.
    reason_not_written : str
        Why summary and picture could not be made; empty if they could.
    """

    found: RecordedRun
    torn: Path | None = None
    written: list[str] = field(default_factory=list)
    cycles_not_recorded: int = 0
    reason_not_written: str = ""

    @property
    def needed(self) -> bool:
        """Whether there was anything to recover."""
        return bool(self.torn or self.written or self.reason_not_written)


def recover(run: str | Path) -> Recovery:
    """Complete a run as far as its record goes; a complete one is left as it is.

    A torn or damaged record is rewritten and the old one kept as ``run.torn.mcap``. Missing files of the folder are
    made from it. Nothing is written before everything is read, and no file is overwritten but a torn summary or
    picture.

    Parameters
    ----------
    run : str or Path
        Run folder, or its record.

    Returns
    -------
    Recovery

    Raises
    ------
    InputError
        If it is no record, its run still goes on, or a file cannot be written.
    """
    path = _find_record(run)
    if path.name == TORN and path.with_name(RECORD).exists():
        raise InputError(f"{path}: {RECORD} stands beside it; recover that one, or the folder.")
    _check_not_running(path)
    done = Recovery(read_run(path))
    try:
        target = path.with_name(RECORD) if path.name == TORN else path
        if not done.found.whole or path != target:
            done.torn = _rewrite(done.found, target)
        if target.name == RECORD:
            _complete(done, target)
    except OSError as error:
        raise InputError(f"{path.parent}: the run cannot be completed: {error}.") from error
    return done


def _find_record(run: str | Path) -> Path:
    """Return the path of the record, or of the torn one that an interrupted recovery left."""
    folder = Path(run)
    if folder.is_dir() and not (folder / RECORD).exists() and (folder / TORN).is_file():
        return folder / TORN
    return find_record(run)


def _check_not_running(path: Path) -> None:
    try:
        with path.open("rb") as file:
            free = lock(file)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}.") from error
    if not free:
        raise InputError(f"{path}: is still being written: the run goes on. End it first.")


def _rewrite(found: RecordedRun, target: Path) -> Path:
    """Write a complete record in the place of the old one; return where the old one is kept."""
    part = target.with_name(f"{target.name}.part")
    part.unlink(missing_ok=True)
    scan, file, last = Scan(found.path), McapFile(part), 0
    for number, message in enumerate(scan.read_messages()):
        if message.topic is not None:
            file.append(message.topic, message.time, message.data)
            last = max(last, message.time)
        if number % _FLUSH_EVERY == 0:
            file.flush()
    recovered = pb.Recovered(lost_bytes=_count_lost_bytes(found), ended=found.end is not None)
    file.append("/run/recovered", last, recovered.SerializeToString())
    if found.end is None:
        file.append("/run/end", last, make_end_message(found.run()).SerializeToString())
    file.close()
    again = read_run(part)
    if not again.whole or len(again.moments) != len(found.moments) or len(again.played) != len(found.played):
        raise InputError(f"{part}: does not hold what was read of {found.path}; that one was left as it is.")
    if found.path != target:  # the old one is out of the way already
        part.replace(target)
        return found.path
    kept = _find_free_name(target)
    if not kept.exists():
        try:
            os.link(target, kept)  # so that there is no moment without a record
        except OSError:
            target.rename(kept)
    part.replace(target)
    return kept


def _find_free_name(target: Path) -> Path:
    kept, number = target.with_name(f"{target.stem}.torn{target.suffix}"), 2
    while kept.exists() and not kept.samefile(target):  # the same: another recovery was cut short just here
        kept, number = target.with_name(f"{target.stem}.torn-{number}{target.suffix}"), number + 1
    return kept


def _complete(done: Recovery, target: Path) -> None:
    """Make the missing files of the folder."""
    found, folder = done.found, target.parent
    contents = {**found.begin.files, PROVENANCE: encode_json(found.provenance)}
    for name, content in contents.items():
        if not (folder / name).is_file():
            write_atomically(folder / name, content)
            done.written.append(name)
    if found.moments and not (folder / CYCLES).is_file():
        write_cycles(folder / CYCLES, found)
        done.written.append(CYCLES)
    done.cycles_not_recorded = max(_count_rows(folder / CYCLES) - len(found.moments), 0)
    lacks = [name for name, sound in ((SUMMARY, _is_json), (PICTURE, _is_png)) if not sound(folder / name)]
    if not lacks:
        return
    try:
        mission = found.mission()
    except SmolbotError as error:  # e.g. one whose plug-in is not installed here
        done.reason_not_written = f"{', '.join(lacks)} cannot be made, since the mission cannot be loaded: {error}"
        return
    run, trace = found.run(), found.trace()
    run.folder = str(folder)
    run.summary = _compute_figures(done, mission, run, trace)
    if SUMMARY in lacks:
        write_atomically(folder / SUMMARY, encode_json(run.summary))
    if PICTURE in lacks:
        draw_run_picture(mission, run, trace, folder / PICTURE)
    done.written += lacks


def _compute_figures(done: Recovery, mission: AnyMission, run: Run, trace: Trace) -> dict[str, Any]:
    """Compute the figures of a run from its record, with what is lost of it."""
    found = done.found
    figures = summarise_run(mission, run, trace, int(found.provenance["seed"]), found.provenance["world"])
    figures["recording"] = {
        "dropped": found.dropped,
        "error": None,
        "recovered": {
            "last_s": run.duration,
            "lost_bytes": _count_lost_bytes(found),
            "cycles_not_recorded": done.cycles_not_recorded,
        },
    }
    return figures


def _count_lost_bytes(found: RecordedRun) -> int:
    """Return the number of unreadable bytes, of this record and of the one that it was rewritten from."""
    return found.lost + (found.recovered.lost_bytes if found.recovered is not None else 0)


def write_cycles(path: Path, found: RecordedRun) -> None:
    """Write ``cycles.csv`` as the flight would have written it.

    Parameters
    ----------
    path : Path
    found : RecordedRun
    """
    part = path.with_name(f"{path.name}.part")
    rows = [make_cycle_row(number, moment) for number, moment in zip(found.number_of_cycle, found.moments, strict=True)]
    with part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    part.replace(path)


def _count_rows(path: Path) -> int:
    if not path.is_file():
        return 0
    with path.open(newline="", encoding="utf-8", errors="replace") as file:
        return sum(1 for _ in csv.reader(file)) - 1


def _is_json(path: Path) -> bool:
    with contextlib.suppress(OSError, ValueError):
        return isinstance(json.loads(path.read_bytes()), dict)
    return False


def _is_png(path: Path) -> bool:
    with contextlib.suppress(OSError):
        content = path.read_bytes()
        return content.startswith(b"\x89PNG") and content[-8:-4] == b"IEND"
    return False
