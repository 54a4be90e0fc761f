"""Radiometry: parts against slow definitions, and the whole on a level sea floor of known brightness."""

from __future__ import annotations

import math
from collections import Counter
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from auv_mcm.settings.config import WaterfallConfig
from auv_mcm.waterfall.radiometry import AngleCurve, GainStepFilter, local_mean, ping_levels
from tests.auv_mcm.waterfall.simulated_pings import (
    ALTITUDE_M,
    CONFIG,
    GROUND_M,
    SLANT_M,
    Run,
    amplitudes,
    decibels,
    row_of_ping,
    run,
)

N_PINGS = 320
COLUMN_M = (np.arange(751) + 0.5) * CONFIG.waterfall.column_spacing_m
GRAZING_DEG = np.degrees(np.arctan2(ALTITUDE_M, COLUMN_M))


@pytest.fixture(scope="module")
def plain_samples() -> NDArray[np.float64]:
    return amplitudes(N_PINGS)


@pytest.fixture(scope="module")
def plain(plain_samples: NDArray[np.float64]) -> Run:
    return run(plain_samples)


def test_a_level_sea_floor_comes_out_level() -> None:
    """Within 0.15 dB in pixels of a quarter metre, from the edge of what earns a claim down to 8 degrees."""
    intensity, valid = run(amplitudes(N_PINGS, looks=16)).image()
    profile = decibels(np.array([intensity[40:-40, j : j + 4].mean() for j in range(0, 740, 4)]))
    judged = (GRAZING_DEG[2:742:4] < CONFIG.waterfall.max_grazing_deg) & (GRAZING_DEG[2:742:4] > 8.0)
    assert valid[:, :740].all()
    assert judged.sum() > 150
    assert np.abs(profile[judged]).max() < 0.15


def test_single_look_speckle_comes_out_level_too(plain: Run) -> None:
    intensity, _ = plain.image()
    profile = decibels(np.array([intensity[40:-40, j : j + 16].mean() for j in range(48, 700, 16)]))
    assert np.abs(profile).max() < 0.3


def test_a_changing_altitude_does_not_smear_the_angle_curve() -> None:
    """Dead samples before the first return shift the trace: the same ground at another slant range and angle."""
    curve = AngleCurve()
    ground_m = COLUMN_M[None, :]
    for block in range(30):
        altitude = 5.0 + 2.0 * np.sin(block / 3.0)
        tangent = np.full((8, 1), altitude) / ground_m
        learnt = curve.learn(np.log(np.sin(np.arctan(tangent)) ** 2), np.ones(tangent.shape, dtype=np.bool_), tangent)
    steep = np.degrees(np.arctan(tangent)) < 8.0
    np.testing.assert_allclose(learnt[~steep], np.log(np.sin(np.arctan(tangent)) ** 2)[~steep], atol=0.03)


@pytest.mark.parametrize("from_m", [12.0, 25.0])
def test_a_shadow_keeps_its_contrast(plain_samples: NDArray[np.float64], plain: Run, from_m: float) -> None:
    """A shadow of 10 dB, 2 m along range and 2 m along track."""

    def between(ground_m: NDArray[Any], start_m: float, stop_m: float) -> NDArray[np.bool_]:
        return (ground_m > from_m + start_m) & (ground_m < from_m + stop_m)

    dark = plain_samples.copy()
    dark[:, 150:167, between(GROUND_M, 0.0, 2.0)] *= math.sqrt(0.1)
    shadowed = run(dark)
    rows = slice(row_of_ping(152, shadowed.first_row), row_of_ping(165, shadowed.first_row))

    def change(columns: NDArray[np.bool_]) -> float:
        return float(decibels(shadowed.image()[0][rows][:, columns].mean() / plain.image()[0][rows][:, columns].mean()))

    inside, outside = change(between(COLUMN_M, 0.2, 1.8)), change(between(COLUMN_M, 2.5, 6.0))
    assert inside - outside == pytest.approx(-10.0, abs=0.5)
    assert outside == pytest.approx(0.0, abs=0.5)


