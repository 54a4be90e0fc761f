"""Bluefin's interface: one sentence at a time, said again three times, and control only as the vehicle's words have
it."""

from __future__ import annotations

import re

import pytest
from msgspec import structs

from auv_mcm.settings.vehicle_settings import BluefinSettings
from drivers.navigation.nmea0183 import sentence
from drivers.vehicle.dialect import Acknowledged, Granted, Rejected, ReportedState, VehicleEvent, Withheld
from drivers.vehicle.talkers.bluefin_talker import ATTEMPTS, RESEND_S
from tests.drivers.vehicle.vehicle_loop import REPORT, STEER, Loop, in_control, stamp_at
from tests.sim_replay.conversation import Conversation


def sent(dialect: Conversation, now_s: float) -> list[str]:
    return [line.decode().split("*")[0] for line in dialect.take_outgoing(now_s)]


def hear(dialect: Conversation, body: str, now_s: float) -> list[VehicleEvent]:
    return dialect.hear(sentence(body), stamp_at(now_s))


def answer(dialect: Conversation, line: str, now_s: float, status: int = 2, text: str = "") -> list[VehicleEvent]:
    name, of, *_ = line[1:].split(",")
    of = "" if name == "BPLOG" else of
    return hear(dialect, f"BFACK,101010.000,{name[2:]},{of},0,{status},,{text}", now_s)


def greeted(settings: BluefinSettings | None = None) -> Conversation:
    """After the greeting and the first heartbeat."""
    dialect = Conversation(settings or BluefinSettings())
    dialect.connected(0.0)
    while lines := sent(dialect, 0.0):
        answer(dialect, lines[0], 0.0)
    return dialect


def granted() -> Conversation:
    dialect = greeted()
    dialect.request(0.0)
    assert [type(event) for event in hear(dialect, "BFCTL,101010.000,1", 0.0)] == [Granted]
    while lines := sent(dialect, 0.0):
        answer(dialect, lines[0], 0.0)
    return dialect


def test_answers_are_asked_for_first_and_one_sentence_goes_at_a_time() -> None:
    dialect = Conversation(BluefinSettings())
    dialect.connected(0.0)
    assert sent(dialect, 0.0) == ["$BPLOG,ACK,ON"]
    assert sent(dialect, 0.1) == []
    answer(dialect, "$BPLOG,ACK,ON", 0.2)
    assert sent(dialect, 0.2) == ["$BPLOG,NVG,ON"]


def test_an_unanswered_sentence_is_sent_again_after_5_s_three_times_in_all_then_control_is_given_up() -> None:
    dialect = granted()
    dialect.report(REPORT, 7, 0.5)
    lines: list[tuple[float, str]] = []
    events: list[VehicleEvent] = []
    for i in range(5, 165):
        lines += [(0.1 * i, line) for line in sent(dialect, 0.1 * i)]
        events += hear(dialect, "BFNVR,101010.000,1.0,0.0,0.0", 0.1 * i)
    contacts = [(now_s, line) for now_s, line in lines if line.startswith("$BPMCM")]
    assert [now_s for now_s, _ in contacts] == pytest.approx([0.5, 5.5, 10.5], abs=0.11)
    assert len({line for _, line in contacts}) == 1 <= ATTEMPTS
    assert [type(event) for event in events] == [Withheld, Rejected]


def test_a_vehicle_that_has_fallen_silent_is_notified_that_control_ends_and_greeted_anew() -> None:
    loop = in_control("bluefin")
    loop.lost = lambda line: True
    n_sent = len(loop.sent)
    loop.run(6.0)
    assert any(line.startswith(b"$BPRCE") for _, line in loop.sent[n_sent:])
    loop.lost = lambda line: False
    loop.run(10.0)
    assert "silent" in loop.of(Withheld)[0].reason
    assert not loop.granted
    assert any(line.startswith(b"$BPLOG,ACK") for _, line in loop.sent[n_sent:])


def test_no_answer_to_one_kind_of_sentence_while_others_come_takes_control_away_and_contacts_with_it() -> None:
    loop = in_control("bluefin")
    loop.lost = lambda line: line.startswith(b"$BPMCM")
    loop.dialect.report(REPORT, 7, loop.now_s)
    loop.dialect.report(structs.replace(REPORT, number=18), 8, loop.now_s)
    loop.run(3.0 * RESEND_S + 1.0)
    assert "BPMCM, sent 3 times" in loop.of(Withheld)[0].reason
    assert [event.ticket for event in loop.of(Rejected)] == [7, 8]
    loop.lost = lambda line: False
    loop.run(3.0)
    assert not loop.vehicle.in_control
    assert loop.vehicle.counters["vehicle.reports"] == 0


