"""Whatever happens on the wire and at both its ends, in any order: no vehicle is commanded against a person's will,
and once the trouble is over the payload commands again and the vehicle has every contact as it is known last."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from auv_mcm.clock import Stamp
from auv_mcm.settings.vehicle_settings import ImcSettings
from drivers.vehicle.dialect import Capability
from drivers.vehicle.pilot import Pilot
from drivers.vehicle.vehicles import VEHICLES, decoder_of, talker_of
from tests.drivers.vehicle.test_report_queue import contact
from tests.drivers.vehicle.wire_history import FLOOR_M, HOME_DEG, MIN_ALTITUDE_M, UTC_S, Voyage, settings_of
from tests.drivers.vehicle.wire_parser import Sent, commands_of

WIRE = ("lost", "doubled", "late", "in bytes", "damaged", "flooded")
EVENTS = (
    *WIRE,
    *("cut", "join", "payload restarts", "vehicle restarts", "clock steps", "revoke", "unwilling", "stop", "abort"),
    *("resume", "plan", "no plan", "contact"),
)
SLACK_S = 12.0  # a vehicle's word may be lost, and a Bluefin refuses a command 5 s after it was sent last


class Talk(Voyage):
    """Talk by a wire that does to each message what `fate` names."""

    def __init__(self, name: str) -> None:
        self.settings = ImcSettings(vehicle_id=0x1E, acknowledges=True) if name == "imc" else settings_of(name)
        self.fate, self.is_open, self.is_stopped = "", True, False
        self.n_starts = self.n_items = self.n_contacts = self.n_looked_at = 0
        self.vehicle_ahead_s = 0.0
        self.permitted_s = 1000.0
        self.held: list[Any] = []
        self.contacts: dict[int, Any] = {}
        self.reported: dict[int, float] = {}
        super().__init__(name, settings=self.settings, ask_again_s=2.0)

    def happen(self, event: str) -> None:
        vehicle = self.vehicle
        match event:
            case "cut" | "payload restarts" if self.is_open:
                self.is_open = False
                self.pilot.disconnected(self.now_s)
            case "join" if not self.is_open:
                self.is_open, self.held = True, []
                vehicle.connected(self.now_s)
                self.pilot.connected(self.now_s)
            case "vehicle restarts":
                vehicle.power_up(self.now_s)
                self.is_stopped = False  # it begins with its plan
            case "clock steps":
                self.vehicle_ahead_s += 3600.0
            case "revoke":
                vehicle.revoke(self.now_s)
            case "unwilling":
                vehicle.willing = False
            case "stop" | "abort" if self.name == "imc":
                (vehicle.stop_plan if event == "stop" else vehicle.abort)(self.now_s)
                self.is_stopped = True
            case "resume" if self.is_stopped:
                vehicle.start_plan(self.now_s)
                self.is_stopped = False
            case "plan":
                self.propose()
            case "no plan":
                self.pilot.propose((), self.now_s)
            case "contact":
                self.n_contacts += 1
                number = self.n_contacts % 2
                self.contacts[number] = contact(number, 0.5 + self.n_contacts / 100.0)
                self.pilot.report(self.contacts[number])
        self.fate = event if event in WIRE else self.fate
        if event == "payload restarts":
            self._start_anew()

    def _start_anew(self) -> None:
        self.n_starts += 1
        self.decoder = decoder_of(self.name, self.settings, "vehicle")
        self.talker = talker_of(self.name, self.settings, lambda n: self.n_starts)
        self.pilot = Pilot(self.talker, self.config, session=1)
        self.pilot.go_on(1, self.n_starts, {})
        for each in self.contacts.values():
            self.pilot.report(each)
        self.happen("join")
        self.propose()

    def pass_time(self, for_s: float) -> None:
        for step in range(round(for_s / 0.1)):
            depths = {"depth_m": self.depth_m, "altitude_m": self.floor_m - self.depth_m - 0.02 * (step % 2)}
            self.step(0.1, silent=not self.is_open, time_s=UTC_S + self.vehicle_ahead_s + self.now_s, **depths)
            self.look(self.commands[self.n_looked_at :])

    def look(self, commands: list[Sent]) -> None:
        vehicle, self.n_looked_at = self.vehicle, len(self.commands)
        may = {"iver": lambda: vehicle.mode != "M", "bluefin": lambda: vehicle._lets}
        if may.get(self.name, lambda: vehicle.in_control)():
            self.permitted_s = self.now_s
        assert not commands or (self.is_open and self.now_s - self.permitted_s < SLACK_S)
        assert all(sent.depth_m is None or sent.depth_m <= FLOOR_M - MIN_ALTITUDE_M for sent in commands)
        assert not (self.is_stopped and vehicle.in_control), "started against a person's will"
        assert self.pilot.health().startswith(f"vehicle={self.pilot.authority} ")
        self.reported |= {report.number: round(report.p_mine, 2) for report in vehicle.take_reports()}

    def _hear(self, items: Sequence[Any]) -> None:
        self.held, waiting = ([], [*self.held, *items]) if self.fate != "late" else (list(items), self.held)
        while waiting and self.is_open:
            item = waiting.pop(0)
            self.n_items += 1
            if self.fate == "lost" and self.n_items % 3:
                continue
            if self.fate == "damaged" and self.n_items % 2 and isinstance(item, bytes):
                item = item[: len(item) // 2]
            pieces = [item[at : at + 1] for at in range(len(item))] if self._is_in_bytes(item) else [item]
            n_times = {"doubled": 2, "flooded": 30}.get(self.fate, 1)
            stamp = Stamp(round(self.now_s * 1e9), round((UTC_S + self.now_s) * 1e9))
            for piece in pieces * n_times:
                self.pilot.hear(self.decoder.feed(piece, stamp), stamp)
                outgoing = self.pilot.take_outgoing(self.now_s)
                self.commands += commands_of(self.name, outgoing)
                waiting += [answer for each in outgoing for answer in self.vehicle.heard(each, self.now_s)]

    def _is_in_bytes(self, item: Any) -> bool:
        return self.fate == "in bytes" and isinstance(item, bytes)

    def recover(self) -> None:
        self.fate, self.vehicle.willing = "", True
        self.happen("join")
        self.happen("resume")
        n_before, until_s = self.vehicle.counters["vehicle.commands_accepted"], self.now_s + 90.0
        while self.vehicle.counters["vehicle.commands_accepted"] == n_before or not self.knows_contacts():
            assert self.now_s < until_s, self.pilot.health()
            self.place_deg = HOME_DEG
            self.propose()
            self.pass_time(1.0)

    def knows_contacts(self) -> bool:
        known = {number: round(each.p_mine, 2) for number, each in self.contacts.items()}
        return Capability.ACKNOWLEDGED not in self.talker.capabilities or self.reported == known


@pytest.mark.parametrize("name", sorted(VEHICLES))
@settings(max_examples=6, deadline=None)
@given(events=st.lists(st.sampled_from(EVENTS), max_size=8))
@example(events=["contact", "cut", "stop", "contact", "contact", "payload restarts", "plan"])
@example(events=["cut", "abort", "join", "contact", "unwilling", "lost"])
def test_trouble_in_any_order_does_no_harm_and_passes(name: str, events: list[str]) -> None:
    talk = Talk(name)
    talk.pass_time(5.0)
    for event in events:
        talk.happen(event)
        talk.pass_time(3.0)
    talk.recover()
