"""Measures one candidate: which pixels are its highlight and its shadow, where it is, how long, wide and high."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from auv_mcm.detect.prescreen import Peak, ScoreMaps
from auv_mcm.records import NAN, SATURATED, TURN, VALID, Tile
from auv_mcm.snippet import pack_snippet

ROWS_M: Final = 4.0
_NEAR_M: Final = 3.0
_FAR_M: Final = 8.0

_BRIGHT_STEP: Final = 0.7  # nats above the background at least (3 dB)
_DARK_STEP: Final = -1.0  # nats below it
_STEP_DEVIATIONS: Final = 2.0
_SNIPPET_M: Final = 2.5
_SEARCH_M: Final = 0.45
_MAX_GAP_M: Final = 0.9  # between highlight and shadow: bright surroundings of scour lie there
_CENTRE_ROWS_M: Final = 0.3
_BRIDGE_M: Final = 0.3  # speckle peaks inside a shadow
_FULL_ROW: Final = 0.3


class Measurement(NamedTuple):
    """All rows and columns are fractional, tile-local; lengths in metres; decibels against the local background.

    row, column: highlight centroid, or where the shadow starts if there is no highlight. height_m and shadow_length_m are NaN
    without a shadow. along_m: extent along track; across_m: extent of the highlight across track.
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


class _Roi(NamedTuple):
    contrast: NDArray[np.float32]  # ln of the 3 x 3 mean over background, 0 where nothing valid
    intensity: NDArray[np.float32]  # over background
    valid: NDArray[np.bool_]
    row: int  # of the peak
    column: int


def measure(tile: Tile, maps: ScoreMaps, peak: Peak, beam_width_rad: float) -> Measurement:
    """Segment the surroundings of `peak` and measure the object; deterministic, no error on any tile content."""
    n_rows, n_columns = tile.mask.shape
    row_m, column_m = tile.row_spacing_m, tile.column_spacing_m
    reach_rows = round(ROWS_M / row_m)
    rows = slice(max(0, peak.row - reach_rows), min(n_rows, peak.row + reach_rows + 1))
    columns = slice(max(0, peak.column - round(_NEAR_M / column_m)), min(n_columns, peak.column + round(_FAR_M / column_m) + 1))
    roi = _region(tile, maps, peak, rows, columns)
    spread = math.sqrt(float(maps.small_box_variance[peak.row, peak.column]))
    bright_step = max(_BRIGHT_STEP, _STEP_DEVIATIONS * spread)
    bright = roi.contrast > bright_step
    dark = _bridged((roi.contrast < min(_DARK_STEP, -_STEP_DEVIATIONS * spread)) & roi.valid, round(_BRIDGE_M / column_m))

    highlight = _component_near(bright, roi.row, roi.column, round(_SEARCH_M / row_m), round(_SEARCH_M / column_m))
    anchor_row, anchor_column = (roi.row, roi.column) if highlight is None else _strongest(roi, highlight)
    shadow = _shadow_behind(dark, highlight, anchor_row, anchor_column, row_m, column_m)

    row, column, across_m, highlight_rows = float(anchor_row), float(anchor_column), column_m, 0
    highlight_db = NAN
    if highlight is not None:
        row, column, highlight_rows, highlight_columns = _weighted_extent(roi, highlight, bright_step)
        across_m = highlight_columns * column_m
        highlight_db = _decibels(roi, highlight)
    shadow_length_m, height_m, shadow_db, shadow_rows = NAN, NAN, NAN, 0
    if shadow is not None:
        start, stop = _shadow_interval(shadow, round(row), round(_CENTRE_ROWS_M / row_m))
        if highlight is None:
            column = start - 0.5
        shadow_rows = _full_rows(shadow)
        shadow_db = _decibels(roi, shadow)
        top = start if highlight is None else min(_far_edge(highlight, round(row)), start)
        top_m = (columns.start + top) * column_m
        far_m = (columns.start + stop) * column_m
        shadow_length_m = (stop - start) * column_m
        altitude_m = float(tile.first_return_m[peak.row])
        # The ray that grazes the last lit point goes on to the shadow's end: heights are to ranges as the triangle says.
        height_m = altitude_m * (1.0 - math.hypot(top_m, altitude_m) / math.hypot(far_m, altitude_m))
    ground_m = (columns.start + column + 0.5) * column_m
    footprint_m = math.hypot(ground_m, float(tile.first_return_m[peak.row])) * beam_width_rad
    along_m = _without_footprint(max(highlight_rows, shadow_rows, 1) * row_m, footprint_m)
    # At the end of a track the tile cuts an object off, which says nothing about its length.
    edges = [edge for edge, cut in ((0, peak.row - reach_rows < 0), (-1, peak.row + reach_rows >= n_rows)) if not cut]
    border = any(part is not None and part[edge].any() for part in (highlight, shadow) for edge in edges)
    cut = _snippet_cut(row, column, shadow_length_m, row_m, column_m)
    around = tile.mask[rows, columns][max(roi.row - 2, 0) : roi.row + 3, max(roi.column - 4, 0) : roi.column + 5]
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
        in_turn=bool((around & TURN).any()),
        saturated=bool((around & SATURATED).any()),
        snippet=pack_snippet(tile.intensity[rows, columns][cut]),
        snippet_row=row + 0.5 - cut[0].start,
        snippet_column=column + 0.5 - cut[1].start,
    )


