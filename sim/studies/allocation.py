"""Allocated forces over the workspace compared with brute force and scipy: direction, size, heat, computing time."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sim.studies.columns import join_columns, select_rows
from sim.studies.study import Chunk, Columns, Options, Outcome, Study, cut_chunks, make_rng
from smolbot.core.arrays import FloatArray

if TYPE_CHECKING:
    from controllers.force_allocator import ForceAllocator

DIRECTIONS = 360
TRIES = 200_000
"""Random sets of currents at each position; the best of each direction are then improved by random changes."""

KEPT, CHILDREN, STEPS = 12, 24, (0.3, 0.1, 0.1, 0.03, 0.03, 0.01, 0.01, 0.003, 0.003, 0.001, 0.001)
"""Of each direction: sets that are kept, changes of each in a round, and their size as shares of the limit."""

NEAR = np.radians(0.5)
"""Angle beyond the accepted direction error from which sets start, in rad."""

CHANGED, BLEND = 0.6, 0.7
"""Share of the currents that change at random, and standard deviation of a step along the difference of two sets."""

PENALTY = 300.0
"""Loss of force per rad beyond the accepted direction error."""

ROUNDING = 1e-9
"""Angle, in rad, and share of a current that are rounding."""

EVERY = 45
"""Of so many directions one is checked for heat."""

HEAT_SCALE, VIOLATION = 1e-2, -1e-4
"""Factor on the heat in SLSQP's cost, and a constraint's value down to which it counts as kept."""

SHARES, STARTS, WARM = (0.3, 0.7), 8, 60
"""Requested forces as shares of the strongest, starts of SLSQP for each, and timed allocations at each position."""

CASES = {"head first": (True, (0.0, 2.0, 4.0, 6.0, 8.0)), "either end": (False, (0.0, 5.0, 10.0, 15.0, 20.0))}
"""Which end may lead, and distances from the middle, in mm."""

ANGLES_DEG = (0.0, 17.0, 45.0, 73.0, 90.0, 131.0, 208.0, 317.0)
"""Angles around the middle: on the coils' axes of symmetry, where few currents give force, and between them."""


