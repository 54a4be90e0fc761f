"""Read a SonarView log (.svlog) as the ports that would have received it.

The log is what the sonar sent, packet after packet, with what SonarView heard of the vehicle between (Cerulean,
"Cerulean Ping Protocol", General Packet Definitions): JSON_WRAPPER (10, the log's head with its `timestamp`),
NMEA_WRAPPER (109, a sentence), MAVLINK_WRAPPER (150, a message as JSON). Side-scan profiles (2198) go to a port
`sonar`, sentences to a port `nmea`, positions and attitudes of MAVLink, put into NMEA 0183, to a port `mavlink`.

No packet carries the time at which it was written. Pings have the sonar's counter of milliseconds, which starts at the
head's time stamp. Where port and starboard have counters of their own, profiles go on with the first one's and with
its numbers of pings, in the order of transmissions (`svlog_heads`). What stands between two pings is stamped with the
later one, no more than one interval too late, which the times in the sentences take off again
(`NavUnitSettings.use_unit_time`).
"""

from __future__ import annotations

import json
import math
from collections import Counter, deque
from collections.abc import Hashable, Iterable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from struct import Struct
from typing import Any, Final

from auv_mcm.clock import Stamp
from auv_mcm.records import NAN, Notice
from drivers.navigation.nmea0183 import sentence
from drivers.navigation.sentences import Gga, Pashr, Record, Vtg, body_of
from drivers.recording.session_layout import Recorded
from drivers.sonar import ping_messages
from drivers.sonar.ping_messages import JsonWrapper, PingMessage, decode, to_wire
from drivers.sonar.ping_protocol import PingGrammar
from drivers.sonar.ping_sides import frequency_text, is_same_frequency, look_side
from sim_replay.logs.message_file import MessageFile
from sim_replay.logs.svlog_heads import COUNTER_MS, RESTART_MS, HeadOrder, Offsets, Profile, signed_ms

SONAR_PORT: Final = "sonar"
NMEA_PORT: Final = "nmea"
MAVLINK_PORT: Final = "mavlink"
NO_NAVIGATION: Final = (
    "there is none in NMEA sentences (packet 109: GGA, RMC or GLL) nor in MAVLink (packet 150: GLOBAL_POSITION_INT). "
    "Record with the vehicle's navigation connected to SonarView, or replay the session that 'auv-mcm run' recorded, "
    "which holds every port."
)

_PROFILE: Final = Struct("<4xIII8xH")  # start_mm, length_mm, timestamp_ms, and behind 8 bytes the sound speed, dm/s
_FREQUENCY: Final = Struct("<16xI")  # Hz
_PROBE_PROFILES: Final = 400  # looked at to find which frequencies a log holds
_PROBE_BYTES: Final = 8 << 20  # in this much, sonars that send several frequencies have sent each many times
_STRAY_FRACTION: Final = 0.05  # of the commonest frequency's profiles; fewer of another do not count
_COUNTS: Final = Struct("<I8xI")  # of a profile: its ping number and timestamp_ms
_COUNT, _COUNTER_AT = Struct("<I"), 12  # of a profile: one of them, the number at its start
_HEAD: Final = Struct("<26xB17xff")  # of a profile: its channel, and the angles that give its side
_MAX_WAITING: Final = 256  # navigation packets before the next ping
_RESTART_GAP_NS: Final = 100_000_000  # between the last ping before and the first one after, of which nothing is known
_SAME_TIME_NS: Final = 2_000_000_000  # a further head that differs by this much begins another log
_MAX_ECHO_S: Final = 5.0  # 3750 m; the decoder refuses what is longer
_DAY_S: Final = 86_400.0  # seconds per day
_NO_HEADING: Final = 65535  # cdeg, of GLOBAL_POSITION_INT


