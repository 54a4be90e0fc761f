"""Measure one candidate: which pixels are its highlight and its shadow, where it is, how long, wide and high."""

from __future__ import annotations

import functools
import math
import statistics
from typing import Final, NamedTuple, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from auv_mcm.detect.prescreen import Floor, Peak
from auv_mcm.geometry.shadow import shadow_height_m
from auv_mcm.records import NAN, SATURATED, TURN, VALID, Tile
from auv_mcm.snippet import pack_snippet

ROWS_M: Final = 4.0  # m along the track on either side of the peak that are cut out
_NEAR_M: Final = 3.0  # m in front of the peak that are cut out
_FAR_M: Final = 8.0  # m behind the peak that are cut out: a longer shadow is cut off

_BRIGHT_STEP: Final = 0.7  # nats above the background, minimum (3 dB)
_DARK_STEP: Final = -1.0  # nats below it
_STEP_DEVIATIONS: Final = 2.0  # standard deviations of the background that highlight and shadow stand off by, minimum
_SNIPPET_M: Final = 2.5  # m on either side of the detection: the picture that is kept with a contact
_SEARCH_M: Final = 0.45  # m around the peak within which its highlight has to lie
_MAX_GAP_M: Final = 0.9  # between highlight and shadow: bright surroundings of scour lie there
_CENTRE_ROWS_M: Final = 0.3  # m along the track on either side of the middle, where the shadow is looked for
_BRIDGE_M: Final = 0.3  # speckle peaks inside a shadow
_LOW_OBJECT_M: Final = 0.1  # the shadows of such are the shortest that smoothing must leave
_LONGEST_BLUR_M: Final = 0.5  # m over which the shadow of a long object is smoothed, maximum
_DARK_CLIP: Final = 2.0  # of the background: a highlight must not be smoothed into the shadow behind it
_PROFILE_M: Final = 1.2  # of the shadow next to the object give its extent along track
_HALF_DEPTH: Final = 0.5  # of the shadow's depth, where its edge is taken: half power
_FOOTPRINTS_TO_SIGMA: Final = 1.0 / math.sqrt(8.0 * math.log(2.0))
_KEPT_OF_POINT: Final = 0.1  # share of its image that a point keeps when the footprint is taken off
# at half power, the Gaussian as wide as the mean of three
_THREE_ROWS: Final = math.sqrt(8.0 * math.log(2.0) * 2.0 / 3.0)
_HALVINGS: Final = 30

_Indices: TypeAlias = NDArray[np.intp]


class Measurement(NamedTuple):
    """Hold what was measured of one candidate.

    Rows and columns are fractional and tile-local; lengths in metres; decibels against the local background. row,
    column: highlight centroid, or where the shadow starts if there is no highlight. height_m and shadow_length_m are
    NaN without a shadow. along_m: extent along track; across_m: extent of the highlight across track.
    """

    row: float
    column: float
    along_m: float
    across_m: float
    shadow_length_m: float
    height_m: float
    highlight_db: float
    shadow_db: float
    has_highlight: bool
    has_shadow: bool
    touches_border: bool
    in_turn: bool
    saturated: bool
    snippet: NDArray[np.uint8]
    snippet_row: float
    snippet_column: float


class _Extent(NamedTuple):
    """Hold rows [first, stop) of a part of the region, and what they imply about its length."""

    first: int
    stop: int
    n_rows: float
    smoothed_rows: float  # width at half power of a Gaussian that smooths along track as measuring did
    level: float  # contrast at the edges as a share of that in the middle


class _Roi(NamedTuple):
    contrast: NDArray[np.float32]  # ln of the 3 x 3 mean over background, 0 where nothing valid
    darkness: NDArray[np.float32]  # the same of bounded intensity, over more pixels where beam and shadows are wide
    intensity: NDArray[np.float32]  # over background
    valid: NDArray[np.bool_]
    row: int  # of the peak
    column: int


