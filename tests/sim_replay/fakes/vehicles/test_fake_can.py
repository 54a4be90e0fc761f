"""A made-up controller on a CAN bus: it grants, obeys and revokes control by the DBC file, and both ends agree over a
bad bus.
"""

from __future__ import annotations

import math
from typing import Final

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from auv_mcm.clock import Stamp
from auv_mcm.settings.vehicle_settings import CanSettings
from drivers.links.can_frame import CanFrame
from drivers.vehicle.can_messages import (
    COMMAND_VALID_S,
    DEMANDS,
    FIRST_COMMAND_S,
    PAYLOAD_SILENT_S,
    PayloadStatus,
    encode,
)
from drivers.vehicle.can_translation import command_message
from drivers.vehicle.dialect import Acknowledged, GoTo, Granted, ReportedState, Steer, VehicleEvent, Vertical, Withheld
from sim_replay.fakes.vehicles.can import FakeCan
from tests.make.records import nav_of, report_of
from tests.sim_replay.conversation import Conversation

PAYLOAD: Final = 96
STEP_S: Final = 0.1
PLACE = GoTo(54.0001, 10.0002, Vertical("altitude", 5.0), 1.5, 3.0)
HERE = {"latitude_deg": 54.0, "longitude_deg": 10.0, "depth_m": 7.0}
POSE = nav_of(1_700_000_000.0, **HERE, heading_rad=-0.5, pitch_rad=0.05, roll_rad=-0.1)
REPORT = report_of(number=1, p_mine=0.9, latitude_deg=54.0, longitude_deg=10.0)


class Loop:
    """A dialect and a fake vehicle on one bus, which loses, repeats and swaps frames with the given probability."""

    def __init__(self, p_fault: float = 0.0, seed: int = 0) -> None:
        self.dialect = Conversation(CanSettings())
        self.vehicle = FakeCan()
        self.events: list[VehicleEvent] = []
        self.now_s = 0.0
        self.arrived = False
        self.is_payload_alive = True
        self._p_fault = p_fault
        self._random = np.random.Generator(np.random.PCG64(seed))
        self.dialect.connected(0.0)

    def run(self, duration_s: float, command: GoTo | Steer | None = None) -> list[VehicleEvent]:
        """Return the dialect's output meanwhile, but for states. command: given every half second while it may be."""
        before = len(self.events)
        for _ in range(round(duration_s / STEP_S)):
            self.now_s += STEP_S
            if command is not None and round(self.now_s / STEP_S) % 5 == 0:
                self.dialect.command(command, self.now_s)
            to_vehicle = self.dialect.take_outgoing(self.now_s) if self.is_payload_alive else []
            to_payload = self.vehicle.tick(POSE, self.arrived, self.now_s)
            for frame in self._bus(to_vehicle):
                to_payload += self.vehicle.heard(frame, self.now_s)
            for frame in self._bus(to_payload):
                self.events += self.dialect.hear(frame, Stamp(round(1e9 * self.now_s), 0))
        return [event for event in self.events[before:] if not isinstance(event, ReportedState)]

    def _bus(self, frames: list[CanFrame]) -> list[CanFrame]:
        passed: list[CanFrame] = []
        for frame in frames:
            if self._random.random() >= self._p_fault:
                passed.append(frame)
                continue
            kind = self._random.integers(4)
            if kind == 0:
                passed += [frame, frame]
            elif kind == 1:
                passed.insert(max(len(passed) - 1, 0), frame)
            elif kind == 2:
                flipped = bytearray(frame.data)
                flipped[self._random.integers(8)] ^= 1 << int(self._random.integers(8))
                passed.append(frame._replace(data=bytes(flipped)))
        return passed

    def flown(self) -> GoTo | None:
        """PLACE, if that is what the vehicle goes to within the steps of the wire."""
        command = self.vehicle.command
        if not isinstance(command, GoTo) or command.vertical != PLACE.vertical:
            return None
        numbers = (command.latitude_deg, command.longitude_deg, command.speed_mps, command.radius_m)
        return (
            PLACE if numbers == pytest.approx((PLACE.latitude_deg, PLACE.longitude_deg, 1.5, 3.0), rel=1e-12) else None
        )

    def take_control(self) -> None:
        self.run(0.5)
        self.dialect.request(self.now_s)
        events = self.run(1.0)
        assert [type(event) for event in events] == [Granted]
        assert self.vehicle.in_control


@pytest.mark.parametrize(("command", "limit_s"), [(PLACE, COMMAND_VALID_S), (None, FIRST_COMMAND_S)])
def test_control_without_commands_ends_in_time(command: GoTo | None, limit_s: float) -> None:
    loop = Loop()
    loop.take_control()
    if command is not None:
        loop.run(2.0, command)
    loop.run(limit_s - 1.5)
    assert loop.vehicle.in_control
    assert loop.run(2.0) == [Withheld("command not repeated in time")]
    assert loop.vehicle.command is None


def test_a_payload_that_starts_again_ends_the_control_of_its_earlier_life() -> None:
    loop = Loop()
    loop.take_control()
    loop.run(2.0, PLACE)
    loop.dialect = Conversation(CanSettings())
    loop.dialect.connected(loop.now_s)
    assert loop.run(0.2) == []
    assert not loop.vehicle.in_control
    loop.take_control()


