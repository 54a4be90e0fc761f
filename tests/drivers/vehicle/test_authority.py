"""Compare who commands with an oracle on the whole history; no order of events makes control unobtainable."""

from __future__ import annotations

import math
from typing import Final

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from drivers.vehicle.authority import ANSWER_WITHIN_S, SETTLE_S, Action, Ask, Authority, AuthorityState, GiveBack

SILENT_S: Final = 3.0
ASK_AGAIN_S: Final = 20.0
MAX_CONTROL_S: Final = 60.0


def make() -> Authority:
    return Authority(silent_after_s=SILENT_S, ask_again_s=ASK_AGAIN_S, max_control_s=MAX_CONTROL_S)


def oracle(history: list[tuple[float, str]], now_s: float) -> AuthorityState:
    """The state after a step at now_s, from all that ever happened: wire events, what the vehicle said, and what was
    asked and returned."""
    lost = max(
        (index for index, (_, what) in enumerate(history) if what in ("connected", "disconnected", "silent")),
        default=-1,
    )
    closed = (
        next((what for _, what in reversed(history) if what in ("connected", "disconnected")), "disconnected")
        == "disconnected"
    )
    since = history[lost + 1 :]
    if closed or not any(what == "heard" for _, what in since):
        return "down"
    asked = max((index for index, (_, what) in enumerate(since) if what == "ask"), default=-1)
    if asked < 0:
        return "listening"
    state: AuthorityState = "requested"
    for time_s, what in since[asked + 1 :]:
        if what == "granted":
            state = "granted"
        elif what == "give back":
            return "listening"
        elif what == "withheld":
            return "revoked" if now_s < time_s + ASK_AGAIN_S else "listening"
    return state


class AnyOrder(RuleBasedStateMachine):
    def __init__(self) -> None:
        super().__init__()
        self.authority = make()
        self.now_s = 1000.0
        self.wanted = False
        self.history: list[tuple[float, str]] = []
        self.asks: list[float] = []
        self.pauses: list[float] = [-math.inf]
        self.judged: AuthorityState = "down"

    def note(self, what: str) -> None:
        self.history.append((self.now_s, what))

    def done(self, action: Action | None) -> None:
        match action:
            case Ask():
                self.note("ask")
                self.asks.append(self.now_s)
            case GiveBack():
                self.note("give back")

    @rule(change=st.sampled_from(["connected", "disconnected"]))
    def connect_or_disconnect(self, change: str) -> None:
        before = self.authority.state
        action = getattr(self.authority, change)(self.now_s)
        assert isinstance(action, GiveBack) == (before in ("requested", "granted"))
        self.done(action)
        self.note(change)
        assert self.authority.state == "down"

    @rule()
    def hear(self) -> None:
        self.authority.heard(self.now_s)
        self.note("heard")

    @rule()
    def grant(self) -> None:
        self.authority.granted("yes", self.now_s)
        self.note("granted")

    @rule()
    def withhold(self) -> None:
        if self.authority.state in ("requested", "granted"):
            self.pauses.append(self.now_s)
        self.authority.withheld("no", self.now_s)
        self.note("withheld")

    @rule(pause=st.booleans())
    def give_back(self, pause: bool) -> None:
        action = self.authority.give_back("enough", self.now_s, pause=pause)
        if action is not None and pause:
            self.pauses.append(self.now_s)
        self.done(action)

    @rule(wanted=st.booleans())
    def want(self, wanted: bool) -> None:
        self.wanted = wanted

    @rule(seconds=st.sampled_from([0.1, 0.1, 0.5, 1.0, 4.0, 11.0, 30.0]))
    def wait(self, seconds: float) -> None:
        self.now_s += seconds

    @rule(seconds=st.sampled_from([1.0, 12.0, 25.0, 61.0]))
    def a_vehicle_that_only_talks(self, seconds: float) -> None:
        for _ in range(int(seconds * 2)):
            self.now_s += 0.5
            self.hear()
            self.step()

    @rule()
    def step(self) -> None:
        before = self.authority.state
        last_heard_s = max((time_s for time_s, what in self.history if what == "heard"), default=-math.inf)
        action = self.authority.step(self.wanted, self.now_s)
        if before != "down" and self.authority.state == "down":
            assert self.now_s - last_heard_s > SILENT_S
            self.note("silent")
        elif before != "down":
            assert self.now_s - last_heard_s <= SILENT_S
        if isinstance(action, Ask):
            assert self.wanted
            assert self.now_s >= max(self.pauses) + ASK_AGAIN_S
        if isinstance(action, GiveBack) and before == "granted" and self.wanted and self.authority.state == "listening":
            self.pauses.append(self.now_s)  # held for too long
        self.done(action)
        assert self.authority.state == oracle(self.history, self.now_s)
        self.judged = self.authority.state

    @invariant()
    def only_what_was_asked_for_is_granted(self) -> None:
        if self.authority.state in ("requested", "granted"):
            # oracle() of the moment: time alone changes only `revoked`, and that on the next step
            assert oracle(self.history, self.now_s) == self.authority.state

    def teardown(self) -> None:
        """Check that a vehicle that answers and grants every request is commanded in bounded time."""
        self.connect_or_disconnect("connected")
        start_s = self.now_s
        self.wanted = True
        while self.authority.state != "granted":
            self.now_s += 0.1
            self.hear()
            n_asked = len(self.asks)
            self.step()
            if len(self.asks) > n_asked:
                self.grant()
            assert self.now_s - start_s < ASK_AGAIN_S + ANSWER_WITHIN_S + 3.0 * SETTLE_S


