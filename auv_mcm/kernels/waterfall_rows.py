"""Process every row of a waterfall one by one: overlapping pings, masks, medians, factors, angles.

C and numpy agree to the bit: all in numpy's order of operations; exponentials and angles, which no two libraries round
alike, are taken by numpy outside.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.kernels.signatures import call
from auv_mcm.records import LOW_RESOLUTION, SATURATED, TURN, VALID

Plane = NDArray[np.float32]
Values = NDArray[np.float64]
Flags = NDArray[np.bool_]
Masks = NDArray[np.uint8]
Rows = NDArray[np.int64]


class Turning(NamedTuple):
    """Hold the rotation per ping, (n_pings,).

    Pitch rate times altitude and yaw rate, over speed, float64; whether turning too fast, bool.
    """

    pitch: Values
    yaw: Values
    fast: Flags


def average_rows(
    intensity: Plane, mask: Masks, source: NDArray[np.int64], overlap: Values, min_overlap: float
) -> tuple[Plane, Masks]:
    """Average the pings that rows overlap, weighted by overlap.

    Returns intensity float32 and mask uint8, (n_rows, n_columns) each. A pixel is valid where valid pings overlap it by
    `min_overlap` together; it takes over all other flags, if it is not valid all but SATURATED.

    Parameters
    ----------
    intensity, mask
        (n_pings, n_columns).
    source, overlap
        (n_rows, n_steps), a ping's index and by how much a row overlaps it.
    """
    n_rows, n_steps = source.shape
    n_columns = mask.shape[1]
    total, weight = np.empty(n_columns), np.empty(n_columns)
    rows, row_mask = np.empty((n_rows, n_columns), dtype=np.float32), np.empty((n_rows, n_columns), dtype=np.uint8)
    given, room = (source, overlap, intensity, mask), (total, weight, rows, row_mask)
    if not call("waterfall_rows", n_rows, n_columns, n_steps, *given, min_overlap, *room):
        return average_rows_numpy(intensity, mask, source, overlap, min_overlap)
    return rows, row_mask


def average_rows_numpy(
    intensity: Plane, mask: Masks, source: NDArray[np.int64], overlap: Values, min_overlap: float
) -> tuple[Plane, Masks]:
    """Do as average_rows, in numpy alone."""
    n_rows, n_columns = source.shape[0], mask.shape[1]
    total, weight = np.zeros((n_rows, n_columns)), np.zeros((n_rows, n_columns))
    flags = np.zeros((n_rows, n_columns), dtype=np.uint8)
    for step in range(source.shape[1]):
        rows = np.flatnonzero(overlap[:, step] > 0.0)
        ping, length = source[rows, step], overlap[rows, step][:, np.newaxis]
        total[rows] += length * intensity[ping]
        weight[rows] += length * (mask[ping] & VALID)
        flags[rows] |= mask[ping] & (SATURATED | LOW_RESOLUTION | TURN)
    valid = weight >= min_overlap
    mean = np.divide(total, weight, out=np.zeros_like(total), where=valid)
    return mean.astype(np.float32), np.where(valid, flags | VALID, flags & (LOW_RESOLUTION | TURN)).astype(np.uint8)


def ping_masks(
    valid: Flags,
    saturated: Flags,
    turning: Turning,
    ground_m: Values,
    coarse: Masks,
    coarse_row: Rows,
    max_ratio: float,
) -> Masks:
    """Join what is known of each pixel to its mask, (n_pings, n_columns) uint8.

    TURN where spacing over its straight-line value, 1 + pitch + yaw y, is more than max_ratio either way or the ping
    turns too fast.

    Parameters
    ----------
    ground_m
        (n_columns,) ground range y, rising.
    coarse
        (n, n_columns), LOW_RESOLUTION or 0.
    coarse_row
        (n_pings,) the row each ping takes.
    """
    mask = np.empty(valid.shape, dtype=np.uint8)
    given = *turning, ground_m, coarse, coarse_row, valid, saturated
    if not call("waterfall_masks", *valid.shape, *given, max_ratio, mask):
        return ping_masks_numpy(valid, saturated, turning, ground_m, coarse, coarse_row, max_ratio)
    return mask


def ping_masks_numpy(
    valid: Flags,
    saturated: Flags,
    turning: Turning,
    ground_m: Values,
    coarse: Masks,
    coarse_row: Rows,
    max_ratio: float,
) -> Masks:
    """Do as ping_masks, in numpy alone."""
    mask = valid * np.uint8(VALID)
    mask |= saturated * np.uint8(SATURATED)
    mask |= coarse[coarse_row]
    ratio = 1.0 + turning.pitch[:, np.newaxis] + turning.yaw[:, np.newaxis] * ground_m[np.newaxis, [0, -1]]
    # The ratio rises or falls along the row: its ends bound all of it.
    turned = np.flatnonzero(((ratio > max_ratio) | (ratio * max_ratio < 1.0)).any(axis=1) | turning.fast)
    ratio = 1.0 + turning.pitch[turned, np.newaxis] + turning.yaw[turned, np.newaxis] * ground_m[np.newaxis, :]
    bent = (ratio > max_ratio) | (ratio * max_ratio < 1.0) | turning.fast[turned, np.newaxis]
    mask[turned] |= bent * np.uint8(TURN)
    return mask


def row_medians(values: Values, usable: Flags | None, minimum: int) -> Values:
    """Take the median of the usable values of each row, (n_rows,) float64.

    NaN where fewer than `minimum`, or none, are usable.

    Parameters
    ----------
    values
        (n_rows, n_columns) finite.
    usable
        The same shape, None where all are.
    """
    room, medians = np.empty(2 * values.shape[1] + 2), np.empty(values.shape[0])
    if not call("waterfall_medians", *values.shape, values, usable, minimum, room, medians):
        return row_medians_numpy(values, usable, minimum)
    return medians


def row_medians_numpy(values: Values, usable: Flags | None, minimum: int) -> Values:
    """Do as row_medians, in numpy alone."""
    n_rows, n_columns = values.shape
    if n_columns == 0:
        return np.full(n_rows, np.nan)
    if usable is None:
        middle = (n_columns - 1) // 2, n_columns // 2
        parted = np.partition(values, middle, axis=1)
        return 0.5 * (parted[:, middle[0]] + parted[:, middle[1]]) if n_columns >= minimum else np.full(n_rows, np.nan)
    count = usable.sum(axis=1)
    filled = np.where(usable, values, np.inf)
    filled.sort(axis=1)
    rows = np.arange(n_rows)
    low, high = np.maximum(count - 1, 0) // 2, np.minimum(count // 2, n_columns - 1)
    return np.where(count >= max(minimum, 1), 0.5 * (filled[rows, low] + filled[rows, high]), np.nan)


def raise_to_floor(values: Values, sure: Flags, share: float, least: float) -> None:
    """Raise values (n_rows, n_columns), not negative, to a share of the median of their row and `least` more, in place.

    What is not sure, bool of the same shape, becomes 1.
    """
    if not call("waterfall_floor", *values.shape, sure, share, least, np.empty(values.shape[1] + 1), values):
        raise_to_floor_numpy(values, sure, share, least)


def raise_to_floor_numpy(values: Values, sure: Flags, share: float, least: float) -> None:
    """Do as raise_to_floor, in numpy alone."""
    np.maximum(values, share * row_medians_numpy(values, None, 1)[:, np.newaxis] + least, out=values)
    values[~sure] = 1.0


def scale_rows(values: Values, factor: Values, factor_row: Rows) -> Plane:
    """Multiply values by factor[factor_row], (n_rows, n_columns) float32. factor: (n, n_columns)."""
    product = np.empty(values.shape, dtype=np.float32)
    if not call("waterfall_scale", *values.shape, values, factor, factor_row, product):
        return scale_rows_numpy(values, factor, factor_row)
    return product


def scale_rows_numpy(values: Values, factor: Values, factor_row: Rows) -> Plane:
    """Do as scale_rows, in numpy alone."""
    return (values * factor[factor_row]).astype(np.float32)


def angle_sums(
    angle: Values, angle_row: Rows, values: Values, usable: Flags, n_bins: int, centre: Values | None, clip: float
) -> tuple[NDArray[np.int64], Values]:
    """Count and sum the usable values in each of n_bins bins of angle, (n_bins,) each; the last takes all beyond.

    Parameters
    ----------
    angle
        (n, n_columns).
    angle_row
        (n_pings,) int64, the row each ping takes.
    values, usable
        (n_pings, n_columns).
    centre
        (n_bins,), taken off the values before they are clipped to +-clip; None for the values themselves.
    """
    scratch = np.empty(angle.shape[1], dtype=np.int32)
    count, total = np.empty(n_bins, dtype=np.int64), np.empty(n_bins)
    given = angle, angle_row, values, usable, centre
    if not call("waterfall_angle_sums", *values.shape, n_bins, *given, clip, scratch, count, total):
        return angle_sums_numpy(angle, angle_row, values, usable, n_bins, centre, clip)
    return count, total


def angle_sums_numpy(
    angle: Values, angle_row: Rows, values: Values, usable: Flags, n_bins: int, centre: Values | None, clip: float
) -> tuple[NDArray[np.int64], Values]:
    """Do as angle_sums, in numpy alone."""
    bins, chosen = np.minimum(angle.astype(np.intp), n_bins - 1)[angle_row][usable], values[usable]
    if centre is not None:
        chosen = np.clip(chosen - centre[bins], -clip, clip)
    return np.bincount(bins, minlength=n_bins).astype(np.int64), np.bincount(
        bins, weights=chosen, minlength=n_bins
    ).astype(np.float64)


def along_curve(angle: Values, bins: NDArray[np.intp], level: Values) -> Values:
    """Interpolate linearly at angles >= 0 between levels (n,) at the middles of bins (n,).

    Bins are whole and rising; ends count for what lies beyond.
    """
    middle = bins + 0.5
    slope = (level[1:] - level[:-1]) / (middle[1:] - middle[:-1])
    place, curve = np.empty(int(bins[-1]) + 2, dtype=np.int32), np.empty(angle.shape)
    if not call("waterfall_curve", angle.size, angle, len(bins), bins, level, slope, place, curve):
        return along_curve_numpy(angle, bins, level)
    return curve


def along_curve_numpy(angle: Values, bins: NDArray[np.intp], level: Values) -> Values:
    """Do as along_curve, in numpy alone."""
    return np.asarray(np.interp(angle, bins + 0.5, level))
