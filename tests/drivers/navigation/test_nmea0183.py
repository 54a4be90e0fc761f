"""NMEA 0183: what is written is read back, other readers agree, and no damage hides an intact sentence or gets into a
fix."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import reduce
from itertools import pairwise
from operator import xor
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.clock import Stamp
from auv_mcm.records import NAN
from drivers.framing import Framer
from drivers.navigation.nav_decoder import NavFix
from drivers.navigation.nmea0183 import MAX_SENTENCE_BYTES, NmeaGrammar, sentence, xor_of
from drivers.navigation.nmea_unit import NmeaUnit
from drivers.navigation.sentences import (
    SENTENCES,
    Avr,
    Dbt,
    Dpt,
    Gga,
    Gll,
    Gpatt,
    Hdg,
    Hdm,
    Hdt,
    Hpr,
    Ohpr,
    Pashr,
    PixseAttitude,
    PixseAttitudeSigma,
    PixseHeave,
    PixsePosition,
    PixsePositionSigma,
    PixseSpeed,
    PixseSpeedSigma,
    PixseTime,
    Prdid,
    Record,
    Rmc,
    Ths,
    Vtg,
    Zda,
    body_of,
    parse,
)
from tests.drivers.navigation.nav_damage import T0, at, fed


def number(low: float, high: float) -> st.SearchStrategy[float]:
    return st.one_of(st.just(NAN), st.floats(low, high))


TIME = st.one_of(st.just(NAN), st.floats(0.0, 86_399.0))
LATITUDE, LONGITUDE = number(-90.0, 90.0), number(-180.0, 180.0)
ANGLE, SIGNED = number(0.0, 2 * math.pi), number(-math.pi, math.pi)
DATE = st.one_of(st.just(NAN), st.integers(10_000, 25_000).map(float))
COUNT = st.integers(0, 9).map(float)
METRES, SIGMA = number(-500.0, 500.0), number(0.0, 50.0)
STATUS, MODE = st.sampled_from("AV"), st.sampled_from(["", *"ADEFMNPRS"])
RECORDS: st.SearchStrategy[Record] = st.one_of(
    st.builds(Gga, TIME, LATITUDE, LONGITUDE, COUNT, COUNT, SIGMA, METRES, METRES),
    st.builds(Rmc, TIME, STATUS, LATITUDE, LONGITUDE, SIGMA, ANGLE, DATE, number(-0.5, 0.5), MODE),
    st.builds(Gll, LATITUDE, LONGITUDE, TIME, STATUS, MODE),
    st.builds(Hdt, ANGLE),
    st.builds(Ths, ANGLE, st.sampled_from(["", *"AEMSV"])),
    st.builds(Hdg, ANGLE, number(-0.5, 0.5), number(-0.5, 0.5)),
    st.builds(Hdm, ANGLE),
    st.builds(Hpr, TIME, ANGLE, SIGNED, SIGNED, st.sampled_from(["", "N", "G"])),
    st.builds(Avr, TIME, ANGLE, SIGNED, SIGNED, SIGMA, COUNT),
    st.builds(Gpatt, ANGLE, SIGNED, SIGNED),
    st.builds(Ohpr, ANGLE, SIGNED, SIGNED),
    st.builds(Vtg, ANGLE, SIGMA, MODE),
    st.builds(Zda, TIME, DATE),
    st.builds(Dpt, SIGMA, METRES, SIGMA),
    st.builds(Dbt, SIGMA),
    st.builds(Pashr, TIME, ANGLE, SIGNED, SIGNED, METRES, SIGMA, SIGMA, SIGMA, COUNT, COUNT),
    st.builds(Prdid, SIGNED, SIGNED, ANGLE),
    st.builds(PixseAttitude, SIGNED, SIGNED),
    st.builds(PixsePosition, LATITUDE, LONGITUDE, METRES),
    st.builds(PixseSpeed, METRES, METRES, METRES),
    st.builds(PixseHeave, METRES, METRES, METRES),
    st.builds(PixseTime, TIME),
    st.builds(PixseAttitudeSigma, SIGMA, SIGMA, SIGMA),
    st.builds(PixsePositionSigma, SIGMA, SIGMA, SIGMA),
    st.builds(PixseSpeedSigma, SIGMA, SIGMA, SIGMA),
)
HEADINGS = (Ths, Hdg, Hdm, Hpr, Avr, Gpatt, Ohpr)  # which the other reader names otherwise, or does not know
GGA = b"$GPGGA,123519.25,4807.0380,N,01131.0000,W,1,08,0.9,545.4,M,46.9,M,,"
PHINS = (
    "HEHDT,123.400,T",
    "PIXSE,ATITUD,-1.641,-0.490",
    "PIXSE,POSITI,53.10245714,8.83994382,-0.115",
    "PIXSE,SPEED_,-0.802,-1.243,0.000",
    "PIXSE,STDHRP,0.060,0.010,0.010",
    "PIXSE,STDPOS,1.50,2.50,0.30",
    "PIXSE,STDSPD,0.020,0.030,0.010",
    "PIXSE,TIME__,003356.016693",
)


def closed(body: bytes) -> bytes:
    return b"%b*%02X\r\n" % (body, reduce(xor, body[1:]))


def read(data: bytes, stamp: Stamp = T0) -> list[NavFix]:
    unit = NmeaUnit("n")
    return unit.feed(data, stamp) + unit.finish()


def fields_of(fix: NavFix) -> dict[str, Any]:
    """Return the fields that a fix reports of the vehicle."""
    fields = {name: getattr(fix, name) for name in fix.__struct_fields__[3:]}
    return {
        name: value
        for name, value in fields.items()
        if value not in (None, False) and value == value and name not in ("valid", "age_s")
    }


@given(st.binary(max_size=255))
def test_the_folded_checksum_is_the_xor_of_all_bytes(data: bytes) -> None:
    assert xor_of(data) == reduce(xor, data, 0)


@given(RECORDS)
def test_what_is_written_is_read_back_within_its_last_digit(record: Record) -> None:
    body = body_of(record)
    again: Any = parse(body)
    assert type(again) is type(record)
    pairs: list[tuple[Any, Any]] = list(zip(again, record, strict=True))
    for value, expected in pairs:
        if isinstance(expected, str) or math.isnan(expected):
            assert value == expected or math.isnan(value)
        else:
            assert value == pytest.approx(expected, abs=0.06)
    assert body_of(again) == body, "what was read is exactly what was written"
    assert len(sentence(body)) <= MAX_SENTENCE_BYTES
    [(message, offset, n_bytes)] = Framer(NmeaGrammar()).feed(sentence(body))
    assert (message, offset, n_bytes) == (body, 0, len(sentence(body)))


@given(LATITUDE.filter(lambda value: value == value), LONGITUDE.filter(lambda value: value == value))
def test_positions_are_written_to_millimetres(latitude_deg: float, longitude_deg: float) -> None:
    record = parse(body_of(Gll(latitude_deg, longitude_deg, NAN, "A")))
    assert isinstance(record, Gll)
    assert record.latitude_deg == pytest.approx(latitude_deg, abs=1e-8)
    assert record.longitude_deg == pytest.approx(longitude_deg, abs=1e-8)


@given(
    RECORDS.filter(
        lambda record: (
            not isinstance(record, (PixseAttitude, PixsePosition, PixseSpeed, PixseHeave, PixseTime, Prdid, *HEADINGS))
        )
    )
)
def test_another_reader_sees_the_same_numbers(record: Record) -> None:
    pynmeagps = pytest.importorskip("pynmeagps", reason="pynmeagps, another NMEA reader, is not installed")
    if isinstance(record, PixseAttitudeSigma | PixsePositionSigma | PixseSpeedSigma):
        return
    if isinstance(record, Pashr) and math.isnan(record.time_of_day_s):
        return  # it distinguishes the kinds of PASHR by the first character of the time
    message = pynmeagps.NMEAReader.parse(sentence(body_of(record)))
    degrees = {name: math.degrees(value) for name, value in record._asdict().items() if name.endswith("_rad")}
    mine = record._asdict() | degrees
    theirs = {
        "latitude_deg": "lat",
        "longitude_deg": "lon",
        "height_m": "alt",
        "hdop": "HDOP",
        "course_rad": "cogt" if isinstance(record, Vtg) else "cog",
        "depth_m": "depthm" if isinstance(record, Dbt) else "depth",
        "offset_m": "offset",
        "heading_rad": "trueHdg" if isinstance(record, Pashr) else "headingT",
        "roll_rad": "roll",
        "pitch_rad": "pitch",
        "quality": "quality",
    }
    for name, their_name in theirs.items():
        if name in mine and not math.isnan(mine[name]):
            assert float(getattr(message, their_name)) == pytest.approx(mine[name], abs=0.06)
    if "date_days" in mine and not math.isnan(mine["date_days"]) and isinstance(record, Rmc):
        assert (message.date.toordinal() - 719_163) == mine["date_days"]
    if "time_of_day_s" in mine and not math.isnan(mine["time_of_day_s"]):
        clock = message.utctime if isinstance(record, Pashr) else message.time
        assert clock.hour * 3600 + clock.minute * 60 + clock.second + clock.microsecond * 1e-6 == pytest.approx(
            mine["time_of_day_s"], abs=1e-3
        )


@pytest.mark.parametrize(
    "line",
    [
        b"$PIXSE,ATITUD,-1.641,-0.490*6D",
        b"$PIXSE,POSITI,53.10245714,8.83994382,-0.115*71",
        b"$PIXSE,SPEED_,-0.802,-1.243,0.000*6F",
        b"$PIXSE,TIME__,003356.016693*64",
    ],
)
def test_recorded_phins_sentences_are_written_as_they_were(line: bytes) -> None:
    [(body, _, _)] = Framer(NmeaGrammar()).feed(line)
    record = parse(body)
    assert record is not None
    assert sentence(body_of(record)) == line + b"\r\n"


def test_a_gga_gives_place_and_time() -> None:
    [fix] = read(closed(GGA), Stamp(0, 1_699_964_000_000_000_000))  # 12:13:20 on 2023-11-14
    assert fields_of(fix) == pytest.approx(
        {
            "time_utc_s": 1_699_920_000 + 12 * 3600 + 35 * 60 + 19.25,
            "latitude_deg": 48.1173,
            "longitude_deg": -11 - 31 / 60,
        },
        rel=1e-11,
    )
    assert fix.valid
    assert fix.n_bytes == len(closed(GGA))


@pytest.mark.parametrize("quality", [b"0", b"7", b"8", b""])
def test_a_gga_without_a_measured_place_gives_none(quality: bytes) -> None:
    [fix] = read(closed(GGA.replace(b",1,08", b"," + quality + b",08")))
    assert not fix.valid
    assert math.isnan(fix.latitude_deg)


def test_estimated_places_say_so() -> None:
    assert read(closed(GGA.replace(b",1,08", b",6,08")))[0].estimated
    assert read(sentence("GPRMC,081836,A,3751.65,S,14507.36,E,2.0,180.0,130998,,,E"))[0].estimated


def test_an_rmc_gives_speed_course_and_the_date_that_other_sentences_lack() -> None:
    rmc, gga = read(
        sentence("GPRMC,235958,A,3751.65,S,14507.36,E,2.0,180.0,130998,011.3,E")
        + sentence("GPGGA,000001,3751.65,S,14507.36,E,1,,,,M,,M,,")
    )
    assert rmc.time_utc_s == 905_731_198.0  # 1998-09-13 23:59:58
    assert gga.time_utc_s == 905_731_201.0, "three seconds later is on the next day"
    assert rmc.speed_mps == pytest.approx(2.0 * 1852 / 3600)
    assert rmc.course_rad == pytest.approx(math.pi)
    assert rmc.latitude_deg == pytest.approx(-37.8608333)


@pytest.mark.parametrize("host_s", [1_699_999_990.0, 1_700_006_410.0])
def test_a_time_of_day_is_put_on_the_day_nearest_to_this_computers_clock(host_s: float) -> None:
    for seconds in (86_390.0, 10.0):
        [fix] = read(sentence(body_of(Gga(seconds, 1.0, 2.0, 1.0))), Stamp(0, round(host_s * 1e9)))
        assert fix.time_utc_s is not None
        assert abs(fix.time_utc_s - host_s) <= 43_200.0
        assert fix.time_utc_s % 86_400.0 == pytest.approx(seconds)


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        ("HEHDT,271.5,T", {"heading_rad": math.radians(271.5)}),
        ("GPVTG,90.0,T,,M,3.600,N,6.67,K,A", {"course_rad": math.pi / 2, "speed_mps": 1.852}),
        ("GPVTG,90.0,T,,M,3.600,N,6.67,K,M", {}),
        ("SDDPT,12.5,-0.3", {"altitude_m": 12.5}),
        ("SDDBT,41.01,f,,M,,F", {"altitude_m": 12.499848}),
        ("SDDBT,,f,,M,7.0,F", {"altitude_m": 12.8016}),
        ("SDDPT,0.0,0.0,", {}),
        (
            "PRDID,-1.5,2.5,90.0",
            {"pitch_rad": math.radians(-1.5), "roll_rad": math.radians(2.5), "heading_rad": math.pi / 2},
        ),
        ("GPZDA,000010.5,15,11,2023,00,00", {"time_utc_s": 1_700_006_410.5, "is_time_message": True}),
        ("GPZDA,000010.5,,,,00,", {"time_utc_s": 1_700_006_410.5}),
        ("GPZDA,235960.5,31,12,2016,00,00", {"time_utc_s": 1_483_228_800.5, "is_time_message": True}),
        ("GPGLL,6005.071,N,02332.346,E,,A,D", {"latitude_deg": 60 + 5.071 / 60, "longitude_deg": 23 + 32.346 / 60}),
        ("GPGLL,6005.071,N,02332.346,E,,V,", {}),
        ("GPGLL,6005.071,N,02332.346,E,,A,N", {}),
        ("GPRMC,,V,3751.65,S,14507.36,E,2.0,180.0,,,", {}),
        ("GPRMC,,A,3751.65,S,14507.36,E,2.0,180.0,,,,S", {}),
        ("GPGLL,6005.071,N,02332.346,E", {"latitude_deg": 60 + 5.071 / 60, "longitude_deg": 23 + 32.346 / 60}),
        ("GPGLL,,,,", {}),
        ("GPGLL,6005.071,N,02332.346,E,,", {}),
    ],
)
def test_sentences_give_fields(body: str, expected: dict[str, float]) -> None:
    [fix] = read(sentence(body), Stamp(0, 1_700_006_400_000_000_000))
    assert fields_of(fix) == pytest.approx(expected, rel=1e-11)
    assert fix.valid == bool(expected)


def test_attitude_comes_with_its_own_errors() -> None:
    [fix] = read(sentence("PASHR,120000.125,123.45,T,1.00,-2.00,0.12,0.100,0.200,0.300,1,0"))
    assert fix.time_utc_s is not None
    assert fix.time_utc_s % 86_400.0 == 43_200.125
    assert math.degrees(fix.roll_rad) == pytest.approx(1.0)
    assert math.degrees(fix.pitch_rad) == pytest.approx(-2.0)
    assert math.degrees(fix.attitude_sigma_rad) == pytest.approx(0.2)
    assert math.degrees(fix.heading_sigma_rad) == pytest.approx(0.3)


@pytest.mark.parametrize(
    "body",
    [
        "GPGGA,126019,4807.038,N,01131.000,E,1",
        "GPGGA,123519,4860.000,N,01131.000,E,1",
        "PIXSE,POSITI,90.1,8.8,-20.0",
        "PIXSE,POSITI,53.1,360.1,-20.0",
        "GPGGA,123519,4807.038,X,01131.000,E,1",
        "GPGGA,123519,4807.038,,01131.000,E,1",
        "GPGGA,123519,9007.038,N,01131.000,E,1",
        "GPGGA,123519,4807.038,N,1131.000,E,1",
        "GPHDT,nan,T",
        "GPHDT,1e3,T",
        "GPHDT, 12,T",
        "GPHDT,1_2,T",
        "GPHDT,12,M",
        "GPRMC,081836,X,3751.65,S,14507.36,E,2.0,180.0,130998",
        "GPRMC,081836,A,3751.65,S,14507.36,E,2.0,180.0,310298",
        "GPZDA,000010,31,02,2023",
    ],
)
def test_fields_that_cannot_be_true_are_refused_and_counted(body: str) -> None:
    unit = NmeaUnit("n")
    assert unit.feed(sentence(body), T0) == []
    assert unit.counters["nmea.malformed"] == 1


@pytest.mark.parametrize(
    ("damaged", "reason"),
    [
        (b"$GPHDT,10.0,T*00\r\n", "checksum"),
        (b"$GPHDT,10.0,T*ZZ\r\n", "checksum_malformed"),
        (b"$GPHDT,10.0,T\r\n", "checksum_absent"),
        (b"$GPHDT,10", "interrupted"),
        (b"!AIVDM,1", "interrupted"),
        (b"$GPHDT,10\xc3\xa9,T*0A\r\n", "non_ascii"),
        (b"$GPHDT,\x00\x01,T*0A\r\n", "control_character"),
        (b"$" + b"A" * 300, "oversize"),
    ],
)
def test_every_refusal_is_counted_by_its_reason_and_the_next_sentence_is_read(damaged: bytes, reason: str) -> None:
    unit = NmeaUnit("n")
    [fix] = unit.feed(damaged + sentence("GPHDT,20.0,T"), T0)
    assert math.degrees(fix.heading_rad) == pytest.approx(20.0)
    assert unit.counters[f"nmea.refused.{reason}"] == 1


@pytest.mark.parametrize("end", [b"", b"\n", b"\r", b"\n\r"])
def test_the_line_end_does_not_matter(end: bytes) -> None:
    line = sentence("GPHDT,20.0,T").rstrip() + end
    assert len(NmeaUnit("n").feed(line * 3, T0)) == 3


def test_a_phins_burst_is_one_fix_with_the_time_of_its_last_sentence() -> None:
    unit = NmeaUnit("phins")
    fixes = []
    for burst in range(3):
        for place, body in enumerate(PHINS):
            fixes += unit.feed(sentence(body.replace("003356", f"00335{6 + burst}")), at(burst + place * 1e-3))
    # The very first heading is taken for a compass's, since nothing yet says that an inertial unit sends it.
    assert len(fixes) == 4
    fix = fixes[-1]
    assert fix.received == at(2.0), "of the first sentence"
    assert fix.time_utc_s is not None
    assert fix.time_utc_s % 86_400.0 == pytest.approx(2038.016693)
    assert math.degrees(fix.heading_rad) == pytest.approx(123.4)
    assert math.degrees(fix.roll_rad) == pytest.approx(-1.641)
    assert (fix.latitude_deg, fix.longitude_deg, fix.depth_m) == (53.10245714, 8.83994382, 0.115)
    assert fix.speed_mps == pytest.approx(math.hypot(0.802, 1.243))
    assert math.degrees(fix.course_rad) == pytest.approx(180 + math.degrees(math.atan2(0.802, 1.243)))
    assert (fix.position_sigma_m, fix.depth_sigma_m, fix.speed_sigma_mps) == (2.5, 0.3, 0.03)
    assert math.degrees(fix.heading_sigma_rad) == pytest.approx(0.06)
    assert math.degrees(fix.attitude_sigma_rad) == pytest.approx(0.01)


def test_a_burst_whose_time_was_lost_is_still_delivered_without_one_or_its_heading() -> None:
    bodies = (*PHINS, *PHINS[1:-1], *PHINS, *PHINS[:-1], *PHINS[1:])
    fixes = fed(NmeaUnit("phins"), [sentence(body) for body in bodies])[1:]
    assert [fix.time_utc_s is None for fix in fixes] == [False, True, False, True, False]
    assert [math.isnan(fix.heading_rad) for fix in fixes] == [True, True, False, False, True]


def test_longitudes_beyond_180_are_west() -> None:
    fix = fed(NmeaUnit("phins"), [sentence("PIXSE,POSITI,53.1,351.0,-20.0")])[0]
    assert (fix.longitude_deg, fix.depth_m) == (-9.0, 20.0)


@given(st.sampled_from(sorted(SENTENCES)), st.lists(st.text("0123456789.-+,AVNSEWTMKfF ", max_size=12), max_size=20))
def test_no_checksummed_nonsense_raises(key: str, fields: list[str]) -> None:
    body = ",".join([key if key.startswith("P") else f"GP{key}", *fields])[:200]
    read(sentence(body))


def test_a_recorded_log_is_read_whole(shared_data: Callable[[str], Path]) -> None:
    data = shared_data("nmea/plaka_head.log").read_bytes()
    unit = NmeaUnit("n")
    fixes = [fix for start in range(0, len(data), 997) for fix in unit.feed(data[start : start + 997], T0)]
    counters = unit.counters
    assert counters["nmea.messages"] == 56_728
    assert counters["nmea.malformed"] == 0
    assert not [name for name in counters if "refused" in name]
    track = [(fix.latitude_deg, fix.longitude_deg) for fix in fixes if fix.latitude_deg == fix.latitude_deg]
    assert len(track) == 3545
    steps_m = [
        111_195.0 * math.hypot(b[0] - a[0], (b[1] - a[1]) * math.cos(math.radians(60.1))) for a, b in pairwise(track)
    ]
    assert max(steps_m) < 25.0, "a sailing boat's track has no jumps"
    speeds = [fix.speed_mps for fix in fixes if fix.speed_mps == fix.speed_mps]
    assert sum(steps_m) == pytest.approx(sum(speeds) / len(speeds) * 3545 * 2.0, rel=0.05), (
        "way made is speed times the 2 s between fixes"
    )


@pytest.mark.parametrize(
    ("bodies", "expected_deg"),
    [
        (["GNTHS,123.4,A"], (123.4, NAN, NAN)),
        (["HCHDG,100.0,2.0,W,12.0,E"], (110.0, NAN, NAN)),
        (["HCHDG,350.0,,,12.0,E"], (2.0, NAN, NAN)),
        (["GPRMC,101530,A,4300.0,N,00500.0,E,3.0,90.0,010124,5.0,W,A", "HCHDM,100.0,M"], (95.0, NAN, NAN)),
        (["HCHDM,100.0,M"], (100.0, NAN, NAN)),
        (["PSAT,HPR,101530.00,77.5,1.5,,N"], (77.5, 1.5, 0.0)),
        (["PSAT,HPR,101530.00,77.5,,-2.5,N"], (77.5, 0.0, -2.5)),
        (["PTNL,AVR,181059.6,-10.5,Yaw,+0.0134,Tilt,-2.0,Roll,60.191,3,2.5,6"], (349.5, 0.0134, -2.0)),
        (["PFEC,GPatt,210.5,-1.0,2.0"], (210.5, -1.0, 2.0)),
        (["OHPR,301.2,1.0,-2.0,21.5"], (301.2, 1.0, -2.0)),
    ],
)
def test_every_sentence_of_a_heading_is_read(bodies: list[str], expected_deg: tuple[float, float, float]) -> None:
    fix = read(b"".join(map(sentence, bodies)))[-1]
    found_deg = [math.degrees(angle) for angle in (fix.heading_rad, fix.pitch_rad, fix.roll_rad)]
    assert found_deg == pytest.approx(expected_deg, abs=1e-9, nan_ok=True)


@pytest.mark.parametrize(
    "body", ["GNTHS,123.4,V", "GNTHS,123.4,S", "PTNL,AVR,181059.6,+149.4,Yaw,+0.01,Tilt,,,60.1,0,2.5,6", "GNTHS,,V"]
)
def test_a_heading_that_the_unit_calls_bad_is_none(body: str) -> None:
    fix = read(sentence(body))[-1]
    assert math.isnan(fix.heading_rad)
    assert not fix.valid


def test_of_several_headings_of_a_unit_the_true_one_serves_alone() -> None:
    unit = NmeaUnit("n")
    fixes = unit.feed(b"".join(map(sentence, ["GPHDT,100.0,T", "HCHDG,95.0,,,,", "HCHDM,95.0,M"] * 9)), T0)
    headings = {fix.heading_rad for fix in fixes if not math.isnan(fix.heading_rad)}
    assert headings == {math.radians(100.0)}
    assert unit.counters["nmea.heading_not_used"] == 18
    assert unit.take_notices() == []


@pytest.mark.parametrize(
    ("body", "code"),
    [
        ("HCHDM,95.0,M", "nav_heading_magnetic"),
        ("VWVHW,95.0,T,90.0,M,3.0,N,5.5,K", "nav_heading_not_read"),
        ("GNTHS,,V", "nav_heading_not_valid"),
    ],
)
def test_a_heading_that_is_not_as_good_as_it_looks_is_reported_once(body: str, code: str) -> None:
    unit = NmeaUnit("n")
    unit.feed(sentence(body) * 100, T0)
    assert [notice.code for notice in unit.take_notices()] == [code]
