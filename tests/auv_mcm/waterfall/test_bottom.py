"""Bottom tracking on simulated water columns: steps of known place and contrast, ring-down, fish, wrong altimeters."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from auv_mcm.waterfall.bottom import BIN_M, BottomTrack, BottomTracker, change_point_scores
from auv_mcm.waterfall.ground import Traces, make_traces

N_PINGS, RANGE_M, SPACING_M, BLANK_M = 96, 40.0, 0.025, 1.0
FIRST_RETURN_M = 8.0 + np.sin(np.arange(N_PINGS) / 20.0)
UNKNOWN = np.full(N_PINGS, np.nan)


def two_sides(
    contrast_db: float,
    *,
    n_fish: int = 0,
    seed: int = 0,
    spacing_m: float = SPACING_M,
    first_return_m: NDArray[np.float64] = FIRST_RETURN_M,
) -> list[NDArray[np.float32]]:
    """Single-look speckle: ring-down, dark water with fish, and a sea floor that fades with range. One array per
    side."""
    random = np.random.default_rng(seed)
    slant_m = (np.arange(round(RANGE_M / spacing_m)) + 0.5) * spacing_m
    n_pings = first_return_m.shape[0]
    sides = []
    for _ in range(2):
        water = slant_m[None, :] < first_return_m[:, None]
        mean = np.where(water, 10.0 ** (-contrast_db / 10.0), (first_return_m[:, None] / slant_m[None, :]) ** 2)
        mean[:, slant_m < 0.8] = 1000.0
        for _ in range(n_fish):
            ping, range_m = random.integers(0, n_pings - 12), random.uniform(1.5, 6.5)
            mean[ping : ping + 12, (slant_m > range_m) & (slant_m < range_m + 0.3)] *= 100.0
        sides.append(random.exponential(mean).astype(np.float32))
    return sides


def traces(
    intensity: NDArray[np.float32], spacing_m: float = SPACING_M, valid: NDArray[np.bool_] | None = None
) -> Traces:
    good = np.ones(intensity.shape, dtype=np.bool_) if valid is None else valid
    return make_traces(
        np.where(good, intensity, np.float32(0.0)), good, np.zeros_like(good), 0.5 * spacing_m, spacing_m
    )


def track(
    sides: list[NDArray[np.float32] | None],
    altitude_m: NDArray[np.float64] = UNKNOWN,
    *,
    block: int = 32,
    spacing_m: float = SPACING_M,
) -> BottomTrack:
    tracker = BottomTracker(BLANK_M)
    done = []
    for start in range(0, altitude_m.shape[0], block):
        pings = slice(start, start + block)
        done.append(
            tracker.add(
                [None if side is None else traces(side[pings], spacing_m) for side in sides], altitude_m[pings], RANGE_M
            )
        )
    assert done[0] is None
    return BottomTrack(
        *(np.concatenate(parts) for parts in zip(*[t for t in [*done, tracker.flush()] if t is not None], strict=True))
    )


def rms_bins(found: BottomTrack, truth_m: NDArray[np.float64] = FIRST_RETURN_M) -> float:
    assert found.first_return_m.shape == truth_m.shape
    return float(np.sqrt(np.mean((found.first_return_m - truth_m) ** 2))) / BIN_M


@pytest.mark.parametrize("n_fish", [0, 1, 3])
@pytest.mark.parametrize("seed", [0, 1])
def test_a_step_of_10_db_is_followed_past_ring_down_and_fish(n_fish: int, seed: int) -> None:
    found = track([*two_sides(10.0, n_fish=n_fish, seed=seed)])
    assert rms_bins(found) <= 1.0
    assert np.abs(found.first_return_m - FIRST_RETURN_M).max() <= 3 * BIN_M
    assert found.seen.all()
    assert found.sigma_m.max() < 0.3


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_step_of_6_db_is_followed_past_a_bright_fish_on_either_side(seed: int) -> None:
    assert rms_bins(track([*two_sides(6.0, n_fish=1, seed=seed)])) <= 1.0


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_step_of_3_db_is_found_though_no_ping_alone_shows_it(seed: int) -> None:
    found = track([*two_sides(3.0, seed=seed)])
    assert rms_bins(found) <= 2.0
    # It cannot be proved, and the stated error shows that.
    assert not found.seen.any()
    assert (np.abs(found.first_return_m - FIRST_RETURN_M) < found.sigma_m).all()


@pytest.mark.parametrize("spacing_m", [0.0125, 0.05, 0.1])
def test_sample_spacing_may_be_finer_or_coarser_than_the_bins(spacing_m: float) -> None:
    found = track([*two_sides(10.0, n_fish=1, seed=5, spacing_m=spacing_m)], spacing_m=spacing_m)
    assert rms_bins(found) <= (1.0 if spacing_m <= BIN_M else 1.5)
    assert found.seen.mean() > 0.95


@pytest.mark.parametrize("dead", [0, 1])
def test_one_side_is_enough(dead: int) -> None:
    sides: list[NDArray[np.float32] | None] = [*two_sides(10.0)]
    sides[dead] = None
    found = track(sides)
    assert rms_bins(found) <= 1.0
    assert found.seen.all()


@pytest.mark.parametrize("factor", [0.5, 1.5])
@pytest.mark.parametrize("contrast_db", [10.0, 6.0])
def test_a_wrong_altitude_field_does_not_win_against_the_samples(factor: float, contrast_db: float) -> None:
    sides: list[NDArray[np.float32] | None] = [*two_sides(contrast_db)]
    found, free = track(sides, factor * FIRST_RETURN_M).first_return_m, track(sides).first_return_m
    assert np.abs(found - free).max() <= BIN_M + 1e-9  # it may decide between neighbouring bins, no more


def test_a_right_altitude_field_decides_where_the_samples_cannot() -> None:
    """A layer in the water column as bright as the sea floor, and with as sharp an edge, in every ping."""
    sides = two_sides(10.0, seed=3)
    for side in sides:
        side[:, 100:120] *= 10.0
    for altitude, bottom in ((FIRST_RETURN_M, FIRST_RETURN_M), (np.full(N_PINGS, 2.5), np.full(N_PINGS, 2.5))):
        assert rms_bins(track([*sides], altitude), bottom) <= 1.5


def test_where_no_step_shows_the_altitude_field_stands_in_and_the_doubt_is_reported() -> None:
    random = np.random.default_rng(8)
    level: list[NDArray[np.float32] | None] = [
        random.exponential(size=(N_PINGS, 600)).astype(np.float32) for _ in range(2)
    ]
    found = track(level, np.full(N_PINGS, 8.0))
    assert not found.seen.any()
    np.testing.assert_allclose(found.first_return_m, 8.0, rtol=0.25)
    assert (found.sigma_m >= 0.2 * found.first_return_m).all()


def test_where_all_echoes_begin_beyond_the_altitude_it_is_taken_as_stated() -> None:
    ripples = [side * np.where(np.arange(side.shape[1]) % 60 < 30, 1.0, 8.0) for side in two_sides(10.0)]
    first_m = 12.0
    beyond = [
        traces(side[:, round(first_m / SPACING_M) :].astype(np.float32))._replace(first_range_m=first_m + 0.0125)
        for side in ripples
    ]
    tracker = BottomTracker(BLANK_M)
    assert tracker.add([*beyond], FIRST_RETURN_M, RANGE_M) is None
    found = tracker.flush()
    assert found is not None
    assert found.seen.all()
    assert np.array_equal(found.first_return_m, FIRST_RETURN_M)
    assert np.allclose(found.sigma_m, 0.02 * FIRST_RETURN_M)
    assert tracker.add([beyond[0], traces(two_sides(10.0)[1])], 0.9 * FIRST_RETURN_M, RANGE_M) is None
    found = tracker.flush()
    assert found is not None
    assert rms_bins(found) <= 1.0, "one side shows the bottom"


def test_altitudes_that_are_no_numbers_are_ignored() -> None:
    sides: list[NDArray[np.float32] | None] = [*two_sides(10.0)]
    expected = track(sides).first_return_m
    for altitude in (0.0, -3.0, math.inf, -math.inf):
        np.testing.assert_array_equal(track(sides, np.full(N_PINGS, altitude)).first_return_m, expected)


@pytest.mark.parametrize("gain", [1e-12, 1e-6, 1e6, 1e12])
def test_the_path_does_not_depend_on_gain(gain: float) -> None:
    sides = two_sides(6.0, n_fish=1, seed=2)
    scaled = [(side * np.float32(gain)).astype(np.float32) for side in sides]
    for one, other in zip(track([*scaled]), track([*sides]), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("block", [32, 40, 17])
def test_streaming_in_blocks_finds_what_one_long_block_finds(block: int) -> None:
    """Paths merge within the lag of one block; only what is smoothed beyond the lag may differ at the last ping of a
    block."""
    sides: list[NDArray[np.float32] | None] = [*two_sides(10.0, n_fish=2, seed=4)]
    tracker = BottomTracker(BLANK_M)
    assert tracker.add([None if side is None else traces(side) for side in sides], UNKNOWN, RANGE_M) is None
    whole = tracker.flush()
    assert whole is not None
    streamed = track(sides, block=block)
    np.testing.assert_array_equal(streamed.first_return_m, whole.first_return_m)
    np.testing.assert_array_equal(streamed.seen, whole.seen)
    np.testing.assert_array_equal(streamed.sigma_m, whole.sigma_m)


def test_blocks_of_single_pings_are_taken() -> None:
    """Logs whose sample layout changes from ping to ping come so; no ping is lost and the bottom is still found."""
    found = track([*two_sides(10.0, seed=6)], block=1)
    assert rms_bins(found) <= 1.5


@pytest.mark.parametrize("spacing_m", [0.0125, 0.025, 0.1])
@pytest.mark.parametrize("seed", [0, 1])
def test_noise_is_not_a_bottom(spacing_m: float, seed: int) -> None:
    random = np.random.default_rng(seed)
    noise = [random.exponential(size=(N_PINGS, round(RANGE_M / spacing_m))).astype(np.float32) for _ in range(2)]
    for altitude in (UNKNOWN, np.full(N_PINGS, 8.0)):
        found = track([*noise], altitude, spacing_m=spacing_m)
        assert not found.seen.any()
        assert (found.sigma_m >= 0.1).all()


@pytest.mark.parametrize("fill", [0.0, 1.0])
def test_pings_without_contrast_or_data_are_not_seen(fill: float) -> None:
    flat = np.full((N_PINGS, 1600), fill, dtype=np.float32)
    with np.errstate(all="raise", under="ignore"):
        for sides in ([flat, flat], [flat, None], [None, None]):
            found = track([*sides])
            assert not found.seen.any()
            assert np.isfinite(found.first_return_m).all()
            assert np.isfinite(found.sigma_m).all()


def test_a_hole_of_bad_pings_is_bridged() -> None:
    sides = two_sides(10.0, seed=7)
    for side in sides:
        side[40:48] = 0.0
    found = track([*sides])
    assert rms_bins(found) <= 1.5
    assert found.seen[:36].all()
    assert found.seen[52:].all()
    assert not found.seen[43:45].any()


def test_masked_samples_do_not_move_the_bottom() -> None:
    sides = two_sides(10.0, seed=8)
    tracker = BottomTracker(BLANK_M)
    valid = np.random.default_rng(0).random(sides[0].shape) > 0.3
    tracker.add([traces(side, valid=valid) for side in sides], UNKNOWN, RANGE_M)
    found = tracker.flush()
    assert found is not None
    assert rms_bins(found) <= 1.5


def test_the_range_setting_may_change_on_the_way() -> None:
    """Shorter and longer traces in one segment: the path goes on."""
    sides = two_sides(10.0, seed=9)
    tracker = BottomTracker(BLANK_M)
    done = []
    for start, range_m in ((0, 40.0), (32, 15.0), (64, 40.0)):
        n_samples = round(range_m / SPACING_M)
        done.append(
            tracker.add([traces(side[start : start + 32, :n_samples]) for side in sides], UNKNOWN[:32], range_m)
        )
    found = [track.first_return_m for track in [*done, tracker.flush()] if track is not None]
    assert np.abs(np.concatenate(found) - FIRST_RETURN_M).max() <= 3 * BIN_M


def test_ranges_that_come_later_draw_no_path_where_nothing_shows() -> None:
    tracker = BottomTracker(BLANK_M)
    tracker.add([traces(side[:32, :400]) for side in two_sides(10.0)], UNKNOWN[:32], 10.0)
    tracker.add([traces(np.ones((32, 1600), dtype=np.float32))], UNKNOWN[:32], RANGE_M)
    found = tracker.flush()
    assert found is not None
    assert np.abs(found.first_return_m - FIRST_RETURN_M[31]).max() <= 3 * BIN_M


def test_a_new_segment_starts_afresh() -> None:
    tracker = BottomTracker(BLANK_M)
    assert tracker.flush() is None
    first = two_sides(10.0, seed=10)
    second = two_sides(10.0, seed=11, first_return_m=np.full(32, 20.0))
    tracker.add([traces(side) for side in first], UNKNOWN, RANGE_M)
    tracker.flush()
    assert tracker.add([traces(side) for side in second], UNKNOWN[:32], RANGE_M) is None
    found = tracker.flush()
    assert found is not None
    for line_m in (found.first_return_m, found.level_return_m):
        assert np.abs(line_m - 20.0).max() <= 3 * BIN_M


def slow_score(log_intensity: list[float], valid: list[bool], blank: int, k: int) -> float:
    """The likelihood ratio at bin k from its definition: two Gaussians of variance pi^2/6 against one."""
    window = round(0.5 / BIN_M)
    known = [value if ok else None for value, ok in zip(log_intensity, valid, strict=True)]
    before = [value for value in known[max(k - window, blank) : k] if value is not None]
    after = [value for value in known[k : k + window] if value is not None]
    column = [value for value in known[blank:k] if value is not None]
    if k < blank + 3 or k >= len(known) - window or len(before) < 3 or len(after) < 0.5 * window:
        return 0.0
    mean_before, mean_after = np.mean(before), np.mean(after)
    if mean_after <= mean_before or mean_after - np.mean(column) <= math.log(2.0):
        return 0.0
    joint = np.mean(before + after)
    separate = sum((x - mean_before) ** 2 for x in before) + sum((x - mean_after) ** 2 for x in after)
    return float((sum((x - joint) ** 2 for x in before + after) - separate) / (2.0 * math.pi**2 / 6.0))


@given(
    log_intensity=hnp.arrays(np.float64, (2, 40), elements=st.integers(-4, 8).map(lambda value: 0.773 * value)),
    valid=st.just(np.ones((2, 40), dtype=np.bool_)) | hnp.arrays(np.bool_, (2, 40)),
    blank=st.integers(1, 20),
)
@settings(max_examples=25)
def test_scores_are_likelihood_ratios(log_intensity: NDArray[np.float64], valid: NDArray[np.bool_], blank: int) -> None:
    score = change_point_scores(log_intensity, valid, blank)
    for ping in range(2):
        expected = [slow_score(log_intensity[ping].tolist(), valid[ping].tolist(), blank, k) for k in range(40)]
        np.testing.assert_allclose(score[ping], expected, rtol=1e-9, atol=1e-9)


def test_traces_too_short_for_any_bottom_score_nothing() -> None:
    for n_bins in (2, 5, 20, 33):
        assert not change_point_scores(np.zeros((3, n_bins)), np.ones((3, n_bins), dtype=np.bool_), 20).any()


@settings(max_examples=25)
@given(
    first=st.integers(0, N_PINGS - 2),
    length=st.integers(1, N_PINGS),
    return_m=st.floats(0.2, 0.94 * RANGE_M),
    block=st.sampled_from([32, 48]),
)
def test_where_a_person_corrected_the_first_return_it_is_that_and_far_from_there_what_it_was(
    first: int, length: int, return_m: float, block: int
) -> None:
    sides = two_sides(10.0)
    corrected_m = UNKNOWN.copy()
    corrected_m[first : first + length] = return_m + 0.01 * np.arange(N_PINGS)[first : first + length]
    here = np.isfinite(corrected_m)
    tracker = BottomTracker(BLANK_M)
    done = []
    for start in range(0, N_PINGS, block):
        pings = slice(start, start + block)
        done.append(tracker.add([traces(side[pings]) for side in sides], UNKNOWN[pings], RANGE_M, corrected_m[pings]))
    found = BottomTrack(
        *(np.concatenate(parts) for parts in zip(*[t for t in [*done, tracker.flush()] if t is not None], strict=True))
    )
    for line_m in (found.first_return_m, found.level_return_m):
        np.testing.assert_array_equal(line_m[here], corrected_m[here])
    assert found.seen[here].all()
    assert (found.sigma_m[here] <= 0.1).all()
    # the path leads back within what it may move from ping to ping, 0.4 m, and the reach of the median
    steps = np.abs(np.arange(N_PINGS)[:, None] - np.flatnonzero(here)[None, :]).min(axis=1)
    far = steps > 8 + np.nanmax(np.abs(corrected_m - FIRST_RETURN_M)) / 0.4
    np.testing.assert_allclose(found.first_return_m[far], track([*sides]).first_return_m[far], atol=2 * BIN_M + 1e-9)
