"""Sentences of vehicles: what is written is read back, published samples are read, and what cannot be true is
refused."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import reduce
from operator import xor
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import structs

from auv_mcm.records import NAN
from auv_mcm.settings.vehicle_settings import BluefinSettings, IverSettings, ReconSettings
from drivers.framing import Framer, Grammar
from drivers.navigation.nmea0183 import MAX_SENTENCE_BYTES, sentence
from drivers.vehicle import bluefin_sentences as bluefin
from drivers.vehicle import iver_sentences as iver
from drivers.vehicle import recon_sentences as recon
from drivers.vehicle.ascii_fields import CLASSES, Table, plain_text
from drivers.vehicle.dialect import ContactReport
from sim_replay.fakes.vehicles.text_controller import report_from_fields
from tests.drivers.vehicle.vehicle_loop import REPORT

BLUEFIN, IVER, RECON = (
    bluefin.table_of(BluefinSettings()),
    iver.table_of(IverSettings()),
    recon.table_of(ReconSettings()),
)
FEET = iver.table_of(IverSettings(remote_helm_version=4))
RECON_SAMPLE = (
    b"#S,T15:08:37.672,LAT39N30.5553,LON74W19.4386,D-0.10,DG0.00,A0.00,P-0.3,R3.0,"
    b"TR0,TRG0,V0.00,H0.4,HR0.0,HG0.0,M10,l0,*48\n"
)
IVER_SAMPLE = b"$C82.8P-3.89R-2.63T20.3D3.2*78"


def span(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high)


def or_nan(values: st.SearchStrategy[float]) -> st.SearchStrategy[float]:
    return st.one_of(st.just(NAN), values)


TIME, LATITUDE, LONGITUDE = span(0.0, 86_399.0), or_nan(span(-90.0, 90.0)), or_nan(span(-180.0, 180.0))
HEADING, PITCH, ROLL = span(0.0, 2.0 * math.pi), or_nan(span(-1.5, 1.5)), or_nan(span(-3.1, 3.1))
DEPTH, SPEED, SIZE, SIGMA = span(-5.0, 6000.0), span(-9.0, 9.0), or_nan(span(0.0, 30.0)), or_nan(span(0.0, 5000.0))
WORDS = st.text("abcXYZ 0123456789.:-", min_size=1, max_size=20)
SHARES = st.lists(span(0.0, 1.0), min_size=6, max_size=6)
REPORTS = st.builds(
    ContactReport,
    session=st.integers(0, 2**63),
    number=st.integers(0, 99_999),
    revision=st.integers(1, 9999),
    time_s=span(0.0, 4e9),
    latitude_deg=span(-90.0, 90.0),
    longitude_deg=span(-180.0, 180.0),
    sigma_m=SIGMA,
    p_mine=span(0.0, 1.0),
    classification=st.sampled_from(CLASSES),
    belief=SHARES.map(lambda shares: dict(zip(CLASSES, shares, strict=True))),
    n_views=st.integers(0, 99),
    depth_m=or_nan(DEPTH),
    length_m=SIZE,
    width_m=SIZE,
    height_m=SIZE,
    length_sigma_m=SIGMA,
    width_sigma_m=SIGMA,
    height_sigma_m=SIGMA,
)
BIT = st.sampled_from("01")
Write = Callable[[Any], bytes]
DIALECTS: dict[str, tuple[Table, Write, Grammar[str], st.SearchStrategy[Any]]] = {
    "bluefin": (
        BLUEFIN,
        lambda record: sentence(BLUEFIN.body_of(record)),
        bluefin.BluefinGrammar(),
        st.one_of(
            st.builds(bluefin.BluefinAnswer, or_nan(TIME), WORDS, or_nan(TIME), st.sampled_from("0123"), WORDS),
            st.builds(
                bluefin.BluefinPosition,
                TIME,
                LATITUDE,
                LONGITUDE,
                st.just(1.0),
                DEPTH,
                DEPTH,
                HEADING,
                ROLL,
                PITCH,
                TIME,
            ),
            st.builds(bluefin.BluefinVelocity, TIME, SPEED, SPEED, SPEED),
            st.builds(bluefin.BluefinControl, TIME, BIT),
            st.builds(bluefin.BluefinMission, TIME, WORDS, WORDS),
            st.builds(bluefin.BluefinCommand, TIME, WORDS),
            st.builds(bluefin.BluefinShutdown, TIME),
            st.builds(bluefin.BluefinBegin, TIME, WORDS),
            st.builds(bluefin.BluefinEnd, TIME, WORDS),
            st.builds(bluefin.BluefinLog, WORDS, st.sampled_from(["ON", "OFF"])),
            st.builds(bluefin.BluefinStatus, TIME, BIT, WORDS),
            st.builds(bluefin.BluefinSteer, TIME, HEADING, DEPTH, BIT, SPEED, st.just("1"), st.just("0")),
            st.builds(bluefin.BluefinCancel, TIME, st.just(0.0)),
            st.builds(bluefin.BluefinContact, TIME, REPORTS),
        ),
    ),
    "iver": (
        IVER,
        lambda record: iver.line_of(IVER, record),
        iver.IverGrammar(),
        st.one_of(
            st.builds(
                iver.IverState,
                st.sampled_from(["N", "S", "P", "M", "mP", "A", "W"]),
                LATITUDE,
                LONGITUDE,
                SPEED,
                DEPTH,
                HEADING,
                DEPTH,
            ),
            st.builds(iver.IverCompass, HEADING, PITCH.filter(math.isfinite), ROLL.filter(math.isfinite), SPEED, DEPTH),
            st.builds(iver.IverPoll),
            st.builds(
                iver.IverSteer, HEADING, DEPTH, SIGMA.filter(math.isfinite), SPEED, st.integers(1, 120).map(float)
            ),
            st.builds(iver.IverContact, REPORTS),
            st.builds(iver.IverHealth, WORDS),
        ),
    ),
    "recon": (
        RECON,
        lambda record: recon.frame(RECON.body_of(record)),
        recon.ReconGrammar(),
        st.one_of(
            st.builds(
                recon.ReconState,
                *(
                    TIME,
                    LATITUDE.filter(math.isfinite),
                    LONGITUDE.filter(math.isfinite),
                    DEPTH,
                    DEPTH,
                    DEPTH,
                    PITCH,
                    ROLL,
                    SIZE,
                    SIZE,
                ),
                *(SPEED, HEADING, PITCH, ROLL, st.integers(0, 0xFFFF), WORDS),
            ),
            st.builds(recon.ReconShutdown),
            st.builds(recon.ReconEngage, BIT),
            st.builds(recon.ReconHeading, HEADING),
            st.builds(recon.ReconDepth, DEPTH),
            st.builds(recon.ReconSpeed, SPEED),
            st.builds(recon.ReconAlive, WORDS),
            st.builds(recon.ReconQuery, WORDS),
            st.builds(recon.ReconContact, REPORTS),
        ),
    ),
}
every_dialect = pytest.mark.parametrize("name", DIALECTS)


def alike(value: Any, expected: Any, places: float) -> bool:
    """Equal within the last digit that is written; headings may have passed north."""
    if isinstance(expected, ContactReport):
        return all(
            alike(getattr(value, field), getattr(expected, field), places) for field in expected.__struct_fields__
        )
    if isinstance(expected, dict):
        return all(alike(value[key], expected[key], places) for key in expected)
    if isinstance(expected, float):
        turned = abs(abs(value - expected) - 2.0 * math.pi) < places
        return math.isnan(value) if math.isnan(expected) else turned or abs(value - expected) < places
    return bool(value == expected)


@every_dialect
@settings(max_examples=40)
@given(data=st.data())
def test_what_is_written_is_read_back_within_its_last_digit(name: str, data: st.DataObject) -> None:
    table, write, grammar, records = DIALECTS[name]
    record = data.draw(records)
    line = write(record)
    assert len(line) <= MAX_SENTENCE_BYTES + 2
    framer = Framer(grammar)
    [(body, offset, n_bytes)] = framer.feed(line)
    assert (offset, n_bytes) == (0, len(line))
    again: Any = table.parse(body)
    assert type(again) is type(record)
    assert all(alike(value, expected, 0.51) for value, expected in zip(again, record, strict=True)), (again, record)
    assert write(again) == line, "what was read is exactly what was written"


@every_dialect
@settings(max_examples=40)
@given(data=st.data())
def test_positions_are_written_to_less_than_a_metre(name: str, data: st.DataObject) -> None:
    table, write, grammar, _ = DIALECTS[name]
    latitude_deg, longitude_deg = data.draw(span(-90.0, 90.0)), data.draw(span(-180.0, 180.0))
    example: dict[str, Any] = {
        "bluefin": bluefin.BluefinPosition._make([1.0] * 10),
        "iver": iver.IverState._make(["N", *[1.0] * 6]),
        "recon": recon.ReconState._make([*[1.0] * 14, 1, "1"]),
    }
    record = example[name]._replace(latitude_deg=latitude_deg, longitude_deg=longitude_deg)
    [(body, _, _)] = Framer(grammar).feed(write(record))
    again: Any = table.parse(body)
    assert again.latitude_deg == pytest.approx(latitude_deg, abs=1e-6)
    assert again.longitude_deg == pytest.approx(longitude_deg, abs=1e-6)


@settings(max_examples=40)
@given(REPORTS)
def test_another_reader_finds_the_same_contact(report: ContactReport) -> None:
    body = BLUEFIN.body_of(bluefin.BluefinContact(0.0, report))
    other = report_from_fields(body.split(",")[2:])
    again: Any = BLUEFIN.parse(body)
    for field in report.__struct_fields__:
        assert alike(getattr(other, field), getattr(again.report, field), 1e-9), field


def test_a_contact_of_extreme_numbers_fits_into_a_sentence() -> None:
    sizes = dict.fromkeys(("length_m", "width_m", "height_m"), 100.0)
    sigmas = dict.fromkeys(("length_sigma_m", "width_sigma_m", "height_sigma_m"), 9999.99)
    place = {"longitude_deg": -179.99, "sigma_m": 99_999.99, "depth_m": 11_000.0, "time_s": 4_000_000_000.123}
    longest = structs.replace(REPORT, session=2**64 - 1, number=99_999, revision=9999, **sizes, **sigmas, **place)
    contacts: dict[str, Any] = {
        "bluefin": bluefin.BluefinContact(86_399.0, longest),
        "iver": iver.IverContact(longest),
        "recon": recon.ReconContact(longest),
    }
    for name, (_, write, grammar, _) in DIALECTS.items():
        line = write(contacts[name])
        assert len(line) <= MAX_SENTENCE_BYTES
        assert len(Framer(grammar).feed(line)) == 1


def test_the_published_state_of_a_remus_is_read_and_written_to_the_letter() -> None:
    [(body, _, n_bytes)] = Framer(recon.ReconGrammar()).feed(RECON_SAMPLE)
    assert n_bytes == len(RECON_SAMPLE)
    state: Any = RECON.parse(body)
    assert state.time_of_day_s == pytest.approx(15 * 3600 + 8 * 60 + 37.672)
    assert state.latitude_deg == pytest.approx(39.0 + 30.5553 / 60.0, abs=1e-9)
    assert state.longitude_deg == pytest.approx(-74.0 - 19.4386 / 60.0, abs=1e-9)
    assert state.depth_m == -0.1
    assert state.roll_rad == pytest.approx(math.radians(3.0))
    assert state.mode == 0x10
    assert recon.frame(RECON.body_of(state)) == RECON_SAMPLE


def test_the_published_compass_of_an_iver_is_read() -> None:
    [(body, _, n_bytes)] = Framer(iver.IverGrammar()).feed(IVER_SAMPLE)
    assert n_bytes == len(IVER_SAMPLE)
    compass: Any = IVER.parse(body)
    assert [math.degrees(angle) for angle in compass[:3]] == pytest.approx([82.8, -3.89, -2.63])
    assert compass[3:] == (20.3, 3.2)


def test_an_iver_takes_depths_in_feet_before_version_5_and_in_metres_from_then_on() -> None:
    steer = iver.IverSteer(math.radians(90.0), 3.048, 20.0, 1852.0 / 3600.0, 5.0)
    assert FEET.body_of(steer) == "OMS,90.0,10.0,20.0,1.0,5"
    assert IVER.body_of(steer) == "OMS,90.0,3.0,20.0,1.0,5"
    state = "OSI,0,N,1,48.0,-5.0,2.0,0,N,32.8084,0,0,m,0,10.0,65.6168,0"
    for table in (FEET, IVER):
        read: Any = table.parse(state)
        assert read.depth_m == pytest.approx(20.0)
        assert read.altitude_m == pytest.approx(10.0)


def test_no_heading_is_written_as_a_full_turn() -> None:
    nearly = 2.0 * math.pi - 1e-6
    assert BLUEFIN.body_of(bluefin.BluefinSteer(0.0, nearly, 5.0, "0", 1.0)) == "BPRMB,000000.000,0.00,5.00,0,1.00,1,0"
    assert RECON.body_of(recon.ReconHeading(nearly)) == "C,Heading,Goal,0.0"
    assert IVER.body_of(iver.IverSteer(nearly, 5.0, 20.0, 1.0, 5.0)).startswith("OMS,0.0,")


@pytest.mark.parametrize(
    ("table", "body"),
    [
        (BLUEFIN, "BFCTL,101010.000,2"),
        (BLUEFIN, "BFCTL,101010.000"),
        (BLUEFIN, "BFACK,101010.000,RMB,101010.000,0,9,,"),
        (BLUEFIN, "BFACK,101010.000,,101010.000,0,2,,"),
        (BLUEFIN, "BFNVG,101010.000,9100.0,N,00000.0,E,1,5,5,10,0,0,101010.000"),
        (BLUEFIN, "BFNVG,101010.000,4100.0,N,00000.0,E,1,5,99999,10,0,0,101010.000"),
        (BLUEFIN, "BFNVG,101010.000,4100.0,N,00000.0,E,1,5,5,400,0,0,101010.000"),
        (BLUEFIN, "BFNVR,101010.000,fast,0,0"),
        (BLUEFIN, "BFNVR,251010.000,0,0,0"),
        (IVER, "OSI,0,,1,48.0,-5.0,2.0,0,N,30,0,0,m,0,10.0,60"),
        (IVER, "OSI,0,N,1,98.0,-5.0,2.0,0,N,30,0,0,m,0,10.0,60"),
        (IVER, "C,82.8,-91,0,0,0"),
        (RECON, "S,T15:08:37.672,LAT39N30.5553"),
        (RECON, "S,T15:08:37.672,LAT39E30.5553,LON74W19.4386,D0,DG0,A0,P0,R3,TR0,TRG0,V0,H0,HR0,HG0,M10,l0"),
        (RECON, "S,T15:08:37.672,LAT39N30.5553,LON74W19.4386,D0,DG0,A0,P0,R3,TR0,TRG0,V0,H0,HR0,HG0,MXY,l0"),
        (RECON, "S,T15:08:37.672,LAT39N30.5553,LON74W19.4386,0,DG0,A0,P0,R3,TR0,TRG0,V0,H0,HR0,HG0,M10,l0"),
        (RECON, "C,Speed,1.5 rpm"),
        (RECON, "E,2"),
    ],
)
def test_what_cannot_be_true_to_its_kind_is_refused(table: Table, body: str) -> None:
    with pytest.raises(ValueError, match=r"\S"):
        table.parse(body)


def test_text_for_people_never_breaks_a_sentence() -> None:
    assert plain_text("a,b*c$d!e#f\r\ng\x80é", 80) == "a b c d e f  g  "
    assert plain_text("x" * 99, 5) == "xxxxx"


def test_checksums_are_those_of_an_obvious_reader_and_of_pynmeagps() -> None:
    body = BLUEFIN.body_of(bluefin.BluefinSteer(45_296.5, 1.0, 5.0, "1", 1.5))
    assert sentence(body) == b"$%b*%02X\r\n" % (body.encode(), reduce(xor, body.encode()))
    total = 0
    for byte in b"#E,1,*":
        total += byte
    assert recon.frame("E,1") == b"#E,1,*" + format(total % 256, "02X").encode() + b"\n"
    helpers = pytest.importorskip("pynmeagps.nmeahelpers", reason="pynmeagps, another NMEA reader, is not installed")
    for line in (sentence(body), iver.line_of(IVER, iver.IverPoll()), IVER_SAMPLE):
        text = line.decode().strip()
        assert helpers.calc_checksum(text[1:-3]) == text[-2:]


def test_a_contact_cannot_be_named_as_a_command() -> None:
    with pytest.raises(ValueError, match="BPRMB means something else"):
        BluefinSettings(contact_sentence="BPRMB")
