"""Drive EdgeTech side-scan sonars: framing of JSF, decoding into frames, commands."""

from __future__ import annotations

import math
import re
from collections import Counter
from struct import Struct
from typing import Final

from auv_mcm.clock import Stamp
from auv_mcm.records import NAN, EchoTrace, NavSample
from drivers.framing import Grammar, Refused, StampedFramer, StampedMessage
from drivers.sonar.jsf_messages import (
    DATA_HEADER_BYTES,
    HEADER,
    HEADER_BYTES,
    PING_ENABLE,
    PING_GAIN,
    PING_RANGE,
    PORT,
    SIDE_SCAN,
    STARBOARD,
    SYSTEM_TIME,
    Command,
    DataFormat,
    JsfMessage,
    PositionUnits,
    SideScanData,
    SideScanHeader,
    Validity,
    amplitude,
    declared_data_bytes,
    decode_data,
    read_time,
    set_value,
    sound_speed_in,
)
from drivers.sonar.pairing import SidePairer
from drivers.sonar.sonar_decoder import SonarFrame, SonarReply, SonarSettings
from drivers.sonar.sonar_settings import check_settings

HIGH_FREQUENCY: Final = 21  # subsystem
SIDE_SCAN_SUBSYSTEMS: Final = (20, 21, 22)  # low, high, very high frequency
MAX_RANGE_M: Final = 500.0  # m: beyond any side-scan of this protocol
MAX_GAIN: Final = 100  # per cent
NOMINAL_SOUND_SPEED_MPS: Final = 1500.0  # m/s, while the sonar reports none

_MAX_BODY_BYTES: Final = (1 << 18) - 1  # 32 times the samples that side-scans of AUVs send
_MAX_OTHER_BYTES: Final = 1 << 14  # only its size gives the length of other messages: a wrong one costs little waiting
_PADDING_BYTES: Final = 64  # that a data message may have behind its samples
_LENGTH_KNOWN_BYTES: Final = HEADER_BYTES + 116  # of a data message, to know how many samples it has
_MAX_WEIGHTING: Final = 40  # power of two that scales samples: up to it squares of 16-bit samples fit a 32-bit float
_MAX_REPORTED_RANGE_M: Final = 2000.0  # m: longer traces are damage
_NAVIGATION: Final = (
    Validity.POSITION | Validity.HEADING | Validity.PITCH_ROLL | Validity.DEPTH | Validity.ALTITUDE | Validity.SPEED
)
_KNOT_MPS: Final = 1852.0 / 3600.0  # m/s: a nautical mile in an hour
_SAME_SPEED_MPS: Final = 0.5  # m/s that the sound speed changes by before ranges are scaled anew: 2.5 cm at 75 m
_REPEATED_S: Final = (
    1.25  # between the second of slow receivers and the 1.5 s after which a unit without a new position counts as lost
)

_REPEATED_MOVING_S: Final = 15.0  # s, while the vehicle moves: acoustic positioning comes as seldom as that
_MOVING_DKN: Final = 6  # tenths of a knot, 0.3 m/s: a place then changes by its last digit, 0.2 m, each second

_SPARSE_APART: Final = 15  # 1e-4 minutes of arc, 3 m: a place that changes so far at once came late

# Sync; version <= 0x20; session; type 1..9999; command 0..3; subsystem; channel < 16; sequence; reserved; size below
# _MAX_BODY_BYTES.
_AFTER_SYNC: Final = (
    rb"[\x00-\x20][\x00-\xff](?:[\x01-\xff]\x00|[\x00-\xff][\x01-\x26]|[\x00-\x0f]\x27)"
    rb"[\x00-\x03][\x00-\xff][\x00-\x0f][\x00-\xff]{5}[\x00-\x03]\x00"
)
_HEADER: Final = re.compile(rb"\x01\x16" + _AFTER_SYNC)
_SYNC: Final = re.compile(rb"\x01(?=\x16%b)" % _AFTER_SYNC)  # one byte wide, as headers may overlap
_FIRST_BYTE: Final = 0x01
_SYNC_BYTES: Final = b"\x01\x16"
_START_OF: Final = re.Match.start
_KIND_OFFSET: Final = 4
_KIND_AND_SIZE: Final = Struct("<H6xI").unpack_from