def test_times_have_three_decimals_and_follow_the_clock_of_the_vehicle() -> None:
    dialect = granted()
    hear(dialect, "BFNVG,235959.900,4807.4,N,00539.2,W,1,6.50,12.34,275.3,1.5,-2.0,235959.900", 50.0)
    dialect.command(STEER, 50.5)
    lines = sent(dialect, 50.5)
    while new := [line for known in lines[-1:] for line in (answer(dialect, known, 50.5), sent(dialect, 50.5))[1]]:
        lines += new
    times = [line.split(",")[1] for line in lines]
    assert all(re.fullmatch(r"\d{6}\.\d{3}", time) for time in times)
    assert times[0] == "000000.400"
    assert len(set(times)) == len(times), "no two sentences share a time, so that answers identify them"


def test_a_command_is_sent_as_heading_depth_or_altitude_and_speed() -> None:
    loop = in_control("bluefin")
    [*_, (_, line)] = loop.commands()
    assert re.fullmatch(rb"\$BPRMB,\d{6}\.\d{3},123\.00,7\.50,0,1\.50,1,0\*[0-9A-F]{2}\r\n", line)


def test_an_old_command_is_never_sent_again() -> None:
    dialect = granted()
    dialect.command(STEER, 1.0)
    [first] = [line for line in sent(dialect, 1.0) if "RMB" in line]
    dialect.command(STEER._replace(speed_mps=2.0), 4.0)
    dialect.command(STEER._replace(speed_mps=1.0), 5.9)
    for second in range(1, 5):
        hear(dialect, "BFNVR,101010.000,1.0,0.0,0.0", 1.0 + second)
        assert not any("RMB" in line for line in sent(dialect, 1.0 + second))
    [again] = [line for line in sent(dialect, 6.1) if "RMB" in line]
    assert again != first
    assert ",1.00,1,0" in again


def test_a_command_waits_for_no_contact_but_the_one_under_way() -> None:
    dialect = granted()
    for number in range(1, 65):
        dialect.report(structs.replace(REPORT, number=number), number, 0.1)
    (under_way,) = sent(dialect, 0.1)
    dialect.command(STEER, 0.2)
    answer(dialect, under_way, 0.3)
    assert [line[:6] for line in (under_way, *sent(dialect, 0.3))] == ["$BPMCM", "$BPRMB"]


def test_what_waited_too_long_is_not_commanded_any_more() -> None:
    dialect = granted()
    dialect.report(REPORT, 7, 0.5)
    [contact] = [line for line in sent(dialect, 0.5) if "MCM" in line]
    dialect.command(STEER, 0.6)
    assert sent(dialect, 3.0) == []
    answer(dialect, contact, 3.0)
    assert not any("RMB" in line for line in sent(dialect, 3.0))


def test_release_is_sent_at_once_also_while_an_answer_is_awaited() -> None:
    loop = in_control("bluefin")
    loop.lost = lambda line: line.startswith(b"$BPMCM")
    loop.dialect.report(REPORT, 7, loop.now_s)
    loop.flush()
    loop.dialect.release("stop", loop.now_s)
    [line] = loop.dialect.take_outgoing(loop.now_s)
    assert line.startswith(b"$BPRCE,")
    loop.vehicle.heard(line, loop.now_s)
    assert not loop.vehicle.in_control
    assert loop.vehicle.counters["vehicle.elements_cancelled"] == 0


def test_what_the_payload_did_not_begin_it_does_not_end() -> None:
    dialect = granted()
    dialect.release("nothing was commanded", 1.0)
    assert not any("RCE" in line for line in sent(dialect, 1.0))
    loop = in_control("bluefin")
    loop.vehicle.revoke(loop.now_s)
    loop.run(1.0)
    loop.dialect.release("it was taken back", loop.now_s)
    loop.run(2.0)
    assert not any(line.startswith(b"$BPRCE") for _, line in loop.sent)


def test_once_the_vehicle_has_taken_control_back_the_end_of_control_is_not_sent_again() -> None:
    loop = in_control("bluefin")
    loop.lost = lambda line: line.startswith(b"$BPRCE")
    loop.dialect.release("stop", loop.now_s)
    loop.run(1.0)
    loop.vehicle.revoke(loop.now_s)
    loop.run(20.0)
    assert sum(line.startswith(b"$BPRCE") for _, line in loop.sent) == 1


