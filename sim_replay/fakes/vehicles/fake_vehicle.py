"""What every fake vehicle controller does, whatever it speaks. No ports, no clocks: `now_s` is the monotonic clock."""

from __future__ import annotations

from collections import Counter
from typing import Protocol, TypeVar

from auv_mcm.records import NavSample
from drivers.vehicle.dialect import Command, ContactReport

W = TypeVar("W")


class FakeController(Protocol[W]):
    """The computer of a vehicle, as its maker describes it; W: bytes, or CanFrame on a bus.

    It is asked for control, grants it while `willing`, obeys until what it was told is too old, and then keeps its own plan. What it hears
    is decoded by a parser of its own or by that of the driver, never trusted, never raising.

    counters: vehicle.commands_accepted, .commands_refused (given without control, or impossible), .commands_expired (control ended
    because none came in time), .reports, .reports_repeated (heard before: same session, number and revision), .nonsense.
    """

    willing: bool

    @property
    def counters(self) -> Counter[str]: ...

    @property
    def in_control(self) -> bool:
        """Whether the payload commands."""
        ...

    @property
    def command(self) -> Command | None:
        """What to fly now; None: its own plan."""
        ...

    def take_reports(self) -> list[ContactReport]:
        """Contacts told since this was asked last, each revision once."""
        ...

    def take_health(self) -> list[str]:
        """What the payload said of its health since this was asked last."""
        ...

    def power_up(self, now_s: float) -> None:
        """Forget everything."""
        ...

    def revoke(self, now_s: float) -> None:
        """Take control back."""
        ...

    def connected(self, now_s: float) -> None:
        """A host has opened the wire."""
        ...

    def tick(self, pose: NavSample, arrived: bool, now_s: float) -> list[W]:
        """What it says by itself when the vehicle is at `pose` (time_s: UTC; speed over ground); called ten times a second. arrived: at the
        place of `command`."""
        ...

    def heard(self, data: W, now_s: float) -> list[W]:
        """Answers to what the host sent."""
        ...
