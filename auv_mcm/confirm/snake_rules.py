"""Test contours by the rules that an object's contours follow.

Each rule has a code; broken ones reject where doubt is grave.

On sea floor without an object the shadow's contour expands until it is larger than any mine's shadow, or shrinks to
nothing (Reed, Petillot and Bell, IEEE J. Oceanic Eng. 28(1), 2003). Ripples and grass do hold dark patches behind
bright ones, but the same contours find the like of them a ripple farther on.

Beside another kind of floor the contours of a clear object expand as well, so a broken rule alone does not reject. The
evidence against an object is added up instead, in nats: how far rules are broken, and whether the brightest and darkest
box at the detection itself, which cannot expand, stand out there.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.confirm.region import Region
from auv_mcm.kernels import snake_criterion
from auv_mcm.kernels.order import median
from auv_mcm.kernels.snake_criterion import HIGHLIGHT, SHADOW, Settings
from auv_mcm.kernels.snake_descent import row_intervals
from auv_mcm.kernels.snake_elsewhere import elsewhere
from auv_mcm.kernels.snake_twin import Moved

Nodes = NDArray[np.float64]

BORDER_PX: Final = 2.0  # pixels from the region's edge within which a contour may be cut by it
_DARKEST: Final = 0.01  # times the mean of the window

# Bounds that objects keep, on held-out seeds of simulated missions over rippled sand, seagrass and bare floor.
_MAX_BORDER: Final = 0.25
_SHORTEST_M, _LONGEST_M = 0.36, 4.5
_DEEPEST_HIGHLIGHT_M, _LARGEST_HIGHLIGHT_M2 = 0.92, 1.25
_LARGEST_MINE_M, _HIGHEST_MINE_M, _SHADOW_MARGIN = 2.5, 0.6, 2.5
_LOWEST_M, _LOWEST_PEAK_M, _HIGHEST_M = 0.1, 0.14, 1.2
_BRIGHTEST_SHADOW: Final = 0.45  # times the background's mean: above it a shadow is not dark
_DARKEST_FLANK, _BRIGHTEST_FLANK = 0.35, 1.5
_DARKEST_FRONT, _LIT = 0.15, 2.0
_FRONT_M, _FRONT_GAP_M, _MIN_FRONT_M2 = 1.5, 0.2, 0.1
_HALF_OBJECT_M: Final = 0.4  # m from the detection to where its front begins, where the contours leave no room for it
_MIN_GAIN: Final = -8.0  # J pays for the nodes of small contours with more than a faint target earns
_MAX_REPETITION, _MAX_COMMON = 0.55, 0.3
_DOUBTFUL_GAIN, _GAIN_SCALE, _HOPELESS_GAIN = -6.0, 10.0, -14.0
_GRAVE: Final = 6.6  # nats of doubt
# evidence of what the contours started from that is common around, beyond which it repeats
_MAX_COMMON_SPOT: Final = 0.35

REJECTING: Final = frozenset(
    {
        "region_too_small",
        "geometry_unknown",
        "no_echo",
        "not_measured",
        "touches_border",
        "too_short",
        "too_long",
        "highlight_too_large",
        "shadow_too_large",
        "too_low",
        "too_high",
        "shadow_not_dark",
        "shadow_goes_on",
        "in_shadow",
        "hole_in_bright",
        "little_evidence",
        "repeats",
    }
)
"""Codes that are evidence against an object."""


class Spot(NamedTuple):
    """Describe how the brightest and the darkest box at a detection stand out, as `look_at` finds it.

    common: evidence that one place in twenty of the region holds for the same box over that in place, of the box for
    which it is less. shadow_repetition: the best such evidence for the dark box. shadow_contrast: mean of the dark box
    over that of the darker of the two boxes beside it along track.
    """

    common: float
    shadow_repetition: float
    shadow_contrast: float


class Findings(NamedTuple):
    """Hold facts about converged contours. Means are over that of the region; NaN where there is no contour.

    gain: nats against no object. border: fraction of a contour within BORDER_PX of the region's edge, of the worse one.
    length_m:
    along-track extent of the pair. highlight_m2, highlight_depth_m: area of the highlight and that over its along-track
    extent. shadow_m2: area; largest_shadow_m2: that of the largest mine there. height_m, peak_height_m: median and
    maximum of the heights that the rows of the shadow imply. flank: mean beside the shadow along track. front: mean
    before the pair across track. repetition, common:
    see `kernels.snake_elsewhere`. spot: of the detection.
    """

    gain: float
    highlight_mean: float
    shadow_mean: float
    background_mean: float
    border: float
    length_m: float
    highlight_m2: float
    highlight_depth_m: float
    shadow_m2: float
    largest_shadow_m2: float
    height_m: float
    peak_height_m: float
    flank: float
    front: float
    repetition: float
    common: float
    spot: Spot


def find(region: Region, table: NDArray[np.float64], settings: Settings, moved: Moved, spot: Spot) -> Findings:
    """Measure converged contours."""
    highlight, shadow = moved.highlight_sums, moved.shadow_sums
    count = settings.window_count - highlight.measured - shadow.measured
    rest = (settings.window_sum - highlight.total - shadow.total) / count if count >= 1.0 else math.nan
    present = [nodes for nodes in (moved.highlight, moved.shadow) if len(nodes)]
    pixel_m2 = region.row_spacing_m * region.column_spacing_m
    heights_m = row_heights_m(region, moved.shadow) if len(moved.shadow) else np.array([math.nan])
    repetition, common = elsewhere(table, ((HIGHLIGHT, moved.highlight), (SHADOW, moved.shadow)))
    return Findings(
        gain=snake_criterion.no_object(settings) - moved.criterion,
        highlight_mean=highlight.total / highlight.measured if len(moved.highlight) else math.nan,
        shadow_mean=shadow.total / shadow.measured if len(moved.shadow) else math.nan,
        background_mean=rest,
        border=max(border_fraction(nodes, region.intensity.shape) for nodes in present),
        length_m=float(np.ptp(np.concatenate([nodes[:, 0] for nodes in present]))) * region.row_spacing_m,
        highlight_m2=highlight.area * pixel_m2,
        highlight_depth_m=highlight.area / highlight.rows * region.column_spacing_m
        if len(moved.highlight)
        else math.nan,
        shadow_m2=shadow.area * pixel_m2,
        largest_shadow_m2=_largest_shadow_m2(region),
        height_m=median(heights_m),
        peak_height_m=float(heights_m.max()),
        flank=_flank(table, moved.shadow) if len(moved.shadow) else math.nan,
        front=_front(region, table, moved),
        repetition=repetition,
        common=common,
        spot=spot,
    )


def broken(findings: Findings) -> tuple[str, ...]:
    """List the codes of the rules that the contours break, in fixed order.

    A value that is not known (NaN) breaks none, but missing evidence does.
    """
    rules = (
        ("touches_border", findings.border > _MAX_BORDER),
        ("too_short", findings.length_m < _SHORTEST_M),
        ("too_long", findings.length_m > _LONGEST_M),
        (
            "highlight_too_large",
            findings.highlight_m2 > _LARGEST_HIGHLIGHT_M2 or findings.highlight_depth_m > _DEEPEST_HIGHLIGHT_M,
        ),
        ("shadow_too_large", findings.shadow_m2 > _SHADOW_MARGIN * findings.largest_shadow_m2),
        ("too_low", findings.height_m < _LOWEST_M or findings.peak_height_m < _LOWEST_PEAK_M),
        ("too_high", findings.height_m > _HIGHEST_M),
        ("shadow_not_dark", findings.shadow_mean > _BRIGHTEST_SHADOW * findings.background_mean),
        ("shadow_goes_on", findings.flank < _DARKEST_FLANK),
        ("in_shadow", findings.front < _DARKEST_FRONT * findings.background_mean and not _is_lit(findings)),
        ("hole_in_bright", findings.flank > _BRIGHTEST_FLANK),
        ("little_evidence", not findings.gain >= _MIN_GAIN),
        ("repeats", findings.repetition > _MAX_REPETITION or findings.common > _MAX_COMMON),
    )
    return tuple(code for code, is_broken in rules if is_broken)


def _is_lit(findings: Findings) -> bool:
    """Check whether there is an echo brighter than the sea floor's: an object that rises out of a shadow is seen."""
    return findings.highlight_mean > _LIT * findings.background_mean