@pytest.mark.parametrize(("status", "reported"), [(0, Rejected), (2, Acknowledged)])
def test_the_answer_to_a_contact_is_reported(status: int, reported: type) -> None:
    dialect = greeted()
    dialect.report(REPORT, 7, 0.5)
    [line] = sent(dialect, 0.5)
    assert hear(dialect, "BFACK,101010.000,MCM,000000.000,0,2,,", 0.6) == [], "an answer to another one"
    assert answer(dialect, line, 0.6, status=3) == [], "pending"
    events = answer(dialect, line, 0.9, status=status, text="no such")
    assert [type(event) for event in events] == [reported]
    assert isinstance(events[0], Acknowledged | Rejected)
    assert events[0].ticket == 7
    assert answer(dialect, line, 1.0, status=status) == [], "answered already"


def test_a_refused_command_is_reported_as_control_withheld() -> None:
    dialect = granted()
    dialect.command(STEER, 0.5)
    [line] = sent(dialect, 0.5)
    [event] = answer(dialect, line, 0.6, status=1, text="not while docking")
    assert isinstance(event, Withheld)
    assert "not while docking" in event.reason
    assert not any("RCE" in line for line in sent(dialect, 0.6)), "it took nothing that had to be ended"


@pytest.mark.parametrize(
    ("by", "grant", "end"),
    [
        ("BFCTL", "BFCTL,101010.000,1", "BFCTL,101010.000,0"),
        ("BFCTL", "BFCTL,101010.000,1", "BFMIS,101010.000,plan,Aborted"),
        ("BFCTL", "BFCTL,101010.000,1", "BFSHT,101010.000"),
        ("BFMIS", "BFMIS,101010.000,plan,Running", "BFMIS,101010.000,plan,Completed"),
        ("BFMSC", "BFMSC,101010.000,look again", "BFMBE,101010.000,d,1,2,survey"),
    ],
)
def test_control_begins_and_ends_by_the_words_that_the_settings_name(by: str, grant: str, end: str) -> None:
    words = {"BFCTL,101010.000,1", "BFMIS,101010.000,plan,Running", "BFMSC,101010.000,look again"}
    dialect = greeted(BluefinSettings(granted_by=by))  # type: ignore[arg-type]  # one of its literals
    dialect.request(0.0)
    for other in sorted(words - {grant}):
        assert hear(dialect, other, 0.1) == []
    assert [type(event) for event in hear(dialect, grant, 0.2)] == [Granted]
    assert hear(dialect, grant, 0.3) == [], "reported once"
    assert [type(event) for event in hear(dialect, end, 0.4)] == [Withheld]


def test_a_vehicle_that_withholds_control_is_not_commanded_because_its_mission_runs() -> None:
    dialect = greeted(BluefinSettings(granted_by="BFMIS"))
    dialect.request(0.0)
    assert [type(event) for event in hear(dialect, "BFMIS,101010.000,plan,Running", 0.1)] == [Granted]
    assert [type(event) for event in hear(dialect, "BFCTL,101010.000,0", 0.2)] == [Withheld]
    dialect.request(0.3)
    assert hear(dialect, "BFMIS,101010.000,plan,Running", 0.4) == []
    assert hear(dialect, "BFCTL,101010.000,1", 0.5) == []
    assert [type(event) for event in hear(dialect, "BFMIS,101010.000,plan,Running", 0.6)] == [Granted]


def test_a_vehicle_restarted_just_before_a_request_is_asked_for_its_position_again() -> None:
    loop = Loop("bluefin")
    loop.vehicle.willing = False
    loop.run(3.0)
    loop.vehicle.power_up(loop.now_s)
    loop.dialect.request(loop.now_s)
    loop.run(10.0)
    loop.events.clear()
    assert loop.run(1.0).of(ReportedState)


def test_a_grant_before_the_request_counts_once_it_is_asked_for() -> None:
    dialect = greeted()
    assert hear(dialect, "BFCTL,101010.000,1", 0.1) == []
    dialect.request(0.2)
    assert next(type(event) for event in hear(dialect, "BFNVR,101010.000,1.0,0.0,0.0", 0.3)) is Granted


def test_without_a_sentence_for_contacts_none_is_reported() -> None:
    dialect = greeted(BluefinSettings(contact_sentence=""))
    dialect.report(REPORT, 7, 0.5)
    assert sent(dialect, 0.5) == []


def test_a_contact_known_better_meanwhile_takes_the_place_of_the_one_that_waits() -> None:
    loop = Loop("bluefin").run(2.0)
    for revision in (1, 2, 3):
        loop.dialect.report(structs.replace(REPORT, revision=revision), revision, loop.now_s)
    loop.run(1.0)
    assert [report.revision for report in loop.vehicle.take_reports()] == [3]
    assert loop.of(Acknowledged) == [Acknowledged(3)]
