"""Decide when to plan and which plan to request.

A plan is made at once where there is something to view again, is left unchanged while a leg is run, and is not
requested for ever. A contact is given up after two legs past it that gave no new view of it, and after four legs in
all. A plan under way is not changed while the vehicle runs along a leg, nor as long as the legs in it stay the same.
Where there is an area to clear, plans are also made anew when a leg of its survey ends, and from time to time. No plan
is requested beyond the track that may be commanded in all.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Final, NamedTuple, TypeAlias

import numpy as np

from auv_mcm.clearance.area import AreaState, in_plane
from auv_mcm.geometry.fence import circles_inside
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.plan.reinspect import Place, needs_second_look
from auv_mcm.records import NAN, Contact, Notice, Waypoint
from auv_mcm.settings.config import Config
from auv_mcm.settings.plan_settings import about_first

MAX_VAIN_LOOKS: Final = 2  # legs that brought no view, after which a contact is given up
MAX_LOOKS: Final = 4  # legs flown for one contact: bounds what one contact may cost
WAIT_FOR_VIEW_S: Final = 120.0  # from the end of a leg until its tile is complete
_EVERY_S: Final = 5.0  # s between two requests, minimum
_REFRESH_S: Final = 30.0  # a plan that waits for a grant begins where the vehicle was, and one refused may now fit
LEAVES_LEG_M: Final = 5.0  # and the radius of arrival: so far before its end a leg counts as flown
_BESIDE_M: Final = 5.0  # between a leg as planned and as flown
_RUN_ALONG: Final = 1.0 / 3.0  # of a leg, minimum for it to count as flown: less is crossing it; chosen
_SURVEY_S: Final = 10.0  # between updates on the search of an area, while no leg is flown
_SURVEY_AGAIN_S: Final = 60.0  # and while a leg is flown, or none can be
_STEP_M: Final = 5.0  # in which track is measured, so that the noise of positions does not add up
_FAR_M: Final = 5_000.0  # m; chosen: far for a way to the area, near for minutes taken for decimals of a degree
_OUTSIDE_S: Final = 300.0  # s outside the fence and no nearer to it, until a person is asked; chosen: longer than turns
_NEARER_M: Final = 50.0  # m; chosen: a vehicle on its way to the fence covers more in that time
_JUMP_M: Final = 100.0  # farther apart, two positions are not joined to a track
_SAME_M: Final = 1.0  # m: ends of legs nearer than that are the same request
_CODES: Final = {"done": "survey_done", "cannot": "survey_cannot", "not yet": "survey_waits"}

Run: TypeAlias = tuple[Place, Place]
"""A leg from entry to exit."""


class PlanRequest(NamedTuple):
    """State where a plan begins, and the contacts (ids) that it leaves out.

    sailed_m: track commanded so far. flown: survey legs since the last request. time_s: of the newest position, in
    mission time; perception may be behind it.
    """

    latitude_deg: float
    longitude_deg: float
    heading_rad: float
    left_out: frozenset[str]
    sailed_m: float = 0.0
    flown: tuple[Run, ...] = ()
    time_s: float = NAN


class Proposal(NamedTuple):
    """Hold a plan, and the contacts that are not in it with reasons.

    area: how the search of the area stands, if there is one.
    """

    waypoints: tuple[Waypoint, ...]
    refused: tuple[tuple[str, str], ...]
    area: AreaState | None = None


class _OnLeg(NamedTuple):
    """Measure how far along a leg a place is, and how far beside it."""

    along_m: float
    beside_m: float

    def is_near(self, length_m: float, end_m: float, beside_m: float) -> bool:
        return self.beside_m <= beside_m and -end_m <= self.along_m <= length_m + end_m


class _Leg(NamedTuple):
    """Hold a straight run, past a contact or ("") of a survey, in metres from its entry. along: unit vector."""

    contact_id: str
    ends_deg: Run
    frame: LocalFrame
    along: tuple[float, float]
    length_m: float

    def place(self, latitude_deg: float, longitude_deg: float) -> _OnLeg:
        east_m, north_m, _ = self.frame.to_enu(latitude_deg, longitude_deg, 0.0).tolist()
        east, north = self.along
        return _OnLeg(east_m * east + north_m * north, abs(east_m * north - north_m * east))


class _Looks:
    """Count what was tried for one contact."""

    def __init__(self) -> None:
        self.n_views = 0
        self.n_flown = 0
        self.n_vain = 0  # since the last new view
        self.flown_s = -math.inf

    def is_left_out(self, now_s: float) -> bool:
        return self.is_given_up or (self.n_vain > 0 and now_s - self.flown_s < WAIT_FOR_VIEW_S)

    @property
    def is_given_up(self) -> bool:
        return self.n_vain >= MAX_VAIN_LOOKS or self.n_flown >= MAX_LOOKS


class LooksSoFar(NamedTuple):
    """Hold what a plan after a restart has to know of those before.

    looks: by contact, its views, the legs flown for it, and those since its last new view. raised: what was reported
    once.
    """

    sailed_m: float = 0.0
    looks: tuple[tuple[str, int, int, int], ...] = ()
    flown: tuple[Run, ...] = ()
    raised: tuple[str, ...] = ()


class LookAgain:
    """Decide when plans are made and requested. Times are monotonic seconds.

    `plan` is the last proposal; `area` is how the search of the area stood then, if there is one.
    """

    def __init__(self, config: Config) -> None:
        self.plan: tuple[Waypoint, ...] = ()
        self.area: AreaState | None = None
        self._config = config
        self._clears = bool(config.plan.area_deg)
        self._flown: list[Run] = []  # survey legs that no plan has taken account of
        self._n_requested = 0  # of them, in the request that waits for its plan
        self._sailed_m = 0.0
        self._sailed_from: LocalFrame | None = None
        self._looks: dict[str, _Looks] = {}  # by contact that requested another view, a few of all
        self._legs: list[_Leg] = []  # of the plan, not yet flown
        self._on_leg: _Leg | None = None
        self._along_m = self._began_m = 0.0  # of the leg: so far, and where the vehicle came to it
        self._commanding = False
        self._has_place = False  # the vehicle was seen
        self._begins_here = False  # the plan was made since the payload commands
        self._changed = False
        self._waiting = False  # for a plan
        self._asked_from_deg = NAN, NAN
        self._was_refused = False  # some contact, in the last proposal
        self._outside = math.inf, -math.inf  # m from the middle of the fence, and since when no nearer
        self._requested_s = -math.inf
        self._planned_s = -math.inf
        self._left_out: frozenset[str] = frozenset()
        self._raised: set[str] = set()
        self._notices: list[Notice] = []

    def take_notices(self) -> list[Notice]:
        """Take the notices raised since the last call."""
        notices, self._notices = self._notices, []
        return notices

    def so_far(self) -> LooksSoFar:
        """Give what is to outlast a restart."""
        looks = tuple((name, looks.n_views, looks.n_flown, looks.n_vain) for name, looks in self._looks.items())
        return LooksSoFar(self._sailed_m, looks, tuple(self._flown), tuple(sorted(self._raised)))

    def go_on(self, so_far: LooksSoFar, now_s: float = -math.inf) -> None:
        """Go on after a restart; called first. now_s: what legs before have shown may still come from then on."""
        self._sailed_m, self._flown, self._raised = so_far.sailed_m, list(so_far.flown), set(so_far.raised)
        for name, n_views, n_flown, n_vain in so_far.looks:
            looks = self._looks[name] = _Looks()
            looks.n_views, looks.n_flown, looks.n_vain, looks.flown_s = n_views, n_flown, n_vain, now_s

    def learn(self, contact: Contact) -> None:
        """Take a contact, new or changed."""
        planned = any(leg.contact_id == contact.id for leg in self._legs)
        is_wanted = planned or needs_second_look(contact, self._config.plan.min_p_mine)
        self._changed |= is_wanted
        if is_wanted and contact.id not in self._looks:
            self._looks[contact.id] = _Looks()
        looks = self._looks.get(contact.id)
        if looks is not None and len(contact.views) > looks.n_views:
            looks.n_views, looks.n_vain = len(contact.views), 0

    def move(self, latitude_deg: float, longitude_deg: float, commanding: bool, now_s: float) -> None:
        """Take the vehicle's place, once a second or more often. commanding: the payload has control."""
        if commanding != self._commanding:
            self._leave_leg(now_s)
            self._commanding, self._begins_here = commanding, False
            if commanding:  # the plan begins where the vehicle was before
                self._changed, self._requested_s = True, -math.inf
        if not commanding:
            self._sailed_from = None
            return
        self._sail(latitude_deg, longitude_deg)
        end_m = self._config.vehicle.arrival_radius_m + LEAVES_LEG_M
        beside_m = max(0.5 * self._config.plan.stand_off_m, _BESIDE_M)
        near = {
            leg: place
            for leg in self._legs
            if (place := leg.place(latitude_deg, longitude_deg)).is_near(leg.length_m, end_m, beside_m)
        }
        if self._on_leg not in near:
            self._leave_leg(now_s)
            self._on_leg = next((leg for leg, place in near.items() if place.along_m < 0.5 * leg.length_m), None)
            self._began_m = math.inf
        if self._on_leg is not None:
            self._along_m = near[self._on_leg].along_m
            self._began_m = min(self._began_m, self._along_m)
            if self._along_m >= self._on_leg.length_m - end_m:
                self._leave_leg(now_s)

    def request(self, pose: tuple[float, float, float], time_s: float, now_s: float) -> PlanRequest | None:
        """Request a plan if one is due.

        Parameters
        ----------
        pose
            Latitude, longitude (degrees), heading (radians).
        time_s
            Mission time of the pose.
        """
        self._check_bounds(pose)
        left_out = frozenset(contact_id for contact_id, looks in self._looks.items() if looks.is_left_out(now_s))
        due = (
            self._changed
            or left_out != self._left_out
            or (self._is_old(now_s) if self.plan else self._was_refused and now_s - self._requested_s >= _REFRESH_S)
            or self._is_survey_due(now_s)
        )
        if (
            not due
            or self._waiting
            or self._on_leg is not None
            or now_s - self._requested_s < _EVERY_S
            or not all(map(math.isfinite, pose))
        ):
            return None
        self._changed, self._waiting, self._requested_s, self._left_out = False, True, now_s, left_out
        self._n_requested, self._asked_from_deg = len(self._flown), pose[:2]
        return PlanRequest(*pose, left_out, self._sailed_m, tuple(self._flown), time_s)

    def _check_bounds(self, pose: tuple[float, float, float]) -> None:
        """Report, where the vehicle begins, bounds that are far away: no leg would be requested, in silence."""
        corners_deg = self._config.vehicle.fence_deg or self._config.plan.area_deg
        if self._has_place or not corners_deg or not all(map(math.isfinite, pose[:2])):
            return
        self._has_place = True
        ways_m = zip(*about_first(corners_deg, pose[:2]), strict=True)  # to the corners, east and north
        away_m = math.hypot(*(max(min(way_m), -max(way_m), 0.0) for way_m in ways_m))
        if away_m > _FAR_M:
            key = "vehicle.fence_deg" if self._config.vehicle.fence_deg else "plan.area_deg"
            text = (
                f"the vehicle is {away_m / 1e3:.0f} km from {key}, and no leg is requested before it comes there. "
                "Are its corners [latitude, longitude] in decimal degrees, south and west negative?"
            )
            self._raise_once("bounds_far_away", text)

    def _check_outside(self, proposal: Proposal, now_s: float) -> None:
        """Report a vehicle that stays outside its fence while legs are wanted: none would be requested, in silence."""
        is_area_waiting = proposal.area is not None and "outside its fence" in proposal.area.verdict
        if proposal.waypoints or not (proposal.refused or is_area_waiting):
            self._outside = math.inf, -math.inf
            return
        vehicle = self._config.vehicle
        plane = LocalFrame(latitude_deg=vehicle.fence_deg[0][0], longitude_deg=vehicle.fence_deg[0][1])
        corners, (here,) = in_plane(vehicle.fence_deg, plane), in_plane([self._asked_from_deg], plane)
        margin_m = vehicle.fence_margin_m + vehicle.arrival_radius_m
        away_m = float(np.hypot(*(here - corners.mean(axis=0))))
        nearest_m, since_s = self._outside
        if circles_inside(here, 0.0, corners, margin_m):
            self._outside = math.inf, -math.inf
        elif away_m < nearest_m - _NEARER_M:
            self._outside = away_m, now_s
        elif now_s - since_s >= _OUTSIDE_S:
            text = (
                f"legs are wanted and none is requested: for {_OUTSIDE_S / 60.0:g} min the vehicle has been outside "
                f"vehicle.fence_deg, or nearer to its edge than {margin_m:g} m, and came no nearer; it is {away_m:.0f} "
                "m from its middle. Bring the vehicle inside, or correct the fence."
            )
            self._raise_once("vehicle_outside_fence", text)

    def insist(self, now_s: float) -> tuple[Waypoint, ...] | None:
        """Propose without planning: the same plan while a leg outlasts it, () when all track is sailed."""
        if self.plan and self._sailed_m >= self._config.plan.max_track_m:
            text = (
                f"the {self._config.plan.max_track_m:g} m of track that the payload may command are sailed: no "
                "further legs are requested"
            )
            self._raise_once("track_spent", text)
            self._leave_leg(now_s)
            self.plan, self._legs = (), []
            return ()
        if self._on_leg is not None and self._is_old(now_s):
            self._planned_s = now_s
            return self.plan
        return None

    def take(self, proposal: Proposal, now_s: float) -> tuple[Waypoint, ...] | None:
        """Give the plan to propose in place of the one before, None to keep that one."""
        self._waiting = False
        del self._flown[: self._n_requested]
        self._was_refused = bool(proposal.refused)
        self._check_outside(proposal, now_s)
        for contact_id, reason in proposal.refused:
            if contact_id not in self._raised:
                self._raised.add(contact_id)
                text = f"no second view of {contact_id} is proposed: {reason}"
                self._notices.append(Notice(code="look_refused", text=text, for_the_record="report it" not in reason))
        if proposal.area is not None:
            self.area = proposal.area
            for begin, code in _CODES.items():
                if self.area.verdict.startswith(begin):
                    # A reason to wait may hide another, which is reported when it comes.
                    key = self.area.verdict if code == "survey_waits" else code
                    self._raise_once(code, f"{self.area.words()}: {self.area.verdict}", key)
        if self._on_leg is not None:  # the vehicle reached it while the plan was made
            self._changed = True
            return None
        legs = _legs(proposal.waypoints)
        if legs and _are_alike(legs, self._legs) and self._begins_here and not self._is_old(now_s):
            return None
        if not proposal.waypoints and not self.plan:
            return None
        self._begins_here = self._commanding
        self.plan, self._planned_s, self._legs = proposal.waypoints, now_s, legs
        return self.plan

    def _is_survey_due(self, now_s: float) -> bool:
        settled = (
            bool(self._legs) or (self.area is not None and bool(self.area.verdict)) or not self._config.vehicle.command
        )
        return self._clears and now_s - self._requested_s >= (_SURVEY_AGAIN_S if settled else _SURVEY_S)

    def _sail(self, latitude_deg: float, longitude_deg: float) -> None:
        here = LocalFrame(latitude_deg=latitude_deg, longitude_deg=longitude_deg)
        if self._sailed_from is None:
            self._sailed_from = here
        sailed_m = float(np.linalg.norm(self._sailed_from.to_enu(latitude_deg, longitude_deg, 0.0)))
        if sailed_m >= _STEP_M:
            self._sailed_from = here
            self._sailed_m += sailed_m if sailed_m <= _JUMP_M else 0.0

    def _raise_once(self, code: str, text: str, key: str = "") -> None:
        """Raise a notice once per key, its code where none is given."""
        if (key or code) not in self._raised:
            self._raised.add(key or code)
            self._notices.append(Notice(code=code, text=text))

    def _is_old(self, now_s: float) -> bool:
        lasts_s = 0.5 * self._config.vehicle.plan_valid_s
        return now_s - self._planned_s > (lasts_s if self._commanding else min(lasts_s, _REFRESH_S))

    def _leave_leg(self, now_s: float) -> None:
        """Leave the leg; it counts as flown if its middle, abeam of the contact, was passed along it."""
        leg, self._on_leg = self._on_leg, None
        if leg is None or self._along_m <= max(0.5 * leg.length_m, self._began_m + _RUN_ALONG * leg.length_m):
            return
        self._legs.remove(leg)
        self._changed |= self._clears
        if not leg.contact_id:
            self._flown.append(leg.ends_deg)
            return
        looks = self._looks.setdefault(leg.contact_id, _Looks())  # a plan may pass contacts that are not reported
        looks.n_flown, looks.n_vain, looks.flown_s = looks.n_flown + 1, looks.n_vain + 1, now_s
        if looks.is_given_up:
            text = f"{leg.contact_id} was looked at again {looks.n_flown} times and is not requested any more"
            self._notices.append(Notice(code="look_given_up", text=text, for_the_record=True))


