"""Average a waterfall in a box around each pixel.

C and numpy agree to the bit: all in numpy's order of operations; logarithms, which no two libraries round alike, are
taken by numpy outside.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.kernels.signatures import call
from auv_mcm.records import SATURATED, VALID

Plane = NDArray[np.float32]
Values = NDArray[np.float64]
Flags = NDArray[np.bool_]
Masks = NDArray[np.uint8]

_ROWS_SUMMED: Final = 8  # 2 ROWS_TOGETHER of waterfall.h
# one pixel in so many has room at first: large arrays that are hardly used cost page faults
_USUAL_SHARE_OF_BRIGHT: Final = 16


class Usable(NamedTuple):
    """Hold the usable pixels of an image, which are VALID and not SATURATED, all (n_rows, n_columns).

    level: float32, 0 where not usable; bounded: the same within bounds, 1 where not usable; usable: bool.
    """

    level: Plane
    bounded: Plane
    usable: Flags


def usable_pixels(intensity: Plane, mask: Masks, low: float, high: float) -> Usable:
    """Select the usable pixels of an image, (n_rows, n_columns), as they are and bounded by `low` and `high`."""
    level, bounded = np.empty(mask.shape, dtype=np.float32), np.empty(mask.shape, dtype=np.float32)
    found = Usable(level, bounded, np.empty(mask.shape, dtype=np.bool_))
    if not call("waterfall_usable", mask.size, intensity, mask, low, high, *found):
        return usable_pixels_numpy(intensity, mask, low, high)
    return found


def usable_pixels_numpy(intensity: Plane, mask: Masks, low: float, high: float) -> Usable:
    """Do as usable_pixels, in numpy alone."""
    usable = (mask & (VALID | SATURATED)) == VALID
    bounded = np.clip(intensity, np.float32(low), np.float32(high))
    return Usable(np.where(usable, intensity, np.float32(0.0)), np.where(usable, bounded, np.float32(1.0)), usable)


def bright_spots(
    logarithms: Plane, usable: Flags, half: tuple[int, int], above: float, highest: float, slack: float
) -> tuple[NDArray[np.int32], Values]:
    """Find usable pixels whose logarithm, and `slack`, reaches its limit or `highest`, and those limits.

    A limit is the mean logarithm of the usable pixels within `half` rows and columns, and `above`. logarithms: 0 where
    not usable. Pixels are indices, row times n_columns plus column, int32, and rise; limits float64.
    """
    n_columns = usable.shape[1]
    room = np.empty(n_columns), np.empty(n_columns, dtype=np.uint8), *_box_room(n_columns, half[1])
    n_places, max_places = np.empty(1, dtype=np.int64), usable.size // _USUAL_SHARE_OF_BRIGHT + 1
    while True:
        places, limits = np.empty(max_places, dtype=np.int32), np.empty(max_places)
        rule, found = (above, highest, slack), (places, limits, n_places)
        if not call("waterfall_glints", *usable.shape, *half, logarithms, usable, *rule, *room, max_places, *found):
            return bright_spots_numpy(logarithms, usable, half, *rule)
        if n_places[0] <= max_places:
            return places[: n_places[0]], limits[: n_places[0]]
        max_places = int(n_places[0])


def bright_spots_numpy(
    logarithms: Plane, usable: Flags, half: tuple[int, int], above: float, highest: float, slack: float
) -> tuple[NDArray[np.int32], Values]:
    """Do as bright_spots, in numpy alone."""
    mean, _ = _box_means(logarithms, usable, half)
    limit = mean + above
    found = np.flatnonzero(usable & (logarithms + np.float64(slack) >= np.minimum(limit, highest)))
    return found.astype(np.int32), limit.ravel()[found]


class Levelled(NamedTuple):
    """Hold an image divided by its local mean.

    intensity: (n_rows, n_columns) float32, over its mean, 0 where that is not known or the pixel not VALID; mask: the
    same shape, uint8, VALID only where the mean is known. mean, float64, and known, bool: of some columns, (n_rows, n).
    """

    intensity: Plane
    mask: Masks
    mean: Values
    known: Flags


def box_level(level: Plane, usable: Flags, half: tuple[int, int], min_share: float) -> tuple[Values, Flags]:
    """Average the usable pixels within `half` rows and columns of each pixel, float64.

    Gives also where the mean is known. Of the box, clipped at the image's edge, min_share and one pixel at least must
    be usable, and the mean above 0. level: 0 where not usable.
    """
    n_columns = usable.shape[1]
    mean, known = np.empty(usable.shape), np.empty(usable.shape, dtype=np.bool_)
    planes, nothing = (level, usable, *_level_room(n_columns, half[1]), mean, known), (*[None] * 4, 0, *[None] * 3)
    if not call("waterfall_level", *usable.shape, *half, min_share, *planes, n_columns, *nothing):
        return box_level_numpy(level, usable, half, min_share)
    return mean, known


def box_level_numpy(level: Plane, usable: Flags, half: tuple[int, int], min_share: float) -> tuple[Values, Flags]:
    """Do as box_level, in numpy alone."""
    mean, count = _box_means(level, usable, half)
    rows, columns = (_clipped_length(length, reach) for length, reach in zip(usable.shape, half, strict=True))
    return mean, (count >= np.maximum(min_share * np.outer(rows, columns), 1.0)) & (mean > 0.0)


def divide_by_level(
    intensity: Plane,
    mask: Masks,
    level: Plane,
    usable: Flags,
    half: tuple[int, int],
    min_share: float,
    columns: NDArray[np.int64],
) -> Levelled:
    """Divide an image by the box_level around each pixel, which is written out for some `columns` only.

    Parameters
    ----------
    intensity, mask, level, usable
        (n_rows, n_columns).
    """
    n_rows, n_columns = usable.shape
    room, row = _level_room(n_columns, half[1]), (np.empty(n_columns), np.empty(n_columns, dtype=np.bool_))
    ratio, masked = np.empty(usable.shape, dtype=np.float32), np.empty(usable.shape, dtype=np.uint8)
    mean, known = np.empty((n_rows, columns.size)), np.empty((n_rows, columns.size), dtype=np.bool_)
    divided, some = (intensity, mask, ratio, masked), (columns.size, columns, mean, known)
    if not call("waterfall_level", n_rows, n_columns, *half, min_share, level, usable, *room, *row, 0, *divided, *some):
        return divide_by_level_numpy(intensity, mask, level, usable, half, min_share, columns)
    return Levelled(ratio, masked, mean, known)


def divide_by_level_numpy(
    intensity: Plane,
    mask: Masks,
    level: Plane,
    usable: Flags,
    half: tuple[int, int],
    min_share: float,
    columns: NDArray[np.int64],
) -> Levelled:
    """Do as divide_by_level, in numpy alone."""
    mean, known = box_level_numpy(level, usable, half, min_share)
    ratio = np.divide(intensity, mean, out=np.zeros(mask.shape), where=known & ((mask & VALID) != 0))
    masked = np.where(known, mask, mask & np.uint8(255 - VALID)).astype(np.uint8)
    return Levelled(ratio.astype(np.float32), masked, mean[:, columns], known[:, columns])


def _level_room(n_columns: int, half_columns: int) -> tuple[NDArray[Any], ...]:
    return np.empty(n_columns), *_box_room(n_columns, half_columns)


def _box_means(values: Plane, usable: Flags, half: tuple[int, int]) -> tuple[Values, NDArray[np.int32]]:
    count = _box_sums(usable, np.int32, half)
    return _box_sums(values, np.float64, half) * (1.0 / np.maximum(count, 1)), count


def _box_sums(plane: NDArray[Any], dtype: type, half: tuple[int, int]) -> NDArray[Any]:
    """Sum within half rows and columns of each pixel, by an integral image added up along rows and then down."""
    sums = np.zeros((plane.shape[0] + 1, plane.shape[1] + 1), dtype=dtype)
    np.cumsum(np.cumsum(plane, axis=1, dtype=dtype), axis=0, dtype=dtype, out=sums[1:, 1:])
    rows, columns = (np.arange(length) for length in plane.shape)
    band = sums[np.minimum(rows + half[0] + 1, len(rows))] - sums[np.maximum(rows - half[0], 0)]
    return np.asarray(
        band[:, np.minimum(columns + half[1] + 1, len(columns))] - band[:, np.maximum(columns - half[1], 0)]
    )


def _box_room(n_columns: int, half_columns: int) -> tuple[Values, NDArray[np.int32]]:
    """Make room for what a box holds."""
    wide = n_columns + 1 + 2 * (half_columns + 1)
    return np.empty(2 * (n_columns + 1) + wide + (_ROWS_SUMMED + 1) * n_columns), np.empty(
        2 * n_columns + wide, dtype=np.int32
    )


def _clipped_length(length: int, half: int) -> NDArray[np.int64]:
    position = np.arange(length)
    return np.minimum(position + half, length - 1) - np.maximum(position - half, 0) + 1
