"""Assemble PHINS bursts (iXblue `$PIXSE`): the sentences of one instant, stamped with the time that comes after
them."""

from __future__ import annotations

import math
from typing import Any, Final

from auv_mcm.records import NAN
from drivers.framing import StampedMessage
from drivers.navigation.device_date import DeviceDate
from drivers.navigation.nav_decoder import NavFix
from drivers.navigation.sentences import (
    Hdt,
    PixseAttitude,
    PixseAttitudeSigma,
    PixseHeave,
    PixsePosition,
    PixsePositionSigma,
    PixseSpeed,
    PixseSpeedSigma,
    PixseTime,
)

PIXSE_RECORDS: Final = (
    PixseAttitude,
    PixsePosition,
    PixseSpeed,
    PixseHeave,
    PixseTime,
    PixseAttitudeSigma,
    PixsePositionSigma,
    PixseSpeedSigma,
)


class Burst:
    """Collect one burst after the other.

    A burst ends with its TIME__, or, if that was lost, with a heading, which comes first, or a second sentence of a
    kind it has already. Standard deviations come before or after the time, depending on the unit, and change slowly: a
    fix has the newest ones reported.
    """

    def __init__(self, source: str, date: DeviceDate) -> None:
        self._source = source
        self._date = date
        self._first: StampedMessage[str] | None = None
        self._records: dict[type, Any] = {}
        self._sigma: dict[str, Any] = {}

    def add(self, record: Any, arrived: StampedMessage[str]) -> list[NavFix]:
        """Take one record of PIXSE_RECORDS or a heading; return the fixes that it completes."""
        match record:
            case PixseAttitudeSigma():
                self._sigma["heading_sigma_rad"] = record.heading_rad
                self._sigma["attitude_sigma_rad"] = max(record.roll_rad, record.pitch_rad)
            case PixsePositionSigma():
                self._sigma["position_sigma_m"] = max(record.latitude_m, record.longitude_m)
                self._sigma["depth_sigma_m"] = record.height_m
            case PixseSpeedSigma():
                self._sigma["speed_sigma_mps"] = max(record.north_mps, record.east_mps)
            case PixseTime():
                time_utc_s = (
                    None if self._first is None else self._date.nearest(record.time_of_day_s, self._first.received)
                )
                return self.end(time_utc_s)
            case _:
                begins = type(record) in self._records or (isinstance(record, Hdt) and bool(self._records))
                done = self.end() if begins else []
                if self._first is None:
                    self._first = arrived
                self._records[type(record)] = record
                return done
        return []

    def end(self, time_utc_s: float | None = None) -> list[NavFix]:
        """Return the fix of the burst so far, if it holds anything."""
        first, self._first = self._first, None
        records, self._records = self._records, {}
        if first is None:
            return []
        fix_fields: dict[str, Any] = {}
        for record in records.values():
            fix_fields.update(_fix_fields(record))
        return [
            NavFix(
                source=self._source,
                received=first.received,
                n_bytes=first.n_bytes,
                time_utc_s=time_utc_s,
                **fix_fields,
                **self._sigma,
            )
        ]


def _fix_fields(record: Any) -> dict[str, Any]:
    match record:
        case Hdt():
            return {"heading_rad": record.heading_rad}
        case PixseAttitude():
            return {"pitch_rad": record.pitch_rad, "roll_rad": record.roll_rad}
        case PixsePosition():
            longitude_deg = math.remainder(record.longitude_deg, 360.0)
            if math.isnan(record.latitude_deg) or math.isnan(longitude_deg):
                return {}
            return {"latitude_deg": record.latitude_deg, "longitude_deg": longitude_deg, "depth_m": -record.height_m}
        case PixseSpeed():
            speed_mps = math.hypot(record.east_mps, record.north_mps)
            course_rad = math.atan2(record.east_mps, record.north_mps) % (2.0 * math.pi) if speed_mps > 0.0 else NAN
            return {"speed_mps": speed_mps, "course_rad": course_rad}
    return {}
