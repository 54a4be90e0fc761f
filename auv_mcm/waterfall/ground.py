"""Resample along range by area averages: slant samples to any range grid, exactly and in O(samples).

A trace is taken as constant over each sample, so its cumulative sum is piecewise linear and the mean over an interval
is a difference of two interpolated sums: no aliasing where the destination is coarser, plain lookup where it is finer.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.kernels.waterfall_sums import Sampled, means, sums_to_the_end


class Traces(NamedTuple):
    """Hold cumulative sums of one side of n pings that share sample count and spacing.

    sum_intensity: (n_pings, n_samples + 1) float64, sum of valid intensity before each sample edge.
    sum_weight: the same of validity (0 or 1), or None when every sample is valid. sum_saturated: of clipping, or None;
    ends after the last sample that is clipped in any ping.
    first_range_m: slant range of the centre of sample 0; spacing_m: between samples.
    """

    sum_intensity: NDArray[np.float64]
    sum_weight: NDArray[np.float64] | None
    sum_saturated: NDArray[np.float64] | None
    first_range_m: float
    spacing_m: float

    @property
    def n_samples(self) -> int:
        """Count the samples of a trace."""
        return int(self.sum_intensity.shape[1]) - 1


def make_traces(
    intensity: NDArray[np.float32],
    valid: NDArray[np.bool_],
    saturated: NDArray[np.bool_],
    first_range_m: float,
    spacing_m: float,
) -> Traces:
    """Compute cumulative sums of (n_pings, n_samples) intensity, which must be 0 where not valid.

    Added up from the far end, so that ring-down, a hundred decibels above the sea floor, does not take its last digits.
    """
    weight = None if valid.all() else sums_to_the_end(valid.astype(np.float32))
    return Traces(sums_to_the_end(intensity), weight, sum_of_clipped(saturated), first_range_m, spacing_m)


def sum_of_clipped(saturated: NDArray[np.bool_]) -> NDArray[np.float64] | None:
    """Add up clipping as far out as there is any.

    Ring-down clips the first few samples of most pings, and no others.
    """
    clipped = np.flatnonzero(saturated.any(axis=0))
    return sums_to_the_end(saturated[:, : clipped[-1] + 1].astype(np.float32)) if clipped.size else None


class RangeMeans(NamedTuple):
    """Hold means over range intervals, (n_pings, n_columns) each.

    intensity float64 (0 where invalid), valid bool, saturated bool.
    """

    intensity: NDArray[np.float64]
    valid: NDArray[np.bool_]
    saturated: NDArray[np.bool_]


def mean_between(traces: Traces, edges_m: NDArray[np.float64], edge_row: NDArray[np.int64] | None = None) -> RangeMeans:
    """Average intensity between neighbouring slant ranges.

    edges_m: (n_pings, n_columns + 1) or (1, n_columns + 1) float64 slant range, non-decreasing along columns; or (n,
    n_columns + 1) with edge_row: (n_pings,) int64, the row each ping takes. A column is valid when valid samples cover
    at least half of it, and saturated when clipped ones are a quarter of those.
    """
    if edge_row is None:
        n_pings = len(traces.sum_intensity)
        edge_row = np.zeros(n_pings, dtype=np.int64) if len(edges_m) == 1 else np.arange(n_pings)
    sums = Sampled(
        traces.sum_intensity, traces.sum_weight, traces.sum_saturated, traces.first_range_m, traces.spacing_m
    )
    return RangeMeans(*means(sums, edges_m, edge_row))


def ground_edges_m(first_return_m: NDArray[np.float64], n_columns: int, column_spacing_m: float) -> NDArray[np.float64]:
    """Compute slant ranges (n_pings, n_columns + 1) float64 of ground-range pixel edges over a flat bottom.

    r = sqrt(y^2 + r0^2) with r0 the slant range of the first bottom return (n_pings,); np.hypot does not cancel near
    nadir.
    """
    ground_m = np.arange(n_columns + 1) * column_spacing_m
    return np.asarray(np.hypot(ground_m[None, :], first_return_m[:, None]))
