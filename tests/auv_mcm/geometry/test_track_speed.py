"""Speed over ground by positions: where the measured one is wrong, and how much the positions may scatter."""

from __future__ import annotations

import math
from collections.abc import Iterator

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from auv_mcm.geometry.navigation import NavBuffer
from auv_mcm.records import NAN, NavSample, PoseTrack
from auv_mcm.settings.config import NavigationConfig
from tests.auv_mcm.geometry.nav_samples import FRAME, START_S, east_north

HEADING_RAD = math.radians(70.0)
SPEED_MPS = 1.6


def samples(
    speed_mps: float, *, period_s: float = 0.1, fix_s: float = 0.1, scatter_m: float = 0.0, stands: bool = False
) -> Iterator[NavSample]:
    """A minute straight ahead, or standing; a fix every fix_s, which scatters on both axes."""
    random = np.random.default_rng(3)
    last_fix_s = -math.inf
    for number in range(round(60.0 / period_s)):
        at_s = number * period_s
        way_m = 0.0 if stands else SPEED_MPS * at_s
        east, north = way_m * math.sin(HEADING_RAD), way_m * math.cos(HEADING_RAD)
        latitude = longitude = NAN
        if at_s - last_fix_s >= fix_s - 1e-6:
            last_fix_s = at_s
            east, north = np.array([east, north]) + random.normal(0.0, scatter_m, 2)
            latitude, longitude = (float(angle) for angle in FRAME.to_geodetic(np.array([east, north, 0.0]))[:2])
        yield NavSample(
            time_s=START_S + at_s,
            latitude_deg=latitude,
            longitude_deg=longitude,
            heading_rad=HEADING_RAD,
            speed_mps=speed_mps,
        )


def flown(buffer: NavBuffer, *events: NavSample) -> PoseTrack:
    for event in events:
        buffer.add(event)
    return buffer.interpolate(START_S + np.arange(0.0, 59.0, 0.5))


def off_line_m(track: PoseTrack) -> NDArray[np.float64]:
    """Places less those of the vehicle, east and north."""
    way_m = SPEED_MPS * np.arange(0.0, 59.0, 0.5)
    return np.asarray(east_north(track) - way_m[:, None] * np.array([math.sin(HEADING_RAD), math.cos(HEADING_RAD)]))


def codes(buffer: NavBuffer) -> list[str]:
    return [notice.code for notice in buffer.take_notices()]


@pytest.mark.parametrize("speed_mps", [0.0, 0.5144 * SPEED_MPS, 3.0 * SPEED_MPS])
@pytest.mark.parametrize(("fix_s", "scatter_m"), [(0.1, 0.0), (0.1, 0.3), (1.0, 0.1)])
def test_a_wrong_speed_gives_way_to_the_positions(speed_mps: float, fix_s: float, scatter_m: float) -> None:
    buffer = NavBuffer(NavigationConfig())
    track = flown(buffer, *samples(speed_mps, fix_s=fix_s, scatter_m=scatter_m))
    assert track.speed_mps.mean() == pytest.approx(SPEED_MPS, rel=0.03)
    np.testing.assert_allclose(track.speed_mps, SPEED_MPS, rtol=0.15)
    assert codes(buffer) == ["navigation.speed_off_track"]


def test_a_wrong_speed_is_reported_once_50_m_were_made_and_not_before() -> None:
    buffer, reported_s = NavBuffer(NavigationConfig()), []
    for sample in samples(3.0 * SPEED_MPS):
        buffer.add(sample)
        if "navigation.speed_off_track" in codes(buffer):
            reported_s.append(sample.time_s - START_S)
    assert reported_s == [pytest.approx(50.0 / (3.0 * SPEED_MPS), abs=2.0)]


@pytest.mark.parametrize("factor", [0.9, 1.0, 1.1])
@pytest.mark.parametrize(("fix_s", "scatter_m"), [(0.1, 0.4), (1.0, 0.2)])
def test_a_sound_speed_is_used_as_it_is(factor: float, fix_s: float, scatter_m: float) -> None:
    buffer = NavBuffer(NavigationConfig())
    track = flown(buffer, *samples(factor * SPEED_MPS, fix_s=fix_s, scatter_m=scatter_m))
    np.testing.assert_array_equal(track.speed_mps, factor * SPEED_MPS)
    assert codes(buffer) == []


@pytest.mark.parametrize(
    ("speed_mps", "is_off"), [(SPEED_MPS, False), (-SPEED_MPS, False), (0.0, True), (0.5144 * SPEED_MPS, True)]
)
def test_a_speed_that_comes_with_sparse_fixes_is_judged_by_the_way_between_them(speed_mps: float, is_off: bool) -> None:
    buffer = NavBuffer(NavigationConfig())
    flown(buffer, *samples(speed_mps, period_s=5.0, fix_s=5.0))
    assert ("navigation.speed_off_track" in codes(buffer)) == is_off


