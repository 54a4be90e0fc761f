"""Decode and encode NMEA 0183 sentences as typed records, from one table.

Angles are radians, speeds m/s, times of day seconds since midnight UTC, dates days since 1970-01-01; an empty field is
NaN or "". Signs are those of the wire. Fields missing at the end count as empty, since older units send fewer. Layouts:
IEC 61162-1 for the standard ones, the makers' published descriptions for PASHR, PRDID (TSS1/Teledyne RDI), PIXSE
(iXblue), PSAT (Hemisphere), PTNL (Trimble), PFEC (Furuno) and OHPR (OceanServer).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final, Generic, NamedTuple, TypeAlias, TypeVar

from auv_mcm.records import NAN
from drivers.navigation.sentence_fields import (
    ANGLE_CENTI,
    ANGLE_MILLI,
    ANGLE_TENTHS,
    CENTI,
    COUNT,
    DECIMAL_DEGREES,
    LATITUDE,
    LONGITUDE,
    METRES,
    MILLI,
    MODE,
    STATUS,
    TENTHS,
    TIME,
    VARIATION,
    Codec,
    clock,
    letter,
    named,
    number,
    read_depths,
    read_six_digit_date,
    read_three_field_date,
    with_unit,
    within,
    write_depths,
    write_six_digit_date,
    write_three_field_date,
)

KNOT_MPS: Final = 1852.0 / 3600.0  # m/s: a nautical mile in an hour
_SUBTYPED: Final = ("PIXSE", "PSAT", "PTNL", "PFEC")  # makers whose second field says what a sentence is
_OCEANSERVER: Final = "OHPR"  # without a talker, though it does not begin with P


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
    if key == "GLL" and len(fields) == 5:
        fields += ["", "A"]  # as units before version 2.0 of the standard send it: a position alone
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


_SKIPPED: Final = (None,)

SENTENCES: Final[dict[str, Sentence[Any]]] = {
    kind.key: kind
    for kind in (
        Sentence("GGA", Gga, (TIME, LATITUDE, LONGITUDE, COUNT, COUNT, TENTHS, METRES, METRES)),
        Sentence(
            "RMC",
            Rmc,
            (
                TIME,
                STATUS,
                LATITUDE,
                LONGITUDE,
                number(3, KNOT_MPS),
                ANGLE_CENTI,
                Codec(1, read_six_digit_date, write_six_digit_date),
                VARIATION,
                MODE,
            ),
        ),
        Sentence("GLL", Gll, (LATITUDE, LONGITUDE, TIME, STATUS, MODE)),
        Sentence("HDT", Hdt, (with_unit(ANGLE_MILLI, "T"),)),
        Sentence("THS", Ths, (ANGLE_MILLI, letter("AEMSV"))),
        Sentence("HDG", Hdg, (ANGLE_MILLI, VARIATION, VARIATION)),
        Sentence("HDM", Hdm, (with_unit(ANGLE_MILLI, "M"),)),
        Sentence("PSAT,HPR", Hpr, (TIME, *(ANGLE_MILLI,) * 3, letter("NG"))),
        Sentence(
            "PTNL,AVR",
            Avr,
            (TIME, named(ANGLE_MILLI, "Yaw"), named(ANGLE_MILLI, "Tilt"), named(ANGLE_MILLI, "Roll"), MILLI, COUNT),
        ),
        Sentence("PFEC,GPatt", Gpatt, (ANGLE_TENTHS,) * 3),
        Sentence("OHPR", Ohpr, (ANGLE_TENTHS,) * 3),
        Sentence(
            "VTG",
            Vtg,
            (with_unit(ANGLE_CENTI, "T"), *_SKIPPED * 2, with_unit(number(3, KNOT_MPS), "N"), *_SKIPPED * 2, MODE),
        ),
        Sentence("ZDA", Zda, (TIME, Codec(3, read_three_field_date, write_three_field_date))),
        Sentence("DPT", Dpt, (CENTI, CENTI, TENTHS)),
        Sentence("DBT", Dbt, (Codec(6, read_depths, write_depths),)),
        Sentence(
            "PASHR",
            Pashr,
            (TIME, with_unit(ANGLE_CENTI, "T"), *(ANGLE_CENTI,) * 2, CENTI, *(ANGLE_MILLI,) * 3, COUNT, COUNT),
        ),
        Sentence("PRDID", Prdid, (ANGLE_CENTI, ANGLE_CENTI, ANGLE_CENTI)),
        Sentence("PIXSE,ATITUD", PixseAttitude, (ANGLE_MILLI, ANGLE_MILLI)),
        Sentence(
            "PIXSE,POSITI",
            PixsePosition,
            (within(DECIMAL_DEGREES, -90.0, 90.0), within(DECIMAL_DEGREES, -360.0, 360.0), MILLI),
        ),
        Sentence("PIXSE,SPEED_", PixseSpeed, (MILLI, MILLI, MILLI)),
        Sentence("PIXSE,HEAVE_", PixseHeave, (MILLI, MILLI, MILLI)),
        Sentence("PIXSE,TIME__", PixseTime, (clock(6),)),
        Sentence("PIXSE,STDHRP", PixseAttitudeSigma, (ANGLE_MILLI, ANGLE_MILLI, ANGLE_MILLI)),
        Sentence("PIXSE,STDPOS", PixsePositionSigma, (CENTI, CENTI, CENTI)),
        Sentence("PIXSE,STDSPD", PixseSpeedSigma, (MILLI, MILLI, MILLI)),
    )
}
_BY_RECORD: Final[dict[Any, Sentence[Any]]] = {kind.make: kind for kind in SENTENCES.values()}
