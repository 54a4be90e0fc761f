"""DVL text, PD6 and Water Linked: what is written is read back, no damage hides an intact line, and no bottom means no
velocity."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.records import NAN
from drivers.framing import Framer
from drivers.navigation import dvl_pd6 as pd6
from drivers.navigation import dvl_water_linked as wl
from drivers.navigation.water_linked_unit import WaterLinkedUnit
from tests.drivers.navigation.nav_damage import T0, at, fed

VELOCITY = st.floats(-19.9, 19.9)
ANGLE = st.floats(0.0, 6.28)
LINES: st.SearchStrategy[pd6.Line] = st.one_of(
    st.builds(pd6.Pd6Attitude, st.floats(-1.5, 1.5), st.floats(-3.1, 3.1), ANGLE),
    st.builds(
        pd6.Water,
        st.floats(1e9, 4e9),
        st.floats(0, 40),
        st.floats(-2, 40),
        st.floats(0, 6000),
        st.floats(1400, 1600),
        st.integers(0, 0xFFF),
    ),
    st.builds(pd6.InstrumentVelocity, VELOCITY, VELOCITY, VELOCITY, VELOCITY, st.just(True)),
    st.builds(pd6.ShipVelocity, VELOCITY, VELOCITY, VELOCITY, st.just(True)),
    st.builds(pd6.EarthVelocity, VELOCITY, VELOCITY, VELOCITY, st.just(True)),
    st.just(pd6.ShipVelocity(NAN, NAN, NAN, False)),
    st.builds(pd6.Bottom, *(st.floats(-1e5, 1e5),) * 3, st.floats(0, 500), st.floats(0, 99)),
)
RECORDS: st.SearchStrategy[wl.Record] = st.one_of(
    st.builds(
        wl.Velocity,
        *(VELOCITY,) * 3,
        st.just(True),
        st.floats(0.05, 50),
        st.floats(0, 9),
        st.lists(st.integers(-999, 999).map(lambda value: value * 1e-7), min_size=9, max_size=9).map(tuple),
        *(st.integers(0, 10**16),) * 2,
        st.floats(0, 999),
        st.integers(0, 1),
    ),
    st.builds(
        wl.WaterLinkedAttitude,
        st.floats(0, 2e9),
        *(st.floats(-1e4, 1e4),) * 3,
        st.floats(0, 99),
        *(st.floats(-3.1, 3.1),) * 3,
        st.just(0),
    ),
)
GROUP = (
    b":SA, -2.31, +4.92, 12.34\r\n:TS,23111422132050,35.0,+14.0, 12.5,1500.0,  0\r\n:BI,   +24,   -7,  +12,   +3,A\r\n"
    b":BS,  -100,+1500,   +5,A\r\n:BE, +1000,-1000,   +5,A\r\n:BD,+00000012.34,+00000001.20,-00000000.50, 17.25,  "
    b"0.00\r\n"
)
NO_LOCK = GROUP.replace(b",A\r", b",V\r")
WRZ = b"wrz,0.120,-0.400,2.000,y,1.30,1.855,1e-07;0;1.4;0;1.2;0;0.2;0;1e+09,7,14,123.00,1*50\r\n"
WRU = b"wru,0,0.070,1.10,-40,-95*9c\r\n"
PD6_LINES = GROUP.splitlines(keepends=True)


def close(one: Any, other: Any, within: float) -> bool:
    return all(
        a == b or abs(a - b) <= within or (math.isnan(a) and math.isnan(b)) for a, b in zip(one, other, strict=True)
    )


@given(LINES)
def test_pd6_lines_are_read_back_within_their_last_digit(line: pd6.Line) -> None:
    wire = pd6.line_of(line)
    [((kind, fields), _, n_bytes)] = Framer(pd6.LineGrammar()).feed(wire)
    assert n_bytes == len(wire) - 1, "the line ends with CR"
    again = pd6.parse_line(kind, fields)
    assert again is not None
    assert type(again) is type(line)
    assert close(again, line, 0.051)
    assert pd6.line_of(again) == wire


@given(RECORDS)
def test_water_linked_messages_are_read_back_within_their_last_digit(record: wl.Record) -> None:
    wire = wl.message_of(record)
    [(body, _, _)] = Framer(wl.TextGrammar()).feed(wire)
    again = wl.parse(body)
    assert again is not None
    assert type(again) is type(record)
    assert wl.message_of(again) == wire
    if isinstance(record, wl.WaterLinkedAttitude):
        assert close(again, record, 0.001)
    else:
        assert close(again[:3], record[:3], 0.0006)


def test_the_crc_is_that_of_the_makers_examples() -> None:
    assert wl.crc8(WRZ.partition(b"*")[0]) == 0x50
    assert wl.crc8(WRU.partition(b"*")[0]) == 0x9C


def test_a_pd6_group_is_one_fix() -> None:
    unit = pd6.Pd6Unit("dvl")
    fixes = [fix for place, line in enumerate(PD6_LINES) for fix in unit.feed(line, at(place * 0.01))]
    [fix] = fixes
    assert fix.received == T0, "of its first line"
    assert fix.n_bytes == len(PD6_LINES[0])
    assert fix.time_utc_s == 1_700_000_000.5
    assert [math.degrees(angle) for angle in (fix.pitch_rad, fix.roll_rad, fix.heading_rad)] == pytest.approx(
        [-2.31, 4.92, 12.34]
    )
    assert (fix.depth_m, fix.altitude_m) == (12.5, 17.25)
    assert math.degrees(fix.course_rad) == pytest.approx(135.0)
    assert fix.drift_rad == pytest.approx(math.atan2(-0.1, 1.5))
    assert fix.speed_mps == pytest.approx(math.sqrt(2.0))
    assert fix.valid
    assert unit.counters["pd6.messages"] == 6


def test_without_bottom_lock_there_is_neither_velocity_nor_altitude() -> None:
    unit = pd6.Pd6Unit("dvl")
    [fix] = fed(unit, [NO_LOCK])
    assert not fix.valid
    assert all(math.isnan(value) for value in (fix.speed_mps, fix.altitude_m, fix.course_rad, fix.drift_rad))
    assert fix.depth_m == 12.5
    assert unit.counters["pd6.no_bottom_lock"] == 1


@pytest.mark.parametrize("code", [b"12A", b"38A", b"1FF"])
def test_a_failed_self_test_costs_neither_depth_nor_time(code: bytes) -> None:
    """Teledyne's codes are hexadecimal: 0x2A a sensor's data stream, 0x8A a leak, 0xFF a power failure."""
    unit = pd6.Pd6Unit("dvl")
    [fix] = fed(unit, [b":TS,23111422132050,35.0,+14.0,0012.5,1500.0," + code + b"\r\n"])
    assert (fix.depth_m, fix.time_utc_s) == (12.5, 1_700_000_000.5)
    assert unit.counters["pd6.implausible"] == 0


def test_zeros_that_stand_for_no_sensor_are_no_attitude_and_no_depth() -> None:
    """Water Linked's DVL fills the fields that it does not measure with zeros."""
    zeros = b":SA, +0.00, +0.00,  0.00\r\n:TS,22020812061800, 0.0, +0.0,   0.0,1475.0,  0\r\n"
    [fix] = fed(pd6.Pd6Unit("dvl"), [zeros])
    assert all(math.isnan(value) for value in (fix.heading_rad, fix.pitch_rad, fix.roll_rad, fix.depth_m))
    assert fix.time_utc_s == 1_644_321_978.0
    at_the_surface = b":SA, +0.00, +0.00,  0.00\r\n:TS,22020812061800,35.0, +0.0,   0.0,1475.0,  0\r\n"
    [fix] = fed(pd6.Pd6Unit("dvl"), [at_the_surface])
    assert (fix.heading_rad, fix.pitch_rad, fix.roll_rad, fix.depth_m) == (0.0, 0.0, 0.0, 0.0)


