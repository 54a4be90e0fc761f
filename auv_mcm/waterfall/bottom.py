"""Track the first bottom return from the samples themselves.

Per ping, every slant range is scored as the change point between water column and sea floor: a likelihood ratio for a
step in the mean of ln I (variance of single-look ln I: pi^2/6), both sides summed since both see the same altitude. The
logarithm keeps a short ring-down or a fish from outweighing metres of dark water, and makes the score independent of
gain. A best-path search over pings then takes the sequence of ranges that fits all pings together. An altitude reading
only favours its neighbourhood: recorders disagree with the first return by metres. Where all echoes begin beyond the
reading, as in an image without a water column, no sample can show the bottom and the reading is taken as it is. So is
a first return that a person corrected, and the path around leads to it.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.kernels.viterbi import backtrack, viterbi_forward
from auv_mcm.kernels.waterfall_rows import raise_to_floor
from auv_mcm.kernels.waterfall_steps import add_votes, pull_to_reading, step_ratios
from auv_mcm.waterfall.ground import Traces, mean_between

BIN_M: Final = 0.05  # m of slant range: the step of the search
_WINDOW_M: Final = 0.5  # m on either side of a change point whose means are compared
_LOG_VARIANCE: Final = math.pi**2 / 6.0
_MIN_STEP: Final = math.log(2.0)
_FAINTEST: Final = 1e-6  # of a ping's median intensity, below which an echo counts as that faint
_SMALLEST: Final = 1e-300  # keeps logarithms finite
_SIDE_VOTE: Final = 10.0  # nats that one side may add to a score, maximum
# of first return and altitude reading, either way, beyond which the reading speaks against a range
_ALTITUDE_RATIO: Final = 1.6
_OUTSIDE_GATE: Final = 8.0  # nats that it then takes
_ALTITUDE_PULL: Final = 1.0  # nats per nat between range and altitude reading: decides only where no step shows
# of the altitude reading, 1-sigma where echoes begin beyond it; chosen, not measured
_STATED_SIGMA: Final = 0.02
_UNSEEN_SIGMA: Final = 0.25  # of the first return, 1-sigma where the bottom was not seen; chosen, not measured
_CORRECTED_SIGMA_M: Final = 0.1  # m, 1-sigma of a correction: two pixels of a screen that shows 40 m; chosen
_CORRECTED_VOTE: Final = 2.0 * _SIDE_VOTE  # nats for the path to go through a correction: what both sides may add
_MAX_SLOPE_BINS: Final = 8  # bins that the path may move from ping to ping: 0.4 m
_STEP_COST: Final = 0.5  # nats per bin that the path moves from ping to ping
_EVIDENCE: Final = 6.0  # nats over the pings around, from which the bottom counts as seen
_SMOOTHING_PINGS: Final = 8  # pings: of the median that gives the first return
_LEVEL_PINGS: Final = 32  # pings: of the median that leaves out what rises for a few metres of track
_LEVEL_SLOPE: Final = 0.01  # relative change of the level from ping to ping, maximum
_SEEN_PINGS: Final = 4  # pings over which the evidence is averaged


class BottomTrack(NamedTuple):
    """Hold the tracked bottom.

    first_return_m, sigma_m: (n_pings,) float64 slant range of the first bottom return and its 1-sigma. level_return_m:
    (n_pings,) float64, the same without what rises from the bottom for a few metres of track. seen: (n_pings,) bool,
    whether this ping and those around it showed it.
    """

    first_return_m: NDArray[np.float64]
    level_return_m: NDArray[np.float64]
    sigma_m: NDArray[np.float64]
    seen: NDArray[np.bool_]


def change_point_scores(
    log_intensity: NDArray[np.float64], valid: NDArray[np.bool_], blank_bins: int
) -> NDArray[np.float64]:
    """Compute the log-likelihood ratio (n_pings, n_bins) float64 >= 0 that the bottom starts at each bin.

    0 where it cannot start. log_intensity: (n_pings, n_bins) float64, read where valid. Two-sample Gaussian likelihood
    ratio for a rise of the mean from the 0.5 m before bin k to the 0.5 m from it; zero unless the 0.5 m from k also
    stands at least ln 2 above the mean of everything between the blanked range and k, so that edges inside the sea
    floor do not compete with the first one.
    """
    window = max(2, round(_WINDOW_M / BIN_M))
    return step_ratios(log_intensity, valid, blank_bins, window, _MIN_STEP, 2.0 * _LOG_VARIANCE)


class _Path(NamedTuple):
    """Hold a path.

    bins: (n_pings,) int64; evidence: (n_pings,) float64 score of the best of the bin and its neighbours.
    """

    bins: NDArray[np.int64]
    evidence: NDArray[np.float64]


class _Scored(NamedTuple):
    """Hold a block's scores (n_pings, n_bins) and its steps back.

    stated_m: (n_pings,) the altitude reading where it alone tells, else NaN. corrected_m: (n_pings,), NaN where nobody
    corrected the first return.
    """

    score: NDArray[np.float64]
    back: NDArray[np.int32]
    stated_m: NDArray[np.float64]
    corrected_m: NDArray[np.float64]


_NO_PATH: Final = _Path(np.empty(0, dtype=np.int64), np.empty(0))


class BottomTracker:
    """Track the best path at a fixed lag: feed blocks of pings in order, each path comes with the next call."""

    def __init__(self, blank_m: float) -> None:
        self._blank_bins = max(1, round(blank_m / BIN_M))
        self._cost: NDArray[np.float64] | None = None
        self._held: _Scored | None = None
        self._before = _NO_PATH  # just before the held block
        self._level: float | None = None

    def add(
        self,
        sides: list[Traces | None],
        altitude_m: NDArray[np.float64],
        max_range_m: float,
        corrected_m: NDArray[np.float64] | None = None,
    ) -> BottomTrack | None:
        """Score a block; return the path of the block before it, None for the first.

        Parameters
        ----------
        sides
            Cumulative sums per side, None for a side without data.
        altitude_m
            (n_pings,) float64 prior, NaN where unknown.
        corrected_m
            (n_pings,) float64 first return as a person corrected it, NaN elsewhere; None for no correction.
        """
        stated_m = _stated_m(sides, altitude_m)
        corrected_m = np.full(altitude_m.shape, math.nan) if corrected_m is None else corrected_m
        score = self._score(sides, altitude_m, max_range_m, np.isfinite(stated_m))
        n_bins = score.shape[1]
        for ping in np.flatnonzero(np.isfinite(corrected_m)):
            score[ping] = -_CORRECTED_VOTE
            score[ping, min(round(float(corrected_m[ping]) / BIN_M), n_bins - 1)] = _CORRECTED_VOTE
        if self._cost is None:
            self._cost = np.zeros(n_bins)
        if self._cost.shape[0] < n_bins:
            self._cost = np.concatenate([self._cost, np.full(n_bins - self._cost.shape[0], self._cost.min())])
        elif self._cost.shape[0] > n_bins:
            score = np.pad(score, ((0, 0), (0, self._cost.shape[0] - n_bins)))
        self._cost, back = viterbi_forward(self._cost, score, _MAX_SLOPE_BINS, _STEP_COST)
        end = int(self._cost.argmax())
        scored = _Scored(score, back, stated_m, corrected_m)
        path = _path(end, scored)
        done = self._finish_held(int(back[0, path.bins[0]]), path) if self._held is not None else None
        self._held = scored
        return done

    def flush(self) -> BottomTrack | None:
        """Give the path of the last block, and drop the mission so far."""
        done = None
        if self._held is not None and self._cost is not None:
            done = self._finish_held(int(self._cost.argmax()), _NO_PATH)
        self._cost, self._held, self._before, self._level = None, None, _NO_PATH, None
        return done

    def _finish_held(self, end: int, after: _Path) -> BottomTrack:
        assert self._held is not None
        path = _path(min(end, self._held.back.shape[1] - 1), self._held)
        start, stop = self._before.bins.shape[0], self._before.bins.shape[0] + path.bins.shape[0]
        bins = np.concatenate([self._before.bins, path.bins, after.bins])
        evidence = np.concatenate([self._before.evidence, path.evidence, after.evidence])
        stated_m, corrected_m = self._held.stated_m, self._held.corrected_m
        stated, corrected = np.isfinite(stated_m), np.isfinite(corrected_m)
        # In noise single pings look convincing, in weak contrast they do not: a few together decide.
        seen = (_running_means(evidence, _SEEN_PINGS, start, stop) >= _EVIDENCE) | stated | corrected
        smooth = _running_medians(bins, _SMOOTHING_PINGS, start, stop)
        level = self._levelled(_running_medians(bins, _LEVEL_PINGS, start, stop))
        self._before = _Path(bins[:stop][-_LEVEL_PINGS:], evidence[:stop][-_LEVEL_PINGS:])
        roughness = np.abs(path.bins - smooth)
        sigma = np.where(seen, 1.5 * BIN_M + roughness * BIN_M, _UNSEEN_SIGMA * np.maximum(smooth * BIN_M, 1.0))
        sigma = np.where(stated, _STATED_SIGMA * stated_m, sigma)
        sigma[corrected] = _CORRECTED_SIGMA_M
        first_return_m, level_m = (np.where(stated, stated_m, bins * BIN_M) for bins in (smooth, level))
        for line_m in (first_return_m, level_m):
            line_m[corrected] = corrected_m[corrected]
        return BottomTrack(first_return_m, level_m, sigma, seen)

    def _levelled(self, medians: NDArray[np.float64]) -> NDArray[np.float64]:
        """Follow the medians by at most a hundredth per ping, which any dive stays below and no rock does."""
        level = np.empty_like(medians)
        for ping, median in enumerate(medians.tolist()):
            before = median if self._level is None else self._level
            self._level = min(max(median, before * (1.0 - _LEVEL_SLOPE)), before * (1.0 + _LEVEL_SLOPE) + 1e-3)
            level[ping] = self._level
        return level

    def _score(
        self, sides: list[Traces | None], altitude_m: NDArray[np.float64], max_range_m: float, stated: NDArray[np.bool_]
    ) -> NDArray[np.float64]:
        n_bins = max(int(0.95 * max_range_m / BIN_M), 2)
        edges_m = np.arange(n_bins + 1, dtype=np.float64)[None, :] * BIN_M
        score = np.zeros((altitude_m.shape[0], n_bins))
        for traces in sides:
            if traces is None or stated.all():
                continue
            means = mean_between(traces, edges_m)
            # share of bins that do not repeat their neighbour's sample
            independent = min(1.0, BIN_M / traces.spacing_m)
            # Against a median, because ring-down may stand a hundred decibels above everything that follows.
            raise_to_floor(means.intensity, means.valid, _FAINTEST, _SMALLEST)
            log_intensity = np.log(means.intensity, out=means.intensity)
            ratios = change_point_scores(log_intensity, means.valid, self._blank_bins)
            # Every side of every ping has the same weight: a loud fish, on one side, must not outvote the other and its
            # neighbours.
            add_votes(score, ratios, independent, _SIDE_VOTE, _EVIDENCE)
        score[stated] = 0.0
        pull_to_reading(score, altitude_m, BIN_M, _ALTITUDE_RATIO, _OUTSIDE_GATE, _ALTITUDE_PULL)
        return score


def _stated_m(sides: list[Traces | None], altitude_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Give the altitude reading (n_pings,) of pings whose echoes all begin beyond it, NaN for others."""
    first_m = min((traces.first_range_m - 0.5 * traces.spacing_m for traces in sides if traces), default=0.0)
    return np.where((altitude_m > 0.0) & (altitude_m < first_m), altitude_m, math.nan)


