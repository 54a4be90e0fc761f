"""What a vehicle's controller and the payload have to say to each other, whatever the dialect.

Directions are radians clockwise from true north, depths metres below the surface, altitudes metres above the sea floor. What is not known
is NaN. `now_s` is the monotonic clock.
"""

from __future__ import annotations

import enum
from collections import Counter
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple, Protocol, TypeAlias, TypeVar

import msgspec

from auv_mcm.clock import Stamp
from auv_mcm.records import NAN, ContactClass
from drivers.navigation.nav_decoder import NavFix

W = TypeVar("W")
Wntra = TypeVar("Wntra", contravariant=True)


class Capability(enum.Flag):
    """What a dialect can carry."""

    NAVIGATION = enum.auto()  # it says where the vehicle is
    WAYPOINT = enum.auto()  # the vehicle goes to a place by itself
    STEERING = enum.auto()  # the vehicle holds a heading, a depth or altitude, and a speed
    CONTACT = enum.auto()  # it takes reports of contacts
    ACKNOWLEDGED = enum.auto()  # and says which it has got
    HEALTH = enum.auto()  # it takes the payload's health


class Vertical(NamedTuple):
    """How deep to go."""

    reference: Literal["depth", "altitude"]
    value_m: float


class GoTo(NamedTuple):
    """Go to a place by yourself. radius_m: as near counts as there."""

    latitude_deg: float
    longitude_deg: float
    vertical: Vertical
    speed_mps: float
    radius_m: float


class Steer(NamedTuple):
    """Hold this."""

    heading_rad: float
    vertical: Vertical
    speed_mps: float


Command: TypeAlias = GoTo | Steer


class ContactReport(msgspec.Struct, frozen=True, kw_only=True):
    """A contact as it is reported to the vehicle.

    session: of the run that numbers its contacts, so that two runs are not confused. number, revision: of the contact, and which telling of
    it this is, 1 the first; a report with the session, number and revision of an earlier one is a repetition. time_s: UTC seconds
    since 1970 of the first view. depth_m: of the sea floor there. *_sigma_m: 1-sigma; sigma_m is the semi-major axis of the position's
    error ellipse. belief: mass per class and `unknown`, sum 1.
    """

    session: int
    number: int
    revision: int
    time_s: float
    latitude_deg: float
    longitude_deg: float
    sigma_m: float
    p_mine: float
    classification: ContactClass
    belief: dict[str, float]
    n_views: int
    depth_m: float = NAN
    length_m: float = NAN
    width_m: float = NAN
    height_m: float = NAN
    length_sigma_m: float = NAN
    width_sigma_m: float = NAN
    height_sigma_m: float = NAN

    @property
    def label(self) -> str:
        """A name for people and for dialects that know names alone."""
        return f"MLC-{self.number:05d}"


class PayloadHealth(NamedTuple):
    """How the payload is. state: `starting`, `normal`, `fault` (it works, with less), `failure` (do not count on it)."""

    state: Literal["starting", "normal", "fault", "failure"]
    text: str


class ReportedState(NamedTuple):
    """Where the vehicle says it is."""

    received: Stamp
    latitude_deg: float = NAN
    longitude_deg: float = NAN
    heading_rad: float = NAN
    pitch_rad: float = NAN
    roll_rad: float = NAN
    depth_m: float = NAN
    altitude_m: float = NAN
    speed_mps: float = NAN


def fix_of(source: str, state: ReportedState) -> NavFix:
    """The state for the navigation. source: the port that it came from."""
    return NavFix(
        source=source,
        received=state.received,
        latitude_deg=state.latitude_deg,
        longitude_deg=state.longitude_deg,
        heading_rad=state.heading_rad,
        pitch_rad=state.pitch_rad,
        roll_rad=state.roll_rad,
        depth_m=state.depth_m,
        altitude_m=state.altitude_m if state.altitude_m > 0.0 else NAN,
        speed_mps=state.speed_mps,
    )


class Granted(NamedTuple):
    """We may command."""

    reason: str


