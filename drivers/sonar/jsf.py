"""Drive EdgeTech side-scan sonars: framing of JSF, decoding into frames, commands."""

from __future__ import annotations

import math
import re
from collections import Counter, deque
from collections.abc import Sequence
from struct import Struct
from typing import Final

from auv_mcm.clock import Stamp
from auv_mcm.records import NAN, EchoTrace, NavSample, Notice
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
    USED_FORMATS,
    Command,
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
from drivers.sonar.sonar_decoder import SonarFrame, SonarItem, SonarReply, SonarSettings
from drivers.sonar.sonar_settings import check_settings

HIGH_FREQUENCY: Final = 21  # subsystem
SUBSYSTEM_NAMES: Final = {20: "low frequency", 21: "high frequency", 22: "very high frequency"}
SIDE_SCAN_SUBSYSTEMS: Final = tuple(SUBSYSTEM_NAMES)
MAX_RANGE_M: Final = 500.0  # m: beyond any side-scan of this protocol
MAX_GAIN: Final = 100  # per cent
NOMINAL_SOUND_SPEED_MPS: Final = 1500.0  # m/s, while the sonar reports none

_MAX_BODY_BYTES: Final = (1 << 18) - 1  # 32 times the samples that side-scans of AUVs send
_FIRST_SENSOR: Final = 1000  # types from here on are of sensors, navigation and bathymetry; commands have lower ones
_MAX_OTHER_BYTES: Final = 1 << 14  # only its size gives the length of other messages: a longer one needs another behind
_MAX_FILE_BYTES: Final = (1 << 24) - 1  # of a message in a file, where nobody waits: bathymetry and stave data are long
_OFTEN: Final = 5  # messages of a subsystem, after which it counts (chosen)
_STRAY_FRACTION: Final = (
    0.05  # of the commonest subsystem's messages; fewer of another come of damaged headers (chosen)
)
_RECENT: Final = 200  # messages that are counted: 5 s at 20 pings a second, after which a frequency that ended is left
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

# Sync; version <= 0x20; session; type 1..9999; command 0..3; subsystem; channel < 16; sequence; reserved; the low two
# bytes of the size, the high ones by the longest message.
_AFTER_SYNC: Final = (
    rb"[\x00-\x20][\x00-\xff](?:[\x01-\xff]\x00|[\x00-\xff][\x01-\x26]|[\x00-\x0f]\x27)"
    rb"[\x00-\x03][\x00-\xff][\x00-\x0f][\x00-\xff]{5}"
)
_ON_LINKS: Final = _AFTER_SYNC + rb"[\x00-\x03]\x00"  # up to _MAX_BODY_BYTES
_IN_FILES: Final = _AFTER_SYNC + rb"[\x00-\xff]\x00"  # up to _MAX_FILE_BYTES
_FIRST_BYTE: Final = 0x01
_SYNC_BYTES: Final = b"\x01\x16"
_START_OF: Final = re.Match.start
_KIND_OFFSET: Final = 4
_KIND_AND_SIZE: Final = Struct("<H6xI").unpack_from


