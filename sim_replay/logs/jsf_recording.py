"""Read an EdgeTech log (.jsf) as the ports that would have received it.

Layouts are those of EdgeTech's "JSF Data File Description" (0023492). Side-scan messages (type 80) of one subsystem go
to a port `sonar`, NMEA strings (type 2002) to a port `nmea`, pitch and roll (type 2020), put into NMEA 0183, to a port
`motion`. Each is stamped with its own time in the log; a ping with the time at which its last echo was back.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from struct import Struct
from typing import Final

from auv_mcm.clock import Stamp
from auv_mcm.errors import BadInputError, UsageError
from auv_mcm.records import NAN, Notice
from drivers.navigation.nmea0183 import sentence
from drivers.navigation.sentences import Dpt, Pashr, Record, Vtg, body_of
from drivers.recording.session_layout import Recorded
from drivers.sonar.jsf import JsfGrammar, is_answer, is_side_scan, subsystems_text
from drivers.sonar.jsf_messages import (
    DATA_HEADER,
    DOPPLER,
    PORT,
    PRESSURE,
    SIDE_SCAN,
    STARBOARD,
    USED_FORMATS,
    JsfMessage,
    SideScanHeader,
    sound_speed_in,
    to_wire,
)
from sim_replay.logs.log_order import TimeOrder
from sim_replay.logs.message_file import MessageFile

SONAR_PORT: Final = "sonar"
NMEA_PORT: Final = "nmea"
MOTION_PORT: Final = "motion"
DOPPLER_PORT: Final = "doppler"
NO_NAVIGATION: Final = (
    "neither its side-scan messages (type 80, validity bit 0, in minutes of arc: metres of an unknown projection do "
    "not serve) nor NMEA strings (type 2002) give one. Record with the navigation connected to the sonar, or replay "
    "the session that 'auv-mcm run' recorded, which holds every port."
)

NMEA_STRING, PITCH_ROLL = 2002, 2020
_TIME: Final = Struct("<ii")  # seconds since 1970, milliseconds: the first fields of types 2002 and 2020
_STRING_AT: Final = 12  # byte of a message where its text begins (JSF description)
_ATTITUDE: Final = Struct("<24xhh6xHI")  # pitch, roll: 180 / 32768 deg, bow up, port up; heading: 0.01 deg; validity
# Validity; distances to the bottom, cm; velocity to starboard and ahead over the bottom, mm/s; pitch, roll and heading,
# 0.01 deg.
_DOPPLER: Final = Struct("<12xI4i2h10x2hH")
_MOVES, _ABOVE_BOTTOM = 1 << 0, 1 << 5
_HEADS, _PITCHES, _ROLLS = 1 << 6, 1 << 7, 1 << 8
_FIRST_S: Final = 315_532_800  # 1980-01-01, s since 1970: before it a clock was never set
_PITCH_VALID, _ROLL_VALID, _HEADING_VALID = 1 << 6, 1 << 7, 1 << 9

_PROBE_BYTES: Final = 8 << 20  # in this much, sonars that send several frequencies have sent each many times
_PROBE_MESSAGES: Final = 400  # looked at to find which sonars a log holds
_STRAY_FRACTION: Final = 0.05  # of the commonest subsystem's messages; fewer of another come of damaged headers
_MAX_CHANNEL: Final = 3  # that a recorder may count sides up to, from 0 or 1
_MAX_ECHO_S: Final = 5.0  # 3750 m; the decoder refuses what is longer
_MIN_INTERVAL_S: Final = 0.02  # s between pings whose time and range are unknown
# s that recorders may keep messages: navigation farther from the pings around it has its own clock
_APART_S: Final = 1.0
_MIN_APART: Final = 5  # messages that show how far clocks are apart (chosen)
_MAX_HEARD: Final = 4096  # messages between two pings that are looked at, which bounds memory
_CLOCK_NOT_SET: Final = "the sonar's clock was never set: the date is unknown and times count from 1970"
_DAY_S: Final = 86_400.0  # seconds per day


class JsfRecording:
    """Read one JSF file as the bytes its ports received. Every iteration starts anew.

    Counts reader.not_used.subsystem_N, reader.other_messages, reader.time_invalid (side-scan or navigation without a
    time, left out), reader.short (too short for their type), and those of `MessageFile` and `TimeOrder`.
    """

    def __init__(
        self, path: Path, subsystem: int | None, chunk_bytes: int, *, sound_speed_is_set: bool = False
    ) -> None:
        """Select the subsystem to use; None for the highest that the file holds.

        sound_speed_is_set: by the configuration, so that the log need not say it.

        Raises BadInputError for a file without side-scan messages, UsageError where the subsystem is not there.
        """
        self._file = MessageFile(path, JsfGrammar, chunk_bytes)
        self._own: Counter[str] = Counter()
        self.notices: list[Notice] = []
        self._sound_speed_is_set = sound_speed_is_set
        self._has_clock = False
        self._apart_ns: dict[int, int] = {}  # by type, of the clock of navigation from that of the pings
        self._last_ns: int | None = None  # of the newest ping
        self._n_pings = 0
        self._n_without_speed = 0
        self._choice = ""
        self.subsystem = self._chosen(subsystem)

    @property
    def sizes_bytes(self) -> dict[Path, int]:
        return {self._file.path: self._file.size_bytes}

    @property
    def bytes_read(self) -> int:
        """Count the bytes read so far."""
        return self._file.bytes_read

    @property
    def counters(self) -> Counter[str]:
        return self._own + self._file.counters

    def __iter__(self) -> Iterator[Recorded]:
        self._own = Counter()
        self.notices = []
        self._last_ns, self._n_pings, self._n_without_speed = None, 0, 0
        self._judged: dict[int, tuple[int, bool]] = {}  # by type: at which ping, and whether its clock still is apart
        self._channels.start()
        if self._channels.notice:
            text = f"channel numbers in the messages do not name the sides: {self._channels.notice}"
            self._notify("reader.channel_numbers", text, self._file.path.name)
        if self._choice:
            text = f"of several frequencies one is used: {self._choice}"
            self._notify("reader.frequency_chosen", text, self._file.path.name)
        for kind, apart_ns in self._apart_ns.items():
            text = (
                f"the clock of navigation (type {kind}) is {1e-9 * apart_ns:+.1f} s off that of the pings, which is "
                "taken off; set the clocks of sonar and navigation to UTC"
            )
            self._notify("reader.packet_time_doubted", text, self._file.path.name)
        order = TimeOrder[Recorded](self._own)
        sensor: JsfMessage | None = None  # whose sound speed the decoder of the sonar takes, once there is a ping
        for framed in self._file:
            sensor = framed.message if framed.message.message_type in (PRESSURE, DOPPLER) else sensor
            recorded = self._recorded(framed.message, framed.offset)
            if sensor is not None and self._last_ns is not None:
                yield from order.add(_received(SONAR_PORT, to_wire(sensor), self._last_ns))
                sensor = None
            if recorded is not None:
                yield from order.add(recorded)
        yield from order.finish()
        if self._n_pings and self._n_without_speed == self._n_pings and not self._sound_speed_is_set:
            text = (
                "no message says how fast sound is: 1500 m/s is assumed. Set sonar.sound_speed_mps to what was "
                "measured, since ranges are off by as much as it is"
            )
            self._notify("reader.sound_speed_assumed", text, self._file.path.name)
        if (damage := self._file.damage()) is not None:
            self.notices.append(damage)
        if n_back := self._own["reader.time_backwards"]:
            self._notify(
                "reader.time_backwards",
                f"time went backwards {n_back} times; check the recorder's clock",
                self._file.path.name,
            )

    @property
    def frequency_khz(self) -> float:
        """Return the frequency in use, 0 where the messages state none."""
        headers = [
            SideScanHeader(*DATA_HEADER.unpack_from(message.body))
            for message in self._probed
            if message.subsystem == self.subsystem
        ]
        sweeps = [5e-4 * (header.start_frequency_hz + header.end_frequency_hz) for header in headers]
        return float(sorted(sweeps)[len(sweeps) // 2]) if sweeps else 0.0

    def _chosen(self, wanted: int | None) -> int:
        path = self._file.path
        found = self._subsystems()
        self._channels = _learn_channels(self._probed)
        names = " and ".join(map(str, found))
        if not found:
            raise BadInputError(
                f"{path} holds no side-scan message (type 80 of subsystem 20, 21 or 22, in data format 0, 1 or 3). "
                f"Whole messages in it: {self._inventory()}. Fetch the file again if it was cut off, or give a log "
                "recorded with side scan switched on. Formats above 255 are EdgeTech's own: convert them "
                "with its software."
            )
        if wanted is not None and wanted not in found:
            raise UsageError(
                f"sonar.subsystem is {wanted}, but {path} holds side scan of subsystem {names}. Set one that it holds."
            )
        if wanted is None and len(found) > 1:
            self._choice = subsystems_text(found, found[-1])
        return found[-1] if wanted is None else wanted

    def _subsystems(self) -> list[int]:
        """List the side-scan subsystems at the beginning of the file, without those of a few damaged headers."""
        seen: Counter[int] = Counter()
        self._probed: list[JsfMessage] = []
        clocks = {NMEA_STRING: _Clock(), PITCH_ROLL: _Clock()}
        for framed in self._file:
            if framed.message.message_type in clocks and len(framed.message.body) >= _STRING_AT:
                clocks[framed.message.message_type].hear(*_TIME.unpack_from(framed.message.body))
            elif _is_any_channel(framed.message):
                header = SideScanHeader(*DATA_HEADER.unpack_from(framed.message.body))
                if header.data_format not in USED_FORMATS:
                    continue
                self._probed.append(framed.message)
                seen[framed.message.subsystem] += 1
                self._has_clock = self._has_clock or header.utc_s > 0.0
                for clock in clocks.values():
                    clock.ping(header.utc_s)
                if seen.total() >= _PROBE_MESSAGES or framed.offset > _PROBE_BYTES:
                    break
        self._apart_ns = {kind: apart_ns for kind, clock in clocks.items() if (apart_ns := clock.apart_ns())}
        needed = _STRAY_FRACTION * max(seen.values(), default=0)
        return sorted(subsystem for subsystem, n_messages in seen.items() if n_messages >= needed)

    def _inventory(self) -> str:
        kinds: Counter[str] = Counter()
        for framed in self._file:
            message = framed.message
            name = f"type {message.message_type}"
            if message.message_type == SIDE_SCAN:
                header = SideScanHeader(*DATA_HEADER.unpack_from(message.body))
                name += f" of subsystem {message.subsystem} in data format {header.data_format}"
            kinds[name] += 1
        return ", ".join(f"{n} of {name}" for name, n in kinds.most_common(8)) or "none"

    def _recorded(self, message: JsfMessage, offset: int) -> Recorded | None:
        """Convert a message to bytes of a port; None for one that is not used, which is counted."""
        if is_answer(message):
            self._own["reader.other_messages"] += 1
            return None
        if message.message_type == SIDE_SCAN:
            message = self._channels.canonical(message)
            if is_side_scan(message) and message.subsystem == self.subsystem:
                return self._of_ping(message, offset)
            self._own[f"reader.not_used.subsystem_{message.subsystem}"] += 1
            return None
        if message.message_type == NMEA_STRING:
            return self._of_string(message.body, offset)
        if message.message_type == PITCH_ROLL:
            return self._of_motion(message.body, offset)
        if sound_speed_in(message) is not None:
            self._n_without_speed -= self._n_without_speed == self._n_pings
        if message.message_type == PRESSURE:
            return None
        if message.message_type == DOPPLER and self._last_ns is not None:
            return self._of_doppler(message)
        self._own["reader.other_messages"] += 1
        return None

    def _of_ping(self, message: JsfMessage, offset: int) -> Recorded | None:
        header = SideScanHeader(*DATA_HEADER.unpack_from(message.body))
        self._n_pings += 1
        self._n_without_speed += header.stated_sound_speed_mps is None
        echo_s = (header.start_depth_samples + header.n_samples - 0.5) * header.sample_interval_s
        if not 0.0 < echo_s < _MAX_ECHO_S:
            echo_s = 0.0
        if not self._has_clock:
            header = self._counted(header, echo_s, offset)
            message = message._replace(body=DATA_HEADER.pack(*header) + message.body[DATA_HEADER.size :])
        time_ns = self._time_ns(int(header.utc_s), header.milliseconds_today, offset)
        if time_ns is None:
            return None
        if time_ns < _FIRST_S * 1_000_000_000:
            text = f"no date in any message: {_CLOCK_NOT_SET}"
            self._notify_once("reader.time_unknown", text, offset)
        self._last_ns = time_ns + round(1e9 * echo_s)
        return _received(SONAR_PORT, to_wire(message), self._last_ns)

    def _counted(self, header: SideScanHeader, echo_s: float, offset: int) -> SideScanHeader:
        """Time a message whose date is unknown: by the milliseconds of the day, else by the number of its ping."""
        milliseconds = header.milliseconds_today
        if milliseconds <= 0:
            self._notify_once("reader.time_unknown", f"{_CLOCK_NOT_SET}, by the echo time from ping to ping", offset)
            milliseconds = round(1e3 * header.ping_number * max(echo_s, _MIN_INTERVAL_S))
        return header._replace(time_s=1 + milliseconds // 1000, milliseconds_today=milliseconds)

    def _of_doppler(self, message: JsfMessage) -> Recorded | None:
        """Put a Doppler log's speed, altitude and attitude into sentences, stamped with the ping before."""
        if len(message.body) < _DOPPLER.size or self._last_ns is None:
            self._own["reader.short"] += 1
            return None
        validity, *values = _DOPPLER.unpack_from(message.body)
        distances_cm, (starboard, ahead, pitch, roll, heading) = values[:4], values[4:]
        records: list[Record] = []
        if validity & _MOVES:
            records.append(Vtg(NAN, 1e-3 * math.hypot(starboard, ahead)))
        beams_cm = [distance for distance in distances_cm if distance > 0]
        if validity & _ABOVE_BOTTOM and beams_cm:
            records.append(Dpt(0.01 * sum(beams_cm) / len(beams_cm)))
        if validity & (_HEADS | _PITCHES | _ROLLS):
            records.append(
                Pashr(
                    time_of_day_s=1e-9 * self._last_ns % _DAY_S,
                    heading_rad=math.radians(0.01 * heading) if validity & _HEADS else NAN,
                    roll_rad=math.radians(0.01 * roll) if validity & _ROLLS else NAN,
                    pitch_rad=math.radians(0.01 * pitch) if validity & _PITCHES else NAN,
                )
            )
        return _received(DOPPLER_PORT, b"".join(sentence(body_of(record)) for record in records), self._last_ns)

    def _of_string(self, body: bytes, offset: int) -> Recorded | None:
        if len(body) <= _STRING_AT:
            self._own["reader.short"] += 1
            return None
        time_ns = self._sensor_ns(NMEA_STRING, body, offset)
        return (
            None if time_ns is None else _received(NMEA_PORT, body[_STRING_AT:].rstrip(b"\0\r\n ") + b"\r\n", time_ns)
        )

    def _of_motion(self, body: bytes, offset: int) -> Recorded | None:
        if len(body) < _ATTITUDE.size:
            self._own["reader.short"] += 1
            return None
        time_ns = self._sensor_ns(PITCH_ROLL, body, offset)
        if time_ns is None:
            return None
        pitch, roll, heading, validity = _ATTITUDE.unpack_from(body)
        record = Pashr(
            time_of_day_s=1e-9 * time_ns % _DAY_S,
            heading_rad=math.radians(0.01 * heading) if validity & _HEADING_VALID else NAN,
            roll_rad=math.pi * roll / 32768.0 if validity & _ROLL_VALID else NAN,
            pitch_rad=math.pi * pitch / 32768.0 if validity & _PITCH_VALID else NAN,
        )
        return _received(MOTION_PORT, sentence(body_of(record)), time_ns)

    def _sensor_ns(self, kind: int, body: bytes, offset: int) -> int | None:
        """Return the time of a navigation message of a type by the clock of the pings, ns since 1970."""
        seconds, milliseconds = _TIME.unpack_from(body)
        time_ns = self._time_ns(seconds, milliseconds, offset)
        last_ns, apart_ns = self._last_ns, self._apart_ns.get(kind, 0)
        if time_ns is None or not apart_ns:
            return time_ns
        judged_ns, is_apart = self._judged.get(kind, (None, True))
        if last_ns != judged_ns and last_ns is not None:  # by the first message behind a ping, as pings may pause
            off_ns = abs(time_ns - apart_ns - last_ns)
            is_apart = off_ns <= _APART_S * 1e9 or off_ns < abs(time_ns - last_ns)
            self._judged[kind] = last_ns, is_apart
        if not is_apart:
            return time_ns  # a clock was set meanwhile
        self._own["reader.packet_time_doubted"] += 1
        return time_ns - apart_ns

    def _time_ns(self, seconds: int, milliseconds: int, offset: int) -> int | None:
        """Return the time since 1970; None, counted, for a clock that was never set."""
        if seconds > 0:
            return seconds * 1_000_000_000 + milliseconds % 1000 * 1_000_000
        if self._last_ns is not None:
            return self._last_ns  # strings of sonars without a clock, or before version 8, carry no time
        self._own["reader.time_invalid"] += 1
        if self._own["reader.time_invalid"] == 1:
            text = "a message has no time; such messages are left out and counted: set the sonar's clock"
            self._notify("reader.time_invalid", text, f"{self._file.path.name}, byte {offset}")
        return None

    def _notify_once(self, code: str, text: str, offset: int) -> None:
        if not any(notice.code == code for notice in self.notices):
            self._notify(code, text, f"{self._file.path.name}, byte {offset}")

    def _notify(self, code: str, text: str, place: str) -> None:
        self.notices.append(Notice(code=code, text=text, place=place))