def _snippet_cut(row: float, column: float, shadow_length_m: float, row_m: float, column_m: float) -> tuple[slice, slice]:
    """The part of the region worth keeping as a picture: the object, its shadow and some of the sea floor around."""
    half_rows, near = round(_SNIPPET_M / row_m), round(_SNIPPET_M / column_m)
    behind = near + (0 if math.isnan(shadow_length_m) else round(shadow_length_m / column_m))
    middle, centre = round(row), round(column)
    return slice(max(0, middle - half_rows), middle + half_rows + 1), slice(max(0, centre - near), centre + behind + 1)


def _region(tile: Tile, maps: ScoreMaps, peak: Peak, rows: slice, columns: slice) -> _Roi:
    valid = (tile.mask[rows, columns] & VALID) != 0
    background = np.float32(maps.background[peak.row, peak.column])
    intensity = np.where(valid, tile.intensity[rows, columns] / background, np.float32(0.0)).astype(np.float32)
    border = cv2.BORDER_CONSTANT
    total = cv2.blur(intensity, (3, 3), borderType=border)
    weight = cv2.blur(valid.astype(np.float32), (3, 3), borderType=border)
    mean = np.divide(total, weight, out=np.ones_like(total), where=weight > 0.3)
    contrast = np.log(np.clip(mean, 1e-3, 1e3))
    return _Roi(contrast, intensity, valid, peak.row - rows.start, peak.column - columns.start)


def _bridged(mask: NDArray[np.bool_], gap: int) -> NDArray[np.bool_]:
    """The mask with holes of up to `gap` columns between its pixels of a row filled."""
    padded = np.pad(mask.view(np.uint8), ((0, 0), (0, gap)))
    kernel = np.ones((1, gap + 1), dtype=np.uint8)
    # Opposite anchors: with one in the middle a kernel of even length would shift the mask.
    closed = cv2.erode(cv2.dilate(padded, kernel, anchor=(gap, 0)), kernel, anchor=(0, 0))
    return np.asarray(closed[:, : mask.shape[1]].astype(np.bool_))


def _component_near(mask: NDArray[np.bool_], row: int, column: int, half_rows: int, half_columns: int) -> NDArray[np.bool_] | None:
    """The connected part of `mask` that has most pixels in the window around (row, column); ties go to the first label."""
    _, labels = cv2.connectedComponents(mask.view(np.uint8), connectivity=8)
    window = labels[max(row - half_rows, 0) : row + half_rows + 1, max(column - half_columns, 0) : column + half_columns + 1]
    counts = np.bincount(window.ravel())
    if counts.shape[0] < 2:
        return None
    label = 1 + int(np.argmax(counts[1:]))
    return np.asarray(labels == label)


