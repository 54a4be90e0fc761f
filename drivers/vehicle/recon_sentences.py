"""Define the frames of RECON, for both directions.

A frame is `#`, the type and its fields, `,*`, and two upper-case hex digits, the sum of all bytes from `#` to `*`
modulo 256.

Sources: two public implementations, one of a MOOS interface and one of a fish-tag follower, that agree on what is used
here.

Contacts have no frame of the maker's: they go out as type `K` with the fields of `ascii_fields.CONTACT`; the letter is
a setting.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

from auv_mcm.settings.vehicle_settings import ReconSettings
from drivers.framing import Grammar
from drivers.message_candidates import MessageCandidates
from drivers.navigation.nmea0183 import BYTE_OF_HEX, MAX_SENTENCE_BYTES
from drivers.navigation.sentence_fields import Codec, within
from drivers.navigation.sentences import Sentence
from drivers.vehicle.ascii_fields import (
    CLOCK,
    CONTACT,
    COUNT,
    DEGREE,
    DEPTH,
    LATITUDE,
    LONGITUDE,
    SPEED,
    TENTHS,
    TEXT,
    Table,
    between,
    heading,
    needed,
    one_of,
    scaled,
)
from drivers.vehicle.dialect import ContactReport

_BODY: Final = rb"[\x20-\x22\x24-\x29\x2b-\x7e]"
_FRAME: Final = re.compile(rb"(#[A-Za-z](?:,%b{0,%d})?,\*)([0-9A-F]{2})\r?\n?" % (_BODY, MAX_SENTENCE_BYTES - 9))
_BEGUN: Final = re.compile(rb"#%b*(?:\*[0-9A-F]?)?" % _BODY)
_CANDIDATES: Final = MessageCandidates(
    (b"#",),
    alive=rb"#(?:[A-Za-z](?:,%b{0,%d})?,\*(?:[0-9A-F]{2}|[0-9A-F]?\Z)|%b{0,%d}+(?:\*[0-9A-F]?)?\Z)"
    % (_BODY, MAX_SENTENCE_BYTES - 9, _BODY, MAX_SENTENCE_BYTES - 2),
    dead=rb"((?:#(?=#))++)|#(?:((?:%b{%d}|%b{%d}\*|%b{%d}\*[0-9A-F]))|())"
    % (_BODY, MAX_SENTENCE_BYTES - 1, _BODY, MAX_SENTENCE_BYTES - 2, _BODY, MAX_SENTENCE_BYTES - 3),
    reasons=("malformed", "oversize", "malformed"),
)
_PLACE: Final = re.compile(r"(\d{1,3})([NSEW])(\d{1,2}(?:\.\d*)?)")


class ReconState(NamedTuple):
    """Hold the vehicle's state, `#S`.

    mode: bits 1 in mission, 2 suspended (both: over), 4 override enabled, 8 override active, 10h shore power, 20h
    returns to the closest point, 40h depth alone may be overridden, 80h override not allowed. altitude_m: 0 if not
    known.
    """

    time_of_day_s: float
    latitude_deg: float
    longitude_deg: float
    depth_m: float
    depth_goal_m: float
    altitude_m: float
    pitch_rad: float
    roll_rad: float
    thruster_rpm: float
    thruster_goal_rpm: float
    speed_mps: float
    heading_rad: float
    heading_rate_radps: float
    heading_goal_rad: float
    mode: int
    leg: str


class ReconShutdown(NamedTuple):
    """Announce a shutdown, `#s,SHUTDOWN`: the payload is to shut down."""


class ReconEngage(NamedTuple):
    """Engage or end the override, `#E`. engaged: 1 or 0."""

    engaged: str


class ReconHeading(NamedTuple):
    """Command a heading."""

    heading_rad: float


class ReconDepth(NamedTuple):
    """Command a depth."""

    depth_m: float


class ReconSpeed(NamedTuple):
    """Command a speed."""

    speed_mps: float


class ReconAlive(NamedTuple):
    """Keep the connection alive, with health in words."""

    text: str


class ReconQuery(NamedTuple):
    """Request a value by `#Q`."""

    name: str


class ReconContact(NamedTuple):
    """Report a contact."""

    report: ContactReport


class ReconGrammar(Grammar[str]):
    """Frame messages; a message is the text between `#` and `,*`. Neither `#` nor `*` occurs inside."""

    name = "recon"
    head_bytes = 1
    max_message_bytes = MAX_SENTENCE_BYTES
    proven = True
    find = staticmethod(_CANDIDATES.find)

    def read(self, buffer: bytearray, at: int) -> tuple[str, int] | int | str:
        match = _FRAME.match(buffer, at)
        if match is not None:
            summed, checksum = match.groups()
            if sum(summed) & 0xFF != BYTE_OF_HEX[checksum]:
                return "checksum"
            return summed[1:-2].decode("ascii"), match.end() - at
        begun = _BEGUN.match(buffer, at)
        assert begun is not None  # `find` saw its first character
        if begun.end() - at >= MAX_SENTENCE_BYTES:
            return "oversize"
        return begun.end() - at + 1 if begun.end() == len(buffer) else "malformed"


def sum_of(data: bytes | bytearray) -> int:
    """Return the checksum of a frame from `#` to `*`."""
    return sum(data) & 0xFF


def frame(body: str) -> bytes:
    """Encode a body such as `E,1` as a whole frame."""
    data = f"#{body},*".encode("ascii")
    return b"%b%02X\n" % (data, sum_of(data))


def _place(codec: Codec, n_digits: int) -> Codec:
    """Write and read `39N30.5553` by the codec of ddmm.mmmm,N; written to a ten-thousandth of a minute, 0.2 m, as the
    vehicle does.
    """

    def read(fields: Sequence[str]) -> Any:
        match = _PLACE.fullmatch(fields[0])
        if match is None:
            raise ValueError(f"not a place: {fields[0]}")
        degrees, hemisphere, minutes = match.groups()
        whole, _, fraction = minutes.partition(".")
        return codec.read((f"{degrees:0>{n_digits}}{whole:0>2}.{fraction}", hemisphere))

    def write(value: float) -> Sequence[str]:
        text, hemisphere = codec.write(round(value * 600_000.0) / 600_000.0)
        return (f"{int(text[:n_digits])}{hemisphere}{text[n_digits : n_digits + 7]}",)

    return Codec(1, read, write)


def _read_clock(fields: Sequence[str]) -> Any:
    return CLOCK.read((fields[0].replace(":", ""),))


def _write_clock(value: float) -> Sequence[str]:
    text = CLOCK.write(value)[0]
    return (f"{text[:2]}:{text[2:4]}:{text[4:]}",)


def _read_mode(fields: Sequence[str]) -> int:
    if re.fullmatch(r"[0-9A-Fa-f]{1,8}", fields[0]) is None:
        raise ValueError(f"not a mode: {fields[0]}")
    return int(fields[0], 16)


_MODE: Final = Codec(1, _read_mode, lambda mode: (f"{mode:X}",))
_ANGLE: Final = within(scaled(TENTHS, DEGREE), -7.0, 7.0)
_RPM: Final = within(COUNT, -1e5, 1e5)
_STATE: Final = (
    between("T", Codec(1, _read_clock, _write_clock)),
    between("LAT", _place(LATITUDE, 2)),
    between("LON", _place(LONGITUDE, 3)),
    between("D", DEPTH),
    between("DG", DEPTH),
    between("A", DEPTH),
    between("P", _ANGLE),
    between("R", _ANGLE),
    between("TR", _RPM),
    between("TRG", _RPM),
    between("V", SPEED),
    between("H", heading(1)),
    between("HR", within(scaled(TENTHS, DEGREE), -20.0, 20.0)),
    between("HG", _ANGLE),
    between("M", _MODE),
    between("l", TEXT),
)


def table_of(settings: ReconSettings) -> Table:
    """Make the table of this vehicle's frames."""
    letter = settings.contact_type
    return Table(
        Sentence("S", ReconState, _STATE),
        Sentence("s,SHUTDOWN", ReconShutdown, ()),
        Sentence("E", ReconEngage, (one_of("0", "1"),)),
        Sentence("C,Heading,Goal", ReconHeading, (needed(heading(1)),)),
        Sentence("C,Depth,Depth", ReconDepth, (needed(DEPTH),)),
        Sentence("C,Speed", ReconSpeed, (between("", needed(SPEED), " meters/sec"),)),
        Sentence("V", ReconAlive, (TEXT,)),
        Sentence("Q", ReconQuery, (TEXT,)),
        *((Sentence(letter, ReconContact, (CONTACT,)),) if letter else ()),
    )
