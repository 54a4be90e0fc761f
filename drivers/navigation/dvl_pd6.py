"""Decode DVL text groups, PD6: lines `:SA`, `:TS`, `:BI`, `:BS`, `:BE`, `:BD` of one ping, without a checksum.

Teledyne RD Instruments, "Pathfinder DVL Guide", output data formats; Nortek and Water Linked send the same. `:` never
occurs inside a line, so whatever came before an intact line cannot swallow it; what damage leaves readable must still
be plausible.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from typing import Any, Final, NamedTuple, TypeAlias

from auv_mcm.clock import Stamp
from auv_mcm.records import NAN
from drivers.framing import Grammar, StampedFramer, StampedMessage
from drivers.message_candidates import MessageCandidates
from drivers.navigation.nav_decoder import NavFix

_MAX_LINE_BYTES: Final = 128  # of a line; bounds how long junk can hold one back
_BODY: Final = rb"[\x20-\x39\x3b-\x7e]"
_LINE: Final = re.compile(rb":([A-Z]{2}),(%b{0,%d})[\r\n]" % (_BODY, _MAX_LINE_BYTES - 5))
_RUN: Final = re.compile(rb":%b*" % _BODY)
_CANDIDATES: Final = MessageCandidates(
    (b":",),
    alive=rb":(?:[A-Z]{2},%b{0,%d}+[\r\n]|%b{0,%d}+\Z)" % (_BODY, _MAX_LINE_BYTES - 5, _BODY, _MAX_LINE_BYTES - 2),
    dead=rb"((?::(?=:))++)|:(?:(%b{%d})|%b*+(?:(?=(:))|(?=([\x80-\xff]))|()))" % (_BODY, _MAX_LINE_BYTES - 1, _BODY),
    reasons=("interrupted", "oversize", "interrupted", "non_ascii", "malformed"),
)
_NUMBER: Final = re.compile(r" *[+-]? *(?:\d+\.?\d*|\.\d+) *")
_BIT: Final = re.compile(r" *([0-9A-Fa-f]{1,4}) *")  # how many errors and one's code, as 12A: Pathfinder DVL Guide
_BAD_VELOCITY: Final = -32768.0  # mm/s: what PD6 gives for a velocity that is not measured
_MAX_VELOCITY_MM_S: Final = 20_000.0  # mm/s: faster than any vehicle or lock on the bottom
_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)


class Pd6Attitude(NamedTuple):
    """Hold attitude (`:SA`)."""

    pitch_rad: float
    roll_rad: float
    heading_rad: float


class Water(NamedTuple):
    """Hold :TS. bit: result of the built-in test, 0 if good."""

    time_utc_s: float
    salinity_ppt: float
    temperature_c: float
    depth_m: float
    sound_speed_mps: float
    bit: int = 0


class InstrumentVelocity(NamedTuple):
    """Hold :BI, over ground along the instrument's axes; NaN where good is False."""

    x_mps: float
    y_mps: float
    z_mps: float
    error_mps: float
    good: bool


class ShipVelocity(NamedTuple):
    """Hold :BS, over ground: to starboard, forward, normal; NaN where good is False."""

    starboard_mps: float
    forward_mps: float
    normal_mps: float
    good: bool


class EarthVelocity(NamedTuple):
    """Hold :BE, over ground; NaN where good is False."""

    east_mps: float
    north_mps: float
    up_mps: float
    good: bool


class Bottom(NamedTuple):
    """Hold :BD, distance made good since power-up, range to the bottom, time since the last good velocity."""

    east_m: float
    north_m: float
    up_m: float
    range_m: float
    since_good_s: float


Line: TypeAlias = Pd6Attitude | Water | InstrumentVelocity | ShipVelocity | EarthVelocity | Bottom


class LineGrammar(Grammar[tuple[str, str]]):
    """Frame lines; a message is a line's kind and its comma-separated fields."""

    name = "pd6"
    head_bytes = 1
    max_message_bytes = _MAX_LINE_BYTES
    proven = True  # not its numbers, but where it begins and ends
    find = staticmethod(_CANDIDATES.find)

    def read(self, buffer: bytearray, at: int) -> tuple[tuple[str, str], int] | int | str:
        match = _LINE.match(buffer, at)
        if match is not None:
            kind, fields = match.groups()
            return (kind.decode("ascii"), fields.decode("ascii")), match.end() - at
        run = _RUN.match(buffer, at)
        assert run is not None  # `find` saw its first character
        end = run.end()
        if end - at >= _MAX_LINE_BYTES:
            return "oversize"
        if end == len(buffer):
            return end - at + 1
        stop = buffer[end]
        if stop == ord(":"):
            return "interrupted"
        return "non_ascii" if stop >= 0x80 else "malformed"


