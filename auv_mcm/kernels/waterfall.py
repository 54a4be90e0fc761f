"""Process every ping and every row of a waterfall: sums along range, means between ranges, steps, boxes, masks.

All in numpy's order of operations; logarithms, exponentials and angles, which no two libraries round alike, are taken
by numpy outside.

C and numpy agree to the bit.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.kernels.signatures import call
from auv_mcm.records import LOW_RESOLUTION, SATURATED, TURN, VALID

Plane = NDArray[np.float32]
Values = NDArray[np.float64]
Flags = NDArray[np.bool_]
Masks = NDArray[np.uint8]
Rows = NDArray[np.int64]

_ROWS_SUMMED: Final = 8  # 2 ROWS_TOGETHER of waterfall.c
_USUAL_SHARE_OF_BRIGHT: Final = (
    16  # one pixel in so many has room at first: large arrays that are hardly used cost page faults
)


class Sampled(NamedTuple):
    """Hold traces as cumulative sums (n_pings, n_samples + 1) float64, up to each sample's near edge.

    intensity: of valid samples. weight: of validity, None where every sample is valid. clipped: of clipping, None where
    no sample is; may end after fewer samples where none beyond is clipped. first_m: slant range of the middle of sample
    0; spacing_m: between samples.
    """

    intensity: Values
    weight: Values | None
    clipped: Values | None
    first_m: float
    spacing_m: float


class Turning(NamedTuple):
    """Hold the rotation per ping, (n_pings,).

    Pitch rate times altitude and yaw rate, over speed, float64; whether turning too fast, bool.
    """

    pitch: Values
    yaw: Values
    fast: Flags


def sums_to_the_end(values: Plane) -> Values:
    """Sum (n_rows, n_columns) values from each column to the last, negated.

    (n_rows, n_columns + 1) float64, added up from there.
    """
    sums = np.empty((values.shape[0], values.shape[1] + 1))
    return sums if call("waterfall_sums", *values.shape, values, sums) else sums_to_the_end_numpy(values)


def sums_to_the_end_numpy(values: Plane | Flags) -> Values:
    """Do as sums_to_the_end, in numpy alone."""
    total = np.empty((values.shape[0], values.shape[1] + 1))
    total[:, -1] = 0.0
    np.cumsum(values[:, ::-1], axis=1, dtype=np.float64, out=total[:, -2::-1])
    return np.negative(total, out=total)


def sums_of_counts(counts: NDArray[Any], intensity: Plane) -> Values:
    """Apply sums_to_the_end to intensity[counts].

    Parameters
    ----------
    counts
        (n_rows, n_columns) uint8 or uint16.
    intensity
        (256,) or (65536,) float32, of every count.
    """
    sums = np.empty((counts.shape[0], counts.shape[1] + 1))
    name = f"waterfall_sums_of_{'bytes' if counts.itemsize == 1 else 'words'}"
    if not call(name, *counts.shape, counts, intensity, sums):
        return sums_to_the_end_numpy(intensity[counts])
    return sums


def means(traces: Sampled, edges_m: Values, edge_row: Rows) -> tuple[Values, Flags, Flags]:
    """Average intensity between neighbouring slant ranges.

    Returns three planes (n_pings, n_edges - 1): mean intensity, 0 where not valid; whether valid samples cover half;
    whether clipped samples are a quarter of those.

    Parameters
    ----------
    edges_m
        (n, n_edges), rising along rows.
    edge_row
        (n_pings,) int64, the row each ping takes.
    """
    n_pings, n_edges = traces.intensity.shape[0], edges_m.shape[1]
    scratch = np.empty(n_edges, dtype=np.int32), np.empty((6, n_edges)), np.empty(n_edges, dtype=np.uint8)
    shape = (n_pings, n_edges - 1)
    found = np.empty(shape), np.empty(shape, dtype=np.bool_), np.empty(shape, dtype=np.bool_)
    n_clipped = 0 if traces.clipped is None else traces.clipped.shape[1] - 1
    grid = traces.first_m, 1.0 / traces.spacing_m
    numbers = n_pings, traces.intensity.shape[1] - 1, n_edges
    if (
        traces.intensity.shape[1] < 2
        or not call(  # C needs samples
            "waterfall_means", *numbers, *traces[:3], n_clipped, *grid, edges_m, edge_row, *scratch, *found
        )
    ):
        return means_numpy(traces, edges_m, edge_row)
    return found


def means_numpy(traces: Sampled, edges_m: Values, edge_row: Rows) -> tuple[Values, Flags, Flags]:
    """Do as means, in numpy alone."""
    n_pings, n_samples = traces.intensity.shape[0], traces.intensity.shape[1] - 1
    position = (edges_m - traces.first_m) * (1.0 / traces.spacing_m) + 0.5
    width = np.diff(position, axis=1)[edge_row]
    np.clip(position, 0.0, float(n_samples), out=position)
    sample = np.minimum(position.astype(np.intp), n_samples - 1)
    fraction = position - sample
    sampled = np.diff(fraction + sample, axis=1)[edge_row]
    sample, fraction = sample[edge_row], fraction[edge_row]
    ping = np.arange(n_pings)[:, np.newaxis]

    def difference(sums: Values) -> Values:
        last = sums.shape[1] - 1
        low, high = sums[ping, np.minimum(sample, last)], sums[ping, np.minimum(sample + 1, last)]
        return np.diff(low + fraction * (high - low), axis=1)

    weight = sampled if traces.weight is None else difference(traces.weight)
    valid = (weight >= 0.5 * width) & (weight > 1e-9)
    intensity = np.divide(difference(traces.intensity), weight, out=np.zeros(valid.shape), where=valid)
    saturated = (
        np.zeros(valid.shape, dtype=np.bool_) if traces.clipped is None else difference(traces.clipped) > 0.25 * weight
    )
    return intensity, valid, saturated & valid


def pull_to_reading(score: Values, altitude_m: Values, bin_m: float, ratio: float, gate: float, pull: float) -> None:
    """Lower scores (n_pings, n_bins) of slant ranges that an altitude reading speaks against, in place.

    By `gate` beyond `ratio` of it either way, and everywhere by `pull` per nat between range and reading: where no step
    shows, only the reading is left. The same to the bit where numpy takes logarithms from the C library.

    Parameters
    ----------
    altitude_m
        (n_pings,), NaN where unknown.
    bin_m
        Of slant range, of a bin.
    """
    if not call("waterfall_pull", *score.shape, altitude_m, bin_m, ratio, gate, pull, score):
        pull_to_reading_numpy(score, altitude_m, bin_m, ratio, gate, pull)


def pull_to_reading_numpy(
    score: Values, altitude_m: Values, bin_m: float, ratio: float, gate: float, pull: float
) -> None:
    """Do as pull_to_reading, in numpy alone."""
    known = np.flatnonzero(np.isfinite(altitude_m) & (altitude_m > 0.0))
    range_m, reading_m = np.arange(score.shape[1]) * bin_m, altitude_m[known, np.newaxis]
    outside = (range_m > ratio * reading_m) | (range_m * ratio < reading_m)
    score[known] = score[known] - gate * outside - np.abs(np.log(np.maximum(range_m, bin_m) / reading_m)) * pull


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


def scale_rows(values: Values, factor: Values, factor_row: Rows) -> Plane:
    """Multiply values by factor[factor_row], (n_rows, n_columns) float32. factor: (n, n_columns)."""
    product = np.empty(values.shape, dtype=np.float32)
    if not call("waterfall_scale", *values.shape, values, factor, factor_row, product):
        return scale_rows_numpy(values, factor, factor_row)
    return product


def scale_rows_numpy(values: Values, factor: Values, factor_row: Rows) -> Plane:
    """Do as scale_rows, in numpy alone."""
    return (values * factor[factor_row]).astype(np.float32)


def step_ratios(
    values: Values, valid: Flags, blank: int, window: int, min_step: float, twice_variance: float
) -> Values:
    """Compute how much likelier a rise of the mean is at each bin than none, (n_pings, n_bins) float64.

    0 where it cannot be.

    Means are over the valid values of `window` bins from the bin on, of as many before it, and of all from bin `blank`
    on up to it. The first must rise over the second, three of which are valid, and by min_step over the third.
    twice_variance: of single values.
    """
    n_pings, n_bins = values.shape
    score, total, count = np.zeros((n_pings, n_bins)), np.empty(n_bins + 1), np.empty(n_bins + 1)
    rule = blank, window, min_step, twice_variance
    if not call("waterfall_steps", n_pings, n_bins, values, valid, *rule, total, count, score):
        return step_ratios_numpy(values, valid, *rule)
    return score


def step_ratios_numpy(
    values: Values, valid: Flags, blank: int, window: int, min_step: float, twice_variance: float
) -> Values:
    """Do as step_ratios, in numpy alone."""
    n_pings, n_bins = values.shape
    score = np.zeros((n_pings, n_bins))
    first, last = blank + 3, n_bins - window
    if last <= first:
        return score
    total = np.zeros((n_pings, n_bins + 1))
    count = np.zeros((n_pings, n_bins + 1))
    np.cumsum(np.where(valid, values, 0.0), axis=1, out=total[:, 1:])
    np.cumsum(valid, axis=1, out=count[:, 1:])
    bins = np.arange(first, last)

    def mean_of(start: NDArray[np.intp], stop: NDArray[np.intp]) -> tuple[Values, Values]:
        n = count[:, stop] - count[:, start]
        return (total[:, stop] - total[:, start]) / np.maximum(n, 1.0), n

    after, n_after = mean_of(bins, bins + window)
    near, n_near = mean_of(np.maximum(bins - window, blank), bins)
    column, _ = mean_of(np.full_like(bins, blank), bins)
    rise = after - near
    ratio = n_near * n_after / np.maximum(n_near + n_after, 1.0) * rise**2 / twice_variance
    step = (rise > 0.0) & (after - column > min_step) & (n_near >= 3) & (n_after >= 0.5 * window)
    score[:, first:last] = np.where(step, ratio, 0.0)
    return score


def add_votes(score: Values, ratios: Values, share: float, vote: float, evidence: float) -> None:
    """Add each ping's ratios times share to its score, both (n_pings, n_bins), with `vote` for the highest of a ping.

    Where that is less than `evidence`, `vote` is what `evidence` would get.
    """
    rule = share, vote, evidence
    if not score.flags.c_contiguous or not call("waterfall_votes", *score.shape, ratios, *rule, score):
        add_votes_numpy(score, ratios, *rule)


def add_votes_numpy(score: Values, ratios: Values, share: float, vote: float, evidence: float) -> None:
    """Do as add_votes, in numpy alone."""
    side = share * ratios
    score += side * (vote / np.maximum(side.max(axis=1, keepdims=True), evidence))


def average_rows(
    intensity: Plane, mask: Masks, source: NDArray[np.int64], overlap: Values, min_overlap: float
) -> tuple[Plane, Masks]:
    """Average the pings that rows overlap, weighted by overlap.

    Returns intensity float32 and mask uint8, (n_rows, n_columns) each.

    A pixel is valid where valid pings overlap it by `min_overlap` together; it takes over all other flags, if it is not
    valid all but SATURATED.

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
    found = np.flatnonzero(usable & (logarithms + slack >= np.minimum(limit, highest)))
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

    Gives also where the mean is known.

    Of the box, clipped at the image's edge, min_share and one pixel at least must be usable, and the mean above 0.
    level: 0 where not usable.
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
    slope = np.diff(level) / np.diff(middle)
    last = int(max(angle.max(initial=0.0), 0.0)) + 2
    place = (np.searchsorted(bins, np.arange(-1, last), side="right") - 1).astype(np.int32)
    curve = np.empty(angle.shape)
    if not call("waterfall_curve", angle.size, angle, middle, level, len(bins), slope, place, curve):
        return along_curve_numpy(angle, bins, level)
    return curve


def along_curve_numpy(angle: Values, bins: NDArray[np.intp], level: Values) -> Values:
    """Do as along_curve, in numpy alone."""
    return np.asarray(np.interp(angle, bins + 0.5, level))


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
