"""Whatever happens in whatever order: no command without leave, out of the fence, too low, or too late; and never a
dead end.

A witness judges commands from the history alone; it shares nothing with the pilot but the interface.
"""

from __future__ import annotations

import math
from typing import Final

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from auv_mcm.records import NAN
from auv_mcm.settings.vehicle_settings import VehicleConfig
from drivers.navigation.corrections import moved, offset_m
from drivers.vehicle.dialect import (
    Acknowledged,
    Capability,
    Command,
    GoTo,
    Granted,
    PlaceReached,
    Rejected,
    ReportedState,
    VehicleEvent,
    Withheld,
)
from drivers.vehicle.pilot import Pilot
from tests.drivers.vehicle.vehicle_on_paper import GOES_BY_ITSELF, IS_STEERED, PaperTalker, calls, stamp
from tests.make.records import waypoint_of

HOME_DEG: Final = (54.0, 8.0)
# An L: the way from arm to arm leads through the outside.
CORNERS_M: Final = ((0.0, 0.0), (200.0, 0.0), (200.0, 80.0), (80.0, 80.0), (80.0, 200.0), (0.0, 200.0))
MARGIN_M: Final = 5.0
CONFIG: Final = VehicleConfig(
    command=True,
    fence_deg=tuple(moved(*HOME_DEG, *corner) for corner in CORNERS_M),
    fence_margin_m=MARGIN_M,
    min_altitude_m=2.0,
    max_depth_m=50.0,
    ask_again_s=10.0,
    plan_valid_s=60.0,
    max_control_s=40.0,
)
PLACES_M: Final = st.sampled_from(
    [
        (40.0, 40.0),
        (40.0, 160.0),
        (160.0, 40.0),
        (20.0, 20.0),
        (100.0, 30.0),
        (78.0, 150.0),
        (120.0, 120.0),
        (-30.0, 50.0),
    ]
)
GOOD_PLAN_M: Final = [(40.0, 40.0), (100.0, 40.0), (150.0, 40.0)]
EXTENT_M: Final = 1e-2


def inside(east_m: float, north_m: float) -> bool:
    """Of the L, as the two rectangles that it is."""
    return (0.0 <= east_m <= 200.0 and 0.0 <= north_m <= 80.0) or (0.0 <= east_m <= 80.0 and 0.0 <= north_m <= 200.0)


def way_inside(start_m: tuple[float, float], end_m: tuple[float, float]) -> bool:
    """By walking it."""
    shares = [step / 200.0 for step in range(201)]
    return all(inside(*(a + share * (b - a) for a, b in zip(start_m, end_m, strict=True))) for share in shares)


