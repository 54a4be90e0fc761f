"""The fake REMUS lets an override be engaged, flies its goals, and ends it when nothing keeps it alive."""

from __future__ import annotations

import math

import pytest

from auv_mcm.records import NAN
from drivers.vehicle.dialect import Steer, Vertical
from sim_replay.fakes.vehicles.recon import FakeRecon
from tests.make.records import nav_of

POSE = nav_of(36_610.0, latitude_deg=39.5, longitude_deg=-74.25, heading_rad=math.radians(359.98), altitude_m=NAN)
GOALS = ("C,Heading,Goal,90.0", "C,Depth,Depth,5.0", "C,Speed,1.5 meters/sec")


def frame(body: str) -> bytes:
    data = b"#%b,*" % body.encode()
    return data + b"%02X\n" % (sum(data) & 255)


def engaged() -> FakeRecon:
    vehicle = FakeRecon()
    for body in ("Q,Depth", "E,1"):
        assert vehicle.heard(frame(body), 0.0) == []
    assert vehicle.in_control
    return vehicle


def mode(vehicle: FakeRecon, now_s: float) -> str:
    [state] = vehicle.tick(POSE, False, now_s)
    return next(field for field in state.decode().split(",") if field.startswith("M"))


def test_its_state_is_sent_twice_a_second_in_a_frame_with_the_right_sum() -> None:
    vehicle = FakeRecon()
    [state] = vehicle.tick(POSE, False, 0.0)
    start = (
        b"#S,T10:10:10.000,LAT39N30.0000,LON74W15.0000,D10.00,DG0.00,A0.00,P0.0,R0.0,"
        b"TR1500,TRG1500,V1.50,H0.0,HR0.0,HG0.0,M1,l1,*"
    )
    assert state == start + b"%02X\n" % (sum(start) & 255)
    assert vehicle.tick(POSE, False, 0.3) == []
    assert len(vehicle.tick(POSE, False, 0.5)) == 1


def test_an_override_needs_a_question_before_and_a_vehicle_that_is_willing() -> None:
    vehicle = FakeRecon()
    vehicle.heard(frame("E,1"), 0.0)
    assert not vehicle.in_control
    vehicle.willing = False
    vehicle.heard(frame("Q,Depth") + frame("E,1"), 0.1)
    assert not vehicle.in_control
    assert mode(vehicle, 0.2) == "M81"
    assert mode(engaged(), 0.2) == "MD"


def test_goals_are_flown_once_all_are_there_and_only_in_an_override() -> None:
    vehicle = FakeRecon()
    vehicle.heard(b"".join(map(frame, GOALS)), 0.0)
    assert vehicle.counters["vehicle.commands_refused"] == 3
    vehicle = engaged()
    for body in GOALS:
        assert vehicle.command is None
        vehicle.heard(frame(body), 0.1)
    assert vehicle.command == Steer(math.radians(90.0), Vertical("depth", 5.0), 1.5)
    vehicle.heard(frame("E,0"), 0.2)
    assert vehicle.command is None
    assert not vehicle.in_control


def test_an_override_ends_with_its_goals_or_when_nothing_is_heard() -> None:
    for bodies, alive in (((), False), (GOALS, True)):
        vehicle = engaged()
        vehicle.heard(b"".join(map(frame, bodies)), 0.1)
        vehicle.heard(frame("V,fine") if alive else b"", 4.0)
        assert vehicle.in_control
        vehicle.tick(POSE, False, 5.5)
        assert not vehicle.in_control
        assert vehicle.counters["vehicle.commands_expired"] == 1


@pytest.mark.parametrize(
    "body", ["C,Speed,800 rpm", "C,Depth,Triangle,3,3,10,30", "C,Heading,Goal,east", "C", "X,1", "K,1,2", "E,7"]
)
def test_nonsense_is_counted(body: str) -> None:
    vehicle = engaged()
    assert vehicle.heard(frame(body) + b"#E,0,*00\n" + b"\xff\n", 0.0) == []
    assert vehicle.counters["vehicle.nonsense"] == 3
    assert vehicle.in_control
    assert vehicle.command is None