def test_a_frame_of_an_old_command_does_not_keep_it_alive() -> None:
    loop = Loop()
    loop.take_control()
    loop.dialect.command(PLACE, loop.now_s)
    frames = [frame for frame in loop.dialect.take_outgoing(loop.now_s) if frame.can_id >> 8 & 0xFF == 2]
    assert len(frames) == 4
    for _ in range(round((COMMAND_VALID_S + 0.5) / STEP_S)):
        for frame in frames:
            loop.vehicle.heard(frame, loop.now_s)
        loop.run(STEP_S)
    assert loop.vehicle.counters["vehicle.commands_accepted"] == 1
    assert not loop.vehicle.in_control


def test_commands_without_control_are_refused() -> None:
    vehicle = FakeCan()
    for frame in encode(command_message(PLACE, 3.0, 1, 0), PAYLOAD):
        vehicle.heard(frame, 0.0)
    assert vehicle.command is None
    assert vehicle.counters["vehicle.commands_refused"] == 1


def test_a_command_of_an_earlier_grant_is_refused() -> None:
    loop = Loop()
    loop.take_control()
    loop.dialect.command(PLACE, loop.now_s)
    late = loop.dialect.take_outgoing(loop.now_s)
    loop.dialect.release("", loop.now_s)
    loop.run(1.0)
    loop.take_control()
    for frame in late:
        loop.vehicle.heard(frame, loop.now_s)
    assert loop.vehicle.command is None
    assert loop.vehicle.counters["vehicle.commands_refused"] == 1


def test_a_command_that_leaves_something_open_is_refused_and_ends_control() -> None:
    loop = Loop()
    loop.take_control()
    assert loop.run(1.0, PLACE._replace(speed_mps=math.nan)) == [Withheld("command refused")]
    assert loop.vehicle.counters["vehicle.commands_refused"] == 1
    assert loop.vehicle.command is None


@pytest.mark.parametrize("seed", range(5))
def test_over_a_bad_bus_reports_arrive_once_and_control_works(seed: int) -> None:
    loop = Loop(p_fault=0.1, seed=seed)
    loop.run(1.0)
    loop.dialect.request(loop.now_s)
    assert [type(event) for event in loop.run(2.0)] == [Granted]
    for number in range(1, 21):
        loop.dialect.report(msgspec.structs.replace(REPORT, number=number), number, loop.now_s)
    events = loop.run(60.0, PLACE)
    assert sorted(event.ticket for event in events if isinstance(event, Acknowledged)) == list(range(1, 21))
    assert sorted(report.number for report in loop.vehicle.take_reports()) == list(range(1, 21))
    assert [event for event in events if isinstance(event, Withheld)] == []
    assert loop.vehicle.in_control
    assert loop.flown() == PLACE
    assert loop.vehicle.counters["vehicle.nonsense"] > 0


ACTIONS = st.sampled_from(
    [
        "request",
        "release",
        "command",
        "revoke",
        "power_up",
        "unwilling",
        "willing",
        "reconnect",
        "dead",
        "alive",
        "run",
        "run",
    ]
)


@settings(max_examples=25)
@given(
    st.lists(st.tuples(ACTIONS, st.sampled_from([0.1, 0.3, 1.2, 2.5])), max_size=12),
    st.integers(0, 1000),
    st.sampled_from([0.0, 0.2]),
)
def test_whatever_happens_both_ends_come_to_agree_and_control_can_be_granted_again(
    actions: list[tuple[str, float]], seed: int, p_fault: float
) -> None:
    loop = Loop(p_fault, seed)
    for action, duration_s in actions:
        match action:
            case "request":
                loop.dialect.request(loop.now_s)
            case "release":
                loop.dialect.release("", loop.now_s)
            case "revoke":
                loop.vehicle.revoke(loop.now_s)
            case "power_up":
                loop.vehicle.power_up(loop.now_s)
            case "unwilling" | "willing":
                loop.vehicle.willing = action == "willing"
            case "reconnect":
                loop.dialect.disconnected()
                loop.dialect.connected(loop.now_s)
            case "dead" | "alive":
                loop.is_payload_alive = action == "alive"
        loop.run(duration_s, PLACE if action == "command" else None)
    loop.is_payload_alive = loop.vehicle.willing = True
    loop._p_fault = 0.0
    loop.dialect.release("", loop.now_s)
    loop.run(PAYLOAD_SILENT_S + 1.0)
    assert not loop.vehicle.in_control
    loop.take_control()
    loop.run(1.0, PLACE)
    assert loop.flown() == PLACE


def test_nonsense_is_counted() -> None:
    vehicle = FakeCan()
    [frame] = encode(PayloadStatus(1, 1, DEMANDS.index("request"), 1, 1), PAYLOAD)
    assert vehicle.heard(frame._replace(data=bytes(8)), 0.0) == []
    vehicle.heard(frame._replace(can_id=0x09F80103), 0.0)
    assert vehicle.counters["vehicle.nonsense"] == 1
    vehicle.power_up(0.0)
    assert vehicle.counters["vehicle.nonsense"] == 1
