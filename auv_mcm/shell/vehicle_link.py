"""Connect the service to the vehicle: report contacts at once and health as it changes, and request legs.

The pilot, behind `VehiclePilot`, holds the dialect of the vehicle and whether it grants control.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Coroutine, Iterable, Mapping, Sequence
from functools import partial
from typing import Any, Final

from auv_mcm.clean_text import clean
from auv_mcm.clock import Clock
from auv_mcm.defects import Defect, caught, warn_of
from auv_mcm.geometry.fix import Fix, chord_m, course_rad, fix_at
from auv_mcm.plan.look_again import LookAgain, LooksSoFar, PlanRequest, Proposal
from auv_mcm.records import NAN, Contact, EarlyContact, NavSample, Notice, SourceEvent, Waypoint
from auv_mcm.settings.config import Config
from auv_mcm.shell.health.judge import Vehicle
from auv_mcm.source import AnnouncedContact, Health, VehiclePilot

# s without a position of the vehicle, after which health is a fault and no leg is requested; without a heading, after
# which the course serves
_LOST_S: Final = 3.0
_COURSE_M: Final = 5.0  # of way that gives a course: as that of planning, so that positions may scatter
_PLANNING_FAILED: Final = "planning failed"
_LAST_WORDS_S: Final = 0.5  # s for the last report to go out, and again where it was not acknowledged


class VehicleLink:
    """Link service and vehicle from `start` to `part`, which every way out of the service takes."""

    def __init__(self, config: Config, vehicle: VehiclePilot, clock: Clock) -> None:
        self.vehicle = vehicle
        self._clock = clock
        self._plans = config.vehicle.command or bool(config.plan.area_deg)
        self._look_again = LookAgain(config)
        self._serving: asyncio.Future[None] | None = None
        self._reported_health: tuple[Health, str] | None = None
        self._ending = ""
        self._has_failed = False  # planning, by a defect
        self._defects: list[Notice] = []
        self._proposed = False
        self._parted = ""
        self._position_deg = NAN, NAN
        self._heading_rad = NAN
        self._heading_s = -math.inf  # of a heading that was measured
        self._from: Fix | None = None  # where the course begins
        self._position_s = -math.inf
        self._time_s = NAN

    @property
    def plan(self) -> tuple[Waypoint, ...] | None:
        """Give the last plan proposed, None if there was none."""
        return self._look_again.plan if self._proposed else None

    def health(self) -> str:
        """Give the link's state for the health line; after parting, the last state."""
        area = self._look_again.area
        return (self._parted or self.vehicle.health()) + ("" if area is None else f" {area.words()}")

    def measured(self) -> Vehicle:
        """Give the link's state to be judged."""
        return Vehicle(self.health(), is_silent=not self._parted and self.vehicle.authority == "down")

    @property
    def verdict(self) -> str:
        """Give the verdict on the search of the area, "" if it is not known."""
        return "" if self._look_again.area is None else self._look_again.area.verdict

    def start(self, serve: Coroutine[Any, Any, None]) -> None:
        """Start the link. serve: talks to the vehicle until cancelled."""
        self._serving = asyncio.ensure_future(serve)
        self._report_health("starting", "the payload starts")

    def so_far(self) -> LooksSoFar:
        """Give what planning has to know after a restart."""
        return self._look_again.so_far()

    def go_on(self, session: int, n_starts: int, announced: Mapping[int, AnnouncedContact], so_far: LooksSoFar) -> None:
        """Go on with a session that n_starts runs before this one began; called first. Control is requested anew."""
        self.vehicle.go_on(session, n_starts, announced)
        self._look_again.go_on(so_far, self._clock.monotonic_s())

    def see(self, event: SourceEvent) -> None:
        """Take any event of the source, as it comes."""
        if not isinstance(event, NavSample):
            return
        now_s = self._clock.monotonic_s()
        if math.isfinite(event.heading_rad):
            self._heading_rad, self._heading_s = event.heading_rad, now_s
        if math.isfinite(event.latitude_deg) and math.isfinite(event.longitude_deg) and not event.position_leaps:
            self._position_deg, self._position_s = (event.latitude_deg, event.longitude_deg), now_s
            self._time_s = event.time_s
            self._follow_course(fix_at(event.time_s, *self._position_deg), now_s)

    def _follow_course(self, fix: Fix, now_s: float) -> None:
        """Take the course for the heading where none comes."""
        if self._from is None or chord_m(self._from, fix) >= _COURSE_M:
            if self._from is not None and now_s - self._heading_s > _LOST_S:
                self._heading_rad = course_rad(self._from, fix)
            self._from = fix

    def report(self, contacts: Iterable[Contact]) -> None:
        """Report contacts that are on disk, new or changed, to the vehicle and to planning."""
        for contact in contacts:
            self.vehicle.report(contact)
            self._safely(partial(self._look_again.learn, contact))

    async def report_again(self, contacts: Iterable[Contact]) -> None:
        """Report what a run before has found; what the vehicle does not have for certain comes again."""
        for contact in contacts:
            self.report([contact])
            await asyncio.sleep(0.0)

    def report_early(self, contacts: Iterable[EarlyContact]) -> None:
        """Report early contacts that are on disk to the vehicle alone: nothing is planned for what may be withdrawn."""
        for early in contacts:
            self.vehicle.report(early.reported)

    def attend(self, faults: Sequence[str], ask: Callable[[PlanRequest], bool]) -> list[Notice]:
        """Report and request what is due, twice a second while perception runs. ask: has a plan made, for `take`."""
        now_s = self._clock.monotonic_s()
        position_lost = now_s - self._position_s > _LOST_S
        # In the order of severity: without planning, contacts are still found and reported.
        also = {"there is no position": position_lost, _PLANNING_FAILED: self._has_failed}
        faults = [self._ending] if self._ending else [*faults, *(fault for fault, holds in also.items() if holds)]
        area = self._look_again.area
        self._report_health(
            "fault" if faults else "normal", "; ".join([*faults, *([] if area is None else [area.words()])])
        )
        if self._plans and not self._ending and not position_lost and self.vehicle.authority != "down":
            self._safely(partial(self._request, now_s, ask))
        defects, self._defects = self._defects, []
        return [*self.vehicle.take_notices(), *self._look_again.take_notices(), *defects]

    def _request(self, now_s: float, ask: Callable[[PlanRequest], bool]) -> None:
        """Follow the vehicle along its plan, propose the plan again where that is due, and have a new one made."""
        self._look_again.move(*self._position_deg, self.vehicle.authority == "granted", now_s)
        if (plan := self._look_again.insist(now_s)) is not None:
            self.vehicle.propose(plan)
        request = self._look_again.request((*self._position_deg, self._heading_rad), self._time_s, now_s)
        if request is not None:
            ask(request)

    def _safely(self, step: Callable[[], None]) -> None:
        """Take a step of planning. A defect in it ends planning and gives control back; the mission goes on."""
        if self._has_failed or not isinstance(found := caught(step), Defect):
            return
        self._has_failed = True
        self.vehicle.release(_PLANNING_FAILED)
        text = (
            f"planning failed ({found.text}): control is given back and no further leg is requested; contacts are "
            "found and reported as before. This is a defect: report it with the log"
        )
        self._defects.append(Notice(code="vehicle.planning_failed", text=text))
        warn_of(found, _PLANNING_FAILED)

    def take(self, proposal: Proposal) -> None:
        """Take the plan that was requested."""
        self._safely(partial(self._take, proposal))

    def _take(self, proposal: Proposal) -> None:
        plan = self._look_again.take(proposal, self._clock.monotonic_s())
        if plan is not None and not self._ending:
            self._proposed = True
            self.vehicle.propose(plan)

    def release(self, reason: str) -> None:
        """Give control back at once; contacts are still reported."""
        self._ending = reason
        self.vehicle.release(reason)

    async def part(self, reason: str) -> list[Notice]:
        """Give control back, say why, and leave. May be called at any time; takes less than a second."""
        if self._serving is None:
            return []
        reason = clean(reason)  # an error's words may hold those of a device or a file name
        try:
            self.release(reason)
            self._report_health("failure", reason)
            await asyncio.wait({self._serving}, timeout=_LAST_WORDS_S)
        finally:
            self._parted = self.vehicle.health()
            self._serving.cancel()
        await asyncio.wait({self._serving})
        return self.vehicle.take_notices()

    def _report_health(self, state: Health, text: str) -> None:
        if (state, text) != self._reported_health:
            self._reported_health = state, text
            self.vehicle.report_health(state, text)
