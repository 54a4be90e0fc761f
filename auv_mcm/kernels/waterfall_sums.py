"""Sum every ping of a waterfall along range, and average it between ranges.

C and numpy agree to the bit: all in numpy's order of operations.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.kernels.signatures import call

Plane = NDArray[np.float32]
Values = NDArray[np.float64]
Flags = NDArray[np.bool_]
Rows = NDArray[np.int64]


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
