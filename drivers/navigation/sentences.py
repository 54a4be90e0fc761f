"""Decode and encode NMEA 0183 sentences as typed records, from one table.

Angles are radians, speeds m/s, times of day seconds since midnight UTC, dates days since 1970-01-01; an empty field is
NaN or "". Signs are those of the wire. Fields missing at the end count as empty, since older units send fewer. Layouts:
IEC 61162-1 for the standard ones, the makers' published descriptions for PASHR, PRDID (TSS1/Teledyne RDI), PIXSE
(iXblue), PSAT (Hemisphere), PTNL (Trimble), PFEC (Furuno) and OHPR (OceanServer).
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from datetime import date, timedelta
from typing import Any, Final, Generic, NamedTuple, TypeAlias, TypeVar

from auv_mcm.records import NAN

KNOT_MPS: Final = 1852.0 / 3600.0  # m/s: a nautical mile in an hour
_FOOT_M: Final = 0.3048  # m, the international foot
_FATHOM_M: Final = 1.8288  # m: six feet
_SUBTYPED: Final = ("PIXSE", "PSAT", "PTNL", "PFEC")  # makers whose second field says what a sentence is
_OCEANSERVER: Final = "OHPR"  # without a talker, though it does not begin with P
_EPOCH: Final = date(1970, 1, 1)
_NUMBER: Final = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)")
_CLOCK: Final = re.compile(r"(\d\d)(\d\d)(\d\d(?:\.\d*)?)")
_ANGLE: Final = re.compile(r"(\d{2,3})(\d\d(?:\.\d*)?)")
_MICRO: Final = 1_000_000  # millionths of a minute of arc per minute: 2 mm


class Codec(NamedTuple):
    """Read and write one value in one or several fields. read raises ValueError for an impossible one."""

    n_fields: int
    read: Callable[[Sequence[str]], Any]
    write: Callable[[Any], Sequence[str]]


class Gga(NamedTuple):
    """Hold a GNSS fix (GGA).

    quality: 0 none, 1 GNSS, 2 differential, 4 and 5 RTK, 6 dead reckoning, 7 by hand, 8 simulated.
    """

    time_of_day_s: float
    latitude_deg: float
    longitude_deg: float
    quality: float
    n_satellites: float = NAN
    hdop: float = NAN
    height_m: float = NAN
    geoid_m: float = NAN


class Rmc(NamedTuple):
    """Hold position, speed and date (RMC).

    status: A valid, V not. variation_rad: magnetic, positive to the east. mode: A autonomous, D differential, E dead
    reckoning, M by hand, S simulated, N none.
    """

    time_of_day_s: float
    status: str
    latitude_deg: float
    longitude_deg: float
    speed_mps: float
    course_rad: float
    date_days: float
    variation_rad: float = NAN
    mode: str = ""


class Gll(NamedTuple):
    """Hold a position (GLL)."""

    latitude_deg: float
    longitude_deg: float
    time_of_day_s: float
    status: str
    mode: str = ""


class Hdt(NamedTuple):
    """Hold a true heading (HDT)."""

    heading_rad: float


class Ths(NamedTuple):
    """Hold a true heading and its status (THS).

    mode: A autonomous, E estimated, M by hand, S simulated, V not valid.
    """

    heading_rad: float
    mode: str = ""


class Hdg(NamedTuple):
    """Hold a magnetic heading with the compass's deviation and the magnetic variation, positive to the east (HDG)."""

    heading_rad: float
    deviation_rad: float = NAN
    variation_rad: float = NAN


class Hdm(NamedTuple):
    """Hold a magnetic heading (HDM)."""

    heading_rad: float


class Hpr(NamedTuple):
    """Hold true heading, pitch and roll of a satellite compass (PSAT,HPR). kind: N of satellites, G of a gyro."""

    time_of_day_s: float
    heading_rad: float
    pitch_rad: float
    roll_rad: float
    kind: str = ""


class Avr(NamedTuple):
    """Hold true heading, pitch and roll between two antennas (PTNL,AVR).

    quality: 0 none, 1 autonomous, 2 and 3 RTK, 4 differential.
    """

    time_of_day_s: float
    heading_rad: float
    pitch_rad: float
    roll_rad: float
    distance_m: float = NAN
    quality: float = NAN