def measure(tile: Tile, floor: Floor, peak: Peak, beam_width_rad: float) -> Measurement:
    """Segment the surroundings of `peak` and measure the object; deterministic, no error on any tile content.

    Parameters
    ----------
    floor
        The sea floor around the peak.
    beam_width_rad
        Two-way, at half power.
    """
    n_rows, n_columns = tile.mask.shape
    row_m, column_m = tile.row_spacing_m, tile.column_spacing_m
    reach_rows = round(ROWS_M / row_m)
    rows = slice(max(0, peak.row - reach_rows), min(n_rows, peak.row + reach_rows + 1))
    columns = slice(
        max(0, peak.column - round(_NEAR_M / column_m)), min(n_columns, peak.column + round(_FAR_M / column_m) + 1)
    )
    altitude_m = float(tile.first_return_m[peak.row])
    peak_footprint_m = math.hypot((peak.column + 0.5) * column_m, altitude_m) * beam_width_rad
    low_shadow_m = _LOW_OBJECT_M * (peak.column + 0.5) * column_m / max(altitude_m, _LOW_OBJECT_M)
    blur = (_blur_pixels(0.5 * low_shadow_m, column_m), _blur_pixels(0.5 * peak_footprint_m, row_m))
    roi = _region(tile, floor.background, peak, rows, columns, blur)
    spread = math.sqrt(floor.log_variance)
    bright_step = max(_BRIGHT_STEP, _STEP_DEVIATIONS * spread)
    bright = roi.contrast > bright_step
    dark = _bridged(
        (roi.darkness < min(_DARK_STEP, -_STEP_DEVIATIONS * spread)) & roi.valid, round(_BRIDGE_M / column_m)
    )

    highlight = _component_near(bright, roi.row, roi.column, round(_SEARCH_M / row_m), round(_SEARCH_M / column_m))
    echo = None if highlight is None else _places(highlight)
    anchor_row, anchor_column = (roi.row, roi.column) if echo is None else _strongest(roi, echo)
    shadow = _shadow_behind(dark, highlight, anchor_row, anchor_column, row_m, column_m)

    row, column, across_m = float(anchor_row), float(anchor_column), column_m
    extents: list[_Extent] = []
    highlight_db = NAN
    if echo is not None:
        row, column, extent, highlight_columns = _weighted_extent(roi, echo, bright_step)
        extents.append(extent)
        across_m = highlight_columns * column_m
        highlight_db = _decibels(roi, echo)
    shadow_length_m, height_m, shadow_db = NAN, NAN, NAN
    if shadow is not None:
        rows_in_shadow = np.flatnonzero(shadow.any(axis=1))
        start, stop = _shadow_interval(shadow, rows_in_shadow, round(row), round(_CENTRE_ROWS_M / row_m))
        if highlight is None:
            column = start - 0.5
        interval = round(start), round(stop)
        extents.append(_shadow_extent(roi, rows_in_shadow, round(row), interval, round(_PROFILE_M / column_m)))
        shadow_db = _decibels(roi, shadow)
        top = start if highlight is None else min(_far_edge(highlight, round(row)), start)
        top_m = (columns.start + top) * column_m
        far_m = (columns.start + stop) * column_m
        shadow_length_m = (stop - start) * column_m
        height_m = shadow_height_m(altitude_m, top_m, far_m)
    ground_m = (columns.start + column + 0.5) * column_m
    footprint_m = math.hypot(ground_m, altitude_m) * beam_width_rad
    along_m = max((_length(extent, row_m, footprint_m) for extent in extents), default=row_m)
    # At the end of a track the tile cuts an object off, which carries no information about its length.
    border = any(
        (extent.first == 0 and peak.row >= reach_rows)
        or (extent.stop == roi.valid.shape[0] and peak.row + reach_rows < n_rows)
        for extent in extents
    )
    cut = _snippet_cut(row, column, shadow_length_m, row_m, column_m)
    around = tile.mask[rows, columns][max(roi.row - 2, 0) : roi.row + 3, max(roi.column - 4, 0) : roi.column + 5]
    flags = int(np.bitwise_or.reduce(around, axis=None))
    return Measurement(
        row=rows.start + row + 0.5,
        column=columns.start + column + 0.5,
        along_m=along_m,
        across_m=across_m,
        shadow_length_m=shadow_length_m,
        height_m=height_m,
        highlight_db=highlight_db,
        shadow_db=shadow_db,
        has_highlight=highlight is not None,
        has_shadow=shadow is not None,
        touches_border=border,
        in_turn=bool(flags & TURN),
        saturated=bool(flags & SATURATED),
        snippet=pack_snippet(tile.intensity[rows, columns][cut]),
        snippet_row=row + 0.5 - cut[0].start,
        snippet_column=column + 0.5 - cut[1].start,
    )