def _is_any_channel(message: JsfMessage) -> bool:
    return is_side_scan(message._replace(channel=PORT)) and message.channel <= _MAX_CHANNEL


class _Clock:
    """Learn how far a clock of navigation is off that of the pings, by where its messages stand among them."""

    def __init__(self) -> None:
        self._ping_s = 0.0
        self._heard_s: list[float] = []  # since the newest ping
        self._apart_s: list[tuple[float, float]] = []  # from the middle of two pings, and beyond both

    def ping(self, time_s: float) -> None:
        """Take the time of a side of a ping, 0 for none."""
        if self._ping_s > 0.0 and time_s > 0.0:
            middle_s, half_s = 0.5 * (self._ping_s + time_s), 0.5 * abs(time_s - self._ping_s)
            self._apart_s += [(heard_s - middle_s, abs(heard_s - middle_s) - half_s) for heard_s in self._heard_s]
        self._ping_s, self._heard_s = time_s, []

    def hear(self, seconds: int, milliseconds: int) -> None:
        """Take the time in a navigation message."""
        if seconds > 0 and self._ping_s > 0.0 and len(self._heard_s) < _MAX_HEARD:
            self._heard_s.append(seconds + 1e-3 * (milliseconds % 1000))

    def apart_ns(self) -> int:
        """Return by how much the clock of navigation is ahead, 0 where the difference is that of any recorder."""
        if len(self._apart_s) < _MIN_APART or median(beyond_s for _, beyond_s in self._apart_s) <= _APART_S:
            return 0
        return round(1e9 * median(apart_s for apart_s, _ in self._apart_s))


