"""Read and write the fields of NMEA 0183 sentences: numbers, angles, clocks, dates, letters and depths."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from datetime import date, timedelta
from typing import Any, Final, NamedTuple

from auv_mcm.records import NAN

_FOOT_M: Final = 0.3048  # m, the international foot
_FATHOM_M: Final = 1.8288  # m: six feet
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


def _read_number(fields: Sequence[str]) -> float:
    text = fields[0]
    if not text:
        return NAN
    if _NUMBER.fullmatch(text) is None:
        raise ValueError(f"not a number: {text}")
    return float(text)


def number(decimals: int, unit: float = 1.0) -> Codec:
    """Read and write a number with so many decimals.

    Parameters
    ----------
    decimals
        That are written.
    unit
        What one on the wire is in the record.
    """

    def read(fields: Sequence[str]) -> float:
        return _read_number(fields) * unit

    def write(value: float) -> Sequence[str]:
        return ("",) if math.isnan(value) else (f"{value / unit:.{decimals}f}",)

    return Codec(1, read if unit != 1.0 else _read_number, write)


def within(codec: Codec, low: float, high: float) -> Codec:
    """Make a codec that rejects numbers outside; an empty field passes."""

    def read(fields: Sequence[str]) -> float:
        value: float = codec.read(fields)
        if value < low or value > high:
            raise ValueError(f"not within {low} and {high}: {value}")
        return value

    return Codec(codec.n_fields, read, codec.write)


def letter(allowed: str) -> Codec:
    """Read and write one of these letters, or none."""

    def read(fields: Sequence[str]) -> str:
        if len(fields[0]) > 1 or fields[0] not in allowed:
            raise ValueError(f"not one of {allowed}: {fields[0]}")
        return fields[0]

    return Codec(1, read, lambda value: (value,))


def with_unit(number: Codec, unit: str) -> Codec:
    """Read and write a number and the letter of its unit, which may be missing but not be another.

    Parameters
    ----------
    number
        Its codec.
    unit
        The letter.
    """

    def read(fields: Sequence[str]) -> float:
        if fields[1] not in ("", unit):
            raise ValueError(f"unit {fields[1]} where {unit} belongs")
        value: float = number.read(fields)
        return value

    return Codec(2, read, lambda value: (*number.write(value), unit))


def named(number: Codec, name: str) -> Codec:
    """Read and write a number and the name of what it is, which is not there where the number is not.

    Parameters
    ----------
    number
        Its codec.
    name
        As written.
    """

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


def clock(decimals: int) -> Codec:
    """Read and write a time of day, s, with so many decimals."""
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


def read_six_digit_date(fields: Sequence[str]) -> float:
    """Read ddmmyy as days since 1970; years 80 to 99 are of the last century, since GPS began in 1980."""
    text = fields[0]
    if not text:
        return NAN
    if len(text) != 6 or not text.isdecimal():
        raise ValueError(f"not a date: {text}")
    year = int(text[4:])
    return _days(year + (1900 if year >= 80 else 2000), int(text[2:4]), int(text[:2]))


def read_three_field_date(fields: Sequence[str]) -> float:
    """Read day, month and year as days since 1970."""
    if not all(fields):
        return NAN
    if not all(field.isdecimal() and len(field) <= 4 for field in fields):
        raise ValueError(f"not a date: {','.join(fields)}")
    day, month, year = map(int, fields)
    return _days(year, month, day)


def _days(year: int, month: int, day: int) -> float:
    return float((date(year, month, day) - _EPOCH).days)


def write_six_digit_date(days: float) -> Sequence[str]:
    """Write days since 1970 as ddmmyy."""
    return ("",) if math.isnan(days) else (f"{_EPOCH + timedelta(days):%d%m%y}",)


def write_three_field_date(days: float) -> Sequence[str]:
    """Write days since 1970 as day, month and year."""
    return ("", "", "") if math.isnan(days) else f"{_EPOCH + timedelta(days):%d,%m,%Y}".split(",")


def read_depths(fields: Sequence[str]) -> float:
    """Read a depth from feet,f,metres,M,fathoms,F: metres if they are there."""
    if any(unit not in ("", expected) for unit, expected in zip(fields[1::2], "fMF", strict=True)):
        raise ValueError(f"units {fields[1::2]} where f, M, F belong")
    feet, metres, fathoms = (_read_number((text,)) for text in fields[::2])
    return next((depth for depth in (metres, feet * _FOOT_M, fathoms * _FATHOM_M) if not math.isnan(depth)), NAN)


def write_depths(depth_m: float) -> Sequence[str]:
    """Write a depth, m, in feet, metres and fathoms."""
    if math.isnan(depth_m):
        return "", "f", "", "M", "", "F"
    depth_m = round(depth_m, 2)
    return f"{depth_m / _FOOT_M:.2f}", "f", f"{depth_m:.2f}", "M", f"{depth_m / _FATHOM_M:.2f}", "F"


_DEGREE: Final = math.pi / 180.0
COUNT, TENTHS, CENTI, MILLI = (number(decimals) for decimals in range(4))
ANGLE_TENTHS, ANGLE_CENTI, ANGLE_MILLI = (number(decimals, _DEGREE) for decimals in (1, 2, 3))
VARIATION: Final = _east_or_west(ANGLE_CENTI)
DECIMAL_DEGREES: Final = number(8)
LATITUDE, LONGITUDE = _degrees_and_minutes(2, "NS"), _degrees_and_minutes(3, "EW")
TIME: Final = clock(3)
STATUS, MODE = letter("AV"), letter("ADEFMNPRS")
METRES: Final = with_unit(TENTHS, "M")