class JsfGrammar(Grammar[JsfMessage]):
    """Frame JSF, which has no checksum: accept a message with a plausible header if no other begins inside it.

    If one seems to begin inside, either the outer lost its end and swallowed the beginning of the next, or samples look
    like a header by chance. The inner is believed if another follows it inside or it ends where the outer does; else
    the outer, if a header follows it.
    """

    name = "jsf"
    head_bytes = HEADER_BYTES
    max_message_bytes = HEADER_BYTES + _MAX_BODY_BYTES + HEADER_BYTES  # with the header that follows
    proven = False

    def find(self, buffer: bytearray, start: int, refused: Refused) -> int:
        for at in map(_START_OF, _SYNC.finditer(buffer, start)):
            reason = None if at == start else _refusal(buffer, at)
            if reason is None:
                return at
            refused[reason] = refused.get(reason, 0) + 1
        return -1

    def read(self, buffer: bytearray, at: int) -> tuple[JsfMessage, int] | int | str:
        reason = _refusal(buffer, at)
        if reason is not None:
            return reason
        n_there = len(buffer) - at
        _, version, session, kind, command, subsystem, channel, sequence, reserved, n_body = HEADER.unpack_from(
            buffer, at
        )
        if kind == SIDE_SCAN and n_there < _LENGTH_KNOWN_BYTES:
            return _LENGTH_KNOWN_BYTES
        n_bytes: int = HEADER_BYTES + n_body
        if n_there < n_bytes:
            return n_bytes
        end = at + n_bytes
        if n_there < n_bytes + HEADER_BYTES and _HEADER.search(buffer, at + HEADER_BYTES, end) is not None:
            return n_bytes + HEADER_BYTES
        body = bytes(buffer[at + HEADER_BYTES : end])
        return JsfMessage(kind, body, command, subsystem, channel, sequence, session, version, reserved), n_bytes


def _refusal(buffer: bytearray, at: int) -> str | None:
    """Return why the candidate at `at` is refused, None if it is not, or if that is not known yet."""
    kind, n_body = _KIND_AND_SIZE(buffer, at + _KIND_OFFSET)
    end = at + HEADER_BYTES + n_body
    n_there = len(buffer)
    if kind == SIDE_SCAN:
        if n_body < DATA_HEADER_BYTES:
            return "length"
        if n_there < at + _LENGTH_KNOWN_BYTES:
            return None
        if not 0 <= n_body - declared_data_bytes(buffer, at + HEADER_BYTES) <= _PADDING_BYTES:
            return "length"
    elif n_body > _MAX_OTHER_BYTES:
        return "length"
    if n_there < end:
        return None
    inner_at = buffer.find(_SYNC_BYTES, at + HEADER_BYTES, end)
    if inner_at >= 0 and _HEADER.match(buffer, inner_at, end) is None:
        inner = _HEADER.search(buffer, inner_at + 1, end)
        inner_at = -1 if inner is None else inner.start()
    if inner_at < 0:
        return None
    if n_there >= end + HEADER_BYTES and (buffer[end] != _FIRST_BYTE or _HEADER.match(buffer, end) is None):
        return "swallowed_others"
    # The inner message ends at `end`, or before it where another begins.
    _, n_inner = _KIND_AND_SIZE(buffer, inner_at + _KIND_OFFSET)
    inner_end = inner_at + HEADER_BYTES + n_inner
    is_followed = inner_end == end or (inner_end < end and _HEADER.match(buffer, inner_end) is not None)
    return "swallowed_others" if is_followed else None


