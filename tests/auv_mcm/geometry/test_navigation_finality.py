"""What is ready never changes, waiting ends soon, memory does not grow."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from auv_mcm.geometry.navigation import NavBuffer
from auv_mcm.records import NavSample, PoseTrack
from auv_mcm.settings.config import NavigationConfig
from tests.auv_mcm.geometry.nav_samples import POSE_FIELDS, START_S, filled, here, only, without

quantity = st.sampled_from(["position", "heading_rad", "pitch_rad", "roll_rad", "depth_m", "altitude_m", "speed_mps"])
streams = st.lists(
    st.tuples(
        st.sampled_from([0, 1, 1, 1, 2, 4, 7, 12, 30, 60, 130]),  # sixteenths of a second since the last sample
        st.sets(quantity, max_size=4),  # what it lacks
        st.sampled_from([0.0, 0.0, 0.0, 0.0, 0.0, 900.0]),  # displacement
        st.floats(-3.0, 3.0),
    ),
    min_size=1,
    max_size=40,
)


def a_stream(steps: list[tuple[int, set[str], float, float]], always_missing: set[str]) -> list[NavSample]:
    samples, second, east = [], 0.0, 0.0
    for step, missing, displacement, heading in steps:
        second += step / 16
        east += step / 16 * 1.2 + displacement
        gone = missing | always_missing
        names = [name for name in gone if name != "position"] + (
            ["latitude_deg", "longitude_deg"] if "position" in gone else []
        )
        samples.append(without(here(second, east=east, heading_rad=heading, depth_m=5.0 + heading), *names))
    return samples


@settings(max_examples=200, deadline=None)
@given(
    streams,
    st.sets(quantity, max_size=2),
    st.sampled_from([NavigationConfig(), NavigationConfig(max_extrapolation_s=3.0, max_gap_s=0.5)]),
)
def test_what_is_ready_never_changes(
    steps: list[tuple[int, set[str], float, float]], always_missing: set[str], config: NavigationConfig
) -> None:
    assert_final(a_stream(steps, always_missing), config)


def test_a_late_sample_of_the_same_instant_changes_nothing_that_is_ready() -> None:
    assert_final([here(0.0), *(only(i, heading_rad=1.0, speed_mps=1.0) for i in range(1, 12)), here(11.0, east=3.0)])


def test_a_vehicle_that_starts_to_move_changes_no_heading_that_is_ready() -> None:
    fixes = [here(0.5 * i, east=0.5 * i) for i in range(20)]
    fixes += [here(10.0 + 0.5 * i, east=9.5) for i in range(40)]
    fixes += [here(30.0 + 0.5 * i, east=9.5, north=0.3 * i) for i in range(40)]
    assert_final([without(fix, "heading_rad", "speed_mps") for fix in fixes])


def test_a_hole_waits_for_the_heading_at_its_end() -> None:
    """Whether it is bridged depends on it; one more sample of the same instant may bring it."""
    ends = [without(here(second, east=1.2 * second), "heading_rad") for second in (3.75, 5.625)]
    assert_final(
        [here(0.0, heading_rad=1.5), *ends, only(5.625, heading_rad=0.0)],
        NavigationConfig(max_extrapolation_s=3.0, max_gap_s=0.5),
    )


def test_a_fix_elsewhere_changes_no_position_that_was_carried_on() -> None:
    fixes = [here(0.5 * i, east=0.6 * i, heading_rad=1.5) for i in range(10)]
    reckoned = [only(0.5 * i, heading_rad=1.5, speed_mps=1.2) for i in range(10, 30)]
    elsewhere = [here(0.5 * i, east=0.6 * i, north=900.0, heading_rad=1.5) for i in range(30, 50)]
    assert_final([*fixes, *reckoned, *elsewhere])


@pytest.mark.parametrize("factors", [(1.0, 1.94), (1.94, 1.0), (0.5, 0.5)])
@pytest.mark.parametrize("heading_rad", [0.0, 1.57])
def test_speed_and_heading_that_positions_refute_change_no_pose_that_is_ready(
    factors: tuple[float, float], heading_rad: float
) -> None:
    whole = [
        here(0.25 * i, east=0.5 * i, heading_rad=heading_rad, speed_mps=2.0 * factors[i >= 80]) for i in range(180)
    ]
    assert_final([without(s, "latitude_deg", "longitude_deg") if i % 60 > 40 else s for i, s in enumerate(whole)])


def assert_final(samples: list[NavSample], config: NavigationConfig | None = None) -> None:
    """After each sample take every pose that is reported ready; at the end they must all be the same still."""
    times = START_S + np.arange(-32, 16 * 50) / 16.0
    buffer = NavBuffer(config or NavigationConfig())
    early: list[tuple[NDArray[np.float64], PoseTrack]] = []
    for sample in samples:
        buffer.add(sample)
        ready = times[times <= buffer.ready_until_s]
        early.append((ready, buffer.interpolate(ready)))
    last = buffer.interpolate(max((ready for ready, _ in early), key=len))
    for ready, track in early:
        for name in POSE_FIELDS:
            np.testing.assert_array_equal(getattr(track, name), getattr(last, name)[: len(ready)], err_msg=name)


@settings(max_examples=100, deadline=None)
@given(streams, st.sets(quantity, max_size=2), st.integers(1, 9), st.integers(1, 9))
def test_poses_do_not_depend_on_the_size_of_the_pieces(
    steps: list[tuple[int, set[str], float, float]], always_missing: set[str], piece: int, other_piece: int
) -> None:
    """Feed `piece` samples, take the poses that are ready, forget what is past, go on; at the end take the rest."""

    def run(size: int) -> tuple[list[PoseTrack], NavBuffer]:
        buffer = NavBuffer(NavigationConfig())
        waiting = START_S + np.arange(-8, 160) / 8.0
        tracks = []
        for first in range(0, len(samples), size):
            for sample in samples[first : first + size]:
                buffer.add(sample)
            n_ready = int(np.searchsorted(waiting, buffer.ready_until_s, side="right"))
            tracks.append(buffer.interpolate(waiting[:n_ready]))
            waiting = waiting[n_ready:]
            if waiting.size:
                buffer.forget_before(waiting[0])
        return [*tracks, buffer.interpolate(waiting)], buffer

    samples = a_stream(steps, always_missing)
    (one, one_buffer), (other, other_buffer) = run(piece), run(other_piece)
    for name in POSE_FIELDS:
        np.testing.assert_array_equal(
            np.concatenate([getattr(track, name) for track in one]),
            np.concatenate([getattr(track, name) for track in other]),
            err_msg=name,
        )
    assert one_buffer.counters == other_buffer.counters


def test_waiting_ends_soon() -> None:
    """A full sample makes poses up to itself final; a position that stops delays them by 4 s only."""
    buffer = filled(here(0.1 * i, east=0.1 * i) for i in range(50))
    assert buffer.ready_until_s == START_S + 0.1 * 49
    for i in range(50, 200):
        buffer.add(only(0.1 * i, heading_rad=0.0, speed_mps=1.0))
    assert buffer.ready_until_s == pytest.approx(START_S + 19.9 - 4.0, abs=1e-3)
    for i in range(200, 40_000):
        buffer.add(only(0.1 * i, pitch_rad=0.0))
    assert buffer.ready_until_s == pytest.approx(START_S + 3999.9 - 6.0, abs=1e-3)
    silent_compass = filled(without(here(0.1 * i, east=0.1 * i), "heading_rad", "speed_mps") for i in range(200))
    assert silent_compass.ready_until_s > START_S + 19.9 - 5.0
    no_fix = filled(only(0.1 * i, heading_rad=0.0) for i in range(200))
    assert no_fix.ready_until_s > START_S + 19.9 - 10.0


def test_memory_does_not_grow_with_the_mission() -> None:
    buffer = NavBuffer(NavigationConfig())
    tracemalloc.start()
    try:
        peaks = []
        for lap in range(4):
            for i in range(700):  # one object kept of each would be 30 times what is allowed
                second = 70.0 * lap + 0.1 * i
                buffer.add(
                    only(second, latitude_deg=10.0 + 1e-6 * second, longitude_deg=5.0, heading_rad=0.1, depth_m=3.0)
                )
                buffer.forget_before(START_S + second - 3.0)
            peaks.append(tracemalloc.get_traced_memory()[0])
    finally:
        tracemalloc.stop()
    assert peaks[-1] < peaks[0] + 4096