class _Channels:
    """Give side-scan messages the channels that the format has for port and starboard, 0 and 1.

    first: the lower of two channels in use. by_order: all messages have one channel, and those of a ping differ.
    """

    def __init__(self, first: int, *, by_order: bool, only: int) -> None:
        self._first, self._by_order, self._only = first, by_order, only
        self.notice = ""
        if by_order:
            self.notice = (
                f"both sides have channel {only}: the first of a ping is taken as port. If port and starboard look "
                "exchanged, set sonar.sides: swapped"
            )
        self.start()

    def start(self) -> None:
        """Start at the beginning of the file."""
        self._last: dict[int, int] = {}  # by subsystem the ping whose port is there

    def canonical(self, message: JsfMessage) -> JsfMessage:
        """Return a side-scan message with channel 0 for port and 1 for starboard."""
        if not self._by_order:
            return message if self._first == PORT else message._replace(channel=message.channel - self._first)
        if message.channel != self._only:
            return message
        number = SideScanHeader(*DATA_HEADER.unpack_from(message.body)).ping_number
        is_second = self._last.get(message.subsystem) == number
        if is_second:
            del self._last[message.subsystem]
        else:
            self._last[message.subsystem] = number
        return message._replace(channel=STARBOARD if is_second else PORT)


def _learn_channels(messages: list[JsfMessage]) -> _Channels:
    """Learn from a file's first side-scan messages how its recorder numbers channels."""
    counts = Counter(message.channel for message in messages)
    used = sorted(channel for channel, n in counts.items() if n >= _STRAY_FRACTION * max(counts.values()))
    if len(used) == 2:
        return _Channels(used[0] if used[1] == used[0] + 1 else PORT, by_order=False, only=PORT)
    by_order = False
    if len(used) == 1:
        pings: dict[tuple[int, int], set[bytes]] = {}
        for message in messages:
            number = SideScanHeader(*DATA_HEADER.unpack_from(message.body)).ping_number
            pings.setdefault((message.subsystem, number), set()).add(message.body[DATA_HEADER.size :])
        by_order = 2 * sum(len(bodies) == 2 for bodies in pings.values()) > len(pings)
    return _Channels(PORT, by_order=by_order, only=used[0] if used else PORT)


def _received(port: str, data: bytes, time_ns: int) -> Recorded:
    return Recorded(port, "in", Stamp(time_ns, time_ns), data)
