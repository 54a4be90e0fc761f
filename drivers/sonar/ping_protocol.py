"""Drive the Omniscan 450 and others that speak the Ping Protocol: framing, decoding into frames, commands.

A log (.svlog) is the same stream, stored.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from struct import Struct
from typing import Final

import numpy as np

from auv_mcm.clock import Stamp
from auv_mcm.errors import UsageError
from auv_mcm.records import EchoTrace
from drivers.framing import Grammar, Refused, StampedFramer, StampedMessage
from drivers.running_sum import RunningSum
from drivers.sonar.pairing import SidePairer
from drivers.sonar.ping_messages import (
    ACK,
    CHECKSUM_BYTES,
    DEVICE_INFORMATION,
    HEADER,
    HEADER_BYTES,
    MAX_MESSAGE_BYTES,
    N_RESULTS_OFFSET,
    NACK,
    OS_MONO_PROFILE,
    OTHER_LIMITS,
    PAYLOAD_LIMITS,
    PROFILE_HEADER,
    PROTOCOL_VERSION,
    SYNC,
    Ack,
    DeviceInformation,
    Nack,
    OsMonoProfile,
    OsPingParams,
    PingMessage,
    ProtocolVersion,
    SetSpeedOfSound,
    decode,
    encode,
    linear_power,
)
from drivers.sonar.ping_sides import MAX_CHANNEL, NO_CHANNEL, HeadSides, Sided
from drivers.sonar.sonar_decoder import SonarFrame, SonarItem, SonarReply, SonarSettings
from drivers.sonar.sonar_settings import check_settings

MAX_GAIN: Final = 7  # highest gain setting of the sonar
MAX_RANGE_M: Final = 200.0  # m: the longest range of the sonar
_RESULTS: Final = (200, 1200)  # that the device takes
_MAX_TRACE_MM: Final = 2_000_000  # mm: longer traces are damage
_MAX_DB: Final = 300.0  # dB: more is damage; 10^30 is still a 32-bit float
_LENGTH_AND_ID: Final = Struct("<HH")
_N_RESULTS: Final = Struct("<H").unpack_from
_N_RESULTS_AT: Final = HEADER_BYTES + N_RESULTS_OFFSET
_PROFILE_HEAD_BYTES: Final = HEADER_BYTES + PROFILE_HEADER.size  # that must be there before its results are counted
_FEW_BYTES: Final = 64  # of a payload, up to which numpy is slower than a sum in Python
_ANSWERS: Final = frozenset({ACK, NACK, DEVICE_INFORMATION, PROTOCOL_VERSION})


class PingGrammar(Grammar[PingMessage]):
    """Frame messages; a length must be plausible for its id, and for a profile agree with its number of results."""

    name = "ping_protocol"
    head_bytes = len(SYNC)
    max_message_bytes = MAX_MESSAGE_BYTES
    proven = True

    def __init__(self) -> None:
        self._sum = RunningSum()

    def find(self, buffer: bytearray, start: int, refused: Refused) -> int:
        at, n_length, n_checksum = buffer.find(SYNC, start), 0, 0
        n_there = len(buffer)
        sums: Sequence[int] = ()
        while at > start and n_there - at >= HEADER_BYTES:
            n_payload, message_id = _LENGTH_AND_ID.unpack_from(buffer, at + len(SYNC))
            min_bytes, max_bytes = PAYLOAD_LIMITS.get(message_id, OTHER_LIMITS)
            stop = at + HEADER_BYTES + n_payload
            if not min_bytes <= n_payload <= max_bytes:
                n_length += 1
            elif message_id == OS_MONO_PROFILE and n_there - at < _PROFILE_HEAD_BYTES:
                break
            elif (
                message_id == OS_MONO_PROFILE
                and n_payload != PROFILE_HEADER.size + 2 * _N_RESULTS(buffer, at + _N_RESULTS_AT)[0]
            ):
                n_length += 1
            elif stop + CHECKSUM_BYTES > n_there:
                break
            else:
                sums = sums or self._sum.values(buffer)
                if (sums[stop] - sums[at]) & 0xFFFF == buffer[stop] | buffer[stop + 1] << 8:
                    break
                n_checksum += 1
            at = buffer.find(SYNC, at + 1)
        if n_length:
            refused["length"] = refused.get("length", 0) + n_length
        if n_checksum:
            refused["checksum"] = refused.get("checksum", 0) + n_checksum
        return at

    def read(self, buffer: bytearray, at: int) -> tuple[PingMessage, int] | int | str:
        n_there = len(buffer) - at
        if n_there < HEADER_BYTES:
            return HEADER_BYTES
        _, n_payload, message_id, source, destination = HEADER.unpack_from(buffer, at)
        min_bytes, max_bytes = PAYLOAD_LIMITS.get(message_id, OTHER_LIMITS)
        if not min_bytes <= n_payload <= max_bytes:
            return "length"
        start = at + HEADER_BYTES
        if message_id == OS_MONO_PROFILE:
            if n_there < _PROFILE_HEAD_BYTES:
                return _PROFILE_HEAD_BYTES
            if n_payload != PROFILE_HEADER.size + 2 * _N_RESULTS(buffer, at + _N_RESULTS_AT)[0]:
                return "length"
        n_bytes: int = HEADER_BYTES + n_payload + CHECKSUM_BYTES
        if n_there < n_bytes:
            return n_bytes
        stop = start + n_payload
        if n_payload <= _FEW_BYTES:
            total = sum(buffer[at:stop])
        else:
            total = int(np.add.reduce(np.frombuffer(buffer, np.uint8, stop - at, at), dtype=np.uint32))
        if total & 0xFFFF != buffer[stop] | buffer[stop + 1] << 8:
            return "checksum"
        return PingMessage(message_id, bytes(buffer[start:stop]), source, destination), n_bytes

    def forget(self, n_bytes: int) -> None:
        self._sum.forget(n_bytes)


class PingDecoder:
    """Decode profiles to frames of linear power, both sides joined, and answers to replies; count other messages.

    The look angle in a profile decides its side where somebody set it, see `HeadSides`.
    """

    def __init__(self, *, by_number: bool = False, subsystem: int | None = None) -> None:
        """Start at the beginning of a link or log.

        Parameters
        ----------
        by_number
            Sides by channel numbers alone, not by look angles.
        subsystem
            20 for the lowest of several frequencies, else the highest is used.
        """
        self._framer = StampedFramer(PingGrammar())
        self.counters = self._framer.counters
        self._pairer = SidePairer(self._framer.counters)
        self._sides = HeadSides(self._framer.counters, by_number=by_number, subsystem=subsystem)
        self._n_notices = 0

    def feed(self, data: bytes, stamp: Stamp) -> list[SonarItem]:
        return self._decoded(self._framer.feed(data, stamp))

    def finish(self) -> list[SonarItem]:
        found = self._decoded(self._framer.finish())
        return [*found, *self._paired(self._sides.finish()), *self._pairer.finish()]

    def _decoded(self, messages: list[StampedMessage[PingMessage]]) -> list[SonarItem]:
        found: list[SonarItem] = []
        for arrived in messages:
            message_id = arrived.message.message_id
            if message_id == OS_MONO_PROFILE:
                found += self._frames(arrived)
            elif message_id in _ANSWERS:
                found.append(_reply(arrived))
            else:
                self.counters["ping_protocol.other_messages"] += 1
        return found

    def _frames(self, arrived: StampedMessage[PingMessage]) -> list[SonarItem]:
        profile = decode(arrived.message)
        assert isinstance(profile, OsMonoProfile), "the framer lets no other length pass"
        reason = _unusable(profile)
        if reason is not None:
            self.counters[f"ping_protocol.refused.{reason}"] += 1
            return []
        found: list[SonarItem] = [*self._paired(self._sides.add(arrived, profile))]
        found += self._sides.notices[self._n_notices :]
        self._n_notices = len(self._sides.notices)
        return found

    def _paired(self, profiles: list[Sided]) -> list[SonarFrame]:
        return [frame for sided in profiles for frame in self._pairer.add(self._frame(sided))]

    def _frame(self, sided: Sided) -> SonarFrame:
        profile, arrived = sided.profile, sided.arrived
        n_samples = profile.pwr_results.shape[0]
        spacing_m = 1e-3 * profile.length_mm / n_samples
        trace = EchoTrace(
            samples=linear_power(profile), first_range_m=1e-3 * profile.start_mm + 0.5 * spacing_m, spacing_m=spacing_m
        )
        return SonarFrame(
            number=profile.ping_number,
            port=trace if sided.side == "port" else None,
            starboard=trace if sided.side == "starboard" else None,
            transfer="intensity",
            received=arrived.received,
            n_bytes=arrived.n_bytes,
            sound_speed_mps=0.1 * profile.sound_speed_dmps,
            device_time_s=1e-3 * profile.timestamp_ms,
        )


def commands(settings: SonarSettings) -> tuple[bytes, ...]:
    """Return the commands that make the sonar ping with these settings. Raises UsageError for what it cannot do."""
    check_settings(settings, "ping_protocol", max_range_m=MAX_RANGE_M, max_gain=MAX_GAIN)
    min_samples, max_samples = _RESULTS
    if not min_samples <= settings.n_samples <= max_samples:
        raise UsageError(
            f"ping_protocol: {settings.n_samples} samples per side cannot be set. Give {min_samples} to {max_samples}."
        )
    parameters = OsPingParams(
        start_mm=0,
        length_mm=round(1e3 * settings.range_m),
        gain_index=-1 if settings.gain is None else settings.gain,
        num_results=settings.n_samples,
        enable=int(settings.enabled),
    )
    return encode(SetSpeedOfSound(round(1e3 * settings.sound_speed_mps))), encode(parameters)


def _unusable(profile: OsMonoProfile) -> str | None:
    """Return why no trace can be made of it, in one word."""
    if MAX_CHANNEL < profile.channel_number < NO_CHANNEL:
        return "channel"
    if (
        profile.pwr_results.shape[0] == 0
        or profile.length_mm == 0
        or profile.start_mm + profile.length_mm > _MAX_TRACE_MM
    ):
        return "range"
    if not 1300.0 <= 0.1 * profile.sound_speed_dmps <= 1700.0:
        return "sound_speed"
    low, high = profile.min_pwr_db, profile.max_pwr_db
    if not (math.isfinite(low) and math.isfinite(high) and -_MAX_DB <= low < high <= _MAX_DB):
        return "power_scale"
    return None


def _reply(arrived: StampedMessage[PingMessage]) -> SonarReply:
    content = decode(arrived.message)
    request, text = arrived.message.message_id, ""
    if isinstance(content, Ack):
        request = content.acked_id
    elif isinstance(content, Nack):
        request, text = content.nacked_id, content.text
    elif isinstance(content, DeviceInformation):
        text = f"device type {content.device_type} revision {content.device_revision}, firmware " + ".".join(
            map(str, content[2:5])
        )
    elif isinstance(content, ProtocolVersion):
        text = "protocol " + ".".join(map(str, content[:3]))
    accepted = not isinstance(content, Nack)
    return SonarReply(request=request, accepted=accepted, received=arrived.received, n_bytes=arrived.n_bytes, text=text)
