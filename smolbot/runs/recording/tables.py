"""A recorded run as tables: named columns with the unit in the name, each value bit for bit as it was recorded."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smolbot.core.pose import Pose
from smolbot.core.sensing import Recording
from smolbot.core.shots import Actuate, Excite, Listen, MoveMagnet, Rest, RingDown, Rotate, Window
from smolbot.runs.recording.reader import PlayedShot, RecordedRun
from smolbot.runs.run import CycleRecord
from smolbot.runs.trace import Moment

Column = NDArray[Any] | list[str]
"""Numbers, the first axis being rows, or text."""

NumberedCycle = tuple[int, CycleRecord]


@dataclass(frozen=True)
class RunTable:
    """Columns of equal length.

    Attributes
    ----------
    what : str
        Meaning of a row.
    columns : dict
        Values by column name.
    """

    what: str
    columns: dict[str, Column]

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))


def make_tables(run: RecordedRun) -> dict[str, RunTable]:
    """Build every table of a run except the samples; rows with equal `cycle` or `shot` belong together.

    Vectors are in the world frame, quaternions scalar first; covariances (6, 6) of position in m and rotation in
    rad.

    Parameters
    ----------
    run : RecordedRun

    Returns
    -------
    dict of str to Table
    """
    moments = list(zip(run.number_of_cycle, run.moments, strict=True))
    cycles = [(n, m.cycle) for n, m in moments]
    shots = ((p.number, p.shot.windows) for p in run.played)
    commanded = ((n, _list_windows(c.command.window)) for n, c in cycles)
    return {
        "shots": _make_shots_table(run),
        "windows": _make_windows_table("a window of a shot, in order", "shot", shots),
        "cycles": _make_cycles_table(run, cycles),
        "poses_raw": _make_poses_table("a pose as located", [(n, c.pose) for n, c in cycles]),
        "poses_tracked": _make_poses_table("an estimated pose", [(n, c.tracked) for n, c in cycles]),
        "poses_true": _make_poses_table(
            "where the device truly was at the time of the pose", [(n, m.truth) for n, m in moments]
        ),
        "poses_true_at_end": _make_poses_table(
            "where the device truly was at the end of the shot", [(n, m.truth_at_end) for n, m in moments]
        ),
        "way_true": _make_way_table(moments),
        "commands": _make_commands_table(cycles),
        "command_windows": _make_windows_table("a window of a command, in order", "cycle", commanded),
        "events": _make_events_table(run),
    }


def make_samples_table(run: RecordedRun) -> tuple[RunTable, NDArray[np.float64]]:
    """Build the table of recordings, and the field of all of them.

    Parameters
    ----------
    run : RecordedRun

    Returns
    -------
    RunTable
        A row for each recording: its samples are rows `first` to `first` + `samples` - 1 of the field, counted from
        0.
    ndarray, shape (n_samples, n_sensors), in T
    """
    recordings = list(run.recordings())
    lengths = [recording.field.shape[1] for _, recording in recordings]
    n_sensors = len(run.converter.gains)
    table = RunTable(
        "a recording",
        {
            "shot": _to_ints(played.number for played, _ in recordings),
            "first": _to_ints(np.cumsum([0, *lengths])[:-1].tolist()),
            "samples": _to_ints(lengths),
            "clock_s": _to_floats(recording.clock for _, recording in recordings),
            "sample_rate_hz": _to_floats(recording.sample_rate for _, recording in recordings),
            "time_since_drive_s": _to_floats(recording.time_since_drive for _, recording in recordings),
            "saturated": np.array([r.saturated for _, r in recordings], np.bool_).reshape(len(recordings), n_sensors),
        },
    )
    return table, np.vstack([np.zeros((0, n_sensors)), *(recording.field.T for _, recording in recordings)])


def compute_volts(run: RecordedRun, recording: Recording) -> NDArray[np.float64]:
    """Convert a recording to the converter's volts, without the assumed gains.

    Parameters
    ----------
    run : RecordedRun
    recording : Recording

    Returns
    -------
    ndarray, shape (n_sensors, n), in V
    """
    converter = run.converter
    return recording.field * converter.gains[:, None] * converter.volts_per_tesla


def collect_facts(run: RecordedRun) -> dict[str, str | float | int | bool]:
    """Collect the facts of a run that are no table: seed, status, duration, converter, provenance.

    Parameters
    ----------
    run : RecordedRun

    Returns
    -------
    dict of str to str, float, int or bool
        Units are in the keys.
    """
    flown, where = run.run(), run.provenance
    converter = run.converter
    return {
        "written_by": f"smolbot {where['smolbot']}",
        "seed": int(where["seed"]),
        "status": flown.status,
        "stop_reason": flown.stop_reason,
        "duration_s": flown.duration,
        "begun_s": flown.begun,
        "wall_s": flown.wall,
        "whole": run.whole,
        "dropped_messages": run.dropped,
        "lost_bytes": run.lost,
        "converter_bits": converter.bits,
        "converter_range_v": converter.range,
        "sensitivity_v_per_t": converter.volts_per_tesla,
        "recovered_json": json.dumps(flown.recovered),
        "safety_json": json.dumps(flown.safety),
        "provenance_json": run.begin.provenance,
    }


def _make_shots_table(run: RecordedRun) -> RunTable:
    def of(get: Callable[[PlayedShot], Any]) -> Iterable[Any]:
        return (get(played) for played in run.played)

    return RunTable(
        "a shot that was played, those from which noise and decay were learned too",
        {
            "shot": _to_ints(of(lambda p: p.number)),
            "mode": list(of(lambda p: p.shot.mode)),
            "start_s": _to_floats(of(lambda p: p.shot.start)),
            "end_s": _to_floats(of(lambda p: p.shot.end)),
            "ended_s": _to_floats(of(lambda p: p.ended)),
            "heard": _to_bools(of(lambda p: p.samples is not None)),
        },
    )


def _make_cycles_table(run: RecordedRun, cycles: list[NumberedCycle]) -> RunTable:
    return RunTable(
        "a cycle: shot, pose, command",
        {
            "cycle": _to_ints(n for n, _ in cycles),
            "shot": _to_ints(run.shot_of_cycle),
            "mode": [c.shot.mode for _, c in cycles],
            "start_s": _to_floats(c.shot.start for _, c in cycles),
            "ended_s": _to_floats(c.ended for _, c in cycles),
            "compute_s": _to_floats(c.compute for _, c in cycles),
            "rig": [c.rig for _, c in cycles],
        },
    )


def _make_way_table(moments: list[tuple[int, Moment]]) -> RunTable:
    return RunTable(
        "a place on the way while nothing listened",
        {
            "cycle": _to_ints(n for n, m in moments for _ in m.way),
            "position_m": np.vstack([np.zeros((0, 3)), *(m.way for _, m in moments)]),
        },
    )


def _make_commands_table(cycles: list[NumberedCycle]) -> RunTable:
    return RunTable(
        "the controller's command after a cycle",
        {
            "cycle": _to_ints(n for n, _ in cycles),
            "phase": [c.command.phase for _, c in cycles],
            "progress_m": _to_floats(c.command.progress for _, c in cycles),
            "saturated": _to_bools(c.command.saturated for _, c in cycles),
            "done": _to_bools(c.command.done for _, c in cycles),
            "stuck": _to_bools(c.command.stuck for _, c in cycles),
            "note": [c.command.note for _, c in cycles],
            "event": [c.command.event for _, c in cycles],
        },
    )


def _make_events_table(run: RecordedRun) -> RunTable:
    return RunTable(
        "a change of device, noise model or sensors",
        {
            "time_s": _to_floats(e.time for e in run.events),
            "what": [e.what for e in run.events],
            "detail_json": [json.dumps(e.detail) for e in run.events],
        },
    )


def _make_poses_table(what: str, numbered: list[tuple[int, Pose | None]]) -> RunTable:
    """Build a table of poses; a cycle without one has no row."""
    there = [(number, pose) for number, pose in numbered if pose is not None]
    poses = [pose for _, pose in there]
    return RunTable(
        what,
        {
            "cycle": _to_ints(number for number, _ in there),
            "time_s": _to_floats(p.time for p in poses),
            "position_m": np.array([p.position for p in poses], float).reshape(-1, 3),
            "orientation": np.array([p.orientation for p in poses], float).reshape(-1, 4),
            "covariance": np.array([p.covariance for p in poses], float).reshape(-1, 6, 6),
            "r_squared": _to_floats(p.r_squared for p in poses),
            "flip_margin": _to_floats(p.flip_margin for p in poses),
            "trusted": _to_bools(p.trusted for p in poses),
        },
    )


def _list_windows(window: Window | tuple[Window, ...] | None) -> tuple[Window, ...]:
    return () if window is None else window if isinstance(window, tuple) else (window,)


def _make_windows_table(what: str, key: str, numbered: Iterable[tuple[int, Iterable[Window]]]) -> RunTable:
    """Build a table of windows; what a kind of window does not have is nan, or -1 for a count."""
    rows = [(number, index, window) for number, windows in numbered for index, window in enumerate(windows)]
    kinds = [window for _, _, window in rows]
    n_coils = max((len(w.currents) for w in kinds if isinstance(w, Actuate)), default=0)

    def of(kind: type[Any] | tuple[type[Any], ...], get: Callable[[Any], Any], size: int) -> NDArray[np.float64]:
        nothing = [np.nan] * size
        values = [get(w) if isinstance(w, kind) else nothing for w in kinds]
        return np.array(values, float).reshape(len(kinds), size)

    return RunTable(
        what,
        {
            key: _to_ints(number for number, _, _ in rows),
            "index": _to_ints(index for _, index, _ in rows),
            "kind": [_KINDS[type(window)] for window in kinds],
            "duration_s": _to_floats(window.duration for window in kinds),
            "currents_a": of(Actuate, lambda w: w.currents, n_coils),
            "excite_a": of(Excite, lambda w: w.currents, 2),
            "frequency_hz": of((Excite, Listen, Rotate), lambda w: [w.frequency], 1)[:, 0],
            "periods": _to_ints(w.cycles if isinstance(w, Excite) else -1 for w in kinds),
            "half_periods": _to_ints(w.half_periods if isinstance(w, Listen) else -1 for w in kinds),
            "axis": of(Rotate, lambda w: w.axis, 3),
            "turns": of(Rotate, lambda w: [w.turns], 1)[:, 0],
            "magnet_to": [w.to if isinstance(w, MoveMagnet) else "" for w in kinds],
        },
    )


_KINDS: dict[type[Any], str] = {
    Actuate: "actuate", Excite: "excite", RingDown: "ring-down", Listen: "listen", Rotate: "rotate",
    MoveMagnet: "move magnet", Rest: "rest",
}  # fmt: skip


def _to_ints(values: Iterable[int]) -> NDArray[np.int64]:
    return np.array(list(values), np.int64)


def _to_floats(values: Iterable[float]) -> NDArray[np.float64]:
    return np.array(list(values), np.float64)


def _to_bools(values: Iterable[bool]) -> NDArray[np.bool_]:
    return np.array(list(values), np.bool_)
