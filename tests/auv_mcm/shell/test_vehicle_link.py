"""What the link has planned and proposes to the vehicle, step by step and without a service around it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest

from auv_mcm.plan.look_again import LooksSoFar, PlanRequest, Proposal
from auv_mcm.records import NAN, Contact, NavSample, Notice
from auv_mcm.settings.config import Config
from auv_mcm.settings.vehicle_settings import VehicleConfig
from auv_mcm.shell.vehicle_link import VehicleLink
from tests.auv_mcm.classify import drawn_looks
from tests.auv_mcm.shell.test_service_vehicle import FENCED, Vehicle
from tests.make.records import waypoint_of
from tests.manual_clock import ManualClock

PLACES = ((43.0, "start"), (43.0002, "leg_entry"), (43.0008, "leg_exit"))
PLAN = tuple(waypoint_of(kind, latitude_deg, 5.0) for latitude_deg, kind in PLACES)


def asking(p_mine: float) -> Contact:
    return drawn_looks.contact(p_mine=p_mine, aspects_deg=(0.0,), next_look_deg=(90.0,))


class AtSea:
    """A link whose vehicle lies at a place, and the requests that it makes."""

    def __init__(self, so_far: LooksSoFar | None = None, config: VehicleConfig = FENCED) -> None:
        self.clock, self.vehicle, self.asked = ManualClock(1.7e9), Vehicle(), list[PlanRequest]()
        self.link = VehicleLink(Config(vehicle=config), self.vehicle, self.clock)
        self.link.go_on(7, int(so_far is not None), {}, so_far or LooksSoFar())
        self.link.report([asking(0.5)])

    def tick(self, seconds: float, latitude_deg: float = 43.0, **changes: Any) -> Sequence[Notice]:
        notices = []
        for _ in range(round(2.0 * seconds)):
            self.clock.advance_to(self.clock.utc_s() + 0.5)
            place: dict[str, Any] = {"latitude_deg": latitude_deg, "longitude_deg": 5.0, "heading_rad": 0.0}
            self.link.see(NavSample(time_s=self.clock.utc_s(), **place, **changes))
            notices += self.link.attend([], self.ask)
        return notices

    def ask(self, request: PlanRequest) -> bool:
        self.asked.append(request)
        return True

    def plans(self) -> list[object]:
        return [what for word, what in self.vehicle.reports if word == "plan"]


def test_a_leg_that_outlasts_its_plan_is_proposed_again_while_it_is_flown() -> None:
    sea = AtSea()
    sea.tick(1.0)
    sea.link.take(Proposal(PLAN, ()))
    sea.vehicle.authority = "granted"
    sea.tick(0.6 * FENCED.plan_valid_s, 43.0004)
    assert sea.plans() == [PLAN, PLAN]


def test_what_is_planned_after_the_end_is_not_proposed_and_nothing_more_is_requested() -> None:
    sea = AtSea()
    sea.tick(1.0)
    (request,) = sea.asked
    assert request[:3] == (43.0, 5.0, 0.0)
    sea.link.release("the mission ends")
    sea.link.take(Proposal(PLAN, ()))
    sea.tick(120.0)
    assert (sea.plans(), len(sea.asked)) == ([], 1)
    assert sea.vehicle.reports[-1] == ("fault", "the mission ends")


@pytest.mark.parametrize("changes", [{"latitude_deg": NAN}, {"position_leaps": True}])
def test_nothing_is_requested_from_a_place_that_is_not_known_any_more(changes: dict[str, Any]) -> None:
    sea = AtSea()
    sea.tick(1.0)
    sea.link.take(Proposal((), ()))
    sea.link.report([asking(0.6)])
    sea.tick(120.0, **changes)
    assert (len(sea.asked), sea.vehicle.reports[-1]) == (1, ("fault", "there is no position"))
    sea.tick(10.0)
    assert (len(sea.asked), sea.vehicle.reports[-1]) == (2, ("normal", ""))


@pytest.mark.parametrize(
    ("config", "authority"),
    [(VehicleConfig(), "listening"), (VehicleConfig(fence_deg=FENCED.fence_deg), "listening"), (FENCED, "down")],
)
def test_nothing_is_requested_unless_it_is_wanted_and_the_vehicle_within_reach(
    config: VehicleConfig, authority: str
) -> None:
    sea = AtSea(config=config)
    sea.vehicle.authority = authority
    sea.tick(60.0)
    assert sea.asked == []


def test_after_a_restart_the_track_that_was_sailed_counts() -> None:
    sea = AtSea(LooksSoFar(sailed_m=250.0))
    sea.tick(1.0)
    assert [request.sailed_m for request in sea.asked] == [250.0]


def test_notices_of_the_vehicle_and_of_planning_are_passed_on() -> None:
    sea = AtSea()
    sea.tick(1.0)
    sea.vehicle.take_notices = lambda: [Notice(code="vehicle_refused", text="")]  # type: ignore[method-assign]
    sea.link.take(Proposal((), (("C00001", "report it"),)))
    assert [notice.code for notice in sea.tick(0.5)] == ["vehicle_refused", "look_refused"]