def _shadow_behind(
    dark: NDArray[np.bool_], highlight: NDArray[np.bool_] | None, row: int, column: int, row_m: float, column_m: float
) -> NDArray[np.bool_] | None:
    """The dark part that starts close behind the highlight's far edge, cut off where it lies up-range of (row, column)."""
    far_edge = column if highlight is None else column + int(np.flatnonzero(highlight[row, column:])[-1])
    window = far_edge + round(_MAX_GAP_M / column_m) - column
    behind = dark.copy()
    behind[:, : max(column - 1, 0)] = False
    return _component_near(behind, row, column + window // 2, max(1, round(_CENTRE_ROWS_M / row_m)), max(1, (window + 1) // 2))


def _strongest(roi: _Roi, part: NDArray[np.bool_]) -> tuple[int, int]:
    """The pixel of a part where contrast is highest, less 0.05 nats for every pixel away from the peak; the first on ties."""
    distance = np.hypot((np.arange(part.shape[0]) - roi.row)[:, None], (np.arange(part.shape[1]) - roi.column)[None, :])
    value = np.where(part, roi.contrast - 0.05 * distance, -np.inf)
    row, column = np.unravel_index(int(np.argmax(value)), part.shape)
    return int(row), int(column)


def _weighted_extent(roi: _Roi, part: NDArray[np.bool_], bright_step: float) -> tuple[float, float, int, int]:
    """Centre of a highlight in rows and columns, and its extent in them."""
    rows, columns = np.nonzero(part)
    contrast = roi.contrast[rows, columns].astype(np.float64)
    # Weights bounded in dB terms: one glint must not pull the centre of a long object to itself.
    weight = np.maximum(contrast, 0.1)
    total = weight.sum()
    # The 3 x 3 mean just outside a wide object still holds a third of its echo: strong ones look a pixel larger on every side.
    seam = 2 if math.log((math.exp(float(contrast.max())) - 1.0) / 3.0 + 1.0) > bright_step else 0
    n_rows, n_columns = max(int(np.ptp(rows)) + 1 - seam, 1), max(int(np.ptp(columns)) + 1 - seam, 1)
    return float(rows @ weight / total), float(columns @ weight / total), n_rows, n_columns


def _far_edge(part: NDArray[np.bool_], row: int) -> float:
    """One past the farthest column of a part in the row nearest to `row` that has any."""
    rows = np.flatnonzero(part.any(axis=1))
    nearest = rows[int(np.argmin(np.abs(rows - row)))]
    return float(part.shape[1] - part[nearest, ::-1].argmax())


def _full_rows(shadow: NDArray[np.bool_]) -> int:
    """Extent in rows of a shadow's body: rows that only hold a dark speckle or two at its side do not count."""
    count = shadow.sum(axis=1)
    return int(np.ptp(np.flatnonzero(count > _FULL_ROW * count.max()))) + 1


def _shadow_interval(shadow: NDArray[np.bool_], row: int, half_rows: int) -> tuple[float, float]:
    """First and one-past-last column of the shadow in the rows around the object's centre: medians over rows."""
    rows = np.flatnonzero(shadow.any(axis=1))
    near = rows[np.abs(rows - row) <= half_rows]
    if near.size == 0:
        near = rows[[int(np.argmin(np.abs(rows - row)))]]
    starts = shadow[near].argmax(axis=1)
    stops = shadow.shape[1] - shadow[near][:, ::-1].argmax(axis=1)
    return float(np.median(starts)), float(np.median(stops))


def _decibels(roi: _Roi, part: NDArray[np.bool_]) -> float:
    """Mean intensity of a part over the background, dB, floored at -40."""
    mean = float(roi.intensity[part].mean(dtype=np.float64))
    return 10.0 * math.log10(max(mean, 1e-4))


def _without_footprint(extent_m: float, footprint_m: float) -> float:
    """Length of an object whose image is smeared by the along-track beam; a point keeps a tenth of its image."""
    return math.sqrt(max(extent_m**2 - footprint_m**2, (0.1 * extent_m) ** 2))
