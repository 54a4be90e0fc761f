"""Make the moves of `kernels.snake` in Python: the same decisions as the C kernel, to be read and compared with."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Nodes = NDArray[np.float64]

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
    upper, lower = (a, b) if a[0] < b[0] else (b, a)
    if a[0] == b[0]:
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    start, stop = (min(max(math.ceil(end[0] - 0.5), 0), n_rows) for end in (upper, lower))
    rows = np.arange(start, stop)
    slope = (lower[1] - upper[1]) / (lower[0] - upper[0])
    columns = np.ceil(upper[1] + (rows + 0.5 - upper[0]) * slope - 0.5)
    return rows, np.clip(columns, 0, n_columns).astype(np.int64)


def sums_of(table: NDArray[np.float64], bound: NDArray[np.float64], which: int, nodes: Nodes) -> list[EdgeSums]:
    """Sum per edge of polygon `which`.

    bound: (n_rows,) float64, the facing side of the other polygon, -1 where there is none.
    """
    return [_edge_sums(table, bound, which, a, b) for a, b in zip(nodes, np.roll(nodes, -1, axis=0), strict=True)]


def _edge_sums(table: NDArray[np.float64], bound: NDArray[np.float64], which: int, a: Nodes, b: Nodes) -> EdgeSums:
    rows, columns = crossings(a, b, table.shape[0], table.shape[1] - 1)
    downward = bool(b[0] > a[0])
    sign = 1.0 if downward else -1.0
    total, count = table[rows, columns].sum(axis=0)
    area = float(columns.sum())
    gap = shared = overlap = 0.0
    if downward == (which == HIGHLIGHT):  # this side faces the other polygon
        facing = bound[rows] >= 0.0
        between = (bound[rows] - columns if which == HIGHLIGHT else columns - bound[rows])[facing]
        gap, overlap, shared = (
            float(between[between > 0.0].sum()),
            float(-between[between < 0.0].sum()),
            float(facing.sum()),
        )
    far, n_rows = (area, float(len(rows))) if downward else (0.0, 0.0)
    return EdgeSums(sign * float(total), sign * float(count), sign * area, far, n_rows, gap, shared, overlap)


def facing_side(other: Nodes, which: int, n_rows: int, n_columns: int) -> NDArray[np.float64]:
    """Find per row the column where the polygon `other` faces polygon `which`, (n_rows,) float64.

    -1 where it does not.
    """
    bound = np.full(n_rows, -1.0)
    for a, b in zip(other, np.roll(other, -1, axis=0), strict=True):
        if a[0] != b[0] and (b[0] > a[0]) == (which == SHADOW):
            rows, columns = crossings(a, b, n_rows, n_columns)
            bound[rows] = columns
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


def polygon_cost(settings: Settings, which: int, nodes: Nodes, sums: EdgeSums) -> float:
    """Compute the cost of a polygon by itself: its region's likelihood, its nodes, its mean."""
    n = float(len(nodes))
    row_step, column_step = np.abs(np.roll(nodes, -1, axis=0) - nodes).sum(axis=0).tolist()
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


def cooperation(settings: Settings, highlight: Nodes, shadow: Nodes, moved: EdgeSums) -> float:
    """Compute the cost of a mismatch of highlight and shadow.

    moved: of either, its gap and overlap being against the other.
    """
    top, bottom = (abs(end(highlight[:, 0]) - end(shadow[:, 0])) * settings.row_spacing_m for end in (np.min, np.max))
    cost = _beyond(float(top) - settings.extent_tolerance_m, settings.extent_sigma_m)
    cost += _beyond(float(bottom) - settings.extent_tolerance_m, settings.extent_sigma_m)
    if moved.shared > 0.0:
        cost += _beyond(
            moved.gap / moved.shared * settings.column_spacing_m - settings.gap_tolerance_m, settings.gap_sigma_m
        )
    else:
        cost += settings.forbidden
    cost += settings.forbidden * moved.overlap
    ahead = float(highlight[:, 1].min() - shadow[:, 1].min())
    return cost + settings.forbidden * ahead if ahead > 0.0 else cost


