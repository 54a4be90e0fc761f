"""Score contrasts as prescreen defines them where they matter: at peaks and around given places.

Hardly any pixel's score reaches the threshold, so cheap bounds come first. In blocks of pixels the variances have
extremes, and a box there reaches a given deviate only if its mean passes a bound in closed form; one comparison of box
sums finds the boxes that do. First come the boxes that may be bright: elsewhere a highlight is worth no more than a
faint one. The best highlight of those whose shadow may be at a place bounds from below how dark that shadow must be.
Only boxes beyond the bounds are scored, by the functions of prescreen.

Bounds are taken SLACK of a deviate wide. Rounding moves no deviate by more than 3e-3 up to 1e7 looks, far more than
variances of MIN_LOG_VARIANCE can stand for.
"""

from __future__ import annotations

from collections.abc import Sequence
from statistics import NormalDist
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from auv_mcm.detect import prescreen
from auv_mcm.detect.ftest import f_deviate
from auv_mcm.detect.prescreen import Floor, Peak, PixelGrid, Spread, combined, decay_of, glint, saturate_shadow, worth
from auv_mcm.kernels.contrast import (
    Blocks,
    Frame,
    Places,
    Shadows,
    TileSums,
    background,
    box_means,
    bright_places,
    dark_places,
    extremes,
    image_sums,
    local_variances,
    raise_before,
    ratios,
    shadow_columns,
)
from auv_mcm.kernels.contrast import peaks as peaks_of
from auv_mcm.records import LOW_RESOLUTION, Tile

_FAINT_HIGHLIGHT: Final = 2.2  # deviates, minimum
# Of a score: fainter highlights are found by their shadows. Minimizes the processor time on flat and rough floors.
_BELOW_THRESHOLD: Final = 0.8
SLACK: Final = 0.01
MIN_THRESHOLD: Final = 2.5
"""Of a score, below which all pixels are scored: bounds would hold back too few."""
_MIN_SHADOW: Final = 0.7  # fainter ones are scored where a highlight makes up for them
# rows and columns, minimum, that one bound covers: smaller ones skip more pixels, and there are more of them
_BLOCK: Final = (8, 32)

Values = NDArray[np.float32]
Bounds = NDArray[np.float64]


class Contrasts(NamedTuple):
    """Hold a tile's floor and its scores that reach the threshold.

    background, known, thin, small, large, score: (n_rows, n_columns); variances of ln I over boxes of three sizes, in
    the rows scored, and the score where it is at least the threshold, -inf elsewhere. rows: [start, stop) of those
    scored. shadows: of all sizes searched for. n_bounded: pixels of the rows scored that were skipped, since bounds
    hold them below the threshold.
    """

    tile: Tile
    grid: PixelGrid
    rows: tuple[int, int]
    shadows: Shadows
    sums: TileSums
    background: Values
    known: NDArray[np.bool_]
    thin: Values
    small: Values
    large: Values
    score: Values
    n_bounded: int = 0

    def floor(self, row: int, column: int) -> Floor:
        """Describe the sea floor around a pixel of the rows scored."""
        return Floor(float(self.background[row, column]), float(self.small[row, column]))

    def peaks(self, radius_m: float) -> list[Peak]:
        """Find local maxima over the threshold in the tile's core, best first.

        A peak is the highest score within `radius_m`, at most MARGIN_M, along rows and columns. Pixels of low
        resolution (near nadir) hold none and outshine none.
        """
        tile = self.tile
        half_row, half_column = (
            max(1, round(radius_m / tile.row_spacing_m)),
            max(1, round(radius_m / tile.column_spacing_m)),
        )
        scored = np.flatnonzero(self.score > -np.inf)
        score = self.score.copy()
        score.ravel()[scored[(tile.mask.ravel()[scored] & LOW_RESOLUTION) != 0]] = -np.inf
        places = peaks_of(score, (tile.core_start, tile.core_stop), half_row, half_column)
        rows, columns = np.divmod(places, score.shape[1])
        found = [
            Peak(float(score[row, column]), int(row), int(column)) for row, column in zip(rows, columns, strict=True)
        ]
        return sorted(found, key=lambda p: (-p.score, p.row, p.column))

    def clearest(self, rows: Sequence[int], columns: Sequence[int], half_rows: int, half_columns: int) -> list[Peak]:
        """Find the highest score within half_rows and half_columns of each pixel, the first of equal ones.

        The score is -inf where contrast cannot be computed.
        """
        parts = [
            (
                slice(max(row - half_rows, 0), row + half_rows + 1),
                slice(max(column - half_columns, 0), column + half_columns + 1),
            )
            for row, column in zip(rows, columns, strict=True)
        ]
        score = self.score
        missing = np.zeros(score.shape, dtype=np.bool_)
        for part in parts:
            if score[part].max() == -np.inf:
                missing[part] = self.known[part]
        places = _scored(self, np.flatnonzero(missing))
        if places.size:
            score = score.copy()
            score.ravel()[places] = scores_at(self, places)
        found = []
        for part in parts:
            near = score[part]
            down, right = divmod(int(near.argmax()), near.shape[1])
            found.append(Peak(float(near[down, right]), part[0].start + down, part[1].start + right))
        return found


