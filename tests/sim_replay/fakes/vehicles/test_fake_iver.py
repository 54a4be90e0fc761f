"""The fake Iver answers polls, and steers for as long as commands are valid."""

from __future__ import annotations

import math
from functools import reduce
from operator import xor

import pytest

from auv_mcm.records import NAN
from drivers.vehicle.dialect import Vertical
from sim_replay.fakes.vehicles.iver import FakeIver
from tests.make.records import nav_of

PLACE = {"latitude_deg": -8.5, "longitude_deg": 115.25, "depth_m": 3.048, "altitude_m": 6.096}
POSE = nav_of(36_610.0, heading_rad=math.radians(57.3), speed_mps=NAN, **PLACE)


def line(body: str) -> bytes:
    return b"$%b*%02X\r\n" % (body.encode(), reduce(xor, body.encode()))


def reported(vehicle: FakeIver, now_s: float) -> list[str]:
    return [answer.decode().split("*")[0] for answer in vehicle.heard(line("OSD,G,C,S,P,,,,"), now_s)]


def test_a_poll_is_answered_by_position_compass_and_state_with_depths_in_feet() -> None:
    vehicle = FakeIver()
    assert vehicle.heard(line("OSD,G,C,S,P,,,,"), 0.0) == []
    assert vehicle.tick(POSE, False, 0.1) == []
    position, compass, state = reported(vehicle, 0.2)
    assert position.startswith("$GPRMC,101010.000,A,0830.00000,S,11515.00000,E,")
    assert compass == "$C57.3P0.00R0.00T20.3D10.0"
    _, _, mode, _, *place, _, _, _, altitude_ft, _, _, _, _, heading_deg, depth_ft, _ = state.split(",")
    assert (mode, *place) == ("N", "-8.5000000", "115.2500000")
    assert (altitude_ft, heading_deg, depth_ft) == ("20.00", "57.3", "10.00")


def test_a_command_holds_for_the_time_that_it_carries_and_shows_in_the_mode() -> None:
    vehicle = FakeIver()
    vehicle.tick(POSE, False, 0.0)
    vehicle.heard(line("OMS,90.0,12.0,20.0,2.0,3"), 0.0)
    assert vehicle.command is not None
    assert vehicle.command.vertical == Vertical("depth", 12.0)
    assert vehicle.command.speed_mps == pytest.approx(2.0 * 1852.0 / 3600.0)
    assert reported(vehicle, 2.9)[2].split(",")[2] == "A"
    assert reported(vehicle, 3.1)[2].split(",")[2] == "N"
    assert vehicle.counters["vehicle.commands_expired"] == 1


def test_in_manual_mode_nothing_is_obeyed() -> None:
    vehicle = FakeIver()
    vehicle.tick(POSE, False, 0.0)
    vehicle.heard(line("OMS,90.0,12.0,20.0,2.0,3"), 0.0)
    vehicle.revoke(0.1)
    assert reported(vehicle, 0.2)[2].split(",")[2] == "M"
    vehicle.heard(line("OMS,90.0,12.0,20.0,2.0,3"), 0.3)
    assert not vehicle.in_control
    assert vehicle.counters["vehicle.commands_refused"] == 1


@pytest.mark.parametrize(
    "body",
    ["OMS,90.0,12.0,20.0,2.0", "OMS,90.0,12.0,50.0,2.0,3", "OMS,90.0,-3.0,20.0,2.0,3", "OMW,1", "PMCM,C,1,2", "X"],
)
def test_nonsense_is_counted(body: str) -> None:
    vehicle = FakeIver()
    assert vehicle.heard(line(body) + b"$OMS\xff*00\r\n", 0.0) == []
    assert vehicle.counters["vehicle.nonsense"] == 2
    assert vehicle.command is None
