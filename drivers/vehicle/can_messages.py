"""Define the messages between payload and vehicle on a CAN bus, both ways, in one table.

Identifiers have 29 bits, laid out as in SAE J1939-21: priority, page, 0xFF, message number, address of the sender. Both
page bits are set, which J1939 leaves to others (ISO 15765-3) and NMEA 2000 never does: on a bus shared with NMEA 2000
nobody can take these frames for a parameter group, as other makers' units could if the frames had proprietary groups
without a maker's code. No address is claimed.

Every frame has 8 bytes, numbers are little-endian and byte-aligned, bytes without a meaning are 0xFF. A quantity whose
bits are all ones (signed: the largest number) is not available, NaN here; others are rounded to the nearest step, ties
to the even one. Counters, numbers and codes are whole and always available.

A message of one frame ends with the CRC-16/IBM-3740 of message number, sender and the 6 bytes before. A longer one is a
transfer: each frame begins with its part number and the transfer's sequence number, and 6 bytes of content follow; the
last 4 bytes of the last part are the CRC-32 (as in zip) of message number, sender and all content before. So half a
transfer, or halves of two, are nothing.
"""

from __future__ import annotations

from binascii import crc_hqx
from collections.abc import Callable, Iterator
from itertools import islice
from typing import Any, Final, Literal, NamedTuple, TypeAlias
from zlib import crc32

from auv_mcm.records import ContactClass
from drivers.links.can_frame import CanFrame
from drivers.vehicle.can_signals import Signal, code, length, number, packed, share, unpacked

FRAME_BYTES: Final = 8  # of a classic CAN frame
HEAD_BYTES: Final = 2  # of a frame of a transfer: part, sequence
CRC16_BYTES: Final = 2  # of the checksum of a single frame
CRC32_BYTES: Final = 4  # of the checksum of a message of several frames
N_NUMBERS: Final = 256  # of counters, sequences, requests and commands
_PAGES_AND_FORMAT: Final = 0x3FF00  # both page bits, and the format of messages to all
_CRC16_START: Final = 0xFFFF  # of CRC-16/IBM-3740

STATUS_PERIOD_S: Final = 0.5  # of the payload; also sent at once when it changes
VEHICLE_STATUS_PERIOD_S: Final = 0.2  # s between two, by auv_mcm/docs/vehicle.md
VEHICLE_STATE_PERIOD_S: Final = 0.1  # s, the same
COMMAND_PERIOD_S: Final = 0.5  # s, the same: five lost in a row before a command expires
COMMAND_VALID_S: Final = 3.0  # s after which the vehicle forgets a command
PAYLOAD_SILENT_S: Final = 2.0  # without a new status of the payload for so long the vehicle takes control back
VEHICLE_SILENT_S: Final = 1.0  # without a new status of the vehicle for so long the payload has no control
FIRST_COMMAND_S: Final = 10.0  # without any command for so long after a grant the vehicle takes control back
TRANSFER_S: Final = 0.5  # all frames of a transfer come within this time, or it is dropped

Sender: TypeAlias = Literal["payload", "vehicle"]

HEALTH_STATES: Final = ("starting", "normal", "fault", "failure")
AUTHORITY_STATES: Final = ("down", "listening", "requested", "granted", "revoked")
DEMANDS: Final = ("release", "request")
GRANTS: Final = ("withheld", "considering", "granted")
REASONS: Final = (
    "none",
    "not willing",
    "taken back",
    "released by the payload",
    "payload silent",
    "command not repeated in time",
    "command refused",
    "mission over",
    "shutting down",
    "vehicle fault",
    "vehicle restarted",
)
COMMAND_STATES: Final = ("none", "under way", "arrived", "refused")
REFERENCES: Final[tuple[Literal["depth", "altitude"], ...]] = ("depth", "altitude")
CLASSES: Final[tuple[ContactClass, ...]] = ("cylinder", "sphere", "truncated_cone", "wedge", "clutter", "unknown")
ANSWERS: Final = ("taken", "not wanted", "no memory left", "not understood")


class PayloadStatus(NamedTuple):
    """Report what the payload does and requests."""

    health: int
    authority: int
    demand: int
    request_number: int
    counter: int


class GoToMessage(NamedTuple):
    """Command a place."""

    latitude_deg: float
    speed_mps: float
    longitude_deg: float
    radius_m: float
    vertical_m: float
    vertical_reference: int
    valid_s: float
    command_number: int
    request_number: int


class SteerMessage(NamedTuple):
    """Command a heading."""

    vertical_m: float
    vertical_reference: int
    valid_s: float
    heading_rad: float
    speed_mps: float
    command_number: int
    request_number: int


