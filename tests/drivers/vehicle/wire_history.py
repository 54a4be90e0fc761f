"""Fly a pilot and a fake vehicle through a history of what the vehicle reports, and judge what goes on the wire.

The vehicle is where it is, over a floor that is what it is; only what it reports is wrong. `python -m
tests.drivers.vehicle.wire_history 100000` flies so many drawn histories of every dialect together.
"""

from __future__ import annotations

import logging
import math
import os
import random
import sys
from collections import Counter, deque
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import Any, Final, NamedTuple

from auv_mcm.clock import Stamp
from auv_mcm.records import NavSample
from auv_mcm.settings.vehicle_settings import ImcSettings, VehicleConfig
from drivers.vehicle.pilot import Pilot
from drivers.vehicle.vehicles import VEHICLES, decoder_of, talker_of
from sim_replay.fakes.vehicle_device import CONTROLLERS
from tests.drivers.vehicle.wire_parser import Sent, commands_of
from tests.make.records import waypoint_of

FLOOR_M: Final = 18.0
SHALLOWEST_M: Final = 8.0  # floor of a history
HOME_DEG: Final = (48.0, -68.0)
FENCE_DEG: Final = ((47.998, -68.003), (47.998, -67.997), (48.002, -67.997), (48.002, -68.003))
M_PER_DEG: Final = 111_195.0  # of latitude
SPEED_MPS: Final = 1.5
MIN_ALTITUDE_M: Final = 2.0
MAX_DEPTH_M: Final = 22.0
MARGIN_M: Final = 3.0  # that an altitude may be too deep for max_depth_m; a depth never is
DIVES_MPS: Final = 0.6  # of the vehicle
RISES_MPS: Final = 0.3  # of the floor, at most
UTC_S: Final = 1.7e9
STEP_S: Final = 0.5  # between two reports
GOOD_S: Final = 3.0  # at the beginning of a history, for a floor to be believed
SHORT_S, LONG_S = 9.0, 30.0  # a history
N_TOGETHER: Final = 20  # histories of one voyage; one of them is long
LONGEST_S: Final = {  # of each event; a false value stands no longer than a floor needs to be believed
    "depth": 1.5,
    "altitude": 1.5,
    "swap": 8.0,
    "no_lock": 12.0,
    "no_depth": 12.0,
    "frozen_altitude": 25.0,
    "frozen_depth": 4.0,
    "frozen": 2.5,
    "delay": 10.0,
    "position": 3.0,
    "no_position": 5.0,
    "silence": 6.0,
    "false_then_lost": 5.0,
}
FALSE_S: Final = 1.0  # of false depth, before the altitude is lost
KINDS: Final = tuple(LONGEST_S)
_STILL: Final = {
    "frozen_altitude": {"altitude_m"},
    "frozen_depth": {"depth_m"},
    "frozen": {"depth_m", "altitude_m", "latitude_deg", "longitude_deg"},
}


class Event(NamedTuple):
    """Hold what goes wrong with the reports. size: of a spike, -1 to 1; of a delay, its absolute value."""

    kind: str
    begins_s: float
    lasts_s: float
    size: float


class History(NamedTuple):
    """Hold what happens. slope_mps: of the floor, up and down every 2 pi wave_s; noise_m: of depth and altitude.

    digits_m: of the altitude that is reported.
    """

    lasts_s: float
    slope_mps: float
    noise_m: float
    seed: int
    events: tuple[Event, ...]
    wave_s: float = 3.0
    digits_m: float = 0.0