class Gpatt(NamedTuple):
    """Hold true heading, pitch and roll of a satellite compass (PFEC,GPatt)."""

    heading_rad: float
    pitch_rad: float
    roll_rad: float


class Ohpr(NamedTuple):
    """Hold heading, pitch and roll of a magnetic compass (OHPR); the heading is true where its declination is set."""

    heading_rad: float
    pitch_rad: float
    roll_rad: float


class Vtg(NamedTuple):
    """Hold course and speed over ground (VTG)."""

    course_rad: float
    speed_mps: float
    mode: str = ""


class Zda(NamedTuple):
    """Hold time and date (ZDA)."""

    time_of_day_s: float
    date_days: float


class Dpt(NamedTuple):
    """Hold depth below the transducer. offset_m: to the waterline if positive, to the keel if negative."""

    depth_m: float
    offset_m: float = NAN
    max_range_m: float = NAN


class Dbt(NamedTuple):
    """Hold depth below the transducer (DBT)."""

    depth_m: float


class Pashr(NamedTuple):
    """Hold heading, roll, pitch and heave (PASHR)."""

    time_of_day_s: float
    heading_rad: float
    roll_rad: float
    pitch_rad: float
    heave_m: float = NAN
    roll_sigma_rad: float = NAN
    pitch_sigma_rad: float = NAN
    heading_sigma_rad: float = NAN
    gnss_quality: float = NAN
    imu_status: float = NAN


class Prdid(NamedTuple):
    """Hold pitch, roll and heading (PRDID)."""

    pitch_rad: float
    roll_rad: float
    heading_rad: float


class PixseAttitude(NamedTuple):
    """Hold roll and pitch (PIXSE,ATITUD)."""

    roll_rad: float
    pitch_rad: float


class PixsePosition(NamedTuple):
    """Hold an inertial unit's position. height_m: negative under water."""

    latitude_deg: float
    longitude_deg: float
    height_m: float


class PixseSpeed(NamedTuple):
    """Hold velocity (PIXSE,SPEED_)."""

    east_mps: float
    north_mps: float
    up_mps: float


class PixseHeave(NamedTuple):
    """Hold surge, sway and heave (PIXSE,HEAVE_)."""

    surge_m: float
    sway_m: float
    heave_m: float


class PixseTime(NamedTuple):
    """Hold the time of day (PIXSE,TIME__)."""

    time_of_day_s: float


class PixseAttitudeSigma(NamedTuple):
    """Hold 1-sigma of the attitude (PIXSE,STDHRP)."""

    heading_rad: float
    roll_rad: float
    pitch_rad: float


class PixsePositionSigma(NamedTuple):
    """Hold 1-sigma of the position (PIXSE,STDPOS)."""

    latitude_m: float
    longitude_m: float
    height_m: float


class PixseSpeedSigma(NamedTuple):
    """Hold 1-sigma of the velocity (PIXSE,STDSPD)."""

    north_mps: float
    east_mps: float
    up_mps: float


Record: TypeAlias = (
    Gga
    | Rmc
    | Gll
    | Hdt
    | Ths
    | Hdg
    | Hdm
    | Hpr
    | Avr
    | Gpatt
    | Ohpr
    | Vtg
    | Zda
    | Dpt
    | Dbt
    | Pashr
    | Prdid
    | PixseAttitude
    | PixsePosition
    | PixseSpeed
    | PixseHeave
    | PixseTime
    | PixseAttitudeSigma
    | PixsePositionSigma
    | PixseSpeedSigma
)
R = TypeVar("R", bound=tuple[Any, ...])


class Sentence(NamedTuple, Generic[R]):
    """Describe a sentence.

    key: as `key_of` returns it. codecs: one per value of the record, None for a field that is written empty and not
    read.
    """

    key: str
    make: Callable[..., R]
    codecs: tuple[Codec | None, ...]


def key_of(fields: Sequence[str]) -> str:
    """Return the key of the sentence that a body's fields form.

    The type without its talker, a proprietary one whole, of some makers with its second field.
    """
    address = fields[0]
    if address in _SUBTYPED:
        return f"{address},{fields[1]}" if len(fields) > 1 else address
    return address if address.startswith("P") or address == _OCEANSERVER else address[2:]


