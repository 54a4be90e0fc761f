"""The fake Bluefin holds a payload to its interface."""

from __future__ import annotations

import math
from functools import reduce
from operator import xor

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.vehicle.dialect import Steer, Vertical
from sim_replay.fakes.vehicles.bluefin import FakeBluefin
from tests.make.records import nav_of

POSE = nav_of(36_610.0, latitude_deg=-8.5, longitude_deg=115.25, heading_rad=1.0)
CONTACT = "1,17,1,0.125,0830.000000,S,11515.000000,E,1.0,,sphere,0.5,0,0.5,0,0,0.25,0.25,1,,,,,,"


def line(body: str) -> bytes:
    return b"$%b*%02X\r\n" % (body.encode(), reduce(xor, body.encode()))


def listening(now_s: float = 0.0) -> FakeBluefin:
    """It answers, reports all, and lets the payload command."""
    vehicle = FakeBluefin()
    vehicle.tick(POSE, False, now_s)
    for name in ("ACK", "NVG", "NVR", "CTL"):
        vehicle.heard(line(f"BPLOG,{name},ON"), now_s)
    vehicle.heard(line("BPSTS,101010.000,1,fine"), now_s)
    assert b"BFCTL,101010.000,1" in b"".join(vehicle.tick(POSE, False, now_s))
    return vehicle


def test_nothing_is_sent_or_answered_before_it_is_requested() -> None:
    vehicle = FakeBluefin()
    assert vehicle.tick(POSE, False, 0.0) == []
    assert vehicle.heard(line("BPSTS,101010.000,1,fine"), 0.1) == []
    assert vehicle.heard(line("BPLOG,ACK,ON"), 0.2) == [line("BFACK,101010.000,LOG,,0,2,,")]
    assert vehicle.heard(line("BPSTS,101010.000,1,fine"), 0.3) == [line("BFACK,101010.000,STS,101010.000,0,2,,")]
    vehicle.heard(line("BPLOG,NVG,ON"), 0.4)
    [reported] = vehicle.tick(POSE, False, 0.5)
    assert reported == line("BFNVG,101010.000,0830.00000,S,11515.00000,E,1,5.00,10.00,57.3,0.0,0.0,101010.000")


def test_a_command_in_control_is_flown_until_it_is_old_cancelled_or_taken_back() -> None:
    for end in ("wait", "cancel", "revoke"):
        vehicle = listening()
        assert b",0,2,," in vehicle.heard(line("BPRMB,101010.000,90.0,5.0,1,1.5,1,0"), 0.1)[0]
        assert vehicle.command == Steer(math.radians(90.0), Vertical("altitude", 5.0), 1.5)
        if end == "cancel":
            vehicle.heard(line("BPRCE,101010.000,0"), 0.2)
        elif end == "revoke":
            vehicle.revoke(0.2)
            assert b"BFCTL,101010.000,0" in b"".join(vehicle.tick(POSE, False, 0.3))
        vehicle.tick(POSE, False, 5.0 if end == "wait" else 0.4)
        assert vehicle.in_control is (end == "wait")
        vehicle.tick(POSE, False, 5.3)
        assert not vehicle.in_control
        assert vehicle.counters["vehicle.commands_expired"] == (end == "wait")


def test_a_command_without_control_is_refused() -> None:
    vehicle = listening()
    vehicle.willing = False
    vehicle.tick(POSE, False, 0.1)
    assert (
        b",0,1,,the payload does not have control" in vehicle.heard(line("BPRMB,101010.000,90.0,5.0,0,1.5,1,0"), 0.2)[0]
    )
    assert not vehicle.in_control
    assert vehicle.counters["vehicle.commands_refused"] == 1


@pytest.mark.parametrize(
    "body",
    [
        "BPRMB,101010.00,90.0,5.0,0,1.5,1,0",
        "BPRMB,101010.000,360.0,5.0,0,1.5,1,0",
        "BPRMB,101010.000,90.0,5.0,2,1.5,1,0",
        "BPRMB,101010.000,90.0,5.0,0,1500,0,0",
        "BPRMB,101010.000,90.0,nan,0,1.5,1,0",
        "BPRMB,101010.000,90.0",
        "BPXYZ,101010.000",
        "BPMCM,101010.000,1,2,3",
    ],
)
def test_what_is_invalid_is_answered_so(body: str) -> None:
    vehicle = listening()
    assert b",0,0,," in vehicle.heard(line(body), 0.1)[0]
    assert not vehicle.in_control


def test_a_contact_is_taken_once() -> None:
    vehicle = listening()
    for _ in range(2):
        assert b",0,2,," in vehicle.heard(line(f"BPMCM,101010.000,{CONTACT}"), 0.1)[0]
    [report] = vehicle.take_reports()
    assert (report.session, report.number, report.revision, report.classification) == (1, 17, 1, "sphere")
    assert (report.latitude_deg, report.longitude_deg) == (-8.5, 115.25)
    assert report.belief["sphere"] == 0.5
    assert math.isnan(report.length_m)
    assert dict(vehicle.counters) == {"vehicle.reports": 1, "vehicle.reports_repeated": 1}


def test_after_power_up_it_has_forgotten_what_it_was_asked_for() -> None:
    vehicle = listening()
    vehicle.power_up(1.0)
    assert vehicle.tick(POSE, False, 1.1) == []


@settings(max_examples=50)
@given(
    chunks=st.lists(
        st.one_of(st.binary(max_size=40), st.text("$BPRMB,*0123456789.\r\n", max_size=40).map(str.encode)), max_size=10
    )
)
def test_nonsense_raises_nothing(chunks: list[bytes]) -> None:
    vehicle = listening()
    for chunk in chunks:
        vehicle.heard(chunk, 0.1)
    vehicle.heard(b"\n", 0.2)
    assert not vehicle.in_control
