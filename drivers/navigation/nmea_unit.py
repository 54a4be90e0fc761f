"""Decode units that send NMEA 0183: GNSS receivers, compasses, echo sounders, attitude sensors, and PHINS bursts."""

from __future__ import annotations

import math
from collections import Counter
from typing import Any, Final

from auv_mcm.clock import Stamp
from auv_mcm.records import NAN, Notice
from drivers.framing import StampedFramer, StampedMessage
from drivers.navigation.device_date import DeviceDate
from drivers.navigation.heading_choice import HeadingChoice
from drivers.navigation.nav_decoder import NavFix
from drivers.navigation.nmea0183 import NmeaGrammar
from drivers.navigation.pixse import PIXSE_RECORDS, Burst
from drivers.navigation.sentences import (
    Avr,
    Dbt,
    Dpt,
    Gga,
    Gll,
    Gpatt,
    Hdg,
    Hdm,
    Hdt,
    Hpr,
    Ohpr,
    Pashr,
    Prdid,
    Rmc,
    Ths,
    Vtg,
    Zda,
    key_of,
    parse,
)

# How many sentences of other kinds may pass before a heading is taken not to belong to an inertial unit's bursts.
_BURST_SENTENCES: Final = 32
_GGA_NOT_MEASURED: Final = (0.0, 7.0, 8.0)
_GGA_ESTIMATED: Final = 6.0
_THS_NOT_MEASURED: Final = frozenset("MSV")
_MODES_NOT_MEASURED: Final = frozenset("NMS")