class ReportMessage(NamedTuple):
    """Report a contact."""

    ticket: int
    number: int
    session: int
    revision: int
    time_s: float
    latitude_deg: float
    sigma_m: float
    longitude_deg: float
    p_mine: float
    depth_m: float
    classification: int
    n_views: int
    length_m: float
    width_m: float
    height_m: float
    length_sigma_m: float
    width_sigma_m: float
    height_sigma_m: float
    belief_cylinder: float
    belief_sphere: float
    belief_truncated_cone: float
    belief_wedge: float
    belief_clutter: float
    belief_unknown: float


class HealthText(NamedTuple):
    """Report health in words: UTF-8, filled up with zeros, least significant byte of text_1 first."""

    text_1: int
    text_2: int
    text_3: int
    text_4: int
    text_5: int
    text_6: int
    text_7: int
    text_8: int


class VehicleStatus(NamedTuple):
    """Grant or refuse control."""

    grant: int
    reason: int
    request_number: int
    command_state: int
    command_number: int
    counter: int


class StateMessage(NamedTuple):
    """Report position, heading and speed of the vehicle."""

    latitude_deg: float
    heading_rad: float
    longitude_deg: float
    speed_mps: float
    depth_m: float
    pitch_rad: float
    altitude_m: float
    roll_rad: float


class ReportAnswer(NamedTuple):
    """Answer a report."""

    ticket: int
    report_crc: int
    answer: int


Record: TypeAlias = (
    PayloadStatus
    | GoToMessage
    | SteerMessage
    | ReportMessage
    | HealthText
    | VehicleStatus
    | StateMessage
    | ReportAnswer
)


class PlacedSignal(NamedTuple):
    """Place a signal in a message. part: of its transfer, 0 where there is one frame. first_byte: in the frame."""

    part: int
    first_byte: int
    signal: Signal


class CanMessage(NamedTuple):
    """Describe a message. parts: the signals of each frame, in the order of the record's fields.

    period_s: 0 for one that is sent when there is reason to.
    """

    number: int
    name: str
    sender: Sender
    priority: int
    period_s: float
    make: Callable[..., Record]
    comment: str
    parts: tuple[tuple[Signal, ...], ...]

    @property
    def is_transfer(self) -> bool:
        """Find whether the message takes several frames."""
        return len(self.parts) > 1

    @property
    def placed(self) -> Iterator[PlacedSignal]:
        """Return the place of every signal but head and CRC."""
        for part, signals in enumerate(self.parts):
            at = HEAD_BYTES if self.is_transfer else 0
            for signal in signals:
                yield PlacedSignal(part, at, signal)
                at += signal.n_bytes


def can_id_of(message: CanMessage, address: int) -> int:
    """Compute the 29-bit CAN identifier of a message from an address."""
    return message.priority << 26 | (_PAGES_AND_FORMAT | message.number) << 8 | address


def number_and_address(can_id: int) -> tuple[int, int] | None:
    """Split a 29-bit identifier into message number and sender's address; None for other messages."""
    if can_id >> 8 & 0x3FF00 != _PAGES_AND_FORMAT:
        return None
    return can_id >> 8 & 0xFF, can_id & 0xFF


def encode(record: Record, address: int, sequence: int = 0) -> list[CanFrame]:
    """Encode a record as frames.

    sequence: of a transfer, modulo 256. Raises ValueError for a value out of its signal's range.
    """
    message = BY_RECORD[type(record)]
    values = iter(record)
    can_id = can_id_of(message, address)
    contents = [b"".join(map(packed, signals, islice(values, len(signals)))) for signals in message.parts]
    if not message.is_transfer:
        content = contents[0].ljust(FRAME_BYTES - CRC16_BYTES, b"\xff")
        return [CanFrame(can_id, content + crc16(message.number, address, content).to_bytes(CRC16_BYTES, "little"))]
    n_content = FRAME_BYTES - HEAD_BYTES
    *whole, last = (content.ljust(n_content, b"\xff") for content in contents)
    covered = b"".join(whole) + last[:-CRC32_BYTES]
    content = covered + crc_of(message.number, address, covered).to_bytes(CRC32_BYTES, "little")
    return [
        CanFrame(can_id, bytes((part, sequence & 0xFF)) + content[part * n_content : (part + 1) * n_content])
        for part in range(len(message.parts))
    ]


