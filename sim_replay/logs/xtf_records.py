"""Make navigation samples and pings of what an XTF log stores of each ping."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from auv_mcm.records import NAN, EchoTrace, NavSample, Ping
from sim_replay.logs.xtf_fields import KNOT_MPS, number_or_nan
from sim_replay.logs.xtf_navigation import PacketQueue, Place, SensorWatch, behind
from sim_replay.logs.xtf_pings import RawPing, Trace, sound_speed_mps
from sim_replay.logs.xtf_probe import Fields, Orders
from sim_replay.logs.xtf_report import LogReport

_MAX_LAYBACK_M: Final = 5000.0  # m: longer than any tow cable lets a sonar hang behind


class HeaderNavigation:
    """Read the navigation in ping headers.

    A header that repeats all navigation of the one before gives none; a position is given only where it differs from
    the one before. Zero means unknown for a position and for a header without any navigation.
    """

    def __init__(self, fields: Fields, packets: PacketQueue, place: Place, report: LogReport) -> None:
        """Start at the first ping.

        Parameters
        ----------
        fields
            Which fields are used.
        packets
            That give what headers lack.
        place
            Gives latitude and longitude of stored coordinates, x first.
        report
            Takes counters and notices.
        """
        self._fields, self._packets, self._place, self._report = fields, packets, place, report
        self._watch = SensorWatch()
        self._last: tuple[float, ...] = ()

    def sample(self, raw: RawPing, time_s: float) -> NavSample | None:
        """Return what a ping's header says; None where it says nothing new."""
        h, fields, report = raw.header, self._fields, self._report
        heading = h.ShipGyro if fields.ship_gyro else h.SensorHeading
        values: tuple[float, ...] = (
            *self._header_place(raw, time_s, heading),
            *(heading, h.SensorPitch, h.SensorRoll, h.SensorDepth, h.SensorPrimaryAltitude),
            h.ShipSpeed if fields.ship_speed else h.SensorSpeed,
        )
        is_whole = math.isfinite(sum(values))  # what is not finite leaves no finite sum
        if not is_whole:
            values = tuple(map(number_or_nan, values))
        latitude, longitude, heading, *_, altitude, _ = values
        by_packet = fields.wanted.position and "position" in self._packets.kinds
        if latitude == longitude == heading == altitude == 0.0 and not by_packet:
            report.counters["reader.zero_navigation"] += 1
            text = "a ping has no navigation (all zero); it is taken as unknown"
            report.notify_once("reader.zero_navigation", text, report.place(raw.offset))
            return None
        if not is_whole and any(map(math.isnan, values)):
            report.counters["reader.nan_navigation"] += 1
            text = "navigation holds NaN or infinity; those quantities are taken as unknown"
            report.notify_once("reader.nan_navigation", text, report.place(raw.offset))
        latitude, longitude = (NAN, NAN) if by_packet else self._possible(latitude, longitude, raw.offset)
        if fields.wanted.heading and "heading" in self._packets.kinds:
            heading = NAN
        last, now = self._last, (latitude, longitude, heading, *values[3:])
        self._last = now
        if now == last:  # NAN, one object, equals itself in a tuple
            report.counters["reader.repeated_navigation"] += 1
            return None
        if (last and (latitude, longitude) == last[:2]) or math.isnan(latitude) or math.isnan(longitude):
            latitude = longitude = NAN  # half a position is none
        _, _, _, pitch, roll, depth, altitude, speed = values
        return NavSample(
            time_s=time_s,
            latitude_deg=latitude,
            longitude_deg=longitude,
            heading_rad=math.radians(heading),
            pitch_rad=math.radians(pitch),
            roll_rad=math.radians(roll),
            depth_m=depth,
            altitude_m=altitude,
            speed_mps=speed * KNOT_MPS,
        )

    def _possible(self, latitude: float, longitude: float, offset: int) -> tuple[float, float]:
        """Return the position, with longitudes from -180 on; NaN for one that is 0, 0 or impossible."""
        report = self._report
        if latitude == longitude == 0.0:
            report.counters["reader.zero_position"] += 1
            text = "a ping has heading or altitude but no position (0, 0); the position is taken as unknown"
            report.notify_once("reader.zero_position", text, report.place(offset))
            return NAN, NAN
        if abs(latitude) > 90.0 or abs(longitude) > 360.0:
            report.counters["reader.impossible_position"] += 1
            text = (
                f"impossible position {latitude}, {longitude}; taken as unknown. If these are metres of a projection, "
                "set navigation.epsg"
            )
            report.notify_once("reader.impossible_position", text, report.place(offset))
            return NAN, NAN
        if longitude < -180.0 or longitude >= 180.0:
            longitude = (longitude + 180.0) % 360.0 - 180.0
        return latitude, longitude

    def _header_place(self, raw: RawPing, time_s: float, heading_deg: float) -> tuple[float, float]:
        """Find the latitude and longitude of a ping's header: the sensor's, or the ship's where that stands still."""
        h = raw.header
        if self._fields.ship_position:
            ship = self._place(h.ShipXcoordinate, h.ShipYcoordinate)
            course_deg = h.ShipGyro if h.ShipGyro and math.isfinite(h.ShipGyro) else heading_deg
            return behind(ship, h.Layback, course_deg) if 0.0 < h.Layback < _MAX_LAYBACK_M else ship
        sensor = self._place(h.SensorXcoordinate, h.SensorYcoordinate)
        if h.ShipYcoordinate == h.ShipXcoordinate == 0.0:
            return sensor
        ship = self._place(h.ShipXcoordinate, h.ShipYcoordinate)
        place = self._watch.look(time_s, sensor, ship, heading_deg)
        if self._watch.is_still:
            self._report.counters["reader.sensor_position_still"] += 1
            self._report.notify_once(
                "reader.sensor_position_still",
                "the sensor's position stands still while the ship's moves: the ship's is used, with the sensor where "
                "it last was from it. For a towed sonar set sonar.lever_arm_m if it never was known; check the "
                "positioning of the sensor",
                self._report.place(raw.offset),
            )
        return place


