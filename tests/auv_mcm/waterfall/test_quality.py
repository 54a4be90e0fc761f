"""What of a recorded trace is believed, and that every refusal is counted."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from auv_mcm.records import EchoTrace, Transfer
from auv_mcm.waterfall.ground import make_traces
from auv_mcm.waterfall.quality import CheckedTrace, TraceChecker

AMPLITUDE = Transfer("amplitude")
SPACING_M = 0.05


def rayleigh(seed: int, scale: float = 2000.0, n_samples: int = 800) -> NDArray[np.float64]:
    return scale * np.sqrt(np.random.default_rng(seed).exponential(size=n_samples))


def check_all(
    pings: list[NDArray[Any]], transfer: Transfer = AMPLITUDE, full_scale: float | None = None
) -> tuple[list[CheckedTrace], Counter[str]]:
    counters: Counter[str] = Counter()
    checker = TraceChecker("port", transfer, full_scale, counters)
    return [
        checker.check(EchoTrace(samples=s, first_range_m=SPACING_M / 2, spacing_m=SPACING_M)) for s in pings
    ], counters


def test_a_good_trace_passes_untouched_and_uncounted() -> None:
    samples = rayleigh(0).astype(np.float32)
    (checked,), counters = check_all([samples])
    np.testing.assert_allclose(checked.intensity, samples.astype(np.float64) ** 2, rtol=1e-6)
    assert checked.valid.all()
    assert not checked.saturated.any()
    assert counters == Counter()


@pytest.mark.parametrize(
    ("dtype", "ceiling", "scale"),
    [(np.uint16, 32767, 12000.0), (np.uint16, 65535, 30000.0), (np.int16, 32767, 12000.0), (np.uint8, 255, 110.0)],
)
def test_the_recorders_ceiling_is_found(dtype: type, ceiling: int, scale: float) -> None:
    pings: list[NDArray[Any]] = [np.minimum(rayleigh(seed, scale), ceiling).astype(dtype) for seed in range(5)]
    checked, counters = check_all(pings)
    for samples, result in zip(pings, checked, strict=True):
        np.testing.assert_array_equal(result.saturated, samples == ceiling)
        assert result.valid.all()
        np.testing.assert_allclose(result.intensity, samples.astype(np.float64) ** 2, rtol=1e-6)
    assert counters["quality.sample_saturated"] == sum(int((samples == ceiling).sum()) for samples in pings) > 0


def test_bright_samples_below_the_ceiling_are_not_saturated() -> None:
    strong = [np.minimum(rayleigh(seed, 9000.0), 32766).astype(np.uint16) for seed in range(5)]
    assert not any(result.saturated.any() for result in check_all(strong)[0])
    weak = np.minimum(rayleigh(1, 60.0), 127).astype(np.uint8)
    assert (weak == 127).any()
    assert not check_all([weak])[0][0].saturated.any()


@pytest.mark.parametrize("dtype", [np.uint16, np.float32])
def test_a_configured_full_scale_counts_from_98_percent(dtype: type) -> None:
    samples: NDArray[Any] = rayleigh(2, 1000.0).astype(dtype)
    samples[10:14] = [1999, 1961, 1959, 2000]
    (checked,), _ = check_all([samples], full_scale=2000.0)
    np.testing.assert_array_equal(checked.saturated, samples.astype(np.float64) >= 1960.0)
    assert checked.saturated[[10, 11, 13]].all()
    assert not checked.saturated[12]


def test_pings_clipped_beyond_the_ring_down_are_counted() -> None:
    ring_down = rayleigh(3, n_samples=600).astype(np.uint16)
    ring_down[:40] = 32767  # the first two metres
    clipped = rayleigh(4).astype(np.uint16)
    clipped[100:150] = 32767
    _, counters = check_all([ring_down])
    assert counters["quality.sample_saturated"] == 40
    assert counters["quality.port_ping_mostly_saturated"] == 0
    assert check_all([clipped])[1]["quality.port_ping_mostly_saturated"] == 1


def test_samples_that_are_no_numbers_are_masked_and_counted() -> None:
    samples = rayleigh(5)
    samples[[3, 50]] = np.nan
    samples[60] = -np.inf
    samples[70:73] = -1.0
    (checked,), counters = check_all([samples])
    assert np.flatnonzero(~checked.valid).tolist() == [3, 50, 60, 70, 71, 72]
    assert (checked.intensity[~checked.valid] == 0.0).all()
    assert counters == {"quality.sample_not_finite_or_negative": 6}


def test_invalid_samples_are_never_saturated() -> None:
    samples = rayleigh(6)
    samples[5] = np.inf
    assert not check_all([samples], full_scale=1e9)[0][0].saturated.any()


@pytest.mark.parametrize("broken", [np.zeros(800), np.full(800, 17.0), np.full(800, np.nan), np.full(800, -5.0)])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_channel_without_signal_is_dead(broken: NDArray[np.float64], dtype: type) -> None:
    checked, counters = check_all([rayleigh(7), broken.astype(dtype), broken.astype(dtype), rayleigh(8)])
    assert counters["quality.port_dead"] == 2
    assert [bool(result.valid.any()) for result in checked] == [True, False, False, True]
    assert all(not result.intensity.any() and not result.saturated.any() for result in checked[1:3])


def test_a_constant_channel_is_dead_whatever_the_transfer() -> None:
    constant = np.full(800, 150, dtype=np.uint8)
    for transfer in (AMPLITUDE, Transfer("intensity"), Transfer("log", 0.35)):
        assert check_all([constant], transfer)[1]["quality.port_dead"] == 1


def test_a_channel_that_repeats_itself_is_stuck_until_it_moves() -> None:
    first, second = rayleigh(9), rayleigh(10)
    first[20] = np.nan
    checked, counters = check_all([first, first.copy(), first.copy(), second, first], full_scale=4000.0)
    assert [bool(result.valid.any()) for result in checked] == [True, False, False, True, True]
    assert [bool(result.saturated.any()) for result in checked] == [True, False, False, True, True]
    assert counters["quality.port_stuck"] == 2


def test_another_sample_count_is_not_a_repetition() -> None:
    assert check_all([rayleigh(11), rayleigh(11)[:700]])[1]["quality.port_stuck"] == 0


def test_many_looks_over_a_level_bottom_are_not_dead() -> None:
    """Sixteen looks over a sea floor 20 dB above the water column: variance comes from the step if not from speckle."""
    intensity = np.random.default_rng(0).gamma(16, 1 / 16, 800) * np.where(np.arange(800) < 100, 0.01, 1.0)
    assert check_all([np.sqrt(intensity)])[1] == Counter()
    assert check_all([np.sqrt(np.random.default_rng(1).gamma(16, 1 / 16, 800))])[1] == Counter()


def test_a_trace_without_samples_is_refused_quietly() -> None:
    for dtype in (np.uint8, np.float32):
        (checked,), counters = check_all([np.zeros(0, dtype=dtype)])
        assert checked.valid.shape == (0,)
        assert counters == {"quality.port_no_samples": 1}


@pytest.mark.parametrize("gain", [1e-12, 1e-6, 1e6, 1e12])
def test_nothing_depends_on_gain(gain: float) -> None:
    pings = [rayleigh(12, 1.0), np.full(800, 1.0), rayleigh(13, 1.0)]
    checked, counters = check_all([gain * samples for samples in pings])
    reference, reference_counters = check_all(pings)
    assert counters == reference_counters
    for one, other in zip(checked, reference, strict=True):
        np.testing.assert_array_equal(one.valid, other.valid)
        np.testing.assert_allclose(one.intensity / gain**2, other.intensity, rtol=1e-5)


def test_vanishing_samples_raise_no_floating_point_flag() -> None:
    for scale in (1e-310, 1e-45, 1e-22, 1e-19):
        with np.errstate(all="raise", under="ignore"):
            check_all([rayleigh(14, scale), rayleigh(15, scale)])


@pytest.mark.parametrize("n_absurd", [1, 5])
def test_absurd_samples_are_masked_and_counted_and_the_rest_is_kept(n_absurd: int) -> None:
    counters: Counter[str] = Counter()
    checker = TraceChecker("port", Transfer("amplitude"), None, counters)
    samples = np.random.default_rng(1).rayleigh(100.0, 400).astype(np.float32)
    samples[10 : 10 + n_absurd] = 1e12
    checked = checker.check(EchoTrace(samples=samples, first_range_m=0.05, spacing_m=0.1))
    assert counters["quality.sample_absurd"] == n_absurd
    assert np.flatnonzero(~checked.valid).tolist() == list(range(10, 10 + n_absurd))
    assert checked.intensity.max() < 1e6


def test_one_corrupt_sample_does_not_raise_the_ceiling() -> None:
    checker = TraceChecker("port", Transfer("amplitude"), None, Counter())
    samples = np.random.default_rng(2).integers(100, 3000, 400).astype(np.uint16)
    samples[:20] = 4095
    corrupt = samples.copy()
    corrupt[200] = 65535
    for trace, clipped in ((samples, 20), (corrupt, 21), (np.roll(samples, 3), 20)):
        checked = checker.check(EchoTrace(samples=trace, first_range_m=0.05, spacing_m=0.1))
        assert int(checked.saturated.sum()) == clipped


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_traces_together_are_checked_as_one_by_one(dtype: type) -> None:
    """Good ones, some that repeat the one before, are silent, constant, clipped, broken, or have an absurd sample."""
    random = np.random.Generator(np.random.PCG64(5))
    pings: list[NDArray[Any]] = [
        np.minimum(rayleigh(seed, 60.0 * (1 + seed % 7)), 255.0).astype(dtype) for seed in range(40)
    ]
    for ping in random.integers(1, 40, 8).tolist():
        pings[ping] = pings[ping - 1].copy()
    pings[3], pings[11] = np.zeros_like(pings[3]), np.full_like(pings[3], 7)
    if dtype is np.float32:
        pings[17][5], pings[21][9], pings[22][9], pings[30][:40] = np.nan, 1e12, -1.0, np.nan
        pings[31] = pings[30].copy()
    one_by_one, counters = check_all(pings)
    together: Counter[str] = Counter()
    checker = TraceChecker("port", AMPLITUDE, None, together)
    traces = [EchoTrace(samples=s, first_range_m=SPACING_M / 2, spacing_m=SPACING_M) for s in pings]
    blocks = [checker.check_all(traces[start:stop]) for start, stop in ((0, 7), (7, 8), (8, 40))]
    for k, parts in enumerate(zip(*blocks, strict=True)):
        np.testing.assert_array_equal(
            np.concatenate(parts), np.stack([checked[k] for checked in one_by_one]), strict=True
        )
    assert together == counters
    assert counters["quality.port_stuck"] >= 4


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_zeros_are_no_echo_where_no_trace_ever_held_one(dtype: type) -> None:
    """What is dark later, behind an object, stays a shadow; another layout is judged by itself."""

    def trace(samples: NDArray[Any], spacing_m: float = SPACING_M) -> EchoTrace:
        return EchoTrace(samples=samples.astype(dtype), first_range_m=0.1, spacing_m=spacing_m)

    filled = [np.append(rayleigh(seed, 60.0).clip(1, 200), np.zeros(100)) for seed in range(3)]
    dark, elsewhere = (np.where(np.arange(900) < 600, samples, 0.0) for samples in filled[:2])
    blocks = [
        ([trace(dark)], 600),
        (list(map(trace, filled)), 800),
        ([trace(dark)], 800),
        ([trace(elsewhere, 2.0 * SPACING_M)], 600),
    ]
    checker = TraceChecker("port", AMPLITUDE, None, Counter())
    for block, n_measured in blocks:
        assert checker.check_all(block).valid.sum(axis=1).tolist() == [n_measured] * len(block)


@given(
    seed=st.integers(0, 2**32 - 1),
    kind=st.sampled_from([np.uint8, np.uint16, np.int16, np.uint32, np.float32]),
    transfer=st.sampled_from([AMPLITUDE, Transfer("intensity"), Transfer("log", 0.4)]),
    full_scale=st.sampled_from([None, 150.0]),
    n_samples=st.sampled_from([0, 1, 2, 5, 300]),
)
@settings(deadline=None)
def test_traces_add_up_to_what_each_of_them_holds(
    seed: int, kind: type, transfer: Transfer, full_scale: float | None, n_samples: int
) -> None:
    """Whatever of them is dead, stuck, clipped or absurd, block after block."""
    random = np.random.default_rng(seed)
    counters: tuple[Counter[str], Counter[str]] = (Counter(), Counter())
    whole, single = (TraceChecker("port", transfer, full_scale, counted) for counted in counters)
    last = np.zeros(n_samples)
    for _ in range(3):
        pings = [
            rayleigh(int(random.integers(99)), 60.0, n_samples).clip(0, 127) for _ in range(int(random.integers(1, 6)))
        ]
        pings[0][:] = last if random.integers(2) else pings[0]
        last = pings[-1]
        for ping in pings:
            match random.integers(8):
                case 0:
                    ping[:] = random.integers(2)
                case 1:
                    ping[: n_samples // 3] = 127
                case 2 if kind is np.float32:
                    ping[::7] = random.choice([np.nan, -1.0, 1e18])
        traces = [EchoTrace(samples=p.astype(kind), first_range_m=SPACING_M / 2, spacing_m=SPACING_M) for p in pings]
        sums = whole.cumulate(traces)
        checked = single.check_all(traces)
        expected = make_traces(checked.intensity, checked.valid, checked.saturated, SPACING_M / 2, SPACING_M)
        for found, wanted in zip(sums, expected, strict=True):
            np.testing.assert_array_equal(found, wanted)
    assert counters[0] == counters[1]