def drawn(source: random.Random, lasts_s: float = SHORT_S) -> History:
    """Draw a history. One event in three begins where another begins or ends; extremes are frequent."""

    def share() -> float:
        return source.choice((0.0, 0.5, 1.0)) if source.random() < 0.25 else source.random()

    events: list[Event] = []
    for _ in range(source.randint(1, 5)):
        kind = source.choice(KINDS)
        begins_s, for_s = GOOD_S + share() * (lasts_s - 1.0 - GOOD_S), 0.1 + share() * (LONGEST_S[kind] - 0.1)
        if events and source.random() < 1.0 / 3.0:
            other = source.choice(events)
            begins_s = min(other.begins_s + source.choice((0.0, other.lasts_s)), lasts_s - 1.0)
        events.append(Event(kind, begins_s, for_s, 2.0 * share() - 1.0))
    if lasts_s > LONGEST_S["frozen_altitude"] and source.random() < 0.5:  # while the vehicle holds its depth
        events = [Event("frozen_altitude", GOOD_S + share() * SHORT_S, LONGEST_S["frozen_altitude"], 0.0), *events[:1]]
    slope_mps, noise_m = (2.0 * share() - 1.0) * RISES_MPS, source.choice((0.02, 0.1))
    digits_m = source.choice((0.0, 0.0, 0.01, 0.1, 0.5, 1.0))
    wave_s = 3.0 if any(event.kind == "swap" for event in events) else source.choice((3.0, 12.0))
    return History(lasts_s, slope_mps, noise_m, source.randrange(1 << 30), tuple(events), wave_s, digits_m)


def settings_of(name: str) -> Any:
    return ImcSettings(vehicle_id=0x1E) if name == "imc" else VEHICLES[name].settings()


class Voyage:
    """Run a pilot, a fake vehicle and the time. commands: what the oracle read from the wire."""

    def __init__(self, name: str, *, settings: Any = None, **changes: Any) -> None:
        settings = settings or settings_of(name)
        self.name = name
        self.config = VehicleConfig(**{"command": True, "fence_deg": FENCE_DEG, **changes})
        self.decoder = decoder_of(name, settings, "vehicle")
        self.talker = talker_of(name, settings, lambda n: 1)
        self.pilot: Pilot[Any] = Pilot(self.talker, self.config, session=1)
        self.vehicle: Any = CONTROLLERS[name]()
        self.now_s = 1000.0
        self.place_deg = HOME_DEG
        self.floor_m, self.depth_m = FLOOR_M, 10.0
        self.commands: list[Sent] = []
        self.last_depth_m = math.nan
        self.pilot.connected(self.now_s)
        self.vehicle.connected(self.now_s)
        self.propose()

    def propose(self) -> None:
        kinds = (("start", 0.0), ("leg_entry", 60.0), ("leg_exit", 110.0))
        plan = tuple(waypoint_of(kind, HOME_DEG[0] + north_m / M_PER_DEG, HOME_DEG[1]) for kind, north_m in kinds)
        self.pilot.propose(plan, self.now_s)

    def run(self, for_s: float, **reported: float) -> None:
        """Run for a while; reported: what the vehicle says instead of the truth."""
        for step in range(round(for_s / 0.1)):
            # An altimeter has noise: one that stands still to the last digit is taken for frozen.
            truth: dict[str, Any] = {
                "depth_m": self.depth_m,
                "altitude_m": self.floor_m - self.depth_m - 0.02 * (step % 2),
            }
            self.step(0.1, **{**truth, **reported})

    def step(self, step_s: float, *, silent: bool = False, **reported: Any) -> list[Sent]:
        """Let time pass, and return what was commanded then."""
        self.now_s += step_s
        self._dive(step_s)
        values: dict[str, Any] = {
            "time_s": UTC_S + self.now_s,
            "latitude_deg": self.place_deg[0],
            "longitude_deg": self.place_deg[1],
            "heading_rad": 0.0,
            "pitch_rad": 0.0,
            "roll_rad": 0.0,
            "speed_mps": SPEED_MPS,
            **reported,
        }
        if not silent:
            self._hear(self.vehicle.tick(NavSample(**values), False, self.now_s))
        items = self.pilot.take_outgoing(self.now_s)
        commands = commands_of(self.name, items)
        self.commands += commands
        for command in commands:
            if command.depth_m is not None:
                self.last_depth_m = command.depth_m
        for item in items:
            answers = self.vehicle.heard(item, self.now_s)
            if not silent:
                self._hear(answers)
        return commands

    def _hear(self, items: Sequence[Any]) -> None:
        stamp = Stamp(round(self.now_s * 1e9), round((UTC_S + self.now_s) * 1e9))
        for item in items:
            self.pilot.hear(self.decoder.feed(item, stamp), stamp)

    def _dive(self, step_s: float) -> None:
        """Go to the depth or the altitude that is commanded, or to 10 m, by true depths and altitudes."""
        order = self.vehicle.command if self.vehicle.in_control else None
        wanted_m = 10.0
        if order is not None:
            vertical = order.vertical
            wanted_m = vertical.value_m if vertical.reference == "depth" else self.floor_m - vertical.value_m
        step_m = DIVES_MPS * step_s
        self.depth_m += min(max(min(wanted_m, self.floor_m - 0.5) - self.depth_m, -step_m), step_m)