class Echoes:
    """Make pings of the samples that are stored."""

    def __init__(self, orders: Orders, set_speed_mps: float | None, report: LogReport) -> None:
        """Start at the first ping.

        Parameters
        ----------
        orders
            How sides are stored.
        set_speed_mps
            The sound speed that is configured, in place of the log's.
        report
            Takes counters and notices.
        """
        self._orders, self._set_speed_mps, self._report = orders, set_speed_mps, report
        self._n_samples: dict[str, tuple[int, np.dtype[Any]]] = {}
        self._reference_weight: dict[str, int] = {}

    def ping(self, raw: RawPing, time_s: float, number: int) -> Ping:
        """Return a ping."""
        report, place = self._report, self._report.place(raw.offset)
        logged = sound_speed_mps(number_or_nan(raw.header.SoundVelocity), place, report)
        speed = self._set_speed_mps or logged
        if speed != logged:
            report.notify_once(
                "reader.sound_speed_overridden",
                f"sonar.sound_speed_mps {speed:g} replaces the log's {logged:g} m/s; slant ranges are scaled by "
                f"{speed / logged:.4f}",
                place,
            )
        altitude = number_or_nan(raw.header.SensorPrimaryAltitude)
        report.counters["reader.pings"] += 1
        return Ping(
            number=number,
            time_s=time_s,
            port=self._echo("port", raw.port, speed, logged, self._orders.port_far_to_near, place),
            starboard=self._echo("starboard", raw.starboard, speed, logged, self._orders.starboard_far_to_near, place),
            sound_speed_mps=speed,
            altitude_m=altitude if altitude > 0.0 else NAN,
            place=f"{place}, ping {number}",
        )

    def _echo(
        self, side: str, trace: Trace | None, speed: float, logged: float, turned: bool, place: str
    ) -> EchoTrace | None:
        if trace is None:
            return None
        report, samples = self._report, trace.samples
        form = (samples.shape[0], samples.dtype)
        known = self._n_samples.setdefault(side, form)
        if form != known:
            self._n_samples[side] = form
            what = "sample_type" if form[1] != known[1] else "sample_count"
            report.counters[f"reader.{what}_change"] += 1
            report.notify_once(
                f"reader.{what}_change",
                f"{side} changes from {known[0]} samples of {known[1].str} to {form[0]} of {form[1].str}; later "
                "changes are counted",
                place,
            )
        reference = self._reference_weight.setdefault(side, trace.weight)
        if trace.weight != reference:
            # A sample's value is stored * 2^-weight; only a change against the first ping matters, absolute gain does
            # not.
            samples = np.ldexp(samples.astype(np.float32), max(-60, min(60, reference - trace.weight)))
            report.counters["reader.weight_change"] += 1
            report.notify_once(
                "reader.weight_change",
                f"{side} changes its weight factor; samples are scaled to the first ping's",
                place,
            )
        if samples.dtype.kind == "f" and not np.all(np.isfinite(samples)):
            report.counters["reader.sample_not_finite"] += 1
            report.notify_once(
                "reader.sample_not_finite",
                f"{side} holds samples that are NaN or infinite; they are delivered as such",
                place,
            )
        spacing = trace.range_m * speed / logged / samples.shape[0]
        delay = trace.delay_s if 0.0 < trace.delay_s < 10.0 else 0.0
        if delay:
            report.notify_once(
                "reader.time_delay",
                f"{side} was recorded from {delay:g} s after the transmission on; its ranges start "
                f"{delay * speed / 2:.2f} m out",
                place,
            )
        return EchoTrace(
            samples=np.ascontiguousarray(samples[::-1]) if turned else samples,
            first_range_m=delay * speed / 2.0 + 0.5 * spacing,
            spacing_m=spacing,
        )
