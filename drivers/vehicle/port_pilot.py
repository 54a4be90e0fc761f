"""Run the pilot at its port: write its messages at once; a defect in it ends commanding, not the mission."""

from __future__ import annotations

import asyncio
import logging
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, Literal

from auv_mcm.clock import Clock, Stamp
from auv_mcm.records import Contact, Notice, Waypoint
from auv_mcm.source import AnnouncedContact
from drivers.vehicle.dialect import PayloadHealth, VehicleMessage
from drivers.vehicle.pilot import Pilot

log = logging.getLogger(__name__)

_TICK_S: Final = 0.05  # dialects count on ten times a second at least


class PortPilot:
    """Run the pilot inside one event loop. counters: the pilot's, and vehicle.failed (a defect)."""

    def __init__(self, name: str, pilot: Pilot[Any], send: Callable[[Any], object], clock: Clock) -> None:
        """name: of the port. send: takes bytes, or a frame on a bus, without waiting or raising."""
        self._name = name
        self._pilot = pilot
        self._send = send
        self._clock = clock
        self._n_failed = 0
        self._notices: list[Notice] = []

    @property
    def authority(self) -> str:
        return self._pilot.authority

    @property
    def counters(self) -> Counter[str]:
        return self._pilot.counters + Counter({"vehicle.failed": self._n_failed})

    def health(self) -> str:
        return self._pilot.health()

    def take_notices(self) -> list[Notice]:
        notices, self._notices = [*self._notices, *self._pilot.take_notices()], []
        return notices

    def connected(self) -> None:
        """Note that the wire is open."""
        self._have(self._pilot.connected)

    def disconnected(self) -> None:
        """Note that the wire is lost."""
        self._have(self._pilot.disconnected)

    def hear(self, messages: Sequence[VehicleMessage], stamp: Stamp) -> None:
        """Take messages of the vehicle, if any. stamp: when the last of its bytes were read."""
        self._have(lambda now_s: self._pilot.hear(messages, stamp))

    def go_on(self, session: int, n_starts: int, announced: Mapping[int, AnnouncedContact]) -> None:
        """Report contacts under the numbers of a session; see `ReportQueue.go_on`."""
        self._pilot.go_on(session, n_starts, announced)

    def report(self, contact: Contact) -> None:
        self._have(lambda now_s: self._pilot.report(contact))

    def propose(self, plan: tuple[Waypoint, ...]) -> None:
        """Propose a plan in place of the one before; () withdraws it."""
        if not self._n_failed:
            self._have(lambda now_s: self._pilot.propose(plan, now_s))

    def report_health(self, state: Literal["starting", "normal", "fault", "failure"], text: str) -> None:
        self._have(lambda now_s: self._pilot.report_health(PayloadHealth(state, text), now_s))

    def release(self, reason: str) -> None:
        """Release control for good."""
        self._have(lambda now_s: self._pilot.release(reason, now_s))

    async def keep_talking(self) -> None:
        """Run the timers until cancelled."""
        while True:
            self._have(lambda now_s: None)
            await asyncio.sleep(_TICK_S)

    def _have(self, work: Callable[[float], None]) -> None:
        """Call the pilot and send its output.

        If it fails, control is given back and not asked for again.
        """
        try:
            self._do(work)
        except Exception as error:
            self._n_failed += 1
            if self._n_failed > 1:
                return
            log.exception("the pilot at port '%s' failed", self._name)
            text = (
                f"the pilot at port '{self._name}' failed ({error!r}). Control is released and not requested again. "
                "This is a defect: report it with the log and the recording."
            )
            self._notices.append(Notice(code="vehicle_failed", text=text, place=self._name))
            self._have(lambda now_s: self._pilot.release("the payload has a defect", now_s))

    def _do(self, work: Callable[[float], None]) -> None:
        now_s = self._clock.monotonic_s()
        work(now_s)
        for item in self._pilot.take_outgoing(now_s):
            self._send(item)
