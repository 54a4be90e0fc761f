"""First bottom return from the samples themselves.

Per ping, every slant range is scored as the change point between water column and sea floor: a likelihood ratio for a step
in the mean of ln I (variance of single-look ln I: pi^2/6), both sides summed since both see the same altitude. The logarithm
keeps a short ring-down or a fish from outweighing metres of dark water, and makes the score independent of gain. A best-path
search over pings then takes the sequence of ranges that fits all pings together. An altitude reading favours its
neighbourhood, no more: recorders disagree with the first return by metres.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.kernels.viterbi import backtrack, viterbi_forward
from auv_mcm.waterfall.ground import Traces, mean_between

BIN_M: Final = 0.05
_WINDOW_M: Final = 0.5
_LOG_VARIANCE: Final = math.pi**2 / 6.0
_MIN_STEP: Final = math.log(2.0)
_PING_VOTE: Final = 20.0
_ALTITUDE_RATIO: Final = 1.6
_OUTSIDE_GATE: Final = 8.0
_MAX_SLOPE_BINS: Final = 8
_STEP_COST: Final = 0.5
_EVIDENCE: Final = 6.0
_SMOOTHING_PINGS: Final = 8


class BottomTrack(NamedTuple):
    """first_return_m, sigma_m: (n_pings,) float64 slant range of the first bottom return and its 1-sigma.
    seen: (n_pings,) bool, whether the ping itself showed it."""

    first_return_m: NDArray[np.float64]
    sigma_m: NDArray[np.float64]
    seen: NDArray[np.bool_]


def change_point_scores(log_intensity: NDArray[np.float64], valid: NDArray[np.bool_], blank_bins: int) -> NDArray[np.float64]:
    """Log-likelihood ratio (n_pings, n_bins) float64 >= 0 that the bottom starts at each bin; 0 where it cannot.

    log_intensity: (n_pings, n_bins) float64, read where valid. Two-sample Gaussian likelihood ratio for a rise of the mean
    from the 0.5 m before bin k to the 0.5 m from it; zero unless the 0.5 m from k also stands at least ln 2 above the mean of
    everything between the blanked range and k, so that edges inside the sea floor do not compete with the first one.
    """
    n_pings, n_bins = log_intensity.shape
    window = max(2, round(_WINDOW_M / BIN_M))
    score = np.zeros((n_pings, n_bins))
    first, last = blank_bins + 3, n_bins - window
    if last <= first:
        return score
    total = np.zeros((n_pings, n_bins + 1))
    count = np.zeros((n_pings, n_bins + 1))
    np.cumsum(np.where(valid, log_intensity, 0.0), axis=1, out=total[:, 1:])
    np.cumsum(valid, axis=1, out=count[:, 1:])
    bins = np.arange(first, last)

    def mean_of(start: NDArray[np.intp], stop: NDArray[np.intp]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        n = count[:, stop] - count[:, start]
        return (total[:, stop] - total[:, start]) / np.maximum(n, 1.0), n

    after, n_after = mean_of(bins, bins + window)
    near, n_near = mean_of(np.maximum(bins - window, blank_bins), bins)
    column, _ = mean_of(np.full_like(bins, blank_bins), bins)
    rise = after - near
    ratio = n_near * n_after / np.maximum(n_near + n_after, 1.0) * rise**2 / (2.0 * _LOG_VARIANCE)
    step = (rise > 0.0) & (after - column > _MIN_STEP) & (n_near >= 3) & (n_after >= 0.5 * window)
    score[:, first:last] = np.where(step, ratio, 0.0)
    return score


class BottomTracker:
    """Fixed-lag best-path tracker; feed blocks of pings in order, each block's path is returned with the next call."""

    def __init__(self, blank_m: float) -> None:
        self._blank_bins = max(1, round(blank_m / BIN_M))
        self._cost: NDArray[np.float64] | None = None
        self._held: tuple[NDArray[np.float64], NDArray[np.int32]] | None = None
        self._before: NDArray[np.int64] = np.empty(0, dtype=np.int64)  # path just before the held block

    def add(self, sides: list[Traces | None], altitude_m: NDArray[np.float64], max_range_m: float) -> BottomTrack | None:
        """Score a block; return the path of the block before it, None for the first.

        sides: cumulative sums per side, None for a side without data. altitude_m: (n_pings,) float64 prior, NaN where unknown.
        """
        score = self._score(sides, altitude_m, max_range_m)
        n_bins = score.shape[1]
        if self._cost is None:
            self._cost = np.zeros(n_bins)
        if self._cost.shape[0] < n_bins:
            self._cost = np.concatenate([self._cost, np.full(n_bins - self._cost.shape[0], self._cost.min())])
        elif self._cost.shape[0] > n_bins:
            score = np.pad(score, ((0, 0), (0, self._cost.shape[0] - n_bins)))
        self._cost, back = viterbi_forward(self._cost, score, _MAX_SLOPE_BINS, _STEP_COST)
        end = int(self._cost.argmax())
        path = backtrack(end, back)
        done = self._finish_held(int(back[0, path[0]]), path[:_SMOOTHING_PINGS]) if self._held is not None else None
        self._held = (score, back)
        return done

    def flush(self) -> BottomTrack | None:
        """Path of the last block, and forget the mission so far."""
        done = None
        if self._held is not None and self._cost is not None:
            done = self._finish_held(int(self._cost.argmax()), np.empty(0, dtype=np.int64))
        self._cost, self._held, self._before = None, None, np.empty(0, dtype=np.int64)
        return done

    def _finish_held(self, end: int, after: NDArray[np.int64]) -> BottomTrack:
        assert self._held is not None
        score, back = self._held
        path = backtrack(min(end, back.shape[1] - 1), back)
        pings = np.arange(path.shape[0])
        evidence = np.maximum.reduce([score[pings, np.clip(path + offset, 0, score.shape[1] - 1)] for offset in (-1, 0, 1)])
        seen = evidence >= _EVIDENCE
        smooth = _running_median(self._before, path, after)
        self._before = path[-_SMOOTHING_PINGS:]
        roughness = np.abs(path - smooth)
        sigma = np.where(seen, 1.5 * BIN_M + roughness * BIN_M, 0.1 * np.maximum(smooth * BIN_M, 1.0))
        return BottomTrack(smooth * BIN_M, sigma, seen)

    def _score(self, sides: list[Traces | None], altitude_m: NDArray[np.float64], max_range_m: float) -> NDArray[np.float64]:
        n_bins = max(int(0.95 * max_range_m / BIN_M), 2)
        edges_m = np.arange(n_bins + 1, dtype=np.float64)[None, :] * BIN_M
        score = np.zeros((altitude_m.shape[0], n_bins))
        for traces in sides:
            if traces is None:
                continue
            means = mean_between(traces, edges_m)
            floor = 1e-6 * means.intensity.mean(axis=1, keepdims=True) + 1e-300
            score += change_point_scores(np.log(np.maximum(means.intensity, floor)), means.valid, self._blank_bins)
        # Every ping has the same say: one with a loud fish must not outvote its neighbours.
        score *= _PING_VOTE / np.maximum(score.max(axis=1, keepdims=True), 2.0 * _EVIDENCE)
        known = np.isfinite(altitude_m) & (altitude_m > 0.0)
        if known.any():
            centre_m = (np.arange(n_bins) * BIN_M)[None, :]
            altitude = np.where(known, altitude_m, 1.0)[:, None]
            outside = (centre_m > _ALTITUDE_RATIO * altitude) | (centre_m * _ALTITUDE_RATIO < altitude)
            score -= _OUTSIDE_GATE * (outside & known[:, None])
        return score


def _running_median(before: NDArray[np.int64], path: NDArray[np.int64], after: NDArray[np.int64]) -> NDArray[np.float64]:
    """Median over eight pings to either side, (n_pings,) float64: a rock under the array is not the bottom everything else lies on.

    At the ends of a segment the window shrinks evenly, so that a steady dive is not bent.
    """
    whole = np.concatenate([before, path, after])
    medians = np.empty(path.shape[0])
    for ping in range(path.shape[0]):
        centre = before.shape[0] + ping
        half = min(_SMOOTHING_PINGS, centre, whole.shape[0] - 1 - centre)
        medians[ping] = np.median(whole[centre - half : centre + half + 1])
    return medians