def test_a_velocity_that_is_bad_in_some_axes_alone_is_used_in_the_others() -> None:
    """A DVL without a compass, as Water Linked's, calls the velocity along earth's axes bad."""
    lines = [
        b":SA, +1.50, -2.00,  0.00\r\n",
        b":TS,22020812061800, 0.0, +0.0,   0.0,1475.0,  0\r\n",
        b":BI,  +123,  -420, +2000,    +0,A\r\n",
        b":BS,  -420,  +123, +2000,A\r\n",
        b":BE,    +0,    +0,    +0,V\r\n",
        b":BD,       +0.00,       +0.00,       +0.00,   5.32,  0.00\r\n",
    ]
    unit = pd6.Pd6Unit("dvl")
    [fix] = fed(unit, [b"".join(lines)])
    assert fix.valid
    assert fix.speed_mps == pytest.approx(math.hypot(0.42, 0.123))
    assert fix.drift_rad == pytest.approx(math.atan2(-0.42, 0.123))
    assert math.isnan(fix.course_rad)
    assert fix.altitude_m == 5.32
    assert unit.counters["pd6.no_bottom_lock"] == 0


def test_a_group_with_lost_lines_is_delivered_as_far_as_it_came() -> None:
    without_end = b"".join(PD6_LINES[:4])
    fixes = fed(pd6.Pd6Unit("dvl"), [without_end, GROUP])
    assert [math.isnan(fix.altitude_m) for fix in fixes] == [True, False]
    headless = fed(pd6.Pd6Unit("dvl"), [without_end, b"".join(PD6_LINES[1:])])
    assert [math.isnan(fix.heading_rad) for fix in headless] == [False, True], "a heading is not lent to the next group"


