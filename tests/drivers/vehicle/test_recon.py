"""RECON: an override is engaged, confirmed by the vehicle's mode, and ended whenever nobody wants it."""

from __future__ import annotations

import pytest
from msgspec import structs

from auv_mcm.settings.vehicle_settings import ReconSettings
from drivers.vehicle.dialect import Capability, Granted, ReportedState, Withheld
from drivers.vehicle.recon_sentences import frame
from tests.drivers.vehicle.vehicle_loop import REPORT, STEER, Loop, in_control, stamp_at
from tests.sim_replay.conversation import Conversation


def state(mode: int) -> bytes:
    return frame(f"S,T10:10:10.000,LAT48N7.5,LON5W39.2,D12.0,DG0,A5.0,P0,R0,TR0,TRG0,V1.5,H123.0,HR0,HG0,M{mode:X},l1")


def asked() -> Conversation:
    dialect = Conversation(ReconSettings())
    dialect.connected(0.0)
    dialect.request(0.0)
    return dialect


def test_an_override_counts_once_its_bits_say_enabled_and_active_in_a_mission() -> None:
    dialect = asked()
    assert dialect.take_outgoing(0.0)[:2] == [b"#Q,Depth,*EB\n", frame("E,1")]
    for mode in (0x01, 0x05, 0x09):
        assert [type(event) for event in dialect.hear(state(mode), stamp_at(0.1))] == [ReportedState]
    assert [type(event) for event in dialect.hear(state(0x0D), stamp_at(0.2))] == [Granted, ReportedState]
    assert [type(event) for event in dialect.hear(state(0x05), stamp_at(0.3))] == [Withheld, ReportedState]


@pytest.mark.parametrize("mode", [0x00, 0x02, 0x03, 0x0E, 0x11, 0x1D, 0x4D, 0x81, 0x8D])
def test_no_control_without_a_running_mission_that_allows_it_in_full(mode: int) -> None:
    for before in (0x01, 0x0D):
        dialect = asked()
        dialect.hear(state(before), stamp_at(0.1))
        withheld, _ = dialect.hear(state(mode), stamp_at(0.2))
        assert isinstance(withheld, Withheld)
        assert f"mode {mode:02X}" in withheld.reason
        dialect.command(STEER, 0.3)
        assert not any(line.startswith(b"#C") for line in dialect.take_outgoing(0.3))


def test_commands_are_three_goals_and_keep_the_connection_alive() -> None:
    loop = in_control("recon")
    n_sent = len(loop.sent)
    loop.run(1.0)
    assert [line for _, line in loop.sent[n_sent:]] == [
        b"#C,Heading,Goal,123.0,*67\n",
        frame("C,Depth,Depth,7.50"),
        frame("C,Speed,1.50 meters/sec"),
    ]


def test_an_override_that_nobody_asked_for_is_ended_once_a_second() -> None:
    dialect = Conversation(ReconSettings())
    dialect.connected(0.0)
    lines = []
    for i in range(30):
        dialect.hear(state(0x0D), stamp_at(0.1 * i))
        lines += dialect.take_outgoing(0.1 * i)
    assert lines.count(frame("E,0")) == 3
    assert not any(line.startswith(b"#C") for line in lines)


def test_the_end_of_an_override_is_sent_again_until_the_vehicle_shows_it() -> None:
    loop = in_control("recon")
    loop.dialect.release("done", loop.now_s)
    loop.lost = lambda line: line == frame("E,0")
    loop.run(2.5)
    assert loop.vehicle.in_control
    loop.lost = lambda line: False
    loop.run(1.5)
    assert not loop.vehicle.in_control


def test_a_payload_that_is_to_shut_down_has_no_control() -> None:
    loop = in_control("recon")
    assert loop.dialect.hear(frame("s,SHUTDOWN"), stamp_at(loop.now_s)) == [
        Withheld("the vehicle shuts down its payloads")
    ]


def test_a_decoder_that_is_not_connected_says_nothing() -> None:
    dialect = Conversation(ReconSettings(contact_type=""))
    assert Capability.CONTACT not in dialect.capabilities
    assert [type(event) for event in dialect.hear(state(0x0D), stamp_at(0.1))] == [ReportedState]
    dialect.report(REPORT, 1, 0.1)
    assert dialect.take_outgoing(0.2) == []


def test_contacts_leave_room_for_commands() -> None:
    loop = Loop("recon").run(1.0)
    for number in range(10):
        loop.dialect.report(structs.replace(REPORT, number=number), number, loop.now_s)
    loop.run(1.0)
    n_first = len(loop.vehicle.take_reports())
    assert 4 <= n_first <= 6
    loop.run(2.5)
    assert n_first + len(loop.vehicle.take_reports()) == 10
