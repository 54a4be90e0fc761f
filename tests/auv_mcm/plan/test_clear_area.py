"""Clearing an area: legs until the required clearance is reached, or reported not reachable; never outside fence and
budget."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from itertools import pairwise

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from auv_mcm.clearance.clearance_map import ClearanceMap, clearance_over, unsearched
from auv_mcm.clearance.detection_performance import CellView
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.plan.clear_area import MAX_VAIN_PASSES, ClearArea, floor_ahead
from auv_mcm.plan.look_again import LookAgain, PlanRequest, Proposal, Run
from auv_mcm.records import SEABED_TYPES, SIDES, Contact, CoveragePatch, EchoTrace, Ping, Side, SurveyedCells, Waypoint
from auv_mcm.settings.config import Config
from auv_mcm.settings.plan_settings import PlanConfig
from auv_mcm.settings.vehicle_settings import VehicleConfig
from tests.auv_mcm.plan.test_propose import clearance_m, contact
from tests.make.looks import EvenLook
from tests.make.records import cells_of, patch_of

AREA = ((0.0, 0.0), (0.0, 60.0), (80.0, 60.0), (80.0, 0.0))
FENCE = ((-70.0, -70.0), (-70.0, 130.0), (150.0, 130.0), (150.0, -70.0))
SIGHT_M = 24.0
STEPS = 6  # of the planner's search
STEP_M = 3.0
Corners = tuple[tuple[float, float], ...]


class Mission:
    """A vehicle that follows requests at once, and a sonar that shows a leg some time after its end, or never."""

    steps, sight_m = STEPS, SIGHT_M

    def __init__(
        self,
        *,
        model: EvenLook | None = None,
        area: Corners = AREA,
        fence: Corners = FENCE,
        required: float = 0.8,
        max_track_m: float = 5000.0,
        longitude_deg: float = 5.0,
        is_blind: bool = False,
        command: bool = True,
        shown_after_s: float = 40.0,
        utc_s: Callable[[float], float] = lambda now_s: now_s,
    ) -> None:
        self.frame = LocalFrame(latitude_deg=43.0, longitude_deg=longitude_deg)
        self.fence, self.max_track_m = fence, max_track_m
        self.config = Config(
            plan=PlanConfig(area_deg=self.globe(area), required_clearance=required, max_track_m=max_track_m),
            vehicle=VehicleConfig(command=command, fence_deg=self.globe(fence)),
        )
        self.model = model or EvenLook(same=0.7)
        self.is_blind, self.shown_after_s, self.utc_s = is_blind, shown_after_s, utc_s
        self.planner = ClearArea(self.config, self.model)
        self.searched = ClearanceMap(self.model, self.config.plan.area_deg)
        self.look_again = LookAgain(self.config)
        self.contacts: tuple[Contact, ...] = ()
        self.now_s, self.place_m, self.heading_rad = 1000.0, (-20.0, -20.0), 0.0
        self.way_m = 0.0
        self.coming: list[tuple[float, CoveragePatch]] = []
        self.flown: list[tuple[Waypoint, Waypoint]] = []
        self.proposals: list[Proposal] = []

    def globe(self, corners_m: Corners) -> Corners:
        return tuple(self.geodetic(corner) for corner in corners_m)

    def geodetic(self, place_m: tuple[float, float]) -> tuple[float, float]:
        latitude_deg, longitude_deg, _ = self.frame.to_geodetic([*place_m, 0.0])
        return float(latitude_deg), float(longitude_deg)

    def place_of(self, point: Waypoint) -> tuple[float, float]:
        east_m, north_m, _ = self.frame.to_enu(point.latitude_deg, point.longitude_deg, 0.0).tolist()
        return east_m, north_m

    @property
    def codes(self) -> list[str]:
        return [notice.code for notice in self.look_again.take_notices()]

    def ping(self) -> None:
        trace = EchoTrace(
            samples=np.zeros(100, dtype=np.uint8), first_range_m=0.0, spacing_m=math.hypot(self.sight_m, 5.0) / 100.0
        )
        self.planner.see(Ping(number=1, time_s=self.utc_s(self.now_s), port=trace, starboard=trace))

    def plan(self) -> bool:
        """Whether there is a new one. The clock goes on by as much as a vehicle waits."""
        for _, patch in (reported := [due for due in self.coming if due[0] <= self.now_s]):
            self.searched.add(patch)
            self.planner.add(patch)
        self.coming = [due for due in self.coming if due not in reported]
        pose = *self.geodetic(self.place_m), self.heading_rad
        request = self.look_again.request(pose, self.utc_s(self.now_s), self.now_s)
        if request is None:
            return False
        self.proposals.append(self.propose(request))
        return self.look_again.take(self.proposals[-1], self.now_s) is not None

    def propose(self, request: PlanRequest) -> Proposal:
        left = iter(range(self.steps))
        return self.planner.propose(
            self.searched.snapshot(), self.contacts, request, lambda: next(left, None) is not None
        )

    def run(self, max_s: float = 20_000.0) -> str:
        """Until there is a verdict and nothing more to fly. Returns it."""
        steps: Iterator[tuple[float, float]] = iter(())
        while self.now_s < max_s:
            self.ping()
            if self.plan():
                steps = self._way()
            place_m = next(steps, None)
            self.now_s += 2.0
            state = self.look_again.area
            if place_m is None and state is not None and state.verdict:
                return state.verdict
            self._go(place_m)
        raise AssertionError("no end")

    def _go(self, place_m: tuple[float, float] | None) -> None:
        if place_m is not None and place_m != self.place_m:
            step = place_m[0] - self.place_m[0], place_m[1] - self.place_m[1]
            self.way_m += math.hypot(*step)
            self.heading_rad, self.place_m = math.atan2(*step), place_m
        self.look_again.move(*self.geodetic(self.place_m), place_m is not None, self.now_s)

    def _way(self) -> Iterator[tuple[float, float]]:
        """Along the plan in small steps; what is seen on a leg comes later."""
        plan = self.look_again.plan
        for before, point in pairwise(plan):
            a, b = (np.array(self.place_of(end)) for end in (before, point))
            began_s = self.now_s
            n = max(1, math.ceil(float(np.hypot(*(b - a))) / STEP_M))
            for k in range(1, n + 1):
                yield tuple((a + (b - a) * k / n).tolist())
                if point.kind == "leg_exit" and k == max(n - 3, 1):  # it may be called away from its very end
                    self.flown.append((before, point))
                    self._see(a, b, began_s)

    def _see(self, entry: NDArray[np.float64], leave: NDArray[np.float64], began_s: float) -> None:
        course = math.atan2(*(leave - entry))
        for side, sense in (("port", -1.0), ("starboard", 1.0)):
            cells = None if self.is_blind else self._cells(entry, leave, course, sense)
            patch = drawn_patch(side, self.utc_s(began_s), self.utc_s(self.now_s) + 10.0, cells)  # type: ignore[arg-type]  # a side by its name
            self.coming.append((self.now_s + self.shown_after_s, patch))

    def _cells(
        self, entry: NDArray[np.float64], leave: NDArray[np.float64], course: float, sense: float
    ) -> SurveyedCells | None:
        """Cell by cell, those that lie abeam."""
        seen = {}
        for east in range(-40, 60):
            for north in range(-40, 60):
                off_east, off_north = 4.0 * east + 2.0 - entry[0], 4.0 * north + 2.0 - entry[1]
                ahead = off_east * math.sin(course) + off_north * math.cos(course)
                beside = sense * (off_east * math.cos(course) - off_north * math.sin(course))
                if 10.0 <= ahead <= math.hypot(*(leave - entry)) - 10.0 and 2.0 <= beside <= self.sight_m:
                    seen[east, north] = beside
        if not seen:
            return None
        return cells_of(
            dict.fromkeys(seen, 1.0),
            origin_latitude_deg=self.frame.latitude_deg,
            origin_longitude_deg=self.frame.longitude_deg,
            ground_range_m=list(seen.values()),
            altitude_m=5.0,
            look_rad=(course + sense * math.pi / 2.0) % (2.0 * math.pi),
            seabed=SEABED_TYPES.index("flat"),
            confidence=0.9,
        )

    def assert_kept_to_limits(self) -> None:
        assert self.way_m <= self.max_track_m + 2.0 * STEP_M
        for proposal in self.proposals:
            assert_inside(self, proposal)


class _EasyFlat(EvenLook):
    def p_look(self, view: CellView) -> NDArray[np.float64]:
        return np.where(view.seabed == SEABED_TYPES.index("flat"), 0.9, 0.3)


def drawn_patch(side: Side, start_s: float, stop_s: float, cells: SurveyedCells | None) -> CoveragePatch:
    return patch_of(side=side, start_s=start_s, stop_s=stop_s, cells=cells)


def assert_inside(mission: Mission, proposal: Proposal) -> None:
    places = [np.array(mission.place_of(point)) for point in proposal.waypoints]
    for a, b in pairwise(places[1:]):
        for share in (0.0, 0.3, 0.7, 1.0):
            assert clearance_m(a + share * (b - a), mission.fence) >= 8.0 - 0.1


def test_legs_are_flown_until_the_clearance_is_reached_and_then_none() -> None:
    mission = Mission()
    verdict = mission.run()
    assert re.match("done: mines in the 4.800 m² are found with probability 0[.][89]", verdict)
    assert 2 <= len(mission.flown) <= 8
    assert mission.look_again.plan == ()
    assert mission.codes == ["survey_done"]
    assert {entry.contact_id for entry, _ in mission.flown} == {""}
    mission.assert_kept_to_limits()
    assert not mission.plan()


def test_a_leg_that_is_not_reported_yet_is_not_flown_twice() -> None:
    slow, quick = Mission(shown_after_s=100.0), Mission(shown_after_s=5.0)
    assert all(mission.run().startswith("done") for mission in (slow, quick))
    assert len(slow.flown) <= len(quick.flown)


def test_a_leg_whose_plan_was_lost_with_its_process_is_reported_again_and_counts_once() -> None:
    mission = Mission(shown_after_s=1000.0)
    mission.ping()
    mission.plan()
    steps = mission._way()
    while not (flown := mission.look_again.so_far().flown):
        mission._go(next(steps))
        mission.now_s += 2.0
    request = mission.look_again.request((*mission.geodetic(mission.place_m), 0.0), mission.now_s, mission.now_s)
    assert request is not None
    assert request.flown == flown == mission.look_again.so_far().flown
    assert mission.propose(request) == mission.propose(request)
    while len(both := mission.look_again.so_far().flown) < 2:  # flown while the plan is made
        mission._go(next(steps))
        mission.now_s += 2.0
    mission.look_again.take(mission.propose(request), mission.now_s)
    assert mission.look_again.so_far().flown == both[1:]


@pytest.mark.parametrize(("p", "is_enough"), [(0.75, False), (0.85, True)])
def test_a_leg_that_is_not_shown_yet_counts_for_what_one_view_clears(p: float, is_enough: bool) -> None:
    """A mean of 0.8 is required of a strip that all lies in the swath of the leg, on one side."""
    mission = Mission(model=EvenLook(p), area=((0.0, 8.0), (0.0, 20.0), (60.0, 20.0), (60.0, 8.0)))
    mission.ping()
    leg = mission.geodetic((-50.0, 0.0)), mission.geodetic((110.0, 0.0))
    request = PlanRequest(*mission.geodetic((110.0, 0.0)), 1.57, frozenset(), 160.0, (leg,), mission.now_s)
    for side, stop_s in (("port", mission.now_s - 200.0), ("starboard", mission.now_s)):  # the strip lies to port
        mission.planner.add(drawn_patch(side, stop_s - 10.0, stop_s, None))  # type: ignore[arg-type]  # a side by its name
    proposal = mission.propose(request)
    assert (proposal.waypoints == ()) is is_enough
    assert proposal.area is not None
    assert proposal.area.verdict == ""  # until the leg is shown


@pytest.mark.parametrize("wrong_by_s", [-1e6, 1e6])
def test_one_ping_of_a_wrong_time_has_no_leg_flown_again(wrong_by_s: float) -> None:
    mission = Mission(model=EvenLook(0.85), area=((0.0, 8.0), (0.0, 20.0), (60.0, 20.0), (60.0, 8.0)))
    mission.ping()
    leg = mission.geodetic((-50.0, 0.0)), mission.geodetic((110.0, 0.0))
    request = PlanRequest(*mission.geodetic((110.0, 0.0)), 1.57, frozenset(), 160.0, (leg,), mission.now_s)
    assert mission.propose(request).waypoints == ()
    for at_s in (1002.0, 1004.0 + wrong_by_s, 1004.0 + wrong_by_s, 1006.0):  # both sides bear it, each in a message
        mission.now_s = at_s
        mission.ping()
        assert mission.propose(request._replace(flown=())).waypoints == ()


def test_what_a_leg_has_shown_is_not_expected_once_more() -> None:
    """One view finds 0.75 of what is required to be 0.8: half of the leg shown already leaves it so."""
    mission = Mission(model=EvenLook(0.75), area=((0.0, 8.0), (0.0, 20.0), (60.0, 20.0), (60.0, 8.0)))
    mission.ping()
    ends_m = np.array([[-50.0, 0.0], [110.0, 0.0]])
    middle_s = mission.now_s - 80.0 / mission.config.vehicle.speed_mps
    for side, sense in (("port", -1.0), ("starboard", 1.0)):
        cells = mission._cells(ends_m[0], np.array([40.0, 0.0]), 0.5 * math.pi, sense)  # to the middle, and 10 m more
        patch = drawn_patch(side, middle_s - 60.0, middle_s, cells)  # type: ignore[arg-type]  # a side by its name
        mission.searched.add(patch)
        mission.planner.add(patch)
    leg = tuple(mission.geodetic(tuple(end)) for end in ends_m.tolist())
    request = PlanRequest(*mission.geodetic((110.0, 0.0)), 1.57, frozenset(), 160.0, (leg,), mission.now_s)  # type: ignore[arg-type]  # two ends
    assert mission.propose(request).waypoints


def test_a_leg_that_is_shown_while_it_is_sailed_is_not_in_vain() -> None:
    mission = Mission(model=EvenLook(0.3, same=0.2), shown_after_s=0.0)
    assert mission.run().startswith("done")


def test_a_clock_that_is_set_back_gives_up_nothing_that_legs_show() -> None:
    mission = Mission(model=EvenLook(0.3, same=0.2), utc_s=lambda now_s: now_s if now_s < 1300.0 else now_s - 3600.0)
    assert mission.run().startswith("done")


def runs(waypoints: tuple[Waypoint, ...]) -> list[Run]:
    return [
        ((entry.latitude_deg, entry.longitude_deg), (leave.latitude_deg, leave.longitude_deg))
        for entry, leave in pairwise(waypoints)
        if leave.kind == "leg_exit"
    ]


def test_what_comes_of_a_clock_that_was_set_back_shows_no_later_leg() -> None:
    def planned(before_s: tuple[float, ...]) -> list[Run]:
        mission = Mission()
        mission.ping()
        mission.plan()
        flown, *_ = runs(mission.look_again.plan)
        mission.now_s = 100.0
        mission.ping()  # the segment ends, and its last tile comes
        for stop_s in before_s:
            for side in SIDES:
                mission.planner.add(drawn_patch(side, stop_s - 10.0, stop_s, None))
        mission.now_s += 30.0
        mission.ping()
        request = PlanRequest(*flown[1], 0.0, frozenset(), flown=(flown,), time_s=mission.now_s)
        return runs(mission.propose(request).waypoints)

    assert planned((1000.0,)) == planned(())


def test_where_no_mine_can_be_found_the_plan_states_at_once_that_the_area_cannot_be_cleared() -> None:
    mission = Mission(model=EvenLook(0.0))
    assert mission.run().startswith("cannot, because")
    assert not mission.flown
    assert mission.codes == ["survey_cannot"]


def test_what_passes_show_nothing_of_is_given_up() -> None:
    mission = Mission(is_blind=True)
    verdict = mission.run()
    assert verdict.startswith("cannot, because no leg adds to it any more")
    assert f"passed {MAX_VAIN_PASSES} times in vain and given up" in verdict
    assert len(mission.flown) < 30


def test_control_ends_with_the_track_that_may_be_commanded() -> None:
    mission = Mission(max_track_m=300.0, required=0.95)
    assert mission.run().startswith("cannot, because")
    mission.assert_kept_to_limits()
    assert mission.flown


def test_across_the_antimeridian_it_is_the_same_survey() -> None:
    mission = Mission(longitude_deg=179.9997)
    assert mission.run().startswith("done")
    assert {math.copysign(1.0, entry.longitude_deg) for entry, _ in mission.flown} == {1.0, -1.0}
    mission.assert_kept_to_limits()


def test_an_area_is_cleared_behind_a_long_way_that_the_sonar_saw_too() -> None:
    """Twelve kilometres aslant span a larger map than is laid out, and hold more cells than the area."""
    mission = Mission()
    way = {(beside - step, -step): 1.0 for step in range(60, 3060) for beside in range(8)}
    mission.searched.add(patch_of(side="port", start_s=0.0, stop_s=900.0, cells=cells_of(way)))
    assert mission.run().startswith("done")


def test_an_area_that_no_leg_inside_the_fence_sees_cannot_be_cleared() -> None:
    far = tuple((east + 120.0, north + 160.0) for east, north in AREA)
    corner = (
        (-70.0, -70.0),
        (-70.0, 260.0),
        (-40.0, 260.0),
        (-40.0, -40.0),
        (260.0, -40.0),
        (260.0, -70.0),
    )  # an L around it
    mission = Mission(area=far, fence=corner)
    mission.place_m = (-55.0, 0.0)
    assert "inside the fence" in mission.run() or "fits into the fence" in mission.look_again.area.verdict  # type: ignore[union-attr]  # there is an area


def test_without_command_only_the_state_of_the_search_is_reported() -> None:
    mission = Mission(command=False)
    mission.ping()
    mission.plan()
    assert mission.proposals[-1].waypoints == ()
    state = mission.look_again.area
    assert state is not None
    assert (state.p_detected, state.verdict, state.words()) == (0.0, "", "clearance 0.00 of 0.80")
    assert state.km2 == pytest.approx(0.0048, rel=0.1)


def test_before_the_sonar_sounds_nothing_is_planned() -> None:
    mission = Mission()
    assert not mission.plan()
    assert mission.look_again.area is not None
    assert mission.look_again.area.verdict == "not yet, because no ping has shown how far the sonar reaches"
    mission.ping()
    mission.now_s += 60.0
    assert mission.plan()


def test_a_reason_to_wait_does_not_hide_a_later_one() -> None:
    mission = Mission()
    assert not mission.plan()
    mission.place_m = (-200.0, 0.0)
    mission.ping()
    for _ in range(3):
        mission.now_s += 60.0
        assert not mission.plan()
    notices = mission.look_again.take_notices()
    assert [notice.code for notice in notices] == ["survey_waits"] * 2
    assert "no ping has shown" in notices[0].text
    assert "the vehicle is outside its fence" in notices[1].text


def test_a_clearance_that_is_reached_is_stated_beside_what_was_required() -> None:
    found, required = re.findall(r"\d\.\d+", Mission(required=0.954).run())
    assert required == "0.954"
    assert float(found) >= 0.954


@pytest.mark.parametrize("sounds", [False, True])
def test_a_vehicle_that_searches_outside_its_fence_is_reported_and_one_on_deck_beside_it_is_not(sounds: bool) -> None:
    mission = Mission()
    mission.place_m = (-200.0, 0.0)
    for _ in range(20):
        if sounds:
            mission.ping()
        mission.now_s += 60.0
        assert not mission.plan()
    assert mission.codes == ["survey_waits", "vehicle_outside_fence"][: 1 + sounds]


@given(seed=st.integers(0, 10_000), shape=st.tuples(st.integers(1, 12), st.integers(1, 12)))
@settings(deadline=None)
def test_floor_not_seen_is_expected_to_be_like_the_nearest_seen(seed: int, shape: tuple[int, int]) -> None:
    random = np.random.default_rng(seed)
    looks = (random.random(shape) < 0.2).astype(np.uint8)
    seabed = random.integers(0, len(SEABED_TYPES), shape).astype(np.uint8)
    ripple_rad, unevenness_db = random.random((2, *shape)).astype(np.float32)
    ground = msgspec.structs.replace(
        clearance_over(unsearched(43.0, 5.0, 4.0), 0, 0, shape),
        looks=looks,
        seabed=seabed,
        ripple_rad=ripple_rad,
        unevenness_db=unevenness_db,
    )
    ahead = floor_ahead(ground)
    assert (ahead.looks == looks).all()
    assert not ahead.exponent.any()
    places = np.argwhere(looks)
    for at in np.ndindex(shape):
        if not len(places):
            assert SEABED_TYPES[ahead.seabed[at]] == "flat"
            continue
        away = np.hypot(*(places - at).T)
        near = [tuple(place) for place in places[away <= 1.05 * away.min() + 1e-9]]
        expected = [(seabed[one], ripple_rad[one], unevenness_db[one]) for one in near]
        assert (ahead.seabed[at], ahead.ripple_rad[at], ahead.unevenness_db[at]) in expected


def test_on_floor_easier_than_the_worst_an_area_takes_no_more_legs_than_it_needs() -> None:
    """A view of flat floor finds 0.9, one of any other 0.3."""
    strip = ((0.0, 0.0), (0.0, 44.0), (60.0, 44.0), (60.0, 0.0))
    mission = Mission(model=_EasyFlat(), area=strip, shown_after_s=100.0)
    assert mission.run().startswith("done")
    assert len(mission.flown) == 1


def test_a_contact_is_looked_at_on_the_way_and_after_the_area_is_clear() -> None:
    mission = Mission()
    mission.run()
    mission.contacts = (contact(1, 40.0, 30.0),)
    mission.look_again.learn(mission.contacts[0])
    mission.now_s += 60.0
    assert mission.plan()
    assert {point.contact_id for point in mission.look_again.plan} == {"C00001"}
    assert mission.look_again.area is not None
    assert mission.look_again.area.is_reached


@given(
    place=st.tuples(st.floats(-60.0, 140.0), st.floats(-60.0, 120.0)),
    heading_rad=st.floats(0.0, 6.28),
    left_m=st.floats(-10.0, 800.0),
    fence=st.sampled_from([FENCE, ((-70.0, -70.0), (-70.0, 130.0), (40.0, 20.0), (150.0, 130.0), (150.0, -70.0))]),
    with_contact=st.booleans(),
)
@settings(deadline=None, max_examples=10)
def test_no_plan_leads_out_of_the_fence_or_beyond_the_track_left(
    place: tuple[float, float], heading_rad: float, left_m: float, fence: Corners, with_contact: bool
) -> None:
    mission = Mission(fence=fence)
    mission.ping()
    if with_contact:
        mission.contacts = (contact(1, 20.0, 10.0),)
    request = PlanRequest(*mission.geodetic(place), heading_rad, frozenset(), mission.max_track_m - left_m)
    proposal = mission.propose(request)
    assert_inside(mission, proposal)
    for start in proposal.waypoints[:1]:
        assert math.remainder(start.heading_rad - heading_rad, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-4)
    places = np.array([mission.place_of(point) for point in proposal.waypoints]).reshape(-1, 2)
    assert np.hypot(*np.diff(places, axis=0).T).sum() <= max(left_m, 0.0) + 0.1
    assert proposal.area is not None
    assert bool(proposal.waypoints) or proposal.area.verdict.startswith(("cannot, because", "not yet, because"))
