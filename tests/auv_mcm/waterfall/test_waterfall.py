"""The waterfall stage as a whole: where echoes land, what the mask holds, and what broken input does."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
import pytest
from msgspec import structs
from numpy.typing import NDArray

from auv_mcm.intake import PingBlock
from auv_mcm.records import LOW_RESOLUTION, SATURATED, SIDES, TURN, VALID, Side, Tile, Transfer
from auv_mcm.settings.config import Config
from auv_mcm.waterfall.radiometry import LOCAL_MEAN_REACH_M
from auv_mcm.waterfall.waterfall import Waterfall
from tests.auv_mcm.waterfall.simulated_pings import (
    ALTITUDE_M,
    CONFIG,
    FIRST_PING_M,
    GROUND_M,
    N_SAMPLES,
    RANGE_M,
    SLANT_M,
    SPACING_M,
    STEP_M,
    Run,
    amplitudes,
    block_of,
    row_of_ping,
    run,
)

N_PINGS = 160
COLUMN_SPACING_M = CONFIG.waterfall.column_spacing_m


@pytest.fixture(scope="module")
def samples() -> NDArray[np.float64]:
    return amplitudes(N_PINGS)


@pytest.fixture(scope="module")
def plain(samples: NDArray[np.float64]) -> Run:
    return run(samples)


def masks(found: Run, side: Side = "port") -> NDArray[np.uint8]:
    return np.concatenate([tile.mask[tile.core_start : tile.core_stop] for tile in found.tiles if tile.side == side])


def run_blocks(blocks: list[PingBlock], config: Config = CONFIG) -> Run:
    counters: Counter[str] = Counter()
    stage = Waterfall(config, Transfer("amplitude"), 6.0, counters)
    tiles = [tile for block in blocks for tile in stage.add(block)]
    return Run(tiles + stage.close_segment(), counters)


def assert_same_tiles(one: list[Tile], other: list[Tile]) -> None:
    assert len(one) == len(other) > 0
    for a, b in zip(one, other, strict=True):
        assert (a.index, a.first_row, a.core_start, a.core_stop) == (b.index, b.first_row, b.core_start, b.core_stop)
        np.testing.assert_array_equal(a.intensity, b.intensity)
        np.testing.assert_array_equal(a.mask, b.mask)
        np.testing.assert_array_equal(a.first_return_m, b.first_return_m)


def test_mirrored_sides_give_mirrored_tiles(samples: NDArray[np.float64], plain: Run) -> None:
    mirrored = run(samples[::-1])
    for side, other in (SIDES, SIDES[::-1]):
        assert_same_tiles(
            [tile for tile in mirrored.tiles if tile.side == side], [tile for tile in plain.tiles if tile.side == other]
        )


@pytest.mark.parametrize(("ping", "ground_m"), [(40, 4.5), (77, 15.02), (110, 38.5)])
@pytest.mark.parametrize("side", SIDES)
def test_an_echo_lands_on_its_ping_and_ground_range(
    samples: NDArray[np.float64], ping: int, ground_m: float, side: Side
) -> None:
    marked = samples.copy()
    sample = int(np.abs(GROUND_M - ground_m).argmin())
    marked[SIDES.index(side), ping, sample] = 1e3
    found = run(marked)
    intensity, _ = found.image(side)
    row, column = np.unravel_index(intensity.argmax(), intensity.shape)
    assert abs((found.first_row + row + 0.5) * STEP_M - (FIRST_PING_M + STEP_M * ping)) <= STEP_M
    # The tracked first return is good to a bin and a half of 5 cm, which moves a pixel by altitude over ground range of
    # that.
    assert abs((column + 0.5) * COLUMN_SPACING_M - ground_m) <= COLUMN_SPACING_M + 0.075 * ALTITUDE_M / ground_m
    tile = next(tile for tile in found.tiles if tile.side == side and tile.index == found.tiles[0].index)
    assert ping in tile.ping_number[tile.core_start :]


def test_first_returns_travel_with_the_rows(plain: Run) -> None:
    for tile in plain.tiles:
        assert np.abs(tile.first_return_m - ALTITUDE_M).max() < 0.1
        assert (tile.first_return_sigma_m < 0.3).all()
        assert (np.diff(tile.ping_number[tile.ping_number >= 0]) >= 0).all()
        assert (np.diff(tile.pose.time_s) >= 0.0).all()


def test_pixels_too_steep_or_too_flat_are_of_low_resolution(samples: NDArray[np.float64]) -> None:
    waterfall = structs.replace(CONFIG.waterfall, max_grazing_deg=60.0, min_grazing_deg=10.0)
    mask = masks(run(samples, config=structs.replace(CONFIG, waterfall=waterfall)))
    ground_m = (np.arange(mask.shape[1]) + 0.5) * COLUMN_SPACING_M
    claimed = (mask[20:-20] & LOW_RESOLUTION) == 0
    grazing_deg = np.degrees(np.arctan2(ALTITUDE_M, ground_m))
    assert claimed[:, (grazing_deg < 59.0) & (grazing_deg > 10.3)].all()
    assert not claimed[:, (grazing_deg > 61.0) | (grazing_deg < 9.7)].any()


def test_beyond_the_recorded_or_configured_range_nothing_is_valid(samples: NDArray[np.float64], plain: Run) -> None:
    ground_m = math.sqrt(RANGE_M**2 - ALTITUDE_M**2)
    edge = math.floor(ground_m / COLUMN_SPACING_M)
    assert (masks(plain)[10:-10, edge - 3] & VALID).all()
    assert not (masks(plain)[:, edge + 3 :] & VALID).any()
    near = run(samples, config=structs.replace(CONFIG, sonar=structs.replace(CONFIG.sonar, max_range_m=20.0)))
    assert masks(near).shape[1] == math.ceil(20.0 / COLUMN_SPACING_M)


def test_clipped_echoes_are_saturated_and_valid(samples: NDArray[np.float64]) -> None:
    counts = np.minimum(samples * 20000.0, 32766.0).astype(np.uint16)
    counts[0, 80, (GROUND_M > 20.0) & (GROUND_M < 20.4)] = 32767
    found = run(counts)
    mask = masks(found)
    row, columns = (
        row_of_ping(80, found.first_row),
        slice(round(20.1 / COLUMN_SPACING_M), round(20.3 / COLUMN_SPACING_M)),
    )
    assert (mask[row, columns] & (VALID | SATURATED) == VALID | SATURATED).all()
    mask[row - 2 : row + 3] = 0
    assert not (mask & SATURATED).any()
    assert not (masks(found, "starboard") & SATURATED).any()


def test_a_strip_that_is_clipped_in_every_ping_teaches_no_angle_response(samples: NDArray[np.float64]) -> None:
    counts = np.minimum(samples * 20000.0, 32766.0).astype(np.uint16)
    counts[0, :, (GROUND_M > 20.0) & (GROUND_M < 21.0)] = 32767
    image, _ = run(counts).image()
    assert image[20:-20, round(20.2 / COLUMN_SPACING_M) : round(20.8 / COLUMN_SPACING_M)].mean() > 100.0


def test_a_clipped_pulse_of_another_sonar_is_no_evidence_of_a_highlight(samples: NDArray[np.float64]) -> None:
    counts = np.minimum(samples * 20000.0, 32766.0).astype(np.uint16)
    random = np.random.default_rng(4)
    for ping in range(0, counts.shape[1], 2):
        start = random.integers(N_SAMPLES // 3, N_SAMPLES - 20)
        counts[0, ping, start : start + 16] = 32767
    found = run(counts)
    assert found.counters["quality.sample_saturated"] > 16 * 32
    # 0.8 % where none is taken out; what is left are pulses that meet another's place two pings on
    assert np.mean((masks(found)[32:-32] & SATURATED) != 0) < 5e-4


def turning(samples: NDArray[np.float64], yaw_deg_s: float, pitch_deg_s: float = 0.0) -> Run:
    blocks = []
    for start in range(0, N_PINGS, 32):
        block = block_of(samples[0, start : start + 32], samples[1, start : start + 32], start)
        rate = np.full(32, math.radians(yaw_deg_s)), np.full(32, math.radians(pitch_deg_s))
        blocks.append(block._replace(yaw_rate_rad_s=rate[0], pitch_rate_rad_s=rate[1]))
    return run_blocks(blocks)


@pytest.mark.parametrize("yaw_deg_s", [4.0, -4.0])
def test_the_inside_of_a_turn_folds_and_the_outside_spreads(samples: NDArray[np.float64], yaw_deg_s: float) -> None:
    """At 1.2 m/s: pings move on the sea floor at y by v -+ y * yaw rate, kept between half and twice v."""
    found = turning(samples, yaw_deg_s)
    inside, outside = ("starboard", "port") if yaw_deg_s > 0.0 else ("port", "starboard")
    rate, speed = math.radians(abs(yaw_deg_s)), 1.2
    for side, limit_m in ((inside, 0.5 * speed / rate), (outside, speed / rate)):
        turn = (masks(found, "port" if side == "port" else "starboard")[5:-5] & TURN) != 0
        column = round(limit_m / COLUMN_SPACING_M)
        assert not turn[:, : column - 1].any()
        assert turn[:, column + 1 :].all()


def test_fast_turns_are_marked_whole_and_slow_ones_not_at_all(samples: NDArray[np.float64]) -> None:
    assert ((masks(turning(samples, 5.1))[3:-3] & TURN) != 0).all()
    assert not (masks(turning(samples, 0.5)) & TURN).any()


def test_pitching_squeezes_the_pings_too(samples: NDArray[np.float64]) -> None:
    """Bow going down at 6 deg/s from 6 m altitude moves the fan back at half the vehicle's speed."""
    assert ((masks(turning(samples, 0.0, -6.0))[3:-3] & TURN) != 0).all()
    assert not (masks(turning(samples, 0.0, -5.0)) & TURN).any()
    assert not (masks(turning(samples, 0.0, 10.0)) & TURN).any()
    assert ((masks(turning(samples, 0.0, 12.0))[3:-3] & TURN) != 0).all()


