"""Read navigation from where XTF logs hold it: packets of their own, the ship's fields, projected coordinates.

Layouts are pyxtf's (Triton Imaging, "eXtended Triton Format", rev. 42): packets 107 (POS_RAW_NAVIGATION), 42
(navigation), 84 (gyro), 3 (attitude) and 6 (a sentence as it came over a serial line). Angles there are degrees.
"""

from __future__ import annotations

import math
import struct
from collections import deque
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from struct import Struct
from typing import Final, NamedTuple, TypeAlias

from auv_mcm.clock import Stamp
from auv_mcm.errors import UsageError
from auv_mcm.records import NAN, NavSample
from drivers.navigation.corrections import moved, offset_m
from drivers.navigation.nmea_unit import NmeaUnit
from sim_replay.logs.xtf_report import LogReport

ATTITUDE, SERIAL, NAVIGATION, GYRO, RAW_NAVIGATION = 3, 6, 42, 84, 107  # packet types (XTF)
NAVIGATION_KINDS: Final = (ATTITUDE, SERIAL, NAVIGATION, GYRO, RAW_NAVIGATION)
_POSITION_FIRST: Final = (RAW_NAVIGATION, NAVIGATION, SERIAL)  # the best kind of packet that a log holds serves alone
_HEADING_FIRST: Final = (GYRO, RAW_NAVIGATION, ATTITUDE, SERIAL)
_LEVEL_FIRST: Final = (ATTITUDE, RAW_NAVIGATION, SERIAL)
_MAX_WAITING: Final = 1 << 15  # packets before the next ping: a minute of five units at 100 Hz
_AHEAD_S: Final = 5.0  # s by which a packet may be later than the ping behind it in the file: recorders keep a second
LATE_S: Final = 2.0  # s by which recorders write some packets later than others (chosen)
_BEHIND_S: Final = 600.0  # s before the ping ahead of it, for packets in blocks; time zones are 900 s apart (chosen)
_DAY: Final = Struct("<HBBBBB")  # year, month, day, hour, minute, second
_RAW: Final = Struct("<H2d8x2f4xf")  # tenths of a millisecond, Y, X, pitch, roll, then heading, behind the day
_NAV: Final = Struct("<I8x2d")  # microseconds, Y, X, behind the day
_GYRO: Final = Struct("<I8xf")  # microseconds, heading, behind the day
_ATTITUDE: Final = Struct("<2f12xf")  # pitch, roll, heading
_PACKET_AT, _ATTITUDE_AT, _ATTITUDE_DAY_AT, _SERIAL_AT = 14, 30, 54, 30  # bytes from the packet's beginning
_STILL_S: Final = 6.0  # s for which a sensor's position may stand still: acoustic positioning comes every few seconds
_STILL_FACTOR: Final = 2.5  # of the longest time between two positions of the sensor seen so far
_SHIP_WAY_M: Final = 5.0  # m that a ship makes meanwhile, well above the scatter of its fixes

Place: TypeAlias = Callable[[float, float], tuple[float, float]]


class PacketNavigation(NamedTuple):
    """Hold what a navigation packet says; x, y as stored, angles in degrees, NaN for what it does not say."""

    kind: int
    time_s: float
    x: float = NAN
    y: float = NAN
    heading_deg: float = NAN
    pitch_deg: float = NAN
    roll_deg: float = NAN


class Wanted(NamedTuple):
    """Hold which quantities ping headers lack, so that packets give them."""

    position: bool
    heading: bool
    level: bool


def utc_seconds(year: int, month: int, day: int, clock: tuple[int, int, int], fraction_s: float) -> float | None:
    """Compute seconds since 1970; None for an impossible date or time, or one before 1970.

    Parameters
    ----------
    year
        Two digits are of 1980 to 2079.
    month, day
        As in the calendar.
    clock
        Hour, minute, second, which may be a leap second.
    fraction_s
        Of the second.
    """
    hour, minute, second = clock
    year += 0 if year >= 100 or not month else 1900 if year >= 80 else 2000
    if not 0.0 <= fraction_s < 1.0 or year < 1970 or second > 60:
        return None
    try:
        whole = datetime(year, month, day, hour, minute, min(second, 59), tzinfo=UTC)
    except ValueError:
        return None
    return whole.timestamp() + (second == 60) + fraction_s


