"""Define what the service needs of a source of pings and navigation, of its recorder and of the vehicle at its
ports."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping
from typing import Literal, NamedTuple, Protocol, TypeAlias, runtime_checkable

from auv_mcm.clock import Stamp
from auv_mcm.records import Contact, Notice, SourceEvent, Waypoint

Health: TypeAlias = Literal["starting", "normal", "fault", "failure"]


class SourceUri(NamedTuple):
    """Hold a parsed service.source, e.g. replay:///data/mission.xtf?speed=1."""

    text: str
    scheme: str
    path: str
    options: dict[str, str]


class AnnouncedContact(NamedTuple):
    """Hold what the runs of a session before this one announced of a contact: how often, and its highest p_mine."""

    n_revisions: int
    p_mine: float


class VehiclePilot(Protocol):
    """Talk to the vehicle at its port; nothing here waits or raises."""

    @property
    def authority(self) -> str:
        """Return the state of control: down, listening, requested, granted or revoked."""

    @property
    def counters(self) -> Counter[str]: ...

    def health(self) -> str:
        """Describe the vehicle's port for the health line."""

    def take_notices(self) -> list[Notice]: ...

    def go_on(self, session: int, n_starts: int, announced: Mapping[int, AnnouncedContact]) -> None:
        """Report contacts under the numbers of a session that n_starts runs before this one began.

        announced: by them, by the number of a report.
        """

    def report(self, contact: Contact) -> None:
        """Report a contact that is new or has changed."""

    def propose(self, plan: tuple[Waypoint, ...]) -> None:
        """Propose a plan, in place of the one before; () withdraws it."""

    def report_health(self, state: Health, text: str) -> None: ...

    def release(self, reason: str) -> None:
        """Give control back, for good."""


class PortState(NamedTuple):
    """Describe a port.

    discarded_bytes: received and not decoded. age_s, ping_age_s: since the last byte and, of a sonar, the last ping;
    infinite if none came. ping_age_s is NaN of a port without a sonar.
    """

    name: str
    state: Literal["up", "silent", "down"]
    received_bytes: int
    discarded_bytes: int
    age_s: float
    ping_age_s: float = math.nan


class QuantityState(NamedTuple):
    """Describe a quantity of navigation that some unit has given.

    served_by: the unit, "" while it is lost. age_s: of the newest value.
    """

    name: str
    served_by: str
    age_s: float


class SourceHealth(NamedTuple):
    """Describe a live source: every port, and every quantity that was ever given; position always."""

    ports: tuple[PortState, ...]
    quantities: tuple[QuantityState, ...]


class EventSink(Protocol):
    """Take the events of a source: the service's queue."""

    async def put(self, event: SourceEvent) -> None:
        """Append an event once there is room."""

    def push(self, event: SourceEvent) -> None:
        """Append an event at once; the oldest of its kind is dropped if there is no room."""


class Source(Protocol):
    """Provide pings and navigation.

    A lossless source puts its events, and waits for room; the others push them.
    """

    @property
    def lossless(self) -> bool:
        """Find whether the source waits while the pipeline is busy, so that nothing is lost."""

    async def run(self, sink: EventSink) -> None:
        """Give every event to `sink`, and return once none follows. Called once. Raises AuvMcmError."""

    def counters(self) -> Counter[str]:
        """Count what it skipped or mended so far."""


Record: TypeAlias = "Callable[[str, Literal['in', 'out'], Stamp, bytes], None]"
"""Takes bytes of a port, by its name, that were received or sent; neither waits nor raises."""


@runtime_checkable
class LiveSource(Source, Protocol):
    """Read ports, which never end by themselves."""

    def record_with(self, record: Record) -> None:
        """Hand every byte to `record`. Called once, before `run`."""

    def stop(self) -> None:
        """Close the ports; `run` then gives what was held back, and returns."""

    def health(self) -> SourceHealth:
        """Describe each port and each quantity of navigation as they are now."""

    def faults(self) -> list[str]:
        """List what is wrong with ports, in a few words each."""

    @property
    def vehicle(self) -> VehiclePilot | None:
        """Return the vehicle's end, if there is one."""

    async def serve_vehicle(self) -> None:
        """Talk to the vehicle until cancelled, whether or not `run` has begun or returned."""


class Recorder(Protocol):
    """Keep what live ports received and were sent."""

    @property
    def counters(self) -> Counter[str]: ...

    def record(self, port: str, direction: Literal["in", "out"], stamp: Stamp, data: bytes) -> None: ...

    def take_notices(self) -> list[Notice]: ...

    def close(self) -> None: ...