def test_a_dead_channel_is_counted_and_its_side_stays_without_data(samples: NDArray[np.float64], plain: Run) -> None:
    dead = samples.copy()
    dead[1] = 0.0
    found = run(dead)
    assert found.counters["quality.starboard_dead"] == N_PINGS
    assert not (masks(found, "starboard") & VALID).any()
    np.testing.assert_array_equal(masks(found, "port"), masks(plain, "port"))


def test_a_side_that_ends_before_the_bottom_hides_it_from_neither_and_tiles_have_the_squint_of_their_pings(
    samples: NDArray[np.float64],
) -> None:
    short = round(0.5 * ALTITUDE_M / SPACING_M)
    blocks = [block_of(samples[0, i : i + 32], samples[1, i : i + 32, :short], i) for i in range(0, N_PINGS, 32)]
    squinted = [b._replace(pings=[structs.replace(ping, squint_rad=0.05) for ping in b.pings]) for b in blocks]
    for tile in run_blocks(squinted).tiles:
        assert np.abs(tile.first_return_m - ALTITUDE_M).max() < 0.1
        assert tile.squint_rad == 0.05


def test_bad_pings_leave_gaps_or_are_bridged_and_nothing_else_changes(samples: NDArray[np.float64], plain: Run) -> None:
    broken = samples.copy()
    broken[:, 60:80] = np.nan
    found = run(broken)
    assert found.counters["quality.port_dead"] == 20
    rows = slice(row_of_ping(60, found.first_row) + 1, row_of_ping(79, found.first_row) - 1)
    assert not (masks(found)[rows] & VALID).any()
    far = np.r_[0 : rows.start - 70, rows.stop + 70 : masks(found).shape[0] - 5]
    np.testing.assert_array_equal(masks(found)[far], masks(plain)[far])


