"""One continuous route over all strokes of a character, since a robot cannot be lifted off its path.

Strokes and the points where they meet form a graph. The route over all of it with the least retracing is that of
the Chinese postman problem with free ends: all odd nodes but two are joined in pairs along the shortest
connections, which are then drawn twice, and an Eulerian trail passes every edge. Of all such trails, the one with
the least turning where strokes meet is chosen.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np

from smolbot.core.arrays import BoolArray, FloatArray
from smolbot.paths.drawing.smoothing import smooth_stroke
from smolbot.paths.polylines import (
    compute_arc_lengths,
    find_crossings,
    find_nearest_place,
    interpolate_polyline,
    is_straight,
    split_at,
)

MEETING_DISTANCE, MERGE_DISTANCE = 0.8, 0.3
"""Distances, in units of the font's grid: an end this near to another stroke meets it; points this near coincide."""

MAX_SMOOTH_TURN = np.radians(12.0)
"""Turn, in rad, up to which a route goes straight on from one stroke to another."""

MAX_SEARCH_STEPS = 20_000
"""Steps of the search for the trail with the least turning."""

LEAVING = 0.5
"""Length of a stroke's end, in units of the grid, that gives its direction there."""

INNER_PENALTY = 0.1
"""Length, in units of the grid, by which a bridge to the middle of a stroke counts longer than one to an end."""

WRITING_ORDER = 0.05
"""Turn, in rad, by which a start at the left or top is preferred, as in handwriting."""

NO_SHORTER = 1e-12
"""Difference of two ways, in units of the grid, that is rounding."""

ROUNDING = 1e-9
"""Difference, in units of the grid or rad, that is rounding."""


@dataclass(frozen=True)
class Route:
    """One continuous route over a character.

    Attributes
    ----------
    pieces : tuple of ndarray, each (n, 2)
        Smooth curves, one after another; corners lie between them.
    retraced : tuple of ndarray
        Pieces that are drawn twice.
    bridges : tuple of ndarray, each (2, 2)
        Straight lines across gaps between parts that do not touch, such as that from the dot of an i to its stem.
    """

    pieces: tuple[FloatArray, ...]
    retraced: tuple[FloatArray, ...] = ()
    bridges: tuple[FloatArray, ...] = ()


@dataclass(frozen=True)
class _Edge:
    points: FloatArray
    a: int
    b: int
    bridge: bool = False
    again: bool = False

    @property
    def length(self) -> float:
        return float(compute_arc_lengths(self.points)[-1])

    def compute_exit_direction(self, from_a: bool) -> FloatArray:
        """Compute the direction (unit vector) of the edge at one of its ends, away from that end."""
        points = self.points if from_a else self.points[::-1]
        way = interpolate_polyline(points, min(LEAVING, 0.5 * self.length)) - points[0]
        return way / np.linalg.norm(way)


@dataclass
class _StrokeGraph:
    nodes: list[FloatArray] = field(default_factory=list)
    edges: list[_Edge] = field(default_factory=list)

    def find_or_add_node(self, place: FloatArray) -> int:
        for i, known in enumerate(self.nodes):
            if np.linalg.norm(known - place) < MERGE_DISTANCE:
                return i
        self.nodes.append(place)
        return len(self.nodes) - 1

    def add_edge(self, points: FloatArray, bridge: bool = False) -> None:
        a, b = self.find_or_add_node(points[0]), self.find_or_add_node(points[-1])
        points = points.copy()
        points[0], points[-1] = self.nodes[a], self.nodes[b]
        self.edges.append(_Edge(points, a, b, bridge))

    def find_components(self) -> list[int]:
        """Return for each node the smallest index of a node connected to it."""
        part = list(range(len(self.nodes)))
        for _ in part:
            for edge in self.edges:
                part[edge.a] = part[edge.b] = min(part[edge.a], part[edge.b])
        return part

    def count_edges(self, node: int) -> int:
        return sum((edge.a == node) + (edge.b == node) for edge in self.edges)


def join_strokes(strokes: list[FloatArray], stretch: float = 1.0) -> Route:
    """Join all strokes of a character to one smooth route.

    Parameters
    ----------
    strokes : list of ndarray, each (n, 2)
        On the font's grid.
    stretch : float
        Vertical over horizontal scale of the final drawing, which decides what is the shortest connection.

    Returns
    -------
    Route
    """
    if len(strokes) == 1:
        return Route(tuple(smooth_stroke(strokes[0])))
    net = _build_graph(strokes)
    _bridge_gaps(net)
    _add_retraced_edges(net, np.array([1.0, stretch]))
    return _build_route(net, _find_trail(net))