def test_a_third_of_the_samples_missing_changes_no_estimate(plain_samples: NDArray[np.float64], plain: Run) -> None:
    masked = plain_samples.copy()
    masked[np.random.default_rng(1).random(masked.shape) < 0.3] = np.nan
    gappy = run(masked)
    both = gappy.image()[1] & plain.image()[1]
    assert both[:, 40:740].mean() > 0.6
    for columns in (slice(60, 240), slice(240, 480), slice(480, 740)):
        ratio = decibels(
            gappy.image()[0][:, columns][both[:, columns]].mean()
            / plain.image()[0][:, columns][both[:, columns]].mean()
        )
        assert abs(ratio) < 0.05


@pytest.mark.parametrize(
    ("step_db", "ping"), [(30.0, 40), (-30.0, 200), (6.0, 100), (-6.0, 223), (30.0, 255), (6.0, 3)]
)
def test_a_gain_step_leaves_no_trace(plain_samples: NDArray[np.float64], plain: Run, step_db: float, ping: int) -> None:
    stepped = plain_samples.copy()
    stepped[:, ping:] *= 10.0 ** (step_db / 20.0)
    found = run(stepped)
    assert found.counters["radiometry.port_gain_step"] == 1
    assert found.counters["radiometry.starboard_gain_step"] == 1
    (intensity, valid), (expected, _) = found.image(), plain.image()
    change = np.abs(decibels(np.where(valid, intensity, 1.0) / np.where(valid, expected, 1.0)))
    row = row_of_ping(ping, found.first_row)
    change[row - 2 : row + 3] = 0.0
    assert change[:, 40:].max() < 0.5


def test_gain_steps_every_way_are_all_taken_out(plain_samples: NDArray[np.float64], plain: Run) -> None:
    steps_db = {50: -15.0, 90: 20.0, 121: 20.0, 200: -30.0, 260: 6.0}
    gain_db = np.array([sum(step for start, step in steps_db.items() if start <= ping) for ping in range(N_PINGS)])
    found = run(plain_samples * 10.0 ** (gain_db[:, None] / 20.0))
    assert found.counters["radiometry.port_gain_step"] == 5
    ratio = decibels(found.image()[0][:, 40:740].mean(axis=1) / plain.image()[0][:, 40:740].mean(axis=1))
    assert np.abs(ratio).max() < 0.5


def test_a_change_of_the_sea_floor_is_left(plain_samples: NDArray[np.float64]) -> None:
    """Ten decibels more from all of the bottom and none from the water column is another bottom, not another gain."""
    change = np.where((np.arange(N_PINGS) >= 160)[:, None] & (SLANT_M >= ALTITUDE_M)[None, :], math.sqrt(10.0), 1.0)
    found = run(plain_samples * change)
    assert found.counters["radiometry.port_gain_step"] == 0
    intensity, _ = found.image()
    row = row_of_ping(160, found.first_row)
    step = decibels(intensity[row + 1 : row + 11, 100:700].mean() / intensity[row - 11 : row - 1, 100:700].mean())
    assert step > 6.0  # of 10, the local mean takes the rest


@pytest.mark.parametrize("gain", [1e-6, 1e6])
def test_nothing_depends_on_absolute_gain(plain_samples: NDArray[np.float64], plain: Run, gain: float) -> None:
    found = run(plain_samples * gain)
    np.testing.assert_array_equal(found.image()[1], plain.image()[1])
    np.testing.assert_allclose(found.image()[0], plain.image()[0], rtol=1e-5)


def test_the_curve_is_not_dragged_by_targets_or_shadows() -> None:
    """A tenth of the pixels 30 dB off, in either direction, moves the mean of the logarithm by 0.3 nats and not by
    0.7."""
    tangent = np.full((32, 100), 0.5)
    speckle = np.log(np.random.default_rng(0).exponential(size=(40, 32, 100)))
    for offset in (6.9, -6.9):
        curve = AngleCurve()
        for block in speckle:
            curve.learn(block, np.ones(block.shape, dtype=np.bool_), tangent)
        clean = curve.learn(speckle[0], np.ones(tangent.shape, dtype=np.bool_), tangent)[0, 0]
        spoilt = speckle[1].copy()
        spoilt[:, :10] += offset
        for _ in range(40):
            moved = curve.learn(spoilt, np.ones(tangent.shape, dtype=np.bool_), tangent)[0, 0]
        assert abs(moved - clean) < 0.4


def test_a_curve_without_anything_to_learn_from_is_zero() -> None:
    shape = (4, 50)
    assert not AngleCurve().learn(np.full(shape, 7.0), np.zeros(shape, dtype=np.bool_), np.ones(shape)).any()


