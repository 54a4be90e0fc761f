"""The payload's end of the vehicle's CAN bus: no command without a grant that is alive, no report lost, and no frame
makes it fall over."""

from __future__ import annotations

import math
from collections import Counter
from itertools import count, pairwise

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from auv_mcm.records import NAN
from auv_mcm.settings.vehicle_settings import CanSettings
from drivers.links.can_frame import CanFrame
from drivers.navigation import n2k_messages as n2k
from drivers.vehicle.can_messages import (
    BY_NUMBER,
    COMMAND_VALID_S,
    DEMANDS,
    STATUS_PERIOD_S,
    VEHICLE_SILENT_S,
    GoToMessage,
    HealthText,
    PayloadStatus,
    Record,
    ReportAnswer,
    ReportMessage,
    StateMessage,
    SteerMessage,
    VehicleStatus,
    encode,
    number_and_address,
)
from drivers.vehicle.can_receiver import CanReceiver
from drivers.vehicle.can_translation import text_of
from drivers.vehicle.dialect import (
    Acknowledged,
    Command,
    Considered,
    GoTo,
    Granted,
    PayloadHealth,
    PlaceReached,
    Rejected,
    ReportedState,
    Steer,
    VehicleEvent,
    Vertical,
    Withheld,
)
from drivers.vehicle.talkers.can_talker import CanTalker
from tests.drivers.vehicle.can_traffic import at, records
from tests.make.records import report_of
from tests.sim_replay.conversation import Conversation

PAYLOAD, VEHICLE = 96, 32
PLACE = GoTo(54.0001, 10.0002, Vertical("altitude", 5.0), 1.5, 3.0)
OTHER_PLACE = PLACE._replace(latitude_deg=54.0003)
COURSE = Steer(1.25, Vertical("depth", 12.0), 1.5)
REPORT = report_of(number=1, p_mine=0.9, latitude_deg=54.0, longitude_deg=10.0)


class Bench:
    """Run a dialect, and collect what the vehicle's end of the bus hears."""

    def __init__(self, can_settings: CanSettings | None = None) -> None:
        self.dialect = Conversation(can_settings or CanSettings())
        self._receiver = CanReceiver("vehicle", "payload", PAYLOAD, Counter())
        self._counters = count(250)
        self._sequences = count()
        self.dialect.connected(0.0)

    def take(self, now_s: float) -> list[Record]:
        frames = self.dialect.take_outgoing(now_s)
        return [received.record for frame in frames if (received := self._receiver.add(frame, now_s)) is not None]

    def say(self, record: Record, now_s: float) -> list[VehicleEvent]:
        frames = encode(record, VEHICLE, next(self._sequences))
        return [event for frame in frames for event in self.dialect.hear(frame, at(now_s))]

    def status(
        self, grant: int, request_number: int, now_s: float, reason: int = 0, state: int = 0, command_number: int = 0
    ) -> list[VehicleEvent]:
        counter = next(self._counters) % 256
        return self.say(VehicleStatus(grant, reason, request_number, state, command_number, counter), now_s)

    def granted(self, now_s: float = 0.0) -> int:
        """Ask for control and get it; the number of the request."""
        self.status(0, 0, now_s)
        self.dialect.request(now_s)
        number = self.demand(now_s).request_number
        assert [type(event) for event in self.status(2, number, now_s)] == [Granted]
        return number

    def demand(self, now_s: float) -> PayloadStatus:
        return [record for record in self.take(now_s) if isinstance(record, PayloadStatus)][-1]


def commands_in(sent: list[Record]) -> list[Record]:
    return [record for record in sent if isinstance(record, GoToMessage | SteerMessage)]


def test_it_greets_with_a_release_sent_three_times() -> None:
    sent = [record for record in Bench().take(0.0) if isinstance(record, PayloadStatus)]
    assert [DEMANDS[status.demand] for status in sent] == ["release"] * 3
    assert len({status.counter for status in sent}) == 3


def test_its_status_is_a_sign_of_life() -> None:
    bench = Bench()
    bench.take(0.0)
    statuses = [
        record for tick in range(1, 101) for record in bench.take(0.1 * tick) if isinstance(record, PayloadStatus)
    ]
    assert len(statuses) in (19, 20)
    assert all((after.counter - before.counter) % 256 == 1 for before, after in pairwise(statuses))


