"""Make the moves of `kernels.snake` in Python: the same decisions as the C kernel, to be read and compared with."""

from __future__ import annotations

import math
import operator
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.kernels.snake_criterion import (
    HIGHLIGHT,
    NOTHING,
    SHADOW,
    EdgeSums,
    Nodes,
    Point,
    Polygon,
    Settings,
    TableRows,
    criterion_of,
    edge_sums,
    facing_side,
    points_of,
    polygon_of,
    sums_of,
)

_CLOSEST_PX: Final = 0.5  # pixels between two nodes, minimum; equal in C
_SHORTEST_CUT_PX: Final = 2.0  # pixels of the shortest side that is cut in two; equal in C

# Ways a node may go, then ways an edge may go: (row, column).
_NODE_WAYS: Final = ((-1, 0), (1, 0), (0, -1), (0, 1), (-1, -1), (-1, 1), (1, -1), (1, 1))
_EDGE_WAYS: Final = ((-1, 0), (1, 0), (0, -1), (0, 1))


class Moved(NamedTuple):
    """Hold the pair moved.

    (n, 2) float64 nodes, (0, 2) where there is no polygon; criterion in nats; moves made and proposed; sums of both.
    """

    highlight: Nodes
    shadow: Nodes
    criterion: float
    n_moves: int
    n_proposed: int
    highlight_sums: EdgeSums
    shadow_sums: EdgeSums


def is_sound(nodes: Nodes) -> bool:
    """Check that a polygon is simple, its nodes half a pixel apart, and each row crosses it at most twice."""
    return _sound(points_of(nodes), range(len(nodes)))


def _sound(points: list[Point], edges: range) -> bool:
    """Check as is_sound where only `edges` can be at fault."""
    n = len(points)
    ways = [_sign(points[(i + 1) % n][0] - points[i][0]) for i in range(n)]
    steep = [way for way in ways if way]
    if sum(way != steep[i - 1] for i, way in enumerate(steep)) > 2:
        return False
    for edge in edges:
        i = edge % n
        after = (i + 1) % n
        a, b = points[i], points[after]
        row, column = b[0] - a[0], b[1] - a[1]
        if row * row + column * column < _CLOSEST_PX * _CLOSEST_PX:
            return False
        for j in range(n):
            c, d = points[j], points[(j + 1) % n]
            if j == i:
                continue
            if j == after:  # neighbours only must not fold back
                if _turn(a, b, d) == 0.0 and row * (d[0] - c[0]) + column * (d[1] - c[1]) < 0.0:
                    return False
            elif (j + 1) % n == i:
                if _turn(c, a, b) == 0.0 and row * (a[0] - c[0]) + column * (a[1] - c[1]) < 0.0:
                    return False
            elif _meet(a, b, c, d):
                return False
    return True


def _sign(value: float) -> int:
    return (value > 0.0) - (value < 0.0)


def _turn(a: Point, b: Point, c: Point) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _meet(a: Point, b: Point, c: Point, d: Point) -> bool:
    """Check whether two segments have a point in common."""
    c_side, d_side, a_side, b_side = (_sign(_turn(*three)) for three in ((a, b, c), (a, b, d), (c, d, a), (c, d, b)))
    if c_side * d_side < 0 and a_side * b_side < 0:
        return True
    ends = ((c_side, a, b, c), (d_side, a, b, d), (a_side, c, d, a), (b_side, c, d, b))
    return any(side == 0 and _within(p, q, point) for side, p, q, point in ends)


def _within(a: Point, b: Point, point: Point) -> bool:
    return all(min(a[axis], b[axis]) <= point[axis] <= max(a[axis], b[axis]) for axis in (0, 1))


def fault_of(table: NDArray[np.float64], settings: Settings, nodes: Nodes) -> int:
    """Find what keeps a polygon from being moved: 0 nothing, 1 too small, clockwise or not measured, 2 not sound."""
    if len(nodes) == 0:
        return 0
    total = _total(sums_of(table, np.full(table.shape[0], -1.0), HIGHLIGHT, nodes))
    if total.measured < 1.0 or total.area < settings.min_area_px:
        return 1
    return 0 if is_sound(nodes) else 2


