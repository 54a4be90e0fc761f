"""Score every pixel of a tile as the centre of a highlight with a shadow behind, by box means.

The sea floor sets its own scale. The variance of the logarithm of box means is measured around each pixel at two box
sizes, as equivalent looks: it holds speckle, its correlation from pixel to pixel, and texture, and how it falls from
the small to the large box says how many independent samples other boxes have. Ratios of box means to the background
then become standard deviations in closed form. Highlights and shadows of several sizes are tried, shadows in multiples
of what an object of given height casts at that range and altitude.
"""

from __future__ import annotations

import copy
from statistics import NormalDist
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from auv_mcm.detect.ftest import equivalent_looks, f_deviate
from auv_mcm.detect.integral import PaddedIntegral
from auv_mcm.records import LOW_RESOLUTION, SATURATED, VALID, Tile

# Along track, across track, metres.
HIGHLIGHTS_M: Final = ((0.12, 0.18), (0.36, 0.24), (0.36, 0.48), (0.84, 0.36), (1.6, 0.36))
# Along track and height of the object that casts it, metres.
SHADOWS_M: Final = ((0.12, 0.1), (0.12, 0.2), (0.36, 0.1), (0.36, 0.2), (0.36, 0.35), (0.84, 0.35), (0.84, 0.7))
SHADOW_LENGTH_M: Final = (0.18, 6.0)
MIN_ALTITUDE_M: Final = 0.05
SHADOW_LAG_M: Final = 0.6  # from the highlight's centre to where the shadow starts, maximum

# Background: a frame around the object, narrow enough to follow the sea floor, hollow so that the object stays out of
# it.
FRAME_ROWS_M: Final = 1.5
_FRAME_NEAR_M: Final = 1.0
_FRAME_FAR_M: Final = 2.0
_HOLLOW_ROWS_M: Final = 0.6
_HOLLOW_NEAR_M: Final = 0.4
_HOLLOW_FAR_M: Final = 1.2
BACKGROUND_CLIP: Final = 6.0  # times the local mean: one speckle in 400 is brighter
MIN_BACKGROUND: Final = 0.3
NO_ECHO: Final = np.float32(1e-6)
"""Background where nothing around echoes, and the least that there is."""
MIN_SHADOW: Final = 0.6  # share of a shadow box that has to be measured

LOOKS_ROWS_M: Final = 5.0  # m along the track over which the looks of the sea floor are estimated
LOOKS_COLUMNS_M: Final = 4.0  # m across the track, the same
SMALL_BOX_M: Final = (0.36, 0.24)  # m along and across: the highlight of a small mine
THIN_BOX_M: Final = (0.12, 0.24)  # m: the highlight of one seen end on
LARGE_BOX_M: Final = (0.84, 0.84)  # m: that of the largest mine sought, broadside
LOG_CLIP: Final = 1.2  # bright objects and shadows must not pass for texture
MIN_DECAY: Final = 0.3  # less is measured where a structure, not texture, spans the large boxes
MIN_LOG_VARIANCE: Final = 1e-3  # nats²: a thousand looks; keeps deviates finite where nothing scatters

# A shadow is the better witness: speckle, glints and texture make bright spots, hardly anything else makes dark ones.
# But they seldom make brighter ones than this, and from there on a highlight counts like a shadow: far off it often is
# all that can be seen.
HIGHLIGHT_WEIGHT: Final = 0.5
PAIR_NORM: Final = float(np.hypot(HIGHLIGHT_WEIGHT, 1.0))
CLEAR_HIGHLIGHT: Final = 4.0
# Beyond these deviates more contrast says little more; the small slope left keeps the order of strong echoes.
_HIGHLIGHT_KNEE: Final = 6.0
_SHADOW_KNEE: Final = 6.0
_LOWEST_DEVIATE: Final = -2.0
# An echo may be so strong that it counts without a shadow: over soft mud, or with the shadow filled by multipath.
GLINT_DISCOUNT: Final = 4.0
_GLINT_KNEE: Final = 5.0
_BEYOND_KNEE: Final = 0.05
MAX_RATIO: Final = 100.0
_BAND_ROWS: Final = 48

