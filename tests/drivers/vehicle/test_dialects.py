"""Every vehicle obeys its dialect and is let go; dialects of sentences never raise, command unasked, or flood the
wire."""

from __future__ import annotations

import math
from collections import Counter
from typing import Any

import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from msgspec import structs

from drivers.navigation.nmea0183 import sentence
from drivers.vehicle.dialect import (
    Acknowledged,
    Capability,
    GoTo,
    PayloadHealth,
    PlaceReached,
    ReportedState,
    Steer,
    Vertical,
    WireCommand,
    Withheld,
)
from drivers.vehicle.recon_sentences import frame
from tests.drivers.vehicle.vehicle_loop import (
    COMMANDS,
    PAIRS,
    PLACE,
    POSE,
    REPORT,
    SPOKEN,
    STEER,
    Loop,
    dialogues,
    in_control,
    play,
    stamp_at,
    take_over,
)

BLUEFIN_LINES = [
    *(f"BFCTL,101010.00{i},1" for i in range(2)),
    "BFCTL,101011.000,0",
    *(
        f"BFACK,101010.000,{name},{of},0,{status},,text"
        for name in ("LOG", "STS", "BPRMB", "MCM")
        for of in ("", "221641.000")
        for status in "0123"
    ),
    "BFNVG,101010.000,4807.5,N,00539.2,W,1,5.0,12.0,123.0,1.0,2.0,101010.000",
    "BFNVR,101010.000,1.0,0.5,0.0",
    "BFMIS,101010.000,plan,Running",
    "BFMIS,101010.000,plan,Completed",
    "BFMSC,101010.000,look",
    "BFSHT,101010.000",
    "BFMBE,101010.000,d,1,2,survey",
    "BPLOG,ACK,ON",
    "BPRCE,101010.000,0",
]
IVER_LINES = [
    *(
        f"OSI,0,{mode},1,48.1,-5.2,3.0,50,N,20.0,0,0,m,0,123.0,40.0,0"
        for mode in ("N", "A", "W", "S", "P", "M", "mP", "?")
    ),
    "C82.8P-3.89R-2.63T20.3D3.2",
    "GPRMC,101010.000,A,4807.5,N,00539.2,W,3.0,123.0,010120,,",
    "OMS,90.0,5.0,20.0,3.0,5",
]
RECON_LINES = [
    *(
        f"S,T10:10:10.000,LAT48N7.5,LON5W39.2,D12.0,DG0,A5.0,P0,R0,TR0,TRG0,V1.5,H123.0,HR0,HG0,M{mode},l1"
        for mode in ("1", "D", "5", "9", "0", "3", "81", "11", "4D")
    ),
    "s,SHUTDOWN",
    "E,1",
]
LINES = {
    "bluefin": [sentence(body) for body in BLUEFIN_LINES],
    "iver": [sentence(body) for body in IVER_LINES],
    "recon": [frame(body) for body in RECON_LINES],
}
POSITION_DEG = {"recon": 1e-6}  # what a wire resolves, 1e-8 elsewhere
QUANTITY = {"can": 1e-4, "imc": 1e-6}  # in radians, m and m/s; 0.01 of sentences
every_dialect = pytest.mark.parametrize("name", SPOKEN)
every_vehicle = pytest.mark.parametrize("name", PAIRS)


@every_dialect
@settings(max_examples=100)
@given(data=st.data())
def test_no_order_of_events_raises_or_makes_a_command_leave_without_control(name: str, data: st.DataObject) -> None:
    dialect = PAIRS[name][0]()
    sent, _ = play(dialect, data.draw(dialogues(LINES[name])))
    assert all(granted for granted, line in sent if line.startswith(COMMANDS))


@every_dialect
def test_the_orders_of_events_do_see_commands(name: str) -> None:
    sent, _ = play(PAIRS[name][0](), [*take_over(LINES[name]), ("command", None)])
    assert {granted for granted, line in sent if line.startswith(COMMANDS)} == {True}


