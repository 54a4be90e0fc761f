"""A dialect and its fake vehicle at the two ends of a wire, and what a lossy wire does to sentences."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import msgspec
from hypothesis import strategies as st

from auv_mcm.clock import Stamp
from auv_mcm.settings.vehicle_settings import BluefinSettings, CanSettings, ImcSettings, IverSettings, ReconSettings
from drivers.navigation.nmea0183 import sentence
from drivers.vehicle.dialect import GoTo, Granted, PayloadHealth, Steer, VehicleEvent, Vertical, Withheld
from sim_replay.fakes.vehicles.bluefin import FakeBluefin
from sim_replay.fakes.vehicles.can import FakeCan
from sim_replay.fakes.vehicles.imc import FakeImc
from sim_replay.fakes.vehicles.iver import FakeIver
from sim_replay.fakes.vehicles.recon import FakeRecon
from sim_replay.fakes.vehicles.text_controller import TextController
from tests.make.records import nav_of, report_of
from tests.sim_replay.conversation import Conversation

UTC_S = 1_700_000_000.0
STEP_S = 0.1
SPOKEN: dict[str, tuple[Callable[[], Conversation], Callable[[], TextController]]] = {
    "bluefin": (lambda: Conversation(BluefinSettings()), FakeBluefin),
    "iver": (lambda: Conversation(IverSettings()), FakeIver),
    "recon": (lambda: Conversation(ReconSettings()), FakeRecon),
}
PAIRS: dict[str, tuple[Callable[[], Conversation], Callable[[], Any]]] = {
    **SPOKEN,
    "can": (lambda: Conversation(CanSettings()), FakeCan),
    "imc": (lambda: Conversation(ImcSettings(acknowledges=True)), FakeImc),
}
COMMANDS = (b"$BPRMB", b"$OMS,", b"#C,")
STEER = Steer(math.radians(123.0), Vertical("depth", 7.5), 1.5)
POSE = nav_of(
    UTC_S,
    latitude_deg=48.123456,
    longitude_deg=-5.654321,
    heading_rad=math.radians(275.3),
    pitch_rad=math.radians(-2.0),
    roll_rad=math.radians(1.5),
    depth_m=12.34,
    altitude_m=6.5,
    speed_mps=1.6,
)
PLACE = GoTo(POSE.latitude_deg + 0.002, POSE.longitude_deg, Vertical("depth", 7.5), 1.5, 3.0)
REPORT = report_of(
    session=1_700_000_123,
    number=17,
    revision=2,
    time_s=UTC_S + 0.125,
    latitude_deg=48.1237,
    longitude_deg=-5.6541,
    sigma_m=1.25,
    p_mine=0.875,
    classification="truncated_cone",
    belief={"cylinder": 0.125, "sphere": 0.0, "truncated_cone": 0.5, "wedge": 0.25, "clutter": 0.0, "unknown": 0.125},
    n_views=2,
    depth_m=18.75,
    length_m=1.02,
    width_m=0.98,
    height_m=0.45,
    length_sigma_m=0.1,
    width_sigma_m=0.12,
    height_sigma_m=0.06,
)


def stamp_at(now_s: float) -> Stamp:
    return Stamp(round(now_s * 1e9), round((UTC_S + now_s) * 1e9))


class Loop:
    """Both ends, ten times a second. lost: whether this message to the vehicle, or from it, does not arrive."""

    def __init__(self, name: str, lost: Callable[[Any], bool] = lambda message: False) -> None:
        dialect, vehicle = PAIRS[name]
        self.dialect, self.vehicle = dialect(), vehicle()
        self.lost = lost
        self.now_s = 100.0
        self.pose = POSE
        self.events: list[VehicleEvent] = []
        self.sent: list[tuple[float, Any]] = []
        self.steer: GoTo | Steer | None = None
        self.arrived = False
        self.dialect.connected(self.now_s)
        self.vehicle.connected(self.now_s)

    def step(self) -> None:
        self.now_s += STEP_S
        sample = msgspec.structs.replace(self.pose, time_s=UTC_S + self.now_s)
        if self.steer is not None and self.granted and round(self.now_s / STEP_S) % 10 == 0:
            self.dialect.command(self.steer, self.now_s)
        self._hear(self.vehicle.tick(sample, self.arrived, self.now_s))
        self.flush()

    def flush(self) -> None:
        """Until neither has anything to say."""
        while lines := self.dialect.take_outgoing(self.now_s):
            for line in lines:
                self.sent.append((self.now_s, line))
                if not self.lost(line):
                    self._hear(self.vehicle.heard(line, self.now_s))

    def _hear(self, lines: list[Any]) -> None:
        for line in lines:
            if not self.lost(line):
                self.events += self.dialect.hear(line, stamp_at(self.now_s))

    def run(self, seconds: float) -> Loop:
        for _ in range(round(seconds / STEP_S)):
            self.step()
        return self

    @property
    def granted(self) -> bool:
        reported = [event for event in self.events if isinstance(event, Granted | Withheld)]
        return bool(reported) and isinstance(reported[-1], Granted)

    def of(self, kind: type[Any]) -> list[Any]:
        return [event for event in self.events if isinstance(event, kind)]

    def commands(self) -> list[tuple[float, Any]]:
        return [(now_s, line) for now_s, line in self.sent if any(self.dialect.commands_in([line]))]


def in_control(name: str) -> Loop:
    """A loop in which the payload commands: a course, or a place where the vehicle takes no courses."""
    loop = Loop(name).run(2.0)
    loop.dialect.request(loop.now_s)
    loop.steer = PLACE if name == "imc" else STEER
    loop.run(3.0)
    assert loop.granted
    assert loop.vehicle.in_control
    return loop


def take_over(lines: list[bytes]) -> list[tuple[str, Any]]:
    """Return the steps to a grant: the vehicle's first two lines say that it lets the payload command."""
    steps: list[tuple[str, Any]] = [("connected", None), ("hear", lines[0]), ("request", None), ("hear", lines[1])]
    return [*steps, *[("answer", None)] * 10]