class NmeaUnit:
    """Decode one link's sentences to fixes. Never raises, whatever the bytes.

    `counters`: those of the framer (`nmea.*`), `nmea.malformed` (checksum right, fields impossible), `nmea.ignored`
    (kinds not known here), `nmea.heading_not_used` (a better heading comes as well).
    """

    def __init__(self, source: str) -> None:
        self._source = source
        self._framer = StampedFramer(NmeaGrammar())
        self._own: Counter[str] = Counter()
        self._date = DeviceDate()
        self._burst = Burst(source, self._date)
        self._since_burst = _BURST_SENTENCES
        self._headings = HeadingChoice(source)

    @property
    def counters(self) -> Counter[str]:
        return self._framer.counters + self._own

    def feed(self, data: bytes, stamp: Stamp) -> list[NavFix]:
        """Return what a chunk completes, in order. stamp: when its last byte was read."""
        return [fix for arrived in self._framer.feed(data, stamp) for fix in self._fixes(arrived)]

    def finish(self) -> list[NavFix]:
        """Return what still waited at the end of a log or link."""
        return [fix for arrived in self._framer.finish() for fix in self._fixes(arrived)] + self._burst.end()

    def take_notices(self) -> list[Notice]:
        """Take the notices about headings raised since the last call."""
        return self._headings.take_notices()

    def _fixes(self, arrived: StampedMessage[str]) -> list[NavFix]:
        try:
            record = parse(arrived.message)
        except ValueError:
            self._own["nmea.malformed"] += 1
            return []
        self._since_burst += 1
        if record is None:
            self._own["nmea.ignored"] += 1
            self._headings.ignored(key_of(arrived.message.split(",")))
            return []
        if isinstance(record, PIXSE_RECORDS):
            self._since_burst = 0
        if self._since_burst == 0 or (isinstance(record, Hdt) and self._since_burst < _BURST_SENTENCES):
            return self._burst.add(record, arrived)
        fields = self._fix_fields(record, arrived.received)
        if not self._headings.serves(record, fields.get("heading_rad", NAN)):
            self._own["nmea.heading_not_used"] += 1
            fields["heading_rad"] = NAN
        return [NavFix(source=self._source, received=arrived.received, n_bytes=arrived.n_bytes, **fields)]

    def _fix_fields(self, record: Any, stamp: Stamp) -> dict[str, Any]:
        """Return the fields of a fix that a sentence fills."""
        match record:
            case Gga():
                time_utc_s = self._date.nearest(record.time_of_day_s, stamp)
                if record.quality in _GGA_NOT_MEASURED or math.isnan(record.quality):
                    return {"time_utc_s": time_utc_s, "valid": False}
                place = _place(record.latitude_deg, record.longitude_deg)
                return {"time_utc_s": time_utc_s, "estimated": record.quality == _GGA_ESTIMATED, **place}
            case Rmc():
                fix_fields = _judged(record.status, record.mode)
                fix_fields["time_utc_s"] = self._date.dated(record.date_days, record.time_of_day_s, stamp)
                self._headings.vary(record.variation_rad)
                if fix_fields["valid"]:
                    fix_fields.update(
                        _place(record.latitude_deg, record.longitude_deg),
                        speed_mps=record.speed_mps,
                        course_rad=record.course_rad,
                    )
                return fix_fields
            case Gll():
                fix_fields = _judged(record.status, record.mode)
                fix_fields["time_utc_s"] = self._date.nearest(record.time_of_day_s, stamp)
                if fix_fields["valid"]:
                    fix_fields.update(_place(record.latitude_deg, record.longitude_deg))
                return fix_fields
            case Vtg():
                fix_fields = _judged("A", record.mode)
                if fix_fields["valid"]:
                    fix_fields.update(speed_mps=record.speed_mps, course_rad=record.course_rad)
                return fix_fields
            case Zda():
                time_utc_s = self._date.dated(record.date_days, record.time_of_day_s, stamp)
                return {
                    "time_utc_s": time_utc_s,
                    "is_time_message": time_utc_s is not None and not math.isnan(record.date_days),
                }
            case Dpt() | Dbt():
                return {"altitude_m": record.depth_m if record.depth_m > 0.0 else NAN, "valid": record.depth_m > 0.0}
        return self._attitude_fields(record, stamp)

    def _attitude_fields(self, record: Any, stamp: Stamp) -> dict[str, Any]:
        """Return the fields of a fix that a sentence of heading, pitch or roll fills."""
        match record:
            case Ths():
                sound = record.mode not in _THS_NOT_MEASURED and not math.isnan(record.heading_rad)
                return {"heading_rad": record.heading_rad if sound else NAN, "valid": sound}
            case Hdg() | Hdm():
                heading_rad = self._headings.true_rad(record)
                return {"heading_rad": heading_rad, "valid": not math.isnan(heading_rad)}
            case Hpr() | Avr():
                fix_fields = {"time_utc_s": self._date.nearest(record.time_of_day_s, stamp)}
                if isinstance(record, Avr) and record.quality == 0.0:
                    return {**fix_fields, "valid": False}
                return {**fix_fields, **_attitude(record.heading_rad, record.pitch_rad, record.roll_rad)}
            case Gpatt() | Ohpr():
                return _attitude(record.heading_rad, record.pitch_rad, record.roll_rad)
            case Hdt():
                return {"heading_rad": record.heading_rad, "valid": not math.isnan(record.heading_rad)}
            case Pashr():
                return {
                    "time_utc_s": self._date.nearest(record.time_of_day_s, stamp),
                    "heading_rad": record.heading_rad,
                    "pitch_rad": record.pitch_rad,
                    "roll_rad": record.roll_rad,
                    "heading_sigma_rad": record.heading_sigma_rad,
                    "attitude_sigma_rad": max(record.roll_sigma_rad, record.pitch_sigma_rad),
                }
            case Prdid():
                return {"heading_rad": record.heading_rad, "pitch_rad": record.pitch_rad, "roll_rad": record.roll_rad}
        raise AssertionError(f"no rule for {type(record).__name__}")


def _judged(status: str, mode: str) -> dict[str, Any]:
    return {"valid": status == "A" and mode not in _MODES_NOT_MEASURED, "estimated": mode == "E"}


def _attitude(heading_rad: float, pitch_rad: float, roll_rad: float) -> dict[str, Any]:
    """Return the fields of an attitude; a unit of two antennas gives pitch or roll alone, and the other is level."""
    if math.isnan(pitch_rad) != math.isnan(roll_rad):
        pitch_rad, roll_rad = (0.0 if math.isnan(angle) else angle for angle in (pitch_rad, roll_rad))
    fields = {"heading_rad": heading_rad % math.tau, "pitch_rad": pitch_rad, "roll_rad": roll_rad}
    return {**fields, "valid": not all(map(math.isnan, fields.values()))}


def _place(latitude_deg: float, longitude_deg: float) -> dict[str, Any]:
    """Return the fields of a position; invalid where the unit gives none."""
    known = not (math.isnan(latitude_deg) or math.isnan(longitude_deg))
    return {"latitude_deg": latitude_deg, "longitude_deg": longitude_deg} if known else {"valid": False}