class Pull:
    """Force on an aligned moment at one position, in plain numpy.

    Parameters
    ----------
    own : ForceAllocator
        Whose rules are kept.
    here : ndarray, shape (3,), in m
    low, high : ndarray, shape (n_coils,), in A
        Limits of the currents.
    """

    def __init__(self, own: ForceAllocator, here: FloatArray, low: FloatArray, high: FloatArray) -> None:
        field, gradient = own.table.field_and_gradient(here[None, :])
        self.own, self.low, self.high = own, low, high
        self._b, self._g = field[:, 0], gradient[:, 0].reshape(len(low), 9)

    def __call__(self, currents: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Field (n, 3) in T and force (n, 3) in N of sets of currents (n, n_coils)."""
        field = currents @ self._b
        slope = (currents @ self._g).reshape(-1, 3, 3)
        size = np.linalg.norm(field, axis=1)[:, None] + 1e-300
        return field, self.own.moment * np.einsum("ni,nij->nj", field / size, slope)

    def is_allowed(self, field: FloatArray, force: FloatArray) -> FloatArray:
        """Return which forces keep to the allocator's rules.

        Parameters
        ----------
        field : ndarray, shape (k, 3), in T
        force : ndarray, shape (k, 3), in N

        Returns
        -------
        ndarray of bool, shape (k,)
        """
        from controllers.force_allocator import MAX_FIELD_SLOPES

        level = np.linalg.norm(field[:, :2], axis=1)
        kept = (level >= self.own.least_field) & (np.abs(field[:, 2]) <= MAX_FIELD_SLOPES[0] * level)
        if self.own.head_first:
            kept &= np.sum(field[:, :2] * force[:, :2], axis=1) >= 0.0
        return kept


def find_strongest(pull: Pull, toward: FloatArray, misses: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Find by brute force the strongest force in each of some directions.

    Parameters
    ----------
    pull : Pull
    toward, misses : ndarray, shape (k,), in rad
        Directions, and the tolerated angle of each.
    rng : numpy.random.Generator

    Returns
    -------
    ndarray, shape (k,), in N
        0 where none was found.
    """
    low, high = pull.low, pull.high
    n = len(low)
    kind = rng.integers(0, 3, (TRIES, n))
    currents = np.where(kind == 0, low, np.where(kind == 1, high, rng.uniform(low, high, (TRIES, n))))
    currents = _stretch_currents(currents[np.any(currents != 0.0, axis=1)], high)
    field, force = pull(currents)
    kept = pull.is_allowed(field, force)
    currents, force = currents[kept], force[kept, :2]
    size, angle = np.linalg.norm(force, axis=1), np.arctan2(force[:, 1], force[:, 0])
    parents = np.zeros((len(toward), KEPT, n))
    for k, way in enumerate(toward):
        near = np.flatnonzero(np.abs(_wrap_angle(angle - way)) < misses[k] + NEAR)
        best = near[np.argsort(size[near])[-KEPT:]]
        parents[k, : len(best)] = currents[best]
    for share in STEPS:
        change = share * high * rng.standard_normal((len(toward), KEPT, CHILDREN, n))
        change *= rng.random(change.shape) < CHANGED
        # half of them along the difference of two good sets
        one, other = rng.integers(0, KEPT, (2, KEPT, CHILDREN // 2))
        change[:, :, ::2] = rng.normal(0.0, BLEND, (KEPT, CHILDREN // 2, 1)) * (parents[:, one] - parents[:, other])
        children = np.clip(parents[:, :, None] + change, low, high).reshape(len(toward), -1, n)
        family = np.concatenate([parents, _stretch_currents(children, high)], axis=1)
        worth, _ = _evaluate_currents(pull, family, toward, misses)
        best = np.argsort(worth, axis=1)[:, -KEPT:]
        parents = np.take_along_axis(family, best[:, :, None], axis=1)
    _, found = _evaluate_currents(pull, parents, toward, misses)
    return np.max(found, axis=1)


def _evaluate_currents(
    pull: Pull, family: FloatArray, toward: FloatArray, misses: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Force of each set, less where it misses by more than it may; and the force of those that do not."""
    field, force = pull(family.reshape(-1, family.shape[2]))
    size = np.linalg.norm(force[:, :2], axis=1) * pull.is_allowed(field, force)
    off = np.abs(_wrap_angle(np.arctan2(force[:, 1], force[:, 0]).reshape(family.shape[:2]) - toward[:, None]))
    size = size.reshape(family.shape[:2])
    beyond = np.maximum(off - misses[:, None], 0.0)
    return size / (1.0 + PENALTY * beyond), np.where(beyond <= ROUNDING, size, 0.0)


def _stretch_currents(currents: FloatArray, high: FloatArray) -> FloatArray:
    """The same mixes with one coil at its limit: the force grows in proportion."""
    top = np.max(np.abs(currents) / high, axis=-1, keepdims=True)
    return currents / np.maximum(top, ROUNDING)


def _wrap_angle(angle: FloatArray) -> FloatArray:
    return np.asarray((angle + np.pi) % (2.0 * np.pi) - np.pi)


def find_least_heat(pull: Pull, way: FloatArray, requested: float, miss: float, rng: np.random.Generator) -> float:
    """Find the smallest sum of squared currents for a force, by SLSQP from many starts.

    Parameters
    ----------
    pull : Pull
    way : ndarray, shape (3,)
        Unit vector of the force.
    requested : float, in N
    miss : float, in rad
        Tolerated angle.
    rng : numpy.random.Generator

    Returns
    -------
    float, in A²
    """
    from scipy.optimize import minimize

    from controllers.force_allocator import MAX_FIELD_SLOPES

    def rules(currents: FloatArray) -> FloatArray:
        field, force = (rows[0] for rows in pull(currents[None, :]))
        along = (force[:2] @ way) / requested
        across = (way[0] * force[1] - way[1] * force[0]) / requested
        level = np.linalg.norm(field[:2]) + 1e-12
        head = field[:2] @ way / level if pull.own.head_first else 1.0
        slack = np.tan(miss) * along
        steep = MAX_FIELD_SLOPES[0] - abs(field[2]) / level
        return np.array([along - 1.0, slack - across, slack + across, level / pull.own.least_field - 1.0, steep, head])

    best = np.inf
    for _ in range(STARTS):
        start = rng.uniform(pull.low, pull.high)
        out = minimize(
            lambda i: HEAT_SCALE * i @ i, start, method="SLSQP", bounds=list(zip(pull.low, pull.high, strict=True)),
            constraints=[{"type": "ineq", "fun": rules}],
        )  # fmt: skip
        if np.all(rules(out.x) > VIOLATION):
            best = min(best, float(out.x @ out.x))
    return best


def run_chunk(chunk: Chunk) -> Columns:
    """Allocate forces in all directions at one position.

    Parameters
    ----------
    chunk : Chunk

    Returns
    -------
    Columns
    """
    from controllers.force_allocator import DIRECTION_SLACK, ForceAllocator, UnreachableForceError
    from sim.studies.benches import load_rig_once
    from smolbot.config.robot import load_robot

    rig, rng = load_rig_once(chunk["rig"]), make_rng(chunk)
    moment, limits = load_robot("gradient").device.moment, rig.limits
    own = ForceAllocator(
        rig.table(), limits.max_current, moment, unipolar=limits.unipolar, head_first=chunk["head_first"]
    )
    high = np.full(own.table.n_coils, limits.max_current)
    around = np.radians(chunk["around_deg"])
    here = 1e-3 * np.array([chunk["radius_mm"] * np.cos(around), chunk["radius_mm"] * np.sin(around), 0.0])
    here[2] = rig.surface_z
    pull = Pull(own, here, np.zeros(len(high)) if limits.unipolar else -high, high)
    toward = np.radians(np.arange(DIRECTIONS) * (360.0 / DIRECTIONS))
    ways = np.stack([np.cos(toward), np.sin(toward), np.zeros(DIRECTIONS)], axis=1)
    force, miss = np.zeros(DIRECTIONS), np.zeros(DIRECTIONS)
    for k, way in enumerate(ways):
        try:
            found = own.allocate(here, way)
        except UnreachableForceError:
            continue
        force[k], miss[k] = np.linalg.norm(found.force[:2]), found.direction_error
    best = find_strongest(pull, toward, np.maximum(miss, np.arctan(DIRECTION_SLACK)), rng)
    heat = np.full((DIRECTIONS, len(SHARES)), np.nan)
    for k in range(0, DIRECTIONS, EVERY):
        for j, share in enumerate(SHARES):
            if force[k] > 0.0:
                requested = share * force[k]
                used = own.allocate(here, ways[k], requested)
                least = find_least_heat(
                    pull, ways[k, :2], requested, max(used.direction_error, np.arctan(DIRECTION_SLACK)), rng
                )
                heat[k, j] = used.currents @ used.currents / least if np.isfinite(least) else np.nan
    picked, seconds = rng.integers(0, DIRECTIONS, WARM), np.zeros(DIRECTIONS)
    for k in picked:
        if force[k] > 0.0:
            begin = time.thread_time_ns()
            own.allocate(here, ways[k])
            seconds[k] = 1e-9 * (time.thread_time_ns() - begin)
    place = {"case": chunk["case"], "radius_mm": chunk["radius_mm"], "around_deg": chunk["around_deg"]}
    columns: Columns = {key: np.full(DIRECTIONS, value) for key, value in place.items()}
    columns |= {"toward_deg": np.degrees(toward), "force_un": 1e6 * force, "miss_deg": np.degrees(miss)}
    columns |= {"brute_force_un": 1e6 * best, "allocation_ms": 1e3 * seconds}
    return columns | {f"heat_ratio_{int(100 * share)}": heat[:, j] for j, share in enumerate(SHARES)}


def make_chunks(options: Options) -> list[Chunk]:
    """Make one chunk for each position; `poses` limits how many around the centre at each distance.

    Parameters
    ----------
    options : Options

    Returns
    -------
    list of Chunk
    """
    around = ANGLES_DEG[: options.poses]
    pieces = [
        (f"{name.replace(' ', '-')}-{radius:g}-{angle:g}",
         {"case": name, "head_first": head_first, "radius_mm": radius, "around_deg": angle})
        for name, (head_first, radii) in CASES.items()
        for radius in radii
        for angle in (around if radius else around[:1])
    ]  # fmt: skip
    return cut_chunks(options, run_chunk, pieces)


def conclude(options: Options, parts: list[Columns]) -> Outcome:
    """Compute percentiles over positions and directions.

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
    figures: dict[str, Any] = {"cases": []}
    rows: list[tuple[str, str]] = []
    for name in CASES:
        part = select_rows(columns, case=name)
        known = part["brute_force_un"] > 0.0
        got = part["force_un"] > 0.0
        share = part["force_un"][known & got] / part["brute_force_un"][known & got]
        heat = np.concatenate([part[f"heat_ratio_{int(100 * s)}"] for s in SHARES])
        heat = heat[np.isfinite(heat)]
        timed = part["allocation_ms"][part["allocation_ms"] > 0.0]
        case: dict[str, Any] = {
            "case": name,
            "directions": int(known.sum()),
            "missed": int((known & ~got).sum()),
            "direction_p99_deg": float(np.percentile(part["miss_deg"][got], 99)),
            "direction_max_deg": float(part["miss_deg"][got].max()),
            "share_min": float(share.min()),
            "share_below_099": int((share < 0.99).sum()),
            "share_p1": float(np.percentile(share, 1)),
            "share_median": float(np.median(share)),
            "weakest_un": float(part["force_un"][got].min()),
            "heat_max": float(heat.max()),
            "heat_median": float(np.median(heat)),
            "allocation_ms": float(np.median(timed)),
            "allocation_least_ms": float(timed.min()),
        }
        figures["cases"].append(case)
        rows += [
            (f"{name}: direction", f"error {case['direction_p99_deg']:.2f}° (p99), {case['direction_max_deg']:.2f}° "
             f"(maximum) of {case['directions']} reachable; {case['missed']} found by brute force only"),
            (f"{name}: force over brute force", f"minimum {case['share_min']:.3f}, below 0.99 in "
             f"{case['share_below_099']} directions, p1 {case['share_p1']:.3f}, "
             f"median {case['share_median']:.3f}; weakest {case['weakest_un']:.0f} µN"),
            (f"{name}: heat over SLSQP's best", f"median {case['heat_median']:.4f}, maximum {case['heat_max']:.3f} "
             f"of {len(heat)}"),
            (f"{name}: one allocation", f"{case['allocation_ms']:.3f} ms, minimum "
             f"{case['allocation_least_ms']:.3f} ms, processor time"),
        ]  # fmt: skip
    return Outcome(rows, figures, columns)


def draw(outcome: Outcome, path: Path) -> None:
    """Draw force by direction at some positions, allocated and by brute force.

    Parameters
    ----------
    outcome : Outcome
    path : Path
        PNG to write.
    """
    from sim.batch.slide import BOUND, WHITENED, open_slide

    columns = outcome.columns
    head, either = outcome.figures["cases"]
    least = min(head["share_min"], either["share_min"])
    total = head["directions"] + either["directions"]
    headline = f"At least {least:.3f} of the force that brute force finds, in {total} directions"
    subline = (
        "strongest force on an aligned moment by direction, in µN; line: allocated; grey: brute force with the same "
        f"direction error: {head['direction_p99_deg']:.1f}°"
    )
    around = float(columns["around_deg"][-1])
    shown = [("head first", 0.0), ("head first", 4.0), ("head first", 8.0)]
    shown += [("either end", 5.0), ("either end", 10.0), ("either end", 20.0)]
    with open_slide(path, headline, subline, 2, 3, hspace=0.2, wspace=0.1, top=0.82, bottom=0.03) as axes:
        for panel, (case, radius) in zip(axes, shown, strict=True):
            part = select_rows(columns, case=case, radius_mm=radius, around_deg=around if radius else ANGLES_DEG[0])
            angle = np.radians(np.append(part["toward_deg"], part["toward_deg"][:1]))
            for key, color, width in (("brute_force_un", BOUND, 6.0), ("force_un", WHITENED, 1.6)):
                force = np.append(part[key], part[key][:1])
                force[force <= 0.0] = np.nan  # where nothing was found, there is no line
                panel.plot(force * np.cos(angle), force * np.sin(angle), color=color, lw=width)
            top = 1.1 * float(np.max(part["brute_force_un"]))
            for ring in (100.0, 200.0, 400.0, 800.0):
                if 0.25 * top < ring < top:
                    panel.plot(ring * np.cos(angle), ring * np.sin(angle), color="#dddddd", lw=0.8, zorder=0)
                    panel.text(0.0, ring, f"{ring:.0f}", color="#777777", fontsize=10, ha="center", va="bottom")
            panel.plot(0, 0, "+", color="#777777")
            panel.set(aspect="equal", xlim=(-1.6 * top, 1.6 * top), ylim=(-top, top))
            panel.axis("off")
            where = f", {around:.0f}° from x" if radius else ""
            panel.set_title(f"{radius:g} mm from the middle{where}, {case}", loc="center", fontsize=12)


STUDY = Study(
    name="allocation",
    title="Allocated force",
    devices=dict,
    chunks=make_chunks,
    conclude=conclude,
    draw=draw,
    notes={"rules": "field of 20 µT or more, at most 0.3 out of the plane per unit in it; heat at 0.3 and 0.7 of the "
           "strongest force in eight directions of each place"},
)  # fmt: skip