def is_rejected(reasons: Collection[str], findings: Findings) -> bool:
    """Decide whether contours are not an object's.

    They are rejected if there are none, or if rules are broken and either the contours and what they started from both
    repeat, or all doubts together are grave.
    """
    if "not_measured" in reasons or not findings.gain > _HOPELESS_GAIN:
        return True
    everywhere = findings.repetition > _MAX_REPETITION and findings.spot.common > _MAX_COMMON_SPOT
    return not REJECTING.isdisjoint(reasons) and (everywhere or doubt(findings) > _GRAVE)


def doubt(findings: Findings) -> float:
    """Sum the evidence against an object, nats; 0 where there is none.

    Weights are those of clutter against targets in a logistic regression on missions with held-out seeds.
    """
    spot = findings.spot
    long, short = _fraction(findings.length_m, 2.5, 6.0), _fraction(findings.length_m, 0.6, 0.3)
    common = _fraction(spot.common, 0.03, 0.4)
    # Missing contours have no mean, and count by themselves.
    dim, shallow = _fraction(findings.highlight_mean, 20.0, 3.0), _fraction(spot.shadow_contrast, 0.22, 0.74)
    little = min(max((_DOUBTFUL_GAIN - findings.gain) / _GAIN_SCALE, 0.0), 1.0)
    return (
        0.5 * long
        + 3.3 * long * common
        + 2.5 * _fraction(findings.highlight_m2, 0.7, 2.5)
        + 2.7 * _fraction(findings.height_m, 0.25, 0.06)
        + 1.4 * _fraction(findings.flank, 0.6, 0.3)
        + 1.9 * _fraction(findings.repetition, 0.1, 0.8)
        + 0.9 * common
        + 1.7 * _fraction(spot.shadow_repetition, 0.3, 2.0)
        + 3.4 * dim * shallow
        + 1.1 * math.isnan(findings.highlight_mean)
        + 3.4 * math.isnan(findings.shadow_mean) * short
        + 2.1 * little
    )


