"""``smolbot recover``: completes a run that was killed, as far as its record goes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from smolbot.ui.cli.options import JsonOption

if TYPE_CHECKING:
    from smolbot.runs.recover import Recovery


def recover(
    run: Annotated[Path, typer.Argument(help="Run folder, or the record in it.", metavar="RUN")],
    json: JsonOption = False,
) -> None:
    """Complete the folder of a killed run: record, summary, cycles, picture. A complete run is not changed."""
    from smolbot.runs.recover import recover as make_whole
    from smolbot.ui.cli.show import echo_json, print_table

    done = make_whole(run)
    summary = make_summary(done)
    print_table(f"recover {run}", _make_rows(done, summary), err=json)
    if json:
        echo_json(summary)


def make_summary(done: Recovery) -> dict[str, Any]:
    """Build the JSON output of a recovery: what was found, what is missing, what was done.

    Parameters
    ----------
    done : Recovery

    Returns
    -------
    dict
    """
    found = done.found
    flown = found.run()
    numbers = found.number_of_cycle
    return {
        "record": str(found.path),
        "needed": done.needed,
        "whole": found.whole,
        "ended": found.end is not None,
        "status": flown.status,
        "stop_reason": flown.stop_reason,
        "messages": found.messages,
        "shots": len(found.played),
        "cycles": len(numbers),
        "last_s": flown.duration,
        "lost_bytes": found.lost,
        "dropped": found.dropped,
        "cycles_missing_between": numbers[-1] + 1 - len(numbers) if numbers else 0,
        "cycles_not_recorded": done.cycles_not_recorded,
        "torn": None if done.torn is None else str(done.torn),
        "written": done.written,
        "not_written": done.reason_not_written or None,
    }


def _make_rows(done: Recovery, summary: dict[str, Any]) -> list[tuple[str, str]]:
    held = f"{summary['shots']} shots, {summary['cycles']} cycles, until {summary['last_s']:.3f} s"
    rows = [
        ("found", f"{summary['messages']} messages: {held}"),
        ("run", f"{summary['status']}: {summary['stop_reason']}"),
    ]
    missing = [
        (summary["lost_bytes"], "bytes hold nothing that can be read"),
        (summary["dropped"], "messages were dropped while it flew"),
        (summary["cycles_missing_between"], "cycles before the last are missing"),
        (summary["cycles_not_recorded"], "more cycles stand in cycles.csv than in the record"),
    ]
    parts = [f"{count} {what}" for count, what in missing if count]
    if not summary["ended"]:
        parts.append("what the last half second before the end held, if anything")
    rows.append(("missing", "; ".join(parts) or "nothing"))
    if not done.needed:
        return [*rows, ("done", "nothing to recover")]
    if done.torn is not None:
        rows.append(("record", f"written anew; as found it is kept as {done.torn.name}"))
    if done.written:
        rows.append(("written", ", ".join(done.written)))
    if done.reason_not_written:
        rows.append(("not written", done.reason_not_written))
    return rows
