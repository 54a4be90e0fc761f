"""Plans proposed to a vehicle: no way leads out of the fence, whatever the contacts, and what is left out is reported
with its reason."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.plan.look_again import PlanRequest, Proposal
from auv_mcm.plan.propose import propose
from auv_mcm.plan.reinspect import plan_reinspection
from auv_mcm.records import Contact, Waypoint
from auv_mcm.settings.plan_settings import PlanConfig
from auv_mcm.settings.vehicle_settings import VehicleConfig
from tests.auv_mcm.classify import drawn_looks

FRAME = LocalFrame(latitude_deg=43.0, longitude_deg=5.0)
PLAN = PlanConfig()
SQUARE = ((-200.0, -200.0), (-200.0, 200.0), (200.0, 200.0), (200.0, -200.0))
NOTCHED = ((-200.0, -200.0), (-200.0, 200.0), (0.0, 20.0), (200.0, 200.0), (200.0, -200.0))
START = PlanRequest(43.0, 5.0, 0.0, frozenset())


def geodetic(east_m: float, north_m: float) -> tuple[float, float]:
    latitude_deg, longitude_deg, _ = FRAME.to_geodetic([east_m, north_m, 0.0])
    return float(latitude_deg), float(longitude_deg)


def fenced(corners_m: tuple[tuple[float, float], ...], margin_m: float = 5.0) -> VehicleConfig:
    return VehicleConfig(
        command=True, fence_deg=tuple(geodetic(*corner) for corner in corners_m), fence_margin_m=margin_m
    )


def contact(number: int, east_m: float, north_m: float, look_deg: float = 90.0) -> Contact:
    latitude_deg, longitude_deg = geodetic(east_m, north_m)
    return drawn_looks.contact(
        id=f"C{number:05d}",
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        p_mine=0.6,
        aspects_deg=(0.0,),
        next_look_deg=(look_deg,),
    )


def places_m(proposal: Proposal) -> NDArray[np.float64]:
    return np.array(
        [FRAME.to_enu(point.latitude_deg, point.longitude_deg, 0.0)[:2] for point in proposal.waypoints]
    ).reshape(-1, 2)


def test_without_a_fence_in_the_way_it_is_the_plan_of_the_mission() -> None:
    contacts = [contact(1, 50.0, 50.0), contact(2, -60.0, 20.0)]
    proposal = propose(contacts, START, PLAN, fenced(SQUARE))
    assert proposal == Proposal(plan_reinspection(contacts, 43.0, 5.0, 0.0, PLAN), ())


def test_a_leg_that_leads_out_is_left_out_with_its_reason_and_the_others_stay() -> None:
    proposal = propose([contact(1, 50.0, 50.0), contact(2, 195.0, 195.0)], START, PLAN, fenced(SQUARE))
    assert {point.contact_id for point in proposal.waypoints} == {"C00001"}
    ((contact_id, reason),) = proposal.refused
    assert contact_id == "C00002"
    assert "its leg comes within 8 m of the fence or leads out of it" in reason


@pytest.mark.parametrize("east_m", [-185.0, 185.0])
def test_a_contact_near_the_fence_is_passed_on_its_inner_side(east_m: float) -> None:
    proposal = propose([contact(1, east_m, 50.0, look_deg=90.0)], START, PLAN, fenced(SQUARE))
    assert not proposal.refused
    assert {point.contact_id for point in proposal.waypoints} == {"C00001"}


def test_a_plan_without_time_is_ordered_a_few_times_only_and_stays_inside(monkeypatch: pytest.MonkeyPatch) -> None:
    orders: list[int] = []

    def ordered(contacts: list[Contact], *rest: Any) -> tuple[Waypoint, ...]:
        orders.append(len(contacts))
        return plan_reinspection(contacts, *rest)

    monkeypatch.setattr("auv_mcm.plan.propose.plan_reinspection", ordered)
    random = np.random.default_rng(1)
    places = random.uniform((-48.0, -290.0, 0.0), (48.0, 290.0, 180.0), (12, 3)).tolist()
    contacts = [contact(number, *place) for number, place in enumerate(places, 1)]
    strip = fenced(((-60.0, -300.0), (-60.0, 300.0), (60.0, 300.0), (60.0, -300.0)))
    proposal = propose(contacts, START, PLAN, strip, lambda: False)
    n_hurried = len(orders)
    assert places_m(proposal)[1:].size
    assert (np.abs(places_m(proposal)[1:]) <= (60.0 - strip.fence_margin_m, 300.0 - strip.fence_margin_m)).all()
    patient = propose(contacts, START, PLAN, strip)
    assert n_hurried <= 2 < len(orders) - n_hurried
    assert len(patient.waypoints) >= len(proposal.waypoints)


def test_what_is_not_to_be_looked_at_is_not_in_the_plan() -> None:
    proposal = propose([contact(1, 50.0, 50.0)], START._replace(left_out=frozenset({"C00001"})), PLAN, fenced(SQUARE))
    assert proposal == Proposal((), ())


def test_no_contacts_no_plan() -> None:
    assert propose([], START, PLAN, fenced(SQUARE)) == Proposal((), ())


@given(
    looks=st.lists(st.tuples(st.floats(-250.0, 250.0), st.floats(-250.0, 250.0), st.floats(0.0, 180.0)), max_size=4),
    corners=st.sampled_from([SQUARE, NOTCHED]),
    heading_rad=st.floats(0.0, 6.28),
)
@settings(deadline=None, max_examples=20)
def test_no_way_comes_nearer_to_the_fence_than_its_margin(
    looks: list[tuple[float, float, float]], corners: tuple[tuple[float, float], ...], heading_rad: float
) -> None:
    contacts = [contact(number, *look) for number, look in enumerate(looks)]
    proposal = propose(contacts, START._replace(heading_rad=heading_rad), PLAN, fenced(corners))
    planned = {point.contact_id for point in proposal.waypoints}
    assert planned | {contact_id for contact_id, _ in proposal.refused} == {contact.id for contact in contacts}
    assert planned.isdisjoint(contact_id for contact_id, _ in proposal.refused)
    for a, b in zip(places_m(proposal)[1:-1], places_m(proposal)[2:], strict=True):
        for share in np.linspace(0.0, 1.0, 7):
            assert clearance_m(a + share * (b - a), corners) >= 8.0 - 0.1


def clearance_m(place_m: NDArray[np.float64], corners_m: tuple[tuple[float, float], ...]) -> float:
    """The slow way: winding number for inside, and the fence walked in small steps."""
    corners = np.array([*corners_m, corners_m[0]]) - place_m
    turns = np.diff(np.unwrap(np.arctan2(corners[:, 1], corners[:, 0])))
    walk = np.concatenate([np.linspace(a, b, 401) for a, b in pairwise(corners)])
    return float(np.hypot(*walk.T).min()) * (1.0 if abs(turns.sum()) > math.pi else -1.0)


@pytest.mark.parametrize(("track_m", "n_legs"), [(1000.0, 2), (200.0, 1), (10.0, 0)])
def test_a_plan_ends_where_the_track_that_is_left_does(track_m: float, n_legs: int) -> None:
    contacts = [contact(1, 40.0, 40.0), contact(2, -60.0, -60.0)]
    whole = propose(contacts, START, PLAN, fenced(SQUARE))
    short = propose(contacts, START._replace(sailed_m=PLAN.max_track_m - track_m), PLAN, fenced(SQUARE))
    assert short.waypoints == whole.waypoints[: len(short.waypoints)]
    assert sum(point.kind == "leg_exit" for point in short.waypoints) == n_legs
    assert np.hypot(*np.diff(places_m(short), axis=0).T).sum() <= track_m