def contrasts(tile: Tile, p_false_alarm: float, *, bounded: bool = True) -> Contrasts:
    """Score all pixels of a tile that reach a tail probability (> 0, < 0.5) in pure speckle.

    bounded: score only pixels that may reach the threshold; the result is the same.
    """
    grid = PixelGrid(tile.row_spacing_m, tile.column_spacing_m)
    margin = round(prescreen.MARGIN_M / tile.row_spacing_m) + 1
    rows = max(tile.core_start - margin, 0), min(tile.core_stop + margin, tile.mask.shape[0])
    sums = image_sums(tile.intensity, tile.mask, prescreen.MAX_RATIO)
    outer, hollow, area = grid.frame()
    frame = Frame(_box(outer), _box(hollow), prescreen.MIN_BACKGROUND * area)
    level, known = background(tile.intensity, tile.mask, frame, prescreen.BACKGROUND_CLIP, prescreen.NO_ECHO)
    boxes = [grid.centred(size_m)[0] for size_m in (prescreen.THIN_BOX_M, prescreen.SMALL_BOX_M, prescreen.LARGE_BOX_M)]
    logarithms = ratios(sums, level, np.array(boxes, dtype=np.int32), 1e-3)
    np.log(logarithms, out=logarithms)
    half = grid.rows(prescreen.LOOKS_ROWS_M), grid.columns(prescreen.LOOKS_COLUMNS_M)
    thin, small, large = local_variances(logarithms, known, rows, half, prescreen.LOG_CLIP, prescreen.MIN_LOG_VARIANCE)
    del logarithms  # 13 MB of a wide tile, which would be held while scores are computed
    score = np.full(tile.mask.shape, -np.inf, dtype=np.float32)
    found = Contrasts(tile, grid, rows, _shadows(tile, grid), sums, level, known, thin, small, large, score)
    threshold = np.float32(-NormalDist().inv_cdf(p_false_alarm))
    weighs_all = threshold < MIN_THRESHOLD or not bounded
    places, values = _all_scores(found) if weighs_all else _high_scores(found, float(threshold))
    high = values >= threshold
    score.ravel()[places[high]] = values[high]
    return (
        found if weighs_all else found._replace(n_bounded=int(np.count_nonzero(known[rows[0] : rows[1]])) - places.size)
    )


def scores_at(tile: Contrasts, places: Places) -> Values:
    """Score some pixels of the rows scored, where the background is known."""
    return combined(_highlights_at(tile, places), _shadows_at(tile, places))


def _all_scores(tile: Contrasts) -> tuple[Places, Values]:
    places = _scored(tile, np.flatnonzero(tile.known))
    return places, scores_at(tile, places)