TestAnyOrder = AnyOrder.TestCase
TestAnyOrder.settings = settings(max_examples=40, stateful_step_count=40, deadline=None)


def test_control_is_given_back_after_so_long_and_asked_for_again_later() -> None:
    authority = make()
    authority.connected(0.0)
    did: list[tuple[float, str]] = []
    for tenth in range(1000):
        now_s = tenth / 10.0
        authority.heard(now_s)
        action = authority.step(True, now_s)
        if isinstance(action, Ask):
            did.append((now_s, "ask"))
            authority.granted("yes", now_s)
        elif action is not None:
            did.append((now_s, action.reason))
    assert did == [(0.0, "ask"), (60.1, "control was held for 60 s"), (80.1, "ask")]


def test_a_vehicle_that_says_every_second_that_it_keeps_control_is_asked_again_all_the_same() -> None:
    authority = make()
    authority.connected(0.0)
    asked = []
    for tenth in range(500):
        now_s = tenth / 10.0
        authority.heard(now_s)
        if isinstance(authority.step(True, now_s), Ask):
            asked.append(now_s)
        if tenth % 10 == 5:
            authority.withheld("mission", now_s)
    assert asked == [0.0, 20.5, 40.5]


def test_a_grant_that_nobody_asked_for_is_given_back_and_used_for_nothing() -> None:
    authority = make()
    authority.connected(0.0)
    authority.heard(0.0)
    authority.granted("please", 0.0)
    assert authority.state == "listening"
    assert authority.step(False, 0.1) == GiveBack("control was not requested")
    assert authority.step(False, 0.2) is None
    authority.granted("please", 0.3)
    assert authority.step(False, 0.4) is None  # an answer to what was said before, perhaps
    authority.heard(1.2)
    assert authority.step(False, 1.2) == GiveBack("control was not requested")


def test_an_unanswered_request_is_withdrawn_and_made_again_sooner_than_one_that_is_considered() -> None:
    authority = make()
    authority.connected(0.0)
    asked: list[float] = []
    counts = []
    for tenth in range(1560):
        authority.heard(tenth / 10.0)
        action = authority.step(True, tenth / 10.0)
        if isinstance(action, Ask):
            asked.append(tenth / 10.0)
            if len(asked) == 3:
                authority.considered()
        elif action is not None:
            counts.append((action.n_unanswered, action.n_undecided))
    assert asked == pytest.approx([0.0, 11.1, 22.2, 143.3, 154.4], abs=0.3)
    assert counts == [(1, 0), (2, 0), (0, 1), (1, 0)]
