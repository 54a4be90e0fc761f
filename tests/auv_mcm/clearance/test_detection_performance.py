"""Tables of performance: read one place at a time against read as arrays, and files that are none."""

from __future__ import annotations

import json
import math
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from auv_mcm.clearance.clearance_map import LookModel
from auv_mcm.clearance.detection_performance import (
    FLOORS,
    USUAL_UNEVENNESS_DB,
    Band,
    CellView,
    Performance,
    aspect_rad,
    configured_performance,
    parse_performance,
    shipped_performance,
)
from auv_mcm.errors import BadInputError
from auv_mcm.records import SEABED_TYPES
from auv_mcm.settings.config import Config, SonarConfig

EDGES_M = (0.0, 10.0, 20.0, 40.0)
ALTITUDE_M = 6.0
UNKNOWN = SEABED_TYPES.index("unknown")


def tables(exponent: float = 1.0) -> Performance:
    by_floor = {
        "flat": (0.5, 0.9, 0.7),
        "ripple_across": (0.4, 0.8, 0.6),
        "ripple_oblique": (0.3, 0.6, 0.3),
        "ripple_along": (0.1, 0.2, 0.1),
        "rough": (0.2, 0.3, 0.05),
        "vegetation": (0.3, 0.1, 0.2),
    }
    floors = {
        name: tuple(
            Band(n_looks=100, n_found=int(100 * p), p=p, low=0.9 * p, high=min(1.1 * p, 1.0)) for p in by_floor[name]
        )
        for name in FLOORS
    }
    return Performance(
        fitted_on="a test",
        altitude_m=ALTITUDE_M,
        altitude_exponent=exponent,
        edges_m=EDGES_M,
        floors=floors,
        same_look_correlation=0.4,
        other_look_correlation=0.2,
    )


@given(st.floats(0.05, 20.0), st.floats(0.05, 20.0))
def test_a_wider_beam_finds_less_on_every_floor_and_at_every_range(one_deg: float, other_deg: float) -> None:
    narrow, wide = (shipped_performance().for_beam(math.radians(width)) for width in sorted((one_deg, other_deg)))
    for floor in FLOORS:
        for by_narrow, by_wide in zip(narrow.floors[floor], wide.floors[floor], strict=True):
            assert 0.0 <= by_wide.low <= by_wide.p <= by_wide.high <= by_narrow.high
            assert by_wide.p <= by_narrow.p


def test_a_beam_no_wider_than_the_tables_and_a_synthetic_aperture_change_nothing() -> None:
    shipped = shipped_performance()
    assert (
        shipped.for_beam(math.radians(0.5)) == shipped.for_beam(math.radians(0.1)) == shipped.for_beam(0.0) == shipped
    )
    own = msgspec.structs.replace(shipped, beam_width_deg=1.5)
    assert own.for_beam(math.radians(1.5)) == own, "as of a sonar that they were fitted for"
    assert configured_performance(Config(sonar=SonarConfig(kind="sas", beam_width_deg=3.0))) == shipped


def test_half_of_mines_on_a_flat_floor_are_left_where_the_beam_covers_a_metre() -> None:
    narrow = msgspec.structs.replace(tables(), beam_width_deg=1e-6)
    width_rad = 1.0 / math.hypot(30.0, ALTITUDE_M)
    assert narrow.for_beam(width_rad).floors["flat"][2].p == pytest.approx(0.5 * 0.7, rel=1e-6)
    configured = configured_performance(Config(sonar=SonarConfig(beam_width_deg=math.degrees(width_rad))))
    assert configured == shipped_performance().for_beam(width_rad)