class Pd6Unit:
    """Decode one link's groups to fixes. Never raises, whatever the bytes.

    `counters`: those of the framer (`pd6.*`), `.implausible` (lines), `.ignored` (kinds not known here),
    `.no_bottom_lock` (groups).
    """

    def __init__(self, source: str) -> None:
        self._source = source
        self._framer = StampedFramer(LineGrammar())
        self._own: Counter[str] = Counter()
        self._first: StampedMessage[tuple[str, str]] | None = None
        self._group: dict[type, Any] = {}

    @property
    def counters(self) -> Counter[str]:
        return self._framer.counters + self._own

    def feed(self, data: bytes, stamp: Stamp) -> list[NavFix]:
        """Return what a chunk completes, in order. stamp: when its last byte was read."""
        return [fix for arrived in self._framer.feed(data, stamp) for fix in self._add(arrived)]

    def finish(self) -> list[NavFix]:
        """Return what still waited at the end of a log or link."""
        return [fix for arrived in self._framer.finish() for fix in self._add(arrived)] + self._end()

    def _add(self, arrived: StampedMessage[tuple[str, str]]) -> list[NavFix]:
        try:
            line = parse_line(*arrived.message)
        except ValueError:
            self._own["pd6.implausible"] += 1
            return []
        if line is None:
            self._own["pd6.ignored"] += 1
            return []
        begins = isinstance(line, Pd6Attitude) or (isinstance(line, Water) and self._group.keys() != {Pd6Attitude})
        done = self._end() if begins or type(line) in self._group else []
        if self._first is None:
            self._first = arrived
        self._group[type(line)] = line
        return done + self._end() if isinstance(line, Bottom) else done

    def _end(self) -> list[NavFix]:
        first, self._first = self._first, None
        group, self._group = self._group, {}
        if first is None:
            return []
        fix_fields: dict[str, Any] = {}
        are_good = [
            line.good for line in group.values() if isinstance(line, InstrumentVelocity | ShipVelocity | EarthVelocity)
        ]
        lock = any(are_good) or not are_good  # in axes that a DVL does not know it calls the same velocity bad
        if not lock:
            self._own["pd6.no_bottom_lock"] += 1
        for kind in (Pd6Attitude, Water, InstrumentVelocity, ShipVelocity, EarthVelocity, Bottom):
            if kind in group and getattr(group[kind], "good", True):
                fix_fields.update(_fix_fields(group[kind]))
        if not lock:
            fix_fields.update(altitude_m=NAN, valid=False)
        water, attitude = group.get(Water), group.get(Pd6Attitude)
        if water is not None and not (water.salinity_ppt or water.temperature_c or water.depth_m):
            fix_fields["depth_m"] = NAN  # zeros stand for no sensor, as in Water Linked's PD6
            if attitude is not None and not any(attitude):
                fix_fields.update(heading_rad=NAN, pitch_rad=NAN, roll_rad=NAN)
        return [NavFix(source=self._source, received=first.received, n_bytes=first.n_bytes, **fix_fields)]


def _fix_fields(line: Line) -> dict[str, Any]:
    match line:
        case Pd6Attitude():
            return {"pitch_rad": line.pitch_rad, "roll_rad": line.roll_rad, "heading_rad": line.heading_rad}
        case Water():
            return {"time_utc_s": line.time_utc_s, "depth_m": line.depth_m}
        case InstrumentVelocity():
            return {
                "speed_mps": math.hypot(line.x_mps, line.y_mps)
            }  # the axes point anywhere: a speed, not a direction
        case ShipVelocity():
            return {
                "speed_mps": math.hypot(line.starboard_mps, line.forward_mps),
                "drift_rad": math.atan2(line.starboard_mps, line.forward_mps),
            }
        case EarthVelocity():
            return {
                "speed_mps": math.hypot(line.east_mps, line.north_mps),
                "course_rad": math.atan2(line.east_mps, line.north_mps) % (2.0 * math.pi),
            }
        case Bottom():
            return {"altitude_m": line.range_m if line.range_m > 0.0 else NAN}


