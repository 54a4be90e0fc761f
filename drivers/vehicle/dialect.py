"""Define the messages between a vehicle's controller and the payload, whatever the dialect.

Directions are radians clockwise from true north, depths metres below the surface, altitudes metres above the sea floor.
What is not known is NaN. `now_s` is the monotonic clock.
"""

from __future__ import annotations

import enum
from collections import Counter
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple, Protocol, TypeAlias, TypeVar, runtime_checkable

import msgspec

from auv_mcm.clock import Stamp
from auv_mcm.records import NAN, ContactClass
from drivers.navigation.nav_decoder import NavFix

W = TypeVar("W")
Wntra = TypeVar("Wntra", contravariant=True)


class Capability(enum.Flag):
    """Name the capabilities of a dialect."""

    NAVIGATION = enum.auto()  # it reports the vehicle's position
    WAYPOINT = enum.auto()  # the vehicle goes to a place by itself
    STEERING = enum.auto()  # the vehicle holds a heading, a depth or altitude, and a speed
    CONTACT = enum.auto()  # it takes reports of contacts
    ACKNOWLEDGED = enum.auto()  # and acknowledges them
    HEALTH = enum.auto()  # it takes the payload's health
    DEPTHS_ALONE = enum.auto()  # it holds depths and no altitudes: it is commanded depths
    INVITES = enum.auto()  # it offers control of itself: a request waits for that, and nothing of it is sent


class Vertical(NamedTuple):
    """Command a depth or an altitude."""

    reference: Literal["depth", "altitude"]
    value_m: float


class GoTo(NamedTuple):
    """Command the vehicle to a place. radius_m: as near counts as arrived."""

    latitude_deg: float
    longitude_deg: float
    vertical: Vertical
    speed_mps: float
    radius_m: float


class Steer(NamedTuple):
    """Command a heading, a depth or altitude, and a speed to hold."""

    heading_rad: float
    vertical: Vertical
    speed_mps: float


Command: TypeAlias = GoTo | Steer


class WireCommand(NamedTuple):
    """Hold the numbers by which an outgoing message commands, None for what it leaves as it was.

    place_deg: latitude, longitude. holds_s: how long the vehicle obeys it. All None: a message that cannot be read.
    """

    place_deg: tuple[float, float] | None = None
    radius_m: float | None = None
    heading_rad: float | None = None
    vertical: Vertical | None = None
    speed_mps: float | None = None
    holds_s: float | None = None


def numbers_of(command: Command) -> WireCommand:
    """Return the numbers of a command that is not encoded yet."""
    if isinstance(command, Steer):
        return WireCommand(heading_rad=command.heading_rad, vertical=command.vertical, speed_mps=command.speed_mps)
    return WireCommand(
        place_deg=(command.latitude_deg, command.longitude_deg),
        radius_m=command.radius_m,
        vertical=command.vertical,
        speed_mps=command.speed_mps,
    )


class ContactReport(msgspec.Struct, frozen=True, kw_only=True):
    """Hold a contact as it is reported to the vehicle.

    session: of the run that numbers its contacts, so that two runs are not confused. number, revision: of the contact,
    and which report of it this is, 1 the first; a report with the session, number and revision of an earlier one is a
    repetition. time_s: UTC seconds since 1970 of the first view. depth_m: of the sea floor there. *_sigma_m: 1-sigma;
    sigma_m is the semi-major axis of the position's error ellipse. belief: mass per class and `unknown`, sum 1.
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
        """Return a name for people and for dialects that carry names alone."""
        return f"MLC-{self.number:05d}"


class PayloadHealth(NamedTuple):
    """Hold the payload's health.

    state: `starting`, `normal`, `fault` (it works, with less), `failure` (do not count on it).
    """

    state: Literal["starting", "normal", "fault", "failure"]
    text: str


class ReportedState(NamedTuple):
    """Hold the vehicle's own navigation."""

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
    """Return the state as a fix for the navigation. source: the port that it came from."""
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
    """Grant control to the payload."""

    reason: str


class Withheld(NamedTuple):
    """Refuse or revoke control: refused, taken back, timed out, mission over, shutting down.

    reason: in the vehicle's words, for people.
    """

    reason: str


class Considered(NamedTuple):
    """Answer a request for control without a decision, which comes later."""


class PlaceReached(NamedTuple):
    """Report that the vehicle has reached the place of the last GoTo."""


class Acknowledged(NamedTuple):
    """Acknowledge the message with this ticket."""

    ticket: int