def _legs(waypoints: tuple[Waypoint, ...]) -> list[_Leg]:
    legs = []
    for entry, leaving in pairwise(waypoints):
        if leaving.kind == "leg_exit":
            frame = LocalFrame(latitude_deg=entry.latitude_deg, longitude_deg=entry.longitude_deg)
            run_m = frame.to_enu(leaving.latitude_deg, leaving.longitude_deg, 0.0)[:2]
            length_m = float(np.linalg.norm(run_m))
            east, north = (run_m / length_m).tolist()
            ends_deg = (entry.latitude_deg, entry.longitude_deg), (leaving.latitude_deg, leaving.longitude_deg)
            legs.append(_Leg(entry.contact_id, ends_deg, frame, (east, north), length_m))
    return legs


def _are_alike(legs: list[_Leg], others: list[_Leg]) -> bool:
    """Check whether plans have second views of the same contacts, or the same legs in the same order."""
    if all(leg.contact_id for leg in legs):
        return {leg.contact_id for leg in legs} == {leg.contact_id for leg in others}
    return len(legs) == len(others) and all(
        np.linalg.norm(leg.frame.to_enu(*other.ends_deg[0], 0.0)) < _SAME_M
        and np.linalg.norm(leg.frame.to_enu(*other.ends_deg[1], 0.0)[:2] - np.multiply(leg.along, leg.length_m))
        < _SAME_M
        for leg, other in zip(legs, others, strict=True)
    )
