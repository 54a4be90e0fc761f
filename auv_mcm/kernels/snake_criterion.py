"""Compute the criterion of `kernels.snake` in Python: the same numbers as the C kernel, to be read and compared with.

Polygons have a few nodes and edges cross a few rows, where numpy takes ten times as long as Python's own numbers.
"""

from __future__ import annotations

import math
import operator
from typing import Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

Nodes = NDArray[np.float64]
Point: TypeAlias = tuple[float, float]
"""Row and column of a node."""

HIGHLIGHT: Final = 0  # indices of the two polygons and of what neither holds; equal in C
SHADOW: Final = 1  # see HIGHLIGHT
BACKGROUND: Final = 2  # see HIGHLIGHT
# 2 ln(2e), nats: of the code length of a node (see _own_cost); equal in C
_TWICE_LOG_2E: Final = 2.0 * 1.6931471805599454


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


NOTHING: Final = EdgeSums(*[0.0] * len(EdgeSums._fields))


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


def points_of(nodes: Nodes) -> list[Point]:
    """List the nodes of a polygon, (n, 2)."""
    return [(row, column) for row, column in nodes.tolist()]


class TableRows(dict[int, list[list[float]]]):
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
    points = points_of(nodes)
    edges = zip(points, points[1:] + points[:1], strict=True)
    return [edge_sums(TableRows(table), bound.tolist(), which, a, b) for a, b in edges]


def edge_sums(rows: TableRows, bound: list[float], which: int, a: Point, b: Point) -> EdgeSums:
    """Sum along the edge from a to b of polygon `which`. bound: as in sums_of."""
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


def facing_side(rows: TableRows, other: list[Point], which: int) -> list[float]:
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


def _own_cost(
    settings: Settings, which: int, rows: tuple[float, ...], columns: tuple[float, ...], sums: EdgeSums
) -> float:
    """Compute the cost of a polygon by itself, nats: its region's likelihood, its nodes, its mean."""
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


class Polygon(NamedTuple):
    """Hold a polygon as the criterion sees it: its sums, what it costs by itself, and how far it reaches."""

    sums: EdgeSums
    own: float
    top: float
    bottom: float
    near: float


def polygon_of(settings: Settings, which: int, points: list[Point], sums: EdgeSums) -> Polygon:
    """Take what the criterion sees of polygon `which`."""
    rows, columns = zip(*points, strict=True)
    own = _own_cost(settings, which, rows, columns, sums)
    return Polygon._make((sums, own, min(rows), max(rows), min(columns)))


def _cooperation(settings: Settings, highlight: Polygon, shadow: Polygon, moved: EdgeSums) -> float:
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


def criterion_of(settings: Settings, pair: tuple[Polygon | None, Polygon | None], moved: EdgeSums) -> float:
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
