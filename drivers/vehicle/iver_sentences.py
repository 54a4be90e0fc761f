"""Define the sentences of Iver Remote Helm, for both directions.

Source: Goby3, frontseat/iver (LGPL), for the fields and their units; the depth of `$OMS` is in feet before Remote Helm
5 and in metres from then on, those of `$OSI` are in feet. `$OMW`, which inserts way-points, is not described in public,
and `$OMSTART` and `$OMSTOP` start and stop the mission, which is not a guest's business: all three are left out.

Contacts and health have no sentence of the maker's: they go out as `$PMCM,C,` with the fields of
`ascii_fields.CONTACT`, and `$PMCM,H,` with a text; the name is a setting.
"""

from __future__ import annotations

import re
from typing import Any, Final, NamedTuple

from auv_mcm.settings.vehicle_settings import IverSettings
from drivers.navigation.nmea0183 import NmeaGrammar, sentence
from drivers.navigation.sentence_fields import DECIMAL_DEGREES, Codec, within
from drivers.navigation.sentences import KNOT_MPS, Sentence
from drivers.vehicle.ascii_fields import (
    CENTI,
    CONTACT,
    COUNT,
    FOOT_M,
    HEADING,
    PITCH,
    ROLL,
    TENTHS,
    TEXT,
    Table,
    depth,
    heading,
    needed,
    speed,
)
from drivers.vehicle.dialect import ContactReport

METRES_SINCE: Final = 5  # version of Remote Helm
_COMPASS: Final = re.compile(r"C([\d.+-]+)P([\d.+-]+)R([\d.+-]+)T([\d.+-]+)D([\d.+-]+)")


class IverState(NamedTuple):
    """Hold the vehicle's state, `$OSI`.

    mode: its first letter is N normal, S stopped, P parking, M manual, m manual parking, A servo, W mission.
    """

    mode: str
    latitude_deg: float
    longitude_deg: float
    speed_mps: float
    altitude_m: float
    heading_rad: float
    depth_m: float


class IverCompass(NamedTuple):
    """Hold the compass, `$C`, such as `$C82.8P-3.89R-2.63T20.3D3.2*78`.

    heading_rad: by the compass, so not from true north.
    """

    heading_rad: float
    pitch_rad: float
    roll_rad: float
    temperature_c: float
    depth: float


class IverPoll(NamedTuple):
    """Request reports, `$OSD,G,C,S,P,,,,`: position, compass, state and power, once."""


class IverSteer(NamedTuple):
    """Command heading, depth and speed, `$OMS`."""

    heading_rad: float
    depth_m: float
    max_pitch_deg: float
    speed_mps: float
    timeout_s: float


class IverContact(NamedTuple):
    """Report a contact."""

    report: ContactReport


class IverHealth(NamedTuple):
    """Report health in words."""

    text: str


class IverGrammar(NmeaGrammar):
    """Frame sentences of NMEA 0183. The compass has no commas; its fields come out with them."""

    name = "iver"

    def read(self, buffer: bytearray, at: int) -> tuple[str, int] | int | str:
        found = super().read(buffer, at)
        if not isinstance(found, tuple) or not found[0].startswith("C"):
            return found
        match = _COMPASS.fullmatch(found[0])
        return found if match is None else (",".join(("C", *match.groups())), found[1])


def table_of(settings: IverSettings) -> Table:
    """Make the table of this vehicle's sentences."""
    depth_unit_m = 1.0 if settings.remote_helm_version >= METRES_SINCE else FOOT_M
    state: tuple[Codec | None, ...] = (
        None,  # fins and motor
        needed(TEXT),
        None,  # next way-point
        within(DECIMAL_DEGREES, -90.0, 90.0),
        within(DECIMAL_DEGREES, -180.0, 180.0),
        speed(CENTI, KNOT_MPS),
        None,  # distance to the next way-point
        None,  # error
        depth(CENTI, FOOT_M),
        None,  # parking time
        None,  # declination
        None,  # mission
        None,  # remaining time
        HEADING,
        depth(CENTI, FOOT_M),
    )
    name = settings.contact_sentence
    return Table(
        Sentence("OSI", IverState, state),
        Sentence("C", IverCompass, (HEADING, PITCH, ROLL, TENTHS, TENTHS)),
        Sentence("OSD", IverPoll, ()),
        Sentence(
            "OMS",
            IverSteer,
            (
                needed(heading(1)),
                needed(depth(TENTHS, depth_unit_m)),
                needed(TENTHS),
                needed(speed(TENTHS, KNOT_MPS)),
                needed(COUNT),
            ),
        ),
        *((Sentence(f"{name},C", IverContact, (CONTACT,)), Sentence(f"{name},H", IverHealth, (TEXT,))) if name else ()),
    )


def line_of(table: Table, record: Any) -> bytes:
    """Encode a record of the table as a sentence."""
    body = table.body_of(record)
    if isinstance(record, IverPoll):
        body += ",G,C,S,P,,,,"
    elif isinstance(record, IverCompass):
        body = "".join(letter + field for letter, field in zip("CPRTD", body.split(",")[1:], strict=True))
    return sentence(body)