def _snippet_cut(
    row: float, column: float, shadow_length_m: float, row_m: float, column_m: float
) -> tuple[slice, slice]:
    """Cut out the part of the region to keep as a picture: the object, its shadow and some of the sea floor around."""
    half_rows, near = round(_SNIPPET_M / row_m), round(_SNIPPET_M / column_m)
    behind = near + (0 if math.isnan(shadow_length_m) else round(shadow_length_m / column_m))
    middle, centre = round(row), round(column)
    return slice(max(0, middle - half_rows), middle + half_rows + 1), slice(max(0, centre - near), centre + behind + 1)


def _blur_pixels(length_m: float, pixel_m: float) -> int:
    """Choose an odd number of pixels over which to smooth what varies over `length_m` or more, 3 at the minimum."""
    return max(3, 2 * round(0.5 * (min(length_m, _LONGEST_BLUR_M) / pixel_m - 1.0)) + 1)


def _region(tile: Tile, level: float, peak: Peak, rows: slice, columns: slice, blur: tuple[int, int]) -> _Roi:
    valid = (tile.mask[rows, columns] & VALID) != 0
    intensity: NDArray[np.float32] = tile.intensity[rows, columns] / np.float32(level)
    np.copyto(intensity, np.float32(0.0), where=~valid)
    known = None if valid.all() else valid
    contrast = _log_mean(intensity, known, (3, 3))
    darkness = _log_mean(np.minimum(intensity, np.float32(_DARK_CLIP)), known, blur)
    return _Roi(contrast, darkness, intensity, valid, peak.row - rows.start, peak.column - columns.start)


def _log_mean(
    intensity: NDArray[np.float32], valid: NDArray[np.bool_] | None, size: tuple[int, int]
) -> NDArray[np.float32]:
    """Compute the logarithm of the mean over the valid pixels (None: all) of a box around each; 0 where few are."""
    shape = intensity.shape
    weight, few = _weights_of_all(None, shape, size) if valid is None else _weights(valid, shape, size)
    total = cv2.blur(intensity, size, borderType=cv2.BORDER_CONSTANT)
    total[few] = 1.0
    mean = np.divide(total, weight, out=total)
    np.clip(mean, 1e-3, 1e6, out=mean)
    return np.asarray(np.log(mean, out=mean))


def _weights(
    valid: NDArray[np.bool_] | None, shape: tuple[int, ...], size: tuple[int, int]
) -> tuple[NDArray[np.float32], tuple[_Indices, ...]]:
    """Give the share of the box around each pixel that is valid, and the pixels where few are, whose share is 1."""
    flags = np.ones(shape, dtype=np.float32) if valid is None else valid.astype(np.float32)
    weight = np.asarray(cv2.blur(flags, size, borderType=cv2.BORDER_CONSTANT), dtype=np.float32)
    few = _places(weight <= 0.3)
    weight[few] = 1.0
    return weight, few


def _places(mask: NDArray[np.bool_]) -> tuple[_Indices, _Indices]:
    """List rows and columns as np.nonzero does, in a sixth of the time where few pixels are set."""
    return np.divmod(np.flatnonzero(mask), mask.shape[1])


_weights_of_all = functools.lru_cache(maxsize=32)(_weights)


def _bridged(mask: NDArray[np.bool_], gap: int) -> NDArray[np.bool_]:
    """Fill holes of up to `gap` columns between pixels of the mask in the same row."""
    padded = np.zeros((mask.shape[0], mask.shape[1] + gap), dtype=np.uint8)
    padded[:, : mask.shape[1]] = mask
    kernel = np.ones((1, gap + 1), dtype=np.uint8)
    # Opposite anchors: with one in the middle a kernel of even length would shift the mask.
    closed = cv2.erode(cv2.dilate(padded, kernel, anchor=(gap, 0)), kernel, anchor=(0, 0))
    return np.ascontiguousarray(closed[:, : mask.shape[1]]).view(np.bool_)