def decode(message: CanMessage, contents: list[bytes]) -> Record:
    """Decode frames without heads and CRC, whose CRC was right, to a record.

    Raises ValueError for a value that is out of its signal's range.
    """
    start = HEAD_BYTES if message.is_transfer else 0
    values = []
    for part, first_byte, signal in message.placed:
        at = first_byte - start
        values.append(unpacked(signal, contents[part][at : at + signal.n_bytes]))
    return message.make(*values)


def crc16(number: int, address: int, content: bytes) -> int:
    """Return the CRC-16/IBM-3740 of a message of one frame: polynomial 0x1021, start 0xFFFF, not reflected."""
    return crc_hqx(bytes((number, address)) + content, _CRC16_START)


def crc_of(number: int, address: int, content: bytes) -> int:
    """Return the CRC-32/ISO-HDLC of a transfer."""
    return crc32(bytes((number, address)) + content)


def goes_on(counter: int, last: int) -> bool:
    """Return whether a counter of one byte is newer than it was: ahead by less than half its range."""
    return 0 < (counter - last) % N_NUMBERS < N_NUMBERS // 2


_LATITUDE: Final = Signal("latitude_deg", 4, -90.0, 90.0, "WGS 84, north positive", 1e-7, "deg", signed=True)
_LONGITUDE: Final = Signal("longitude_deg", 4, -180.0, 180.0, "WGS 84, east positive", 1e-7, "deg", signed=True)
_HEADING: Final = Signal("heading_rad", 2, 0.0, 6.2832, "clockwise from true north; a full turn is 0", 1e-4, "rad")
_SPEED: Final = Signal("speed_mps", 2, 0.0, 655.0, "over ground", 0.01, "m/s")
_DEPTH: Final = Signal("depth_m", 4, 0.0, 12_000.0, "below the surface", 1e-3, "m")
_VERTICAL: Final = Signal(
    "vertical_m", 4, 0.0, 12_000.0, "rounded to the shallower: altitudes up, depths down", 1e-3, "m"
)
_REFERENCE: Final = code("vertical_reference", REFERENCES, "vertical_m is below the surface, or above the sea floor")
_VALID: Final = Signal("valid_s", 1, 0.0, 25.0, "expires this long after its last frame, unless repeated", 0.1, "s")
_COMMAND_NUMBER: Final = number(
    "command_number", 1, "goes on by 1 for a command unlike the one before, not for a repetition"
)
_REQUEST_NUMBER: Final = number("request_number", 1, "of the request in whose grant it is given; refused in any other")
_REASON: Final = Signal("reason", 1, 0, 255, "why the grant is what it is; readers take any number", names=REASONS)
_COUNTER: Final = number(
    "counter", 1, "goes on by 1 with every frame; one that does not, or goes back, does not count as a sign of life"
)