def test_a_speed_that_is_missing_for_a_while_is_not_judged_then() -> None:
    buffer = NavBuffer(NavigationConfig())
    gone = (START_S + 20.0, START_S + 35.0)
    track = flown(
        buffer,
        *(
            msgspec.structs.replace(sample, speed_mps=math.nan) if gone[0] < sample.time_s < gone[1] else sample
            for sample in samples(SPEED_MPS)
        ),
    )
    assert codes(buffer) == []
    np.testing.assert_allclose(track.speed_mps, SPEED_MPS, rtol=0.05)


@pytest.mark.parametrize("scatter_m", [0.0, 0.5])
def test_positions_that_stand_still_judge_no_speed(scatter_m: float) -> None:
    buffer = NavBuffer(NavigationConfig())
    track = flown(buffer, *samples(SPEED_MPS, scatter_m=scatter_m, stands=True))
    np.testing.assert_array_equal(track.speed_mps, SPEED_MPS)
    assert "navigation.speed_off_track" not in codes(buffer)


def test_a_vehicle_that_stands_and_says_so_makes_no_way() -> None:
    track = flown(NavBuffer(NavigationConfig()), *samples(0.0, scatter_m=0.3, stands=True))
    assert track.speed_mps.max() < 0.3


@pytest.mark.parametrize("speed_mps", [SPEED_MPS, 3.0 * SPEED_MPS])
def test_fixes_five_seconds_apart_are_bridged(speed_mps: float) -> None:
    track = flown(NavBuffer(NavigationConfig()), *samples(speed_mps, fix_s=5.0))
    bridged = ~track.stale
    assert bridged[4:110].all()
    np.testing.assert_allclose(off_line_m(track)[4:110], 0.0, atol=0.05)
    # 5 % of the way to the nearer of both fixes
    assert track.position_sigma_m[4:110].max() == pytest.approx(0.05 * 2.5 * SPEED_MPS, abs=0.01)


@pytest.mark.parametrize("heading_rad", [NAN, 0.0])
def test_the_course_bridges_fixes_five_seconds_apart_where_no_heading_is_known(heading_rad: float) -> None:
    events = [msgspec.structs.replace(one, heading_rad=heading_rad, speed_mps=NAN) for one in samples(NAN, fix_s=5.0)]
    track = flown(NavBuffer(NavigationConfig()), *events)
    assert not track.stale[12:100].any()
    np.testing.assert_allclose(off_line_m(track)[12:100], 0.0, atol=0.05)


@pytest.mark.parametrize("heading_rad", [0.0, math.tau])
def test_a_heading_of_zero_everywhere_gives_way_to_the_course(heading_rad: float) -> None:
    buffer = NavBuffer(NavigationConfig())
    events = [msgspec.structs.replace(event, heading_rad=heading_rad) for event in samples(SPEED_MPS)]
    off_rad = flown(buffer, *events).heading_rad - HEADING_RAD  # but for whole turns
    np.testing.assert_allclose(np.cos(off_rad), 1.0, atol=1.0 - math.cos(math.radians(2.0)))
    assert codes(buffer) == ["navigation.heading_zero"]


@pytest.mark.parametrize("factor", [0.0, 0.1, 3.0])
def test_fixes_five_seconds_apart_judge_speed_and_a_heading_of_zero(factor: float) -> None:
    buffer = NavBuffer(NavigationConfig())
    events = [msgspec.structs.replace(event, heading_rad=0.0) for event in samples(factor * SPEED_MPS, fix_s=5.0)]
    track = flown(buffer, *events)
    known = slice(4, 110)  # the first course stands in the middle of the second hole
    np.testing.assert_allclose(track.heading_rad[known], HEADING_RAD, atol=math.radians(2.0))
    np.testing.assert_allclose(track.speed_mps[known], SPEED_MPS, rtol=0.05)
    assert set(codes(buffer)) == {"navigation.heading_zero", "navigation.speed_off_track"}


@pytest.mark.parametrize(("off_deg", "expected"), [(10.0, []), (25.0, ["navigation.heading_off_course"])])
def test_a_heading_that_stands_still_beside_the_course_is_reported(off_deg: float, expected: list[str]) -> None:
    buffer = NavBuffer(NavigationConfig())
    heading_rad = HEADING_RAD + math.radians(off_deg)
    track = flown(buffer, *(msgspec.structs.replace(one, heading_rad=heading_rad) for one in samples(SPEED_MPS)))
    np.testing.assert_allclose(track.heading_rad, heading_rad)
    assert codes(buffer) == expected
