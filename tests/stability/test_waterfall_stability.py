"""Numbers at the edge of what can come in: zeros, denormals, huge gains, long missions, low altitudes, NaN, clocks,
tile borders.
"""

from __future__ import annotations

import math
from collections import Counter
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from auv_mcm.intake import Intake, PingBlock, SegmentEnd
from auv_mcm.records import VALID, EchoTrace, NavSample, Ping, PoseTrack, Tile, Transfer
from auv_mcm.settings.config import Config, WaterfallConfig
from auv_mcm.waterfall.floor_speckle import floor_speckle
from auv_mcm.waterfall.grid import AlongTrackGrid, SideImage, Swath
from auv_mcm.waterfall.regions import measure_regions
from auv_mcm.waterfall.sample_law import sample_law
from auv_mcm.waterfall.waterfall import Waterfall

N_PINGS, N_SAMPLES, SPACING_M, STEP_M = 96, 400, 0.1, 0.15
SLANT_M = (np.arange(N_SAMPLES) + 0.5) * SPACING_M
CONFIG = Config(waterfall=WaterfallConfig(row_spacing_m=0.15, column_spacing_m=0.12, tile_rows=64))


def poses(n_pings: int, **changes: NDArray[Any]) -> PoseTrack:
    zero: NDArray[np.float64] = np.zeros(n_pings)
    values: dict[str, Any] = dict.fromkeys(PoseTrack.__struct_fields__, zero)
    values |= {"time_s": 1.7e9 + 0.1 * np.arange(n_pings), "speed_mps": zero + 1.5, "altitude_m": zero + math.nan}
    return PoseTrack(**(values | {"stale": np.zeros(n_pings, dtype=np.bool_)} | changes))


def amplitudes(altitude_m: float = 6.0, seed: int = 0) -> NDArray[np.float64]:
    """(2, n_pings, n_samples): a level sea floor under a dark water column."""
    mean = np.where(altitude_m > SLANT_M, 1e-3, (altitude_m / SLANT_M) ** 2)
    return np.sqrt(np.random.default_rng(seed).exponential(mean, (2, N_PINGS, N_SAMPLES)))


def tiles_of(
    samples: NDArray[Any], transfer: Transfer | None = None, unknown_poses: tuple[str, ...] = ()
) -> tuple[list[Tile], Counter[str]]:
    """The stage over blocks of 32 pings, with every floating-point flag but underflow raised."""
    counters: Counter[str] = Counter()
    stage = Waterfall(CONFIG, transfer or Transfer("amplitude"), 6.0, counters)
    tiles: list[Tile] = []
    with np.errstate(all="raise", under="ignore"):
        for start in range(0, samples.shape[1], 32):
            pings = [
                Ping(
                    number=number,
                    time_s=1.7e9 + 0.1 * number,
                    port=EchoTrace(samples=samples[0, number], first_range_m=0.5 * SPACING_M, spacing_m=SPACING_M),
                    starboard=EchoTrace(samples=samples[1, number], first_range_m=0.5 * SPACING_M, spacing_m=SPACING_M),
                )
                for number in range(start, start + 32)
            ]
            track = poses(32, **{name: np.full(32, np.nan) for name in unknown_poses})
            along_m = 0.6 + STEP_M * np.arange(start, start + 32, dtype=np.float64)
            tiles += stage.add(PingBlock(pings, track, along_m, np.zeros(32), np.zeros(32)))
        tiles += stage.close_segment()
    return tiles, counters


def assert_sound(tiles: list[Tile]) -> None:
    for tile in tiles:
        assert np.isfinite(tile.intensity).all()
        assert (tile.intensity >= 0.0).all()
        assert not tile.intensity[(tile.mask & VALID) == 0].any()
        assert np.isfinite(tile.first_return_m).all()
        assert (tile.first_return_sigma_m > 0.0).all()


# Logarithm of zero and of next to nothing.


@pytest.mark.parametrize("share", [0.01, 0.5, 0.99, 1.0])
def test_zeros_in_any_share_of_the_samples(share: float) -> None:
    samples = amplitudes()
    samples[np.random.default_rng(1).random(samples.shape) < share] = 0.0
    tiles, _ = tiles_of(samples)
    assert_sound(tiles)


@pytest.mark.parametrize("scale", [1e-310, 1e-160, 1e-40, 1e-22, 1e-18, 1e15, 1e18, 1e30, 1e300])
def test_vanishing_and_huge_samples(scale: float) -> None:
    """What single precision cannot hold is refused, not turned into infinity."""
    for kind in ("amplitude", "intensity"):
        tiles, counters = tiles_of(amplitudes() * scale, Transfer("amplitude" if kind == "amplitude" else "intensity"))
        assert_sound(tiles)
        if scale >= 1e30 and kind == "amplitude":
            assert counters["quality.sample_not_finite_or_negative"] > 0


def test_logarithmic_samples_of_any_offset() -> None:
    """An offset in decibels is a gain; far beyond what single precision holds the numbers are bounded, not infinite."""
    decibels = 20.0 * np.log10(amplitudes())
    reference = tiles_of(decibels, Transfer("log", 1.0))[0]
    for offset in (-60.0, 60.0):
        for one, other in zip(tiles_of(decibels + offset, Transfer("log", 1.0))[0], reference, strict=True):
            np.testing.assert_allclose(one.intensity, other.intensity, rtol=1e-3)
    for offset in (-1e4, 1e4, 1e30):
        assert_sound(tiles_of(decibels + offset, Transfer("log", 1.0))[0])