def _build_graph(strokes: list[FloatArray]) -> _StrokeGraph:
    """Build the graph of the strokes, cut where others meet or cross them."""
    met, fixed = _snap_ends(strokes)
    pieces = [smooth_stroke(stroke, hold) for stroke, hold in zip(met, fixed, strict=True)]
    net = _StrokeGraph()
    for i, own in enumerate(pieces):
        for piece in own:
            cuts = []
            for j, others in enumerate(pieces):
                if i == j:
                    continue
                for end in (others[0][0], others[-1][-1]):
                    place, away = find_nearest_place(piece, end)
                    if away < MERGE_DISTANCE:
                        cuts.append(place)
                cuts += [place for other in others for place, _ in find_crossings(piece, other)]
            length = float(compute_arc_lengths(piece)[-1])
            inside: list[float] = []
            for cut in sorted(cuts):
                if cut > (inside[-1] if inside else 0.0) + MERGE_DISTANCE and cut < length - MERGE_DISTANCE:
                    inside.append(cut)
            for part in split_at(piece, inside):
                net.add_edge(part)
    return net


def _snap_ends(strokes: list[FloatArray]) -> tuple[list[FloatArray], list[BoolArray]]:
    """Move the ends of strokes onto the strokes that they meet; also return which points are meeting points."""
    met = [stroke.copy() for stroke in strokes]
    for i, stroke in enumerate(met):
        for end in (0, -1):
            near = [(find_nearest_place(other, stroke[end]), j) for j, other in enumerate(met) if j != i]
            (place, away), j = min(near, key=lambda found: found[0][1])
            if away > MEETING_DISTANCE:
                continue
            arc = compute_arc_lengths(met[j])
            vertex = int(np.argmin(np.abs(arc - place)))
            if abs(arc[vertex] - place) < 0.5 * MEETING_DISTANCE:
                stroke[end] = met[j][vertex]
            else:
                stroke[end] = interpolate_polyline(met[j], place)
                if not is_straight(met[j]):
                    met[j] = np.insert(met[j], int(np.searchsorted(arc, place)), stroke[end], axis=0)
    ends = np.array([stroke[k] for stroke in met for k in (0, -1)])
    fixed = [np.min(np.linalg.norm(s[:, None] - ends[None], axis=2), axis=1) < ROUNDING for s in met]
    for stroke, hold in zip(met, fixed, strict=True):
        if np.allclose(stroke[0], stroke[-1]) and np.sum(np.linalg.norm(ends - stroke[0], axis=1) < ROUNDING) == 2:
            hold[[0, -1]] = False  # only its own end meets it there
    return met, fixed


def _bridge_gaps(net: _StrokeGraph) -> None:
    """Join parts that do not touch by the shortest straight lines."""
    while len(set(part := net.find_components())) > 1:
        best: tuple[float, FloatArray, int, float] | None = None
        for edge in net.edges:
            for k, other in enumerate(net.edges):
                if part[edge.a] == part[other.a]:
                    continue
                for vertex, point in enumerate(edge.points):
                    place, away = find_nearest_place(other.points, point)
                    inside = MERGE_DISTANCE < place < other.length - MERGE_DISTANCE
                    away += INNER_PENALTY * (inside + (0 < vertex < len(edge.points) - 1))
                    if best is None or away < best[0] - ROUNDING:
                        best = away, point, k, place
        assert best is not None
        _, point, k, place = best
        other = net.edges[k]
        if MERGE_DISTANCE < place < other.length - MERGE_DISTANCE:
            net.edges[k : k + 1] = []
            for half in split_at(other.points, [place]):
                net.add_edge(half, other.bridge)
        goal = interpolate_polyline(other.points, place)
        for k, edge in enumerate(net.edges):
            at, away = find_nearest_place(edge.points, point)
            if away < ROUNDING and MERGE_DISTANCE < at < edge.length - MERGE_DISTANCE:
                net.edges[k : k + 1] = []
                for half in split_at(edge.points, [at]):
                    net.add_edge(half, edge.bridge)
                break
        net.add_edge(np.array([point, goal]), bridge=True)


