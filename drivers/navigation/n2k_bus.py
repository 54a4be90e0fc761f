"""Decode a NMEA 2000 bus: frames of many units to each unit's fixes. It listens only and never claims an address."""

from __future__ import annotations

import math
from collections import Counter
from typing import Any, Final

from auv_mcm.clock import Stamp
from auv_mcm.records import NAN
from drivers.navigation.device_date import DAY_S
from drivers.navigation.n2k_fast_packet import FastPackets
from drivers.navigation.n2k_messages import (
    ADDRESS_CLAIM,
    FAST_PACKET_GROUPS,
    Attitude,
    GnssPosition,
    Heading,
    MagneticVariation,
    RapidCourse,
    RapidPosition,
    Record,
    Speed,
    SystemTime,
    WaterDepth,
    decode,
    identifier_of,
)
from drivers.navigation.nav_decoder import NavFix

_MAX_NAMES: Final = 512  # devices remembered; bounds memory, a bus has 252 addresses
_NO_ADDRESS: Final = 254  # the address of a device that could claim none; 255 is all (ISO 11783-5)
_MAX_SID: Final = 252  # sequence numbers beyond it mark none (NMEA 2000)
_SAME_INSTANT_NS: Final = 50_000_000  # messages of one sid leave a unit within this time
_TRUE, _MAGNETIC = 0.0, 1.0
_NOT_MEASURED: Final = (0.0, 7.0, 8.0)  # GNSS methods of PGN 129029: no fix, manual input, simulated
_ESTIMATED: Final = 6.0  # GNSS method of PGN 129029: dead reckoning
_TURN: Final = 2.0 * math.pi


