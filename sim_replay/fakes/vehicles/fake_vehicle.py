"""Define what every fake vehicle controller does, in any protocol. No ports, no clocks: `now_s` is the monotonic
clock."""

from __future__ import annotations

from collections import Counter
from typing import Protocol, TypeVar, runtime_checkable

from auv_mcm.records import NavSample
from drivers.vehicle.dialect import Command, ContactReport

W = TypeVar("W")


class FakeController(Protocol[W]):
    """Simulate the computer of a vehicle by its maker's manual; W: bytes, or CanFrame on a bus.

    It receives requests for control, grants them while `willing`, obeys until the last command is too old, and then
    keeps its own plan. Its input is decoded by a parser of its own or by that of the driver, never trusted, never
    raising.

    counters: vehicle.commands_accepted, .commands_refused (given without control, or impossible), .commands_expired
    (control ended because none came in time), .reports, .reports_repeated (heard before: same session, number and
    revision), .nonsense.
    """

    willing: bool

    @property
    def counters(self) -> Counter[str]: ...

    @property
    def in_control(self) -> bool:
        """Report whether the payload commands."""
        ...

    @property
    def command(self) -> Command | None:
        """Return the command to fly now; None: its own plan."""
        ...

    def take_reports(self) -> list[ContactReport]:
        """Return contacts reported since the last call, each revision once."""
        ...

    def take_health(self) -> list[str]:
        """Return the payload's health reports since the last call."""
        ...

    def power_up(self, now_s: float) -> None:
        """Forget everything."""
        ...

    def revoke(self, now_s: float) -> None:
        """Revoke control."""
        ...

    def connected(self, now_s: float) -> None:
        """React to a host that has opened the wire."""
        ...

    def tick(self, pose: NavSample, arrived: bool, now_s: float) -> list[W]:
        """Return messages due when the vehicle is at `pose` (time_s: UTC.

        Speed over ground); called ten times a second.

        arrived: at the place of `command`.
        """
        ...

    def heard(self, data: W, now_s: float) -> list[W]:
        """Return answers to the host's data."""
        ...


@runtime_checkable
class Stoppable(Protocol):
    """Stop a vehicle as a person does, after which it idles until a person starts its plan again."""

    @property
    def is_idle(self) -> bool:
        """Report whether it flies no plan."""
        ...

    def abort(self, now_s: float) -> None:
        """Abort by a message that the payload hears as well."""
        ...

    def stop_plan(self, now_s: float) -> None:
        """Stop whatever plan runs, on board: the payload hears of it by the vehicle's state alone."""
        ...

    def start_plan(self, now_s: float) -> None:
        """Start the vehicle's own plan."""
        ...