class JsfDecoder:
    """Decode data messages of one subsystem to frames of amplitude, both sides joined, and answers to replies.

    Ranges are made with the sound speed that the sonar measured, changed only when it moved by half a metre per second,
    so that consecutive pings keep one sample layout; with that of a pressure sensor or Doppler log where it reports
    none; with 1500 m/s without either. Messages repeat the position until the topside has a new one: a repeated one is
    not taken as a fix for 1.25 s, or for 15 s while the speed says that the vehicle moves, so that the track runs
    between fixes and not in steps.
    """

    def __init__(self, *, subsystem: int = HIGH_FREQUENCY) -> None:
        """subsystem: 20, 21 or 22, as one sonar may send several frequencies at once."""
        self._framer = StampedFramer(JsfGrammar())
        self._pairer = SidePairer(self._framer.counters)
        self._subsystem = subsystem
        self._sound_speed_mps = NOMINAL_SOUND_SPEED_MPS
        self._sensor_speed_mps: float | None = None  # of sound, by a sensor's own message
        self._place_since_s = math.inf
        self._is_sparse = False  # positions were seen to come seldom, and far apart
        self._fix: tuple[int, int, float] | None = None  # longitude, latitude, and when they were first reported

    @property
    def counters(self) -> Counter[str]:
        return self._framer.counters

    def feed(self, data: bytes, stamp: Stamp) -> list[SonarFrame | SonarReply]:
        return self._decoded(self._framer.feed(data, stamp))

    def finish(self) -> list[SonarFrame | SonarReply]:
        return [*self._decoded(self._framer.finish()), *self._pairer.finish()]

    def _decoded(self, messages: list[StampedMessage[JsfMessage]]) -> list[SonarFrame | SonarReply]:
        found: list[SonarFrame | SonarReply] = []
        for arrived in messages:
            message = arrived.message
            if message.command in (Command.REPLY, Command.ERROR):
                found.append(_reply(arrived))
            elif message.message_type != SIDE_SCAN:
                self._sensor_speed_mps = sound_speed_in(message) or self._sensor_speed_mps
                self.counters["jsf.other_messages"] += 1
            elif message.subsystem != self._subsystem or message.channel not in (PORT, STARBOARD):
                name = (
                    f"subsystem_{message.subsystem}" if message.subsystem in SIDE_SCAN_SUBSYSTEMS else "other_subsystem"
                )
                self.counters[f"jsf.not_used.{name}"] += 1
            else:
                found += self._frames(arrived)
        return found

    def _frames(self, arrived: StampedMessage[JsfMessage]) -> list[SonarFrame]:
        data = decode_data(arrived.message.body)
        assert data is not None, "the framer lets no shorter body pass"
        header = data.header
        sound_speed_mps = self._range_speed_mps(header)
        spacing_m = 0.5 * sound_speed_mps * header.sample_interval_s
        reason = _unusable(data, spacing_m)
        if reason is not None:
            self.counters[f"jsf.refused.{reason}"] += 1
            return []
        trace = EchoTrace(
            samples=amplitude(data), first_range_m=header.start_depth_samples * spacing_m, spacing_m=spacing_m
        )
        to_port = arrived.message.channel == PORT
        time_s = header.utc_s if header.utc_s > 0.0 else None
        altitude_m = _valued(header, Validity.ALTITUDE, 1e-3 * header.altitude_mm)
        frame = SonarFrame(
            number=header.ping_number,
            port=trace if to_port else None,
            starboard=None if to_port else trace,
            transfer="amplitude",
            received=arrived.received,
            n_bytes=arrived.n_bytes,
            sound_speed_mps=sound_speed_mps,
            altitude_m=altitude_m if altitude_m > 0.0 else NAN,
            device_time_s=time_s,
            device_time_is_utc=time_s is not None,
            navigation=_navigation(header, NAN if time_s is None else time_s, is_fix=self._is_fix(header)),
        )
        return self._pairer.add(frame)

    def _is_fix(self, header: SideScanHeader) -> bool:
        """Return whether a message's position is new, not that of an earlier message repeated."""
        place = header.longitude, header.latitude
        moves = self._is_sparse or (header.validity & Validity.SPEED and header.speed_dkn >= _MOVING_DKN)
        limit_s = _REPEATED_MOVING_S if moves else _REPEATED_S
        if self._fix is not None and self._fix[:2] == place and 0.0 < header.utc_s - self._fix[2] < limit_s:
            self.counters["jsf.repeated_position"] += 1
            return False
        if self._fix is None or self._fix[:2] != place:
            stood_s, self._place_since_s = header.utc_s - self._place_since_s, header.utc_s
        else:
            stood_s = 0.0
        if self._fix is not None and stood_s > _REPEATED_S:
            apart = max(abs(now - before) for now, before in zip(place, self._fix, strict=False))
            self._is_sparse = self._is_sparse or apart >= _SPARSE_APART
        self._fix = *place, header.utc_s
        return True

    def _range_speed_mps(self, header: SideScanHeader) -> float:
        sound_speed_mps = header.sound_speed_mps
        if not (header.validity & Validity.SOUND_SPEED and 1300.0 <= sound_speed_mps <= 1700.0):
            self.counters["jsf.sound_speed_not_told"] += 1
            sound_speed_mps = self._sensor_speed_mps or self._sound_speed_mps
        if abs(sound_speed_mps - self._sound_speed_mps) >= _SAME_SPEED_MPS:
            self._sound_speed_mps = sound_speed_mps
        return self._sound_speed_mps


