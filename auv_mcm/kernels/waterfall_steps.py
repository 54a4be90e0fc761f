"""Rate every slant range of a ping as that of the sea floor's first echo: rises of the mean, votes, readings.

C and numpy agree to the bit: all in numpy's order of operations.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from auv_mcm.kernels.signatures import call

Values = NDArray[np.float64]
Flags = NDArray[np.bool_]


def step_ratios(
    values: Values, valid: Flags, blank: int, window: int, min_step: float, twice_variance: float
) -> Values:
    """Compute how much likelier a rise of the mean is at each bin than none, (n_pings, n_bins) float64.

    0 where it cannot be. Means are over the valid values of `window` bins from the bin on, of as many before it, and of
    all from bin `blank` on up to it. The first must rise over the second, three of which are valid, and by min_step
    over the third. twice_variance: of single values.
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