class SvlogRecording:
    """Read one svlog file as the bytes its ports received. Every iteration starts anew.

    Counts reader.sonar_restarted, reader.navigation_dropped (more than 256 packets without a ping),
    reader.mavlink_malformed, reader.other_messages, and those of `MessageFile`.
    """

    def __init__(self, path: Path, subsystem: int | None, chunk_bytes: int) -> None:
        """Open the file. subsystem: 20 for the lowest of several frequencies, else the highest is used.

        Raises BadInputError for a file that cannot be read.
        """
        self._file = MessageFile(path, lambda size_bytes: PingGrammar(), chunk_bytes)
        self.frequency_khz = 0.0
        self._used_hz, self._choice = self._chosen(subsystem)
        self._begin()

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

    def _begin(self) -> None:
        self._own: Counter[str] = Counter()
        self.notices: list[Notice] = []
        self._clock = _SonarTime()
        self._order = HeadOrder()
        self._stamp: Stamp | None = None  # of the newest profile
        self._waiting: deque[bytes | dict[str, Any]] = deque(maxlen=_MAX_WAITING)
        self._mavlink = _Mavlink()

    def _chosen(self, subsystem: int | None) -> tuple[int, str]:
        """Return the frequency in use, and what a person has to know of the choice."""
        often: Counter[int] = Counter()
        for framed in self._file:
            if framed.message.message_id == ping_messages.OS_MONO_PROFILE:
                often[round(_FREQUENCY.unpack_from(framed.message.payload)[0], -3)] += 1
            if often.total() >= _PROBE_PROFILES or framed.offset > _PROBE_BYTES:
                break
        there = [hz for hz, n in often.items() if n >= _STRAY_FRACTION * max(often.values())]
        if there:
            self.frequency_khz = 1e-3 * (min(there) if subsystem == 20 else max(there))
        if not there or is_same_frequency(min(there), max(there)):
            return 0, ""
        used = min(there) if subsystem == 20 else max(there)
        return used, frequency_text(min(there), max(there), used)

    def __iter__(self) -> Iterator[Recorded]:
        self._begin()
        if self._choice:
            self.notices.append(
                Notice(
                    code="reader.frequency_chosen",
                    text=f"of several frequencies one is used: {self._choice}",
                    place=self._file.path.name,
                )
            )
        for framed in self._file:
            message: PingMessage = framed.message
            match message.message_id:
                case ping_messages.OS_MONO_PROFILE if not self._is_in_use(message):
                    self._own["reader.not_used.frequency"] += 1
                case ping_messages.OS_MONO_PROFILE:
                    yield from self._released(self._order.add(self._profile(message, framed.offset)))
                case ping_messages.NMEA_WRAPPER:
                    self._wait(message.payload.rstrip(b"\0\r\n ") + b"\r\n")
                case ping_messages.MAVLINK_WRAPPER:
                    self._wait_mavlink(message.payload)
                case ping_messages.JSON_WRAPPER:
                    yield from self._released(self._order.finish())
                    self._read_head(message)
                case _:
                    self._own["reader.other_messages"] += 1
        yield from self._released(self._order.finish())
        if self._stamp is not None:
            yield from self._navigation(self._waiting, self._stamp)
        if (damage := self._file.damage()) is not None:
            self.notices.append(damage)

    def _is_in_use(self, message: PingMessage) -> bool:
        return not self._used_hz or is_same_frequency(_FREQUENCY.unpack_from(message.payload)[0], self._used_hz)

    def _profile(self, message: PingMessage, offset: int) -> Profile:
        """Take a profile, and what was stored before it."""
        channel, *angles_deg = _HEAD.unpack_from(message.payload)
        head = look_side(*angles_deg) or (channel, message.source)  # some recorders get the source wrong
        number, counter_ms = _COUNTS.unpack_from(message.payload)
        profile = Profile(head, number, counter_ms, message, offset, list(self._waiting))
        self._waiting.clear()
        return profile

    def _released(self, profiles: list[Profile]) -> Iterator[Recorded]:
        for profile in profiles:
            self._stamp, counter_ms = self._stamped(profile)
            yield from self._navigation(profile.navigation, self._stamp)
            yield Recorded(SONAR_PORT, "in", self._stamp, to_wire(_counted(profile, counter_ms)))

    def _stamped(self, profile: Profile) -> tuple[Stamp, int]:
        """Compute when the last echo of a profile was received, and what the first head's counter was, ms."""
        start_mm, length_mm, _, sound_speed_dmps = _PROFILE.unpack_from(profile.message.payload)
        echo_s = 2e-3 * (start_mm + length_mm) / (0.1 * sound_speed_dmps) if sound_speed_dmps else 0.0
        if not 0.0 < echo_s < _MAX_ECHO_S:
            echo_s = 0.0
        place = f"{self._file.path.name}, byte {profile.offset}"
        if not self._clock.is_known and not self._clock.is_used:
            text = "the log's head carries no time: times count from 1970-01-01, and contacts carry them"
            self.notices.append(Notice(code="reader.time_unknown", text=text, place=place))
        self._clock.align(profile)
        time_ns, counter_ms = self._clock.time_ns(profile.head, profile.counter_ms, round(1e9 * echo_s))
        if self._clock.n_restarts > self._own["reader.sonar_restarted"]:
            self._own["reader.sonar_restarted"] = self._clock.n_restarts
            text = (
                "the sonar's counter started anew: later times are too early by as long as it was off, which is not "
                "in the log"
            )
            self.notices.append(Notice(code="reader.sonar_restarted", text=text, place=place))
        return Stamp(time_ns, time_ns), counter_ms

    def _wait(self, packet: bytes | dict[str, Any]) -> None:
        self._own["reader.navigation_dropped"] += len(self._waiting) == _MAX_WAITING
        self._waiting.append(packet)

    def _wait_mavlink(self, payload: bytes) -> None:
        try:
            packet = json.loads(payload.rstrip(b"\0"))
            body = packet["message"]
            if not isinstance(body, dict):
                raise TypeError
        except (ValueError, RecursionError, KeyError, TypeError):
            self._own["reader.mavlink_malformed"] += 1
            return
        if body.get("type") in _MAVLINK_TYPES:
            self._wait(body)
        else:
            self._own["reader.other_messages"] += 1

    def _navigation(self, waiting: Iterable[bytes | dict[str, Any]], stamp: Stamp) -> Iterator[Recorded]:
        """Release what waited for a ping, stamped with it."""
        for packet in waiting:
            if isinstance(packet, bytes):
                yield Recorded(NMEA_PORT, "in", stamp, packet)
                continue
            try:
                records = self._mavlink.records(packet, stamp)
                data = b"".join(sentence(body_of(record)) for record in records)
            except (KeyError, TypeError, ValueError, OverflowError):
                self._own["reader.mavlink_malformed"] += 1
                continue
            yield Recorded(MAVLINK_PORT, "in", stamp, data)

    def _read_head(self, message: PingMessage) -> None:
        head = decode(message)
        text = (
            head.content.get("timestamp") if isinstance(head, JsonWrapper) and isinstance(head.content, dict) else None
        )
        try:
            when = datetime.fromisoformat(text) if isinstance(text, str) else None
        except ValueError:
            when = None
        if when is None:
            self._own["reader.other_messages"] += 1
            return
        if when.tzinfo is None:
            when = when.replace(tzinfo=UTC)
        self._clock.start(round(when.timestamp() * 1e3) * 1_000_000)