def one_by_one(
    reported: Performance, kind: str, ground_m: float, altitude_m: float, look_rad: float, ripple_rad: float
) -> float:
    """Read by hand, without arrays."""
    if not (altitude_m > 0.0 and math.isfinite(ground_m)) or math.degrees(math.atan2(altitude_m, ground_m)) > 70.0:
        return 0.0
    range_m: float = ground_m * (reported.altitude_m / altitude_m) ** reported.altitude_exponent
    if range_m > reported.edges_m[-1]:
        return 0.0

    def of(floor: Any) -> float:
        middles = [(near + far) / 2.0 for near, far in zip(reported.edges_m[:-1], reported.edges_m[1:], strict=True)]
        p: list[float] = [band.p for band in reported.floors[floor]]
        if range_m <= middles[0]:
            return p[0]
        for k in range(1, len(middles)):
            if range_m <= middles[k]:
                part = (range_m - middles[k - 1]) / (middles[k] - middles[k - 1])
                return p[k - 1] + part * (p[k] - p[k - 1])
        return p[-1]

    if kind == "unknown":
        return min(of(floor) for floor in FLOORS)
    if kind != "ripple":
        return of(kind)
    if math.isnan(ripple_rad):
        return min(of("ripple_across"), of("ripple_oblique"), of("ripple_along"))
    degrees = math.degrees(look_rad - ripple_rad) % 180.0
    degrees = min(degrees, 180.0 - degrees)
    if degrees <= 15.0:
        return of("ripple_across")
    if degrees >= 75.0:
        return of("ripple_along")
    if degrees <= 45.0:
        return of("ripple_across") + (degrees - 15.0) / 30.0 * (of("ripple_oblique") - of("ripple_across"))
    return of("ripple_oblique") + (degrees - 45.0) / 30.0 * (of("ripple_along") - of("ripple_oblique"))


PLACES = st.tuples(
    st.sampled_from(SEABED_TYPES),
    st.floats(0.0, 100.0),
    st.floats(0.5, 30.0),
    st.floats(0.0, 2.0 * math.pi),
    st.one_of(st.just(math.nan), st.floats(0.0, math.pi)),
)


@settings(max_examples=40)
@given(st.lists(PLACES, min_size=1, max_size=20), st.sampled_from([0.0, 0.5, 1.0]))
def test_arrays_of_places_read_as_each_alone(
    places: list[tuple[str, float, float, float, float]], exponent: float
) -> None:
    reported = tables(exponent)
    kind = np.array([SEABED_TYPES.index(place[0]) for place in places], dtype=np.uint8)
    columns = [np.array([place[i] for place in places]) for i in range(1, 5)]
    p = reported.p_look(CellView(kind, *columns))
    assert p.dtype == np.float64
    # A grazing angle of 70 degrees, or the last edge, may fall to either side by rounding.
    ground, altitude = columns[0], columns[1]
    on_edge = np.isclose(ground * math.tan(math.radians(70.0)), altitude) | np.isclose(
        ground * (reported.altitude_m / altitude) ** exponent, reported.edges_m[-1]
    )
    expected = np.array([one_by_one(reported, *place) for place in places])
    np.testing.assert_allclose(np.where(on_edge, 0.0, p), np.where(on_edge, 0.0, expected), atol=1e-12)


@settings(max_examples=40)
@given(PLACES)
def test_unknown_is_the_most_cautious(place: tuple[str, float, float, float, float]) -> None:
    p = [float(tables().p_look(CellView(index, *place[1:]))) for index in range(len(SEABED_TYPES))]
    assert 0.0 <= p[UNKNOWN] == min(p) <= max(p) <= 1.0


@pytest.mark.parametrize(
    ("ground_m", "altitude_m"),
    [
        (1.0, 6.0),
        (0.0, 6.0),
        (41.0, 6.0),
        (1e9, 6.0),
        (math.nan, 6.0),
        (math.inf, 6.0),
        (15.0, math.nan),
        (15.0, 0.0),
        (15.0, -3.0),
    ],
)
def test_nothing_is_found_below_beyond_and_where_range_or_altitude_is_not_known(
    ground_m: float, altitude_m: float
) -> None:
    for kind in range(len(SEABED_TYPES)):
        assert tables().p_look(CellView(kind, ground_m, altitude_m, 0.0, 0.0)) == 0.0


def test_the_angle_to_ripples_is_that_to_the_nearest_of_both_ways() -> None:
    assert aspect_rad(3.1, 0.0) == pytest.approx(math.pi - 3.1)
    assert np.isnan(aspect_rad(0.0, math.nan))


def test_scalars_and_nothing_at_all_are_read() -> None:
    reported: LookModel = tables()
    none = np.empty(0, dtype=np.float32)
    assert reported.p_look(CellView(np.empty(0, dtype=np.uint8), *[none] * 5)).shape == (0,)
    assert reported.same_look_correlation == 0.4


def test_a_seabed_that_is_none_is_refused() -> None:
    with pytest.raises(ValueError, match="SEABED_TYPES"):
        tables().p_look(CellView(len(SEABED_TYPES), 10.0, 6.0, 0.0, 0.0))


