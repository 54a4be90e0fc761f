"""Merge several navigation units into one track.

Feed it fixes in the order of their arrival; out come navigation samples in the order of their times, and notices. It
has no clock: its output depends on the fixes and stamps alone. A quantity is taken from one unit at a time and never
repeated; positions go on by dead reckoning when all units have lost them.
"""

from __future__ import annotations

import heapq
import math
from collections import Counter
from typing import Any, Final, NamedTuple, TypeAlias

from msgspec import structs

from auv_mcm.clock import Stamp
from auv_mcm.geometry.fix import JUMP_SLACK_M
from auv_mcm.geometry.fix_agreement import FixAgreement
from auv_mcm.geometry.sample_values import MAX_SPEED_MPS
from auv_mcm.records import NAN, NavSample, Notice
from auv_mcm.settings.port_settings import QUANTITIES, NavUnitSettings, Quantity
from drivers.clocks import DeviceClock, wire_delay_s
from drivers.navigation.corrections import (
    AttitudeReading,
    HeadingReading,
    Position,
    Readings,
    arm_north_east_down,
    moved,
    offset_m,
    readings_of,
)
from drivers.navigation.given import N_SIGMA, SLACK, Channel, Given, apart_m, difference, sample_of
from drivers.navigation.health import Fallback
from drivers.navigation.nav_decoder import NavFix
from drivers.navigation.nav_settings import NavMergeSettings
from drivers.navigation.reckoning import MAX_HOLD_S, Reckoner
from drivers.navigation.thinning import Thinning

Event: TypeAlias = NavSample | Notice

_QUEUE_SLACK_S: Final = 0.25  # beyond the longest latency, for links of unequal speed
_RECKONING_PERIOD_S: Final = 0.1  # s between reckoned positions
_RECKONING_STEPS_M: Final = (10.0, 20.0, 50.0, 100.0, 200.0, 500.0)  # 1-sigma at which a person should know
_LOST_AFTER_S: Final = 2.0 * MAX_HOLD_S  # without a position, measured or reckoned
_RECKONED_SHARE: Final = 0.2  # of the way: a speed or course that far off is wrong, whatever the current
_COMPARE_S: Final = 0.5  # values farther apart in time are not compared
_N_DISAGREE: Final = 5  # in a row, before a notice is raised; as many that agree end it
_N_IMPOSSIBLE: Final = (
    20  # values in a row, 2 s at 10 Hz: a bottom lock is lost for longer than a ping, a sentence damaged only once
)
_FIELDS: Final[dict[Quantity, tuple[str, ...]]] = {
    "position": ("latitude_deg", "longitude_deg"),
    "heading": ("heading_rad",),
    "attitude": ("pitch_rad", "roll_rad"),
    "depth": ("depth_m",),
    "altitude": ("altitude_m",),
    "speed": ("speed_mps",),
}
_UNITS: Final = {"deg": "degrees", "rad": "rad", "m": "m", "mps": "m/s"}
_MAX_UNKNOWN: Final = 32  # sources; bounds memory where a damaged bus invents them
_TICK_S: Final = 1e-3  # s: times nearer than that are the same


class QuantityHealth(NamedTuple):
    """Hold the state of a quantity.

    serving: the unit that delivers it now; None if none does. age_s: since its last value, by source, inf if it was
    refused always.
    """

    serving: str | None
    age_s: dict[str, float]