MARGIN_M: Final = 1.0
"""How far beyond a tile's core pixels are scored, so that a peak in the core is compared with all its neighbours."""
CONTEXT_M: Final = LOOKS_ROWS_M + FRAME_ROWS_M + 1.0
"""Along-track reach of a score: a pixel this far inside a tile is scored as it would be anywhere else."""


class ScoreMaps(NamedTuple):
    """Hold what is known per pixel, each (n_rows, n_columns) float32.

    score: of the best pair of boxes, in standard deviations that one pair has on pure sea floor; -inf where it
    cannot be computed. highlight, shadow: deviates, a shadow counts positive. background: mean intensity.
    small_box_variance: of ln I.
    """

    score: NDArray[np.float32]
    highlight: NDArray[np.float32]
    shadow: NDArray[np.float32]
    background: NDArray[np.float32]
    small_box_variance: NDArray[np.float32]

    def floor(self, row: int, column: int) -> Floor:
        return Floor(float(self.background[row, column]), float(self.small_box_variance[row, column]))


class Floor(NamedTuple):
    """Hold the sea floor around one pixel: mean intensity, and variance of the logarithm of small box means."""

    background: float
    log_variance: float


class Peak(NamedTuple):
    """Hold a local maximum of the score: tile-local row and column, and the score there."""

    score: float
    row: int
    column: int


class PixelGrid(NamedTuple):
    """Convert lengths to whole pixels of a tile, 1 at the minimum, and boxes to half-open offsets from a pixel."""

    row_m: float
    column_m: float

    def rows(self, length_m: float) -> int:
        return max(1, round(length_m / self.row_m))

    def columns(self, length_m: float) -> int:
        """Convert a length across the track, m, to whole columns, 1 at the minimum."""
        return max(1, round(length_m / self.column_m))

    def centred(self, size_m: tuple[float, float]) -> tuple[tuple[int, int, int, int], int]:
        """Return the half-open offsets of a box around a pixel, and its area in pixels."""
        half_row, half_column = self.rows(size_m[0]) // 2, self.columns(size_m[1]) // 2
        return (-half_row, half_row + 1, -half_column, half_column + 1), (2 * half_row + 1) * (2 * half_column + 1)

    def frame(self) -> tuple[tuple[int, int, int, int], tuple[int, int, int, int], int]:
        """Return the background's frame and its hollow as half-open offsets, and the area between them in pixels."""
        hollow_rows = self.rows(_HOLLOW_ROWS_M)
        hollow = (-hollow_rows, hollow_rows + 1, -self.columns(_HOLLOW_NEAR_M), self.columns(_HOLLOW_FAR_M))
        # On a coarse grid the frame stays at least a pixel wide.
        rows = max(self.rows(FRAME_ROWS_M), hollow_rows + 1)
        outer = (
            -rows,
            rows + 1,
            min(-self.columns(_FRAME_NEAR_M), hollow[2] - 1),
            max(self.columns(_FRAME_FAR_M), hollow[3] + 1),
        )
        area = (outer[1] - outer[0]) * (outer[3] - outer[2]) - (hollow[1] - hollow[0]) * (hollow[3] - hollow[2])
        return outer, hollow, area


