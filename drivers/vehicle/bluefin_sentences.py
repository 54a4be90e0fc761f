"""Define the sentences of Bluefin's standard payload interface, for both directions.

Times are hhmmss.sss with three decimals, by the vehicle's clock. Source: Goby3, frontseat/bluefin (LGPL), which names
the fields after the maker's manual. What it does not name, as the fields of `$BPTRK`, is left out; so is `$BPABT`,
which aborts the mission.

Contacts have no sentence of the maker's: they go out as `$BPMCM`, time and the fields of `ascii_fields.CONTACT`; the
name is a setting.
"""

from __future__ import annotations

from typing import NamedTuple

from auv_mcm.settings.vehicle_settings import BluefinSettings
from drivers.navigation.nmea0183 import NmeaGrammar
from drivers.navigation.sentences import Sentence
from drivers.vehicle.ascii_fields import (
    CENTI,
    CLOCK,
    CONTACT,
    COUNT,
    DEPTH,
    HEADING,
    LATITUDE,
    LONGITUDE,
    PITCH,
    ROLL,
    SPEED,
    TEXT,
    Table,
    needed,
    one_of,
)
from drivers.vehicle.dialect import ContactReport


class BluefinAnswer(NamedTuple):
    """Hold an answer, `$BFACK`.

    status: 0 invalid, 1 failed, 2 done, 3 pending, of the sentence `name` with the time `of_s`.
    """

    time_of_day_s: float
    name: str
    of_s: float
    status: str
    text: str


class BluefinPosition(NamedTuple):
    """Hold a position, `$BFNVG`. quality: 1 by GNSS. computed_s: time of day that the position is for."""

    time_of_day_s: float
    latitude_deg: float
    longitude_deg: float
    quality: float
    altitude_m: float
    depth_m: float
    heading_rad: float
    roll_rad: float
    pitch_rad: float
    computed_s: float


class BluefinVelocity(NamedTuple):
    """Hold velocities, `$BFNVR`, over ground; its rates are not read."""

    time_of_day_s: float
    east_mps: float
    north_mps: float
    down_mps: float


class BluefinControl(NamedTuple):
    """Hold who has control, `$BFCTL`. control: 1 if the payload may command."""

    time_of_day_s: float
    control: str


class BluefinMission(NamedTuple):
    """Hold the mission's state, `$BFMIS`. status: holds `Running` while a mission runs."""

    time_of_day_s: float
    mission: str
    status: str


class BluefinCommand(NamedTuple):
    """Hold a command of the mission, `$BFMSC`: what the mission has for the payload, in words agreed upon by both."""

    time_of_day_s: float
    text: str


class BluefinShutdown(NamedTuple):
    """Announce a shutdown, `$BFSHT`: the payload is to shut down."""

    time_of_day_s: float


class BluefinBegin(NamedTuple):
    """Announce a behaviour, `$BFMBS`: a behaviour begins."""

    time_of_day_s: float
    behaviour: str


class BluefinEnd(NamedTuple):
    """End a behaviour, `$BFMBE`: a behaviour ends."""

    time_of_day_s: float
    behaviour: str


class BluefinLog(NamedTuple):
    """Request a sentence, `$BPLOG`: send this from now on."""

    name: str
    switch: str = "ON"


class BluefinStatus(NamedTuple):
    """Report the payload's state, `$BPSTS`. ok: 0 if nobody should count on the payload."""

    time_of_day_s: float
    ok: str
    text: str


class BluefinSteer(NamedTuple):
    """Command heading, depth and speed, `$BPRMB`.

    vertical_mode: 0 depth, 1 altitude, 2 pitch. speed_mode: 0 rpm, 1 m/s. heading_mode: 0 heading, 1 rudder.
    """

    time_of_day_s: float
    heading_rad: float
    vertical_m: float
    vertical_mode: str
    speed_mps: float
    speed_mode: str = "1"
    heading_mode: str = "0"


class BluefinCancel(NamedTuple):
    """Cancel a command, `$BPRCE`: end the current mission element, and with it what the payload made of it."""

    time_of_day_s: float
    element: float = 0.0


class BluefinContact(NamedTuple):
    """Report a contact."""

    time_of_day_s: float
    report: ContactReport


class BluefinGrammar(NmeaGrammar):
    """Frame sentences of NMEA 0183, counted as this vehicle's."""

    name = "bluefin"


def table_of(settings: BluefinSettings) -> Table:
    """Make the table of this vehicle's sentences."""
    name = settings.contact_sentence
    return Table(
        Sentence("BFACK", BluefinAnswer, (CLOCK, needed(TEXT), CLOCK, None, one_of(*"0123"), None, TEXT)),
        Sentence(
            "BFNVG", BluefinPosition, (CLOCK, LATITUDE, LONGITUDE, COUNT, DEPTH, DEPTH, HEADING, ROLL, PITCH, CLOCK)
        ),
        Sentence("BFNVR", BluefinVelocity, (CLOCK, SPEED, SPEED, SPEED)),
        Sentence("BFCTL", BluefinControl, (CLOCK, one_of("0", "1"))),
        Sentence("BFMIS", BluefinMission, (CLOCK, TEXT, needed(TEXT))),
        Sentence("BFMSC", BluefinCommand, (CLOCK, TEXT)),
        Sentence("BFSHT", BluefinShutdown, (CLOCK,)),
        Sentence("BFMBS", BluefinBegin, (CLOCK, None, None, None, TEXT)),
        Sentence("BFMBE", BluefinEnd, (CLOCK, None, None, None, TEXT)),
        Sentence("BPLOG", BluefinLog, (needed(TEXT), one_of("ON", "OFF"))),
        Sentence("BPSTS", BluefinStatus, (needed(CLOCK), one_of("0", "1"), TEXT)),
        Sentence(
            "BPRMB",
            BluefinSteer,
            (needed(CLOCK), needed(HEADING), needed(CENTI), one_of("0", "1"), needed(SPEED), one_of("1"), one_of("0")),
        ),
        Sentence("BPRCE", BluefinCancel, (needed(CLOCK), needed(COUNT))),
        *((Sentence(name, BluefinContact, (needed(CLOCK), CONTACT)),) if name else ()),
    )