def _add_retraced_edges(net: _StrokeGraph, scale: FloatArray) -> None:
    """Draw some edges a second time, so that all nodes but two have an even number of edges."""
    n = len(net.nodes)
    way, last = np.full((n, n), np.inf), np.full((n, n), -1)
    np.fill_diagonal(way, 0.0)
    for k, edge in enumerate(net.edges):
        length = float(compute_arc_lengths(edge.points * scale)[-1])
        for a, b in ((edge.a, edge.b), (edge.b, edge.a)):
            if length < way[a, b]:
                way[a, b], last[a, b] = length, k
    for m in range(n):
        through = way[:, m, None] + way[None, m, :]
        shorter = through < way - NO_SHORTER
        way = np.where(shorter, through, way)
        last = np.where(shorter, last[None, m, :], last)
    odd = [i for i in range(n) if net.count_edges(i) % 2]

    @cache
    def pairs(left: tuple[int, ...], free: int) -> tuple[float, tuple[tuple[int, int], ...]]:
        if len(left) <= free:
            return 0.0, ()
        first, rest = left[0], left[1:]
        options = [pairs(rest, free - 1)] if free else []
        for i, other in enumerate(rest):
            cost, found = pairs(rest[:i] + rest[i + 1 :], free)
            options.append((cost + float(way[first, other]), ((first, other), *found)))
        return min(options)

    edges = list(net.edges)
    for start, end in pairs(tuple(odd), 2)[1]:
        at = end
        while at != start:
            edge = edges[last[start, at]]
            net.edges.append(replace(edge, again=True))
            at = edge.a if edge.b == at else edge.b


def _find_trail(net: _StrokeGraph) -> list[tuple[int, bool]]:
    """Find the order of edges with the least turning where they meet; each with whether it runs from a to b."""
    odd = [i for i in range(len(net.nodes)) if net.count_edges(i) % 2]
    starts = odd or [i for i in range(len(net.nodes)) if net.count_edges(i)]
    size = np.ptp(np.array(net.nodes), axis=0).max() + 1.0
    out: list[list[tuple[int, bool]]] = [[] for _ in net.nodes]
    for k, edge in enumerate(net.edges):
        out[edge.a].append((k, True))
        out[edge.b].append((k, False))
    leaving = {(k, way): edge.compute_exit_direction(way) for k, edge in enumerate(net.edges) for way in (True, False)}
    turns = {(i, j): _compute_turn(-leaving[i[0], not i[1]], leaving[j]) for i in leaving for j in leaving}
    best: list[tuple[int, bool]] = []
    least, tries = np.inf, 0
    used = [False] * len(net.edges)
    trail: list[tuple[int, bool]] = []

    def extend_trail(node: int, cost: float) -> None:
        nonlocal best, least, tries
        tries += 1
        if len(trail) == len(net.edges):
            best, least = list(trail), cost
            return
        ways = [(turns[trail[-1], way] if trail else 0.0, way) for way in out[node] if not used[way[0]]]
        for turn, (k, forward) in sorted(ways):
            if cost + turn >= least - ROUNDING or (best and tries > MAX_SEARCH_STEPS):
                return
            edge = net.edges[k]
            used[k] = True
            trail.append((k, forward))
            extend_trail(edge.b if forward else edge.a, cost + turn)
            trail.pop()
            used[k] = False

    for start in starts:
        x, y = net.nodes[start]
        extend_trail(start, float(WRITING_ORDER * (x - y) / size))
    return best


def _compute_turn(heading: FloatArray, way: FloatArray) -> float:
    return float(np.arccos(np.clip(heading @ way, -1.0, 1.0)))


def _build_route(net: _StrokeGraph, trail: list[tuple[int, bool]]) -> Route:
    pieces: list[FloatArray] = []
    heading: FloatArray | None = None
    for k, forward in trail:
        edge = net.edges[k]
        points = edge.points if forward else edge.points[::-1]
        if heading is not None and float(heading @ edge.compute_exit_direction(forward)) > np.cos(MAX_SMOOTH_TURN):
            pieces[-1] = np.vstack([pieces[-1], points[1:]])
        else:
            pieces.append(points)
        heading = -edge.compute_exit_direction(not forward)
    again = tuple(edge.points for edge in net.edges if edge.again)
    return Route(tuple(pieces), again, tuple(edge.points for edge in net.edges if edge.bridge and not edge.again))