def _total(edges: list[EdgeSums]) -> EdgeSums:
    return EdgeSums._make(map(sum, zip(*edges, strict=True)))


class _Pair:
    """Hold the pair on its way.

    points, edges, seen: of both polygons; edges and seen hold gap and overlap as they were when a polygon last moved.
    bounds, measured: what either faces, and the sums of all edges measured against it, since most are tried again.
    """

    def __init__(self, table: NDArray[np.float64], settings: Settings, nodes: tuple[Nodes, Nodes]) -> None:
        self.rows = TableRows(table)
        self.settings = settings
        self.points = [points_of(nodes[HIGHLIGHT]), points_of(nodes[SHADOW])]
        self.edges: list[list[EdgeSums]] = [[], []]
        self.seen: list[Polygon | None] = [None, None]
        self.bounds: list[list[float]] = [[], []]
        self.measured: list[dict[tuple[Point, Point], EdgeSums]] = [{}, {}]
        self.n_moves = self.n_proposed = 0
        self.criterion = 0.0
        # polygon and node that nothing has moved since no way of theirs was better
        self.settled: set[tuple[int, int]] = set()
        for which in (HIGHLIGHT, SHADOW):
            if self.points[which]:
                self.face(which)
                self.refresh(which)

    def face(self, which: int) -> None:
        """Fix the other polygon and move polygon `which` from now on."""
        bound = facing_side(self.rows, self.points[1 - which], which)
        if bound != self.bounds[which]:
            self.bounds[which], self.measured[which] = bound, {}

    def refresh(self, which: int) -> None:
        """Measure polygon `which` anew, and the criterion."""
        points = self.points[which]
        self.edges[which] = [self.edge(which, a, b) for a, b in zip(points, points[1:] + points[:1], strict=True)]
        self.seen[which] = polygon_of(self.settings, which, points, _total(self.edges[which]))
        self.criterion = self.value(which, self.seen[which])

    def edge(self, which: int, a: Point, b: Point) -> EdgeSums:
        """Measure an edge of polygon `which`."""
        measured = self.measured[which]
        sums = measured.get((a, b))
        if sums is None:
            sums = measured[a, b] = edge_sums(self.rows, self.bounds[which], which, a, b)
        return sums

    def value(self, which: int, moved: Polygon | None) -> float:
        """Compute the criterion with another polygon `which`."""
        assert moved is not None
        pair = (moved, self.seen[SHADOW]) if which == HIGHLIGHT else (self.seen[HIGHLIGHT], moved)
        return criterion_of(self.settings, pair, moved.sums)

    def sums_with(self, which: int, gone: Sequence[int], points: list[Point], new: range) -> EdgeSums:
        """Sum polygon `which` without the edges `gone`, with the edges `new` of other points. Sums are exact."""
        seen = self.seen[which]
        assert seen is not None
        n = len(points)
        edges = [self.edge(which, points[i % n], points[(i + 1) % n]) for i in new]
        taken = [self.edges[which][i] for i in gone]
        total = map(sum, zip(seen.sums, *edges, strict=True))
        return EdgeSums._make(map(operator.sub, total, map(sum, zip(*taken, strict=True))))

    def sweep(self, which: int, amplitude: float) -> int:
        """Move each node, and the edge after it, the best way of all unless it is settled; return how many moved."""
        n = len(self.points[which])
        if n == 0:
            return 0
        self.face(which)
        self.refresh(which)
        moved = 0
        for i in range(n):
            if (which, i) in self.settled:
                continue
            best: list[Point] | None = None
            for n_shifted, ways in ((1, _NODE_WAYS), (2, _EDGE_WAYS)):
                for row, column in ways:
                    points = self.points[which].copy()
                    for k in range(n_shifted):
                        here = points[(i + k) % n]
                        points[(i + k) % n] = here[0] + row * amplitude, here[1] + column * amplitude
                    found = self.tried(which, points, i, n_shifted)
                    if found < self.criterion:
                        self.criterion, best = found, points
            if best is None:
                self.settled.add((which, i))
            else:
                self.points[which] = best
                self.refresh(which)
                self.settled.clear()
                moved += 1
        return moved

    def tried(self, which: int, points: list[Point], first: int, n_shifted: int) -> float:
        """Compute the criterion of points of which n_shifted were moved, from `first` on.

        Infinite where it is no better or not allowed.
        """
        n = len(points)
        n_rows, n_columns = self.rows.shape
        for k in range(n_shifted):
            row, column = points[(first + k) % n]
            if not (0.0 <= row <= n_rows and 0.0 <= column <= n_columns):
                return math.inf
        self.n_proposed += 1
        changed = range(first - 1, first + n_shifted)
        sums = self.sums_with(which, [i % n for i in changed], points, changed)
        if sums.measured < 1.0 or sums.area < self.settings.min_area_px:
            return math.inf
        found = self.value(which, polygon_of(self.settings, which, points, sums))
        return found if found < self.criterion and _sound(points, changed) else math.inf

    def subdivide(self, which: int, n: int) -> None:
        """Add nodes half-way along the longest edges, the first of equals, until there are n."""
        points = self.points[which]
        while 0 < len(points) < n:
            after = points[1:] + points[:1]
            ways = [(b[0] - a[0], b[1] - a[1]) for a, b in zip(points, after, strict=True)]
            squares = [row * row + column * column for row, column in ways]
            longest = squares.index(max(squares))
            if squares[longest] < _SHORTEST_CUT_PX * _SHORTEST_CUT_PX:
                return
            a, b = points[longest], after[longest]
            points.insert(longest + 1, (0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])))

    def prune(self, which: int) -> int:
        """Remove nodes one by one whose removal lowers the criterion most; return how many went."""
        if not self.points[which]:
            return 0
        self.face(which)
        self.refresh(which)
        gone = 0
        while len(self.points[which]) > 3:
            best: list[Point] | None = None
            for i in range(len(self.points[which])):
                points = self.points[which].copy()
                del points[i]
                sums = self.sums_with(which, (i - 1, i), points, range(i - 1, i))
                self.n_proposed += 1
                if sums.measured < 1.0 or sums.area < self.settings.min_area_px:
                    continue
                found = self.value(which, polygon_of(self.settings, which, points, sums))
                if found < self.criterion and _sound(points, range(i - 1, i)):
                    self.criterion, best = found, points
            if best is None:
                break
            self.points[which] = best
            self.refresh(which)
            gone += 1
        return gone


