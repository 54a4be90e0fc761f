"""Encode navigation samples as units do by their makers' manuals. No ports, no clocks."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from types import MappingProxyType
from typing import Final, Protocol, TypeAlias

from auv_mcm.records import NAN, NavSample
from drivers.links.can_frame import CanFrame
from drivers.navigation import dvl_pd6, dvl_water_linked, n2k_messages, sentences
from drivers.navigation.n2k_fast_packet import frames_of
from drivers.navigation.n2k_messages import ADDRESS_CLAIM, FAST_PACKET_GROUPS, GLOBAL, MESSAGES, Identifier, can_id_of
from drivers.navigation.nmea0183 import sentence

Message: TypeAlias = bytes | CanFrame

_DAY_S: Final = 86_400.0  # seconds per day
_N_SID: Final = 253  # sequence numbers 0 to 252 (NMEA 2000)
_N2K_ADDRESS: Final = 12  # on the bus
_N2K_NAME: Final = (
    0xC0_32_82_00_1B_E0_04_D2  # a GNSS and attitude sensor of marine industry, manufacturer 223, number 1234
)
_CLAIM_EVERY: Final = 50  # samples
_TURN: Final = 2.0 * math.pi


class FakeNavigation(Protocol):
    """Send each sample as soon as it is measured."""

    def measured(self, sample: NavSample, utc_s: float) -> list[Message]:
        """Return messages about a sample; utc_s: when it was measured, by the unit's own clock."""
        ...


class Nmea0183Unit:
    """Simulate a satellite compass: position, heading, attitude, speed, depth below its echo sounder, time and date."""

    def measured(self, sample: NavSample, utc_s: float) -> list[Message]:
        day, time_of_day_s = divmod(utc_s, _DAY_S)
        has_place = math.isfinite(sample.latitude_deg) and math.isfinite(sample.longitude_deg)
        records: list[sentences.Record] = [
            sentences.Gga(
                time_of_day_s, sample.latitude_deg, sample.longitude_deg, 4.0 if has_place else 0.0, 12.0, 0.8
            ),
            sentences.Vtg(sample.heading_rad % _TURN, sample.speed_mps, "A"),
            sentences.Pashr(time_of_day_s, sample.heading_rad % _TURN, sample.roll_rad, sample.pitch_rad),
            sentences.Zda(time_of_day_s, day),
        ]
        if math.isfinite(sample.altitude_m):
            records.append(sentences.Dpt(sample.altitude_m))
        return [_sentences(records)]


class PixseUnit:
    """Simulate a PHINS: bursts of `$PIXSE` with their heading; the depth is sent as a height."""

    def measured(self, sample: NavSample, utc_s: float) -> list[Message]:
        records: list[sentences.Record] = [sentences.Hdt(sample.heading_rad % _TURN)]
        records.append(sentences.PixseAttitude(sample.roll_rad, sample.pitch_rad))
        records.append(sentences.PixsePosition(sample.latitude_deg, sample.longitude_deg % 360.0, -sample.depth_m))
        east_mps, north_mps = _velocity(sample)
        records.append(sentences.PixseSpeed(east_mps, north_mps, 0.0))
        records.append(sentences.PixseTime(utc_s % _DAY_S))
        return [_sentences(records)]


class FakePd6Unit:
    """Simulate a DVL with PD6 text: attitude, velocity over ground, range to the bottom."""

    def __init__(self) -> None:
        self._last: NavSample | None = None
        self._made_good_m = (0.0, 0.0)

    def measured(self, sample: NavSample, utc_s: float) -> list[Message]:
        lines: list[dvl_pd6.Line] = []
        if all(map(math.isfinite, (sample.pitch_rad, sample.roll_rad, sample.heading_rad))):
            lines.append(dvl_pd6.Pd6Attitude(sample.pitch_rad, sample.roll_rad, sample.heading_rad % _TURN))
        lines.append(dvl_pd6.Water(utc_s, 35.0, 12.0, or_zero(sample.depth_m), 1500.0))
        good = math.isfinite(sample.speed_mps)
        lines.append(dvl_pd6.InstrumentVelocity(sample.speed_mps, 0.0, 0.0, 0.0, good))
        lines.append(dvl_pd6.ShipVelocity(0.0, sample.speed_mps, 0.0, good))
        east_mps, north_mps = _velocity(sample)
        lines.append(dvl_pd6.EarthVelocity(east_mps, north_mps, 0.0, math.isfinite(east_mps)))
        if math.isfinite(east_mps) and self._last is not None:
            step_s = sample.time_s - self._last.time_s
            self._made_good_m = self._made_good_m[0] + east_mps * step_s, self._made_good_m[1] + north_mps * step_s
        self._last = sample
        lines.append(dvl_pd6.Bottom(*self._made_good_m, 0.0, or_zero(sample.altitude_m), 0.0))
        return [b"".join(map(dvl_pd6.line_of, lines))]