def fly(name: str, histories: Sequence[History]) -> tuple[list[str], int]:
    """Fly histories one after the other with one dialect. Returns what was wrong, and the number of commands."""
    voyage = Voyage(name, ask_again_s=1.0, max_depth_m=MAX_DEPTH_M, min_altitude_m=MIN_ALTITUDE_M)
    wrong: list[str] = []
    for number, history in enumerate(histories):
        voyage.propose()  # again, if it was dropped
        wrong += [f"{name}, history {number}: {fault}" for fault in _flown_through(voyage, history)]
    return wrong, len(voyage.commands)


def _flown_through(voyage: Voyage, history: History) -> list[str]:
    source = random.Random(history.seed)
    reports: deque[dict[str, float]] = deque(maxlen=8)
    last: dict[str, float] = {}
    wrong = []
    for step in range(round(history.lasts_s / STEP_S)):
        at_s = step * STEP_S
        rise_m = math.copysign(history.slope_mps, math.sin(at_s / history.wave_s) * history.slope_mps) * STEP_S
        voyage.floor_m = min(max(voyage.floor_m + rise_m, SHALLOWEST_M), 30.0)
        true = {
            "depth_m": max(voyage.depth_m + source.gauss(0.0, history.noise_m / 3.0), 0.0),
            "altitude_m": voyage.floor_m - voyage.depth_m + source.gauss(0.0, history.noise_m / 3.0),
            "latitude_deg": HOME_DEG[0] + source.gauss(0.0, 1e-7),
            "longitude_deg": HOME_DEG[1] + source.gauss(0.0, 1e-7),
        }
        if history.digits_m:
            true["altitude_m"] = round(true["altitude_m"] / history.digits_m) * history.digits_m
        reports.append(true)
        active = [event for event in history.events if event.begins_s <= at_s < event.begins_s + event.lasts_s]
        if any(event.kind == "swap" for event in active):  # else a depth stands still for longer than 4 s
            active = [event for event in active if event.kind != "frozen_altitude"]
        reported = dict(true)
        for event in active:
            _disturb(reported, event, reports, last, at_s)
        last = {key: last.get(key, true[key]) if key in _frozen(active) else true[key] for key in true}
        if voyage.name not in ("imc", "vehicle_can"):  # the others report 0 for what they do not know
            reported = {key: value if math.isfinite(value) else 0.0 for key, value in reported.items()}
        silent = any(event.kind == "silence" for event in active)
        for sent in voyage.step(STEP_S, silent=silent, **reported):
            wrong += [
                f"{why} at {at_s:.2f} s over {voyage.floor_m:.2f} m: {sent}" for why in _faults(sent, voyage.floor_m)
            ]
    return wrong


def _frozen(active: Sequence[Event]) -> set[str]:
    """Return the values that stand still."""
    keys = set()
    for event in active:
        keys |= _STILL.get(event.kind, set())
    return keys