def test_tables_come_back_from_json_as_they_were() -> None:
    assert parse_performance(msgspec.json.encode(tables()), "here") == tables()


def test_the_shipped_tables_know_every_floor_and_are_no_better_than_sure() -> None:
    reported = shipped_performance()
    for name in FLOORS:
        assert all(0.0 < band.p < 1.0 for band in reported.floors[name])
    flat, rough = (
        reported.p_look(CellView(SEABED_TYPES.index(name), 25.0, reported.altitude_m, 0.0, np.nan))
        for name in ("flat", "rough")
    )
    assert 0.0 < rough < flat < 1.0


def _broken(**changes: Any) -> bytes:
    return json.dumps(json.loads(msgspec.json.encode(tables())) | changes).encode()


_BAND = {"n_looks": 4, "n_found": 2, "p": 0.5, "low": 0.2, "high": 0.8}


def test_a_band_in_which_nothing_was_found_is_read() -> None:
    band = {"n_looks": 0, "n_found": 0, "p": 0.0, "low": 0.0, "high": 1.0}
    read = parse_performance(_broken(floors={name: [band] * 3 for name in FLOORS}), "here")
    assert read.floors["flat"][0].p == 0.0


@pytest.mark.parametrize(
    ("data", "statement"),
    [
        (b"", "truncated"),
        (b"\xff\xfe", "malformed|utf"),
        (b"[]", "object"),
        (_broken(altitude_m=0.0), "altitude_m"),
        (_broken(altitude_m="6"), "altitude_m"),
        (_broken(edges_m=[0.0, 10.0, 10.0, 40.0]), "rise"),
        (_broken(edges_m=[0.0, 10.0]), "rise"),
        (_broken(edges_m=[0.0, 10.0, 20.0, 40.0, 60.0]), "3 bands where edges_m makes 4"),
        (_broken(floors={}), "no table of"),
        (_broken(floors={"sand": [_BAND] * 3}), "sand"),
        (_broken(floors={name: [_BAND | {"low": 0.6}] * 3 for name in FLOORS}), "outside its interval"),
        (_broken(floors={name: [_BAND | {"n_found": 5}] * 3 for name in FLOORS}), "5 found in 4 looks"),
        (_broken(floors={name: [_BAND | {"p": 1.5}] * 3 for name in FLOORS}), "p"),
        (_broken(same_look_correlation=-0.1), "same_look_correlation"),
        (_broken(more=1), "more"),
    ],
)
def test_a_file_that_is_no_table_is_named_with_what_to_run(data: bytes, statement: str) -> None:
    with pytest.raises(BadInputError, match=rf"^p\.json: .*({statement}).*calibrate performance"):
        parse_performance(data, "p.json")


@given(st.floats(0.0, 3.0), st.floats(0.0, 12.0), st.floats(2.0, 70.0))
def test_each_decibel_more_than_usual_divides_the_odds_by_as_much_and_less_changes_nothing(
    loss_per_db: float, unevenness_db: float, ground_m: float
) -> None:
    usual = tables()
    uneven = msgspec.structs.replace(usual, loss_per_db=loss_per_db)
    there = CellView(0, ground_m, 6.0, 0.0, math.nan)
    uneven_there = there._replace(unevenness_db=unevenness_db)
    before, after = float(usual.p_look(there)), float(uneven.p_look(uneven_there))
    odds = before / (1.0 - before) * math.exp(-loss_per_db * max(unevenness_db - USUAL_UNEVENNESS_DB, 0.0))
    assert after == pytest.approx(odds / (1.0 + odds), rel=1e-9)
    assert uneven.p_look(there) == usual.p_look(there)  # not measured: as usual
    assert usual.p_look(uneven_there) == pytest.approx(usual.p_look(there))  # tables that know of none


def test_the_shipped_tables_promise_little_over_floor_that_hides_mines() -> None:
    """Over floor of 8 dB 23 of 552 looks found their mine, in missions that no table was fitted on."""
    sonar = shipped_performance()
    hidden, usual = (float(sonar.p_look(CellView(0, 30.0, 6.0, 0.0, math.nan, db))) for db in (7.0, 2.0))
    assert hidden < 0.08
    assert usual > 0.8