@every_dialect
@settings(max_examples=30)
@given(chunks=st.lists(st.binary(max_size=300), max_size=8))
def test_random_bytes_are_nothing_and_raise_nothing(name: str, chunks: list[bytes]) -> None:
    dialect, vehicle = PAIRS[name][0](), PAIRS[name][1]()
    dialect.connected(0.0)
    dialect.request(0.0)
    for i, chunk in enumerate(chunks):
        assert dialect.hear(chunk, stamp_at(0.1 * i)) == []
        vehicle.heard(chunk, 0.1 * i)
    assert not any(line.startswith(COMMANDS) for line in dialect.take_outgoing(1.0))
    assert not vehicle.in_control


@every_dialect
@settings(max_examples=8, phases=[Phase.generate])
@given(lost=st.lists(st.booleans(), min_size=1, max_size=16))
def test_a_lossy_wire_is_not_flooded_and_never_deadlocks(name: str, lost: list[bool]) -> None:
    fates = iter(lost)
    loop = Loop(name, lambda line: next(fates, False))
    loop.steer = STEER
    loop.dialect.request(loop.now_s)
    for _ in range(3):
        loop.dialect.report(REPORT, 9, loop.now_s)
        loop.run(12.0)
        loop.dialect.request(loop.now_s)
    for _ in range(8):  # the loss of an answer costs a Bluefin 5 s
        loop.dialect.request(loop.now_s)
        loop.run(10.0)
    assert loop.granted, "once the wire is good again control is granted"
    assert loop.vehicle.in_control
    per_second = Counter(int(now_s) for now_s, _ in loop.sent)
    assert max(per_second.values()) < 25
    assert loop.vehicle.counters["vehicle.reports"] <= 1


@every_vehicle
def test_the_vehicle_flies_what_is_commanded_and_its_own_plan_after_release(name: str) -> None:
    loop = in_control(name)
    flown = loop.vehicle.command
    assert flown is not None
    if isinstance(flown, GoTo):
        assert flown[:2] == pytest.approx(PLACE[:2], abs=1e-12)
    else:
        assert flown.heading_rad == pytest.approx(STEER.heading_rad, abs=1e-3)
    assert flown.vertical.value_m == pytest.approx(7.5, abs=0.05)
    assert flown.speed_mps == pytest.approx(1.5, abs=0.03)
    counters = loop.vehicle.counters
    assert counters["vehicle.commands_accepted"] >= 3
    assert counters["vehicle.commands_refused"] == counters["vehicle.nonsense"] == 0
    n_sent = len(loop.commands())
    loop.dialect.release("the plan is complete", loop.now_s)
    loop.run(6.0)
    assert not loop.vehicle.in_control
    assert loop.vehicle.command is None
    late = [line for _, line in loop.commands()[n_sent:]]
    assert name == "recon" or late == []
    assert name != "recon" or [line for line in late if not line.startswith(b"#C,X")] == []


@pytest.mark.parametrize("name", ["can", "imc"])
def test_the_vehicle_says_when_it_is_where_it_was_sent(name: str) -> None:
    loop = in_control(name)
    loop.steer = PLACE
    loop.run(2.0)
    assert loop.of(PlaceReached) == []
    loop.arrived, loop.pose = True, structs.replace(POSE, latitude_deg=PLACE.latitude_deg)
    loop.run(2.0)
    assert loop.of(PlaceReached) == [PlaceReached()]


@every_vehicle
def test_control_that_is_taken_back_stops_all_commands_and_is_granted_again_when_asked_for(name: str) -> None:
    loop = in_control(name)
    loop.vehicle.revoke(loop.now_s)
    loop.run(2.0)
    assert not loop.granted
    assert isinstance(loop.of(Withheld)[-1].reason, str)
    n_sent = len(loop.commands())
    loop.run(15.0)
    assert len(loop.commands()) == n_sent
    assert loop.vehicle.counters["vehicle.elements_cancelled"] == 0
    loop.dialect.request(loop.now_s)
    loop.run(3.0)
    assert loop.granted
    assert loop.vehicle.in_control


