"""Make the moves of `kernels.snake` in Python: the same decisions as the C kernel, to be read and compared with.

Polygons have a few nodes and edges cross a few rows, where numpy takes ten times as long as Python's own numbers.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Sequence
from typing import Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

Nodes = NDArray[np.float64]
Point: TypeAlias = tuple[float, float]
"""Row and column of a node."""

HIGHLIGHT: Final = 0  # indices of the two polygons and of what neither holds; equal in C
SHADOW: Final = 1  # see HIGHLIGHT
BACKGROUND: Final = 2  # see HIGHLIGHT
# 2 ln(2e), nats: of the code length of a node (see polygon_cost); equal in C
_TWICE_LOG_2E: Final = 2.0 * 1.6931471805599454
_CLOSEST_PX: Final = 0.5  # pixels between two nodes, minimum; equal in C
_SHORTEST_CUT_PX: Final = 2.0  # pixels of the shortest side that is cut in two; equal in C

# Ways a node may go, then ways an edge may go: (row, column).
_NODE_WAYS: Final = ((-1, 0), (1, 0), (0, -1), (0, 1), (-1, -1), (-1, 1), (1, -1), (1, 1))
_EDGE_WAYS: Final = ((-1, 0), (1, 0), (0, -1), (0, 1))


class Settings(NamedTuple):
    """Set the criterion apart from the image. Lengths in metres, costs in nats.

    correlation_px: A_c. extent_*: along-track ends of highlight and shadow may differ by the tolerance; beyond it the
    square of sigmas counts half. gap_*: the same for the mean gap between highlight and shadow. height_*: the same for
    the mean height that the shadow implies, H (1 - r_start / r_end); beyond height_bound_m it is forbidden.
    min_area_px: minimum area of a polygon. faintest: minimum mean of a region over that of the window;
    dimmest_highlight, brightest_shadow: bounds on what objects show. forbidden: cost per pixel of overlap and per metre
    of height beyond the bound. window_*: sum, count and ln(number of pixels / A_c) of the whole window.
    """

    row_spacing_m: float
    column_spacing_m: float
    first_ground_range_m: float
    altitude_m: float
    correlation_px: float
    extent_tolerance_m: float
    extent_sigma_m: float
    gap_tolerance_m: float
    gap_sigma_m: float
    height_limit_m: float
    height_sigma_m: float
    height_bound_m: float
    min_area_px: float
    faintest: float
    dimmest_highlight: float
    brightest_shadow: float
    forbidden: float
    window_sum: float
    window_count: float
    log_window: float


class EdgeSums(NamedTuple):
    """Hold sums of edges over the rows they cross, and of polygons over their edges. Downward edges count positive.

    total, measured: intensity and number of measured pixels inside. area: pixels inside. far: columns of the far side.
    rows: crossed. gap, overlap: pixels between the polygon and the side of the other one that faces it, over the
    `shared` rows.
    """

    total: float
    measured: float
    area: float
    far: float
    rows: float
    gap: float
    shared: float
    overlap: float


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


_NOTHING: Final = EdgeSums(*[0.0] * len(EdgeSums._fields))


def crossings(a: Nodes, b: Nodes, n_rows: int, n_columns: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Find rows whose centres the edge from a to b crosses, and the first columns of pixels beyond it; (n,) int64."""
    first, columns = _crossed((float(a[0]), float(a[1])), (float(b[0]), float(b[1])))
    rows = np.arange(first, first + len(columns))
    inside = (rows >= 0) & (rows < n_rows)
    return rows[inside], np.clip(np.array(columns, dtype=np.int64), 0, n_columns)[inside]


def _crossed(a: Point, b: Point) -> tuple[int, list[int]]:
    """Find the first row whose centre an edge crosses, and a column for it and each row after it.

    They lie in the window if the nodes do.
    """
    (top, left), (bottom, right) = (a, b) if a[0] < b[0] else (b, a)
    if top == bottom:
        return 0, []
    start, stop = math.ceil(top - 0.5), math.ceil(bottom - 0.5)
    slope = (right - left) / (bottom - top)
    return start, [math.ceil(left + (row + 0.5 - top) * slope - 0.5) for row in range(start, stop)]


class _Rows(dict[int, list[list[float]]]):
    """Hold rows of a table as lists, taken from it when they are first asked for."""

    def __init__(self, table: NDArray[np.float64]) -> None:
        super().__init__()
        self.table = table
        self.shape = table.shape[0], table.shape[1] - 1

    def __missing__(self, row: int) -> list[list[float]]:
        cells: list[list[float]] = self.table[row].tolist()
        self[row] = cells
        return cells


def sums_of(table: NDArray[np.float64], bound: NDArray[np.float64], which: int, nodes: Nodes) -> list[EdgeSums]:
    """Sum per edge of polygon `which`.

    bound: (n_rows,) float64, the facing side of the other polygon, -1 where there is none.
    """
    points = _points(nodes)
    edges = zip(points, points[1:] + points[:1], strict=True)
    return [_edge_sums(_Rows(table), bound.tolist(), which, a, b) for a, b in edges]