def _disturb(
    reported: dict[str, float], event: Event, reports: deque[dict[str, float]], last: dict[str, float], at_s: float
) -> None:
    """Change what is reported as an event does."""
    match event.kind:
        case "depth":
            reported["depth_m"] = max(reported["depth_m"] + 80.0 * event.size, 0.0)
        case "false_then_lost" if at_s - event.begins_s < FALSE_S:
            reported["depth_m"] += 40.0 * abs(event.size)
        case "false_then_lost":
            reported["altitude_m"] = 0.0
        case "altitude":
            reported["altitude_m"] = max(reported["altitude_m"] + 60.0 * event.size, 0.0)
        case "swap":
            reported["depth_m"], reported["altitude_m"] = reported["altitude_m"], reported["depth_m"]
        case "no_lock":
            reported["altitude_m"] = 0.0 if event.size > 0.0 else math.nan
        case "no_depth":
            reported["depth_m"] = math.nan
        case "frozen_altitude" | "frozen_depth" | "frozen":
            reported.update({key: last[key] for key in _STILL[event.kind] if key in last})
        case "delay":
            reported.update(reports[max(len(reports) - 1 - round(4.0 * abs(event.size)), 0)])
        case "position":
            reported["latitude_deg"] += 300.0 * event.size / M_PER_DEG
        case "no_position":
            reported["latitude_deg"] = math.nan


def _faults(sent: Sent, floor_m: float) -> list[str]:
    """Return why a command must not have been sent over a floor that is truly this deep."""
    south, west = FENCE_DEG[0]
    north, east = FENCE_DEG[2]
    margin_deg = 4.98 / M_PER_DEG
    numbers = [sent.depth_m, sent.altitude_m, sent.heading_deg, sent.speed_mps, *(sent.place_deg or ())]
    faults = {
        "not finite": not all(math.isfinite(value) for value in numbers if value is not None),
        "towards the floor": sent.depth_m is not None and not sent.depth_m <= floor_m - MIN_ALTITUDE_M,
        "deeper than allowed": sent.depth_m is not None and not 0.0 <= sent.depth_m <= MAX_DEPTH_M,
        "lower than allowed": sent.altitude_m is not None and not sent.altitude_m >= MIN_ALTITUDE_M - 1e-3,
        "too deep over this floor": sent.altitude_m is not None
        and not floor_m - sent.altitude_m <= MAX_DEPTH_M + MARGIN_M,
        "too fast": sent.speed_mps is not None and not 0.0 < sent.speed_mps <= SPEED_MPS + 1e-9,
        "no heading": sent.heading_deg is not None and not 0.0 <= sent.heading_deg < 360.0,
        "held too long": sent.holds_s is not None and not 0.0 < sent.holds_s <= 5.0,
        "out of the fence": sent.place_deg is not None
        and not (
            south + margin_deg <= sent.place_deg[0] <= north - margin_deg
            and west + 1.49 * margin_deg <= sent.place_deg[1] <= east - 1.49 * margin_deg
        ),
    }
    return [why for why, is_wrong in faults.items() if is_wrong]


def fly_voyage(number: int) -> tuple[Counter[str], list[str]]:
    """Fly the drawn histories of this number, one after the other, and return counts and what was wrong."""
    source = random.Random(number)
    name = sorted(VEHICLES)[number % len(VEHICLES)]
    histories = [drawn(source, SHORT_S if n else LONG_S) for n in range(N_TOGETHER)]
    wrong, n_commands = fly(name, histories)
    counts = Counter({f"{name} histories": N_TOGETHER, f"{name} commands": n_commands, f"{name} wrong": len(wrong)})
    return counts, [f"voyage {number}: {fault}" for fault in wrong]


def main(n_histories: int) -> int:
    """Fly histories on all cores, and print what was wrong."""
    counts: Counter[str] = Counter()
    wrong: list[str] = []
    with ProcessPoolExecutor(os.cpu_count(), initializer=logging.disable) as pool:
        voyages = pool.map(fly_voyage, range(-(-n_histories // N_TOGETHER)), chunksize=5)
        for number, (some, faults) in enumerate(voyages, start=1):
            counts.update(some)
            wrong += faults
            print(*faults, sep="\n", end="\n" if faults else "", flush=True)
            if number % 50 == 0:
                print(f"{number * N_TOGETHER} histories, {len(wrong)} commands wrong", flush=True)
    for what, count in sorted(counts.items()):
        print(f"{what}: {count}")
    print(f"{len(wrong)} commands were wrong in {sum(counts[f'{name} histories'] for name in VEHICLES)} histories")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1])))