def test_control_is_asked_for_with_a_number_that_the_vehicle_has_not_answered_before() -> None:
    bench = Bench()
    bench.status(0, 1, 0.0, reason=3)
    bench.dialect.request(0.0)
    status = bench.demand(0.0)
    assert DEMANDS[status.demand] == "request"
    assert status.request_number not in (0, 1)
    assert bench.status(0, 1, 0.1, reason=3) == [], "that is an answer to somebody before us"
    assert bench.status(1, status.request_number, 0.2) == [Considered()]
    assert [type(event) for event in bench.status(2, status.request_number, 0.3)] == [Granted]
    assert bench.status(2, status.request_number, 0.4) == [], "reported once"


def test_a_refusal_is_reported_and_the_next_request_has_another_number() -> None:
    bench = Bench()
    bench.dialect.request(0.0)
    number = bench.demand(0.0).request_number
    assert bench.status(0, number, 0.1, reason=1) == [Withheld("not willing")]
    assert bench.demand(0.1).demand == DEMANDS.index("release")
    bench.dialect.request(1.0)
    assert bench.demand(1.0).request_number != number


@pytest.mark.parametrize(("reason", "reported"), [(2, "taken back"), (8, "shutting down"), (200, "reason 200")])
def test_a_grant_that_is_taken_back_ends_commands_at_once(reason: int, reported: str) -> None:
    bench = Bench()
    number = bench.granted()
    bench.dialect.command(PLACE, 0.1)
    assert bench.status(0, number, 0.1, reason=reason) == [Withheld(reported)]
    assert commands_in(bench.take(0.1)) == []
    bench.dialect.command(PLACE, 0.2)
    assert commands_in(bench.take(0.2)) == []
    assert bench.dialect.counters["vehicle_can.commands_without_grant"] == 1


def test_a_grant_to_another_request_is_none() -> None:
    bench = Bench()
    number = bench.granted()
    assert [type(event) for event in bench.status(2, (number + 1) % 256, 0.1)] == [Withheld]


def test_a_grant_without_signs_of_life_ends() -> None:
    bench = Bench()
    bench.granted()
    bench.dialect.command(PLACE, VEHICLE_SILENT_S + 0.1)
    assert commands_in(bench.take(VEHICLE_SILENT_S + 0.1)) == []
    state = StateMessage(54.0, 1.0, 10.0, 1.5, 3.0, 0.0, 5.0, 0.0)
    assert [type(event) for event in bench.say(state, VEHICLE_SILENT_S + 0.2)] == [Withheld, ReportedState]


def test_a_gateway_that_repeats_its_last_frame_for_ever_is_no_sign_of_life() -> None:
    bench = Bench()
    number = bench.granted()
    [frame] = encode(VehicleStatus(2, 0, number, 0, 0, 100), VEHICLE)
    events = [event for tick in range(20) for event in bench.dialect.hear(frame, at(0.1 * tick))]
    assert [type(event) for event in events] == [Withheld]
    assert bench.dialect.counters["vehicle_can.refused.stale"] > 10


def test_a_late_grant_does_not_undo_what_was_sent_after_it() -> None:
    bench = Bench()
    bench.dialect.request(0.0)
    number = bench.demand(0.0).request_number
    [late] = encode(VehicleStatus(2, 0, number, 0, 0, 20), VEHICLE)
    [newer] = encode(VehicleStatus(0, 1, number, 0, 0, 21), VEHICLE)
    assert bench.dialect.hear(newer, at(0.1)) == [Withheld("not willing")]
    assert bench.dialect.hear(late, at(0.1)) == []
    bench.dialect.command(PLACE, 0.1)
    assert commands_in(bench.take(0.1)) == []


def test_a_command_names_its_grant_its_validity_and_whether_it_is_new() -> None:
    bench = Bench()
    number = bench.granted()
    numbers: list[int] = []
    given: tuple[Command, ...] = PLACE, PLACE, OTHER_PLACE, COURSE, COURSE
    for tick, command in enumerate(given):
        bench.dialect.command(command, 0.1 * tick)
        [sent] = commands_in(bench.take(0.1 * tick))
        assert isinstance(sent, GoToMessage | SteerMessage)
        assert sent.request_number == number
        assert sent.valid_s == pytest.approx(COMMAND_VALID_S)
        numbers.append(sent.command_number - numbers[0] if numbers else sent.command_number)
    assert numbers[1:] == [0, 1, 2, 2]