@every_vehicle
def test_a_vehicle_that_is_not_willing_is_not_commanded(name: str) -> None:
    loop = Loop(name)
    loop.vehicle.willing = False
    loop.run(1.0)
    loop.dialect.request(loop.now_s)
    loop.steer = STEER
    loop.run(15.0)
    assert not loop.granted
    assert loop.commands() == []
    assert loop.vehicle.command is None
    reasons = {"can": "not willing", "imc": "plan refused: the payload may not command now"}
    if name in reasons:
        assert [each.reason for each in loop.of(Withheld)] == [reasons[name]]
        loop.vehicle.willing = True
        assert not loop.run(3.0).granted, "that request is over"


def test_a_vehicle_by_imc_says_that_it_was_left_without_a_reference() -> None:
    loop = in_control("imc")
    loop.steer = None
    loop.run(6.0)
    assert loop.of(Withheld) == [Withheld("the vehicle received no reference in time")]
    assert not loop.vehicle.in_control


@every_vehicle
def test_a_payload_that_dies_is_let_go_by_the_vehicle(name: str) -> None:
    loop = in_control(name)
    for _ in range(80):
        loop.now_s += 0.1
        loop.vehicle.tick(structs.replace(POSE, time_s=POSE.time_s + loop.now_s), False, loop.now_s)
    assert not loop.vehicle.in_control
    assert loop.vehicle.counters["vehicle.commands_expired"] == 1


@every_vehicle
def test_after_a_reboot_of_the_vehicle_all_goes_on_when_asked_again(name: str) -> None:
    loop = in_control(name)
    loop.vehicle.power_up(loop.now_s)
    loop.run(25.0)
    loop.dialect.request(loop.now_s)
    loop.run(12.0)
    assert loop.granted
    assert loop.vehicle.in_control
    assert loop.of(ReportedState)[-1].received.mono_ns > (loop.now_s - 2.0) * 1e9


@every_vehicle
def test_a_contact_is_reported_within_a_second_also_in_control(name: str) -> None:
    loop = in_control(name)
    loop.dialect.report(REPORT, 5, loop.now_s)
    loop.run(0.5)
    (report,) = loop.vehicle.take_reports()
    assert report == REPORT or name not in SPOKEN
    assert Acknowledged(5) in loop.events or name in ("iver", "recon")  # which acknowledge nothing
    assert (report.number, report.revision, report.classification) == (17, 2, REPORT.classification)
    assert report.belief == pytest.approx(REPORT.belief, abs=0.01)


@every_vehicle
def test_a_change_of_health_does_not_wait_for_the_next_repetition(name: str) -> None:
    """The service ends half a second after it has reported that it does."""
    loop = in_control(name)
    for health, said in (
        (PayloadHealth("fault", "it is being stopped"), "it is being stopped"),
        (PayloadHealth("failure", "no sonar, *no* pings"), "failure no sonar   no  pings"),
    ):
        said = said if name in SPOKEN else f"{health.state}: {health.text}"
        loop.dialect.report_health(health, loop.now_s)
        loop.run(0.2)
        assert said in loop.vehicle.take_health()[-1]


@every_vehicle
def test_the_vehicle_reports_where_it_is(name: str) -> None:
    state = Loop(name).run(3.0).of(ReportedState)[-1]
    near_deg = POSITION_DEG.get(name, 1e-8)
    assert state.latitude_deg == pytest.approx(POSE.latitude_deg, abs=near_deg)
    assert state.longitude_deg == pytest.approx(POSE.longitude_deg, abs=near_deg)
    for quantity in ("heading_rad", "pitch_rad", "roll_rad", "depth_m", "altitude_m", "speed_mps"):
        assert getattr(state, quantity) == pytest.approx(getattr(POSE, quantity), abs=QUANTITY.get(name, 0.01)), (
            quantity
        )