def slow_median(values: list[float], usable: list[bool]) -> float:
    known = sorted(value for value, ok in zip(values, usable, strict=True) if ok)
    n = len(known)
    return math.nan if n < 24 else known[n // 2] if n % 2 else 0.5 * (known[n // 2 - 1] + known[n // 2])


@given(
    values=hnp.arrays(np.float64, st.tuples(st.integers(1, 3), st.integers(1, 40)), elements=st.floats(-1e6, 1e6)),
    share=st.floats(0.5, 1.0),
)
def test_row_medians_skip_what_is_not_usable(values: NDArray[np.float64], share: float) -> None:
    usable = np.random.default_rng(0).random(values.shape) < share
    expected = [slow_median(row.tolist(), ok.tolist()) for row, ok in zip(values, usable, strict=True)]
    np.testing.assert_array_equal(ping_levels(values, usable), expected)


def levels(gain: NDArray[np.float64], seed: int = 0) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    random = np.random.default_rng(seed)
    return gain + random.normal(0.0, 0.05, gain.size), gain - 4.0 + random.normal(0.0, 0.1, gain.size)


@given(step=st.floats(1.0, 8.0) | st.floats(-8.0, -1.0), ping=st.integers(3, 40), cut=st.integers(1, 49))
def test_gain_steps_are_found_wherever_the_blocks_are_cut(step: float, ping: int, cut: int) -> None:
    gain = np.where(np.arange(50) < ping, 0.0, step)
    seabed, water = levels(gain)
    whole = GainStepFilter()
    correction, n_steps = whole.corrections(seabed, water)
    parts = GainStepFilter()
    first, second = parts.corrections(seabed[:cut], water[:cut]), parts.corrections(seabed[cut:], water[cut:])
    for found, count in ((correction, n_steps), (np.concatenate([first[0], second[0]]), first[1] + second[1])):
        assert count == 1
        assert np.abs(found - gain).max() < 0.25


@given(seed=st.integers(0, 2**32 - 1), step=st.floats(-8.0, 8.0), ping=st.integers(1, 49), cut=st.integers(0, 49))
def test_a_steady_block_is_remembered_like_its_pings(seed: int, step: float, ping: int, cut: int) -> None:
    """The pings before a step, some of them without a level, by themselves or together with it: the same correction to
    the bit."""
    cut = min(cut, ping)
    seabed, water = levels(np.where(np.arange(50) < ping, 0.0, step), seed)
    for level in (seabed, water):
        level[np.random.default_rng(seed).random(50) < 0.2] = np.nan
    whole, n_steps = GainStepFilter().corrections(seabed, water)
    parts = GainStepFilter()
    first, second = parts.corrections(seabed[:cut], water[:cut]), parts.corrections(seabed[cut:], water[cut:])
    np.testing.assert_array_equal(np.concatenate([first[0], second[0]]), whole)
    assert first[1] + second[1] == n_steps


@pytest.mark.parametrize("step", [0.5, -0.5])
def test_small_steps_are_left_to_the_local_mean(step: float) -> None:
    correction, n_steps = GainStepFilter().corrections(*levels(np.where(np.arange(50) < 25, 0.0, step)))
    assert n_steps == 0
    assert not correction.any()


def test_steps_of_sea_floor_or_water_alone_are_no_gain() -> None:
    gain, none = np.where(np.arange(50) < 25, 0.0, 3.0), np.zeros(50)
    for seabed, water in (
        (levels(gain)[0], levels(none)[1]),
        (levels(none)[0], levels(gain)[1]),
        (levels(gain)[0], levels(-gain)[1]),
    ):
        assert GainStepFilter().corrections(seabed, water)[1] == 0


def test_a_single_loud_ping_is_corrected_and_the_next_ones_back() -> None:
    """Interference for one ping looks like two gain steps, and both are taken out."""
    gain = np.where(np.arange(50) == 25, 5.0, 0.0)
    correction, _ = GainStepFilter().corrections(*levels(gain))
    assert np.abs(correction - gain).max() < 0.25


def test_without_a_water_column_there_is_no_gain_step() -> None:
    gain = np.where(np.arange(50) < 25, 0.0, 3.0)
    filter_ = GainStepFilter()
    correction, n_steps = filter_.corrections(levels(gain)[0], np.full(50, np.nan))
    assert (n_steps, bool(correction.any())) == (0, False)
    correction, n_steps = filter_.corrections(np.full(50, np.nan), np.full(50, np.nan))
    assert (n_steps, bool(correction.any())) == (0, False)


def slow_local_mean(
    intensity: NDArray[np.float32], usable: NDArray[np.bool_], half_rows: int, half_columns: int
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Each pixel limited by the geometric mean of its own surroundings, then averaged."""

    def around(i: int, j: int) -> tuple[slice, slice]:
        return slice(max(i - half_rows, 0), i + half_rows + 1), slice(max(j - half_columns, 0), j + half_columns + 1)

    limited = intensity.astype(np.float64)
    for i, j in zip(*np.nonzero(usable), strict=True):
        box = around(i, j)
        geometric = np.exp(
            np.mean(np.log(np.clip(intensity[box][usable[box]].astype(np.float64), math.exp(-3.0), math.exp(3.0))))
        )
        limited[i, j] = min(limited[i, j], 6.0 * math.exp(np.euler_gamma) * geometric)
    mean, known = np.zeros(intensity.shape), np.zeros(intensity.shape, dtype=np.bool_)
    for i, j in np.ndindex(*intensity.shape):
        box = around(i, j)
        values = limited[box][usable[box]]
        if values.size >= max(0.25 * usable[box].size, 1):
            mean[i, j] = values.mean()
            known[i, j] = mean[i, j] > 0.0
    return mean, known


@given(seed=st.integers(0, 1000), shape=st.tuples(st.integers(1, 9), st.integers(1, 12)), share=st.floats(0.0, 1.0))
def test_local_means_are_masked_means_of_what_lies_in_the_image(
    seed: int, shape: tuple[int, int], share: float
) -> None:
    random = np.random.default_rng(seed)
    usable = random.random(shape) < share
    glints = random.choice([1.0, 50.0], p=[0.9, 0.1], size=shape)
    intensity = np.where(usable, random.exponential(glints), 0.0).astype(np.float32)
    mean, known = local_mean(intensity, usable, 7.5 / 4.0, 7.5 / 6.0)
    slow_mean, slow_known = slow_local_mean(intensity, usable, 2, 3)
    np.testing.assert_array_equal(known, slow_known)
    np.testing.assert_allclose(mean[known], slow_mean[known], rtol=1e-6)


def test_the_stage_counts_no_gain_step_on_plain_ground(plain: Run) -> None:
    assert +plain.counters == Counter()


def test_a_bright_patch_is_no_reference_for_itself() -> None:
    """The local mean and the angle curve forget within twenty metres what was darker before; levels are those of the
    mission."""
    factor = np.ones((1, 900, 1))
    factor[0, 500:] = 4.0  # only the sea floor gets brighter; the water column stays
    samples = amplitudes(900, factor=np.where(SLANT_M > ALTITUDE_M, factor, 1.0))
    seen = run(samples)
    tiles = [tile for tile in seen.tiles if tile.side == "port"]
    level = np.concatenate([tile.level[tile.core_start : tile.core_stop] for tile in tiles if tile.level is not None])
    intensity, valid = seen.image()
    dark, bright = (
        slice(row_of_ping(first, seen.first_row), row_of_ping(last, seen.first_row))
        for first, last in ((300, 450), (800, 880))
    )
    rise = float(np.nanmedian(level[bright]) - np.nanmedian(level[dark]))
    # less what the patch, two fifths of the mission, has added to its mean
    assert 0.5 * math.log(4.0) < rise < math.log(4.0)
    assert intensity[bright][valid[bright]].mean() == pytest.approx(intensity[dark][valid[dark]].mean(), rel=0.1)


def test_levels_do_not_depend_on_the_blocks_that_tiles_are_cut_from() -> None:
    samples = amplitudes(600, seed=3)
    grid = WaterfallConfig(row_spacing_m=CONFIG.waterfall.row_spacing_m, column_spacing_m=0.06, tile_rows=128)
    one, other = (
        run(samples, config=config, overlap_m=16.0)
        for config in (CONFIG, msgspec.structs.replace(CONFIG, waterfall=grid))
    )
    levels = [
        np.concatenate(
            [t.level[t.core_start : t.core_stop] for t in each.tiles if t.side == "port" and t.level is not None]
        )
        for each in (one, other)
    ]
    inner = slice(0, min(map(len, levels)))
    assert np.allclose(levels[0][inner], levels[1][inner], equal_nan=True, atol=1e-5)