def _counted(profile: Profile, counter_ms: int) -> PingMessage:
    """Set a profile's counter and number to those of the first head."""
    payload = bytearray(profile.message.payload)
    _COUNT.pack_into(payload, 0, profile.transmission % 2**32)
    _COUNT.pack_into(payload, _COUNTER_AT, counter_ms)
    return profile.message._replace(payload=bytes(payload))


class _SonarTime:
    """Compute UTC of profiles from a log's start and the counters of the sonar's heads, each powered up at its own
    time.
    """

    def __init__(self) -> None:
        self.is_known = False
        self.is_used = False
        self.n_restarts = 0
        self._next_ns: int | None = 0
        self._last_ns = self._zero_ns = 0  # of the newest ping; where the counter of the log's first head was 0
        self._counters: dict[Hashable, tuple[int, int]] = {}  # by head: the last counter, ms, and UTC where it was 0
        self._offsets: Offsets | None = None
        self._aligned: set[Hashable] = set()  # heads whose UTC holds for these offsets

    def start(self, utc_ns: int) -> None:
        """Take the time stamp of a log's head; a further one of about the time reached changes nothing."""
        if self.is_used and abs(utc_ns - self._last_ns) <= _SAME_TIME_NS:
            return
        self.is_known = True
        self._next_ns = utc_ns
        self._counters.clear()

    def align(self, profile: Profile) -> None:
        """Put a head on the clock of the other one, as far as it was compared with it."""
        offsets, head = profile.offsets, profile.head
        if offsets is None:
            return
        if offsets is not self._offsets:
            self._offsets = offsets
            begun = zip(offsets.heads, offsets.begin_ms, strict=True)
            self._aligned = set([one for one, begin_ms in begun if self._goes_on(one, begin_ms)][:1])
        if head in self._aligned:
            return
        self._aligned.add(head)
        is_first = head == offsets.heads[0]
        last = self._counters.get(offsets.heads[is_first]) if offsets.heads[is_first] in self._aligned else None
        if last is not None:
            at_ms = profile.counter_ms + (offsets.ms if is_first else -offsets.ms)  # by the other head's counter
            zero_ns = last[1] + (last[0] + signed_ms(at_ms - last[0]) - profile.counter_ms) * 1_000_000
            self._counters[head] = profile.counter_ms, zero_ns

    def _goes_on(self, head: Hashable, counter_ms: int) -> bool:
        known = self._counters.get(head)
        return known is not None and signed_ms(counter_ms - known[0]) >= -RESTART_MS

    def time_ns(self, head: Hashable, counter_ms: int, echo_ns: int) -> tuple[int, int]:
        """Compute when the last echo of a ping was received, and what the first head's counter was at the ping, ms.

        The time decreases only where a new log begins.
        """
        self.is_used = True
        known = self._counters.get(head)
        if known is not None and (counter_ms - known[0]) % COUNTER_MS < COUNTER_MS // 2:
            zero_ns = known[1] + (COUNTER_MS * 1_000_000 if counter_ms < known[0] else 0)
        elif known is not None and known[0] - counter_ms <= RESTART_MS:
            zero_ns = known[1]  # an older packet
        elif self._next_ns is not None:
            zero_ns = self._zero_ns = self._next_ns - counter_ms * 1_000_000
        else:
            zero_ns = self._zero_of_another(head, counter_ms, echo_ns, restarted=known is not None)
        if self._next_ns is not None:
            self._last_ns, self._next_ns = 0, None
        self._counters[head] = counter_ms, zero_ns
        self._last_ns = max(zero_ns + counter_ms * 1_000_000 + echo_ns, self._last_ns)
        return self._last_ns, (counter_ms + round(1e-6 * (zero_ns - self._zero_ns))) % COUNTER_MS

    def _zero_of_another(self, head: Hashable, counter_ms: int, echo_ns: int, *, restarted: bool) -> int:
        for other, (last_ms, zero_ns) in self._counters.items():
            if other != head and abs(counter_ms - last_ms) <= RESTART_MS:
                return zero_ns
        self.n_restarts += restarted
        return self._last_ns + (_RESTART_GAP_NS if restarted else -echo_ns) - counter_ms * 1_000_000