def parse(body: str) -> Record | None:
    """Decode a sentence's body to its record; None for an unknown kind.

    Raises ValueError for one that does not fit its kind.
    """
    fields = body.split(",")
    key = key_of(fields)
    kind = SENTENCES.get(key)
    if kind is None:
        return None
    at = 1 + key.count(",")
    missing = at + sum(1 if codec is None else codec.n_fields for codec in kind.codecs) - len(fields)
    if missing > 0:
        fields += [""] * missing
    values = []
    for codec in kind.codecs:
        if codec is None:
            at += 1
            continue
        n_fields, read, _ = codec
        values.append(read(fields[at : at + n_fields]))
        at += n_fields
    record: Record = kind.make(*values)
    return record


def body_of(record: Record, talker: str = "GP") -> str:
    """Encode a record as a body; talker: for standard sentences."""
    kind = _BY_RECORD[type(record)]
    fields = [kind.key if kind.key.startswith(("P", _OCEANSERVER)) else talker + kind.key]
    values = iter(record)
    for codec in kind.codecs:
        fields += [""] if codec is None else codec.write(next(values))
    return ",".join(fields)


def _read_number(fields: Sequence[str]) -> float:
    text = fields[0]
    if not text:
        return NAN
    if _NUMBER.fullmatch(text) is None:
        raise ValueError(f"not a number: {text}")
    return float(text)


def _number(decimals: int, unit: float = 1.0) -> Codec:
    """Make the codec of a decimal number; unit: the SI value of 1 on the wire."""

    def read(fields: Sequence[str]) -> float:
        return _read_number(fields) * unit

    def write(value: float) -> Sequence[str]:
        return ("",) if math.isnan(value) else (f"{value / unit:.{decimals}f}",)

    return Codec(1, read if unit != 1.0 else _read_number, write)


def _letter(allowed: str) -> Codec:
    def read(fields: Sequence[str]) -> str:
        if len(fields[0]) > 1 or fields[0] not in allowed:
            raise ValueError(f"not one of {allowed}: {fields[0]}")
        return fields[0]

    return Codec(1, read, lambda value: (value,))


def _with_unit(number: Codec, unit: str) -> Codec:
    """Make the codec of a number and the letter of its unit, which may be missing but not be another."""

    def read(fields: Sequence[str]) -> float:
        if fields[1] not in ("", unit):
            raise ValueError(f"unit {fields[1]} where {unit} belongs")
        value: float = number.read(fields)
        return value

    return Codec(2, read, lambda value: (*number.write(value), unit))


def _named(number: Codec, name: str) -> Codec:
    """Make the codec of a number and the name of what it is, which is not there where the number is not."""

    def read(fields: Sequence[str]) -> float:
        if fields[1].lower() not in ("", name.lower()):
            raise ValueError(f"{fields[1]} where {name} belongs")
        value: float = number.read(fields)
        return value

    def write(value: float) -> Sequence[str]:
        return ("", "") if math.isnan(value) else (*number.write(value), name)

    return Codec(2, read, write)


def _east_or_west(number: Codec) -> Codec:
    """Make the codec of an angle and the letter of its side; positive to the east."""

    def read(fields: Sequence[str]) -> float:
        if len(fields[1]) > 1 or fields[1] not in "EW":
            raise ValueError(f"not E or W: {fields[1]}")
        value: float = number.read(fields)
        return -value if fields[1] == "W" else value

    def write(value: float) -> Sequence[str]:
        return ("", "") if math.isnan(value) else (*number.write(abs(value)), "W" if value < 0.0 else "E")

    return Codec(2, read, write)


def _degrees_and_minutes(n_degree_digits: int, hemispheres: str) -> Codec:
    """Make the codec of ddmm.mmmm and a hemisphere; written to a millionth of a minute, 2 mm."""
    limit_deg = {2: 90.0, 3: 180.0}[n_degree_digits]

    def read(fields: Sequence[str]) -> float:
        text, hemisphere = fields
        if not text and not hemisphere:
            return NAN
        match = _ANGLE.fullmatch(text)
        if match is None or len(match[1]) != n_degree_digits or not hemisphere or hemisphere not in hemispheres:
            raise ValueError(f"not an angle: {text},{hemisphere}")
        minutes = float(match[2])
        degrees = int(match[1]) + minutes / 60.0
        if minutes >= 60.0 or degrees > limit_deg:
            raise ValueError(f"not an angle: {text},{hemisphere}")
        return -degrees if hemisphere == hemispheres[1] else degrees

    def write(value: float) -> Sequence[str]:
        if math.isnan(value):
            return "", ""
        degrees, micro_minutes = divmod(round(abs(value) * 60 * _MICRO), 60 * _MICRO)
        minutes, fraction = divmod(micro_minutes, _MICRO)
        return f"{degrees:0{n_degree_digits}d}{minutes:02d}.{fraction:06d}", hemispheres[
            math.copysign(1.0, value) < 0.0
        ]

    return Codec(2, read, write)