def read_packet(kind: int, data: bytes, unit: NmeaUnit) -> list[PacketNavigation]:
    """Read a navigation packet. unit: for the sentences in serial packets."""
    try:
        if kind == SERIAL:
            return _sentences(data, unit)
        if kind == ATTITUDE:
            pitch, roll, heading = _ATTITUDE.unpack_from(data, _ATTITUDE_AT)
            time_s = _time(data, _ATTITUDE_DAY_AT, 1e-3 * int.from_bytes(data[61:63], "little"))
            return [PacketNavigation(kind, time_s, heading_deg=heading, pitch_deg=pitch, roll_deg=roll)]
        at = _PACKET_AT + _DAY.size
        if kind == RAW_NAVIGATION:
            ticks, y, x, pitch, roll, heading = _RAW.unpack_from(data, at)
            return [PacketNavigation(kind, _time(data, _PACKET_AT, 1e-4 * ticks), x, y, heading, pitch, roll)]
        if kind == NAVIGATION:
            ticks, y, x = _NAV.unpack_from(data, at)
            return [PacketNavigation(kind, _time(data, _PACKET_AT, 1e-6 * ticks), x, y)]
        ticks, heading = _GYRO.unpack_from(data, at)
        return [PacketNavigation(kind, _time(data, _PACKET_AT, 1e-6 * ticks), heading_deg=heading)]
    except (IndexError, struct.error):  # it is shorter than its kind
        return []


def _time(data: bytes, at: int, fraction_s: float) -> float:
    year, month, day, *clock = _DAY.unpack_from(data, at)
    time_s = utc_seconds(year, month, day, (clock[0], clock[1], clock[2]), fraction_s)
    return NAN if time_s is None else time_s


def _sentences(data: bytes, unit: NmeaUnit) -> list[PacketNavigation]:
    time_s = _time(data, _PACKET_AT, 0.01 * data[21])
    stamp_ns = 0 if math.isnan(time_s) else round(time_s * 1e9)
    return [
        PacketNavigation(
            SERIAL,
            time_s,
            fix.longitude_deg,
            fix.latitude_deg,
            math.degrees(fix.heading_rad),
            math.degrees(fix.pitch_rad),
            math.degrees(fix.roll_rad),
        )
        for fix in unit.feed(data[_SERIAL_AT:].rstrip(b"\0") + b"\r\n", Stamp(stamp_ns, stamp_ns))
    ]