def commands(settings: SonarSettings) -> tuple[bytes, ...]:
    """Return the commands that make the subsystem ping with these settings; without a gain, its own is kept.

    The number of samples and the sound speed are the sonar's own affair. Raises UsageError for what it cannot do.
    """
    check_settings(settings, "jsf", max_range_m=MAX_RANGE_M, max_gain=MAX_GAIN)
    subsystem = settings.subsystem or HIGH_FREQUENCY
    parts = [set_value(PING_RANGE, round(1e3 * settings.range_m), subsystem)]
    if settings.gain is not None:
        parts.append(set_value(PING_GAIN, settings.gain, subsystem))
    return *parts, set_value(PING_ENABLE, int(settings.enabled), subsystem)


def _unusable(data: SideScanData, spacing_m: float) -> str | None:
    """Return why no trace can be made of it, in one word."""
    header = data.header
    if header.data_format not in (DataFormat.ENVELOPE, DataFormat.ANALYTIC):
        return "data_format"
    if (
        header.n_samples == 0
        or spacing_m <= 0.0
        or (header.start_depth_samples + header.n_samples) * spacing_m > _MAX_REPORTED_RANGE_M
    ):
        return "range"
    if abs(header.weighting) > _MAX_WEIGHTING:
        return "weighting"
    return None


def _valued(header: SideScanHeader, field: int, value: float) -> float:
    return value if header.validity & field else NAN


def _navigation(header: SideScanHeader, time_s: float, *, is_fix: bool) -> NavSample | None:
    """Return the vehicle's navigation in the message; None if it has none.

    Pitch is bow up, roll port up. is_fix: its position is a new one.
    """
    if not header.validity & _NAVIGATION:
        return None
    latitude_deg = longitude_deg = NAN
    if is_fix and header.validity & Validity.POSITION and header.units == PositionUnits.ARC_MINUTES_1E_4:
        latitude_deg, longitude_deg = header.latitude / 600_000.0, header.longitude / 600_000.0
        if abs(latitude_deg) > 90.0 or abs(longitude_deg) > 180.0:
            latitude_deg = longitude_deg = NAN
    return NavSample(
        time_s=time_s,
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        heading_rad=_valued(header, Validity.HEADING, math.radians(0.01 * header.heading_cdeg)),
        pitch_rad=_valued(header, Validity.PITCH_ROLL, math.pi * header.pitch_counts / 32768.0),
        roll_rad=_valued(header, Validity.PITCH_ROLL, math.pi * header.roll_counts / 32768.0),
        depth_m=_valued(header, Validity.DEPTH, 1e-3 * header.depth_mm),
        altitude_m=_valued(header, Validity.ALTITUDE, 1e-3 * header.altitude_mm),
        speed_mps=_valued(header, Validity.SPEED, 0.1 * _KNOT_MPS * header.speed_dkn),
    )


def _reply(arrived: StampedMessage[JsfMessage]) -> SonarReply:
    message = arrived.message
    accepted = message.command == Command.REPLY
    return SonarReply(
        request=message.message_type,
        accepted=accepted,
        received=arrived.received,
        n_bytes=arrived.n_bytes,
        utc_s=read_time(message.body) if accepted and message.message_type == SYSTEM_TIME else None,
    )