def test_sample_counts_and_range_settings_may_change_between_blocks(samples: NDArray[np.float64]) -> None:
    blocks = [
        block_of(samples[0, i : i + 32, : n_samples or N_SAMPLES], samples[1, i : i + 32, : n_samples or N_SAMPLES], i)
        for i, n_samples in ((0, 0), (32, 700), (64, 0), (96, 900), (128, 0))
    ]
    found = run_blocks(blocks)
    valid = (masks(found) & VALID) != 0
    assert valid.shape[1] == math.ceil((RANGE_M + 0.5 * SPACING_M) / COLUMN_SPACING_M)
    shorter = slice(row_of_ping(36, found.first_row), row_of_ping(60, found.first_row))
    assert valid[shorter, : int(SLANT_M[650] / COLUMN_SPACING_M)].all()
    assert not valid[shorter, int(SLANT_M[720] / COLUMN_SPACING_M) :].any()


def test_segments_share_no_tile_and_no_row(samples: NDArray[np.float64]) -> None:
    stage = Waterfall(CONFIG, Transfer("amplitude"), 6.0, Counter())
    seen: set[tuple[Side, int]] = set()
    start_m, last_row = FIRST_PING_M, -1
    for _ in range(3):
        tiles = []
        for i in range(0, 64, 32):
            along_m = start_m + STEP_M * np.arange(i, i + 32, dtype=np.float64)
            tiles += stage.add(block_of(samples[0, i : i + 32], samples[1, i : i + 32], i, along_m))
        tiles += stage.close_segment()
        keys = {(tile.side, tile.index) for tile in tiles}
        assert len(keys) == len(tiles)
        assert not keys & seen
        seen |= keys
        assert min(tile.first_row for tile in tiles) > last_row
        last_row = max(tile.first_row + tile.core_stop - 1 for tile in tiles)
        start_m = stage.next_segment_m() + CONFIG.waterfall.max_ping_gap_m
    assert stage.close_segment() == []


@pytest.mark.parametrize("tile_rows", [64, 97])
def test_tile_length_changes_no_core_pixel(samples: NDArray[np.float64], tile_rows: int) -> None:
    waterfall = structs.replace(CONFIG.waterfall, tile_rows=tile_rows)
    overlap_m = LOCAL_MEAN_REACH_M + 1.0
    cut = run(samples, config=structs.replace(CONFIG, waterfall=waterfall), overlap_m=overlap_m)
    whole = run(samples, overlap_m=overlap_m)
    assert len(cut.tiles) > len(whole.tiles)
    for side in SIDES:
        np.testing.assert_array_equal(masks(cut, side), masks(whole, side))
        np.testing.assert_allclose(cut.image(side)[0], whole.image(side)[0], rtol=1e-6)