@pytest.mark.parametrize(
    "line",
    [
        b":SA,+99.00,+00.00,012.00",
        b":SA,+01.00,+00.00,400.00",
        b":SA,+01.00,+00.00",
        b":TS,23131422132050,35.0,+14.0,0012.5,1500.0,000",
        b":TS,23111422132050,35.0,+14.0,0012.5,0150.0,000",
        b":TS,23111422132050,35.0,+14.0,0012.5,1500.0,0G0",
        b":TS,23111422132050,35.0,+14.0,0012.5,1500.0",
        b":BI,+99999,+00000,+00000,+00000,A",
        b":BI,+00001,+00000,+00000,+00000,X",
        b":BS,+00001,nan,+00000,A",
        b":BD,0,0,0,1e3,0",
    ],
)
def test_implausible_lines_are_refused_and_counted(line: bytes) -> None:
    unit = pd6.Pd6Unit("dvl")
    assert fed(unit, [line + b"\r\n"]) == []
    assert unit.counters["pd6.implausible"] == 1


def test_a_wrz_gives_velocity_altitude_and_how_old_it_is() -> None:
    [fix] = fed(WaterLinkedUnit("dvl"), [WRZ])
    assert fix.speed_mps == pytest.approx(math.hypot(0.12, 0.4))
    assert fix.drift_rad == pytest.approx(math.atan2(-0.4, 0.12))
    assert (fix.altitude_m, fix.speed_sigma_mps) == (1.3, 1.855)
    assert fix.time_utc_s is None, "7 microseconds after power-up is no time of day"
    assert fix.age_s == pytest.approx(7e-6)


@pytest.mark.parametrize(("altitude_m", "given_m"), [(-1.0, math.nan), (0.0, math.nan), (0.05, 0.05)])
def test_a_wrz_with_lock_and_without_altitude_gives_none(altitude_m: float, given_m: float) -> None:
    locked = wl.Velocity(0.5, 0.0, 0.0, True, altitude_m, 0.01, (0.0,) * 9, 7, 14, 100.0, 0)
    [fix] = fed(WaterLinkedUnit("dvl"), [wl.message_of(locked)])
    assert (fix.speed_mps, fix.altitude_m) == pytest.approx((0.5, given_m), nan_ok=True)


def test_a_wrz_without_lock_gives_nothing() -> None:
    unit = WaterLinkedUnit("dvl")
    lost = wl.Velocity(
        0.0, 0.0, 0.0, False, -1.0, 0.0, (0.0,) * 9, 1_700_000_000_000_000, 1_700_000_000_150_000, 100.0, 0
    )
    [fix] = fed(unit, [wl.message_of(lost)])
    assert (fix.valid, fix.time_utc_s) == (False, 1_700_000_000.0)
    assert fix.age_s == pytest.approx(0.15)
    assert math.isnan(fix.speed_mps)
    assert math.isnan(fix.altitude_m)
    assert unit.counters["water_linked.no_bottom_lock"] == 1


def test_wru_is_known_but_gives_no_navigation() -> None:
    unit = WaterLinkedUnit("dvl")
    assert fed(unit, [WRU]) == []
    assert unit.counters["water_linked.ignored"] == 1