def _edge_sums(rows: _Rows, bound: list[float], which: int, a: Point, b: Point) -> EdgeSums:
    first, columns = _crossed(a, b)
    total = count = 0.0
    for row, column in enumerate(columns, first):
        cell = rows[row][column]
        total += cell[0]
        count += cell[1]
    area = float(sum(columns))
    downward = b[0] > a[0]
    gap = shared = overlap = 0.0
    if downward == (which == HIGHLIGHT):  # this side faces the other polygon
        for row, column in enumerate(columns, first):
            if bound[row] >= 0.0:
                between = bound[row] - column if which == HIGHLIGHT else column - bound[row]
                shared += 1.0
                if between > 0.0:
                    gap += between
                else:
                    overlap -= between
    if downward:
        return EdgeSums._make((total, count, area, area, float(len(columns)), gap, shared, overlap))
    return EdgeSums._make((-total, -count, -area, 0.0, 0.0, gap, shared, overlap))


def _facing_side(rows: _Rows, other: list[Point], which: int) -> list[float]:
    """Find per row the column where the polygon `other` faces polygon `which`, -1 where it does not."""
    bound = [-1.0] * rows.shape[0]
    for a, b in zip(other, other[1:] + other[:1], strict=True):
        if a[0] != b[0] and (b[0] > a[0]) == (which == SHADOW):
            first, columns = _crossed(a, b)
            bound[first : first + len(columns)] = columns
    return bound


def likelihood(settings: Settings, side: int, total: float, count: float) -> float:
    """Compute the negative log-likelihood of a region of single-look speckle at its best mean, per correlation area.

    The mean of a highlight is at least dimmest_highlight, that of a shadow at most brightest_shadow; the background's
    is free.
    """
    mean = total / count
    best = max(mean, settings.faintest)
    if side == HIGHLIGHT:
        best = max(best, settings.dimmest_highlight)
    elif side == SHADOW:
        best = min(best, settings.brightest_shadow)
    return count * (math.log(best) + (mean / best - 1.0)) / settings.correlation_px


def parameter_code(settings: Settings, count: float) -> float:
    """Compute the code length of a region's mean, nats."""
    samples = count / settings.correlation_px
    return 0.5 * math.log(samples) if samples > 1.0 else 0.0


def polygon_cost(settings: Settings, which: int, nodes: Nodes | Sequence[Point], sums: EdgeSums) -> float:
    """Compute the cost of a polygon by itself: its region's likelihood, its nodes, its mean."""
    rows, columns = zip(*nodes, strict=True)
    return _own_cost(settings, which, rows, columns, sums)


def _own_cost(
    settings: Settings, which: int, rows: tuple[float, ...], columns: tuple[float, ...], sums: EdgeSums
) -> float:
    n = float(len(rows))
    row_step = sum(map(abs, map(operator.sub, rows, rows[1:] + rows[:1])))
    column_step = sum(map(abs, map(operator.sub, columns, columns[1:] + columns[:1])))
    spread = math.log(max(row_step / n * (column_step / n) / settings.correlation_px, 0.25))
    code = settings.log_window + 2.0 * math.log(n) + n * (_TWICE_LOG_2E + spread)
    return likelihood(settings, which, sums.total, sums.measured) + code + parameter_code(settings, sums.measured)


def height_m(settings: Settings, sums: EdgeSums) -> float:
    """Compute the height of what casts a shadow of mean length and place, m.

    z = H (1 - r_start / r_end) by similar triangles.
    """
    far_m = settings.first_ground_range_m + sums.far / sums.rows * settings.column_spacing_m
    near_m = far_m - sums.area / sums.rows * settings.column_spacing_m
    up = settings.altitude_m
    return up * (1.0 - math.sqrt(near_m * near_m + up * up) / math.sqrt(far_m * far_m + up * up))


def _beyond(excess_m: float, sigma_m: float) -> float:
    deviation = excess_m / sigma_m if excess_m > 0.0 else 0.0
    return 0.5 * deviation * deviation


def shadow_cost(settings: Settings, sums: EdgeSums) -> float:
    """Compute what a shadow costs that no object of a plausible height casts, nats."""
    height = height_m(settings, sums)
    cost = _beyond(height - settings.height_limit_m, settings.height_sigma_m)
    if height > settings.height_bound_m:
        cost += settings.forbidden * (height - settings.height_bound_m)
    return cost


class _Polygon(NamedTuple):
    """Hold a polygon as the criterion sees it: its sums, what it costs by itself, and how far it reaches."""

    sums: EdgeSums
    own: float
    top: float
    bottom: float
    near: float


def _seen(settings: Settings, which: int, points: list[Point], sums: EdgeSums) -> _Polygon:
    rows, columns = zip(*points, strict=True)
    own = _own_cost(settings, which, rows, columns, sums)
    return _Polygon._make((sums, own, min(rows), max(rows), min(columns)))