def _answer(line: bytes) -> bytes:
    """Return how a Bluefin says that it takes a sentence."""
    name, of, *_ = line[1:].split(b"*")[0].decode().split(",")
    return sentence(f"BFACK,101010.000,{name[2:]},{'' if name == 'BPLOG' else of},0,2,,")


@st.composite
def dialogues(draw: st.DrawFn, lines: list[bytes]) -> list[tuple[str, Any]]:
    """What may happen to a dialect, in any order: calls, lines of the vehicle and its own, damaged or not, noise, and
    time."""
    steps = take_over(lines) if draw(st.booleans()) else []
    for _ in range(draw(st.integers(1, 40))):
        kind = draw(st.sampled_from(["line", "line", "line", "damaged", "noise", "wait", "call", "call", "answer"]))
        if kind in ("line", "damaged"):
            line = draw(st.sampled_from(lines))
            if kind == "damaged":
                at = draw(st.integers(0, len(line) - 1))
                line = line[:at] + draw(st.binary(max_size=3)) + line[at + draw(st.integers(0, 5)) :]
            steps.append(("hear", line))
        elif kind == "noise":
            steps.append(("hear", draw(st.binary(max_size=30))))
        elif kind == "answer":
            steps.append((kind, None))
        elif kind == "wait":
            steps.append(("wait", draw(st.sampled_from([0.1, 1.0, 4.0, 6.0, 30.0]))))
        else:
            steps.append(
                (
                    draw(
                        st.sampled_from(
                            ["connected", "disconnected", "request", "command", "release", "report", "report_health"]
                        )
                    ),
                    None,
                )
            )
    return steps


def play(dialect: Conversation, steps: list[tuple[str, Any]]) -> tuple[list[tuple[bool, bytes]], list[VehicleEvent]]:
    """Return what it sends, each with whether control was granted then, by its events and our releases; and its
    events."""
    now_s, granted = 100.0, False
    sent: list[tuple[bool, bytes]] = []
    events: list[VehicleEvent] = []
    for kind, value in steps:
        heard: list[VehicleEvent] = []
        match kind:
            case "wait":
                now_s += value
            case "hear":
                heard = dialect.hear(value, stamp_at(now_s))
            case "answer" if sent and sent[-1][1].startswith(b"$BP"):
                heard = dialect.hear(_answer(sent[-1][1]), stamp_at(now_s))
            case "connected" | "request":
                getattr(dialect, kind)(now_s)
            case "disconnected":
                dialect.disconnected()
            case "command":
                dialect.command(STEER, now_s)
            case "release":
                dialect.release("a test", now_s)
            case "report":
                dialect.report(REPORT, 1 + len(sent) % 7, now_s)
            case "report_health":
                dialect.report_health(PayloadHealth("fault", "a lens, *dirty*\x00"), now_s)
        for event in heard:
            granted = isinstance(event, Granted) if isinstance(event, Granted | Withheld) else granted
        granted &= kind not in ("connected", "disconnected", "release")
        events += heard
        sent += [(granted, line) for line in dialect.take_outgoing(now_s)]
    return sent, events
