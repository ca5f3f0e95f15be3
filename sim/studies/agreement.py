"""How often preview and flights agree, on rigs, robots and missions that are drawn at random.

A preview is right if what it calls go ends and passes, and what it calls no-go does not when it is flown all the same.
Files that are refused as they are read cannot be flown, and are counted by themselves. No two study seeds share a
world, so that what was mended with one can be reported with another.
"""

from __future__ import annotations

import math
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from sim.studies.columns import join_columns, make_columns, select_rows
from sim.studies.drawn_rigs import write_drawn_world
from sim.studies.study import Chunk, Columns, Options, Outcome, Study, cut_chunks
from smolbot.errors import ConfigError

DEFAULT_WORLDS = 60
"""Worlds of one study: its rates are known to some per cent."""

FLIGHTS = 1
"""Flights of each world, with seeds from 0: more worlds say more than more flights of one."""

MAX_REASON = 300
"""Characters of a reason that are kept."""

Row = dict[str, Any]


def run_chunk(chunk: Chunk) -> Columns:
    """Draw one world, preview it, and fly it whatever the preview says.

    Parameters
    ----------
    chunk : Chunk

    Returns
    -------
    Columns
        One row.
    """
    with tempfile.TemporaryDirectory() as folder:
        drawn = write_drawn_world(Path(folder), chunk["study_seed"], chunk["world"])
        row = {"world": chunk["world"], **drawn, **_judge(Path(folder) / "mission.toml")}
    return make_columns([row])


def _judge(path: Path) -> Row:
    """Preview and fly a mission; refused ones are not flown."""
    from smolbot.config.load import load_mission
    from smolbot.flight.preview.gradient import preview
    from smolbot.flight.session import fly

    row: Row = {"refused": False, "go": False, "reason": "", "told_s": math.nan, "drawn_share": math.nan}
    row |= {"passed": False, "status": "", "ended_by": "", "flown_s": math.nan, "tracking_mm": math.nan}
    try:
        mission = load_mission(str(path))
    except ConfigError as error:
        return row | {"refused": True, "reason": str(error).replace(f"{path.parent}/", "")[:MAX_REASON]}
    try:
        found = preview(mission, seek_remedy=False)  # type: ignore[arg-type]  # it steers
        row |= {"go": found.go, "reason": " ".join(found.reasons)[:MAX_REASON], "told_s": found.duration}
        row |= {"drawn_share": math.nan if found.worlds is None else found.worlds.share}
        figures: list[dict[str, Any]] = [fly(mission, seed).summary for seed in range(FLIGHTS)]
    except Exception as error:  # one bad world is one failed row, which names the error
        return row | {"status": "error", "ended_by": f"{type(error).__name__}: {error}"[:MAX_REASON]}
    worst = next((f for f in figures if f["verdict"] != "passed"), figures[0])
    ended_by = "; ".join(dict.fromkeys([worst["stop_reason"], *worst["verdict_reasons"]]))
    return row | {
        "passed": all(f["verdict"] == "passed" for f in figures),
        "status": worst["status"],
        "ended_by": ended_by[:MAX_REASON],
        "flown_s": float(worst["duration_s"]),
        "tracking_mm": float(worst.get("tracking_error_mm", {}).get("mean", math.nan)),
    }


def make_chunks(options: Options) -> list[Chunk]:
    """Make a chunk for each world.

    Parameters
    ----------
    options : Options
        `poses` is the number of worlds.

    Returns
    -------
    list of Chunk
    """
    count = options.poses or DEFAULT_WORLDS
    pieces = [(f"world-{n:03d}", {"world": n, "study_seed": options.seed}) for n in range(count)]
    return cut_chunks(options, run_chunk, pieces)


def conclude(options: Options, parts: list[Columns]) -> Outcome:
    """Count how often the preview was right, and list the worlds in which it was not.

    Parameters
    ----------
    options : Options
    parts : list of Columns
        One per chunk, in order.

    Returns
    -------
    Outcome
    """
    columns = join_columns(parts)
    flown = select_rows(columns, refused=False)
    go, passed = np.asarray(flown["go"]), np.asarray(flown["passed"])
    counts = {
        "go_passed": int(np.sum(go & passed)),
        "go_failed": int(np.sum(go & ~passed)),
        "no_go_passed": int(np.sum(~go & passed)),
        "no_go_failed": int(np.sum(~go & ~passed)),
        "refused": int(np.sum(columns["refused"])),
    }
    told_no = counts["no_go_passed"] + counts["no_go_failed"] + counts["refused"]
    figures: dict[str, Any] = {
        "worlds": len(columns["world"]),
        **counts,
        "no_go_passed_share": counts["no_go_passed"] / max(told_no, 1),
        "wrong": [
            {"world": int(flown["world"][i]), "go": bool(go[i]), "told": str(flown["reason"][i]),
             "flown": str(flown["ended_by"][i])}
            for i in np.flatnonzero(go != passed)
        ],
    }  # fmt: skip
    rows = [
        ("go", f"{counts['go_passed']} passed, {counts['go_failed']} failed"),
        ("no-go, flown all the same", f"{counts['no_go_failed']} failed, {counts['no_go_passed']} passed"),
        ("refused as it was read", str(counts["refused"])),
        *((f"world {w['world']}, {'go' if w['go'] else 'no-go'}", w["told"] or w["flown"]) for w in figures["wrong"]),
    ]
    return Outcome(rows, figures, columns)


def draw(outcome: Outcome, path: Path) -> None:
    """Draw the duration that was told against the one that was flown, and the counts.

    Parameters
    ----------
    outcome : Outcome
    path : Path
        PNG to write.
    """
    from sim.batch.slide import COLORS, open_slide, set_titles

    figures, columns = outcome.figures, select_rows(outcome.columns, refused=False, go=True)
    headline = f"{figures['go_passed']} of {figures['go_passed'] + figures['go_failed']} go passed"
    no_go = figures["no_go_passed"] + figures["no_go_failed"]
    subline = f"{figures['no_go_passed']} of {no_go} no-go passed when flown all the same; {figures['refused']} refused"
    with open_slide(path, headline, subline) as (axes,):
        for passed, color in ((True, COLORS["whitened"]), (False, COLORS["paper"])):
            part = select_rows(columns, passed=passed)
            axes.plot(part["told_s"], part["flown_s"], "o", color=color, label="passed" if passed else "failed")
        most = float(np.nanmax(np.concatenate([columns["told_s"], columns["flown_s"], [1.0]])))
        axes.plot([0.0, most], [0.0, most], color="#999999", lw=1, ls="--")
        axes.legend(frameon=False)
        set_titles(axes, "Duration of what was a go, in s", "told", "flown")


STUDY = Study(
    name="agreement",
    title="Preview against flights on drawn rigs",
    devices=dict,
    chunks=make_chunks,
    conclude=conclude,
    draw=draw,
    notes={"worlds": "sim.studies.drawn_rigs", "flights_of_each": FLIGHTS},
)
