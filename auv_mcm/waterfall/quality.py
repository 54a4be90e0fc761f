"""Check the quality of each recorded trace; count a reason for every sample and trace rejected."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.intake import same_ranges
from auv_mcm.kernels.waterfall_sums import sums_of_counts
from auv_mcm.records import EchoTrace, Side, Transfer
from auv_mcm.waterfall.ground import Traces, make_traces, sum_of_clipped
from auv_mcm.waterfall.transfer import to_intensity

_SATURATION_FRACTION: Final = 0.98  # of full scale, from which a sample may be clipped
# sixty-four looks of pure speckle still have 0.016, and a real trace a range profile on top
_FLAT_LOG_VARIANCE: Final = 0.02
_MANY_SATURATED: Final = 0.05  # share of a trace's samples: a few glints clip rightly
_ABSURD_RATIO: Final = 1e10  # of a sample over its trace's median: 100 dB, more than any receiver spans
_NEAR_M: Final = 2.0  # m of slant range left out: ring-down and first return clip rightly
# samples that give a trace's level, that distinguish two traces; one in how many shows that a trace varies
_SOME, _FEW, _SPARSE = 128, 8, 8
_MIN_OF_HIGHEST: Final = np.float32(1e-6)


class CheckedTrace(NamedTuple):
    """Hold one checked trace, or all of shape (n_traces, n_samples).

    intensity: (n_samples,) float32 linear, 0 where not valid; valid, saturated: (n_samples,) bool.
    """

    intensity: NDArray[np.float32]
    valid: NDArray[np.bool_]
    saturated: NDArray[np.bool_]


class _CountTable(NamedTuple):
    """Hold the intensity of every count, rising. is_wide: whether one may be absurd beside another."""

    intensity: NDArray[np.float32]
    is_wide: bool


def _absurd(intensity: NDArray[np.float32]) -> NDArray[np.bool_] | None:
    """Find samples a hundred decibels above the middle one, None if there are none.

    No echo is that strong, and in a running sum it would leave no digits for the others.
    """
    some = intensity[:: max(intensity.shape[0] // _SOME, 1)]
    some = some[some > 0.0]
    if some.size == 0:
        return None
    limit = _ABSURD_RATIO * float(np.partition(some, some.size // 2)[some.size // 2])
    if float(intensity.max()) <= limit:
        return None
    return np.asarray(intensity.astype(np.float64) > limit)


class TraceChecker:
    """Check the traces of one side in order; count rejections in `counters`."""

    def __init__(self, side: Side, transfer: Transfer, full_scale: float | None, counters: Counter[str]) -> None:
        self._side = side
        self._transfer = transfer
        self._full_scale = full_scale
        self._counters = counters
        self._highest = 0
        self._previous: NDArray[Any] | None = None
        self._first: EchoTrace | None = None  # of this layout
        self._n_filled = 0  # samples of this layout up to the last one that was ever another number than zero
        self._tables: dict[np.dtype[Any], _CountTable | None] = {}  # per sample type

    def check(self, trace: EchoTrace) -> CheckedTrace:
        """Compute linear intensity with validity and saturation of one recorded trace."""
        checked = self.check_all([trace])
        return CheckedTrace(checked.intensity[0], checked.valid[0], checked.saturated[0])

    def cumulate(self, traces: Sequence[EchoTrace]) -> Traces:
        """Check traces of one layout, which follow each other, and add them up along range.

        Samples of one or two bytes without a sign, which nearly all recorders store, have few values: what each stands
        for is looked up as it is added up, and only what `check_all` would reject is checked one by one.
        """
        layout = traces[0].first_range_m, traces[0].spacing_m
        kind = traces[0].samples.dtype
        is_whole = self._filled(traces) >= traces[0].samples.size > 0
        table = self._table(kind) if is_whole and all(trace.samples.dtype == kind for trace in traces) else None
        if table is not None:
            samples, intensity = _stacked(traces), table.intensity
            highest_count = samples.max(axis=1, initial=0)
            highest = intensity[highest_count]
            some = samples[:, :: max(samples.shape[1] // _SOME, 1)]
            is_unsure = table.is_wide and bool(_may_be_absurd(intensity.take(some), highest).any())
            sparse = intensity.take(samples[:, ::_SPARSE])
            if not (is_unsure or _may_be_dead(sparse, samples.shape[1], highest).any() or self._stuck(samples).any()):
                saturated = self._saturated(samples, highest_count)
                self._count_saturation(traces[0], saturated)
                self._previous = traces[-1].samples
                return Traces(sums_of_counts(samples, intensity), None, sum_of_clipped(saturated), *layout)
        checked = self.check_all(traces)
        return make_traces(checked.intensity, checked.valid, checked.saturated, *layout)

    def _filled(self, traces: Sequence[EchoTrace]) -> int:
        """Count the samples before the zeros that fill up every trace of this layout so far: no echo was measured."""
        first = traces[0]
        if self._first is None or not same_ranges(first, self._first):
            self._first, self._n_filled = first, 0
        if self._n_filled < first.samples.shape[0]:
            tails = np.stack([trace.samples[self._n_filled :] for trace in traces])
            filled = np.flatnonzero((tails != 0).any(axis=0))
            self._n_filled += int(filled[-1]) + 1 if filled.size else 0
        return self._n_filled

    def _table(self, kind: np.dtype[Any]) -> _CountTable | None:
        """Give what samples of a type stand for, if they are few enough to look up and higher ones stand for no
        less."""
        if kind.kind != "u" or kind.itemsize > 2:
            return None
        if kind not in self._tables:
            intensity = to_intensity(np.arange(256**kind.itemsize).astype(kind), self._transfer)[0]
            rises = bool((np.diff(intensity) >= 0.0).all())
            is_wide = bool(_may_be_absurd(intensity[np.newaxis], intensity[-1:]).any())
            self._tables[kind] = _CountTable(intensity, is_wide) if rises else None
        return self._tables[kind]

    def check_all(self, traces: Sequence[EchoTrace]) -> CheckedTrace:
        """Check several traces of one layout, which follow each other; arrays (n_traces, n_samples)."""
        n_filled = self._filled(traces)
        if len({trace.samples.dtype for trace in traces}) > 1:
            apart = [self.check(trace) for trace in traces]
            intensities, valids, saturateds = zip(*apart, strict=True)
            return CheckedTrace(np.stack(intensities), np.stack(valids), np.stack(saturateds))
        samples = _stacked(traces)
        intensity, valid = to_intensity(samples, self._transfer)
        n_bad = samples.size - int(np.count_nonzero(valid))
        if n_bad:
            self._counters["quality.sample_not_finite_or_negative"] += n_bad
        intensity[:, n_filled:], valid[:, n_filled:] = 0.0, False
        highest = intensity.max(axis=1, initial=0.0)
        some = intensity[:, :: max(intensity.shape[1] // _SOME, 1)]
        for ping in np.flatnonzero(_may_be_absurd(some, highest)).tolist():
            absurd = _absurd(intensity[ping])
            if absurd is not None:
                self._counters["quality.sample_absurd"] += int(np.count_nonzero(absurd))
                intensity[ping][absurd] = 0.0
                valid[ping] &= ~absurd
                highest[ping] = intensity[ping].max(initial=0.0)
        saturated = (
            self._saturated(samples, samples.max(axis=1, initial=0) if samples.dtype.kind in "ui" else None) & valid
        )
        self._count_saturation(traces[0], saturated)
        dead, stuck = _dead(intensity, highest), self._stuck(samples)
        for ping in np.flatnonzero(dead | stuck).tolist():
            reason = "no_samples" if samples.shape[1] == 0 else "dead" if dead[ping] else "stuck"
            self._counters[f"quality.{self._side}_{reason}"] += 1
            intensity[ping], valid[ping], saturated[ping] = 0.0, False, False
        self._previous = traces[-1].samples
        return CheckedTrace(intensity, valid, saturated)

    def _saturated(self, samples: NDArray[Any], highest: NDArray[Any] | None) -> NDArray[np.bool_]:
        """Find clipped samples (n_traces, n_samples). highest: of each trace, None unless samples are integers."""
        if self._full_scale is not None:
            return np.asarray(samples >= _SATURATION_FRACTION * self._full_scale)
        if highest is None or samples.size == 0:
            return np.zeros(samples.shape, dtype=np.bool_)
        ceilings = np.empty(len(samples), dtype=np.int64)
        for ping, trace_highest in enumerate(highest.tolist()):
            # Converters clip at all ones, often of fewer bits than the stored type has. One corrupt sample is no
            # ceiling, three are.
            if trace_highest > self._highest:
                trace = samples[ping]
                third_highest = np.partition(trace, -3)[-3] if trace.shape[0] >= 3 else trace.min()
                self._highest = max(self._highest, int(third_highest))
            ceilings[ping] = max((1 << self._highest.bit_length()) - 1, 255)
        if (highest < ceilings).all():
            return np.zeros(samples.shape, dtype=np.bool_)
        if ceilings.max() <= np.iinfo(samples.dtype).max:
            ceilings = ceilings.astype(samples.dtype)  # else all samples would be widened to compare them
        return np.asarray(samples >= ceilings[:, np.newaxis])

    def _count_saturation(self, first: EchoTrace, saturated: NDArray[np.bool_]) -> None:
        """Count clipped samples (n_traces, n_samples) of the first trace's layout, and traces of which too many are."""
        n_saturated = int(np.count_nonzero(saturated))
        if not n_saturated:
            return
        self._counters["quality.sample_saturated"] += n_saturated
        near = max(0, round((_NEAR_M - first.first_range_m) / first.spacing_m))
        far = saturated[:, near:]
        if not far.any():
            return
        n_mostly = int(np.count_nonzero(np.count_nonzero(far, axis=1) > _MANY_SATURATED * far.shape[1]))
        if n_mostly:
            self._counters[f"quality.{self._side}_ping_mostly_saturated"] += n_mostly

    def _stuck(self, samples: NDArray[Any]) -> NDArray[np.bool_]:
        """Find traces (n_traces, n_samples) that repeat the one before."""
        floats = samples.dtype.kind == "f"
        stuck = np.zeros(len(samples), dtype=np.bool_)
        stuck[0] = self._previous is not None and np.array_equal(samples[0], self._previous, equal_nan=floats)
        # A few samples distinguish most traces.
        some = samples[:, :: max(samples.shape[1] // _FEW, 1)]
        alike = (some[1:] == some[:-1]) | ((some[1:] != some[1:]) & (some[:-1] != some[:-1]))
        for ping in np.flatnonzero(alike.all(axis=1)) + 1:
            stuck[ping] = np.array_equal(samples[ping], samples[ping - 1], equal_nan=floats)
        return stuck


def _may_be_absurd(some: NDArray[np.float32], highest: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Find traces `_absurd` must check: their highest sample is so far above the lowest of some, (n_traces, n)."""
    lowest = np.where(some > 0.0, some, np.float32(np.inf)).min(axis=1, initial=np.inf).astype(np.float64)
    return np.asarray(np.isfinite(lowest) & (highest > _ABSURD_RATIO * lowest))


def _stacked(traces: Sequence[EchoTrace]) -> NDArray[Any]:
    return np.concatenate([trace.samples for trace in traces]).reshape(len(traces), -1)


def _may_be_dead(sparse: NDArray[np.float32], n_samples: int, highest: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Find traces that `_dead` must check.

    All samples together vary at least as much as some of them do by themselves, times their share.

    sparse: (n_traces, n) intensity of some of the n_samples.
    """
    is_dark = ~(highest > 0.0)
    if is_dark.all():  # there may be no sample at all
        return np.asarray(is_dark)
    share = sparse.shape[1] / n_samples
    some = np.log(np.maximum(sparse / np.where(is_dark, np.float32(1.0), highest)[:, np.newaxis], _MIN_OF_HIGHEST))
    return np.asarray(is_dark | ~(some.var(axis=1) * share > 2.0 * _FLAT_LOG_VARIANCE))


def _dead(intensity: NDArray[np.float32], highest: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Find traces (n_traces, n_samples) that hold no picture."""
    dead = ~(highest > 0.0)
    if dead.all():
        return np.asarray(dead)
    unsure = ~dead & _may_be_dead(intensity[:, ::_SPARSE], intensity.shape[1], highest)
    # Any level step across the trace clears this; only a constant or nearly constant trace does not.
    for ping in np.flatnonzero(unsure):
        dead[ping] = np.log(np.maximum(intensity[ping] / highest[ping], _MIN_OF_HIGHEST)).var() < _FLAT_LOG_VARIANCE
    return dead