class NavMerge:
    """Merge several units' fixes into one stream of samples.

    `counters`, by quantity and source: nav.impossible.*, .same_instant.*, .jump.*, .refix.*, .gnss_<doubt>.*,
    .disagree.*, .thinned.*; by source: nav.not_valid.*, .clock_anchored_anew.*; nav.unknown_source, .too_late,
    .lever_arm_unknown, .reckoned.
    """

    def __init__(self, settings: NavMergeSettings) -> None:
        self.counters: Counter[str] = Counter()
        self.position_sigma_m = NAN  # of the newest sample with a position
        self._settings = settings
        self._channels: dict[tuple[Quantity, str], Channel] = {}
        self._fallbacks = {quantity: Fallback(settings.recover_s) for quantity in QUANTITIES}
        self._clocks: dict[str, DeviceClock] = {}
        self._unknown: set[str] = set()
        self._n_impossible: dict[tuple[Quantity, str], int] = {}  # in a row
        self._impossible_reported: set[tuple[Quantity, str]] = set()
        self._reckoner = Reckoner()
        self._thinning = Thinning()
        self._lost: set[Quantity] = set()
        self._reckoned_s = -math.inf
        self._position_s = -math.inf  # of the newest position, measured or reckoned
        self._reckoning = self._position_lost = False
        self._n_steps_reported = 0
        self._reckoned_off = False  # reported that dead reckoning ended far from the next position
        self._now_s = self._last_utc_s = -math.inf
        self._hold_s = _QUEUE_SLACK_S + max((unit.latency_s for unit in settings.units.values()), default=0.0)
        self._queue: list[tuple[float, int, NavSample, bool]] = []  # and whether it was reckoned
        self._n_queued = 0
        self._released_s = -math.inf  # monotonic

    def feed(self, fix: NavFix) -> list[Event]:
        """Take a fix; return the samples that are due, and notices."""
        events = self.advance(fix.received)
        unit = self._settings.unit(fix.source)
        if unit is None:
            return events + self._unknown_source(fix.source)
        if not fix.valid:
            self.counters[f"nav.not_valid.{fix.source}"] += 1
        age_s = self._age_s(fix, unit, events)
        time_s = fix.received.mono_ns * 1e-9 - age_s
        utc_s = fix.received.utc_ns * 1e-9 - age_s
        readings, impossible = readings_of(fix, unit)
        events += self._refuse(impossible, readings, fix)
        delivered = {
            quantity: reading
            for quantity, reading in zip(QUANTITIES, readings, strict=True)
            if reading is not None and quantity in unit.delivers
        }
        served: dict[Quantity, Any] = {}
        leap: Position | None = None
        # Positions last: they are judged and moved by the others.
        for quantity in sorted(delivered, key=lambda name: name == "position"):
            reading: Any = delivered[quantity]
            channel = self._channel(quantity, fix.source, unit)
            if self._repeats(channel, fix, quantity):
                continue
            if quantity == "position":
                measured = self._without_arm(reading, unit)
                reading = self._believed(channel, time_s, reading, measured)
                if reading is None and self._is_for_perception(channel, time_s, measured):
                    leap = measured
            elif quantity == "speed" and unit.surface_only and self._submerged(fix.source):
                reading = None
            elif quantity == "depth" or quantity == "altitude":
                reading = self._vertical(quantity, reading, unit)
            if reading is None:
                continue
            channel.given = Given(time_s, reading)
            channel.health.gave(self._now_s)
            events += self._choose(quantity)
            if self._fallbacks[quantity].serving is channel.health:
                served[quantity] = reading
            else:
                events += self._compare(quantity, channel)
            if quantity in served:
                events += self._compare_reckoned(reading) if quantity == "position" else []
                self._reckon_with(quantity, time_s, reading)
        given = self._thinned(time_s, served if leap is None else {**served, "position": leap}, fix.source)
        if given:
            self._put(time_s, sample_of(utc_s, given, position_leaps=leap is not None and "position" in given))
        if "position" in served:
            self._position_s, self.position_sigma_m = time_s, served["position"].sigma_m
            events += self._position_back(time_s)
        elif "heading" in served or "speed" in served:
            events += self._reckon(fix.received)
        return events + self._due()

    def advance(self, stamp: Stamp) -> list[Event]:
        """Take the passing of time without a fix; return what is due, and notices of what went missing."""
        now_s = stamp.mono_ns * 1e-9
        events: list[Event] = []
        if now_s > self._now_s + _TICK_S:
            self._now_s = now_s
            for quantity in QUANTITIES:
                events += self._choose(quantity)
            if "position" in self._lost and now_s - self._position_s > _LOST_AFTER_S:
                events += self._report_position_lost()
            events += self._due()
        return events

    def finish(self) -> list[Event]:
        """End the stream; return every sample still held back."""
        self._now_s = math.inf
        return self._due()

    def health(self) -> dict[Quantity, QuantityHealth]:
        """Return who serves each quantity and the age of each unit's newest value, as of the newest stamp."""
        health = {}
        for quantity, fallback in self._fallbacks.items():
            serving = None if fallback.serving is None else fallback.serving.source
            health[quantity] = QuantityHealth(
                serving, {unit.source: self._now_s - unit.last_s for unit in fallback.units}
            )
        return health

    def _refuse(self, impossible: list[Quantity], readings: Readings, fix: NavFix) -> list[Event]:
        """Count impossible values; report a unit that goes on sending them once per quantity."""
        events: list[Event] = []
        for quantity, reading in zip(QUANTITIES, readings, strict=True):
            if reading is not None:
                self._n_impossible.pop((quantity, fix.source), None)
        for quantity in impossible:
            self.counters[f"nav.impossible.{quantity}.{fix.source}"] += 1
            if quantity == "position" and fix.latitude_deg == fix.longitude_deg == 0.0:
                continue  # a receiver that waits for its first fix
            key = (quantity, fix.source)
            self._n_impossible[key] = self._n_impossible.get(key, 0) + 1
            if self._n_impossible[key] < _N_IMPOSSIBLE or key in self._impossible_reported:
                continue
            self._impossible_reported.add(key)
            values = ", ".join(
                f"{name.rpartition('_')[0]} {getattr(fix, name):g} {_UNITS[name.rpartition('_')[2]]}"
                for name in _FIELDS[quantity]
            )
            text = f"'{fix.source}' sends an impossible {quantity} ({values}); it is rejected. "
            text += "Check the unit's settings, sensor and wiring."
            events.append(Notice(code="nav_impossible", text=text))
        return events

    def _unknown_source(self, source: str) -> list[Event]:
        self.counters["nav.unknown_source"] += 1
        if source in self._unknown or len(self._unknown) >= _MAX_UNKNOWN:
            return []
        self._unknown.add(source)
        text = (
            f"navigation unit '{source}' sends data, but is not configured: its data is rejected. Configure "
            "it, or ignore this notice."
        )
        return [Notice(code="nav_unit_unknown", text=text)]

    def _age_s(self, fix: NavFix, unit: NavUnitSettings, events: list[Event]) -> float:
        """Return the age of a measurement at its arrival, in seconds."""
        delay_s = unit.latency_s + wire_delay_s(fix.n_bytes, unit.baud)
        if not unit.use_unit_time or fix.time_utc_s is None:
            return delay_s + fix.age_s
        clock = self._clocks.get(fix.source)
        if clock is None:
            clock = self._clocks[fix.source] = DeviceClock(f"navigation unit '{fix.source}'")
        host_time = clock.host_time(fix.time_utc_s, fix.received, delay_s=delay_s + fix.age_s)
        if n_anchored_anew := clock.counters["clock.anchored_anew"]:
            self.counters[f"nav.clock_anchored_anew.{fix.source}"] = n_anchored_anew
        events += [] if host_time.notice is None else [host_time.notice]
        return (fix.received.mono_ns - host_time.mono_ns) * 1e-9

    def _channel(self, quantity: Quantity, source: str, unit: NavUnitSettings) -> Channel:
        channel = self._channels.get((quantity, source))
        if channel is None:
            channel = self._channels[quantity, source] = Channel(
                source, unit, self._settings.surface_depth_m, FixAgreement(apart_m, self._reach_m, span_s=0.0)
            )
            self._fallbacks[quantity].add(channel.health)
        return channel

    def _repeats(self, channel: Channel, fix: NavFix, quantity: Quantity) -> bool:
        """Return whether the unit repeats an instant: another sentence of one epoch, or a unit that hangs."""
        if fix.time_utc_s is not None and fix.time_utc_s == channel.unit_time_s:
            self.counters[f"nav.same_instant.{quantity}.{fix.source}"] += 1
            return True
        channel.unit_time_s = fix.time_utc_s
        return False

    def _fresh(self, quantity: Quantity) -> Any:
        """Return the serving unit's last value, if it is still valid."""
        serving = self._fallbacks[quantity].serving
        is_fresh = serving is not None and serving.is_healthy(self._now_s)
        given = self._channels[quantity, serving.source].given if serving is not None and is_fresh else None
        return None if given is None else given.value

    def _arm(self, unit: NavUnitSettings) -> tuple[float, float, float] | None:
        """Return the lever arm in north, east, down; None if it needs a heading and there is none."""
        heading: HeadingReading | None = self._fresh("heading")
        attitude: AttitudeReading = self._fresh("attitude") or AttitudeReading(0.0, 0.0)
        if heading is None and unit.lever_arm_m[:2] != (0.0, 0.0):
            self.counters["nav.lever_arm_unknown"] += 1
            return None
        return arm_north_east_down(unit.lever_arm_m, 0.0 if heading is None else heading.heading_rad, *attitude)

    def _without_arm(self, position: Position, unit: NavUnitSettings) -> Position:
        """Return the position of the reference; without a heading, of the antenna, with the arm's length as error."""
        if unit.lever_arm_m == (0.0, 0.0, 0.0):
            return position
        arm = self._arm(unit)
        if arm is None:
            return position._replace(sigma_m=math.hypot(position.sigma_m, *unit.lever_arm_m[:2]), is_stated=True)
        north_m, east_m, _ = arm
        return Position(*moved(position.latitude_deg, position.longitude_deg, -east_m, -north_m), *position[2:])

    def _vertical(self, quantity: Quantity, value_m: float, unit: NavUnitSettings) -> float:
        if unit.lever_arm_m == (0.0, 0.0, 0.0):
            return value_m
        attitude: AttitudeReading = self._fresh("attitude") or AttitudeReading(0.0, 0.0)
        down_m = arm_north_east_down(unit.lever_arm_m, 0.0, *attitude)[2]
        return value_m - down_m if quantity == "depth" else value_m + down_m

    def _believed(self, channel: Channel, time_s: float, antenna: Position, position: Position) -> Position | None:
        """Accept the position, unless a satellite receiver cannot have it or the vehicle cannot have got there."""
        source = channel.health.source
        if channel.watch is not None:
            travelled, depth_m = self._reckoner.travelled(time_s), self._fresh("depth")
            channel.doubt = channel.watch.doubt(time_s, antenna, position, depth_m, travelled)
            if channel.doubt == "not_the_way_made" and depth_m is not None:  # at the surface it may be right
                self._reckoner.contradict(time_s, position)
            if channel.doubt is not None:
                self.counters[f"nav.gnss_{channel.doubt}.{source}"] += 1
                return None
        decision = channel.agreement.add(Given(time_s, position))
        if decision.accepted and decision.step_m == 0.0:
            return position
        self.counters[f"nav.jump.{source}"] += 1
        if not decision.accepted:
            return None
        self.counters[f"nav.refix.{source}"] += 1  # reported by perception, once it follows
        return position

    def _is_for_perception(self, channel: Channel, time_s: float, position: Position) -> bool:
        """Check whether perception has to see a position that was not believed, to find that two places alternate.

        What it would take for a motion stays out, and so does what a satellite receiver under water cannot have.
        """
        serving, last = self._fallbacks["position"].serving, channel.agreement.last
        if channel.doubt is not None or last is None or serving not in (None, channel.health):
            return False
        reach_m = JUMP_SLACK_M + MAX_SPEED_MPS * abs(time_s - last.time_s)
        return apart_m(last, Given(time_s, position)) > reach_m

    def _submerged(self, source: str) -> bool:
        """Return whether a satellite receiver is under water, or sends positions as if it were."""
        depth_m = self._fresh("depth")
        channel = self._channels.get(("position", source))
        return (depth_m is not None and depth_m > self._settings.surface_depth_m) or (
            channel is not None and channel.doubt is not None
        )

    def _reach_m(self, before: Given, after: Given) -> float:
        slack_m = JUMP_SLACK_M + N_SIGMA * math.hypot(before.value.sigma_m, after.value.sigma_m)
        return slack_m + self._settings.max_speed_mps * abs(after.time_s - before.time_s)

    def _choose(self, quantity: Quantity) -> list[Event]:
        """Let the best healthy unit serve; raise a notice if it is another one than before."""
        fallback = self._fallbacks[quantity]
        before = fallback.serving
        now = fallback.choose(self._now_s)
        if now is before:
            return []
        if now is None and before is not None:
            self._lost.add(quantity)
            if quantity == "position":
                return []  # reported with its consequence: dead reckoning or nothing
            text = (
                f"{quantity} is lost: '{before.source}' gave none for {before.valid_s:g} s and no other unit does. "
                "Check its cable."
            )
            return [Notice(code="nav_quantity_lost", text=text)]
        if now is None:
            return []
        if before is None:
            was_reported = quantity in self._lost and quantity != "position"
            self._lost.discard(quantity)
            return (
                [Notice(code="nav_quantity_back", text=f"{quantity} is back, from '{now.source}'")]
                if was_reported
                else []
            )
        if before.is_healthy(self._now_s) and fallback.is_starting(now):
            return []  # nothing failed: the units start one after the other
        why = "which is better and has been healthy for a while"
        if not before.is_healthy(self._now_s):
            why = f"because '{before.source}' gave none for {before.valid_s:g} s. Check its cable and its power."
        text = f"{quantity} now comes from '{now.source}', {why}"
        return [Notice(code="nav_source_changed", text=text, for_the_record=before.is_healthy(self._now_s))]

    def _compare(self, quantity: Quantity, channel: Channel) -> list[Event]:
        """Compare a unit that does not serve with the one that does."""
        serving = self._fallbacks[quantity].serving
        reference = None if serving is None else self._channels[quantity, serving.source].given
        given = channel.given
        if serving is None or reference is None or given is None or abs(given.time_s - reference.time_s) > _COMPARE_S:
            return []
        apart = difference(quantity, given, reference, self._settings.max_speed_mps)
        if apart <= SLACK[quantity]:
            channel.n_disagree = max(channel.n_disagree - 1, 0)
            channel.disagrees = channel.disagrees and channel.n_disagree > 0
            return []
        self.counters[f"nav.disagree.{quantity}.{channel.health.source}"] += 1
        channel.n_disagree = min(channel.n_disagree + 1, _N_DISAGREE)
        if channel.disagrees or channel.n_disagree < _N_DISAGREE:
            return []
        channel.disagrees = True
        text = (
            f"{quantity} of '{channel.health.source}' and '{serving.source}' differ by more than their errors; "
            f"'{serving.source}' is used. "
        )
        return [Notice(code="nav_disagreement", text=text + "Check signs, offsets and mounting of both.")]

    def _compare_reckoned(self, position: Position) -> list[Event]:
        """Report once that dead reckoning ended far from where the vehicle is, by more than both errors."""
        reckoned = self._reckoner.position() if self._reckoning and not self._reckoned_off else None
        if reckoned is None:
            return []
        off_m = math.hypot(*offset_m(reckoned[1][:2], position[:2]))
        way_m = self._reckoner.way_m()
        if off_m <= N_SIGMA * math.hypot(position.sigma_m, reckoned[1].sigma_m) + _RECKONED_SHARE * way_m:
            return []
        self._reckoned_off = True
        text = (
            f"dead reckoning over {way_m:.0f} m ended {off_m:.0f} m from the next position: contacts between may be "
            "off by as much. Check the speed's source and unit, and the heading."
        )
        return [Notice(code="nav_reckoning_off", text=text)]

    def _reckon_with(self, quantity: Quantity, time_s: float, reading: Any) -> None:
        if quantity == "heading":
            self._reckoner.turn(time_s, reading)
        elif quantity == "speed":
            self._reckoner.run(time_s, reading)
        elif quantity == "position":
            self._reckoner.fix(time_s, reading)

    def _reckon(self, stamp: Stamp) -> list[Event]:
        """Return a position by dead reckoning, if no unit has one and the next is due."""
        fallback = self._fallbacks["position"]
        if fallback.serving is not None or not fallback.units:
            return []
        reckoned = self._reckoner.position()
        if reckoned is None:
            return self._report_position_lost()
        time_s, position = reckoned
        if time_s - self._reckoned_s < _RECKONING_PERIOD_S:
            return []
        self._reckoned_s = self._position_s = time_s
        self.counters["nav.reckoned"] += 1
        self.position_sigma_m = position.sigma_m
        utc_s = stamp.utc_ns * 1e-9 - (stamp.mono_ns * 1e-9 - time_s)
        self._put(time_s, sample_of(utc_s, {"position": position}), is_reckoned=True)
        events: list[Event] = []
        if not self._reckoning:
            self._reckoning, self._position_lost = True, False
            self._n_steps_reported = sum(step_m <= position.sigma_m for step_m in _RECKONING_STEPS_M)
            text = f"no unit gives a plausible position{self._doubts()}: dead reckoning by heading and speed, "
            text += f"1-sigma {position.sigma_m:.1f} m and growing"
            events.append(Notice(code="nav_dead_reckoning", text=text))
        elif (
            self._n_steps_reported < len(_RECKONING_STEPS_M)
            and position.sigma_m >= _RECKONING_STEPS_M[self._n_steps_reported]
        ):
            self._n_steps_reported += 1
            text = f"still dead reckoning by heading and speed: 1-sigma of the position is {position.sigma_m:.0f} m"
            events.append(Notice(code="nav_dead_reckoning", text=text))
        return events

    def _report_position_lost(self) -> list[Event]:
        if self._position_lost:
            return []
        self._reckoning, self._position_lost = False, True
        text = f"no unit gives a plausible position{self._doubts()}, and dead reckoning needs a heading and a speed"
        return [Notice(code="nav_position_lost", text=text)]

    def _doubts(self) -> str:
        doubts = [
            f"{source}: {channel.doubt.replace('_', ' ')}"
            for (_, source), channel in self._channels.items()
            if channel.doubt
        ]
        return f" ({', '.join(doubts)})" if doubts else ""

    def _position_back(self, time_s: float) -> list[Event]:
        if not (self._reckoning or self._position_lost):
            return []
        self._queue = [queued for queued in self._queue if not (queued[3] and queued[0] >= time_s)]  # from an older fix
        heapq.heapify(self._queue)
        self._reckoning = self._position_lost = False
        serving = self._fallbacks["position"].serving
        name = "" if serving is None else f" from '{serving.source}'"
        return [
            Notice(code="nav_position_back", text=f"positions come{name} again, 1-sigma {self.position_sigma_m:.1f} m")
        ]

    def _thinned(self, time_s: float, served: dict[Quantity, Any], source: str) -> dict[Quantity, Any]:
        """Leave out what comes more often than it can be used: a chatty unit must not take the room of pings."""
        taken = {quantity: reading for quantity, reading in served.items() if self._thinning.takes(quantity, time_s)}
        for quantity in served.keys() - taken.keys():
            self.counters[f"nav.thinned.{quantity}.{source}"] += 1
        return taken

    def _put(self, time_s: float, sample: NavSample, is_reckoned: bool = False) -> None:
        if time_s < self._released_s:
            self.counters["nav.too_late"] += 1
            return
        heapq.heappush(self._queue, (time_s, self._n_queued, sample, is_reckoned))
        self._n_queued += 1

    def _due(self) -> list[Event]:
        """Return the samples that no later fix can precede."""
        due: list[Event] = []
        while self._queue and self._queue[0][0] <= self._now_s - self._hold_s:
            self._released_s, _, sample, _ = heapq.heappop(self._queue)
            # Two readings of two clocks are never exactly as far apart, so equal instants may differ by microseconds.
            if 0.0 < self._last_utc_s - sample.time_s < _TICK_S:
                sample = structs.replace(sample, time_s=self._last_utc_s)
            self._last_utc_s = sample.time_s
            due.append(sample)
        return due