def criterion(settings: Settings, nodes: tuple[Nodes, Nodes], sums: tuple[EdgeSums, EdgeSums], moved: int) -> float:
    """Compute J of a pair. moved: the polygon whose sums hold gap and overlap."""
    present = [which for which in (HIGHLIGHT, SHADOW) if len(nodes[which])]
    cost = polygon_cost(settings, present[0], nodes[present[0]], sums[present[0]])
    if len(present) == 2:
        cost += polygon_cost(settings, SHADOW, nodes[SHADOW], sums[SHADOW])
    count = settings.window_count - sums[HIGHLIGHT].measured - sums[SHADOW].measured
    if count >= 1.0:
        total = settings.window_sum - sums[HIGHLIGHT].total - sums[SHADOW].total
        cost += likelihood(settings, BACKGROUND, total, count) + parameter_code(settings, count)
    if SHADOW in present:
        cost += shadow_cost(settings, sums[SHADOW])
    if len(present) == 2:
        cost += cooperation(settings, nodes[HIGHLIGHT], nodes[SHADOW], sums[moved])
    return cost


def no_object(settings: Settings) -> float:
    """Compute J of a window without any object."""
    return likelihood(settings, BACKGROUND, settings.window_sum, settings.window_count) + parameter_code(
        settings, settings.window_count
    )


def is_sound(nodes: Nodes) -> bool:
    """Check that a polygon is simple, its nodes half a pixel apart, and each row crosses it at most twice."""
    return _sound(nodes, range(len(nodes)))


def _sound(nodes: Nodes, edges: range) -> bool:
    """Check as is_sound where only `edges` can be at fault."""
    points = [(float(row), float(column)) for row, column in nodes]
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


_Point = tuple[float, float]


def _sign(value: float) -> int:
    return (value > 0.0) - (value < 0.0)


def _turn(a: _Point, b: _Point, c: _Point) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _meet(a: _Point, b: _Point, c: _Point, d: _Point) -> bool:
    """Check whether two segments have a point in common."""
    c_side, d_side, a_side, b_side = (_sign(_turn(*three)) for three in ((a, b, c), (a, b, d), (c, d, a), (c, d, b)))
    if c_side * d_side < 0 and a_side * b_side < 0:
        return True
    ends = ((c_side, a, b, c), (d_side, a, b, d), (a_side, c, d, a), (b_side, c, d, b))
    return any(side == 0 and _within(p, q, point) for side, p, q, point in ends)


def _within(a: _Point, b: _Point, point: _Point) -> bool:
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
    total = _NOTHING
    for edge in edges:
        total = EdgeSums(*(a + b for a, b in zip(total, edge, strict=True)))
    return total