def _high_scores(tile: Contrasts, threshold: float) -> tuple[Places, Values]:
    """Score all places that may reach the threshold.

    Returns places, among them all whose scores reach it, and scores; those of others may be too high, but below the
    threshold.
    """
    blocks = Blocks(_BLOCK[0], max(_BLOCK[1], tile.grid.columns(prescreen.SHADOW_LAG_M)))
    ranges = _ranges(tile, blocks)
    faint = max(_FAINT_HIGHLIGHT, threshold - _BELOW_THRESHOLD)
    faint_worth = float(worth(np.array([faint], dtype=np.float32))[0])
    highlight = _bright(tile, blocks, ranges, faint)
    flat = highlight.ravel()
    lit = np.flatnonzero(flat >= np.float32(faint)).astype(np.int32)
    needed = threshold * prescreen.PAIR_NORM - SLACK
    gain = worth(flat[lit])
    left = np.maximum(needed - _best_in_view(tile, blocks, lit, gain, faint_worth), _MIN_SHADOW)
    shadow = _dark(tile, blocks, ranges, left).ravel()

    # Bright enough to need hardly any shadow, and none was found: then the exact deviate of the darkest one counts.
    unseen = lit[(gain > needed - _MIN_SHADOW) & (shadow[lit] < np.float32(_MIN_SHADOW))]
    if unseen.size:
        shadow[unseen] = _shadows_at(tile, unseen)
    likely = (gain + saturate_shadow(shadow[lit]) >= needed) | (glint(flat[lit]) >= threshold - SLACK)
    bright = _scored(tile, lit[likely])
    dark = np.flatnonzero(shadow >= needed - faint_worth)
    dim = _scored(tile, dark[(flat[dark] < np.float32(faint)) & tile.known.ravel()[dark]])
    places = np.concatenate((bright, dim))
    return places, combined(np.concatenate((flat[bright], _highlights_at(tile, dim))), shadow[places])


class _Ranges(NamedTuple):
    """Hold the bounds in each block of variances over thin and small boxes, and of the power of area."""

    thin: tuple[Bounds, Bounds]
    small: tuple[Bounds, Bounds]
    decay: tuple[Bounds, Bounds]


def _ranges(tile: Contrasts, blocks: Blocks) -> _Ranges:
    thin, small, large = (extremes(plane, blocks) for plane in (tile.thin, tile.small, tile.large))
    area_ratio = tile.grid.centred(prescreen.LARGE_BOX_M)[1] / tile.grid.centred(prescreen.SMALL_BOX_M)[1]
    decay = decay_of(small[0], large[1], area_ratio), decay_of(small[1], large[0], area_ratio)
    return _Ranges(*((low * (1.0 - 1e-5), high * (1.0 + 1e-5)) for low, high in _double(thin, small, decay)))


def _double(*pairs: tuple[Values, Values]) -> list[tuple[Bounds, Bounds]]:
    return [(low.astype(np.float64), high.astype(np.float64)) for low, high in pairs]


def _inverse_looks(tile: Contrasts, ranges: _Ranges, n_rows: int, area: float | Bounds) -> tuple[Bounds, Bounds]:
    """Bound 1 / (9 looks), the variance of a box mean's cube root, in each block."""
    one_row = n_rows == 1
    low, high = ranges.thin if one_row else ranges.small
    growth = np.log(area / tile.grid.centred(prescreen.THIN_BOX_M if one_row else prescreen.SMALL_BOX_M)[1])
    slow, fast = (np.where(growth < 0.0, 1.0, decay) * growth for decay in ranges.decay)
    low_bound, high_bound = (2.0 / 9.0 * variance for variance in (low * np.exp(-fast), high * np.exp(-slow)))
    return low_bound / (1.0 + np.sqrt(1.0 + 9.0 * low_bound)), high_bound / (1.0 + np.sqrt(1.0 + 9.0 * high_bound))


def _bright(tile: Contrasts, blocks: Blocks, ranges: _Ranges, faint: float) -> Values:
    """Compute the deviate of the brightest box where it may be `faint` or more.

    Elsewhere the value is less, or -inf.
    """
    highlight = np.full(tile.background.shape, -np.inf, dtype=np.float32)
    flat = highlight.ravel()
    around, _ = _inverse_looks(tile, ranges, 2, float(tile.grid.frame()[2]))
    boxes, areas = zip(*(tile.grid.centred(size_m) for size_m in prescreen.HIGHLIGHTS_M), strict=True)
    limits = []
    for box, area in zip(boxes, areas, strict=True):
        low_bound, high_bound = _inverse_looks(tile, ranges, box[1] - box[0], float(area))
        root = (1.0 - high_bound + (faint - SLACK) * np.sqrt(low_bound)) / (1.0 - around)
        limits.append(np.maximum(root - SLACK, 0.0) ** 3)
    wanted = np.array(boxes, dtype=np.int32), np.stack(limits)
    for k, places in enumerate(bright_places(tile.sums, tile.background, tile.known, tile.rows, *wanted, blocks)):
        flat[places] = np.maximum(flat[places], _highlight_deviates(tile, _Spots.at(tile, places), k))
    return highlight