def _component_near(
    mask: NDArray[np.bool_], row: int, column: int, half_rows: int, half_columns: int
) -> NDArray[np.bool_] | None:
    """Find the connected part of `mask` with most pixels near (row, column); ties go to the first label."""
    _, labels = cv2.connectedComponents(mask.view(np.uint8), connectivity=8)
    window = labels[
        max(row - half_rows, 0) : row + half_rows + 1, max(column - half_columns, 0) : column + half_columns + 1
    ]
    counts = np.bincount(window.ravel())
    if counts.shape[0] < 2:
        return None
    label = 1 + int(np.argmax(counts[1:]))
    return np.asarray(labels == label)


def _shadow_behind(
    dark: NDArray[np.bool_], highlight: NDArray[np.bool_] | None, row: int, column: int, row_m: float, column_m: float
) -> NDArray[np.bool_] | None:
    """Find the dark part close behind the highlight's far edge, cut off up-range of (row, column)."""
    far_edge = column if highlight is None else column + int(np.flatnonzero(highlight[row, column:])[-1])
    window = far_edge + round(_MAX_GAP_M / column_m) - column
    behind = dark.copy()
    behind[:, : max(column - 1, 0)] = False
    return _component_near(
        behind, row, column + window // 2, max(1, round(_CENTRE_ROWS_M / row_m)), max(1, (window + 1) // 2)
    )


def _strongest(roi: _Roi, part: tuple[_Indices, ...]) -> tuple[int, int]:
    """Find a part's pixel of highest contrast, less 0.05 nats for every pixel away from the peak; the first on ties."""
    rows, columns = part
    value = roi.contrast[rows, columns] - 0.05 * np.hypot(rows - roi.row, columns - roi.column)
    best = int(np.argmax(value))
    return int(rows[best]), int(columns[best])


def _weighted_extent(roi: _Roi, part: tuple[_Indices, ...], bright_step: float) -> tuple[float, float, _Extent, int]:
    """Compute the centre of a highlight in rows and columns, its extent in rows, and its width in columns."""
    rows, columns = part
    contrast = roi.contrast[rows, columns].astype(np.float64)
    # Weights bounded in dB terms: one glint must not pull the centre of a long object to itself.
    weight = np.maximum(contrast, 0.1)
    total = weight.sum()
    # The 3 x 3 mean just outside a wide object still holds a third of its echo: strong ones look a pixel larger on
    # every side.
    excess = math.exp(float(contrast.max())) - 1.0
    rim = 2 if math.log(excess / 3.0 + 1.0) > bright_step else 0
    first, stop = int(rows[0]), int(rows[-1]) + 1  # as np.nonzero lists them
    extent = _Extent(first, stop, max(stop - first - rim, 1), 0.0, (math.exp(bright_step) - 1.0) / excess)
    return float(rows @ weight / total), float(columns @ weight / total), extent, max(int(np.ptp(columns)) + 1 - rim, 1)


def _far_edge(part: NDArray[np.bool_], row: int) -> float:
    """Find one past the farthest column of a part in the row nearest to `row` that has any."""
    rows = np.flatnonzero(part.any(axis=1))
    nearest = rows[int(np.argmin(np.abs(rows - row)))]
    return float(part.shape[1] - part[nearest, ::-1].argmax())