def _clock(decimals: int) -> Codec:
    """Make the codec of a time of day, hhmmss.sss."""
    scale = 10**decimals

    def read(fields: Sequence[str]) -> float:
        if not fields[0]:
            return NAN
        match = _CLOCK.fullmatch(fields[0])
        if match is None:
            raise ValueError(f"not a time: {fields[0]}")
        hours, minutes, seconds = int(match[1]), int(match[2]), float(match[3])
        if hours > 23 or minutes > 59 or seconds >= 61.0:  # leap seconds are
            raise ValueError(f"not a time: {fields[0]}")
        return hours * 3600 + minutes * 60 + seconds

    def write(value: float) -> Sequence[str]:
        if math.isnan(value):
            return ("",)
        whole, fraction = divmod(round(value * scale) % (86_400 * scale), scale)
        return (f"{whole // 3600:02d}{whole // 60 % 60:02d}{whole % 60:02d}.{fraction:0{decimals}d}",)

    return Codec(1, read, write)


def _read_six_digit_date(fields: Sequence[str]) -> float:
    """Read a date as ddmmyy; years 80 to 99 are of the last century, since GPS began in 1980."""
    text = fields[0]
    if not text:
        return NAN
    if len(text) != 6 or not text.isdecimal():
        raise ValueError(f"not a date: {text}")
    year = int(text[4:])
    return _days(year + (1900 if year >= 80 else 2000), int(text[2:4]), int(text[:2]))


def _read_three_field_date(fields: Sequence[str]) -> float:
    """Read a date from three fields, dd,mm,yyyy."""
    if not all(fields):
        return NAN
    if not all(field.isdecimal() and len(field) <= 4 for field in fields):
        raise ValueError(f"not a date: {','.join(fields)}")
    day, month, year = map(int, fields)
    return _days(year, month, day)


def _days(year: int, month: int, day: int) -> float:
    return float((date(year, month, day) - _EPOCH).days)


def _write_six_digit_date(days: float) -> Sequence[str]:
    return ("",) if math.isnan(days) else (f"{_EPOCH + timedelta(days):%d%m%y}",)


def _write_three_field_date(days: float) -> Sequence[str]:
    return ("", "", "") if math.isnan(days) else f"{_EPOCH + timedelta(days):%d,%m,%Y}".split(",")


def _read_depths(fields: Sequence[str]) -> float:
    """Read a depth from feet,f,metres,M,fathoms,F: metres if they are there."""
    if any(unit not in ("", expected) for unit, expected in zip(fields[1::2], "fMF", strict=True)):
        raise ValueError(f"units {fields[1::2]} where f, M, F belong")
    feet, metres, fathoms = (_read_number((text,)) for text in fields[::2])
    return next((depth for depth in (metres, feet * _FOOT_M, fathoms * _FATHOM_M) if not math.isnan(depth)), NAN)


def _write_depths(depth_m: float) -> Sequence[str]:
    if math.isnan(depth_m):
        return "", "f", "", "M", "", "F"
    depth_m = round(depth_m, 2)
    return f"{depth_m / _FOOT_M:.2f}", "f", f"{depth_m:.2f}", "M", f"{depth_m / _FATHOM_M:.2f}", "F"


_DEGREE: Final = math.pi / 180.0
_COUNT, _TENTHS, _CENTI, _MILLI = (_number(decimals) for decimals in range(4))
_ANGLE_TENTHS, _ANGLE_CENTI, _ANGLE_MILLI = (_number(decimals, _DEGREE) for decimals in (1, 2, 3))
_VARIATION: Final = _east_or_west(_ANGLE_CENTI)
_DECIMAL_DEGREES: Final = _number(8)
_LATITUDE, _LONGITUDE = _degrees_and_minutes(2, "NS"), _degrees_and_minutes(3, "EW")
_TIME: Final = _clock(3)
_STATUS, _MODE = _letter("AV"), _letter("ADEFMNPRS")
_METRES: Final = _with_unit(_TENTHS, "M")
_SKIPPED: Final = (None,)

