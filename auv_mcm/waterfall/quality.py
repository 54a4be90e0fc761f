"""Per-ping quality control: what of a recorded trace may be believed, with a counted reason for everything refused."""

from __future__ import annotations

from collections import Counter
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.records import EchoTrace, Side
from auv_mcm.waterfall.transfer import Transfer, to_intensity

_SATURATION_FRACTION: Final = 0.98
_FLAT_LOG_VARIANCE: Final = 0.02  # sixty-four looks of pure speckle still have 0.016, and a real trace a range profile on top
_MANY_SATURATED: Final = 0.05
_ABSURD_RATIO: Final = 1e10
_NEAR_M: Final = 2.0


class CheckedTrace(NamedTuple):
    """intensity: (n_samples,) float32 linear, 0 where not valid; valid, saturated: (n_samples,) bool."""

    intensity: NDArray[np.float32]
    valid: NDArray[np.bool_]
    saturated: NDArray[np.bool_]


def _absurd(intensity: NDArray[np.float32]) -> NDArray[np.bool_] | None:
    """Samples a hundred decibels above the middle one, None if there are none.

    No echo is that strong, and in a running sum it would leave no digits for the others.
    """
    some = intensity[:: max(intensity.shape[0] // 128, 1)]
    some = some[some > 0.0]
    if some.size == 0:
        return None
    limit = _ABSURD_RATIO * float(np.partition(some, some.size // 2)[some.size // 2])
    if float(intensity.max()) <= limit:
        return None
    return np.asarray(intensity.astype(np.float64) > limit)


class TraceChecker:
    """Checks the traces of one side in order; counts what it refuses in `counters`."""

    def __init__(self, side: Side, transfer: Transfer, full_scale: float | None, counters: Counter[str]) -> None:
        self._side = side
        self._transfer = transfer
        self._full_scale = full_scale
        self._counters = counters
        self._highest = 0
        self._previous: NDArray[Any] | None = None

    def check(self, trace: EchoTrace) -> CheckedTrace:
        """Linear intensity with validity and saturation of one recorded trace."""
        samples = trace.samples
        intensity, valid = to_intensity(samples, self._transfer)
        n_bad = samples.shape[0] - int(np.count_nonzero(valid))
        if n_bad:
            self._counters["quality.sample_not_finite_or_negative"] += n_bad
        absurd = _absurd(intensity)
        if absurd is not None:
            self._counters["quality.sample_absurd"] += int(np.count_nonzero(absurd))
            intensity[absurd] = 0.0
            valid &= ~absurd
        saturated = self._saturated(samples) & valid
        self._count_saturation(trace, saturated)
        reason = self._dead(samples, intensity)
        if reason is not None:
            self._counters[f"quality.{self._side}_{reason}"] += 1
            valid = np.zeros_like(valid)
            saturated = valid
            intensity = np.zeros_like(intensity)
        self._previous = samples
        return CheckedTrace(intensity, valid, saturated)

    def _saturated(self, samples: NDArray[Any]) -> NDArray[np.bool_]:
        if self._full_scale is not None:
            return np.asarray(samples >= _SATURATION_FRACTION * self._full_scale)
        if samples.dtype.kind not in "ui" or samples.size == 0:
            return np.zeros(samples.shape, dtype=np.bool_)
        # Converters clip at all ones, often of fewer bits than the stored type has. One corrupt sample is no ceiling, three are.
        if samples.max() > self._highest:
            third_highest = np.partition(samples, -3)[-3] if samples.shape[0] >= 3 else samples.min()
            self._highest = max(self._highest, int(third_highest))
        ceiling = max((1 << self._highest.bit_length()) - 1, 255)
        return np.asarray(samples >= ceiling)

    def _count_saturation(self, trace: EchoTrace, saturated: NDArray[np.bool_]) -> None:
        n_saturated = int(np.count_nonzero(saturated))
        if n_saturated == 0:
            return
        self._counters["quality.sample_saturated"] += n_saturated
        near = max(0, round((_NEAR_M - trace.first_range_m) / trace.spacing_m))
        far = saturated[near:]
        if far.size and np.count_nonzero(far) > _MANY_SATURATED * far.size:
            self._counters[f"quality.{self._side}_ping_mostly_saturated"] += 1

    def _dead(self, samples: NDArray[Any], intensity: NDArray[np.float32]) -> str | None:
        if samples.size == 0:
            return "no_samples"
        highest = intensity.max()
        # Any level step across the trace clears this; only a constant or nearly constant trace does not.
        if highest <= 0.0 or np.log(np.maximum(intensity / highest, np.float32(1e-6))).var() < _FLAT_LOG_VARIANCE:
            return "dead"
        if self._previous is not None and np.array_equal(samples, self._previous, equal_nan=samples.dtype.kind == "f"):
            return "stuck"
        return None
