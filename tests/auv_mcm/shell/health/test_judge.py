"""Each trouble is a state and a reason of the part that has it, and of no other."""

from __future__ import annotations

import math
from collections import Counter

import pytest

from auv_mcm.shell.health.judge import Measured, Process, Vehicle, judge
from auv_mcm.shell.health.record import REASONS, VALUES, State
from auv_mcm.source import QuantityState, SourceHealth
from tests.auv_mcm.shell.health.measurements import COMPUTER, LATER, NEVER, PORT, POSITION, WELL, part, record


def ports(*, state: str = "up", discarded_bytes: int = 0, ping_age_s: float = 0.3) -> SourceHealth:
    port = PORT._replace(state=state, discarded_bytes=discarded_bytes, ping_age_s=ping_age_s)  # type: ignore[arg-type]
    return SourceHealth((port,), (POSITION,))


TROUBLES: list[tuple[Measured, str, State, str]] = [
    (LATER._replace(is_ready=False), "service", "boot", "starting"),
    (LATER._replace(counters=Counter({"service.journal_failed": 1})), "service", "fault", "journal_failed"),
    (LATER._replace(counters=Counter({"service.early_journal_failed": 1})), "service", "fault", "journal_failed"),
    (LATER._replace(counters=Counter({"service.ping_dropped": 1})), "perception", "fault", "perception_behind"),
    (LATER._replace(queue_pings=257), "perception", "fault", "perception_behind"),
    (LATER._replace(pings=100), "perception", "fault", "perception_stalled"),
    (LATER._replace(counters=Counter({"service.work_shed": 1})), "perception", "degraded", "work_shed"),
    (LATER._replace(counters=Counter({"perception.restarted": 1})), "perception", "degraded", "perception_restarted"),
    (LATER._replace(has_kernels=False), "perception", "degraded", "no_kernels"),
    (LATER._replace(source=ports(state="down")), "port.sonar", "fault", "port_down"),
    (LATER._replace(source=ports(state="silent")), "port.sonar", "fault", "port_silent"),
    (LATER._replace(vehicle=Vehicle("vehicle=down", is_silent=True)), "vehicle", "degraded", "vehicle_silent"),
    (LATER._replace(source=ports(discarded_bytes=9)), "port.sonar", "degraded", "port_discards"),
    (LATER._replace(source=ports(ping_age_s=math.inf)), "port.sonar", "fault", "no_pings"),
    (
        LATER._replace(source=SourceHealth((PORT,), (POSITION._replace(served_by=""),))),
        "navigation.position",
        "fault",
        "position_lost",
    ),
    (
        LATER._replace(source=SourceHealth((PORT,), (POSITION, QuantityState("heading", "", 9.0)))),
        "navigation.heading",
        "degraded",
        "quantity_lost",
    ),
    (LATER._replace(counters=Counter({"session.bytes_lost": 1})), "recording", "degraded", "recording_incomplete"),
    (LATER._replace(computer=COMPUTER._replace(free_bytes=5e8)), "disk", "degraded", "disk_low"),
    (LATER._replace(computer=COMPUTER._replace(free_bytes=5e7)), "disk", "fault", "disk_full"),
    (LATER._replace(computer=COMPUTER._replace(temperature_c=90.0)), "computer", "degraded", "hot"),
]


@pytest.mark.parametrize(("now", "name", "state", "reason"), TROUBLES, ids=[trouble[3] for trouble in TROUBLES])
def test_a_trouble_is_a_state_and_a_reason_of_its_part_alone(
    now: Measured, name: str, state: State, reason: str
) -> None:
    found = part(name, now)
    assert (found.state, found.reasons) == (state, (reason,))
    others = {other.name: other.reasons for other in judge(now, WELL) if other.name != name}
    assert set(others.values()) == {()}
    assert record(now).state == state  # as the worst part; nothing is normal before perception is ready
    assert record(now).reasons == (f"{name}:{reason}",)


def test_every_reason_has_a_trouble_and_a_remedy() -> None:
    assert {trouble[3] for trouble in TROUBLES} == set(REASONS)
    assert [text for text in REASONS.values() if not any(mark in text for mark in ":;")] == []


def test_a_payload_that_is_well_is_normal_in_every_part() -> None:
    assert {part.state for part in judge(LATER, WELL)} == {"normal"}
    assert (record().state, record().reasons) == ("normal", ())
    assert {name for part in judge(LATER, WELL) for name in part.values} == set(VALUES)


def test_what_was_lost_before_the_period_is_no_reason_any_more() -> None:
    counted = Counter({"service.ping_dropped": 3, "service.work_shed": 2, "session.bytes_lost": 9})
    assert {part.state for part in judge(LATER._replace(counters=counted), WELL._replace(counters=counted))} == {
        "normal"
    }


def test_pings_may_take_as_long_as_sound_does_and_a_while_to_begin() -> None:
    far = LATER._replace(source=ports(ping_age_s=9.0))
    early = LATER._replace(uptime_s=9.0, source=ports(ping_age_s=math.inf))
    other = LATER._replace(source=ports(ping_age_s=math.nan))
    assert [part("port.sonar", now).reasons for now in (far, early, other)] == [()] * 3


def test_a_vehicle_may_take_a_while_to_speak() -> None:
    assert part("vehicle", LATER._replace(uptime_s=9.0, vehicle=Vehicle("vehicle=down", is_silent=True))).reasons == ()


def test_a_source_that_waits_on_purpose_is_neither_behind_nor_stalled() -> None:
    now = LATER._replace(waits_on_purpose=True, pings=100, queue_pings=512)
    assert part("perception", now).state == "normal"


def test_rates_are_those_of_the_period() -> None:
    perception, sonar = part("perception").values, part("port.sonar").values
    assert (perception["pings_hz"], perception["processor_share"]) == (10.0, 0.5)
    assert perception["delay_s"] == 0.5  # 5 pings wait, 10 a second
    assert sonar["received_bytes_hz"] == 1000.0


def test_what_is_not_known_is_absent() -> None:
    first = part("perception", WELL, WELL).values
    assert not {"pings_hz", "delay_s", "processor_share"} & set(first)
    restored = part("perception", LATER, WELL._replace(is_ready=False, pings=0)).values  # the pings before a power cut
    assert not {"pings_hz", "delay_s"} & set(restored)
    silent = LATER._replace(source=SourceHealth((PORT._replace(received_bytes=0, age_s=NEVER),), ()))
    assert "age_s" not in part("port.sonar", silent).values
    unknown = LATER._replace(computer=COMPUTER._replace(temperature_c=math.nan, free_bytes=math.nan))
    assert part("computer", unknown).values == part("disk", unknown).values == {}
    assert part("disk", unknown).state == part("computer", unknown).state == "normal"


def test_a_process_that_was_started_anew_has_no_share_yet() -> None:
    anew = LATER._replace(perception=Process(busy_s=0.1, memory_bytes=1e8))
    assert "processor_share" not in part("perception", anew).values
    assert "memory_bytes" not in part("perception", LATER._replace(perception=None)).values


def test_a_recorded_mission_has_neither_ports_nor_recording_nor_vehicle() -> None:
    now = LATER._replace(source=None, is_recording=False, vehicle=None)
    assert [part.name for part in judge(now, WELL)] == ["service", "perception", "disk", "computer"]