def test_a_command_is_sent_once_each_time_it_is_given() -> None:
    bench = Bench()
    bench.granted()
    bench.dialect.command(PLACE, 0.1)
    assert [len(commands_in(bench.take(0.1 + 0.1 * tick))) for tick in range(5)] == [1, 0, 0, 0, 0]


def test_the_command_given_last_is_the_one_that_is_sent() -> None:
    bench = Bench()
    bench.granted()
    bench.dialect.command(PLACE, 0.1)
    bench.dialect.command(COURSE, 0.1)
    assert [type(record) for record in commands_in(bench.take(0.1))] == [SteerMessage]


@pytest.mark.parametrize(
    "command", [PLACE._replace(latitude_deg=95.0), COURSE._replace(speed_mps=math.inf), PLACE._replace(speed_mps=-1.0)]
)
def test_a_command_that_cannot_be_sent_is_dropped(command: GoTo | Steer) -> None:
    bench = Bench()
    bench.granted()
    bench.dialect.command(command, 0.1)
    assert commands_in(bench.take(0.1)) == []
    assert bench.dialect.counters["vehicle_can.commands_unsayable"] == 1


def test_release_drops_the_command_and_is_sent_at_once() -> None:
    bench = Bench()
    bench.granted()
    bench.dialect.command(PLACE, 0.1)
    bench.dialect.release("service stops", 0.1)
    sent = bench.take(0.1)
    assert commands_in(sent) == []
    assert [record.demand for record in sent if isinstance(record, PayloadStatus)] == [DEMANDS.index("release")] * 3


def test_arrival_counts_for_the_command_given_last() -> None:
    bench = Bench()
    number = bench.granted()
    bench.dialect.command(PLACE, 0.1)
    [first] = commands_in(bench.take(0.1))
    assert isinstance(first, GoToMessage)
    bench.dialect.command(OTHER_PLACE, 0.2)
    assert bench.status(2, number, 0.2, state=2, command_number=first.command_number) == [], "that was the place before"
    arrived = [bench.status(2, number, 0.3, state=2, command_number=(first.command_number + 1) % 256) for _ in range(3)]
    assert arrived == [[PlaceReached()], [], []]


def test_a_refused_command_ends_the_grant() -> None:
    bench = Bench()
    number = bench.granted()
    bench.dialect.command(PLACE, 0.1)
    [sent] = commands_in(bench.take(0.1))
    assert isinstance(sent, GoToMessage)
    assert bench.status(2, number, 0.2, reason=6, state=3, command_number=sent.command_number) == [
        Withheld("command refused")
    ]


def test_a_report_is_sent_at_once_and_again_until_it_is_answered() -> None:
    bench = Bench()
    bench.take(0.0)
    bench.dialect.report(REPORT, 7, 1.0)
    times = [
        0.1 * tick
        for tick in range(10, 400)
        if any(isinstance(record, ReportMessage) for record in bench.take(0.1 * tick))
    ]
    assert times == pytest.approx([1.0, 2.0, 4.0, 8.0, 16.0, 24.0, 32.0], abs=0.11)
    crc = answer_crc(bench.dialect, 40.0)
    assert bench.say(ReportAnswer(7, crc ^ 1, 0), 40.0) == [], "an answer to another report with this ticket"
    assert bench.say(ReportAnswer(7, crc, 0), 40.0) == [Acknowledged(7)]
    assert bench.say(ReportAnswer(7, crc, 0), 40.0) == []
    assert not any(isinstance(record, ReportMessage) for tick in range(200) for record in bench.take(40.0 + 0.1 * tick))


def answer_crc(dialect: Conversation, now_s: float) -> int:
    """Lower half of the CRC of the next report that is sent."""
    for tick in range(200):
        frames = [
            frame
            for frame in dialect.take_outgoing(now_s + 0.1 * tick)
            if number_and_address(frame.can_id) == (0x04, PAYLOAD)
        ]
        if frames:
            return int.from_bytes(frames[-1].data[4:6], "little")
    raise AssertionError("no report was sent")


@pytest.mark.parametrize(("answer", "reported"), [(1, "not wanted"), (77, "answer 77")])
def test_a_refused_report_is_not_sent_again(answer: int, reported: str) -> None:
    bench = Bench()
    bench.dialect.report(REPORT, 7, 1.0)
    assert bench.say(ReportAnswer(7, answer_crc(bench.dialect, 1.0), answer), 1.0) == [Rejected(7, reported)]


