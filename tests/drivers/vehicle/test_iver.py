"""Iver Remote Helm: its mode decides, and silence gives control back."""

from __future__ import annotations

import pytest
from msgspec import structs

from auv_mcm.settings.vehicle_settings import IverSettings
from drivers.navigation.nmea0183 import sentence
from drivers.vehicle.dialect import Capability, Granted, ReportedState, Withheld
from tests.drivers.vehicle.vehicle_loop import REPORT, STEER, in_control, stamp_at
from tests.sim_replay.conversation import Conversation


def state(mode: str) -> bytes:
    return sentence(f"OSI,0,{mode},1,48.1,-5.2,3.0,50,N,20.0,0,0,survey,0,123.0,40.0,0")


@pytest.mark.parametrize("mode", ["S", "P", "M", "mP", "m", "?", "X"])
def test_no_control_in_modes_that_are_a_persons_or_not_known(mode: str) -> None:
    dialect = Conversation(IverSettings())
    dialect.connected(0.0)
    dialect.request(0.0)
    reported, where = dialect.hear(state(mode), stamp_at(0.1))
    assert isinstance(reported, Withheld)
    assert f"mode {mode[0]}" in reported.reason
    assert isinstance(where, ReportedState)
    assert [type(event) for event in dialect.hear(state("N"), stamp_at(0.2))] == [ReportedState], (
        "it has to be asked again"
    )


@pytest.mark.parametrize("mode", ["N", "A", "W"])
def test_control_in_modes_that_obey_and_only_when_asked_for(mode: str) -> None:
    dialect = Conversation(IverSettings())
    dialect.connected(0.0)
    assert [type(event) for event in dialect.hear(state(mode), stamp_at(0.1))] == [ReportedState]
    dialect.request(0.2)
    assert [type(event) for event in dialect.hear(state(mode), stamp_at(0.3))] == [Granted, ReportedState]
    assert [type(event) for event in dialect.hear(state("M"), stamp_at(0.4))] == [Withheld, ReportedState]


def test_it_is_polled_and_steered_for_as_long_as_its_settings_say() -> None:
    dialect = Conversation(
        IverSettings(poll_s=0.2, command_timeout_s=2, max_pitch_deg=15.0, remote_helm_version=4, contact_sentence="")
    )
    assert dialect.command_period_s == 0.5
    assert Capability.CONTACT not in dialect.capabilities
    dialect.connected(0.0)
    assert dialect.take_outgoing(0.0) == [b"$OSD,G,C,S,P,,,,*5F\r\n"]
    assert dialect.take_outgoing(0.1) == []
    dialect.request(0.1)
    dialect.hear(state("N"), stamp_at(0.1))
    dialect.take_outgoing(0.1)
    dialect.command(STEER, 0.15)
    dialect.report(REPORT, 1, 0.15)
    assert dialect.take_outgoing(0.15) == [sentence("OMS,123.0,24.6,15.0,2.9,2")]
    assert dialect.take_outgoing(0.31) == [b"$OSD,G,C,S,P,,,,*5F\r\n"], "a command is said once each time it is given"
    dialect.command(STEER, 0.32)
    dialect.release("done", 0.32)
    assert dialect.take_outgoing(0.33) == []


def test_release_says_nothing_and_the_vehicle_goes_on_by_itself_in_time() -> None:
    loop = in_control("iver")
    n_commands = len(loop.commands())
    loop.dialect.release("done", loop.now_s)
    loop.run(5.5)
    assert len(loop.commands()) == n_commands
    assert not any(line.startswith((b"$OMSTOP", b"$OMSTART", b"$OMW")) for _, line in loop.sent)
    assert loop.vehicle.counters["vehicle.commands_expired"] == 1
    assert loop.vehicle.command is None


def test_a_new_contact_does_not_wait_for_the_repetition_of_all_others() -> None:
    dialect = Conversation(IverSettings())
    n_sent = 0

    def numbers_sent(n_contacts: int) -> list[int]:
        nonlocal n_sent
        dialect.connected(0.25 * n_sent)
        for number in range(1, n_contacts + 1):
            dialect.report(structs.replace(REPORT, number=number), number, 0.25 * n_sent)
        lines = [line for n in range(n_contacts) for line in dialect.take_outgoing(0.25 * (n_sent + n + 1))]
        n_sent += n_contacts
        dialect.disconnected()
        return [int(line.split(b",")[3]) for line in lines if line.startswith(b"$PMCM,C")]

    assert numbers_sent(300) == list(range(1, 301))
    assert numbers_sent(301) == [301, *range(1, 301)]