class JsfGrammar(Grammar[JsfMessage]):
    """Frame JSF, which has no checksum: accept a message with a plausible header if no other begins inside it.

    If one seems to begin inside, either the outer lost its end and swallowed the beginning of the next, or samples look
    like a header by chance. The inner is believed if another follows it inside or it ends where the outer does; else
    the outer, if a header follows it. A long message of another type than side scan is believed only if a header, or
    the end of the file, follows it, whatever is inside.
    """

    name = "jsf"
    head_bytes = HEADER_BYTES
    proven = False

    def __init__(self, file_bytes: int | None = None) -> None:
        """file_bytes: size of the file that is read, None for a link, where long messages would be waited for."""
        self._max_body_bytes = _MAX_BODY_BYTES if file_bytes is None else _MAX_FILE_BYTES
        after_sync = _ON_LINKS if file_bytes is None else _IN_FILES
        self._header = re.compile(rb"\x01\x16" + after_sync)
        self._sync = re.compile(rb"\x01(?=\x16%b)" % after_sync)  # one byte wide, as headers may overlap
        self._file_bytes = -1 if file_bytes is None else file_bytes
        self._n_forgotten = 0

    @property
    def max_message_bytes(self) -> int:
        """Return the length of the longest message, with the header that follows."""
        return HEADER_BYTES + self._max_body_bytes + HEADER_BYTES

    def find(self, buffer: bytearray, start: int, refused: Refused) -> int:
        for at in map(_START_OF, self._sync.finditer(buffer, start)):
            reason = None if at == start else self._refusal(buffer, at)
            if reason is None:
                return at
            refused[reason] = refused.get(reason, 0) + 1
        return -1

    def read(self, buffer: bytearray, at: int) -> tuple[JsfMessage, int] | int | str:
        reason = self._refusal(buffer, at)
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
        if n_there < n_bytes + HEADER_BYTES and (
            self._needs_a_follower(kind, n_body, end)
            or (not _is_long(kind, n_body) and self._header.search(buffer, at + HEADER_BYTES, end) is not None)
        ):
            return n_bytes + HEADER_BYTES
        body = bytes(buffer[at + HEADER_BYTES : end])
        return JsfMessage(kind, body, command, subsystem, channel, sequence, session, version, reserved), n_bytes

    def forget(self, n_bytes: int) -> None:
        self._n_forgotten += n_bytes

    def _needs_a_follower(self, kind: int, n_body: int, end: int) -> bool:
        """Check whether a message counts only if a header follows; the end of a file is as good."""
        return _is_long(kind, n_body) and self._n_forgotten + end != self._file_bytes

    def _refusal(self, buffer: bytearray, at: int) -> str | None:
        """Return why the candidate at `at` is refused, None if it is not, or if that is not known yet."""
        kind, n_body = _KIND_AND_SIZE(buffer, at + _KIND_OFFSET)
        end = at + HEADER_BYTES + n_body
        n_there = len(buffer)
        if n_body > self._max_body_bytes:
            return "length"
        if kind == SIDE_SCAN:
            if n_body < DATA_HEADER_BYTES:
                return "length"
            if n_there < at + _LENGTH_KNOWN_BYTES:
                return None
            declared = declared_data_bytes(buffer, at + HEADER_BYTES)
            if declared is not None and not 0 <= n_body - declared <= _PADDING_BYTES:
                return "length"
        elif _is_long(kind, n_body):
            if n_there < end + HEADER_BYTES or not self._needs_a_follower(kind, n_body, end):
                return None
            return None if self._header.match(buffer, end) is not None else "length"
        if n_there < end:
            return None
        inner_at = buffer.find(_SYNC_BYTES, at + HEADER_BYTES, end)
        if inner_at >= 0 and self._header.match(buffer, inner_at, end) is None:
            inner = self._header.search(buffer, inner_at + 1, end)
            inner_at = -1 if inner is None else inner.start()
        if inner_at < 0:
            return None
        if n_there >= end + HEADER_BYTES and (buffer[end] != _FIRST_BYTE or self._header.match(buffer, end) is None):
            return "swallowed_others"
        # The inner message ends at `end`, or before it where another begins.
        _, n_inner = _KIND_AND_SIZE(buffer, inner_at + _KIND_OFFSET)
        inner_end = inner_at + HEADER_BYTES + n_inner
        is_followed = inner_end == end or (inner_end < end and self._header.match(buffer, inner_end) is not None)
        return "swallowed_others" if is_followed else None


def _is_long(kind: int, n_body: int) -> bool:
    """Check whether a message is so long that its size has to be confirmed."""
    return kind != SIDE_SCAN and n_body > _MAX_OTHER_BYTES