class N2kBus:
    """Decode one bus's frames to fixes. Never raises, whatever the frames.

    Units are called SOURCE.ADDRESS; one that claims another address keeps its name, by the 64-bit NAME in its claim.
    Messages of one unit with one sid carry the stamp of the first of them, since they were measured together.
    `counters`: n2k.messages, .ignored (groups not known here), .short, .claims, .impossible_position, .heading_magnetic
    (no variation known), .heading_reference_unknown, and those of FastPackets.
    """

    def __init__(self, source: str) -> None:
        self._source = source
        self._own: Counter[str] = Counter()
        self._packets = FastPackets()
        self._talkers: dict[int, _Talker] = {}  # by address
        self._labels: dict[int, str] = {}  # by NAME
        self._variation_rad = NAN  # newest of any unit: it is the place's, and often the receiver sends it

    @property
    def counters(self) -> Counter[str]:
        return self._own + self._packets.counters

    @property
    def units(self) -> dict[str, int | None]:
        """Return the NAME of every unit heard, None for one that has not claimed its address since listening began."""
        return {talker.label: talker.name for talker in self._talkers.values()}

    def feed(self, can_id: int, data: bytes, stamp: Stamp) -> list[NavFix]:
        """Return the fixes that a frame completes.

        Parameters
        ----------
        can_id
            29 bits.
        stamp
            When it was read.
        """
        _, pgn, _, source = identifier_of(can_id)
        if pgn in FAST_PACKET_GROUPS:
            whole = self._packets.add(pgn, source, data)
            return [] if whole is None else self.feed_message(pgn, source, whole, stamp)
        return self.feed_message(pgn, source, data, stamp)

    def feed_message(self, pgn: int, address: int, data: bytes, stamp: Stamp) -> list[NavFix]:
        """Return the fixes in a whole message, for links and logs that put fast packets together themselves."""
        if pgn == ADDRESS_CLAIM:
            self._claim(address, data)
            return []
        try:
            record = decode(pgn, data)
        except ValueError:
            self._own["n2k.short"] += 1
            return []
        if record is None:
            self._own["n2k.ignored"] += 1
            return []
        self._own["n2k.messages"] += 1
        talker = self._talkers.get(address)
        if talker is None:
            talker = self._talkers[address] = _Talker(f"{self._source}.{address}", None)
        fix_fields = self._fix_fields(record, talker)
        if fix_fields is None:
            return []
        return [NavFix(source=talker.label, received=talker.instant(pgn, record, stamp), **fix_fields)]

    def _claim(self, address: int, data: bytes) -> None:
        if len(data) < 8:
            self._own["n2k.short"] += 1
            return
        self._own["n2k.claims"] += 1
        name = int.from_bytes(data[:8], "little")
        known = self._talkers.get(address)
        if known is not None and known.name == name:
            return
        for other in [other for other, talker in self._talkers.items() if talker.name == name]:
            del self._talkers[other]
        if address >= _NO_ADDRESS:
            return
        if name not in self._labels:
            if len(self._labels) >= _MAX_NAMES:
                self._own["n2k.too_many_units"] += 1
                return
            label = f"{self._source}.{address}"
            self._labels[name] = f"{self._source}.{name:016x}" if label in self._labels.values() else label
        self._talkers[address] = _Talker(self._labels[name], name)

    def _fix_fields(self, record: Record, talker: _Talker) -> dict[str, Any] | None:
        """Return the fields of a fix that a message fills; None for one without information on the vehicle's track."""
        match record:
            case Heading():
                return self._heading(record, talker)
            case Attitude():
                fix_fields: dict[str, Any] = {"pitch_rad": record.pitch_rad, "roll_rad": record.roll_rad}
                if not talker.sends_heading:
                    fix_fields["heading_rad"] = record.yaw_rad % _TURN
                fix_fields["valid"] = not all(math.isnan(angle) for angle in fix_fields.values())
                return fix_fields
            case MagneticVariation():
                talker.variation_rad = record.variation_rad
                if not math.isnan(record.variation_rad):
                    self._variation_rad = record.variation_rad
                return None
            case Speed():
                known = not (math.isnan(record.ground_mps) and math.isnan(record.water_mps))
                return {"speed_mps": record.ground_mps, "water_speed_mps": record.water_mps, "valid": known}
            case WaterDepth():
                return {"altitude_m": record.depth_m, "valid": record.depth_m > 0.0}
            case RapidPosition():
                return self._place(record.latitude_deg, record.longitude_deg) if talker.has_fix else {"valid": False}
            case RapidCourse():
                course_rad = record.course_rad if record.reference == _TRUE else NAN
                return {
                    "speed_mps": record.speed_mps,
                    "course_rad": course_rad,
                    "valid": not math.isnan(record.speed_mps),
                }
            case GnssPosition():
                talker.has_fix = not (record.method in _NOT_MEASURED or math.isnan(record.method))
                place = self._place(record.latitude_deg, record.longitude_deg) if talker.has_fix else {"valid": False}
                time_utc_s = _utc_s(record.date_days, record.time_of_day_s)
                return {"time_utc_s": time_utc_s, "estimated": record.method == _ESTIMATED, **place}
            case SystemTime():
                return {"time_utc_s": _utc_s(record.date_days, record.time_of_day_s)}
        return None

    def _place(self, latitude_deg: float, longitude_deg: float) -> dict[str, Any]:
        """Return a position as sent; the fields have room for 214 degrees.

        NavMerge rejects and reports impossible ones.
        """
        if math.isnan(latitude_deg) or math.isnan(longitude_deg):
            return {"valid": False}
        is_possible = abs(latitude_deg) <= 90.0 and abs(longitude_deg) <= 180.0
        self._own["n2k.impossible_position"] += not is_possible
        return {"latitude_deg": latitude_deg, "longitude_deg": longitude_deg, "valid": is_possible}

    def _heading(self, record: Heading, talker: _Talker) -> dict[str, Any] | None:
        if math.isnan(record.heading_rad):
            return {"valid": False}
        talker.sends_heading = True
        if record.reference == _TRUE:
            return {"heading_rad": record.heading_rad}
        if record.reference != _MAGNETIC:
            self._own["n2k.heading_reference_unknown"] += 1
            return None
        known = (record.variation_rad, talker.variation_rad, self._variation_rad)
        variation_rad = next((angle for angle in known if not math.isnan(angle)), NAN)
        if math.isnan(variation_rad):
            self._own["n2k.heading_magnetic"] += 1
            return None
        deviation_rad = 0.0 if math.isnan(record.deviation_rad) else record.deviation_rad
        return {"heading_rad": (record.heading_rad + deviation_rad + variation_rad) % _TURN}


class _Talker:
    """Hold the state of one unit."""

    def __init__(self, label: str, name: int | None) -> None:
        self.label = label
        self.name = name
        self.variation_rad = NAN
        self.sends_heading = False  # then its yaw is the same once more, magnetic if that is
        self.has_fix = True
        self._sid = NAN
        self._first: Stamp | None = None
        self._groups: set[int] = set()

    def instant(self, pgn: int, record: Record, stamp: Stamp) -> Stamp:
        """Return the stamp of the first message of the instant that this one belongs to.

        Units that do not count their sids send the same one for ever, so a group that comes again begins a new instant.
        """
        sid = NAN if isinstance(record, RapidPosition) else record.sid
        if not sid <= _MAX_SID:
            return stamp
        first = self._first
        if first is None or sid != self._sid or pgn in self._groups or stamp.mono_ns - first.mono_ns > _SAME_INSTANT_NS:
            self._sid, self._first, self._groups = sid, stamp, {pgn}
            return stamp
        self._groups.add(pgn)
        return first


def _utc_s(date_days: float, time_of_day_s: float) -> float | None:
    utc_s = date_days * DAY_S + time_of_day_s
    return None if math.isnan(utc_s) else utc_s