MESSAGES: Final = (
    CanMessage(
        0x01,
        "PAYLOAD_STATUS",
        "payload",
        2,
        STATUS_PERIOD_S,
        PayloadStatus,
        "Sign of life, health, and whether the payload requests control. Sent at once when it changes. A release is "
        "sent three times; one that names the granted request, or none as after a restart, counts whatever its "
        f"counter. Without one for {PAYLOAD_SILENT_S:g} s the vehicle takes control back.",
        (
            (
                code("health", HEALTH_STATES, "fault: it works, degraded. failure: do not rely on it"),
                code("authority", AUTHORITY_STATES, "as the payload sees it"),
                code("demand", DEMANDS, "request: as long as it is repeated. release: ends control at once"),
                number("request_number", 1, "of the request that is made or was made last; 0: none yet"),
                _COUNTER,
            ),
        ),
    ),
    CanMessage(
        0x02,
        "GO_TO",
        "payload",
        3,
        COMMAND_PERIOD_S,
        GoToMessage,
        f"Go to a place and stay there. Only while granted. The vehicle forgets it after valid_s ({COMMAND_VALID_S:g} "
        "s as sent), takes control back and flies its own plan. A sequence not newer than the last one's is refused "
        "and extends nothing.",
        (
            (_LATITUDE, _SPEED),
            (
                _LONGITUDE,
                Signal("radius_m", 2, 0.0, 655.0, "within this distance the place counts as reached", 0.01, "m"),
            ),
            (_VERTICAL, _REFERENCE, _VALID),
            (_COMMAND_NUMBER, _REQUEST_NUMBER),
        ),
    ),
    CanMessage(
        0x03,
        "STEER",
        "payload",
        3,
        COMMAND_PERIOD_S,
        SteerMessage,
        "Hold a heading, a depth or altitude, and a speed. Otherwise as GO_TO, with which it shares sequence and "
        "command numbers.",
        ((_VERTICAL, _REFERENCE, _VALID), (_HEADING, _SPEED, _COMMAND_NUMBER, _REQUEST_NUMBER), ()),
    ),
    CanMessage(
        0x04,
        "CONTACT_REPORT",
        "payload",
        7,
        0.0,
        ReportMessage,
        "A contact. Repeated until answered, after 1 s and then less and less often; session, number and revision "
        "identify a repetition. Sizes, errors and depths too large are sent as the largest value.",
        (
            (
                number("ticket", 2, "repeated in the answer; 1 to 65535"),
                number("number", 4, "of the contact in its session"),
            ),
            (
                number("session", 4, "of the run that numbers its contacts"),
                number("revision", 2, "which report of the contact; 1 the first"),
            ),
            (Signal("time_s", 6, 0.0, 1e11, "UTC since 1970 of the first view", 1e-3, "s"),),
            (
                _LATITUDE,
                Signal("sigma_m", 2, 0.0, 655.0, "1-sigma, semi-major axis of the position's error ellipse", 0.01, "m"),
            ),
            (_LONGITUDE, share("p_mine", "probability of a mine")),
            (
                _DEPTH._replace(comment="of the sea floor below the surface"),
                code("classification", CLASSES, "the likeliest class"),
                number("n_views", 1, "number of views; 255 stands for 255 or more"),
            ),
            tuple(length(f"{axis}_m", "of the object") for axis in ("length", "width", "height")),
            tuple(length(f"{axis}_sigma_m", "1-sigma") for axis in ("length", "width", "height")),
            tuple(share(f"belief_{name}", "mass; of all classes together 1 within rounding") for name in CLASSES[:3]),
            tuple(share(f"belief_{name}", "mass; of all classes together 1 within rounding") for name in CLASSES[3:]),
            (),
        ),
    ),
    CanMessage(
        0x05,
        "HEALTH_TEXT",
        "payload",
        7,
        10.0,
        HealthText,
        "Why the payload's health is as it is, for people: up to 44 bytes of UTF-8, filled up with zeros. Also sent "
        "when it changes.",
        (
            *((number(f"text_{n}", 6, "first byte least significant"),) for n in range(1, 8)),
            (number("text_8", 2, "first byte least significant"),),
        ),
    ),
    CanMessage(
        0x81,
        "VEHICLE_STATUS",
        "vehicle",
        2,
        VEHICLE_STATUS_PERIOD_S,
        VehicleStatus,
        "Sign of life, and whether the payload may command. Sent at once when it changes. Without one for "
        f"{VEHICLE_SILENT_S:g} s the payload has no control and sends no command.",
        (
            (
                code("grant", GRANTS, "withheld answers the request of that number; a new try needs a new number"),
                _REASON,
                number("request_number", 1, "of the payload's request that this answers; 0: none heard"),
                code("command_state", COMMAND_STATES, "what has become of the command"),
                number("command_number", 1, "of the command that was heard last"),
                _COUNTER,
            ),
        ),
    ),
    CanMessage(
        0x82,
        "VEHICLE_STATE",
        "vehicle",
        3,
        VEHICLE_STATE_PERIOD_S,
        StateMessage,
        "Where the vehicle is, all of one instant. May be left out where NMEA 2000 units on the bus report it.",
        (
            (_LATITUDE, _HEADING),
            (_LONGITUDE, _SPEED),
            (_DEPTH, Signal("pitch_rad", 2, -1.571, 1.571, "bow up positive", 1e-4, "rad", signed=True)),
            (
                Signal("altitude_m", 4, 0.0, 12_000.0, "above the sea floor", 1e-3, "m"),
                Signal("roll_rad", 2, -3.1416, 3.1416, "starboard down positive", 1e-4, "rad", signed=True),
            ),
            (),
        ),
    ),
    CanMessage(
        0x83,
        "REPORT_ANSWER",
        "vehicle",
        6,
        0.0,
        ReportAnswer,
        "A report was taken, or refused: then it is not repeated. Sent for every CONTACT_REPORT that came whole, "
        "repetitions too.",
        (
            (
                number("ticket", 2, "of the report"),
                number(
                    "report_crc",
                    2,
                    "lower 16 bits of the report's CRC, so that no other report with this ticket is meant",
                ),
                Signal("answer", 1, 0, 255, "readers take any number above 0 for a refusal", names=ANSWERS),
            ),
        ),
    ),
)
BY_NUMBER: Final[dict[int, CanMessage]] = {message.number: message for message in MESSAGES}
BY_RECORD: Final[dict[Any, CanMessage]] = {message.make: message for message in MESSAGES}