class _Pair:
    """Hold the pair on its way. `sums` of a polygon hold gap and overlap as they were when it last moved."""

    def __init__(self, table: NDArray[np.float64], settings: Settings, nodes: tuple[Nodes, Nodes]) -> None:
        self.table = table
        self.settings = settings
        self.nodes = [nodes[HIGHLIGHT].copy(), nodes[SHADOW].copy()]
        self.sums = [_NOTHING, _NOTHING]
        self.n_moves = self.n_proposed = 0
        self.criterion = 0.0
        self.settled: set[tuple[int, int]] = (
            set()
        )  # polygon and node that nothing has moved since no way of theirs was better
        for which in (HIGHLIGHT, SHADOW):
            if len(self.nodes[which]):
                self.face(which)
                self.sums[which] = _total(sums_of(table, self.bound, which, self.nodes[which]))
        for which in (HIGHLIGHT, SHADOW):
            if len(self.nodes[which]):
                self.face(which)
                self.criterion = self.refreshed(which)

    def face(self, which: int) -> None:
        """Fix the other polygon and move polygon `which` from now on."""
        self.bound = facing_side(self.nodes[1 - which], which, self.table.shape[0], self.table.shape[1] - 1)

    def refreshed(self, which: int) -> float:
        """Measure polygon `which` anew; returns the criterion."""
        self.sums[which] = _total(sums_of(self.table, self.bound, which, self.nodes[which]))
        return self.value(which, self.nodes[which], self.sums[which])

    def value(self, which: int, nodes: Nodes, sums: EdgeSums) -> float:
        """Compute the criterion with other nodes for polygon `which`."""
        both_nodes, both_sums = list(self.nodes), list(self.sums)
        both_nodes[which], both_sums[which] = nodes, sums
        return criterion(self.settings, (both_nodes[0], both_nodes[1]), (both_sums[0], both_sums[1]), which)

    def sweep(self, which: int, amplitude: float) -> int:
        """Move each node, and the edge after it, the best way of all unless it is settled; return how many moved."""
        n = len(self.nodes[which])
        if n == 0:
            return 0
        self.face(which)
        self.criterion = self.refreshed(which)
        moved = 0
        for i in range(n):
            if (which, i) in self.settled:
                continue
            best: Nodes | None = None
            edges = sums_of(self.table, self.bound, which, self.nodes[which])
            for n_shifted, ways in ((1, _NODE_WAYS), (2, _EDGE_WAYS)):
                for way in ways:
                    nodes = self.nodes[which].copy()
                    nodes[[(i + k) % n for k in range(n_shifted)]] += np.array(way) * amplitude
                    found = self.tried(which, nodes, edges, range(i - 1, i + n_shifted))
                    if found < self.criterion:
                        self.criterion, best = found, nodes
            if best is None:
                self.settled.add((which, i))
            else:
                self.nodes[which] = best
                self.criterion = self.refreshed(which)
                self.settled.clear()
                moved += 1
        return moved

    def tried(self, which: int, nodes: Nodes, edges: list[EdgeSums], changed: range) -> float:
        """Compute the criterion of nodes that differ at the edges `changed`.

        Infinite where it is no better or not allowed.
        """
        n = len(nodes)
        window = self.table.shape[0], self.table.shape[1] - 1
        if not ((nodes >= 0.0) & (nodes <= window)).all():
            return math.inf
        self.n_proposed += 1
        edges = list(edges)
        for i in changed:
            edges[i % n] = _edge_sums(self.table, self.bound, which, nodes[i % n], nodes[(i + 1) % n])
        sums = _total(edges)
        if sums.measured < 1.0 or sums.area < self.settings.min_area_px:
            return math.inf
        found = self.value(which, nodes, sums)
        return found if found < self.criterion and _sound(nodes, changed) else math.inf

    def subdivide(self, which: int, n: int) -> None:
        """Add nodes half-way along the longest edges, the first of equals, until there are n."""
        while 0 < len(self.nodes[which]) < n:
            nodes = self.nodes[which]
            after = np.roll(nodes, -1, axis=0)
            square = ((after - nodes) ** 2).sum(axis=1)
            longest = int(square.argmax())
            if square[longest] < _SHORTEST_CUT_PX * _SHORTEST_CUT_PX:
                return
            self.nodes[which] = np.insert(nodes, longest + 1, 0.5 * (nodes[longest] + after[longest]), axis=0)

    def prune(self, which: int) -> int:
        """Remove nodes one by one whose removal lowers the criterion most; return how many went."""
        if len(self.nodes[which]) == 0:
            return 0
        self.face(which)
        self.criterion = self.refreshed(which)
        gone = 0
        while len(self.nodes[which]) > 3:
            best: Nodes | None = None
            for i in range(len(self.nodes[which])):
                nodes = np.delete(self.nodes[which], i, axis=0)
                sums = _total(sums_of(self.table, self.bound, which, nodes))
                self.n_proposed += 1
                if sums.measured < 1.0 or sums.area < self.settings.min_area_px:
                    continue
                found = self.value(which, nodes, sums)
                if found < self.criterion and _sound(nodes, range(i - 1, i)):
                    self.criterion, best = found, nodes
            if best is None:
                break
            self.nodes[which] = best
            self.criterion = self.refreshed(which)
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
            if len(pair.nodes[which]) == 0:
                continue
            if amplitude == 0.0:
                pair.n_moves += pair.prune(which)
            else:
                pair.subdivide(which, int(n_nodes))
                pair.face(which)
                pair.criterion = pair.refreshed(which)
        for _ in range(int(n_sweeps) if amplitude > 0.0 else 0):
            moved = pair.sweep(SHADOW, amplitude) + pair.sweep(HIGHLIGHT, amplitude)
            pair.n_moves += moved
            if moved == 0:
                break
    return Moved(
        pair.nodes[HIGHLIGHT],
        pair.nodes[SHADOW],
        pair.criterion,
        pair.n_moves,
        pair.n_proposed,
        pair.sums[HIGHLIGHT],
        pair.sums[SHADOW],
    )
