"""Hold the health of the payload: one record, which every output renders."""

from __future__ import annotations

from typing import Any, Final, Literal, TypeAlias, get_args

import msgspec

from auv_mcm.clean_text import clean_json

State: TypeAlias = Literal["boot", "normal", "degraded", "fault"]
STATES: Final[tuple[State, ...]] = get_args(State)
"""States by their number for Prometheus. boot: not ready yet; degraded: it works, but less well; fault: a part of the
mission is not done."""
GRAVITY: Final[tuple[State, ...]] = ("normal", "boot", "degraded", "fault")
"""States in the order of their gravity: the whole is as its worst part, and not normal while one is not ready."""

_LATE_PERIODS: Final = 3.0  # periods without a new record, after which the service does not run, or hangs

REASONS: Final = {
    "starting": "perception is not ready yet; wait",
    "no_kernels": "numpy does the work of the C kernels: install the wheel with compiled kernels",
    "journal_failed": "announced contacts are not on disk: free space, or check the disk",
    "perception_behind": "pings are dropped, or half of the queue waits: set budget.duty, or use coarser pixels",
    "perception_stalled": "pings wait and perception has taken none: it is restarted, or the service with it",
    "perception_restarted": "perception ended and goes on from its checkpoint: check memory and the system log",
    "work_shed": "work on the least likely places is left out: set budget.duty, or use coarser pixels",
    "port_down": "the port cannot be opened: check device, address and cable; 'auv-mcm check' names the cause",
    "port_silent": "the port is open and nothing comes: check supply, cable, rate and what the device is set to send",
    "no_pings": "the sonar sends and no ping is in it: let it ping, and check that device and rate are its own",
    "vehicle_silent": "the vehicle says nothing that is understood: check its port, and that the protocol is its own",
    "port_discards": "more comes than can be decoded: check that only the configured device sends there",
    "position_lost": "no unit gives a position: check antenna, unit and its port",
    "quantity_lost": "a quantity that was there is given by no unit any more: check the unit and its port",
    "recording_incomplete": "bytes are missing from the recording: free space, or record to a faster disk",
    "disk_low": "recordings of a day may fill the disk: free space",
    "disk_full": "the results of a mission do not fit: free space",
    "hot": "the processor is as warm as its kernel's limit for slowing it down: cool it, or lower budget.duty",
}
"""What each reason means and what to do."""

VALUES: Final = {
    "uptime_s": "time since the service began",
    "event_loop_late_s": "longest time that a byte at a port waited in the last period",
    "processor_share": "share of one core that the process took in the last period",
    "memory_bytes": "resident memory of the process",
    "pings_total": "pings handed to perception",
    "pings_hz": "pings handed to perception in a second",
    "pings_dropped_total": "pings dropped because the queue was full",
    "pings_with_less_work_total": "pings for which work was left out because perception was behind",
    "queue_pings": "pings that wait for perception",
    "queue_pings_limit": "service.queue_pings",
    "messages_in_flight": "messages that perception has not answered yet",
    "delay_s": "time from a ping's arrival to its answer: the pings that wait, by their rate (Little's law)",
    "contacts": "contacts announced that are no clutter",
    "clutter": "contacts announced as clutter",
    "received_bytes_total": "bytes received at the port",
    "received_bytes_hz": "bytes received at the port in a second",
    "age_s": "time since the newest byte of the port, or the newest value of the quantity",
    "ping_age_s": "time since the newest ping of the sonar at the port",
    "recorded_bytes_total": "bytes of ports that are on disk",
    "lost_bytes_total": "bytes of ports that are missing from the recording",
    "free_bytes": "free space on the disk of the results",
    "temperature_c": "highest temperature that the kernel reports",
}
"""What each value of a part is. A name ends with its unit; _total: counted since the service began."""


class Part(msgspec.Struct, frozen=True, kw_only=True):
    """Describe one part: a port, a quantity of navigation, a stage, the disk, the computer.

    name: such as port.sonar. reasons: keys of `REASONS`. words: more for people, such as who grants control. values: by
    a name of `VALUES`; what is not known is absent.
    """

    name: str
    state: State
    reasons: tuple[str, ...] = ()
    words: str = ""
    values: dict[str, float] = {}


class Health(msgspec.Struct, frozen=True, kw_only=True):
    """Describe the payload at one moment.

    session: its folder. utc_s: of this computer's clock, when this was found. period_s: until the next record.
    """

    version: str
    session: str
    utc_s: float
    period_s: float
    parts: tuple[Part, ...]

    @property
    def state(self) -> State:
        """Give the state of the worst part."""
        return max((part.state for part in self.parts), key=GRAVITY.index, default="boot")

    @property
    def reasons(self) -> tuple[str, ...]:
        """List the reasons of all parts, each as part:reason."""
        return tuple(f"{part.name}:{reason}" for part in self.parts for reason in part.reasons)

    def is_late(self, now_s: float) -> bool:
        """Find whether it is too old, or of a later time: the clock was set back since, as at a start without one.

        now_s: UTC.
        """
        return abs(now_s - self.utc_s) > _LATE_PERIODS * self.period_s + 1.0  # a second: of writing, and of the start

    def to_json(self) -> bytes:
        """Write the record, with the state of the whole, as JSON on one line."""
        whole: dict[str, Any] = {"state": self.state, **msgspec.to_builtins(self)}
        return clean_json(msgspec.json.encode(whole).decode()).encode()


def parse_health(data: bytes) -> Health:
    """Read what `to_json` wrote. Raises msgspec.DecodeError."""
    return msgspec.json.decode(data, type=Health)