def _shadow_extent(roi: _Roi, rows: _Indices, row: int, interval: tuple[int, int], reach: int) -> _Extent:
    """Find the rows around `row` that are half as dark as the darkest of them or darker; rows: of the shadow.

    Darkness is averaged over the columns next to the object. The mean over columns shows a shadow's sides where single
    pixels are speckle, which runs together into dark areas of any size.
    """
    columns = slice(interval[0], max(interval[0] + 1, min(interval[1], interval[0] + reach)))
    total = np.minimum(roi.intensity[:, columns], np.float32(_DARK_CLIP)).sum(axis=1, dtype=np.float64)
    count = roi.valid[:, columns].sum(axis=1)
    three = np.ones(3)
    depths = 1.0 - (np.convolve(total, three) / np.maximum(np.convolve(count, three), 1.0))[1:-1]
    depths[count == 0] = 0.0
    depth = depths.tolist()
    near = int(rows[np.argmin(np.abs(rows - row))])
    middle = max(range(max(near - 1, 0), min(near + 2, len(depth))), key=depth.__getitem__)
    edge = _HALF_DEPTH * max(depth[middle], 0.0)
    first, stop = middle, middle + 1
    while first > 0 and depth[first - 1] >= edge:
        first -= 1
    while stop < len(depth) and depth[stop] >= edge:
        stop += 1
    n_rows = stop - first - 1 + _beyond(depth, first, -1, edge) + _beyond(depth, stop - 1, 1, edge)
    return _Extent(first, stop, n_rows, _THREE_ROWS, _HALF_DEPTH)


def _beyond(depth: list[float], row: int, step: int, edge: float) -> float:
    """Interpolate how far beyond the centre of `row` the depth falls below `edge`, in rows.

    Half a row at the end of the picture.
    """
    if not 0 <= row + step < len(depth) or depth[row] <= edge:
        return 0.5
    return (depth[row] - edge) / (depth[row] - depth[row + step])


def _shadow_interval(shadow: NDArray[np.bool_], rows: _Indices, row: int, half_rows: int) -> tuple[float, float]:
    """Find first and one-past-last column of the shadow around the object's centre: medians over its rows."""
    near = rows[np.abs(rows - row) <= half_rows]
    if near.size == 0:
        near = rows[[int(np.argmin(np.abs(rows - row)))]]
    starts = shadow[near].argmax(axis=1)
    stops = shadow.shape[1] - shadow[near][:, ::-1].argmax(axis=1)
    return float(statistics.median(starts.tolist())), float(statistics.median(stops.tolist()))


def _decibels(roi: _Roi, part: NDArray[np.bool_] | tuple[_Indices, ...]) -> float:
    """Compute the mean intensity of a part over the background, dB, floored at -40."""
    mean = float(roi.intensity[part].mean(dtype=np.float64))
    return 10.0 * math.log10(max(mean, 1e-4))


def _length(extent: _Extent, row_m: float, footprint_m: float) -> float:
    return without_footprint(extent.n_rows * row_m, math.hypot(footprint_m, extent.smoothed_rows * row_m), extent.level)


def without_footprint(extent_m: float, footprint_m: float, level: float) -> float:
    """Compute the length along track, m, of an even object whose image through the beam is `extent_m` long at `level`.

    The image of an object of length L at x from its middle is erf((x + L/2) / (s sqrt 2)) - erf((x - L/2) / (s sqrt 2))
    with s = footprint / sqrt(8 ln 2), and L is found by halving, the image itself at the maximum. A point, whose image
    is footprint sqrt(log2(1 / level)) long, and anything shorter keeps a tenth of its image.

    Parameters
    ----------
    footprint_m
        The two-way beam at half power, taken as Gaussian.
    level
        0 < level < 1, contrast at the edges of the image over contrast in its middle, both against the background; so
        it holds for highlights (intensity less background) and shadows (background less intensity).
    """
    min_m = _KEPT_OF_POINT * extent_m
    per_m = 1.0 / max(math.sqrt(2.0) * _FOOTPRINTS_TO_SIGMA * footprint_m, 1e-9)
    half_m = 0.5 * extent_m

    def faded(length_m: float) -> float:
        inner, outer = (half_m - 0.5 * length_m) * per_m, (half_m + 0.5 * length_m) * per_m
        return (math.erf(outer) - math.erf(inner)) / (2.0 * math.erf(0.5 * length_m * per_m))

    shortest, longest = min_m, extent_m
    if faded(shortest) >= level:
        return min_m
    for _ in range(_HALVINGS):
        middle = 0.5 * (shortest + longest)
        shortest, longest = (middle, longest) if faded(middle) < level else (shortest, middle)
    return 0.5 * (shortest + longest)