def _fraction(value: float, harmless: float, grave: float) -> float:
    """Compute how far a value has come, by its logarithm, from a harmless one to a grave one; 0 for NaN."""
    if math.isnan(value):
        return 0.0
    way = math.log(max(value, 1e-3) / harmless) / math.log(grave / harmless)
    return min(max(way, 0.0), 1.0)


def _largest_shadow_m2(region: Region) -> float:
    """Compute the shadow of the largest mine at the detection, m², on a flat bottom.

    Length times height y / (altitude - height).
    """
    ground_m = max(region.first_ground_range_m + region.column * region.column_spacing_m, 0.0)
    height_m = min(_HIGHEST_MINE_M, 0.5 * region.altitude_m)
    beam_m = region.beam_width_rad * math.hypot(ground_m, region.altitude_m)
    return (_LARGEST_MINE_M + beam_m) * max(height_m * ground_m / (region.altitude_m - height_m), height_m)


def border_fraction(nodes: Nodes, shape: tuple[int, ...]) -> float:
    """Compute the fraction of a contour's length within BORDER_PX of the window's edge."""
    ways = np.concatenate((nodes[1:], nodes[:1])) - nodes
    highest = [size - BORDER_PX for size in shape]
    total = near = 0.0
    for node, way, length in zip(nodes.tolist(), ways.tolist(), np.hypot(*ways.T).tolist(), strict=True):
        total += length
        near += length * (1.0 - _inner_fraction(node, way, highest))
    return near / total if total > 0.0 else 1.0


def _inner_fraction(node: list[float], ways: list[float], highest: list[float]) -> float:
    """Compute the fraction of a segment inside the box from BORDER_PX to highest (Liang and Barsky, 1984)."""
    start, stop = 0.0, 1.0
    for origin, way, high in zip(node, ways, highest, strict=True):
        if way == 0.0:
            if not BORDER_PX <= origin <= high:
                return 0.0
            continue
        first, last = sorted(((BORDER_PX - origin) / way, (high - origin) / way))
        start, stop = max(start, first), min(stop, last)
    return max(stop - start, 0.0)