class PacketQueue:
    """Hold navigation packets until the ping that follows them in time."""

    def __init__(self) -> None:
        self._waiting: deque[tuple[int, PacketNavigation]] = deque(maxlen=_MAX_WAITING)
        self._ping_s = -math.inf
        self._unit = NmeaUnit("serial packets")
        self._kinds: dict[str, int] = {}  # by quantity: the best kind of packet met so far
        self._last: tuple[float, float] = (NAN, NAN)
        self.positions: deque[PacketNavigation] = deque(maxlen=_MAX_WAITING)

    def add(self, kind: int, data: bytes, offset: int) -> None:
        """Take a packet that lies at a byte of the file."""
        for packet in read_packet(kind, data, self._unit):
            has_place = not is_nowhere((packet.x, packet.y))
            for quantity, value, order in (
                ("position", packet.x if has_place else NAN, _POSITION_FIRST),
                ("heading", packet.heading_deg, _HEADING_FIRST),
                ("level", packet.pitch_deg, _LEVEL_FIRST),
            ):
                if math.isfinite(value) and kind in order:
                    best = self._kinds.get(quantity, kind)
                    self._kinds[quantity] = min(best, kind, key=order.index)
            self._waiting.append((offset, packet))
            if has_place:
                self.positions.append(packet)

    @property
    def kinds(self) -> dict[str, int]:
        """Return the kind of packet that serves each quantity."""
        return dict(self._kinds)

    def until(self, time_s: float, offset: int, wanted: Wanted, place: Place, report: LogReport) -> Iterator[NavSample]:
        """Yield what packets say up to a ping, of the quantities that are wanted; a repeated position is none.

        A packet whose time is far from those of the pings around it, or that has none, counts at the ping behind it.

        Parameters
        ----------
        time_s, offset
            When the ping was, and at which byte of the file it lies.
        wanted
            Quantities.
        place
            Gives latitude and longitude of stored coordinates, x first.
        report
            Takes the count of doubted times, and a notice.
        """
        for packet_offset, packet, is_sound in self._due(time_s, offset):
            if not is_sound and math.isfinite(packet.time_s):
                report.counters["reader.packet_time_doubted"] += 1
                text = (
                    "a navigation packet's time is far from those of the pings around it: such packets count at the "
                    "ping behind them; set the clocks of sonar and navigation to UTC"
                )
                report.notify_once("reader.packet_time_doubted", text, report.place(packet_offset))
            latitude = longitude = NAN
            here = packet.x, packet.y
            if wanted.position and self._serves("position", packet) and not is_nowhere(here) and here != self._last:
                self._last = here
                is_degrees = packet.kind == SERIAL  # as sentences are, whatever the log's own units
                latitude, longitude = (packet.y, packet.x) if is_degrees else place(packet.x, packet.y)
            level = wanted.level and self._serves("level", packet)
            heading = wanted.heading and self._serves("heading", packet)
            yield NavSample(
                time_s=packet.time_s if is_sound else time_s,
                latitude_deg=latitude,
                longitude_deg=longitude,
                heading_rad=math.radians(packet.heading_deg) if heading else NAN,
                pitch_rad=math.radians(packet.pitch_deg) if level else NAN,
                roll_rad=math.radians(packet.roll_deg) if level else NAN,
            )

    def _due(self, time_s: float, offset: int) -> list[tuple[int, PacketNavigation, bool]]:
        """Take the packets that count up to a ping, in order of time, each with its byte and whether its time is sound.

        Recorders write some packets later than others: those behind one that has to wait are looked at as well.
        """
        before_s, self._ping_s = min(self._ping_s, time_s), time_s
        due, later = [], []
        while self._waiting:
            packet_offset, packet = self._waiting.popleft()
            earliest_s = (time_s if packet_offset > offset else before_s) - _BEHIND_S
            is_sound = earliest_s <= packet.time_s <= time_s + _AHEAD_S
            if packet.time_s > time_s if is_sound else packet_offset > offset:
                later.append((packet_offset, packet))
                if not is_sound or packet.time_s > time_s + LATE_S:
                    break
            else:
                due.append((packet_offset, packet, is_sound))
        self._waiting.extendleft(reversed(later))
        return sorted(due, key=lambda item: item[1].time_s if item[2] else time_s)

    def _serves(self, quantity: str, packet: PacketNavigation) -> bool:
        return self._kinds.get(quantity) == packet.kind


def projection(epsg: int) -> Place:
    """Make the conversion from projected coordinates, x (east) first, to latitude and longitude (WGS 84), degrees.

    Raises UsageError without pyproj, or for a code that it does not know.
    """
    try:
        from pyproj import Transformer
        from pyproj.exceptions import ProjError
    except ModuleNotFoundError as error:
        raise UsageError(
            "navigation.epsg needs the package pyproj. Install it with: pip install 'auv-mcm[bench]'"
        ) from error
    try:
        transformer = Transformer.from_crs(epsg, 4326, always_xy=True)
    except ProjError as error:
        raise UsageError(
            f"navigation.epsg is {epsg}, which is not known ({error}). Give the EPSG code of the log's projection, "
            "such as 32632 for UTM zone 32 north."
        ) from error

    def place(x: float, y: float) -> tuple[float, float]:
        longitude, latitude = transformer.transform(x, y)
        return (latitude, longitude) if math.isfinite(latitude) and math.isfinite(longitude) else (NAN, NAN)

    return place