def move_pair(
    table: NDArray[np.float64], settings: Settings, schedule: NDArray[np.float64], highlight: Nodes, shadow: Nodes
) -> Moved:
    """Do as kernels.snake.move_pair, of float64 nodes that have been checked."""
    pair = _Pair(table, settings, (highlight, shadow))
    for n_nodes, amplitude, n_sweeps in schedule.tolist():
        pair.settled.clear()
        for which in (SHADOW, HIGHLIGHT):
            if not pair.points[which]:
                continue
            if amplitude == 0.0:
                pair.n_moves += pair.prune(which)
            else:
                pair.subdivide(which, int(n_nodes))
                pair.face(which)
                pair.refresh(which)
        for _ in range(int(n_sweeps) if amplitude > 0.0 else 0):
            moved = pair.sweep(SHADOW, amplitude) + pair.sweep(HIGHLIGHT, amplitude)
            pair.n_moves += moved
            if moved == 0:
                break
    sums = [NOTHING if seen is None else seen.sums for seen in pair.seen]
    nodes = [np.array(points, dtype=np.float64).reshape(-1, 2) for points in pair.points]
    return Moved(
        nodes[HIGHLIGHT], nodes[SHADOW], pair.criterion, pair.n_moves, pair.n_proposed, sums[HIGHLIGHT], sums[SHADOW]
    )
