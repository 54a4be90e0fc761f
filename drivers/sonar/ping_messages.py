"""Decode and encode the Ping Protocol messages of Omniscan 450 side-scan sonars.

Layout (Blue Robotics, "Ping Protocol", MIT licence), little-endian: 'B' 'R', u16 payload length, u16 message id, u8
source, u8 destination, payload, u16 sum of all bytes before it.
"""

from __future__ import annotations

import json
from struct import Struct
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

SYNC: Final = b"BR"
HEADER: Final = Struct("<2sHHBB")
HEADER_BYTES: Final = HEADER.size
CHECKSUM_BYTES: Final = 2  # a sum of 16 bits after the payload

ACK, NACK, ASCII_TEXT, DEVICE_INFORMATION, PROTOCOL_VERSION, GENERAL_REQUEST, JSON_WRAPPER = 1, 2, 3, 4, 5, 6, 10
SET_SPEED_OF_SOUND, OLD_SET_SPEED_OF_SOUND = 116, 1002  # devices made before the spring of 2026 take the old number
OS_PING_PARAMS, OS_MONO_PROFILE = 2197, 2198
NMEA_WRAPPER, MAVLINK_WRAPPER = (
    109,
    150,
)  # in logs of SonarView (Cerulean, "Cerulean Ping Protocol", General Packet Definitions)

PROFILE_HEADER: Final = Struct("<5I3HBB6f")
N_RESULTS_OFFSET: Final = 22  # of the profile's payload, u16
MAX_RESULTS: Final = 12_000  # ten times what the devices send
_FULL_SCALE: Final = 65535.0  # counts of a 16-bit power result


class PingMessage(NamedTuple):
    """Hold a message as sent. source, destination: device numbers, 0 where there is but one."""

    message_id: int
    payload: bytes
    source: int = 0
    destination: int = 0


class Ack(NamedTuple):
    """Acknowledge a message."""

    acked_id: int


class Nack(NamedTuple):
    """Refuse a message, with the reason."""

    nacked_id: int
    text: str


class AsciiText(NamedTuple):
    """Carry a text."""

    text: str


class DeviceInformation(NamedTuple):
    """Describe the device and its firmware."""

    device_type: int
    device_revision: int
    firmware_major: int
    firmware_minor: int
    firmware_patch: int
    reserved: int = 0


class ProtocolVersion(NamedTuple):
    """State the protocol's version."""

    major: int
    minor: int
    patch: int
    reserved: int = 0


class GeneralRequest(NamedTuple):
    """Request one message of this id."""

    requested_id: int


class JsonWrapper(NamedTuple):
    """Hold the description in a log's first message: any JSON value, None if it is not JSON."""

    content: Any


class SetSpeedOfSound(NamedTuple):
    """Set the sound speed, mm/s."""

    sound_speed_mmps: int


class OsPingParams(NamedTuple):
    """Hold the ping settings.

    msec_per_ping: 0 for as fast as the range permits. gain_index: 0..7, -1 for automatic. num_results: 200..1200.
    """

    start_mm: int
    length_mm: int
    msec_per_ping: int = 0
    reserved_1: float = 0.0
    reserved_2: float = 0.0
    pulse_len_percent: float = 0.002
    filter_duration_percent: float = 0.0015
    gain_index: int = -1
    num_results: int = 600
    enable: int = 1
    reserved_3: int = 0
    reserved_4: int = 0
    reserved_5: int = 0


class OsMonoProfile(NamedTuple):
    """Hold one side of one ping.

    timestamp_ms: since power-up, modulo 2^32. pwr_results: (n,) uint16, near to far, on a scale of decibels.
    """

    ping_number: int
    start_mm: int
    length_mm: int
    timestamp_ms: int
    ping_hz: int
    gain_index: int
    sound_speed_dmps: int
    channel_number: int
    pulse_duration_sec: float
    analog_gain: float
    max_pwr_db: float
    min_pwr_db: float
    transducer_heading_deg: float
    vehicle_heading_deg: float
    pwr_results: NDArray[np.uint16]
    reserved: int = 0


Payload: TypeAlias = (
    Ack
    | Nack
    | AsciiText
    | DeviceInformation
    | ProtocolVersion
    | GeneralRequest
    | JsonWrapper
    | SetSpeedOfSound
    | OsPingParams
    | OsMonoProfile
)

FIXED_LAYOUTS: Final[dict[int, tuple[Any, Struct]]] = {
    ACK: (Ack, Struct("<H")),
    DEVICE_INFORMATION: (DeviceInformation, Struct("<6B")),
    PROTOCOL_VERSION: (ProtocolVersion, Struct("<4B")),
    GENERAL_REQUEST: (GeneralRequest, Struct("<H")),
    SET_SPEED_OF_SOUND: (SetSpeedOfSound, Struct("<I")),
    OLD_SET_SPEED_OF_SOUND: (SetSpeedOfSound, Struct("<I")),
    OS_PING_PARAMS: (OsPingParams, Struct("<3I4fhH4B")),
}
# In the order of PROFILE_HEADER, which the results follow.
PROFILE_FIELDS: Final = (
    *OsMonoProfile._fields[:6],
    "n_results",
    *OsMonoProfile._fields[6:8],
    "reserved",
    *OsMonoProfile._fields[8:14],
)
_ID_OF: Final[dict[type, int]] = {
    kind: number for number, (kind, _) in FIXED_LAYOUTS.items() if number != OLD_SET_SPEED_OF_SOUND
}
_MAX_TEXT_BYTES: Final = 1024