class AnyOrder(RuleBasedStateMachine):
    @initialize(capabilities=st.sampled_from([GOES_BY_ITSELF, IS_STEERED]))
    def begin(self, capabilities: Capability) -> None:
        self.dialect = PaperTalker(capabilities)
        self.pilot = Pilot(self.dialect, CONFIG, session=1)
        self.now_s = 50.0
        self.state: ReportedState | None = None  # the last one reported whole
        self.place_m = (40.0, 40.0)
        self.last_digit_m = 0.0
        self.plan_s = -math.inf
        self.fetched_s = -math.inf
        self.wire_open = False
        self.asked = self.may_command = self.stopped = False
        self.n_seen = 0
        self.n_commands = 0
        self.take_command()

    @rule()
    def take_command(self) -> None:
        """Where most of what can go wrong begins; if nothing is in the way."""
        if not self.wire_open:
            self.connect()
        self.place_m = (40.0, 40.0)
        self.propose(GOOD_PLAN_M)
        self.run(3.0, False)

    def hear(self, *events: VehicleEvent) -> None:
        self.pilot.hear([calls(self.now_s, *events)], stamp(self.now_s))
        for event in events:
            if isinstance(event, Granted) and self.asked and self.wire_open:
                self.may_command, self.asked = True, False
            elif isinstance(event, Withheld):
                self.may_command = self.asked = False
        self.read()

    def read(self) -> None:
        """Follow the calls of the dialect, in order, and judge every command by them."""
        for line in self.dialect.calls[self.n_seen :]:
            if line == "request":
                assert self.wire_open
                assert not self.stopped
                assert not self.may_command
                self.asked = True
            elif line.startswith("release") or line in ("connected", "disconnected"):
                self.may_command = self.asked = False
            elif line == "command":
                self.judge(*self.dialect.commands[self.n_commands])
                self.n_commands += 1
        self.n_seen = len(self.dialect.calls)

    def judge(self, time_s: float, command: Command) -> None:
        assert time_s == self.now_s
        assert self.may_command
        assert self.wire_open
        assert not self.stopped
        assert self.now_s - self.plan_s <= CONFIG.plan_valid_s
        assert self.now_s - self.fetched_s <= CONFIG.command_valid_s
        state = self.state
        assert state is not None
        assert self.now_s - state.received.mono_ns * 1e-9 <= CONFIG.state_valid_s + 1e-6
        assert state.altitude_m >= CONFIG.min_altitude_m
        assert state.depth_m <= CONFIG.max_depth_m
        assert command.vertical.reference == "altitude"
        assert command.vertical.value_m >= CONFIG.min_altitude_m
        assert state.depth_m + state.altitude_m - command.vertical.value_m <= CONFIG.max_depth_m
        assert 0.0 < command.speed_mps <= CONFIG.speed_mps
        here_m = offset_m(HOME_DEG, (state.latitude_deg, state.longitude_deg))
        if isinstance(command, GoTo):
            there_m = offset_m(HOME_DEG, (command.latitude_deg, command.longitude_deg))
            away = MARGIN_M - EXTENT_M
            assert all(
                inside(there_m[0] + east_m, there_m[1] + north_m)
                for east_m in (-away, away)
                for north_m in (-away, away)
            )
        else:
            reach_m = command.speed_mps * CONFIG.command_valid_s
            there_m = (
                here_m[0] + reach_m * math.sin(command.heading_rad),
                here_m[1] + reach_m * math.cos(command.heading_rad),
            )
        assert way_inside(here_m, there_m)

    @rule()
    def connect(self) -> None:
        self.wire_open = True
        self.pilot.connected(self.now_s)
        self.read()

    @rule()
    def disconnect(self) -> None:
        was_in_control = self.pilot.authority in ("requested", "granted")
        n_calls = len(self.dialect.calls)
        self.pilot.disconnected(self.now_s)
        assert any(line.startswith("release") for line in self.dialect.calls[n_calls:]) == was_in_control
        self.wire_open = False
        self.read()

    @rule(seconds=st.sampled_from([4.0, 25.0, 70.0]))
    def listen_to_a_vehicle_without_position(self, seconds: float) -> None:
        for _ in range(round(seconds / 0.5)):
            self.now_s += 0.5
            self.hear(Acknowledged(1))
            self.fetch()

    @rule(
        place_m=st.one_of(st.none(), PLACES_M),
        depth_m=st.sampled_from([20.0, 20.0, 20.0, 49.0, 51.0, NAN]),
        altitude_m=st.sampled_from([8.0, 8.0, 8.0, 1.0, NAN]),
        heading_rad=st.sampled_from([0.0, 1.0, 3.0, 5.0]),
    )
    def report_place(
        self, place_m: tuple[float, float] | None, depth_m: float, altitude_m: float, heading_rad: float
    ) -> None:
        if place_m is not None:
            self.place_m = place_m
        self.report_state(
            ReportedState(
                stamp(self.now_s), *moved(*HOME_DEG, *self.place_m), heading_rad, NAN, NAN, depth_m, altitude_m
            )
        )

    def report_state(self, state: ReportedState) -> None:
        # What a message leaves out holds for a while: the witness waits until it is reported whole.
        if math.isfinite(state.depth_m + state.altitude_m) or self.state is None:
            self.state = state
            self.hear(state)
        else:
            whole = state._replace(depth_m=20.0, altitude_m=8.0)
            self.state = whole
            self.hear(state._replace(depth_m=NAN, altitude_m=NAN), whole)

    @rule(place_m=PLACES_M, steps=st.integers(1, 12))
    def be_elsewhere(self, place_m: tuple[float, float], steps: int) -> None:
        """Its navigation was corrected."""
        self.place_m = place_m
        self.run(0.2 * steps, False)

    @rule()
    def grant(self) -> None:
        self.hear(Granted("yes"))

    @rule()
    def withhold(self) -> None:
        self.hear(Withheld("no"))

    @rule(ticket=st.integers(1, 3))
    def send_something_else(self, ticket: int) -> None:
        self.hear(Acknowledged(ticket), Rejected(ticket + 1, "no"), PlaceReached())

    @rule()
    def make_noise(self) -> None:
        self.pilot.hear([], stamp(self.now_s))

    @rule(places_m=st.lists(PLACES_M, min_size=0, max_size=4))
    def propose(self, places_m: list[tuple[float, float]]) -> None:
        kinds = ("start", "leg_entry", "leg_exit", "turn")
        plan = tuple(
            waypoint_of(kinds[number % 4], *moved(*HOME_DEG, *place_m), 1 + number // 3)
            for number, place_m in enumerate(places_m)
        )
        self.plan_s = self.now_s
        self.pilot.propose(plan, self.now_s)
        self.read()

    @rule(seconds=st.sampled_from([0.1, 0.1, 1.0, 2.0, 6.0, 30.0]))
    def stall(self, seconds: float) -> None:
        self.now_s += seconds

    @rule(seconds=st.sampled_from([0.2, 1.0, 3.0, 12.0]), sails=st.booleans())
    def run(self, seconds: float, sails: bool) -> None:
        """A well-behaved vehicle and a well-behaved service, for a while."""
        for _ in range(round(seconds / 0.2)):
            self.now_s += 0.2
            self.last_digit_m = 0.02 - self.last_digit_m  # an altitude that lives does not stand still
            if sails:
                self.place_m = (self.place_m[0] * 0.98 + 40.0 * 0.02, self.place_m[1] * 0.98 + 40.0 * 0.02)
            self.report_place(None, 20.0, 8.0 - self.last_digit_m, 1.0)
            self.fetch()
            if self.asked:
                self.grant()

    @rule()
    def fetch(self) -> None:
        before = self.pilot.authority
        n_calls = len(self.dialect.calls)
        stalled = self.now_s - self.fetched_s > CONFIG.command_valid_s
        if not stalled:
            self.fetched_s = self.now_s
        self.pilot.take_outgoing(self.now_s)
        self.read()
        self.fetched_s = self.now_s
        if before in ("requested", "granted") and self.pilot.authority != before:
            assert any(line.startswith("release") for line in self.dialect.calls[n_calls:])

    @rule(rarely=st.integers(0, 9))
    def stop(self, rarely: int) -> None:
        if rarely:
            return
        self.pilot.release("the service stops", self.now_s)
        self.read()
        self.stopped = True
        assert self.pilot.authority not in ("requested", "granted")

    @invariant()
    def control_is_what_the_witness_thinks(self) -> None:
        if hasattr(self, "pilot"):
            assert (self.pilot.authority == "granted") == self.may_command
            assert self.pilot.health()

    def teardown(self) -> None:
        """With a vehicle that answers, a good position over a sound floor and a plan, there is a command in time."""
        if not hasattr(self, "pilot") or self.stopped:
            return
        self.connect()
        self.place_m = (40.0, 40.0)
        self.propose(GOOD_PLAN_M)
        n_commands, start_s = self.n_commands, self.now_s
        while self.n_commands == n_commands:
            self.run(0.2, False)
            assert self.now_s - start_s < CONFIG.ask_again_s + 15.0, self.pilot.health()


TestAnyOrder = AnyOrder.TestCase
TestAnyOrder.settings = settings(max_examples=60, stateful_step_count=25, deadline=None)