class JsfDecoder:
    """Decode data messages of one subsystem to frames of amplitude, both sides joined, and answers to replies.

    Ranges are made with the sound speed that the sonar measured, changed only when it moved by half a metre per second,
    so that consecutive pings keep one sample layout; with that of a pressure sensor or Doppler log where it reports
    none; with 1500 m/s without either. Messages repeat the position until the topside has a new one: a repeated one is
    not taken as a fix for 1.25 s, or for 15 s while the speed says that the vehicle moves, so that the track runs
    between fixes and not in steps.
    """

    def __init__(self, *, subsystem: int | None = None) -> None:
        """subsystem: 20, 21 or 22, as one sonar may send several frequencies at once; None for the highest heard."""
        self._framer = StampedFramer(JsfGrammar())
        self.counters = self._framer.counters
        self._pairer = SidePairer(self._framer.counters)
        self._subsystem = subsystem or HIGH_FREQUENCY
        self._heard: deque[int] | None = deque(maxlen=_RECENT) if subsystem is None else None  # subsystems
        self._is_notified = False
        self._sound_speed_mps = NOMINAL_SOUND_SPEED_MPS
        self._sensor_speed_mps: float | None = None  # of sound, by a sensor's own message
        self._place_since_s = math.inf
        self._is_sparse = False  # positions were seen to come seldom, and far apart
        self._fix: tuple[int, int, float] | None = None  # longitude, latitude, and when they were first reported

    def feed(self, data: bytes, stamp: Stamp) -> list[SonarItem]:
        return self._decoded(self._framer.feed(data, stamp))

    def finish(self) -> list[SonarItem]:
        return [*self._decoded(self._framer.finish()), *self._pairer.finish()]

    def _decoded(self, messages: list[StampedMessage[JsfMessage]]) -> list[SonarItem]:
        found: list[SonarItem] = []
        for arrived in messages:
            message = arrived.message
            if self._heard is not None and is_side_scan(message):
                found += self._follow_highest(message.subsystem, self._heard)
            if is_answer(message):
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

    def _follow_highest(self, subsystem: int, heard: deque[int]) -> list[Notice]:
        """Use the highest frequency that is heard often enough to come of no damage; report the choice once."""
        heard.append(subsystem)
        counts = Counter(heard)
        enough = max(_OFTEN, _STRAY_FRACTION * max(counts.values()))
        often = sorted(known for known, n_messages in counts.items() if n_messages >= enough)
        if not often:
            return []
        self._subsystem = often[-1]
        if len(often) < 2 or self._is_notified:
            return []
        self._is_notified = True
        return [
            Notice(
                code="sonar_frequency_chosen",
                text=f"of several frequencies one is used: {subsystems_text(often, self._subsystem)}",
            )
        ]

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
        sound_speed_mps = header.stated_sound_speed_mps
        if sound_speed_mps is None:
            self.counters["jsf.sound_speed_not_told"] += 1
            sound_speed_mps = self._sensor_speed_mps or self._sound_speed_mps
        if abs(sound_speed_mps - self._sound_speed_mps) >= _SAME_SPEED_MPS:
            self._sound_speed_mps = sound_speed_mps
        return self._sound_speed_mps


def is_side_scan(message: JsfMessage) -> bool:
    """Check whether a message is a side of a ping, of any frequency."""
    return (
        message.message_type == SIDE_SCAN
        and message.subsystem in SIDE_SCAN_SUBSYSTEMS
        and message.channel in (PORT, STARBOARD)
        and not is_answer(message)
    )


def is_answer(message: JsfMessage) -> bool:
    """Check whether a message answers a command: what is measured carries the byte of a reply in EdgeTech's files."""
    is_measured = message.message_type == SIDE_SCAN or message.message_type >= _FIRST_SENSOR
    return message.command == Command.ERROR or (message.command == Command.REPLY and not is_measured)


def subsystems_text(there: Sequence[int], used: int) -> str:
    """Describe which of a sonar's frequencies is used, and how to change it."""
    others = " or ".join(str(subsystem) for subsystem in there if subsystem != used)
    names = " and ".join(f"{subsystem} ({SUBSYSTEM_NAMES[subsystem]})" for subsystem in there)
    return f"side scan comes of subsystems {names}: {used} is used. Set sonar.subsystem: {others} for another"


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
    if header.data_format not in USED_FORMATS:
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
        heading_rad=_valued(header, Validity.HEADING, math.radians(header.heading_deg)),
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