# Plausible minimum and maximum bytes of payload by message id; OTHER_LIMITS for ids not listed.
OTHER_LIMITS: Final = (0, 4096)
PAYLOAD_LIMITS: Final[dict[int, tuple[int, int]]] = {
    **{number: (layout.size, layout.size) for number, (_, layout) in FIXED_LAYOUTS.items()},
    NACK: (2, 2 + _MAX_TEXT_BYTES),
    ASCII_TEXT: (0, _MAX_TEXT_BYTES),
    JSON_WRAPPER: (0, PROFILE_HEADER.size + 2 * MAX_RESULTS),
    OS_MONO_PROFILE: (PROFILE_HEADER.size, PROFILE_HEADER.size + 2 * MAX_RESULTS),
}
MAX_MESSAGE_BYTES: Final = HEADER_BYTES + max(max_bytes for _, max_bytes in PAYLOAD_LIMITS.values()) + CHECKSUM_BYTES


def to_wire(message: PingMessage) -> bytes:
    """Encode the message, checksum included."""
    body = (
        HEADER.pack(SYNC, len(message.payload), message.message_id, message.source, message.destination)
        + message.payload
    )
    return body + (sum(body) & 0xFFFF).to_bytes(2, "little")


def encode(payload: Payload, source: int = 0, destination: int = 0) -> bytes:
    """Encode a message with this payload. Raises struct.error for numbers that do not fit their field."""
    if isinstance(payload, OsMonoProfile):
        message_id, content = OS_MONO_PROFILE, _encode_profile(payload)
    elif isinstance(payload, Nack):
        message_id, content = NACK, payload.nacked_id.to_bytes(2, "little") + payload.text.encode("ascii", "replace")
    elif isinstance(payload, AsciiText):
        message_id, content = ASCII_TEXT, payload.text.encode("ascii", "replace")
    elif isinstance(payload, JsonWrapper):
        message_id, content = JSON_WRAPPER, json.dumps(payload.content).encode()
    else:
        message_id = _ID_OF[type(payload)]
        content = FIXED_LAYOUTS[message_id][1].pack(*payload)
    return to_wire(PingMessage(message_id, content, source, destination))


def decode(message: PingMessage) -> Payload | None:
    """Decode the message's content; None for an unknown id, or a payload of the wrong length."""
    message_id, payload = message.message_id, message.payload
    min_bytes, max_bytes = PAYLOAD_LIMITS.get(message_id, OTHER_LIMITS)
    if not min_bytes <= len(payload) <= max_bytes:
        return None
    if message_id == OS_MONO_PROFILE:
        return _decode_profile(payload)
    if message_id in FIXED_LAYOUTS:
        kind, layout = FIXED_LAYOUTS[message_id]
        made: Payload = kind(*layout.unpack(payload))
        return made
    if message_id == NACK:
        return Nack(int.from_bytes(payload[:2], "little"), _text(payload[2:]))
    if message_id == ASCII_TEXT:
        return AsciiText(_text(payload))
    if message_id == JSON_WRAPPER:
        return JsonWrapper(_json(payload))
    return None


def linear_power(profile: OsMonoProfile) -> NDArray[np.float32]:
    """Return (n,) float32 power, proportional to intensity: 10^(dB / 10) of dB = min + result / 65535 * (max - min)."""
    neper = np.log(10.0) / 10.0
    slope = np.float32(neper * (profile.max_pwr_db - profile.min_pwr_db) / _FULL_SCALE)
    exponent = profile.pwr_results.astype(np.float32)
    exponent *= slope
    exponent += np.float32(neper * profile.min_pwr_db)
    return np.exp(exponent, out=exponent)


def _encode_profile(profile: OsMonoProfile) -> bytes:
    head = PROFILE_HEADER.pack(
        *profile[:6],
        profile.pwr_results.shape[0],
        profile.sound_speed_dmps,
        profile.channel_number,
        profile.reserved,
        *profile[8:14],
    )
    return head + profile.pwr_results.astype("<u2", copy=False).tobytes()


def _decode_profile(payload: bytes) -> OsMonoProfile | None:
    fields = PROFILE_HEADER.unpack_from(payload)
    n_results, sound_speed, channel, reserved = fields[6:10]
    if len(payload) != PROFILE_HEADER.size + 2 * n_results:
        return None
    results = np.frombuffer(payload, dtype="<u2", offset=PROFILE_HEADER.size)
    return OsMonoProfile._make((*fields[:6], sound_speed, channel, *fields[10:], results, reserved))


def _text(content: bytes) -> str:
    return content.rstrip(b"\0").decode("ascii", "replace")


def _json(content: bytes) -> Any:
    try:
        return json.loads(content.rstrip(b"\0"))
    except (ValueError, RecursionError):
        return None
