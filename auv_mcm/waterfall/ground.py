"""Area-averaging resampling along range: slant samples to any range grid, exactly and in O(samples).

A trace is taken as constant over each sample, so its cumulative sum is piecewise linear and the mean over an interval is a
difference of two interpolated sums: no aliasing where the destination is coarser, plain lookup where it is finer.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Traces(NamedTuple):
    """Cumulative sums of one side of n pings that share sample count and spacing.

    sum_intensity: (n_pings, n_samples + 1) float64, sum of valid intensity before each sample edge.
    sum_weight: the same of validity (0 or 1), or None when every sample is valid; sum_saturated: of clipping, or None.
    first_range_m: slant range of the centre of sample 0; spacing_m: between samples.
    """

    sum_intensity: NDArray[np.float64]
    sum_weight: NDArray[np.float64] | None
    sum_saturated: NDArray[np.float64] | None
    first_range_m: float
    spacing_m: float

    @property
    def n_samples(self) -> int:
        return int(self.sum_intensity.shape[1]) - 1


def _cumulative(values: NDArray[np.float32] | NDArray[np.bool_]) -> NDArray[np.float64]:
    """Sums up to every sample's near edge, less the sum of all.

    Added up from the far end, so that ring-down, a hundred decibels above the sea floor, does not take its last digits.
    """
    total = np.empty((values.shape[0], values.shape[1] + 1), dtype=np.float64)
    total[:, -1] = 0.0
    np.cumsum(values[:, ::-1], axis=1, dtype=np.float64, out=total[:, -2::-1])
    return np.negative(total, out=total)


def make_traces(
    intensity: NDArray[np.float32],
    valid: NDArray[np.bool_],
    saturated: NDArray[np.bool_],
    first_range_m: float,
    spacing_m: float,
) -> Traces:
    """Cumulative sums of (n_pings, n_samples) intensity, which must be 0 where not valid."""
    return Traces(
        _cumulative(intensity),
        None if valid.all() else _cumulative(valid),
        _cumulative(saturated) if saturated.any() else None,
        first_range_m,
        spacing_m,
    )


class RangeMeans(NamedTuple):
    """Means over range intervals, each (n_pings, n_columns): intensity float64 (0 where invalid), valid bool, saturated bool."""

    intensity: NDArray[np.float64]
    valid: NDArray[np.bool_]
    saturated: NDArray[np.bool_]


def mean_between(traces: Traces, edges_m: NDArray[np.float64]) -> RangeMeans:
    """Mean intensity between neighbouring slant ranges.

    edges_m: (n_pings, n_columns + 1) or (1, n_columns + 1) float64 slant range, non-decreasing along columns.
    A column is valid when valid samples cover at least half of it, and saturated when clipped ones are a quarter of those.
    """
    n_pings, n_samples = traces.sum_intensity.shape[0], traces.n_samples
    position = (edges_m - traces.first_range_m) * (1.0 / traces.spacing_m) + 0.5
    width = np.diff(position, axis=1)
    np.clip(position, 0.0, float(n_samples), out=position)
    sample = np.minimum(position.astype(np.intp), n_samples - 1)
    position -= sample
    if edges_m.shape[0] == 1:
        sample, position = sample[0], position[0]

        def difference(cumulative: NDArray[np.float64]) -> NDArray[np.float64]:
            low = cumulative[:, sample]
            return np.diff(low + position * (cumulative[:, sample + 1] - low), axis=1)

    else:
        sample += (np.arange(n_pings) * (n_samples + 1))[:, None]

        def difference(cumulative: NDArray[np.float64]) -> NDArray[np.float64]:
            flat = cumulative.ravel()
            low = flat.take(sample)
            high = flat.take(sample + 1)
            high -= low
            high *= position
            high += low
            return np.diff(high, axis=1)

    sampled = np.diff(position + (sample if edges_m.shape[0] == 1 else sample % (n_samples + 1)), axis=-1)
    weight = np.broadcast_to(sampled, (n_pings, edges_m.shape[1] - 1)) if traces.sum_weight is None else difference(traces.sum_weight)
    valid = (weight >= 0.5 * width) & (weight > 1e-9)
    intensity = np.divide(difference(traces.sum_intensity), weight, out=np.zeros(valid.shape), where=valid)
    saturated = np.zeros(valid.shape, dtype=np.bool_) if traces.sum_saturated is None else difference(traces.sum_saturated) > 0.25 * weight
    return RangeMeans(intensity, valid, saturated & valid)


def ground_edges_m(first_return_m: NDArray[np.float64], n_columns: int, column_spacing_m: float) -> NDArray[np.float64]:
    """Slant ranges (n_pings, n_columns + 1) float64 of ground-range pixel edges over a flat bottom.

    r = sqrt(y^2 + r0^2) with r0 the slant range of the first bottom return (n_pings,); np.hypot does not cancel near nadir.
    """
    ground_m = np.arange(n_columns + 1) * column_spacing_m
    return np.asarray(np.hypot(ground_m[None, :], first_return_m[:, None]))