def _best_in_view(tile: Contrasts, blocks: Blocks, lit: Places, gain: Values, faint_worth: float) -> Bounds:
    """Bound the worth of a highlight, in each block, among the pixels whose shadows may start there."""
    best = np.full(blocks.shape(tile.sums.shape), faint_worth)
    row, column = np.divmod(lit, tile.sums.shape[1])
    lag = tile.grid.columns(prescreen.SHADOW_LAG_M)
    strength = gain.astype(np.float64)
    # Shadows start 1 to `lag` columns behind, in the row or one beside it: at most two blocks either way, so that
    # corners will do.
    for row_off in (-1, 1):
        down = np.clip(row + row_off, 0, tile.sums.shape[0] - 1) // blocks.n_rows
        for column_off in (1, lag):
            across = np.minimum(column + column_off, tile.sums.shape[1] - 1) // blocks.n_columns
            np.maximum.at(best.ravel(), down * best.shape[1] + across, strength)
    return best


def _dark(tile: Contrasts, blocks: Blocks, ranges: _Ranges, left: Bounds) -> Values:
    """Compute the deviate of the darkest shadow behind each pixel, dark positive.

    Exact where it may be `left` or more; less, or 0, elsewhere.
    """
    darkest = np.zeros(tile.background.shape, dtype=np.float32)
    _, around = _inverse_looks(tile, ranges, 2, float(tile.grid.frame()[2]))
    n_rows, n_columns = tile.sums.shape
    last = np.minimum(
        np.arange(blocks.n_columns - 1, n_columns + blocks.n_columns - 1, blocks.n_columns), n_columns - 1
    )
    lowest = tile.shadows._replace(
        clearance_m=np.minimum.reduceat(tile.shadows.clearance_m, np.arange(0, n_rows, blocks.n_rows), axis=1)
    )
    limits = []
    for k, width in enumerate((2 * tile.shadows.half_rows + 1).tolist()):
        longest = shadow_columns(lowest, k, np.arange(left.shape[0])[:, None], last[None, :])
        low_bound, _ = _inverse_looks(tile, ranges, width, (width * longest).astype(np.float64))
        root = (1.0 - low_bound - (left - SLACK) * np.sqrt(low_bound)) / (1.0 - around)
        limits.append((np.maximum(root, 0.0) + SLACK) ** 3)
    lag = tile.grid.columns(prescreen.SHADOW_LAG_M)
    for k, places in enumerate(
        dark_places(tile.sums, tile.background, tile.rows, tile.shadows, np.stack(limits), blocks)
    ):
        deviates = _shadow_deviates(tile, _Spots.at(tile, places), k)
        raise_before(darkest, tile.rows, places, deviates, lag)
    return darkest


class _Spots(NamedTuple):
    """Hold the sea floor at n places, (n,) each."""

    places: Places
    per_background: Values
    spread: Spread
    background_looks: Values

    @staticmethod
    def at(tile: Contrasts, places: Places) -> _Spots:
        """Read the sea floor of a tile at some places."""
        wanted = places.astype(np.intp)
        level, thin, small, large = (
            plane.ravel().take(wanted) for plane in (tile.background, tile.thin, tile.small, tile.large)
        )
        areas = [
            tile.grid.centred(size_m)[1]
            for size_m in (prescreen.THIN_BOX_M, prescreen.SMALL_BOX_M, prescreen.LARGE_BOX_M)
        ]
        spread = Spread(thin, small, decay_of(small, large, areas[2] / areas[1]), areas[0], areas[1])
        return _Spots(places, np.float32(1.0) / level, spread, spread.looks(2, float(tile.grid.frame()[2])))


