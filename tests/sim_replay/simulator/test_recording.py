"""Stored numbers are what the recorder makes of echoes: nothing lost below full scale but rounding."""

from __future__ import annotations

from typing import Any, get_args, get_type_hints

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from sim_replay.simulator.recording import complete, record, sample_type
from sim_replay.simulator.scene import SampleRecorder

KINDS = get_args(get_type_hints(SampleRecorder)["samples"])
GAIN = np.linspace(0.5, 2.0, 40)
ECHO = np.random.Generator(np.random.PCG64(5)).exponential(size=(3, 40)).astype(np.float32)


def stored(recorder: SampleRecorder, intensity: NDArray[np.float32] = ECHO, n_ringing: int = 0) -> NDArray[Any]:
    return np.stack([trace.samples for trace in record(intensity, GAIN, n_ringing, complete(recorder), 0.05)])


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_usual_fills_in_for_what_is_left_open_and_the_file_type_fits(kind: Any) -> None:
    usual = complete(SampleRecorder(samples=kind))
    assert None not in (usual.seabed_counts, usual.full_scale, usual.db_per_count)
    assert complete(SampleRecorder(samples=kind, full_scale=99)).full_scale == 99
    assert stored(usual).dtype == np.dtype(sample_type(usual))


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind.startswith("amplitude")])
def test_amplitudes_are_roots_of_intensity_and_gain(kind: Any) -> None:
    exact = 50.0 * np.sqrt(ECHO * GAIN)
    assert exact.max() < 255.0
    rounding = 1e-4 if kind == "amplitude_float32" else 0.5 + 1e-4
    assert stored(SampleRecorder(samples=kind, seabed_counts=50.0)) == pytest.approx(exact, abs=rounding)


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind.startswith("log")])
def test_logarithms_are_decibels(kind: Any) -> None:
    exact = 120.0 + 10.0 * np.log10(ECHO * GAIN) / 0.5
    assert 0.0 < exact.min() < exact.max() < 255.0
    assert stored(SampleRecorder(samples=kind, seabed_counts=120.0, db_per_count=0.5)) == pytest.approx(
        exact, abs=0.5 + 1e-3
    )


@pytest.mark.parametrize("kind", KINDS)
@given(full_scale=st.integers(15, 250), n_ringing=st.integers(0, 40))
def test_ringing_and_loud_echoes_clip_at_full_scale_and_silence_is_zero(
    kind: Any, full_scale: int, n_ringing: int
) -> None:
    recorder = SampleRecorder(samples=kind, full_scale=full_scale, seabed_counts=10.0)
    loud, silent = (
        stored(recorder, np.full_like(ECHO, 1e30), n_ringing),
        stored(recorder, np.zeros_like(ECHO), n_ringing),
    )
    assert np.all(loud == full_scale)
    assert np.all(silent[:, :n_ringing] == full_scale)
    assert np.all(silent[:, n_ringing:] == 0)


def test_ranges_are_those_the_recorder_believes_in() -> None:
    (trace, *_) = record(ECHO, GAIN, 0, complete(SampleRecorder()), 0.0504)
    assert (trace.first_range_m, trace.spacing_m) == pytest.approx((0.0252, 0.0504))