def test_many_reports_go_out_one_after_the_other_the_new_ones_first() -> None:
    bench = Bench()
    for number in range(1, 31):
        bench.dialect.report(msgspec.structs.replace(REPORT, number=number), number, 0.0)
    sent: list[int] = []
    for tick in range(40):
        if tick == 15:
            bench.dialect.report(msgspec.structs.replace(REPORT, number=99), 99, 1.5)
        records_now = [record for record in bench.take(0.1 * tick) if isinstance(record, ReportMessage)]
        assert len(records_now) <= 1
        sent += [record.number for record in records_now]
    assert sent[:31] == [*range(1, 31), 99]


def test_a_report_takes_the_place_of_the_one_before_of_its_contact() -> None:
    bench = Bench()
    for revision in (1, 2):
        bench.dialect.report(msgspec.structs.replace(REPORT, revision=revision), revision, 0.0)
    sent = [record for tick in range(300) for record in bench.take(0.1 * tick) if isinstance(record, ReportMessage)]
    assert {(record.revision, record.ticket) for record in sent} == {(2, 2)}


def test_a_report_that_cannot_be_sent_is_rejected() -> None:
    bench = Bench()
    bench.dialect.report(msgspec.structs.replace(REPORT, latitude_deg=91.0), 7, 0.0)
    [event] = bench.status(0, 0, 0.0)
    assert isinstance(event, Rejected)
    assert event.ticket == 7
    assert "latitude_deg" in event.reason


def test_health_is_reported_when_it_changes_and_every_now_and_then() -> None:
    bench = Bench()
    bench.take(0.0)
    bench.dialect.report_health(PayloadHealth("fault", "sonar silent"), 0.1)
    sent = bench.take(0.1)
    assert [record.health for record in sent if isinstance(record, PayloadStatus)] == [2]
    assert [text_of(record) for record in sent if isinstance(record, HealthText)] == ["sonar silent"]
    later = [
        text_of(record) for tick in range(2, 300) for record in bench.take(0.1 * tick) if isinstance(record, HealthText)
    ]
    assert later == ["sonar silent"] * 2


def test_a_lost_wire_forgets_control_and_reports() -> None:
    bench = Bench()
    bench.granted()
    bench.dialect.command(PLACE, 0.1)
    bench.dialect.report(REPORT, 7, 0.1)
    bench.dialect.disconnected()
    assert bench.dialect.take_outgoing(0.1) == []
    bench.dialect.connected(0.2)
    bench.dialect.command(PLACE, 0.2)
    sent = bench.take(0.2)
    assert {type(record) for record in sent} == {PayloadStatus, HealthText}


def test_the_vehicles_state_is_reported_whole() -> None:
    state = StateMessage(54.0, 1.25, 10.0, 1.5, 3.5, -0.1, 5.25, 0.2)
    [event] = Bench().say(state, 2.0)
    assert isinstance(event, ReportedState)
    assert event.received == at(2.0)
    assert event[1:] == pytest.approx((54.0, 10.0, 1.25, -0.1, 0.2, 3.5, 5.25, 1.5))


def test_nmea_2000_units_can_report_the_vehicles_state() -> None:
    bench = Bench(CanSettings(nmea2000_addresses=(12,)))

    def reported(record: n2k.Record, now_s: float, source: int = 12) -> list[VehicleEvent]:
        pgn, data = n2k.encode(record)
        return bench.dialect.hear(CanFrame(n2k.can_id_of(n2k.Identifier(2, pgn, n2k.GLOBAL, source)), data), at(now_s))

    assert reported(n2k.Heading(NAN, 1.25, NAN, NAN, 0.0), 1.0) == []
    assert reported(n2k.WaterDepth(NAN, 5.25, 0.0, NAN), 1.1) == []
    assert reported(n2k.WaterDepth(NAN, 0.0, 0.0, NAN), 1.15) == [], "a bottom not found gives no altitude"
    assert reported(n2k.RapidPosition(114.0, 10.0), 1.15) == [], "impossible"
    assert reported(n2k.RapidPosition(54.0, 10.0), 1.2, source=13) == [], "a unit that was not named"
    [event] = reported(n2k.RapidPosition(54.0, 10.0), 1.2)
    assert isinstance(event, ReportedState)
    assert (event.heading_rad, event.altitude_m) == pytest.approx((1.25, 5.25))
    assert math.isnan(event.depth_m)
    [event] = reported(n2k.RapidPosition(54.0, 10.0), 2.05)
    assert isinstance(event, ReportedState)
    assert math.isnan(event.heading_rad), "too old by now"
    assert event.altitude_m == pytest.approx(5.25)
    [event] = bench.say(StateMessage(1.0, 1.0, 1.0, 1.0, 1.0, 0.0, 7.0, 0.0), 2.1)
    assert isinstance(event, ReportedState)
    reported_by_controller = {
        name for name, value in event._asdict().items() if isinstance(value, float) and not math.isnan(value)
    }
    assert reported_by_controller == {"depth_m"}, "one of both reports each quantity"