SENTENCES: Final[dict[str, Sentence[Any]]] = {
    kind.key: kind
    for kind in (
        Sentence("GGA", Gga, (_TIME, _LATITUDE, _LONGITUDE, _COUNT, _COUNT, _TENTHS, _METRES, _METRES)),
        Sentence(
            "RMC",
            Rmc,
            (
                _TIME,
                _STATUS,
                _LATITUDE,
                _LONGITUDE,
                _number(3, KNOT_MPS),
                _ANGLE_CENTI,
                Codec(1, _read_six_digit_date, _write_six_digit_date),
                _VARIATION,
                _MODE,
            ),
        ),
        Sentence("GLL", Gll, (_LATITUDE, _LONGITUDE, _TIME, _STATUS, _MODE)),
        Sentence("HDT", Hdt, (_with_unit(_ANGLE_MILLI, "T"),)),
        Sentence("THS", Ths, (_ANGLE_MILLI, _letter("AEMSV"))),
        Sentence("HDG", Hdg, (_ANGLE_MILLI, _VARIATION, _VARIATION)),
        Sentence("HDM", Hdm, (_with_unit(_ANGLE_MILLI, "M"),)),
        Sentence("PSAT,HPR", Hpr, (_TIME, *(_ANGLE_MILLI,) * 3, _letter("NG"))),
        Sentence(
            "PTNL,AVR",
            Avr,
            (
                _TIME,
                _named(_ANGLE_MILLI, "Yaw"),
                _named(_ANGLE_MILLI, "Tilt"),
                _named(_ANGLE_MILLI, "Roll"),
                _MILLI,
                _COUNT,
            ),
        ),
        Sentence("PFEC,GPatt", Gpatt, (_ANGLE_TENTHS,) * 3),
        Sentence("OHPR", Ohpr, (_ANGLE_TENTHS,) * 3),
        Sentence(
            "VTG",
            Vtg,
            (_with_unit(_ANGLE_CENTI, "T"), *_SKIPPED * 2, _with_unit(_number(3, KNOT_MPS), "N"), *_SKIPPED * 2, _MODE),
        ),
        Sentence("ZDA", Zda, (_TIME, Codec(3, _read_three_field_date, _write_three_field_date))),
        Sentence("DPT", Dpt, (_CENTI, _CENTI, _TENTHS)),
        Sentence("DBT", Dbt, (Codec(6, _read_depths, _write_depths),)),
        Sentence(
            "PASHR",
            Pashr,
            (_TIME, _with_unit(_ANGLE_CENTI, "T"), *(_ANGLE_CENTI,) * 2, _CENTI, *(_ANGLE_MILLI,) * 3, _COUNT, _COUNT),
        ),
        Sentence("PRDID", Prdid, (_ANGLE_CENTI, _ANGLE_CENTI, _ANGLE_CENTI)),
        Sentence("PIXSE,ATITUD", PixseAttitude, (_ANGLE_MILLI, _ANGLE_MILLI)),
        Sentence("PIXSE,POSITI", PixsePosition, (_DECIMAL_DEGREES, _DECIMAL_DEGREES, _MILLI)),
        Sentence("PIXSE,SPEED_", PixseSpeed, (_MILLI, _MILLI, _MILLI)),
        Sentence("PIXSE,HEAVE_", PixseHeave, (_MILLI, _MILLI, _MILLI)),
        Sentence("PIXSE,TIME__", PixseTime, (_clock(6),)),
        Sentence("PIXSE,STDHRP", PixseAttitudeSigma, (_ANGLE_MILLI, _ANGLE_MILLI, _ANGLE_MILLI)),
        Sentence("PIXSE,STDPOS", PixsePositionSigma, (_CENTI, _CENTI, _CENTI)),
        Sentence("PIXSE,STDSPD", PixseSpeedSigma, (_MILLI, _MILLI, _MILLI)),
    )
}
_BY_RECORD: Final[dict[Any, Sentence[Any]]] = {kind.make: kind for kind in SENTENCES.values()}
