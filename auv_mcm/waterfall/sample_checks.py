"""Check and scale the samples of one side before anything is computed from them."""

from __future__ import annotations

import math
from collections import Counter
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from auv_mcm.records import EchoTrace, Notice, Side

# Intensities are powers of samples in float32, 2.86 at the maximum (`sample_law`), which ends at 2^-126 and 2^127:
# 2^12 above and below the middle sample fit.
_MAX_EXPONENT: Final = 22
_N_SOME: Final = 128  # samples that give the exponent of the middle one
_N_IN_A_ROW: Final = 20  # traces: two seconds at 10 Hz, so that a single damaged ping raises nothing


class SampleCheck:
    """Check traces of one side in order; count in `counters`.

    Floating-point samples are scaled by a power of two where their powers would not fit into float32: nothing depends
    on absolute gain.
    """

    def __init__(self, side: Side, full_scale: float | None, counters: Counter[str]) -> None:
        """full_scale: the configured one, in the recorder's own numbers; samples are not scaled then."""
        self._side = side
        self._scales = full_scale is None
        self._counters = counters
        self._exponent = 0
        self._n_negative = self._n_unusable = 0
        self._reported = self._lost = False

    def usable(self, trace: EchoTrace | None) -> EchoTrace | None:
        """Return the trace, scaled; None where it is none, or no row of two or more samples at known ranges."""
        if trace is None:
            return None
        samples, metric = trace.samples, math.isfinite(trace.first_range_m) and 0.0 < trace.spacing_m < math.inf
        if samples.ndim == 1 and samples.shape[0] >= 2 and samples.dtype.kind in "uif" and metric:
            self._n_unusable = 0
            return self.scaled(trace)
        self._n_unusable += 1
        self._counters["ping.trace_unusable"] += 1
        return None

    def take_notices(self, place: str) -> list[Notice]:
        """Raise a notice, once, where no trace could be used for a while. place: of the newest."""
        if self._n_unusable != _N_IN_A_ROW or self._lost:
            return []
        self._lost = True
        text = (
            f"the samples of {self._side} cannot be used, in {_N_IN_A_ROW} pings in a row: they are fewer than two a "
            "ping, or not at finite ranges that grow. Nothing is seen there. Check what records or reads them."
        )
        return [Notice(code="quality.samples_unusable", text=text, place=place)]

    def scaled(self, trace: EchoTrace) -> EchoTrace:
        """Scale the trace where its powers would not fit into float32."""
        if not self._scales or trace.samples.dtype.kind != "f":
            return trace
        some = np.abs(trace.samples[:: max(trace.samples.shape[0] // _N_SOME, 1)]).astype(np.float64)
        some = some[np.isfinite(some) & (some > 0.0)]
        if some.size:
            exponent = math.frexp(float(np.partition(some, some.size // 2)[some.size // 2]))[1]
            if abs(exponent - self._exponent) > _MAX_EXPONENT:
                self._exponent = exponent if abs(exponent) > _MAX_EXPONENT else 0
        if not self._exponent:
            return trace
        self._counters["quality.trace_scaled"] += 1
        samples: NDArray[Any] = np.ldexp(trace.samples.astype(np.float64), -self._exponent)
        return EchoTrace(samples=samples, first_range_m=trace.first_range_m, spacing_m=trace.spacing_m)

    def check(self, trace: EchoTrace, place: str) -> list[Notice]:
        """Check the samples of a trace; returns notices that ask a person to act."""
        samples = trace.samples
        if samples.dtype.kind == "u" or (samples > 0).any() or not (samples < 0).any():
            self._n_negative = 0
            return []
        self._n_negative += 1
        self._counters["quality.trace_all_negative"] += 1
        if self._n_negative < _N_IN_A_ROW or self._reported:
            return []
        self._reported = True
        text = (
            f"the samples of {self._side} are negative, in {_N_IN_A_ROW} pings in a row. They may be decibels below "
            "full scale, or signed numbers read with the wrong sign or offset. Check the recorder's sample format and "
            "set sonar.transfer; contacts cannot be relied on until then."
        )
        return [Notice(code="quality.samples_negative", text=text, place=place)]