@every_dialect
def test_commands_that_cannot_be_sent_are_counted_and_not_sent(name: str) -> None:
    loop = Loop(name).run(2.0)
    loop.dialect.command(STEER, loop.now_s)
    assert loop.dialect.counters[f"{name}.command_without_grant"] == 1
    loop = in_control(name)
    n_sent, loop.steer = len(loop.commands()), None
    unfit: list[Any] = [STEER._replace(speed_mps=math.nan), STEER._replace(vertical=Vertical("depth", math.inf))]
    for command in (*unfit, GoTo(48.0, -5.0, Vertical("depth", 5.0), 1.5, 3.0)):
        loop.dialect.command(command, loop.now_s)
    loop.flush()
    assert len(loop.commands()) == n_sent
    assert loop.dialect.counters[f"{name}.command_unfit"] == 3


def test_a_bluefin_flies_altitudes() -> None:
    loop = in_control("bluefin")
    loop.steer = Steer(1.0, Vertical("altitude", 5.0), 1.5)
    loop.run(2.0)
    assert loop.vehicle.command is not None
    assert loop.vehicle.command.vertical == Vertical("altitude", 5.0)


@pytest.mark.parametrize("name", ["iver", "recon"])
def test_a_vehicle_that_holds_depths_alone_is_sent_no_altitude(name: str) -> None:
    loop = in_control(name)
    n_sent, loop.steer = len(loop.commands()), Steer(1.0, Vertical("altitude", 5.0), 1.5)
    loop.run(1.1)
    assert Capability.DEPTHS_ALONE in loop.dialect.capabilities
    assert len(loop.commands()) == n_sent
    assert loop.dialect.counters[f"{name}.command_without_floor"] == 1


@every_dialect
def test_depths_and_speeds_go_out_no_deeper_and_no_faster_than_commanded(name: str) -> None:
    loop = in_control(name)
    for depth_m, speed_mps in ((7.1234567, 1.2345678), (7.05, 0.5144), (0.04, 2.999999)):
        loop.steer = Steer(1.0, Vertical("depth", depth_m), speed_mps)
        loop.run(2.0)
        flown = loop.vehicle.command
        assert flown is not None
        assert depth_m - 0.1 <= flown.vertical.value_m <= depth_m + 1e-9
        assert speed_mps - 0.06 <= flown.speed_mps <= speed_mps + 1e-9


@every_dialect
def test_all_that_a_dialect_sends_is_read_back_and_commands_are_known_for_such(name: str) -> None:
    loop = in_control(name)
    loop.dialect.report(REPORT, 5, loop.now_s)
    loop.dialect.report_health(PayloadHealth("failure", "no sonar, *no* pings"), loop.now_s)
    loop.run(3.0)
    loop.dialect.release("done", loop.now_s)
    loop.run(6.0)
    lines = [line for _, line in loop.sent]
    read = loop.dialect.commands_in(lines)
    assert [number is not None for number in read] == [line.startswith(COMMANDS) for line in lines]
    assert WireCommand() not in read
    assert {number.vertical for number in read if number is not None} - {None} == {Vertical("depth", 7.5)}


@every_dialect
@pytest.mark.parametrize("line", [b"", b"\x00", b"$OMSTOP*00\r\n", b"$BPRMB*00\r\n", b"#C,Depth,Depth,x,*00\n"])
def test_a_line_that_cannot_be_read_counts_as_a_command(name: str, line: bytes) -> None:
    two_in_one = sentence("OSD,G,C,S,P,,,,") + sentence("OMS,123.0,99.0,15.0,2.9,2")
    assert PAIRS[name][0]().commands_in([line, two_in_one]) == [WireCommand(), WireCommand()]