class _Boxes:
    """Average boxes of valid pixels on some rows of a tile, in whole pixels around each pixel."""

    def __init__(self, tile: Tile) -> None:
        valid = (tile.mask & VALID) != 0
        self.grid = grid = PixelGrid(tile.row_spacing_m, tile.column_spacing_m)
        intensity = np.where(valid, np.minimum(tile.intensity, np.float32(MAX_RATIO)), np.float32(0.0))
        pad = (grid.rows(FRAME_ROWS_M) + 2, grid.columns(SHADOW_LENGTH_M[1]) + 4)
        self._intensity = PaddedIntegral(intensity, *pad)
        self._weight = PaddedIntegral(valid.view(np.uint8), *pad)
        seabed = valid & ((tile.mask & SATURATED) == 0)
        bounded = np.where(seabed, np.minimum(intensity, np.float32(BACKGROUND_CLIP)), np.float32(0.0))
        self._seabed = PaddedIntegral(bounded, *pad)
        self._seabed_weight = self._weight if (seabed == valid).all() else PaddedIntegral(seabed.view(np.uint8), *pad)

    def band(self, rows: slice) -> _Boxes:
        """Restrict the boxes to rows [start, stop) of the tile."""
        part = copy.copy(self)
        part._intensity = self._intensity.band(rows.start, rows.stop)
        part._weight = self._weight.band(rows.start, rows.stop)
        part._seabed = self._seabed.band(rows.start, rows.stop)
        part._seabed_weight = self._seabed_weight.band(rows.start, rows.stop)
        return part

    def mean(self, *box: int) -> NDArray[np.float32]:
        """Average the intensity over the valid pixels of a box, 0 where there are none."""
        return (self._intensity.box(*box) / np.maximum(self._weight.box(*box), 1.0)).astype(np.float32)

    def shadow_mean(self, half_rows: int, lengths: NDArray[np.intp]) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
        """Average the intensity from each pixel on over `lengths` columns.

        Returns the mean and the number of valid pixels.
        """
        varying = (-half_rows, half_rows + 1, 0, lengths)
        weight = self._weight.box_varying(*varying)
        return (self._intensity.box_varying(*varying) / np.maximum(weight, 1.0)).astype(np.float32), weight

    def background(self) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """Average the frame around each pixel; return the mean, and where enough of the frame holds echoes.

        Saturated pixels stay out and bright ones are bounded: an object longer than the hollow must not raise its own
        background.
        """
        outer, hollow, area = self.grid.frame()
        total = self._seabed.box(*outer) - self._seabed.box(*hollow)
        weight = self._seabed_weight.box(*outer) - self._seabed_weight.box(*hollow)
        mean = np.maximum(np.maximum(total, 0.0) / np.maximum(weight, 1.0), NO_ECHO).astype(np.float32)
        # Without any echo around, as in a stretch of dropped samples, there is no contrast to speak of.
        return mean, (weight >= MIN_BACKGROUND * area) & (mean > NO_ECHO)


class Spread(NamedTuple):
    """Hold how much box means vary on the sea floor around each pixel of a band, float32.

    Variances of the logarithm for the thin and the small box, and the power of area with which larger boxes vary less.
    """

    thin: NDArray[np.float32]
    small: NDArray[np.float32]
    decay: NDArray[np.float32]
    thin_area: int
    small_area: int

    def looks(self, n_rows: int, area: NDArray[np.float32] | float) -> NDArray[np.float32]:
        """Compute the equivalent looks of the mean over a box.

        What is smaller than the boxes measured holds speckle alone, which falls with area.
        """
        variance, measured_area = (self.thin, self.thin_area) if n_rows == 1 else (self.small, self.small_area)
        growth = np.log(np.asarray(area, dtype=np.float32) / np.float32(measured_area))
        return equivalent_looks(variance * np.exp(-np.where(growth < 0.0, np.float32(1.0), self.decay) * growth))


def score_tile(tile: Tile) -> ScoreMaps:
    """Score every pixel of one tile.

    Overlap rows more than MARGIN_M from the core lend their pixels but are not scored themselves.
    """
    shape = tile.mask.shape
    margin = round(MARGIN_M / tile.row_spacing_m) + 1
    scored = slice(max(tile.core_start - margin, 0), min(tile.core_stop + margin, shape[0]))
    boxes = _Boxes(tile)
    grid = boxes.grid
    # A few dozen rows at a time, so that intermediate planes stay in the processor's cache.
    bands = [slice(start, min(start + _BAND_ROWS, shape[0])) for start in range(0, shape[0], _BAND_ROWS)]
    background, known = np.empty(shape, dtype=np.float32), np.empty(shape, dtype=np.bool_)
    for rows in bands:
        background[rows], enough = boxes.band(rows).background()
        known[rows] = enough & ((tile.mask[rows] & VALID) != 0)

    measured = [grid.centred(size_m) for size_m in (THIN_BOX_M, SMALL_BOX_M, LARGE_BOX_M)]
    around = _Neighbourhood(boxes, known)
    thin, small, large = (around.log_variance(boxes, bands, box, background) for box, _ in measured)
    (_, thin_area), (_, small_area), (_, large_area) = measured

    highlight, darkest = np.full(shape, -np.inf, dtype=np.float32), np.zeros(shape, dtype=np.float32)
    for rows in [
        slice(start, min(start + _BAND_ROWS, scored.stop)) for start in range(scored.start, scored.stop, _BAND_ROWS)
    ]:
        decay = decay_of(small[rows], large[rows], large_area / small_area)
        spread = Spread(thin[rows], small[rows], decay, thin_area, small_area)
        highlight[rows], darkest[rows] = _deviates(boxes.band(rows), tile, rows, background[rows], spread)
    shadow = -darkest_behind(darkest, grid.columns(SHADOW_LAG_M))

    score = combined(highlight, shadow)
    score[~known] = -np.inf
    score[: scored.start] = score[scored.stop :] = -np.inf
    return ScoreMaps(score, highlight, shadow, background, small)