class _Mavlink:
    """Convert MAVLink as JSON to NMEA 0183.

    The vehicle's time since boot becomes a time of day by one offset for the whole log.
    """

    def __init__(self) -> None:
        self._boot_s: float | None = None
        self._has_attitude = False

    def records(self, body: dict[str, Any], stamp: Stamp) -> list[Record]:
        """Yield records. Raises KeyError, TypeError or ValueError for fields that are missing or not numeric."""
        since_boot_s = 1e-3 * float(body["time_boot_ms"])
        if self._boot_s is None:
            self._boot_s = stamp.utc_ns * 1e-9 - since_boot_s
        time_of_day_s = (self._boot_s + since_boot_s) % _DAY_S
        if body["type"] == "ATTITUDE":
            self._has_attitude = True
            roll_rad, pitch_rad, yaw_rad = (float(body[name]) for name in ("roll", "pitch", "yaw"))
            return [Pashr(time_of_day_s, yaw_rad % math.tau, roll_rad, pitch_rad)]
        north_mps, east_mps = 0.01 * float(body["vx"]), 0.01 * float(body["vy"])
        course_rad = math.atan2(east_mps, north_mps) % math.tau
        records: list[Record] = [
            Gga(time_of_day_s, 1e-7 * float(body["lat"]), 1e-7 * float(body["lon"]), 1.0),
            Vtg(course_rad, math.hypot(north_mps, east_mps), "A"),
        ]
        heading_cdeg = float(body.get("hdg", _NO_HEADING))
        if not self._has_attitude and 0.0 <= heading_cdeg < 36_000.0:
            records.append(Pashr(time_of_day_s, math.radians(0.01 * heading_cdeg), NAN, NAN))
        return records


_MAVLINK_TYPES: Final = ("GLOBAL_POSITION_INT", "ATTITUDE")
