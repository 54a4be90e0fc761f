"""Measure the spread and the skewness of recorded samples where the sea floor is most even.

Samples are compared along the track at one range, a few pings apart, so that a floor that changes slowly adds little.
The most even third of all regions is taken, chosen by one half of their pings and measured by the other half, as a
region chosen by the very numbers that are measured would look more even than it is. Speckle that is correlated over
neighbouring samples or pings, and texture finer than a few pings, leave both numbers usable: neither is compared with
a law of pure speckle.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.records import NAN
from auv_mcm.waterfall.regions import Regions, join_tables

Floats = NDArray[np.float64]

_EVEN_SHARE: Final = 1.0 / 3.0  # of regions; on ripples and stones a third still lies between them. Chosen
_TRIM: Final = 0.05  # share of regions left out at either end: a fish or a wreck. Chosen
_STRUCK: Final = 4.0
"""Relative variance over that of the quarter that has least, from which pulses of another sonar strike a region. Of
even regions of recorded lines and drawn missions 3 % are beyond at the most, 8 to 58 % where there is one."""
_WHOLE: Final = 2.0  # relative variance over that of the tenth that has least, up to which none strikes a region
_MIN_REGIONS: Final = 24  # that anything is measured from: four pairs of blocks of pings, six regions each. Chosen
_CLIPPED_SHARE: Final = 0.05  # of a region's samples at its highest count, from which its tail is lost. Chosen
_MIN_COUNT: Final = 3.0  # mean count of integers, below which rounding hides how they are spread. Chosen
_ZERO_SHARE: Final = 0.25  # of a region's samples at zero, above which they are a floor. Chosen
_ROUNDING_VARIANCE: Final = 1.0 / 12.0  # counts squared, of integers (Sheppard's correction)
_TINY: Final = 1e-18  # of the highest count squared: rounding errors of a constant region
_LOWEST_VARIANCE: Final = 1e-160  # counts squared, below which cubes underflow
_LEVEL_BINS: Final = 8  # of regions by level, along which the spread may grow. Chosen


class FloorSpeckle(NamedTuple):
    """Hold spread and skewness of samples over the most even sea floor.

    relative_spread, relative_skewness: of samples over their local mean. spread_counts, skewness: of the samples
    themselves. growth: slope of ln spread against ln mean over regions of all levels, 1 where the spread grows with the
    mean, 0 where it does not. level_nats: standard deviation of ln mean over those regions. span_counts: from the 1st
    to the 99th percentile of all samples. n_regions: used; 0 where spread and skewness are NaN. What is relative to a
    mean is NaN as well where means are not above zero. byte_sized: samples are integers of up to 255. negative: some
    samples are below zero. undisturbed: relative spread and skewness without the regions that pulses of another sonar
    strike; None where there are none.
    """

    relative_spread: float
    relative_skewness: float
    spread_counts: float
    skewness: float
    growth: float
    level_nats: float
    span_counts: float
    n_regions: int
    byte_sized: bool
    negative: bool
    undisturbed: tuple[float, float] | None = None


def floor_speckle(blocks: Sequence[Regions]) -> FloorSpeckle:
    """Join what several blocks of one recorder show."""
    negative = any(block.lowest < 0.0 for block in blocks)
    if not blocks:
        return _unseen(0.0, byte_sized=False, negative=False)
    table = join_tables([block.table for block in blocks])
    integer = all(block.integer for block in blocks)
    highest = float(table.highest.max(initial=0.0))
    byte_sized = integer and highest <= 255.0 and not negative
    span = float(np.median([block.percentile_99 for block in blocks])) - float(
        np.median([block.percentile_1 for block in blocks])
    )
    share = table.cell_share
    mean = (table.mean * share).sum(axis=1)
    # Windows of the largest stride: their halves share no ping.
    halves = (table.cumulants[-1] * share[:, :, None, None]).sum(axis=1)
    if integer:
        halves = halves - np.array([_ROUNDING_VARIANCE, 0.0])
    variance = halves[:, :, 0].min(axis=1)
    usable = (table.at_highest <= _CLIPPED_SHARE) & (variance > max(_TINY * highest**2, _LOWEST_VARIANCE))
    usable &= (table.at_zero * share).sum(axis=1) <= _ZERO_SHARE
    if integer:
        usable &= mean > _MIN_COUNT
    n_regions = int(np.count_nonzero(usable))
    if n_regions < _MIN_REGIONS:
        return _unseen(span, byte_sized=byte_sized, negative=negative)
    mean, halves = mean[usable], halves[usable]
    spread, skewness = _of_even(halves)
    above = mean > 0.0
    relative_spread = relative_skewness = growth = level_nats = NAN
    undisturbed = None
    if np.count_nonzero(above) >= _MIN_REGIONS:
        mean, halves = mean[above], halves[above]
        relative = halves / np.stack([mean**2, mean**3], axis=-1)[:, None, :]
        relative_spread, relative_skewness = _of_even(relative)
        undisturbed = _of_undisturbed(relative)
        growth, level_nats = _growth(mean, halves[:, :, 0].mean(axis=1))
    return FloorSpeckle(
        relative_spread,
        relative_skewness,
        spread,
        skewness,
        growth,
        level_nats,
        span,
        n_regions,
        byte_sized,
        negative,
        undisturbed,
    )


def _unseen(span: float, *, byte_sized: bool, negative: bool) -> FloorSpeckle:
    return FloorSpeckle(NAN, NAN, NAN, NAN, NAN, NAN, span, 0, byte_sized, negative)


def _of_even(halves: Floats) -> tuple[float, float]:
    """Compute standard deviation and skewness of the most even third of regions.

    halves: (n_regions, 2, 2) second and third cumulants by half of the pings.
    """
    return _joined(_even(halves))


def _of_undisturbed(halves: Floats) -> tuple[float, float] | None:
    """Do as `_of_even` without regions that pulses of another sonar strike; None where there are few of them."""
    parts = _even(halves)
    least = [np.quantile(even[:, 0], 0.25) for even in parts]
    if all(np.mean(even[:, 0] > _STRUCK * low) <= _TRIM for even, low in zip(parts, least, strict=True)):
        return None
    return _joined([even[even[:, 0] <= _WHOLE * np.quantile(even[:, 0], 0.1)] for even in parts])


def _even(halves: Floats) -> list[Floats]:
    """Give either half's cumulants of the regions that are most even by the other half, (n, 2) each."""
    return [halves[halves[:, half, 0] <= np.quantile(halves[:, half, 0], _EVEN_SHARE), 1 - half] for half in range(2)]


def _joined(parts: list[Floats]) -> tuple[float, float]:
    second, third = np.mean([[_trimmed_mean(column) for column in even.T] for even in parts], axis=0)
    return math.sqrt(second), float(third / second**1.5)


def _trimmed_mean(values: Floats) -> float:
    cut = int(_TRIM * len(values))
    return float(np.sort(values)[cut : len(values) - cut].mean())


def _growth(mean: Floats, variance: Floats) -> tuple[float, float]:
    """Fit the slope of ln spread against ln mean over the more even regions of each level, and the levels' spread."""
    order = np.argsort(mean, kind="stable")
    level, spread = np.log(mean[order]), 0.5 * np.log(variance[order])
    x = np.array([np.median(part) for part in np.array_split(level, _LEVEL_BINS)])
    y = np.array([np.quantile(part, 0.2) for part in np.array_split(spread, _LEVEL_BINS)])
    x = x - x.mean()
    scatter = float(x @ x)
    return (float(x @ y) / scatter if scatter > 0.0 else 0.0), math.sqrt(scatter / _LEVEL_BINS)