def decay_of(small: NDArray[np.float32], large: NDArray[np.float32], area_ratio: float) -> NDArray[np.float32]:
    """Compute the power of area with which variances fall from the small to the large box.

    area_ratio: of the large box over the small one.
    """
    # On a grid too coarse to separate the two boxes both variances are equal, and any growth of area will do.
    per_area = np.float32(1.0 / np.log(max(area_ratio, 2.0)))
    return np.asarray(np.clip(np.log(small / large) * per_area, MIN_DECAY, 1.0), dtype=np.float32)


def combined(highlight: NDArray[np.float32], shadow: NDArray[np.float32]) -> NDArray[np.float32]:
    """Combine a highlight's and a shadow's deviates into a score, float32 of any shape."""
    pair = (worth(highlight) + saturate_shadow(shadow)) * np.float32(1.0 / PAIR_NORM)
    return np.asarray(np.maximum(pair, glint(highlight)))


def worth(highlight: NDArray[np.float32]) -> NDArray[np.float32]:
    """Compute what a highlight's deviate adds to a pair."""
    bright = saturate(highlight, _HIGHLIGHT_KNEE)
    clear = np.maximum(bright - np.float32(CLEAR_HIGHLIGHT), np.float32(0.0))
    return np.asarray(HIGHLIGHT_WEIGHT * bright + (1.0 - HIGHLIGHT_WEIGHT) * clear)


def saturate_shadow(shadow: NDArray[np.float32]) -> NDArray[np.float32]:
    """Compute what a shadow's deviate adds to a pair."""
    return saturate(shadow, _SHADOW_KNEE)


def glint(highlight: NDArray[np.float32]) -> NDArray[np.float32]:
    """Score a highlight without a shadow."""
    return saturate(highlight - np.float32(GLINT_DISCOUNT), _GLINT_KNEE)