class FakeWaterLinkedUnit:
    """Simulate a Water Linked DVL.

    Velocity, altitude, attitude, and its own dead reckoning, which stays at its start.
    """

    def measured(self, sample: NavSample, utc_s: float) -> list[Message]:
        good = math.isfinite(sample.speed_mps)
        altitude_m = sample.altitude_m if math.isfinite(sample.altitude_m) else -1.0
        microseconds = round(1e6 * utc_s)
        covariance = (1e-4, 0.0, 0.0, 0.0, 1e-4, 0.0, 0.0, 0.0, 1e-4)
        velocity = dvl_water_linked.Velocity(
            sample.speed_mps, 0.0, 0.0, good, altitude_m, 0.01, covariance, microseconds, microseconds, 100.0, 0
        )
        message = dvl_water_linked.message_of(velocity)
        angles = sample.roll_rad, sample.pitch_rad, sample.heading_rad % _TURN
        if all(map(math.isfinite, angles)):
            message += dvl_water_linked.message_of(
                dvl_water_linked.WaterLinkedAttitude(utc_s, 0.0, 0.0, 0.0, 0.1, *angles, 0)
            )
        return [message]


class Nmea2000Unit:
    """Send heading, attitude, position, speed and water depth on NMEA 2000, all of one sample with one sid.

    It claims its address.
    """

    def __init__(self) -> None:
        self._n_samples = 0

    def measured(self, sample: NavSample, utc_s: float) -> list[Message]:
        number, self._n_samples = self._n_samples, self._n_samples + 1
        sid = float(number % _N_SID)
        day, time_of_day_s = divmod(utc_s, _DAY_S)
        heading_rad = sample.heading_rad % _TURN
        records: list[n2k_messages.Record] = [
            n2k_messages.Heading(sid, heading_rad, NAN, NAN, 0.0),
            n2k_messages.Attitude(sid, _half_turn(heading_rad), sample.pitch_rad, sample.roll_rad),
            n2k_messages.RapidPosition(sample.latitude_deg, sample.longitude_deg),
            n2k_messages.RapidCourse(sid, 0.0, heading_rad, sample.speed_mps),
            n2k_messages.Speed(sid, NAN, sample.speed_mps, 0.0),
            n2k_messages.WaterDepth(sid, sample.altitude_m, 0.0, NAN),
        ]
        if number % _CLAIM_EVERY == 0:
            records.append(n2k_messages.SystemTime(sid, 0.0, day, time_of_day_s))
            return [self._claim(), *_frames(records, number)]
        return list(_frames(records, number))

    def _claim(self) -> CanFrame:
        return CanFrame(can_id_of(Identifier(6, ADDRESS_CLAIM, GLOBAL, _N2K_ADDRESS)), _N2K_NAME.to_bytes(8, "little"))


NAVIGATION_UNITS: Final[Mapping[str, Callable[[], FakeNavigation]]] = MappingProxyType(
    {
        "nmea0183": Nmea0183Unit,
        "pixse": PixseUnit,
        "pd6": FakePd6Unit,
        "water_linked": FakeWaterLinkedUnit,
        "nmea2000": Nmea2000Unit,
    }
)


def _sentences(records: Iterable[sentences.Record]) -> bytes:
    return b"".join(sentence(sentences.body_of(record)) for record in records)


def _frames(records: Iterable[n2k_messages.Record], number: int) -> Iterable[CanFrame]:
    for record in records:
        pgn, data = n2k_messages.encode(record)
        can_id = can_id_of(Identifier(MESSAGES[pgn].priority, pgn, GLOBAL, _N2K_ADDRESS))
        for part in frames_of(data, number) if pgn in FAST_PACKET_GROUPS else (data,):
            yield CanFrame(can_id, part)


def _velocity(sample: NavSample) -> tuple[float, float]:
    """Return the velocity east and north, m/s, of a vehicle that travels along its heading."""
    return sample.speed_mps * math.sin(sample.heading_rad), sample.speed_mps * math.cos(sample.heading_rad)


def or_zero(value: float) -> float:
    """Replace a value that was not measured, as devices do."""
    return value if math.isfinite(value) else 0.0


def _half_turn(angle_rad: float) -> float:
    return math.remainder(angle_rad, _TURN)
