"""Find contours of highlight and shadow by cooperating statistical snakes, and judge whether they are an object's.

Reed, Petillot and Bell, IEEE J. Oceanic Eng. 28(1), 2003: two contours share what is known of object images, namely
that a highlight is followed by a shadow of the same along-track extent. They work on the echoes themselves, so it
matters little how well the start was labelled; on sea floor without an object they expand beyond what a mine can be,
and `snake_rules` rejects them.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.confirm import snake_rules
from auv_mcm.confirm.region import HIGHLIGHT, SHADOW, Region, require_sound
from auv_mcm.kernels import snake, snake_criterion
from auv_mcm.kernels.order import quantile
from auv_mcm.kernels.snake_criterion import Settings
from auv_mcm.kernels.snake_descent import MIN_SIDE_PX, Course, Schedule, box, descend, is_measured
from auv_mcm.kernels.snake_elsewhere import evidences
from auv_mcm.kernels.snake_twin import Moved

Nodes = NDArray[np.float64]

# (nodes, pixels a move goes, sweeps at most): from the box toward the object, on few nodes
COARSE: Final[Schedule] = ((4, 8.0, 20), (4, 3.0, 20))
FINE: Final[Schedule] = ((8, 3.0, 20), (8, 1.0, 20), (16, 1.0, 20), (0, 0.0, 1), (0, 1.0, 10))
"""(nodes, pixels a move goes, sweeps at most) per stage; 0 pixels is pruning. See `kernels.snake.move_pair`."""

# the same after highlight and shadow are joined: moves of a pixel, then pruning
_POLISH: Final[Schedule] = ((0, 1.0, 10), (0, 0.0, 1))
_NONE: Final = np.empty((0, 2))
_MIN_AREA_PX: Final = 9.0  # pixels: a polygon of less holds too few samples to estimate a mean
_NODES_PER_PX: Final = 16.0  # coarse enough that the kernel need not round what it returned before
_FAINTEST: Final = 1e-6  # times the region's mean: keeps the logarithm of an empty shadow's mean finite
_DIMMEST_HIGHLIGHT, _BRIGHTEST_SHADOW = 1.5, 0.5  # times the region's mean
_FORBIDDEN: Final = 1e6  # nats: more than any likelihood of a region, so that such a state never wins
# How well highlight and shadow of one object fit: beam width, layover and scour allow this much.
_EXTENT_M, _EXTENT_SIGMA_M = 0.2, 0.1
_GAP_M, _GAP_SIGMA_M = 0.3, 0.1
_HEIGHT_M, _HEIGHT_SIGMA_M, _HEIGHT_BOUND_M = 1.2, 0.1, 2.0
_STRIP_M: Final = 0.3  # m across the track of the thinnest start of a shadow; at least the smallest side in pixels
# Boxes to start from, metres: along track, across track, from the detection, and the height of what casts the shadow.
_START_SHIFTS_M: Final = (0.0, -0.35, 0.35)
_START_ALONG_M: Final = (0.5, 1.0, 2.0)
_START_ACROSS_M: Final = (0.25, 0.5)
_START_BEHIND_M: Final = (0.1, 0.4, 0.7, 1.0)
_START_HEIGHTS_M: Final = (0.15, 0.3, 0.5, 0.8)
_MIN_SHADOW_M, _LONGEST_SHADOW_M = 0.3, 8.0


class Start(NamedTuple):
    """Hold where the contours start: (n, 2) float64 nodes (row, column); (0, 2) for none."""

    highlight: Nodes
    shadow: Nodes


class RegionContext(NamedTuple):
    """Hold what contours in a region share wherever they start.

    boxes: the start at the detection; spot: what is special about it there.
    """

    region: Region
    sums: snake.WindowRowSums
    settings: Settings
    boxes: Start
    spot: snake_rules.Spot


class Contours(msgspec.Struct, frozen=True, kw_only=True, eq=False):
    """Hold the result of the snakes.

    highlight, shadow: (n, 2) float64 nodes (row, column) in pixels of the region, pixel (r, k) covering [r, r + 1) x
    [k, k + 1), along the far side with rising row; (0, 2) where there is none. criterion: J in nats, NaN if nothing
    could be moved. gain: by how much J is below that of the region without an object. n_moves: node moves made. *_mean:
    mean intensity, NaN where there is no contour. length_m: along-track extent. height_m: median over rows of the
    height that the shadow implies, NaN without a shadow. repetition: best evidence of the same contours elsewhere in
    the region over that in place. reasons: codes, those of `snake_rules.REJECTING` being of broken rules. rejected:
    rules are broken, and the evidence against an object is grave in sum.
    """

    highlight: Nodes
    shadow: Nodes
    criterion: float
    gain: float
    n_moves: int
    highlight_mean: float
    shadow_mean: float
    background_mean: float
    highlight_area_m2: float
    length_m: float
    height_m: float
    repetition: float
    reasons: tuple[str, ...]
    rejected: bool


def start_from_detection(region: Region) -> Start:
    """Find the brightest box around the detector's highlight, and the darkest behind it that a mine could cast.

    Brightest and darkest: by the likelihood ratio of speckle, N (m - 1 - ln m) for N pixels of mean m over the
    region's. Raises ValueError if the region's geometry is impossible for a sonar.
    """
    require_sound(region)
    return _boxes_at(region, snake.window_row_sums(region.intensity, region.valid).table)


def _boxes_at(region: Region, table: Nodes) -> Start:
    n_rows, n_columns = region.intensity.shape
    sums = np.zeros((n_rows + 1, n_columns + 1, 2))
    np.cumsum(table, axis=0, out=sums[1:])
    row_px, column_px = region.row_spacing_m, region.column_spacing_m
    row, column = min(max(region.row, 0.0), float(n_rows)), min(max(region.column, 0.0), float(n_columns))
    ground_m = max(region.first_ground_range_m + column * column_px, 0.0)
    above_m = np.maximum(region.altitude_m - np.array(_START_HEIGHTS_M), 0.3 * abs(region.altitude_m) + 0.1)
    lengths_m = np.clip(np.array(_START_HEIGHTS_M) * ground_m / above_m, _MIN_SHADOW_M, _LONGEST_SHADOW_M)
    centres, halves = row + np.array(_START_SHIFTS_M) / row_px, np.array(_START_ALONG_M) / (2.0 * row_px)
    far_m = np.array(_START_ACROSS_M)
    highlight = _best_box(
        snake_criterion.HIGHLIGHT, region, sums, centres, halves, column - 0.5 * far_m / column_px, far_m / column_px
    )
    behind = column + np.array(_START_BEHIND_M) / column_px
    shadow = _best_box(snake_criterion.SHADOW, region, sums, centres, halves, behind, lengths_m / column_px)
    return Start(highlight, shadow)


def _best_box(
    which: int, region: Region, sums: Nodes, centres: Nodes, halves: Nodes, nears: Nodes, widths: Nodes
) -> Nodes:
    """Find the box with most evidence, the first of equals.

    All centres and halves along track with all near sides and widths are tried.

    sums: (n_rows + 1, n_columns + 1, 2) of all that is above and before.
    """
    n_rows, n_columns = region.intensity.shape
    top, bottom = _intervals(np.subtract.outer(centres, halves), np.add.outer(centres, halves), n_rows)
    low, high = _intervals(np.repeat(nears, len(widths)), np.add.outer(nears, widths).ravel(), n_columns)
    rows, columns = np.minimum(bottom, n_rows)[:, None], np.minimum(high, n_columns)
    total, count = (
        sums[rows, columns] - sums[top[:, None], columns] - sums[rows, low] + sums[top[:, None], low]
    ).transpose(2, 0, 1)
    row, column = divmod(int(evidences(which, total, count).argmax()), len(low))
    return _box(top[row], low[column], bottom[row], high[column], region)


def start_from_labels(region: Region, labels: NDArray[np.uint8]) -> Start:
    """Make boxes around most of the highlight and of the shadow labels; none where a label is missing.

    labels: (n_rows, n_columns) uint8 of BACKGROUND, SHADOW and HIGHLIGHT, of one object. Raises ValueError if the shape
    does not fit.
    """
    if labels.shape != region.intensity.shape:
        raise ValueError(f"labels must have the shape of the region, {region.intensity.shape}, not {labels.shape}")
    boxes = []
    for label in (HIGHLIGHT, SHADOW):
        rows, columns = np.nonzero(labels == label)
        if len(rows) == 0:
            boxes.append(_NONE)
            continue
        columns = np.sort(columns)  # rows rise as they are
        top, bottom, near, far = (quantile(places, share) for places in (rows, columns) for share in (0.05, 0.95))
        boxes.append(_box(top, near, bottom + 1.0, far + 1.0, region))
    return Start(*boxes)


def converge(
    region: Region, start: Start, *, correlation_px: float = 1.0, coarse: Schedule = COARSE, fine: Schedule = FINE
) -> Contours:
    """Find contours of the object at `start`, deterministically.

    correlation_px: correlation area of the speckle in pixels, as `speckle.measure_correlation` gives for each axis.
    Never raises on what a region holds: a start that is not a polygon is replaced (`start_replaced`), and a region that
    cannot be judged is rejected.
    Raises ValueError if correlation_px or a schedule is out of range.
    """
    ground = survey(region, correlation_px)
    return ground if isinstance(ground, Contours) else converge_on(ground, start, coarse=coarse, fine=fine)


def survey(region: Region, correlation_px: float) -> RegionContext | Contours:
    """Compute what contours in a region share wherever they start, or empty contours. Raises as converge does."""
    if not 1.0 <= correlation_px < math.inf:
        raise ValueError(f"correlation_px must be a finite area of at least one pixel, not {correlation_px}")
    if min(region.intensity.shape) < 2 * MIN_SIDE_PX:
        return _nothing(("region_too_small",))
    try:
        require_sound(region)
    except ValueError:
        return _nothing(("geometry_unknown",))
    sums = snake.window_row_sums(region.intensity, region.valid)
    if sums.mean == 0.0:
        return _nothing(("no_echo",))
    boxes = _boxes_at(region, sums.table)
    return RegionContext(
        region, sums, snake_settings(region, sums.table, correlation_px), boxes, snake_rules.look_at(sums.table, *boxes)
    )


def converge_on(ground: RegionContext, start: Start, *, coarse: Schedule = COARSE, fine: Schedule = FINE) -> Contours:
    """Apply `converge` several times in one region."""
    region, sums, settings, boxes, spot = ground
    parts, replaced = _usable_start(region, sums.table, settings, start, boxes)
    reasons = ("start_replaced",) if replaced else ()
    highlight, shadow = (nodes if is_measured(sums.table, nodes) else _NONE for nodes in parts)
    if len(highlight) + len(shadow) == 0:
        return _nothing((*reasons, "not_measured"))
    strip_px = max(_STRIP_M / region.column_spacing_m, MIN_SIDE_PX)
    moved, n_moves = descend(sums.table, settings, Course(coarse, fine, _POLISH), highlight, shadow, strip_px)
    findings = snake_rules.find(region, sums.table, settings, moved, spot)
    return _judged(region, sums, findings, moved, n_moves, reasons)


def _judged(
    region: Region,
    sums: snake.WindowRowSums,
    findings: snake_rules.Findings,
    moved: Moved,
    n_moves: int,
    notes: tuple[str, ...],
) -> Contours:
    if len(moved.highlight) == 0:
        notes = (*notes, "no_highlight")
    if len(moved.shadow) == 0:
        notes = (*notes, "no_shadow")
    if not any(is_measured(sums.table, nodes) for nodes in (moved.highlight, moved.shadow)):
        notes = (*notes, "not_measured")
    reasons = (*notes, *snake_rules.broken(findings))
    pixel_m2 = region.row_spacing_m * region.column_spacing_m
    return Contours(
        highlight=moved.highlight,
        shadow=moved.shadow,
        criterion=moved.criterion,
        gain=findings.gain,
        n_moves=n_moves,
        highlight_mean=findings.highlight_mean * sums.mean,
        shadow_mean=findings.shadow_mean * sums.mean,
        background_mean=findings.background_mean * sums.mean,
        highlight_area_m2=moved.highlight_sums.area * pixel_m2,
        length_m=findings.length_m,
        height_m=findings.height_m,
        repetition=findings.repetition,
        reasons=reasons,
        rejected=snake_rules.is_rejected(reasons, findings),
    )


def _nothing(reasons: tuple[str, ...]) -> Contours:
    nan = math.nan
    return Contours(
        highlight=_NONE,
        shadow=_NONE,
        criterion=nan,
        gain=nan,
        n_moves=0,
        highlight_mean=nan,
        shadow_mean=nan,
        background_mean=nan,
        highlight_area_m2=0.0,
        length_m=0.0,
        height_m=nan,
        repetition=nan,
        reasons=reasons,
        rejected=True,
    )


def snake_settings(region: Region, table: NDArray[np.float64], correlation_px: float) -> Settings:
    """Set the criterion for a region; table: its `kernels.snake.window_row_sums`."""
    total, count = table[:, -1].sum(axis=0).tolist()
    return Settings(
        row_spacing_m=region.row_spacing_m,
        column_spacing_m=region.column_spacing_m,
        first_ground_range_m=region.first_ground_range_m,
        altitude_m=region.altitude_m,
        correlation_px=correlation_px,
        extent_tolerance_m=_EXTENT_M,
        extent_sigma_m=_EXTENT_SIGMA_M,
        gap_tolerance_m=_GAP_M,
        gap_sigma_m=_GAP_SIGMA_M,
        height_limit_m=_HEIGHT_M,
        height_sigma_m=_HEIGHT_SIGMA_M,
        height_bound_m=_HEIGHT_BOUND_M,
        min_area_px=_MIN_AREA_PX,
        faintest=_FAINTEST,
        dimmest_highlight=_DIMMEST_HIGHLIGHT,
        brightest_shadow=_BRIGHTEST_SHADOW,
        forbidden=_FORBIDDEN,
        window_sum=total,
        window_count=count,
        log_window=math.log(max(region.intensity.size / correlation_px, 1.0)),
    )


def _usable_start(
    region: Region, table: NDArray[np.float64], settings: Settings, start: Start, boxes: Start
) -> tuple[list[Nodes], bool]:
    """Give the start as sound polygons that run down their far sides, and whether a box replaced any.

    The boxes are those at the detection.
    """
    given = [np.asarray(nodes, dtype=np.float64) for nodes in start]
    if all(len(nodes) == 0 for nodes in given):
        return list(boxes), True
    usable = []
    replaced = False
    for which, nodes in enumerate(given):
        if len(nodes) == 0 or (polygon := _ordered(region, table, settings, nodes)) is None:
            polygon = nodes if len(nodes) == 0 else _box_around(region, nodes)
            if polygon is None:
                polygon = boxes[which]
            replaced = replaced or len(nodes) > 0
        usable.append(polygon)
    return usable, replaced


def _ordered(region: Region, table: NDArray[np.float64], settings: Settings, nodes: Nodes) -> Nodes | None:
    """Order a polygon as `kernels.snake.move_pair` takes it, None if it is not a polygon."""
    if nodes.ndim != 2 or nodes.shape[1] != 2 or not 3 <= len(nodes) <= snake.MAX_NODES:
        return None
    if not ((nodes >= 0.0) & (nodes <= region.intensity.shape)).all():
        return None
    ordered = np.rint((nodes if _area(nodes) > 0.0 else nodes[::-1]) * _NODES_PER_PX) / _NODES_PER_PX
    return None if snake.fault_of(table, settings, ordered) else ordered


def _box_around(region: Region, nodes: Nodes) -> Nodes | None:
    """Make the box around nodes that are not a polygon, None if they do not touch the region."""
    if nodes.ndim != 2 or nodes.shape[1] != 2 or not np.isfinite(nodes).all():
        return None
    n_rows, n_columns = region.intensity.shape
    (top, near), (bottom, far) = nodes.min(axis=0).tolist(), nodes.max(axis=0).tolist()
    if bottom < 0.0 or top > n_rows or far < 0.0 or near > n_columns:
        return None
    return _box(top, near, bottom, far, region)


def _area(nodes: Nodes) -> float:
    """Compute the signed area in pixels, positive for nodes running down the far side."""
    after = np.concatenate((nodes[1:], nodes[:1]))
    return 0.5 * float((nodes[:, 1] * after[:, 0] - nodes[:, 0] * after[:, 1]).sum())


def _box(top: float, near: float, bottom: float, far: float, region: Region) -> Nodes:
    return box(top, near, bottom, far, *region.intensity.shape)


def _intervals(low: Nodes, high: Nodes, size: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Apply _interval to many ends, flat."""
    low, high = (np.rint(np.clip(end.ravel(), 0.0, size)) for end in (low, high))
    low = np.maximum(np.minimum(low, size - MIN_SIDE_PX), 0.0)
    return low.astype(np.intp), np.maximum(high, low + MIN_SIDE_PX).astype(np.intp)
