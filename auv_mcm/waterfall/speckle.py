"""Measure what speckle does to recorded samples, apart from the sea floor's own texture.

Texture changes little from one ping to the next at the same range; speckle is drawn anew. So cumulants are measured inside windows of four
pings at one range sample, by unbiased estimators (k-statistics: Kendall and Stuart, The Advanced Theory of Statistics, vol. 1, ch. 12), and
averaged over a region of 16 pings by a fortieth of the trace. What texture is left makes a region uneven, so only the most even regions
count. They are chosen by one half of their windows and measured by the other half, as a region chosen by the very numbers that are measured
would look more even than it is. Speckle that lasts over several pings is met by windows of every second or fourth ping.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

BLOCK_PINGS: Final = 16  # four windows of four pings, at strides of 1, 2 or 4 pings
_WINDOW_PINGS: Final = 4
_STRIDES: Final = (2, 4)
_TRACE_PARTS: Final = 40
_MIN_PART_SAMPLES: Final = 16
_MIN_REGIONS: Final = 24
_EVEN_SHARE: Final = 0.1  # about what water column and noise take up, so that an even region can be had over any sea floor
_MIN_EVEN: Final = 8
_EVEN_LEVEL: Final = 1.05  # of the variance of the most even tenth, below which any other region counts as even, too
# Of both ends of what regions show, of samples over their mean and of logarithms: a fish or a target is in few of them. Linear samples
# have the longer tails.
_RELATIVE_TRIM: Final = 0.1
_LOG_TRIM: Final = 0.03
_N_GROUPS: Final = 8
_SIGMA_PER_MAD: Final = 1.4826  # of a normal distribution
_MAX_GROWTH: Final = 1.12  # of the variance from one stride to the next, beyond which speckle is taken to last from ping to ping
_CLIPPED_SHARE: Final = 0.003  # of a region's samples at the highest or lowest count: beyond it, the tail that skewness lives on is lost
_REPEATED_SHARE: Final = 0.05  # at a region's own highest count: a ceiling below the record's highest
# Logarithmic speckle goes far below its mean (of a single look, one sample in 1000 by more than 4.5 std). Where that is cut off at zero,
# skewness is lost, and the region looks the more even for it.
_TAIL_STD: Final = (5.0, 4.0, 3.0)  # above zero: as far as enough regions are
_TAIL_SHARE: Final = 0.1  # of all regions, that are enough
_ZERO_SHARE: Final = 0.25  # small linear counts round to zero, which Sheppard's correction allows for; more of them are a floor
_MIN_COUNT: Final = 3.0  # mean, below which rounding hides how a linear count is spread
_ROUNDING_VARIANCE: Final = 1.0 / 12.0  # of integers (Sheppard's correction)
_LEVEL_BINS: Final = 8
_LEVEL_SIGMA: Final = 0.15  # nats that the spread of even regions of one level differs by, measured on simulated floors
_MAX_SAMPLE: Final = 1e19
_TINY: Final = 1e-80  # of floating-point samples: cubes below that underflow


class RegionTable(NamedTuple):
    """Statistics of n regions.

    mean: (n,) counts. cumulants: (n_strides, n, 2, 2) float64, by stride, region and half of its windows: second and third.
    highest: (n,) counts. at_highest, at_zero: (n,) share of samples. place: (n,) side and range, increasing.
    """

    mean: NDArray[np.float64]
    cumulants: NDArray[np.float64]
    highest: NDArray[np.float64]
    at_highest: NDArray[np.float64]
    at_zero: NDArray[np.float64]
    place: NDArray[np.int64]


class Regions(NamedTuple):
    """The regions of one block of pings. integer: counts are integers. lowest, percentile_1, percentile_99: counts, of the block."""

    table: RegionTable
    integer: bool
    lowest: float
    percentile_1: float
    percentile_99: float


class Shape(NamedTuple):
    """Standard deviation and skewness of the most even regions.

    *_sigma: 1-sigma from how groups of regions differ; log_std_sigma: of ln std.
    """

    std: float
    skewness: float
    log_std_sigma: float
    skewness_sigma: float


class Speckle(NamedTuple):
    """Hold the speckle statistics of several blocks.

    relative: of samples over their local mean; absolute: of the samples themselves, counts; None where too little of the record can be
    used. slope, slope_sigma: of ln std against ln mean over all levels, 1 where the spread grows with the mean, 0 where it does not; sigma
    is infinite where it could not be seen. n_regions: those that could be used. highest: count. span_counts: from the 1st to the 99th
    percentile of all samples. negative: some samples are below zero.
    """

    relative: Shape | None
    absolute: Shape | None
    slope: float
    slope_sigma: float
    n_regions: int
    highest: float
    span_counts: float
    negative: bool


def measure_regions(sides: Sequence[NDArray[Any]]) -> Regions:
    """Measure a block of pings: sides of (16, n_samples) samples each, of any real type, near to far.

    Regions with samples that are not finite, or beyond 1e19, are left out.
    """
    parts = [_measure_side(samples, side) for side, samples in enumerate(sides)]
    lows, highs, lowest = [], [], []
    for samples in sides:
        usable = samples[np.isfinite(samples)] if samples.dtype.kind == "f" else samples
        if usable.size:
            low, high = np.quantile(usable, (0.01, 0.99))
            lows.append(float(low))
            highs.append(float(high))
            lowest.append(float(usable.min()))
    return Regions(
        _joined(parts),
        integer=all(samples.dtype.kind in "ui" for samples in sides),
        lowest=min(lowest, default=0.0),
        percentile_1=min(lows, default=0.0),
        percentile_99=max(highs, default=0.0),
    )


def _joined(tables: Sequence[RegionTable]) -> RegionTable:
    return RegionTable(
        np.concatenate([table.mean for table in tables]),
        np.concatenate([table.cumulants for table in tables], axis=1),
        np.concatenate([table.highest for table in tables]),
        np.concatenate([table.at_highest for table in tables]),
        np.concatenate([table.at_zero for table in tables]),
        np.concatenate([table.place for table in tables]),
    )


def _measure_side(samples: NDArray[Any], side: int) -> RegionTable:
    n_part = max(samples.shape[1] // _TRACE_PARTS, _MIN_PART_SAMPLES)
    # The first part holds the transmitter's ring-down.
    n_parts = max(samples.shape[1] // n_part - 1, 0)
    x = samples[:BLOCK_PINGS, n_part : (n_parts + 1) * n_part].astype(np.float64)
    by_region = x.reshape(BLOCK_PINGS, n_parts, n_part).transpose(1, 0, 2).reshape(n_parts, BLOCK_PINGS * n_part)
    kept = (np.abs(by_region) <= _MAX_SAMPLE).all(axis=1)
    by_region = by_region[kept]
    highest = by_region.max(axis=1, initial=-np.inf)
    cumulants = np.empty((len(_STRIDES), len(by_region), 2, 2))
    columns = by_region.reshape(-1, BLOCK_PINGS, n_part)
    for index, stride in enumerate(_STRIDES):
        # Windows of pings i, i + stride, i + 2 stride, i + 3 stride: (n_regions, 4 windows, 4 pings, n_part).
        windows = columns.reshape(-1, BLOCK_PINGS // (_WINDOW_PINGS * stride), _WINDOW_PINGS, stride, n_part).swapaxes(2, 3)
        windows = windows.reshape(-1, BLOCK_PINGS // _WINDOW_PINGS, _WINDOW_PINGS, n_part)
        deviation = windows - windows.mean(axis=2, keepdims=True)
        squared = deviation * deviation
        second = squared.sum(axis=2) / (_WINDOW_PINGS - 1)
        third = (squared * deviation).sum(axis=2) * (_WINDOW_PINGS / ((_WINDOW_PINGS - 1) * (_WINDOW_PINGS - 2)))
        for half in range(2):
            cumulants[index, :, half, 0] = second[:, half::2].mean(axis=(1, 2))
            cumulants[index, :, half, 1] = third[:, half::2].mean(axis=(1, 2))
    size = BLOCK_PINGS * n_part
    return RegionTable(
        by_region.mean(axis=1) if len(by_region) else np.zeros(0),
        cumulants,
        highest,
        (by_region == highest[:, None]).sum(axis=1) / size,
        (by_region == 0.0).sum(axis=1) / size,
        side * _TRACE_PARTS * 2 + np.flatnonzero(kept),
    )


def summarise(blocks: Sequence[Regions]) -> Speckle:
    """Join what several blocks of one recorder show."""
    if not blocks:
        return Speckle(None, None, 0.0, np.inf, 0, 0.0, 0.0, negative=False)
    joined = _joined([block.table for block in blocks])
    integer = all(block.integer for block in blocks)
    span = np.median([block.percentile_99 for block in blocks]) - np.median([block.percentile_1 for block in blocks])
    highest = float(joined.highest.max(initial=0.0))
    # Floating-point samples repeat their highest where a driver clips them, too; single ones are no ceiling.
    clipped = ((joined.highest >= highest) & (joined.at_highest > _CLIPPED_SHARE)) | (joined.at_highest > _REPEATED_SHARE)
    cumulants = joined.cumulants
    if integer:
        cumulants = cumulants - np.array([_ROUNDING_VARIANCE, 0.0])
    varied = (cumulants[..., 0] > (1.0 if integer else _TINY**2)).all(axis=(0, 2))
    # A constant region leaves rounding errors only.
    varied &= cumulants[0, :, :, 0].min(axis=1) > 1e-18 * joined.highest**2
    linear = varied & ~clipped & (joined.at_zero <= _ZERO_SHARE) & (joined.mean > (_MIN_COUNT if integer else _TINY))
    logarithmic = varied & ~clipped
    if integer:
        above_zero = joined.mean / np.sqrt(np.maximum(cumulants[0, :, :, 0].mean(axis=1), 1.0))
        logarithmic &= joined.at_zero <= _CLIPPED_SHARE
        for n_std in _TAIL_STD:
            with_tail = logarithmic & (above_zero > n_std)
            if np.count_nonzero(with_tail) >= _TAIL_SHARE * len(with_tail):
                break
        logarithmic = with_tail
    slope, slope_sigma = _slope(joined.mean[linear], cumulants[0, linear, :, 0].mean(axis=1))
    return Speckle(
        _shape(cumulants[:, linear], joined.mean[linear], joined.place[linear], _RELATIVE_TRIM),
        _shape(cumulants[:, logarithmic], np.ones(int(logarithmic.sum())), joined.place[logarithmic], _LOG_TRIM),
        slope,
        slope_sigma,
        int(np.count_nonzero(linear | logarithmic)),
        highest,
        float(span),
        negative=min(block.lowest for block in blocks) < 0.0,
    )


def _shape(cumulants: NDArray[np.float64], unit: NDArray[np.float64], place: NDArray[np.int64], trim: float) -> Shape | None:
    """Shape of samples over `unit` (n,) in the most even regions; cumulants (n_strides, n, 2, 2)."""
    if len(unit) < _MIN_REGIONS:
        return None
    shapes = [_shape_at(each, unit, place, trim) for each in cumulants]
    for index in range(len(shapes) - 1):
        if shapes[index + 1].std ** 2 < _MAX_GROWTH * shapes[index].std ** 2:
            return shapes[index]
    return shapes[-1]


def _shape_at(cumulants: NDArray[np.float64], unit: NDArray[np.float64], place: NDArray[np.int64], trim: float) -> Shape:
    scaled = cumulants / np.stack([unit**2, unit**3], axis=-1)[:, None, :]
    n_even = min(max(round(_EVEN_SHARE * len(unit)), _MIN_EVEN), len(unit))
    level = np.mean([_trimmed(scaled[_lowest(scaled[:, half, 0], n_even), 1 - half], trim)[0] for half in range(2)])
    chosen, places = [], []
    for half in range(2):
        by = scaled[:, half, 0]
        even = np.flatnonzero(by <= _EVEN_LEVEL * level)
        if len(even) < n_even:
            even = _lowest(by, n_even)
        chosen.append(scaled[even, 1 - half])
        places.append(place[even])
    values = np.concatenate(chosen)[np.argsort(np.concatenate(places), kind="stable")]
    second, third = _trimmed(values, trim)
    groups = np.array([_trimmed(group, trim) for group in np.array_split(values, _N_GROUPS)])
    return Shape(
        float(np.sqrt(second)),
        float(third / second**1.5),
        0.5 * _error_of_mean(np.log(groups[:, 0])),
        _error_of_mean(groups[:, 1] / groups[:, 0] ** 1.5),
    )


def _lowest(values: NDArray[np.float64], n: int) -> NDArray[np.int64]:
    return np.sort(np.argpartition(values, n - 1)[:n])


def _error_of_mean(groups: NDArray[np.float64]) -> float:
    """1-sigma of the mean of values of groups, from their median absolute deviation: one group may hold a wreck."""
    deviation = np.median(np.abs(groups - np.median(groups)))
    return float(_SIGMA_PER_MAD * deviation / np.sqrt(len(groups) - 1))


def _trimmed(values: NDArray[np.float64], trim: float) -> NDArray[np.float64]:
    """Trimmed mean of each column of (n, 2) values."""
    cut = int(trim * len(values))
    return np.asarray(np.sort(values, axis=0)[cut : len(values) - cut].mean(axis=0))


def _slope(mean: NDArray[np.float64], variance: NDArray[np.float64]) -> tuple[float, float]:
    """Slope of ln std against ln mean over the more even regions of each level, and its 1-sigma."""
    if len(mean) < _MIN_REGIONS:
        return 0.0, np.inf
    level, spread = np.log(mean), 0.5 * np.log(variance)
    order = np.argsort(level, kind="stable")
    bins = np.array_split(order, _LEVEL_BINS)
    x = np.array([np.median(level[part]) for part in bins])
    y = np.array([np.quantile(spread[part], 0.2) for part in bins])
    x = x - x.mean()
    scatter = float(x @ x)
    if scatter <= 0.0:
        return 0.0, np.inf
    slope = float(x @ y) / scatter
    residual = y - y.mean() - slope * x
    variance_of_y = _LEVEL_SIGMA**2 + float(residual @ residual) / (_LEVEL_BINS - 2)
    return slope, float(np.sqrt(variance_of_y / scatter))