def are_degrees(positions: list[tuple[float, float, float]]) -> bool:
    """Find by their values whether positions (time, s, x, y; one or more) are degrees: small numbers, slow to change.

    A vehicle changes its place by 1e-5 degrees a metre; local coordinates in metres would move it by kilometres.
    """
    if any(abs(x) > 360.0 or abs(y) > 90.0 for _, x, y in positions):
        return False
    times, xs, ys = zip(*positions, strict=True)
    spread_deg = max(max(xs) - min(xs), max(ys) - min(ys))
    return bool(spread_deg <= _MAX_DEGREES_PER_S * max(max(times) - min(times), 1.0))


_MAX_DEGREES_PER_S: Final = 3e-4  # 33 m/s along a meridian: faster than any vehicle that carries the payload


class SensorWatch:
    """Use the ship's position while the sensor's stands still, or is absent, and the ship's moves."""

    def __init__(self) -> None:
        self.is_still = False
        self._sensor = (NAN, NAN)
        self._since_s = NAN
        self._still_s = _STILL_S
        self._ship_then = (NAN, NAN)
        self._arm_m: tuple[float, float] | None = None  # ahead and to starboard, of the sensor from the ship

    def look(
        self, time_s: float, sensor: tuple[float, float], ship: tuple[float, float], heading_deg: float
    ) -> tuple[float, float]:
        """Take both positions, latitude first (NaN or zeros: none); return the one to use."""
        if is_nowhere(ship):
            self.is_still = False
            return sensor
        if sensor != self._sensor or not time_s >= self._since_s:
            if not is_nowhere(sensor) and not is_nowhere(self._sensor) and time_s >= self._since_s:
                self._arm_m = _ahead(ship, sensor, heading_deg)
                if not self.is_still:
                    self._still_s = max(self._still_s, _STILL_FACTOR * (time_s - self._since_s))
                self.is_still = False
            self._sensor, self._since_s, self._ship_then = sensor, time_s, ship
        elif not self.is_still and time_s - self._since_s >= self._still_s:
            self.is_still = math.hypot(*offset_m(self._ship_then, ship)) >= _SHIP_WAY_M
        return self.ship_place(ship, heading_deg) if self.is_still else sensor

    def ship_place(self, ship: tuple[float, float], heading_deg: float) -> tuple[float, float]:
        """Move the ship's position to where the sensor last was from it."""
        return ship if self._arm_m is None else behind(ship, -self._arm_m[0], heading_deg, self._arm_m[1])


def behind(
    place: tuple[float, float], behind_m: float, heading_deg: float, starboard_m: float = 0.0
) -> tuple[float, float]:
    """Move a place, latitude first, astern and to starboard of a heading; where it stands without one."""
    if not math.isfinite(heading_deg):
        return place
    heading = math.radians(heading_deg)
    north_m = -behind_m * math.cos(heading) - starboard_m * math.sin(heading)
    east_m = -behind_m * math.sin(heading) + starboard_m * math.cos(heading)
    return moved(*place, east_m, north_m)


def _ahead(ship: tuple[float, float], sensor: tuple[float, float], heading_deg: float) -> tuple[float, float] | None:
    if not math.isfinite(heading_deg):
        return None
    east_m, north_m = offset_m(ship, sensor)
    sine, cosine = math.sin(math.radians(heading_deg)), math.cos(math.radians(heading_deg))
    return north_m * cosine + east_m * sine, east_m * cosine - north_m * sine


def is_nowhere(place: tuple[float, float]) -> bool:
    """Check whether a place, either order, is none: zeros, or not finite."""
    return place == (0.0, 0.0) or not math.isfinite(sum(place))
