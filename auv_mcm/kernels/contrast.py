"""Compute what contrasts need: box sums on integral images, background, variances, and places where a box may stand
out.

Integral images are (n_rows + 1, n_columns + 1), element (i, j) the sum over the rows before i and columns before j,
float64 added up along rows and then down, or int32. Boxes are half-open offsets from a pixel, (..., 4) int32: first and
last row, first and last column; what reaches out of the tile is clipped at its edge. A box's mean is over its valid
pixels, 0 where there are none. Places are indices of pixels, row times n_columns plus column, int32.

C and numpy agree to the bit.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.kernels.signatures import call
from auv_mcm.records import SATURATED, VALID

Plane = NDArray[np.float32]
Flags = NDArray[np.bool_]
Places = NDArray[np.int32]
Boxes = NDArray[np.int32]


class TileSums(NamedTuple):
    """Hold integral images of a tile, (n_rows + 1, n_columns + 1).

    Intensity where valid, float64, and number of valid pixels, int32.
    """

    total: NDArray[np.float64]
    n_valid: NDArray[np.int32]

    @property
    def shape(self) -> tuple[int, int]:
        """Give (n_rows, n_columns) of the tile."""
        return self.total.shape[0] - 1, self.total.shape[1] - 1


class Frame(NamedTuple):
    """Define the background of a pixel: a box (4,) int32 without its hollow (4,) int32.

    least_count: minimum of valid pixels for it to be known.
    """

    outer: Boxes
    hollow: Boxes
    least_count: float


class Blocks(NamedTuple):
    """Divide a plane into blocks of n_rows x n_columns pixels, the last ones cut at the plane's edge."""

    n_rows: int
    n_columns: int

    def shape(self, plane: tuple[int, int]) -> tuple[int, int]:
        """Give the number of blocks of a plane down and across."""
        return -(-plane[0] // self.n_rows), -(-plane[1] // self.n_columns)


class Shadows(NamedTuple):
    """Describe shadows that objects of several heights cast.

    half_rows (n_heights,) int64, rows to either side of a pixel. height_m: (n_heights,), clearance_m: (n_heights,
    n_rows) float64, altitude over the object's top. length_m: minimum and maximum. least_share: of its pixels, more
    than which must be valid.
    """

    half_rows: NDArray[np.int64]
    height_m: NDArray[np.float64]
    clearance_m: NDArray[np.float64]
    column_m: float
    length_m: tuple[float, float]
    least_share: float


def image_sums(intensity: Plane, mask: NDArray[np.uint8], bound: float) -> TileSums:
    """Compute integral images of a tile.

    intensity (n_rows, n_columns) is bounded by `bound`.
    """
    shape = (intensity.shape[0] + 1, intensity.shape[1] + 1)
    sums = TileSums(np.empty(shape), np.empty(shape, dtype=np.int32))
    if not call("contrast_sums", *intensity.shape, intensity, mask, VALID, bound, *sums):
        return image_sums_numpy(intensity, mask, bound)
    return sums


def image_sums_numpy(intensity: Plane, mask: NDArray[np.uint8], bound: float) -> TileSums:
    """Do as image_sums, in numpy alone."""
    valid = (mask & VALID) != 0
    bounded = np.where(valid, np.minimum(intensity, np.float32(bound)), np.float32(0.0))
    return TileSums(_integral(bounded, np.float64), _integral(valid, np.int32))


def background(
    intensity: Plane, mask: NDArray[np.uint8], frame: Frame, bound: float, min_mean: np.float32
) -> tuple[Plane, Flags]:
    """Average the sea floor in the frame around each pixel, min_mean or more.

    Gives also where pixel and frame are valid and the mean is above it. What is not saturated is sea floor, bounded by
    `bound`.
    """
    shape = intensity.shape
    mean, known = np.empty(shape, dtype=np.float32), np.empty(shape, dtype=np.bool_)
    pad, bands = _bands(shape[1], 2, frame.outer, frame.hollow)
    depth = int(max(frame.outer[1], frame.hollow[1], 0) - min(frame.outer[0], frame.hollow[0], 0)) + 1
    rows = np.empty((depth, shape[1] + 1)), np.empty((depth, shape[1] + 1), dtype=np.int32)
    rule, reach = (VALID, SATURATED, bound, *frame, float(min_mean)), (pad, depth)
    if not call("contrast_background", *shape, intensity, mask, *rule, *reach, *rows, *bands, mean, known):
        return background_numpy(intensity, mask, frame, bound, min_mean)
    return mean, known


def background_numpy(
    intensity: Plane, mask: NDArray[np.uint8], frame: Frame, bound: float, min_mean: np.float32
) -> tuple[Plane, Flags]:
    """Do as background, in numpy alone."""
    seabed = (mask & (VALID | SATURATED)) == VALID
    floor = np.where(seabed, np.minimum(intensity, np.float32(bound)), np.float32(0.0))
    floor_total, n_floor = _integral(floor, np.float64), _integral(seabed, np.int32)
    total = _box(floor_total, frame.outer) - _box(floor_total, frame.hollow)
    count = _box(n_floor, frame.outer) - _box(n_floor, frame.hollow)
    mean = np.maximum(np.maximum(total, 0.0) / np.maximum(count, 1), min_mean).astype(np.float32)
    return mean, (count >= frame.least_count) & (mean > min_mean) & ((mask & VALID) != 0)


def ratios(sums: TileSums, level: Plane, boxes: Boxes, minimum: float) -> Plane:
    """Compute means of boxes (n_boxes, 4) over the level (n_rows, n_columns) of each pixel, `minimum` or more.

    Returns (n_boxes, n_rows, n_columns).
    """
    found = np.empty((len(boxes), *sums.shape), dtype=np.float32)
    pad, bands = _bands(sums.shape[1], 1, boxes)
    if not call("contrast_ratios", *sums.shape, *sums, level, len(boxes), boxes, minimum, pad, *bands, found):
        return ratios_numpy(sums, level, boxes, minimum)
    return found


def ratios_numpy(sums: TileSums, level: Plane, boxes: Boxes, minimum: float) -> Plane:
    """Do as ratios, in numpy alone."""
    means = [(_box(sums.total, box) / np.maximum(_box(sums.n_valid, box), 1)).astype(np.float32) for box in boxes]
    return np.stack([np.maximum(mean / level, np.float32(minimum)) for mean in means])


def local_variances(
    planes: Plane, known: Flags, rows: tuple[int, int], half: tuple[int, int], clip: float, minimum: float
) -> Plane:
    """Compute variances of the values of three planes (3, n_rows, n_columns) around each pixel.

    Values are clipped to +-clip and taken over the known pixels within `half` rows and columns; variances are `minimum`
    or more. Of rows [start, stop), one or more; the others repeat the nearest of them.
    """
    width = planes.shape[2] + 1
    variances = np.empty(planes.shape, dtype=np.float32)
    sums, n_known = np.zeros((6 * len(planes), width)), np.zeros(width, dtype=np.int32)
    rule, room = (*half, clip, minimum), (sums, n_known, variances)
    if not call("contrast_variances", *planes.shape[1:], *rows, planes, known, *rule, *room):
        return local_variances_numpy(planes, known, rows, half, clip, minimum)
    return _beyond(variances, rows)


def local_variances_numpy(
    planes: Plane, known: Flags, rows: tuple[int, int], half: tuple[int, int], clip: float, minimum: float
) -> Plane:
    """Do as local_variances, in numpy alone."""
    box = np.array((-half[0], half[0] + 1, -half[1], half[1] + 1), dtype=np.int32)
    count = np.maximum(_box(_integral(known, np.int32), box), 1)
    variances = np.empty(planes.shape, dtype=np.float32)
    for values, variance in zip(planes, variances, strict=True):
        clipped = np.clip(values, np.float32(-clip), np.float32(clip)) * known
        mean = _box(_integral(clipped, np.float64), box) / count
        mean_square = _box(_integral(clipped * clipped, np.float64), box) / count
        variance[:] = np.maximum(mean_square - mean * mean, minimum)
    return _beyond(variances, rows)


def _beyond(planes: Plane, rows: tuple[int, int]) -> Plane:
    planes[:, : rows[0]] = planes[:, rows[0] : rows[0] + 1]
    planes[:, rows[1] :] = planes[:, rows[1] - 1 : rows[1]]
    return planes


def extremes(plane: Plane, blocks: Blocks) -> tuple[Plane, Plane]:
    """Find the lowest and highest value in each block of a plane without NaN, (blocks down, blocks across) each."""
    lowest, highest = (np.empty(blocks.shape((plane.shape[0], plane.shape[1])), dtype=np.float32) for _ in range(2))
    low, high = np.empty((2, plane.shape[1]), dtype=np.float32)
    if not call("contrast_extremes", *plane.shape, plane, *blocks, low, high, lowest, highest):
        return extremes_numpy(plane, blocks)
    return lowest, highest


def extremes_numpy(plane: Plane, blocks: Blocks) -> tuple[Plane, Plane]:
    """Do as extremes, in numpy alone."""
    rows, columns = np.arange(0, plane.shape[0], blocks.n_rows), np.arange(0, plane.shape[1], blocks.n_columns)
    lowest, highest = (
        np.asarray(of.reduceat(of.reduceat(plane, rows, 0), columns, 1)) for of in (np.minimum, np.maximum)
    )
    return lowest, highest


def bright_places(
    sums: TileSums,
    level: Plane,
    known: Flags,
    rows: tuple[int, int],
    boxes: Boxes,
    limits: NDArray[np.float64],
    blocks: Blocks,
) -> tuple[Places, ...]:
    """Find, for each box (n_boxes, 4), the known pixels of rows [start, stop) around which it is bright.

    Its sum is then at least limit times level times number of valid pixels.

    limits: for each box one for each block, (n_boxes, blocks down, blocks across) float64. Places rise.
    """
    pad, bands = _bands(sums.shape[1], 1, boxes)
    flags, places, n_places = _room(sums.shape, rows, len(boxes))
    planes, asked = (*sums, level, known), (len(boxes), boxes, limits, *blocks)
    room = pad, places.shape[1], *bands, flags, places, n_places
    if not call("contrast_bright", *sums.shape, *rows, *planes, *asked, *room):
        return bright_places_numpy(sums, level, known, rows, boxes, limits, blocks)
    return _found(places, n_places)


def bright_places_numpy(
    sums: TileSums,
    level: Plane,
    known: Flags,
    rows: tuple[int, int],
    boxes: Boxes,
    limits: NDArray[np.float64],
    blocks: Blocks,
) -> tuple[Places, ...]:
    """Do as bright_places, in numpy alone."""
    found = []
    for box, limit in zip(boxes, limits, strict=True):
        minimum = _spread(limit, blocks, sums.shape) * level * _box(sums.n_valid, box)
        found.append(_places_of((_box(sums.total, box) >= minimum) & known, rows))
    return tuple(found)


def dark_places(
    sums: TileSums, level: Plane, rows: tuple[int, int], shadows: Shadows, limits: NDArray[np.float64], blocks: Blocks
) -> tuple[Places, ...]:
    """Find, for each height, the pixels of rows [start, stop) where dark shadows begin. Places rise.

    Their sum is at most limit times level times number of valid pixels. limits: (n_heights, blocks down, blocks
    across).
    """
    pad, bands = _bands(sums.shape[1], 1, np.array((round(shadows.length_m[1] / shadows.column_m) + 1,)))
    runs = np.empty((len(shadows.height_m), pad + 1), dtype=np.int32)
    flags, places, n_places = _room(sums.shape, rows, len(shadows.height_m))
    heights = len(shadows.height_m), *shadows[:3], shadows.least_share, shadows.column_m, *shadows.length_m
    room = pad, places.shape[1], *bands, runs, flags, places, n_places
    if not call("contrast_dark", *sums.shape, *rows, *sums, level, *heights, limits, *blocks, *room):
        return dark_places_numpy(sums, level, rows, shadows, limits, blocks)
    return _found(places, n_places)


def dark_places_numpy(
    sums: TileSums, level: Plane, rows: tuple[int, int], shadows: Shadows, limits: NDArray[np.float64], blocks: Blocks
) -> tuple[Places, ...]:
    """Do as dark_places, in numpy alone."""
    row, column = np.indices((rows[1] - rows[0], sums.shape[1]), sparse=True)
    row = row + rows[0]
    stride = sums.total.shape[1]
    spread = [_spread(limit, blocks, sums.shape)[rows[0] : rows[1]] for limit in limits]
    found = []
    for k, half_rows in enumerate(shadows.half_rows.tolist()):
        lengths = shadow_columns(shadows, k, row, column)
        top, bottom = (np.clip(row + reach, 0, sums.shape[0]) * stride for reach in (-half_rows, half_rows + 1))
        stop = np.minimum(column + lengths, sums.shape[1])
        corners = bottom + stop, top + stop, bottom + column, top + column
        total, count = (
            (bottom_stop - top_stop) - (bottom_start - top_start)
            for bottom_stop, top_stop, bottom_start, top_start in (
                [of.take(corner) for corner in corners] for of in (sums.total, sums.n_valid)
            )
        )
        enough = count > np.float32(shadows.least_share) * ((2 * half_rows + 1) * lengths).astype(np.float32)
        dark = (total <= spread[k] * level[rows[0] : rows[1]] * count) & enough
        found.append(np.asarray(np.flatnonzero(dark) + rows[0] * sums.shape[1], dtype=np.int32))
    return tuple(found)


def raise_before(
    darkest: Plane, rows: tuple[int, int], places: Places, deviates: NDArray[np.float32], lag: int
) -> None:
    """Raise `darkest` (n_rows, n_columns), contiguous, to minus the deviates of shadows behind each pixel.

    They start at places (n,), 1 to `lag` columns behind in the row or one beside it. Of rows [start, stop).
    """
    if not call("contrast_before", darkest.shape[1], *rows, len(places), places, deviates, lag, darkest):
        raise_before_numpy(darkest, rows, places, deviates, lag)


def raise_before_numpy(
    darkest: Plane, rows: tuple[int, int], places: Places, deviates: NDArray[np.float32], lag: int
) -> None:
    """Do as raise_before, in numpy alone."""
    row, column = np.divmod(places, darkest.shape[1])
    for down in (-1, 0, 1):
        for across in range(1, lag + 1):
            seen = (row + down >= rows[0]) & (row + down < rows[1]) & (column >= across)
            np.maximum.at(darkest, (row[seen] + down, column[seen] - across), -deviates[seen])


def shadow_columns(shadows: Shadows, k: int, row: NDArray[np.integer], column: NDArray[np.integer]) -> NDArray[np.intp]:
    """Compute lengths in columns of the shadows of height k that begin at pixels.

    h y / (H - h) on a flat bottom.

    Parameters
    ----------
    row, column
        Of one broadcast shape.
    """
    ground_m = (column + 0.5) * shadows.column_m
    length_m = np.clip(shadows.height_m[k] * ground_m / shadows.clearance_m[k, row], *shadows.length_m)
    return np.asarray(np.maximum(np.rint(length_m / shadows.column_m), 1.0), dtype=np.intp)


def box_means(sums: TileSums, places: Places, boxes: Boxes) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Average one box (n, 4) at each of n places, and count its valid pixels, (n,) each."""
    mean, count = np.empty(len(places), dtype=np.float32), np.empty(len(places), dtype=np.int32)
    if not call("contrast_means", *sums.shape, *sums, len(places), places, boxes, mean, count):
        return box_means_numpy(sums, places, boxes)
    return mean, count


def box_means_numpy(sums: TileSums, places: Places, boxes: Boxes) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Do as box_means, in numpy alone."""
    n_rows, n_columns = sums.shape
    row, column = np.divmod(places, n_columns)
    top, bottom = (np.clip(row + boxes[:, k], 0, n_rows) for k in (0, 1))
    left, right = (np.clip(column + boxes[:, k], 0, n_columns) for k in (2, 3))
    total, count = (
        (image[bottom, right] - image[top, right]) - (image[bottom, left] - image[top, left])
        for image in (sums.total, sums.n_valid)
    )
    return (total / np.maximum(count, 1)).astype(np.float32), np.asarray(count, dtype=np.int32)


def peaks(plane: Plane, rows: tuple[int, int], half_rows: int, half_columns: int) -> Places:
    """Find pixels of rows [start, stop) above -inf that are highest within half_rows and half_columns. Places rise."""
    _, places, n_places = _room((plane.shape[0], plane.shape[1]), rows, 1)
    if not call("contrast_peaks", *plane.shape, *rows, plane, half_rows, half_columns, places, n_places):
        return peaks_numpy(plane, rows, half_rows, half_columns)
    return _found(places, n_places)[0]


def peaks_numpy(plane: Plane, rows: tuple[int, int], half_rows: int, half_columns: int) -> Places:
    """Do as peaks, in numpy alone."""
    found = plane > -np.inf
    for row, column in zip(*np.nonzero(found), strict=True):
        near = plane[
            max(row - half_rows, 0) : row + half_rows + 1, max(column - half_columns, 0) : column + half_columns + 1
        ]
        found[row, column] = plane[row, column] >= near.max()
    return _places_of(found, rows)


def _integral(plane: NDArray[Any], dtype: type) -> NDArray[Any]:
    sums = np.zeros((plane.shape[0] + 1, plane.shape[1] + 1), dtype=dtype)
    np.cumsum(np.cumsum(plane, axis=1, dtype=dtype), axis=0, dtype=dtype, out=sums[1:, 1:])
    return sums


def _box(image: NDArray[Any], box: Boxes) -> NDArray[Any]:
    """Sum over a box around every pixel."""
    n_rows, n_columns = image.shape[0] - 1, image.shape[1] - 1
    top, bottom = (np.clip(np.arange(n_rows) + k, 0, n_rows) for k in box[:2])
    left, right = (np.clip(np.arange(n_columns) + k, 0, n_columns) for k in box[2:])
    band = image[bottom] - image[top]
    return np.asarray(band[:, right] - band[:, left])


def _spread(values: NDArray[np.float64], blocks: Blocks, shape: tuple[int, int]) -> NDArray[np.float64]:
    """Give each pixel the value of its block."""
    rows, columns = (np.arange(n) // size for n, size in zip(shape, blocks, strict=True))
    return values[np.ix_(rows, columns)]


def _places_of(found: Flags, rows: tuple[int, int]) -> Places:
    first = rows[0] * found.shape[1]
    return np.asarray(np.flatnonzero(found[rows[0] : rows[1]]) + first, dtype=np.int32)


def _bands(
    n_columns: int, n: int, *boxes: NDArray[np.integer]
) -> tuple[int, tuple[NDArray[np.float64], NDArray[np.int32]]]:
    """Measure how far boxes reach along rows, and make room for n rows of differences that much longer on either
    side."""
    pad = max(int(np.abs(box).max()) for box in boxes)
    width = n_columns + 1 + 2 * pad
    return pad, (np.empty((n, width)), np.empty((n, width), dtype=np.int32))


def _room(shape: tuple[int, int], rows: tuple[int, int], n: int) -> tuple[NDArray[np.uint8], Places, NDArray[np.int64]]:
    """Make room for a row's flags, for n times as many places as there can be, and for their numbers.

    A chunk of flags passes over some places.
    """
    n_columns = shape[1]
    return (
        np.zeros(n_columns + 8, dtype=np.uint8),
        np.empty((n, max(rows[1] - rows[0], 0) * n_columns + 8), dtype=np.int32),
        np.zeros(n, dtype=np.int64),
    )


def _found(places: Places, n_places: NDArray[np.int64]) -> tuple[Places, ...]:
    return tuple(some[:n].copy() for some, n in zip(places, n_places.tolist(), strict=True))