class Rejected(NamedTuple):
    """Reject the message with this ticket: understood and refused; repeating it is of no use."""

    ticket: int
    reason: str


class Doubted(NamedTuple):
    """Report a refused grant, which may be somebody else's or an old one.

    reason: for people.
    """

    reason: str


VehicleEvent: TypeAlias = (
    ReportedState | Granted | Withheld | Considered | PlaceReached | Acknowledged | Rejected | Doubted
)


class VehicleMessage(NamedTuple):
    """Hold one message of the vehicle.

    record: in the terms of its dialect, None for what is of no use to a talker. state: where the vehicle is, if it says
    so. fixes: the same for the navigation, and what other units on its bus say. of_vehicle: False if only such a unit
    said it.
    """

    record: Any
    received: Stamp
    state: ReportedState | None = None
    fixes: tuple[NavFix, ...] = ()
    of_vehicle: bool = True


@runtime_checkable
class VehicleDecoder(Protocol[Wntra]):
    """Decode bytes or frames of one vehicle to messages.

    They depend on what is fed alone, so a recording gives the same. It never raises.

    counters: NAME.messages, NAME.refused.REASON and others, by dotted name. bus_counters: of other units on its bus.
    """

    @property
    def counters(self) -> Counter[str]: ...
    @property
    def bus_counters(self) -> Counter[str]:
        """Count what came over the whole bus, not from the vehicle alone."""

    def feed(self, data: Wntra, stamp: Stamp) -> list[VehicleMessage]:
        """Return the messages that a chunk of bytes, or a frame, completes, in order.

        One for each message, understood or not.

        stamp: when it was read.
        """
        ...


@runtime_checkable
class Talker(Protocol[W]):
    """Talk to one vehicle in its protocol; W: bytes, or CanFrame on a bus.

    It opens no port, reads no clock and never raises.

    It decides how messages are sent, acknowledged, repeated and kept alive; whether a command may be given is decided
    before, and whether it may leave is judged by its bytes after, see `ReadsBack`. The messages to be sent come out of
    `take_outgoing`, called after every call and at least ten times a second.

    silent_after_s: a vehicle not heard for so long is taken for gone. command_period_s: a command that holds is given
    again so often, well within the time after which the vehicle itself forgets it. counters: by dotted name, besides
    those of the decoder.
    """

    @property
    def capabilities(self) -> Capability:
        """Return what this dialect can report and command."""

    @property
    def silent_after_s(self) -> float:
        """Return after how long without a message the vehicle counts as silent, s."""

    @property
    def command_period_s(self) -> float:
        """Return how often a command is repeated, s."""

    @property
    def counters(self) -> Counter[str]: ...

    def connected(self, now_s: float) -> None:
        """Note that the wire is open, perhaps again: greet, and forget what was half sent.

        Unacknowledged reports come again by `report`.
        """
        ...

    def disconnected(self) -> None:
        """Note that the wire is lost."""
        ...

    def hear(self, messages: Sequence[VehicleMessage], stamp: Stamp) -> list[VehicleEvent]:
        """Interpret the messages of a chunk of bytes, or of a frame, in order.

        stamp: when it was read; called without messages, too.
        """
        ...

    def request(self, now_s: float) -> None:
        """Request control."""
        ...

    def command(self, command: Command, now_s: float) -> None:
        """Send a command, only while granted, and only kinds in `capabilities`. It replaces the one before."""
        ...

    def report(self, report: ContactReport, ticket: int, now_s: float) -> None:
        """Report a contact. ticket: for Acknowledged or Rejected; 1 to 65535, not used again while one is awaited."""
        ...

    def report_health(self, health: PayloadHealth, now_s: float) -> None:
        """Take the payload's health whenever it changes; the dialect repeats it as its vehicle requires."""
        ...

    def release(self, reason: str, now_s: float) -> None:
        """Release control at once; a command not yet sent is dropped.

        Also when it was asked for and not yet granted.
        """
        ...

    def take_outgoing(self, now_s: float) -> list[W]:
        """Return what is to be sent now: answers, heartbeats, repetitions."""
        ...


@runtime_checkable
class ReadsBack(Protocol[Wntra]):
    """Read the commands in what a talker sends, from its bytes or frames alone.

    A talker that has this method is judged by what it sends; another one by what it was given.
    """

    def commands_in(self, outgoing: Sequence[Wntra]) -> list[WireCommand | None]:
        """Return the command of each item, None for one that commands nothing. A message of several items is in each.

        Whatever is not known for harmless is a command; one that cannot be read has no numbers.
        """
        ...