def _cooperation(settings: Settings, highlight: _Polygon, shadow: _Polygon, moved: EdgeSums) -> float:
    """Compute the cost of a mismatch of highlight and shadow.

    moved: of either, its gap and overlap being against the other.
    """
    top_m = abs(highlight.top - shadow.top) * settings.row_spacing_m
    bottom_m = abs(highlight.bottom - shadow.bottom) * settings.row_spacing_m
    cost = _beyond(top_m - settings.extent_tolerance_m, settings.extent_sigma_m)
    cost += _beyond(bottom_m - settings.extent_tolerance_m, settings.extent_sigma_m)
    if moved.shared > 0.0:
        cost += _beyond(
            moved.gap / moved.shared * settings.column_spacing_m - settings.gap_tolerance_m, settings.gap_sigma_m
        )
    else:
        cost += settings.forbidden
    cost += settings.forbidden * moved.overlap
    ahead = highlight.near - shadow.near
    return cost + settings.forbidden * ahead if ahead > 0.0 else cost


def _criterion(settings: Settings, pair: tuple[_Polygon | None, _Polygon | None], moved: EdgeSums) -> float:
    """Compute J of a pair, None for a polygon that does not exist.

    moved: sums of the one that hold gap and overlap.
    """
    highlight, shadow = pair
    present = [polygon for polygon in pair if polygon is not None]
    cost = sum([polygon.own for polygon in present])
    total, count = settings.window_sum, settings.window_count
    for polygon in present:
        total -= polygon.sums.total
        count -= polygon.sums.measured
    if count >= 1.0:
        cost += likelihood(settings, BACKGROUND, total, count) + parameter_code(settings, count)
    if shadow is not None:
        cost += shadow_cost(settings, shadow.sums)
    if highlight is not None and shadow is not None:
        cost += _cooperation(settings, highlight, shadow, moved)
    return cost


def no_object(settings: Settings) -> float:
    """Compute J of a window without any object."""
    return likelihood(settings, BACKGROUND, settings.window_sum, settings.window_count) + parameter_code(
        settings, settings.window_count
    )


def is_sound(nodes: Nodes) -> bool:
    """Check that a polygon is simple, its nodes half a pixel apart, and each row crosses it at most twice."""
    return _sound(_points(nodes), range(len(nodes)))


def _points(nodes: Nodes) -> list[Point]:
    return [(row, column) for row, column in nodes.tolist()]


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
        self.rows = _Rows(table)
        self.settings = settings
        self.points = [_points(nodes[HIGHLIGHT]), _points(nodes[SHADOW])]
        self.edges: list[list[EdgeSums]] = [[], []]
        self.seen: list[_Polygon | None] = [None, None]
        self.bounds: list[list[float]] = [[], []]
        self.measured: list[dict[tuple[Point, Point], EdgeSums]] = [{}, {}]
        self.n_moves = self.n_proposed = 0
        self.criterion = 0.0
        self.settled: set[tuple[int, int]] = (
            set()
        )  # polygon and node that nothing has moved since no way of theirs was better
        for which in (HIGHLIGHT, SHADOW):
            if self.points[which]:
                self.face(which)
                self.refresh(which)

    def face(self, which: int) -> None:
        """Fix the other polygon and move polygon `which` from now on."""
        bound = _facing_side(self.rows, self.points[1 - which], which)
        if bound != self.bounds[which]:
            self.bounds[which], self.measured[which] = bound, {}

    def refresh(self, which: int) -> None:
        """Measure polygon `which` anew, and the criterion."""
        points = self.points[which]
        self.edges[which] = [self.edge(which, a, b) for a, b in zip(points, points[1:] + points[:1], strict=True)]
        self.seen[which] = _seen(self.settings, which, points, _total(self.edges[which]))
        self.criterion = self.value(which, self.seen[which])

    def edge(self, which: int, a: Point, b: Point) -> EdgeSums:
        """Measure an edge of polygon `which`."""
        measured = self.measured[which]
        sums = measured.get((a, b))
        if sums is None:
            sums = measured[a, b] = _edge_sums(self.rows, self.bounds[which], which, a, b)
        return sums

    def value(self, which: int, moved: _Polygon | None) -> float:
        """Compute the criterion with another polygon `which`."""
        assert moved is not None
        pair = (moved, self.seen[SHADOW]) if which == HIGHLIGHT else (self.seen[HIGHLIGHT], moved)
        return _criterion(self.settings, pair, moved.sums)

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
        found = self.value(which, _seen(self.settings, which, points, sums))
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
                found = self.value(which, _seen(self.settings, which, points, sums))
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
    sums = [_NOTHING if seen is None else seen.sums for seen in pair.seen]
    nodes = [np.array(points, dtype=np.float64).reshape(-1, 2) for points in pair.points]
    return Moved(
        nodes[HIGHLIGHT],
        nodes[SHADOW],
        pair.criterion,
        pair.n_moves,
        pair.n_proposed,
        sums[HIGHLIGHT],
        sums[SHADOW],
    )