def _highlight_deviates(tile: Contrasts, spots: _Spots, k: int) -> Values:
    box, area = tile.grid.centred(prescreen.HIGHLIGHTS_M[k])
    mean, _ = box_means(tile.sums, spots.places, np.broadcast_to(_box(box), (len(spots.places), 4)))
    looks = spots.spread.looks(box[1] - box[0], float(area))
    return f_deviate(mean * spots.per_background, looks, spots.background_looks)


def _shadow_deviates(tile: Contrasts, spots: _Spots, k: int) -> Values:
    half_rows = int(tile.shadows.half_rows[k])
    lengths = shadow_columns(tile.shadows, k, *np.divmod(spots.places, tile.sums.shape[1]))
    boxes = np.empty((len(lengths), 4), dtype=np.int32)
    boxes[:] = -half_rows, half_rows + 1, 0, 0
    boxes[:, 3] = lengths
    mean, count = box_means(tile.sums, spots.places, boxes)
    n_rows = 2 * half_rows + 1
    area_px = (n_rows * lengths).astype(np.float32)
    deviate = f_deviate(mean * spots.per_background, spots.spread.looks(n_rows, area_px), spots.background_looks)
    return np.where(count > prescreen.MIN_SHADOW * area_px, deviate, np.float32(0.0))


def _highlights_at(tile: Contrasts, places: Places) -> Values:
    """Compute the deviate of the brightest box at each place."""
    spots = _Spots.at(tile, places)
    highlight = np.full(len(places), -np.inf, dtype=np.float32)
    for k, _ in enumerate(prescreen.HIGHLIGHTS_M):
        np.maximum(highlight, _highlight_deviates(tile, spots, k), out=highlight)
    return highlight


def _shadows_at(tile: Contrasts, places: Places) -> Values:
    """Compute the deviate of the darkest shadow behind each place, dark positive."""
    n_rows, n_columns = tile.sums.shape
    lag = tile.grid.columns(prescreen.SHADOW_LAG_M)
    row, column = np.divmod(places, n_columns)
    # A shadow may start in the row or one beside it, 1 to lag columns behind; `wanted` has as many to spare.
    wanted = np.zeros((n_rows, n_columns + lag), dtype=np.uint8)
    wanted[row, column + 1] = 1
    cv2.dilate(wanted, np.ones((3, lag), dtype=np.uint8), dst=wanted, anchor=(lag - 1, 1))
    wanted[: tile.rows[0]] = wanted[tile.rows[1] :] = 0
    weighed = np.flatnonzero(wanted[:, :n_columns].view(np.bool_)).astype(np.int32)
    spots = _Spots.at(tile, weighed)
    values = np.full(len(weighed), np.inf, dtype=np.float32)
    for k, _ in enumerate(prescreen.SHADOWS_M):
        np.minimum(values, _shadow_deviates(tile, spots, k), out=values)
    darkest = np.full(tile.sums.shape, -np.inf, dtype=np.float32)
    raise_before(darkest, tile.rows, weighed, values, lag)
    found = darkest[row, column]
    # Where no shadow is weighed, there is none.
    ends = (row <= tile.rows[0]) | (row + 1 >= tile.rows[1]) | (column + lag >= n_columns)
    return np.where(ends, np.maximum(found, np.float32(0.0)), found)


def _shadows(tile: Tile, grid: PixelGrid) -> Shadows:
    return Shadows(
        half_rows=np.array([grid.rows(along_m) // 2 for along_m, _ in prescreen.SHADOWS_M], dtype=np.int64),
        height_m=np.array([height_m for _, height_m in prescreen.SHADOWS_M]),
        clearance_m=np.stack([prescreen.clearance_m(tile, height_m) for _, height_m in prescreen.SHADOWS_M]),
        column_m=grid.column_m,
        length_m=prescreen.SHADOW_LENGTH_M,
        least_share=prescreen.MIN_SHADOW,
    )


def _scored(tile: Contrasts, places: NDArray[np.integer]) -> Places:
    """Select the places in the rows scored."""
    n_columns = tile.sums.shape[1]
    return places[(places >= tile.rows[0] * n_columns) & (places < tile.rows[1] * n_columns)].astype(np.int32)


def _box(box: tuple[int, int, int, int]) -> NDArray[np.int32]:
    return np.array(box, dtype=np.int32)