def _deviates(
    boxes: _Boxes, tile: Tile, rows: slice, background: NDArray[np.float32], spread: Spread
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Compute the deviates of the brightest box centred on each pixel, and of the darkest shadow that starts there."""
    per_background = np.float32(1.0) / background
    background_looks = spread.looks(2, float(boxes.grid.frame()[2]))
    highlight = np.full(background.shape, -np.inf, dtype=np.float32)
    for size_m in HIGHLIGHTS_M:
        box, area = boxes.grid.centred(size_m)
        looks = spread.looks(box[1] - box[0], float(area))
        np.maximum(highlight, f_deviate(boxes.mean(*box) * per_background, looks, background_looks), out=highlight)
    darkest = np.full(background.shape, np.inf, dtype=np.float32)
    for along_m, height_m in SHADOWS_M:
        lengths = _shadow_columns(tile, rows, height_m)
        half_rows = boxes.grid.rows(along_m) // 2
        mean, weight = boxes.shadow_mean(half_rows, lengths)
        n_rows = 2 * half_rows + 1
        area_px = (n_rows * lengths).astype(np.float32)
        deviate = f_deviate(mean * per_background, spread.looks(n_rows, area_px), background_looks)
        np.minimum(darkest, np.where(weight > MIN_SHADOW * area_px, deviate, np.float32(0.0)), out=darkest)
    return highlight, darkest


def find_peaks(tile: Tile, maps: ScoreMaps, p_false_alarm: float, radius_m: float) -> list[Peak]:
    """Find local maxima above the threshold in the tile's core, best first; ties by row, then column.

    A peak is the highest score within `radius_m`, at most MARGIN_M, along rows and columns. Pixels of low resolution
    (near nadir) hold none and outshine none.
    """
    threshold = np.float32(-NormalDist().inv_cdf(p_false_alarm))
    half_row, half_column = (
        max(1, round(radius_m / tile.row_spacing_m)),
        max(1, round(radius_m / tile.column_spacing_m)),
    )
    coarse = (tile.mask & LOW_RESOLUTION) != 0
    finite = np.where(coarse, np.float32(-1e6), np.maximum(maps.score, np.float32(-1e6)))
    highest = cv2.dilate(finite, np.ones((2 * half_row + 1, 2 * half_column + 1), dtype=np.uint8))
    peak = (finite == highest) & (finite >= threshold)
    peak[: tile.core_start] = False
    peak[tile.core_stop :] = False
    rows, columns = np.nonzero(peak)
    found = [Peak(float(finite[row, column]), int(row), int(column)) for row, column in zip(rows, columns, strict=True)]
    return sorted(found, key=lambda p: (-p.score, p.row, p.column))


def saturate(deviate: NDArray[np.float32], knee: float) -> NDArray[np.float32]:
    """Bound deviates: linear up to the knee, less steep above."""
    bounded = np.maximum(deviate, np.float32(_LOWEST_DEVIATE))
    return np.asarray(np.minimum(bounded, np.float32(knee) + np.float32(_BEYOND_KNEE) * (bounded - np.float32(knee))))


class _Neighbourhood:
    """Compute statistics over the known pixels within a few metres of each pixel."""

    def __init__(self, boxes: _Boxes, known: NDArray[np.bool_]) -> None:
        rows, columns = boxes.grid.rows(LOOKS_ROWS_M), boxes.grid.columns(LOOKS_COLUMNS_M)
        self._box = (-rows, rows + 1, -columns, columns + 1)
        self._pad = (rows + 1, columns + 1)
        self._known = known
        self._count = PaddedIntegral(known.view(np.uint8), *self._pad)

    def log_variance(
        self, boxes: _Boxes, bands: list[slice], box: tuple[int, int, int, int], background: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """Compute the variance of ln(box mean over background), clipped, (n_rows, n_columns) float32."""
        logarithm = np.empty(background.shape, dtype=np.float32)
        for rows in bands:
            ratio = np.maximum(boxes.band(rows).mean(*box) / background[rows], np.float32(1e-3))
            logarithm[rows] = np.clip(np.log(ratio), -LOG_CLIP, LOG_CLIP) * self._known[rows]
        total, square = PaddedIntegral(logarithm, *self._pad), PaddedIntegral(logarithm * logarithm, *self._pad)
        variance = np.empty(background.shape, dtype=np.float32)
        for rows in bands:
            count, mean, mean_square = (
                sums.band(rows.start, rows.stop).box(*self._box) for sums in (self._count, total, square)
            )
            np.maximum(count, 1.0, out=count)
            mean /= count
            variance[rows] = np.maximum(mean_square / count - mean * mean, MIN_LOG_VARIANCE)
        return variance


def clearance_m(tile: Tile, height_m: float) -> NDArray[np.float64]:
    """Compute the altitude over the top of an object of `height_m` in each row, m.

    (n_rows,) float64, bounded from below.
    """
    altitude_m = np.maximum(tile.first_return_m, MIN_ALTITUDE_M)
    return np.maximum(altitude_m - height_m, 0.3 * altitude_m)


def _shadow_columns(tile: Tile, rows: slice, height_m: float) -> NDArray[np.intp]:
    """Compute the shadow's length in columns, (rows, n_columns), of an object of `height_m`.

    It is h y / (H - h) on a flat bottom.
    """
    ground_m = ((np.arange(tile.mask.shape[1]) + 0.5) * tile.column_spacing_m)[None, :]
    length_m = height_m * ground_m / clearance_m(tile, height_m)[rows, None]
    return np.maximum(np.rint(np.clip(length_m, *SHADOW_LENGTH_M) / tile.column_spacing_m), 1.0).astype(np.intp)


def darkest_behind(deviate: NDArray[np.float32], lag_columns: int) -> NDArray[np.float32]:
    """Find the minimum over shadows that start 1 to `lag_columns` columns farther out.

    In the row itself or a neighbouring one.
    """
    n_columns = deviate.shape[1]
    padded = np.pad(deviate, ((1, 1), (0, lag_columns + 1)), constant_values=0.0)
    lowest = cv2.erode(
        padded, np.ones((3, lag_columns), dtype=np.uint8), anchor=(0, 1), borderType=cv2.BORDER_REPLICATE
    )
    return np.asarray(lowest[1:-1, 1 : 1 + n_columns])