@pytest.mark.parametrize("levels", [2, 3])
def test_samples_of_one_bit(levels: int) -> None:
    samples = np.digitize(amplitudes(), np.linspace(0.3, 0.6, levels - 1)).astype(np.uint8)
    assert_sound(tiles_of(samples)[0])
    with np.errstate(all="raise", under="ignore"):
        sample_law(
            floor_speckle(
                [measure_regions([side[first : first + 16] for side in samples]) for first in range(0, N_PINGS, 16)]
            )
        )


@pytest.mark.parametrize("altitude_m", [0.3, 0.6, 1.2, 2.0, 20.0, 39.0])
def test_altitudes_from_a_foot_to_the_whole_range(altitude_m: float) -> None:
    tiles, _ = tiles_of(amplitudes(altitude_m))
    assert_sound(tiles)


def test_water_column_only_and_sea_floor_only() -> None:
    for level in (1e-3, 1.0):
        noise = level * np.sqrt(np.random.default_rng(0).exponential(size=(2, N_PINGS, N_SAMPLES)))
        tiles, counters = tiles_of(noise)
        assert_sound(tiles)
        assert counters["bottom.not_seen"] > 0.8 * N_PINGS


# Long missions: nothing is kept in single precision, nothing drifts.


def test_rows_a_thousand_kilometres_into_a_mission_are_like_the_first() -> None:
    start_m, start_row = 1e6, 8_000_000
    along_m = start_m + 0.7 + 0.2 * np.arange(60, dtype=np.float64)
    image = SideImage(
        np.random.default_rng(0).exponential(size=(60, 5)).astype(np.float32), np.full((60, 5), VALID, dtype=np.uint8)
    )
    grid = AlongTrackGrid(0.125, 0.6)
    swath = Swath(
        along_m,
        poses(60, depth_m=0.01 * np.arange(60)),
        np.full(60, 6.0),
        np.full(60, 0.1),
        np.arange(60),
        {"port": image},
    )
    parts = [part for part in (grid.add(swath), grid.close()) if part is not None]
    here = AlongTrackGrid(0.125, 0.6)
    near = [part for part in (here.add(swath._replace(along_m=along_m - start_m)), here.close()) if part is not None]
    for (row, rows), (near_row, near_rows) in zip(parts, near, strict=True):
        assert row - start_row == near_row
        np.testing.assert_allclose(
            rows.sides["port"].intensity, near_rows.sides["port"].intensity, rtol=1e-6, atol=1e-8
        )
        np.testing.assert_allclose(rows.pose.depth_m, near_rows.pose.depth_m, atol=1e-9)


# NaN and infinity.


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, -1.0])
def test_samples_that_are_no_numbers_spoil_no_neighbour(bad: float) -> None:
    samples = amplitudes()
    reference, _ = tiles_of(samples)
    spoilt = samples.copy()
    spoilt[np.random.default_rng(2).random(samples.shape) < 1e-3] = bad
    spoilt[:, 50] = bad
    tiles, counters = tiles_of(spoilt)
    assert_sound(tiles)
    assert counters["quality.sample_not_finite_or_negative"] > 2 * N_SAMPLES
    for one, other in zip(tiles, reference, strict=True):
        both = (one.mask & other.mask & VALID) != 0
        assert both.mean() > 0.9 * ((other.mask & VALID) != 0).mean()
        ratio = one.intensity[both].mean(dtype=np.float64) / other.intensity[both].mean(dtype=np.float64)
        assert ratio == pytest.approx(1.0, abs=0.02)


def test_poses_that_are_unknown_make_tiles_with_unknown_poses() -> None:
    tiles, _ = tiles_of(
        amplitudes(), unknown_poses=("latitude_deg", "longitude_deg", "heading_rad", "speed_mps", "depth_m")
    )
    assert_sound(tiles)
    reference, _ = tiles_of(amplitudes())
    for one, other in zip(tiles, reference, strict=True):
        np.testing.assert_array_equal(one.intensity, other.intensity)
        assert np.isnan(one.pose.latitude_deg).all()


# Clocks.


@pytest.mark.parametrize("step_s", [3600.0, -3600.0, 0.0, 1e-6, -0.5])
def test_a_clock_that_steps_or_stands_loses_at_most_the_pings_it_repeats(step_s: float) -> None:
    counters: Counter[str] = Counter()
    intake = Intake(Config(), counters)
    trace = EchoTrace(samples=np.arange(8), first_range_m=0.05, spacing_m=0.1)
    released: list[PingBlock | SegmentEnd] = []
    for number in range(400):
        time_s = 1.7e9 + 0.1 * number + (step_s - 0.1 if number >= 200 else 0.0)
        intake.add_navigation(
            NavSample(
                time_s=time_s, latitude_deg=43.0 + 1e-6 * number, longitude_deg=5.0, heading_rad=0.1, speed_mps=1.5
            )
        )
        released += intake.add_ping(Ping(number=number, time_s=time_s, port=trace, starboard=None))
    released += intake.flush()
    numbers = [ping.number for block in released if isinstance(block, PingBlock) for ping in block.pings]
    n_lost = counters["ping.time_repeated"] + counters["ping.time_backwards"]
    assert numbers == sorted(numbers)
    assert len(numbers) == 400 - n_lost
    assert n_lost == {0.0: 1, -0.5: 6}.get(step_s, 0)
    previous_s = -math.inf
    for block in released:
        if isinstance(block, SegmentEnd):
            intake.start_segment(0.0)
            previous_s = -math.inf
        else:
            placed = intake.place_along_track(block)
            assert (np.diff(placed.along_m) > 0.0).all()
            assert block.pings[0].time_s > previous_s
            previous_s = block.pings[-1].time_s
