"""``smolbot run``: flies a mission and prints its result."""

from __future__ import annotations

from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from smolbot.ui.cli.show import echo_json, print_table

if TYPE_CHECKING:
    from smolbot.config.load import AnyMission
    from smolbot.runs.run import Listener, Run

from smolbot.ui.cli.options import (
    FaultOption,
    ForceOption,
    JsonOption,
    MissionArgument,
    RigOption,
    SetOption,
    add_faults,
    parse_settings,
    require_tank,
)


def run(
    mission: MissionArgument,
    rig: RigOption = None,
    seed: Annotated[int, typer.Option(min=0, help="Same seed, same run, bit for bit.")] = 1,
    out: Annotated[Path | None, typer.Option(help="Run folder to make; default: a new one in runs/.")] = None,
    set_: SetOption = None,
    fault: FaultOption = None,
    gui: Annotated[bool, typer.Option("--gui", help="Show the simulated world in a window.")] = False,
    live: Annotated[
        bool, typer.Option("--live", help="Show it on a console, from which it can be stopped too.")
    ] = False,
    report: Annotated[bool, typer.Option(help="Write report.html into the run folder at the end.")] = True,
    force: ForceOption = None,
    json: JsonOption = False,
) -> None:
    """Fly a mission in closed loop, or observe a device; leaves a run folder with figures and picture."""
    from smolbot.config.load import load_mission
    from smolbot.core.operator import TerminalOperator
    from smolbot.flight.preview.missions import require_go
    from smolbot.flight.safety.stop_latch import Latch
    from smolbot.flight.safety.stop_signals import catch_stop_signals
    from smolbot.flight.session import fly, make_run_folder
    from smolbot.runs.folder import RunFolder
    from smolbot.ui.cli.live import connect_console
    from smolbot.ui.cli.progress import show_progress
    from smolbot.ui.cli.stop_key import STOP_KEY_REASON, Keyboard

    settings = add_faults(parse_settings(set_), fault)
    loaded = load_mission(mission, rig, settings)
    require_tank(loaded.rig, fault)
    folder = RunFolder(out) if out is not None else make_run_folder(loaded, seed)
    require_go(loaded, force)
    latch, operator = Latch(), TerminalOperator()
    keyboard = Keyboard(partial(latch.trip, STOP_KEY_REASON, "stopped"))
    with catch_stop_signals(latch), show_progress(loaded) as progress, keyboard:
        operator.pauses += [progress.pause, keyboard.pause]
        if keyboard.active:
            operator.say("q, Esc or Ctrl-C stops the run")

        def listeners(_: AnyMission) -> tuple[Listener, ...]:
            return (progress,)

        with connect_console(loaded, seed, latch, operator.say) if live else nullcontext((None, None)) as (pause, pump):
            flown = fly(
                loaded, seed, folder=folder, settings=settings, gui=gui, make_listeners=listeners, operator=operator,
                latch=latch, report=report, pause=pause, make_live_sink=pump,
            )  # fmt: skip
    _show_run(loaded, flown, json)
    raise typer.Exit(_choose_exit_code(flown))


def _choose_exit_code(run: Run) -> int:
    if run.status in ("stopped", "failed"):
        return 3
    return 0 if run.summary["verdict"] == "passed" else 1