def parse_line(kind: str, fields: str) -> Line | None:
    """Decode a line to its record; None for an unknown kind. Raises ValueError for what cannot be true."""
    texts = fields.split(",")
    match kind:
        case "SA":
            pitch, roll, heading = _numbers(texts, 3, (90.0, 180.0, 360.0))
            return Pd6Attitude(math.radians(pitch), math.radians(roll), math.radians(heading))
        case "TS":
            time_utc_s = _read_time(texts[0])
            salinity, temperature, depth, sound_speed = _numbers(texts[1:-1], 4, (50.0, 60.0, 12_000.0, 1700.0))
            bit = _BIT.fullmatch(texts[-1])
            if sound_speed < 1300.0 or bit is None:
                raise ValueError(f"sound speed {sound_speed}, result of the test {texts[-1]}")
            return Water(time_utc_s, salinity, temperature, depth, sound_speed, int(bit[1], 16))
        case "BI":
            return InstrumentVelocity(*_velocities(texts, 4))
        case "BS":
            return ShipVelocity(*_velocities(texts, 3))
        case "BE":
            return EarthVelocity(*_velocities(texts, 3))
        case "BD":
            return Bottom(*_numbers(texts, 5, (1e8, 1e8, 1e8, 12_000.0, 1e6)))
    return None


def line_of(line: Line) -> bytes:
    """Encode a record as a line, with CR LF."""
    match line:
        case Pd6Attitude():
            text = ":SA," + ",".join(f"{math.degrees(angle):+06.2f}" for angle in line)
        case Water():
            hundredths = round(line.time_utc_s * 100.0)
            when = _EPOCH + timedelta(seconds=hundredths // 100)
            text = f":TS,{when:%y%m%d%H%M%S}{hundredths % 100:02d},{line.salinity_ppt:.1f},{line.temperature_c:+.1f}"
            text += f",{line.depth_m:06.1f},{line.sound_speed_mps:06.1f},{line.bit:03X}"
        case InstrumentVelocity() | ShipVelocity() | EarthVelocity():
            kind = {InstrumentVelocity: "BI", ShipVelocity: "BS", EarthVelocity: "BE"}[type(line)]
            *velocities, good = line
            text = f":{kind}," + ",".join(
                f"{velocity * 1e3 if good else _BAD_VELOCITY:+06.0f}" for velocity in velocities
            )
            text += ",A" if good else ",V"
        case Bottom():
            moved = f"{line.east_m:+012.2f},{line.north_m:+012.2f},{line.up_m:+012.2f}"
            text = f":BD,{moved},{line.range_m:07.2f},{line.since_good_s:06.2f}"
    return text.encode("ascii") + b"\r\n"


def _numbers(texts: Sequence[str], count: int, limits: Sequence[float]) -> list[float]:
    if len(texts) != count:
        raise ValueError(f"{len(texts)} fields instead of {count}")
    values = [_number(text) for text in texts]
    if any(abs(value) > limit for value, limit in zip(values, limits, strict=True)):
        raise ValueError(f"out of range: {texts}")
    return values


def _number(text: str) -> float:
    if _NUMBER.fullmatch(text) is None:
        raise ValueError(f"not a number: {text}")
    return float(text.replace(" ", ""))


def _velocities(texts: Sequence[str], count: int) -> list[Any]:
    """Return velocities in m/s from mm/s, and whether they are good."""
    if len(texts) != count + 1 or texts[-1] not in ("A", "V"):
        raise ValueError(f"not {count} velocities and A or V: {texts}")
    values = [_number(text) for text in texts[:-1]]
    if texts[-1] == "V" or _BAD_VELOCITY in values[:2]:
        return [NAN] * count + [False]
    if any(abs(value) > _MAX_VELOCITY_MM_S for value in values if value != _BAD_VELOCITY):
        raise ValueError(f"out of range: {texts}")
    return [NAN if value == _BAD_VELOCITY else value * 1e-3 for value in values] + [True]


def _read_time(text: str) -> float:
    """Read a time as YYMMDDHHmmsshh."""
    if len(text) != 14 or not text.isdecimal():
        raise ValueError(f"not a time: {text}")
    year, month, day, hour, minute, second, hundredth = (int(text[at : at + 2]) for at in range(0, 14, 2))
    return (
        datetime(2000 + year, month, day, hour, minute, second, tzinfo=UTC) - _EPOCH
    ).total_seconds() + hundredth * 1e-2
