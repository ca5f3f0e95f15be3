"""Stability margins of a mission's loop along its path, and the gains nearest to a linear-quadratic regulator."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path

import numpy as np

from sim.analysis.flight import Model, simulate_flight
from sim.analysis.linear import Cycle, average_cycles, linearize_cycle
from sim.analysis.loop import SampledLoop, compute_margins
from sim.analysis.lqr import Weights, find_closest_gains, interpolate_gains
from sim.studies.columns import join_columns
from sim.studies.margins_report import collect_figures, format_files, format_rows
from sim.studies.study import Chunk, Columns, Options, Outcome, Study, cut_chunks
from smolbot.config.mission import Mission, load_steering_mission
from smolbot.config.plugins import load_plugin
from smolbot.core.arrays import FloatArray
from smolbot.errors import InputError

PARTS = 4
"""Pieces among which the cycles of a flight are divided."""

REACH = 4
"""Cycles before and after one over which its loop is averaged: about its settling time."""

FLIGHTS = 3
"""Seeds of the reduced plant with which gains are flown: those now, and those closest to the regulator."""

SHARES = (1.0, 0.5, 0.25)
"""Shares of the way to the regulator that are tried: the first with which as many flights pass is taken."""

MATRICES = {"motion": (2, 2), "feedback": (2, 2), "kalman": (3, 2), "sigma": (2,), "explained": (2,), "position": (2,)}
"""Arrays of a cycle that are kept, and their shapes."""


@lru_cache(maxsize=1)
def _load_mission(mission: str, rig: str | None, settings: tuple[tuple[str, str], ...]) -> Mission:
    return load_steering_mission(mission, rig, dict(settings))


@lru_cache(maxsize=1)
def _make_model(mission: str, rig: str | None, settings: tuple[tuple[str, str], ...]) -> Model:
    return Model(_load_mission(mission, rig, settings))


def load_study_mission(options: Options) -> Mission:
    """Load the mission of a study.

    Parameters
    ----------
    options : Options

    Returns
    -------
    Mission

    Raises
    ------
    InputError
        If no mission is named.
    """
    if options.mission is None:
        raise InputError("study margins needs a mission: smolbot study margins MISSION, such as r_path.")
    return _load_mission(options.mission, options.own_rig, options.settings)


def parse_weights(text: str | None) -> Weights:
    """Read the regulator's weights.

    Parameters
    ----------
    text : str or None

    Returns
    -------
    Weights
        The default without a text.
    """
    return Weights() if text is None else Weights.parse(text)


def make_chunks(options: Options) -> list[Chunk]:
    """Make the flight's cycles in some pieces, and the search for gains; an unreachable path is refused here.

    Parameters
    ----------
    options : Options

    Returns
    -------
    list of Chunk

    Raises
    ------
    InputError
        For a mission without a loop, or one that would not arrive on the controller's own model.
    """
    from sim.analysis.flight import require_loop
    from smolbot.flight.preview.gradient import preview

    mission = load_study_mission(options)
    require_loop(mission)
    found = preview(mission)
    if not found.go:
        raise InputError(f"{mission.name}: there is no flight to analyse: {' '.join(found.reasons)}")
    parse_weights(options.weights)
    given = {
        "weights": options.weights,
        "mission": options.mission,
        "own_rig": options.own_rig,
        "settings": options.settings,
    }
    pieces = [("gains", {**given, "seed": options.seed})]
    pieces += [(f"path-{i}", {**given, "part": i}) for i in range(PARTS)]
    return [*cut_chunks(options, search_gains, pieces[:1]), *cut_chunks(options, linearize_path, pieces[1:])]


def linearize_path(chunk: Chunk) -> Columns:
    """Linearise every `PARTS`-th cycle of the flight.

    Parameters
    ----------
    chunk : Chunk

    Returns
    -------
    Columns
    """
    model = _make_model(chunk["mission"], chunk["own_rig"], chunk["settings"])
    rows: list[tuple[int, Cycle]] = []
    for instant in simulate_flight(model, model.make_controller(), keep=lambda k: k % PARTS == chunk["part"]):
        if instant.tracker is not None and instant.command.phase == "follow" and not instant.command.done:
            rows.append((instant.number, linearize_cycle(model, instant)))
    cycles = [c for _, c in rows]
    out: Columns = {
        "cycle": np.array([number for number, _ in rows]),
        **{name: np.array([getattr(c, name) for c in cycles]) for name in ("arc", "speed", "duration", "wait")},
        "saturated": np.array([c.saturated for c in cycles]),
    }
    for name, shape in MATRICES.items():
        flat = np.array([getattr(c, name).ravel() for c in cycles]).reshape(len(cycles), math.prod(shape))
        out |= {f"{name}_{i}": flat[:, i] for i in range(flat.shape[1])}
    return out


def search_gains(chunk: Chunk) -> Columns:
    """Find gains closest to the regulator, and fly the reduced plant with the present gains and with these.

    Parameters
    ----------
    chunk : Chunk

    Returns
    -------
    Columns
    """
    model = _make_model(chunk["mission"], chunk["own_rig"], chunk["settings"])
    mission, found = model.mission, find_closest_gains(model, parse_weights(chunk["weights"]))
    names, settings = list(found.gains), dict(chunk["settings"])
    declared = load_plugin("controllers", mission.law).gains
    start = {name: float(mission.gains.get(name, declared[name].default)) for name in names}
    before = _fly_reduced(chunk, mission, settings)
    values, share, after = found.gains, 1.0, np.zeros((0, 4))
    for share in SHARES if names else ():
        values = interpolate_gains(declared, start, found.gains, share)
        after = _fly_reduced(
            chunk, mission, {**settings, **{f"controller.gains.{n}": repr(v) for n, v in values.items()}}
        )
        if np.sum(after[:, 3:]) >= np.sum(before[:, 3:]):
            break
    return {
        "_names": np.array(names, dtype=np.str_),
        "_values": np.array([values[n] for n in names]),
        "_start": np.array([start[n] for n in names]),
        "_share": np.array([share]),
        "_distance": np.array([found.before, found.after]),
        "_duration": np.array(found.duration),
        "_flights": np.array([found.flights]),
        "_flown_before": before,
        "_flown_after": after,
    }


def _fly_reduced(chunk: Chunk, mission: Mission, settings: Mapping[str, str]) -> FloatArray:
    """Rows (seed, tracking rms in mm, robot time in s, passed) of flights of the reduced plant; none on a bench."""
    from sim.batch.flights import PlantModel, fly_one
    from sim.reduced.rig import require_flyable

    try:
        require_flyable(mission)
    except InputError:
        return np.zeros((0, 4))
    rows = []
    for seed in range(chunk["seed"], chunk["seed"] + FLIGHTS):
        summary = fly_one(chunk["mission"], chunk["own_rig"], dict(settings), seed, PlantModel.REDUCED).summary
        done = summary["status"] == "completed"
        rms = summary["tracking_error_mm"]["rms"] if done else math.nan
        rows.append([seed, rms, summary["duration_s"] if done else math.nan, summary["verdict"] == "passed"])
    return np.array(rows, dtype=np.float64)


def rebuild_cycles(columns: Columns) -> list[Cycle]:
    """Rebuild the cycles of a flight from their columns, in order.

    Parameters
    ----------
    columns : Columns

    Returns
    -------
    list of Cycle
    """
    order = np.argsort(columns["cycle"])
    taken = {name: np.asarray(column)[order] for name, column in columns.items()}
    matrices = {
        name: np.stack([taken[f"{name}_{i}"] for i in range(math.prod(shape))], axis=1).reshape(-1, *shape)
        for name, shape in MATRICES.items()
    }
    return [
        Cycle(
            arc=float(taken["arc"][k]),
            speed=float(taken["speed"][k]),
            duration=float(taken["duration"][k]),
            wait=float(taken["wait"][k]),
            currents=np.zeros((2, 0)),
            saturated=bool(taken["saturated"][k]),
            **{name: matrix[k] for name, matrix in matrices.items()},
        )
        for k in range(len(order))
    ]


def conclude(options: Options, parts: list[Columns]) -> Outcome:
    """Compute margins at every cycle, the worst and the median of each, and the result of the search for gains.

    Parameters
    ----------
    options : Options
    parts : list of Columns
        One per chunk, in order.

    Returns
    -------
    Outcome
    """
    gains, columns = parts[0], join_columns(parts[1:])
    cycles = rebuild_cycles(columns)
    if len(cycles) < 2:
        raise InputError("The flight follows its path for less than two cycles: there is no loop to analyse.")
    loops = [average_cycles(cycles, k, REACH) for k in range(len(cycles))]
    found = [compute_margins(SampledLoop.from_cycle(loop)) for loop in loops]
    periods = np.array([loop.duration for loop in loops])
    table: Columns = {
        "cycle": np.sort(columns["cycle"]),
        "arc_mm": 1e3 * np.array([c.arc for c in cycles]),
        "x_mm": 1e3 * np.array([c.position[0] for c in cycles]),
        "y_mm": 1e3 * np.array([c.position[1] for c in cycles]),
        "cycle_ms": 1e3 * np.array([c.duration for c in cycles]),
        "gain_margin_db": np.array([m.gain_db for m in found]),
        "gain_reduction_margin_db": np.array(
            [-20.0 * math.log10(m.least_gain) if m.least_gain > 0.0 else math.inf for m in found]
        ),
        "phase_margin_deg": np.degrees([m.phase for m in found]),
        "delay_margin_cycles": np.array([m.delay for m in found]),
        "delay_margin_ms": 1e3 * np.array([m.delay for m in found]) * periods,
        "late_cycles": np.array([m.late for m in found]),
        "disc_margin": np.array([m.disc for m in found]),
        "bandwidth_hz": np.array([m.bandwidth for m in found]),
        "settle_s": np.array([m.settling for m in found]),
        "largest_pole": np.array([m.radius for m in found]),
        "explained_across": np.array([loop.explained[0] for loop in loops]),
        "explained_turn": np.array([loop.explained[1] for loop in loops]),
        **{f"_{name}": np.array([getattr(loop, name) for loop in loops]) for name in ("motion", "feedback", "kalman")},
        "_period": periods,
        "_wait": np.array([loop.wait for loop in loops]),
    }
    figures = collect_figures(load_study_mission(options), parse_weights(options.weights), table, found, gains)
    return Outcome(format_rows(figures, table), figures, table)


def draw(outcome: Outcome, path: Path) -> None:
    """Draw the margins; see `sim.studies.margins_picture`.

    Parameters
    ----------
    outcome : Outcome
    path : Path
        PNG to write.
    """
    from sim.studies.margins_picture import draw_margins

    draw_margins(outcome, path)


STUDY = Study(
    name="margins",
    title="Margins of the loop",
    devices=dict,
    chunks=make_chunks,
    conclude=conclude,
    draw=draw,
    mission=True,
    rig_of=lambda options: load_study_mission(options).rig,
    files=format_files,
    notes={
        "cut": "at the motion by the law's command: cross-track position and heading together",
        "loop": "frozen at each cycle, averaged over four before and after; the tracker at its covariance there; "
        "what a law learns in flight is kept constant",
        "feedback": "least squares over poses with the errors of tracked ones, at least 0.05 mm and 1 degree",
    },
)