def _show_run(mission: AnyMission, run: Run, json: bool) -> None:
    from smolbot.runs.report.figures_of_merit import append_unit, get_unit
    from smolbot.runs.summary import format_label
    from smolbot.ui.cli.observations import make_observation_rows

    s = run.summary
    rows = [
        ("status", f"{s['status']}: {s['stop_reason']}"),
        ("verdict", "; ".join([str(s["verdict"]), *_format_reasons(s["verdict_reasons"])])),
        ("robot time" if "path_length_mm" in s else "time", f"{s['duration_s']:.1f} s, {s['cycles']} cycles"),
        ("loop rate", f"{s['loop_rate_hz']:.2f} Hz (timeline allows {s['timeline_limit_hz']:.2f} Hz)"),
        ("compute time", _format_compute_time(s)),
    ]
    for key, label in (
        ("localization_error_mm", "localization error"),
        ("tracked_error_mm", "tracked pose error"),
        ("orientation_error_deg", "orientation error"),
        ("axis_error_deg", "axis error"),
        ("axis_error_tracked_deg", "axis error, tracked"),
        ("axis_to_path_deg", "axis against path"),
        ("tracking_error_mm", "tracking error"),
    ):
        values: Any = s.get(key, {})
        shown = [append_unit(f"{name} {values[name]:.2f}", get_unit(key)) for name in ("mean", "p95") if name in values]
        if shown:
            rows.append((label, ", ".join(shown)))
    if "visited_share" in s:
        rows.append(("path visited", _format_visited(s)))
    rows += make_observation_rows(s)
    if s["r_squared_median"] is not None:
        rows.append(("R² (median)", f"{s['r_squared_median']:.4f}"))
    if "turns" in s:
        rows.append(("magnet", f"{s['turns']:g} turns, {s['pauses']} pauses, {s['step_outs']} step-outs"))
    elif "coil_energy_j" in s:
        rows.append(("coil energy", f"{s['coil_energy_j']:.0f} J"))
    if s.get("duty_peak"):
        rows.append(("coils", _format_coils(s)))
    if text := _format_recovered(s):
        rows.append(("recovered", text))
    if text := _format_not_recorded(s.get("recording", {})):
        rows.append(("not recorded", text))
    rows.append(("wall time", f"{s['wall_s']:.1f} s, {s['realtime_factor']:.0f} times real time"))
    rows.append(("picture", f"{run.folder}/path.png"))
    if run.report:
        rows.append(("report", run.report))
    print_table(f"{mission.name} on {mission.rig.name}{format_label(s)}", rows, err=json)
    if json:
        echo_json(s)


def _format_coils(summary: dict[str, Any]) -> str:
    """Describe the highest duty cycle, and the coil that came nearest to its limit, counted from 20 °C."""
    duty: dict[str, float] = summary["duty_peak"]
    busiest = max(duty, key=lambda name: duty[name])
    text = f"driven for at most {100 * duty[busiest]:.0f} % of the time ({busiest})"
    peaks, limits = summary["coil_temperature_peak_c"], summary["coil_temperature_limit_c"]
    if not peaks:
        return text
    hottest = max(peaks, key=lambda name: (peaks[name] - 20.0) / (limits[name] - 20.0))
    return f"{text}, {peaks[hottest]:.0f} °C at most ({hottest}; limit {limits[hottest]:g} °C)"


def _format_visited(summary: dict[str, Any]) -> str:
    """Describe the share of the path that was visited in order, and the longest part that was not.

    Examples
    --------
    >>> _format_visited({"visited_share": 0.532, "longest_skip": "25.7 mm near (-8.0, 0.2) mm"})
    '53.2 % in order; skipped 25.7 mm near (-8.0, 0.2) mm'
    """
    skipped = f"; skipped {summary['longest_skip']}" if summary["longest_skip"] else ""
    return f"{100.0 * summary['visited_share']:.1f} % in order{skipped}"


def _format_recovered(summary: dict[str, Any]) -> str:
    return ", ".join(f"{kind.replace('_', ' ')}: {times}" for kind, times in summary["recovered"].items() if times)


def _format_not_recorded(recording: Any) -> str:
    """Describe what is missing from the record, and why; empty if nothing is.

    Examples
    --------
    >>> _format_not_recorded({"dropped": 3, "error": "OSError: the disk is full"})
    '3 messages: OSError: the disk is full'
    """
    dropped = recording.get("dropped")
    parts = [f"{dropped} messages" if dropped else "", str(recording.get("error") or "")]
    return ": ".join(part for part in parts if part)


def _format_reasons(value: Any) -> list[str]:
    return [str(v) for v in value]


def _format_compute_time(summary: dict[str, Any]) -> str:
    times = summary["compute_ms"]
    if times["median"] is None:
        return "no cycle was played"
    return f"median {times['median']:.2f} ms, p99 {times['p99']:.2f} ms (budget {summary['turnaround_ms']:g} ms)"