class Withheld(NamedTuple):
    """We may not, or no longer: refused, taken back, timed out, mission over, shutting down. reason: in the vehicle's words, for people."""

    reason: str


class PlaceReached(NamedTuple):
    """The vehicle is at the place of the GoTo that was commanded last."""


class Acknowledged(NamedTuple):
    """The message with this ticket was taken."""

    ticket: int


class Rejected(NamedTuple):
    """The message with this ticket was understood and refused; saying it again is of no use."""

    ticket: int
    reason: str


class Doubted(NamedTuple):
    """A message that would let the payload command was refused, as it may be somebody else's or an old one. reason: for people."""

    reason: str


VehicleEvent: TypeAlias = ReportedState | Granted | Withheld | PlaceReached | Acknowledged | Rejected | Doubted


class Said(NamedTuple):
    """One message of the vehicle.

    record: in the terms of its dialect, None for what is of no use to a talker. state: where the vehicle is, if it says so. fixes: the same
    for the navigation, and what other units on its bus say. of_vehicle: False if only such a unit said it.
    """

    record: Any
    received: Stamp
    state: ReportedState | None = None
    fixes: tuple[NavFix, ...] = ()
    of_vehicle: bool = True


class VehicleDecoder(Protocol[Wntra]):
    """Bytes or frames of one vehicle to messages. They depend on what is fed alone, so a recording gives the same. It never raises.

    counters: NAME.messages, NAME.refused.REASON and others, by dotted name. bus_counters: of other units on its bus.
    """

    @property
    def counters(self) -> Counter[str]: ...
    @property
    def bus_counters(self) -> Counter[str]: ...

    def feed(self, data: Wntra, stamp: Stamp) -> list[Said]:
        """What a chunk of bytes, or a frame, completes, in order; one for each message, understood or not. stamp: when it was read."""
        ...


class Talker(Protocol[W]):
    """The payload's part of one vehicle's language; W: bytes, or CanFrame on a bus. It opens no port, reads no clock and never raises.

    What it decides is how things are said, acknowledged, said again and kept alive; whether they may be said at all is decided before.
    What there is to say comes out of `take_outgoing`, asked after every call and at least ten times a second.

    silent_after_s: a vehicle not heard for so long is taken for gone. command_period_s: a command that holds is given again so often, well
    within the time after which the vehicle itself forgets it. counters: by dotted name, besides those of the decoder.
    """

    @property
    def capabilities(self) -> Capability: ...
    @property
    def silent_after_s(self) -> float: ...
    @property
    def command_period_s(self) -> float: ...
    @property
    def counters(self) -> Counter[str]: ...

    def connected(self, now_s: float) -> None:
        """The wire is open, perhaps again: greet, and forget what was half said. Unacknowledged reports come again by `report`."""
        ...

    def disconnected(self) -> None:
        """The wire is gone."""
        ...

    def hear(self, said: Sequence[Said], stamp: Stamp) -> list[VehicleEvent]:
        """What the messages of a chunk of bytes, or of a frame, mean, in order. stamp: when it was read; called without messages, too."""
        ...

    def request(self, now_s: float) -> None:
        """Ask to be allowed to command."""
        ...

    def command(self, command: Command, now_s: float) -> None:
        """Only while granted, and only kinds in `capabilities`. It takes the place of the one before."""
        ...

    def report(self, report: ContactReport, ticket: int, now_s: float) -> None:
        """Report a contact. ticket: for Acknowledged or Rejected; 1 to 65535, not used again while one is awaited."""
        ...

    def report_health(self, health: PayloadHealth, now_s: float) -> None:
        """Called whenever it changes; the dialect repeats it as its vehicle wants."""
        ...

    def release(self, reason: str, now_s: float) -> None:
        """Give control back, at once; a command not yet sent is dropped. Also when it was asked for and not yet granted."""
        ...

    def take_outgoing(self, now_s: float) -> list[W]:
        """What is to be sent now: answers, heartbeats, repetitions."""
        ...
