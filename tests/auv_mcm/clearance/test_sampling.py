"""What was sampled too coarsely for a mine to be seen earns no coverage, on that side and for that time alone."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import structs

from auv_mcm.clearance.coverage import cover_tile
from auv_mcm.clearance.sampling import MAX_SPACING_M, Sampling
from auv_mcm.frozen_state import freeze, thaw
from auv_mcm.records import EchoTrace, Ping, Side
from auv_mcm.settings.config import SonarConfig
from tests.auv_mcm.clearance.covered_tiles import plain, tile_of


def ping(time_s: float, port_m: float | None, starboard_m: float | None) -> Ping:
    port, starboard = (
        None if spacing_m is None else EchoTrace(samples=np.ones(4, np.uint16), first_range_m=0.0, spacing_m=spacing_m)
        for spacing_m in (port_m, starboard_m)
    )
    return Ping(number=0, time_s=time_s, port=port, starboard=starboard)


SPACINGS = st.sampled_from([None, 0.02, 0.2, MAX_SPACING_M, 0.5, 15.0])


@given(st.lists(st.tuples(SPACINGS, SPACINGS), min_size=1, max_size=120), st.sampled_from(["port", "starboard"]))
def test_rows_are_coarse_where_the_ping_before_them_was(pings: list[tuple[float | None, ...]], side: Side) -> None:
    tile = structs.replace(tile_of(plain()), side=side)
    times_s = tile.pose.time_s
    step_s = float(times_s[-1] - times_s[0]) / len(pings)
    sampling, codes = Sampling(), []
    for number, spacings in enumerate(pings):
        codes += [notice.code for notice in sampling.add(ping(float(times_s[0]) + number * step_s, *spacings))]
    expected, is_coarse, number = [], False, 0
    for time_s in times_s:
        while number < len(pings) and float(times_s[0]) + number * step_s <= time_s:
            spacing_m = pings[number][side == "starboard"]
            is_coarse = is_coarse if spacing_m is None else spacing_m > MAX_SPACING_M
            number += 1
        expected.append(is_coarse)
    again = thaw(freeze(sampling, {}), {})
    for one in (sampling, again):
        assert one.coarse_rows(tile).tolist() == expected
    is_any_coarse = any(spacing_m is not None and spacing_m > MAX_SPACING_M for pair in pings for spacing_m in pair)
    assert codes == ["coverage.samples_too_coarse"] * is_any_coarse


def test_a_segment_that_begins_earlier_goes_on_with_the_samples_of_before() -> None:
    tile, sampling = tile_of(plain()), Sampling()
    times_s = tile.pose.time_s
    sampling.add(ping(float(times_s[-1]) + 100.0, 15.0, 15.0))
    sampling.start_segment()
    sampling.add(ping(float(times_s[5]), 0.2, 0.2))
    assert sampling.coarse_rows(tile).tolist() == (times_s < times_s[5]).tolist()


def test_two_samples_over_30_m_earn_no_coverage() -> None:
    tile = tile_of(plain())
    sampling = Sampling()
    (notice,) = sampling.add(ping(0.0, 15.0, 15.0))
    assert "15.00 m" in notice.text
    fine = cover_tile(tile, SonarConfig())
    coarse = cover_tile(tile, SonarConfig(), blind_rows=sampling.coarse_rows(tile))
    assert fine.covered_m2 > 0.0
    assert coarse.covered_m2 == 0.0
    assert coarse.rings_deg == ()
    assert coarse.lost_m2["low_resolution"] == pytest.approx(fine.covered_m2 + fine.lost_m2["low_resolution"])


def test_samples_of_a_usual_sonar_change_nothing() -> None:
    tile, sampling = tile_of(plain()), Sampling()
    assert sampling.add(ping(0.0, 0.2, 0.47)) == []
    assert Sampling().add(ping(0.0, 0.2, 0.49)) != []
    fine = cover_tile(tile, SonarConfig())
    assert cover_tile(tile, SonarConfig(), blind_rows=sampling.coarse_rows(tile)).covered_m2 == fine.covered_m2
