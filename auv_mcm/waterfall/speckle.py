"""Summarise what speckle does to recorded samples, apart from the sea floor's own texture.

Two kinds of places show it: the most even regions (`even`), whatever the law, and cells that hold only noise
(`quiet`), where a logarithm's speckle can be seen without any texture.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.kernels.ping_windows import STRIDES
from auv_mcm.waterfall.even import log_shape, relative_shape
from auv_mcm.waterfall.quiet import quiet_shapes
from auv_mcm.waterfall.regions import Regions, join_tables
from auv_mcm.waterfall.shape import Shape

_STRIDE_TWO: Final = STRIDES.index(2)
# Of a region's samples at the highest or lowest count: beyond it, the tail that skewness lives on is lost.
_CLIPPED_SHARE: Final = 0.003
_REPEATED_SHARE: Final = 0.05  # at a region's own highest count: a ceiling below the record's highest
# Logarithmic speckle goes far below its mean (of a single look, one sample in 1000 by more than 4.5 std). Where that is
# cut off at zero, skewness is lost, and the region looks the more even for it.
_TAIL_STD: Final = (5.0, 4.0, 3.0)  # above zero: as far as enough regions are
_TAIL_SHARE: Final = 0.1  # of all regions, that are enough
# Small linear counts round to zero, which Sheppard's correction allows for; more of them are a floor.
_ZERO_SHARE: Final = 0.25
_MIN_COUNT: Final = 3.0  # mean, below which rounding hides how a linear count is spread
_ROUNDING_VARIANCE: Final = 1.0 / 12.0  # of integers (Sheppard's correction)
_MIN_VARIANCE: Final = 1.0  # counts squared, of integers
_MIN_REGIONS: Final = 24
_LEVEL_BINS: Final = 8
_LEVEL_SIGMA: Final = 0.15  # nats that the spread of even regions of one level differs by, measured on simulated floors
_TINY: Final = 1e-80  # of floating-point samples: cubes below that underflow


class Speckle(NamedTuple):
    """Hold the speckle statistics of several blocks.

    relative: of samples over their local mean in even regions; absolute: of the samples themselves, counts, without
    texture; None where too little of the record can be used. quiet: of samples in cells that hold noise alone, by
    level; may be empty. slope, slope_sigma: of ln std against ln mean over all levels, 1 where the spread grows with
    the mean, 0 where it does not; sigma is infinite where it could not be seen. n_regions: those that could be used.
    highest: count. span_counts: from the 1st to the 99th percentile of all samples. negative: some samples are below
    zero.
    """

    relative: Shape | None
    absolute: Shape | None
    quiet: tuple[Shape, ...]
    slope: float
    slope_sigma: float
    n_regions: int
    highest: float
    span_counts: float
    negative: bool


def summarise(blocks: Sequence[Regions]) -> Speckle:
    """Join what several blocks of one recorder show."""
    if not blocks:
        return Speckle(None, None, (), 0.0, np.inf, 0, 0.0, 0.0, negative=False)
    joined = join_tables([block.table for block in blocks])
    integer = all(block.integer for block in blocks)
    lowest = min(block.lowest for block in blocks)
    span = np.median([block.percentile_99 for block in blocks]) - np.median([block.percentile_1 for block in blocks])
    highest = float(joined.highest.max(initial=0.0))
    # Floating-point samples repeat their highest where a driver clips them, too; single ones are no ceiling.
    clipped = (joined.highest >= highest) & (joined.at_highest > _CLIPPED_SHARE)
    clipped |= joined.at_highest > _REPEATED_SHARE
    cumulants = joined.cumulants - np.array([_ROUNDING_VARIANCE, 0.0]) if integer else joined.cumulants
    min_variance = _MIN_VARIANCE if integer else _TINY**2
    share = joined.cell_share
    halves = (cumulants * share[:, :, None, None]).sum(axis=2)
    # Windows of neighbouring pings share pings, whatever half they are in; cells of range share next to no speckle.
    by_cell = cumulants.mean(axis=3)
    by_cells = np.stack([_over_cells(by_cell[:, :, first::2], share[:, first::2]) for first in range(2)], axis=2)
    mean, at_zero = (joined.mean * share).sum(axis=1), (joined.at_zero * share).sum(axis=1)
    variance = halves[_STRIDE_TWO, :, :, 0]
    varied = (halves[..., 0] > min_variance).all(axis=(0, 2))
    # A constant region leaves rounding errors only.
    varied &= variance.min(axis=1) > 1e-18 * joined.highest**2
    linear = varied & ~clipped & (at_zero <= _ZERO_SHARE) & (mean > (_MIN_COUNT if integer else _TINY))
    logarithmic = varied & ~clipped
    if integer:
        above_zero = mean / np.sqrt(np.maximum(variance.mean(axis=1), 1.0))
        logarithmic &= at_zero <= _CLIPPED_SHARE
        for n_std in _TAIL_STD:
            with_tail = logarithmic & (above_zero > n_std)
            if np.count_nonzero(with_tail) >= _TAIL_SHARE * len(with_tail):
                break
        logarithmic = with_tail
    is_cut = integer and lowest >= 0.0
    slope, slope_sigma = _slope(mean[linear], variance[linear].mean(axis=1))
    return Speckle(
        relative_shape(halves[:, linear], mean[linear], joined.place[linear]),
        log_shape(by_cells[:, logarithmic], mean[logarithmic], joined.place[logarithmic], is_cut=is_cut),
        quiet_shapes(blocks, joined, by_cell, min_variance, is_cut=is_cut),
        slope,
        slope_sigma,
        int(np.count_nonzero(linear | logarithmic)),
        highest,
        float(span),
        negative=lowest < 0.0,
    )


def _over_cells(cumulants: NDArray[np.float64], share: NDArray[np.float64]) -> NDArray[np.float64]:
    """Average cumulants (n_strides, n, n_cells, 2) over cells by their share (n, n_cells) of samples."""
    return np.asarray((cumulants * share[:, :, None]).sum(axis=2) / share.sum(axis=1, keepdims=True))


def _slope(mean: NDArray[np.float64], variance: NDArray[np.float64]) -> tuple[float, float]:
    """Fit the slope of ln std against ln mean over the more even regions of each level, and its 1-sigma."""
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