@given(
    st.lists(
        st.tuples(st.integers(0, 0x1FFFFFFF), st.binary(max_size=64), st.booleans())
        | records().map(lambda record: (record, 0, True)),
        max_size=40,
    )
)
def test_no_frames_raise(frames: list[tuple[int | Record, bytes | int, bool]]) -> None:
    for units in ((), (0, 12)):
        bench = Bench(CanSettings(nmea2000_addresses=units))
        for number, (what, data, extended) in enumerate(frames):
            if isinstance(what, int):
                assert isinstance(data, bytes)
                bench.dialect.hear(CanFrame(what, data, extended), at(0.05 * number))
            else:
                bench.say(what, 0.05 * number)
            bench.take(0.05 * number)


EVENTS = st.sampled_from(
    [
        "request",
        "release",
        "command",
        "steer",
        "report",
        "connected",
        "disconnected",
        "take",
        "take",
        "wait",
        "grant",
        "grant",
        "withhold",
        "foreign",
        "old",
        "state",
    ]
)


@settings(max_examples=300)
@given(st.booleans(), st.lists(st.tuples(EVENTS, st.floats(0.0, 2.0)), max_size=60))
def test_no_command_leaves_without_a_grant_that_is_alive(begins_granted: bool, events: list[tuple[str, float]]) -> None:
    """Beside the dialect an account of its own is kept: of the request that stands, and of the last status that granted
    it."""
    bench = Bench()
    now_s, counter, is_connected = 0.0, 0, True
    standing: int | None = None  # the number asked for and not given back, as heard on the bus
    granted_s = heard_s = -math.inf
    for kind, wait_s in [("request", 0.0), ("grant", 0.0)] * begins_granted + events:
        now_s += wait_s if kind == "wait" else 0.01
        match kind:
            case "request":
                bench.dialect.request(now_s)
            case "release":
                bench.dialect.release("", now_s)
                standing, granted_s = None, -math.inf
            case "command":
                bench.dialect.command(PLACE, now_s)
            case "steer":
                bench.dialect.command(COURSE, now_s)
            case "report":
                bench.dialect.report(REPORT, 1, now_s)
            case "connected" | "disconnected":
                is_connected = kind == "connected"
                standing, granted_s, heard_s = None, -math.inf, -math.inf
                bench.dialect.connected(now_s) if is_connected else bench.dialect.disconnected()
            case "grant" | "withhold" | "foreign" | "old":
                is_new = kind != "old" or now_s - heard_s > VEHICLE_SILENT_S
                counter += kind != "old"
                number = (standing or 0) + (kind == "foreign")
                grant = 0 if kind == "withhold" else 2
                bench.say(VehicleStatus(grant, 0, number % 256, 0, 0, (counter - 3 * (kind == "old")) % 256), now_s)
                heard_s = now_s if is_new else heard_s
                if kind in ("withhold", "foreign"):
                    granted_s = -math.inf
                elif is_new and standing is not None:
                    granted_s = now_s
            case "state":
                bench.say(StateMessage(54.0, 1.0, 10.0, 1.5, 3.0, 0.0, 5.0, 0.0), now_s)
        if kind != "wait":
            for record in bench.take(now_s):
                assert is_connected
                if isinstance(record, PayloadStatus):
                    standing = record.request_number if DEMANDS[record.demand] == "request" else None
                elif isinstance(record, GoToMessage | SteerMessage):
                    assert standing is not None
                    assert record.request_number == standing
                    assert now_s - granted_s <= VEHICLE_SILENT_S + 1e-6


def test_two_ends_of_a_bus_need_two_addresses() -> None:
    with pytest.raises(ValueError, match="give each a number of its own"):
        CanSettings(payload_address=32)


def test_statuses_come_often_enough_for_the_time_outs() -> None:
    assert STATUS_PERIOD_S * 3 < 2.0
    assert CanTalker.command_period_s * 4 < COMMAND_VALID_S
    assert BY_NUMBER[0x81].period_s * 4 < VEHICLE_SILENT_S
