"""Put the controller of a fake vehicle on its wire, report its commands and actions, and corrupt its output on
request."""

from __future__ import annotations

import asyncio
import math
from collections import Counter
from collections.abc import Callable
from typing import Any, Final

import msgspec
import numpy as np

from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.records import NavSample
from drivers.links.can_frame import CanFrame
from drivers.vehicle.dialect import Command, GoTo, Steer, Vertical
from sim_replay.fakes.navigation import Message
from sim_replay.fakes.vehicles.fake_vehicle import FakeController, Stoppable

Report = Callable[[str, dict[str, Any]], None]

_STREAM: Final = 0x4E4F4E53  # keeps these random numbers apart from others of the same seed


class ReportingController:
    """Report a controller's actions.

    `granted`, `released` (by: `payload`, `vehicle`, or `time-out`), `command` (flown from now on), `refused`
    (n_commands), `contact` (as it was reported), `health` (text).

    is_talking_nonsense: every message is repeated, corrupted. granted_once: set when control is granted for the first
    time.
    """

    def __init__(self, controller: FakeController[Any], seed: int, report: Report) -> None:
        self._controller = controller
        self._random = np.random.Generator(np.random.PCG64([seed, _STREAM]))
        self._report = report
        self._nonsense: Counter[str] = Counter()
        self._was_in_control = False
        self._last_command: Command | None = None
        self._before: Counter[str] = Counter()
        self._taken_back = False
        self._heading_rad = 0.0  # true
        self.is_talking_nonsense = False
        self.granted_once = asyncio.Event()

    @property
    def counters(self) -> Counter[str]:
        return self._controller.counters + self._nonsense

    @property
    def in_control(self) -> bool:
        """Report whether the payload commands."""
        return self._controller.in_control

    @property
    def command(self) -> Command | None:
        """Return the command to fly now; None: the vehicle's own plan."""
        return self._controller.command if self._controller.in_control else None

    @property
    def steered(self) -> Command | None:
        """Return what the vehicle does now: the command, or, where it idles, as good as nothing; None: its own plan."""
        idles = isinstance(self._controller, Stoppable) and self._controller.is_idle
        return Steer(self._heading_rad, Vertical("depth", 0.0), 0.0) if idles else self.command

    def power_up(self, now_s: float) -> None:
        self._controller.power_up(now_s)
        self._report_changes()

    def set_willing(self, willing: bool, now_s: float) -> None:
        """Set whether control is granted; unwilling revokes it and grants no more."""
        self._controller.willing = willing
        if not willing:
            self._taken_back = True
            self._controller.revoke(now_s)
            self._report_changes()
            self._taken_back = False

    def stop(self, now_s: float, *, by_abort: bool) -> None:
        """Stop the vehicle as a person does, by an Abort or on board."""
        assert isinstance(self._controller, Stoppable)
        stop = self._controller.abort if by_abort else self._controller.stop_plan
        self._taken_back = True
        stop(now_s)
        self._report_changes()
        self._taken_back = False

    def start_plan(self, now_s: float) -> None:
        """Start the vehicle's own plan, as a person does."""
        assert isinstance(self._controller, Stoppable)
        self._controller.start_plan(now_s)
        self._report_changes()

    def connected(self, now_s: float) -> None:
        self._controller.connected(now_s)
        self._report_changes()

    def tick(self, sample: NavSample, now_s: float) -> list[Message]:
        """Return the messages due at the pose that the vehicle believes; sample.time_s: UTC."""
        self._heading_rad = sample.heading_rad
        messages = list(self._controller.tick(sample, _is_there(sample, self.command), now_s))
        self._report_changes()
        return self._with_nonsense(messages)

    def heard(self, data: Message, now_s: float) -> list[Message]:
        messages = list(self._controller.heard(data, now_s))
        self._report_changes()
        return self._with_nonsense(messages)

    def _report_changes(self) -> None:
        controller = self._controller
        risen = controller.counters - self._before
        self._before = Counter(controller.counters)
        if controller.in_control and not self._was_in_control:
            self._report("granted", {})
            self.granted_once.set()
        if self.command is not None and self.command != self._last_command:
            self._report("command", {"kind": type(self.command).__name__, **self.command._asdict()})
        if n_refused := risen["vehicle.commands_refused"]:
            self._report("refused", {"n_commands": n_refused})
        for report in controller.take_reports():
            self._report("contact", {key: _json(value) for key, value in msgspec.to_builtins(report).items()})
        for text in controller.take_health():
            self._report("health", {"text": text})
        if self._was_in_control and not controller.in_control:
            by = "vehicle" if self._taken_back else "time-out" if risen["vehicle.commands_expired"] else "payload"
            self._report("released", {"by": by})
        self._was_in_control, self._last_command = controller.in_control, self.command

    def _with_nonsense(self, messages: list[Message]) -> list[Message]:
        if not self.is_talking_nonsense:
            return messages
        spoilt = [other for message in messages for other in (message, self._spoilt(message))]
        self._nonsense["vehicle.nonsense_sent"] += len(spoilt) - len(messages)
        return spoilt

    def _spoilt(self, message: Message) -> Message:
        """Corrupt a frame or bytes. Frames are cut short, as a bus has checksums; bytes are cut, or one of them is
        changed.
        """
        if isinstance(message, CanFrame):
            return message._replace(data=message.data[: self._random.integers(0, max(len(message.data), 1))])
        if not message or self._random.random() < 0.5:
            return message[: self._random.integers(0, max(len(message), 1))]
        place = int(self._random.integers(0, len(message)))
        changed = message[place] ^ int(self._random.integers(1, 256))
        return message[:place] + bytes([changed]) + message[place + 1 :]


def _is_there(sample: NavSample, command: Command | None) -> bool:
    if not isinstance(command, GoTo):
        return False
    frame = LocalFrame(latitude_deg=sample.latitude_deg, longitude_deg=sample.longitude_deg)
    east_m, north_m, _ = frame.to_enu(command.latitude_deg, command.longitude_deg, 0.0)
    return math.hypot(float(east_m), float(north_m)) <= command.radius_m


def _json(value: Any) -> Any:
    """Replace NaN, which JSON lacks."""
    return None if isinstance(value, float) and not math.isfinite(value) else value