def contour_mask(nodes: Nodes, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Select pixels of a region of this shape (n_rows, n_columns) inside a contour (n, 2); none for no nodes."""
    inside = np.zeros(shape, dtype=np.bool_)
    rows, near, far = row_intervals(nodes, shape)
    column = np.arange(shape[1])
    inside[rows] = (column >= near[:, None]) & (column < far[:, None])
    return inside


def row_heights_m(region: Region, shadow: Nodes) -> NDArray[np.float64]:
    """Compute the height that the shadow implies in each row it reaches, m: z = H (1 - r_start / r_end)."""
    _, near, far = row_intervals(shadow, region.intensity.shape)
    start_m, end_m = (region.first_ground_range_m + side * region.column_spacing_m for side in (near, far))
    up = region.altitude_m
    heights: NDArray[np.float64] = up * (1.0 - np.hypot(start_m, up) / np.hypot(end_m, up))
    return heights if len(heights) else np.zeros(1)


def _flank(table: NDArray[np.float64], shadow: Nodes) -> float:
    """Average the shadow's columns in the rows beside it along track, over the window's mean.

    Both sides count; 1 where nothing was measured.
    """
    rows, near, far = row_intervals(shadow, (table.shape[0], table.shape[1] - 1))
    total = count = 0.0
    for step in (-len(rows) - 1, len(rows) + 1):
        there = rows + step
        inside = (there >= 0) & (there < table.shape[0])
        sums = (table[there[inside], far[inside]] - table[there[inside], near[inside]]).sum(axis=0)
        total, count = total + float(sums[0]), count + float(sums[1])
    return total / count if count >= 1.0 else 1.0


def _front(region: Region, table: NDArray[np.float64], moved: Moved) -> float:
    """Average the strip of floor before the pair, over the window's mean.

    In the rows of its shadow, or of its highlight if it has none; where the pair begins at the region's near border,
    before the detection. NaN where too little was measured.
    """
    n_rows, n_columns = region.intensity.shape
    first = np.full(n_rows, n_columns)
    strip_rows = np.empty(0, dtype=np.int64)
    for nodes in (moved.highlight, moved.shadow):
        if len(nodes):
            strip_rows, near, _ = row_intervals(nodes, region.intensity.shape)
            first[strip_rows] = np.minimum(first[strip_rows], near)
    gap, length, half = (
        round(reach_m / region.column_spacing_m) for reach_m in (_FRONT_GAP_M, _FRONT_M, _HALF_OBJECT_M)
    )
    far = first[strip_rows] - gap
    far = np.clip(np.where(far >= length // 2, far, round(region.column) - half), 0, n_columns)
    total, count = (table[strip_rows, far] - table[strip_rows, np.maximum(far - length, 0)]).sum(axis=0).tolist()
    return total / count if count * region.row_spacing_m * region.column_spacing_m >= _MIN_FRONT_M2 else math.nan


def look_at(table: NDArray[np.float64], highlight: Nodes, shadow: Nodes) -> Spot:
    """Compare the brightest and the darkest box at a detection with the rest of the region."""
    _, bright_common = elsewhere(table, ((HIGHLIGHT, highlight),))
    repetition, dark_common = elsewhere(table, ((SHADOW, shadow),))
    rows, near, far = row_intervals(shadow, (table.shape[0], table.shape[1] - 1))
    inside, *beside = (_mean(table, rows + step, near, far) for step in (0, -len(rows), len(rows)))
    return Spot(min(bright_common, dark_common), repetition, max(inside, _DARKEST) / max(min(beside), _DARKEST))


def _mean(
    table: NDArray[np.float64], rows: NDArray[np.int64], near: NDArray[np.int64], far: NDArray[np.int64]
) -> float:
    """Average intervals in rows, over the window's mean; 1 where nothing was measured.

    Intervals beyond the window are left out.
    """
    inside = (rows >= 0) & (rows < table.shape[0])
    total, count = (table[rows[inside], far[inside]] - table[rows[inside], near[inside]]).sum(axis=0).tolist()
    return float(total / count) if count >= 1.0 else 1.0