def _path(end: int, scored: _Scored) -> _Path:
    """Trace the best path that ends in bin `end` of the block's last ping."""
    score = scored.score
    bins = backtrack(end, scored.back)
    near = np.clip(bins[:, np.newaxis] + (-1, 0, 1), 0, score.shape[1] - 1)
    return _Path(bins, score[np.arange(len(bins))[:, np.newaxis], near].max(axis=1))


def _windows(start: int, stop: int, reach: int) -> NDArray[np.intp]:
    """List the pings within `reach` of each of pings [start, stop), (stop - start, 2 reach + 1)."""
    return np.arange(start, stop)[:, np.newaxis] + np.arange(-reach, reach + 1)


def _running_means(values: NDArray[np.float64], reach: int, start: int, stop: int) -> NDArray[np.float64]:
    """Average over `reach` pings to either side of pings [start, stop), (stop - start,) float64.

    At the ends fewer pings are averaged.
    """
    whole_start = min(max(start, reach), stop)
    whole_stop = max(min(stop, values.shape[0] - reach), whole_start)
    means = np.empty(stop - start)
    if whole_stop > whole_start:
        windows = values[_windows(whole_start, whole_stop, reach)]
        means[whole_start - start : whole_stop - start] = windows.mean(axis=1)
    for ping in [*range(start, whole_start), *range(whole_stop, stop)]:
        means[ping - start] = values[max(ping - reach, 0) : ping + reach + 1].mean()
    return means


def _running_medians(bins: NDArray[np.int64], reach: int, start: int, stop: int) -> NDArray[np.float64]:
    """Take medians over `reach` pings to either side of pings [start, stop), (stop - start,) float64.

    A rock under the array is not the bottom everything else lies on. At the ends of `bins` the window shrinks evenly,
    so that a steady dive is not bent.
    """
    last = bins.shape[0] - 1
    whole_start = min(max(start, reach), stop)
    whole_stop = max(min(stop, last - reach + 1), whole_start)
    medians = np.empty(stop - start)
    if whole_stop > whole_start:
        windows = bins[_windows(whole_start, whole_stop, reach)]
        medians[whole_start - start : whole_stop - start] = np.partition(windows, reach, axis=1)[:, reach]
    for ping in [*range(start, whole_start), *range(whole_stop, stop)]:
        half = min(reach, ping, last - ping)
        medians[ping - start] = np.median(bins[ping - half : ping + half + 1])
    return medians
