"""Clear an area: plan legs anew from what has been seen until the required clearance is reached or cannot be.

What a leg has shown is known tile by tile, the last of it after its end. Until then its cells count as searched as well
as expected, so that the same leg is not planned again at once. Cells that legs have passed twice and that have gained
next to nothing are given up. Sea floor not seen yet is expected to be like the nearest that was.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Final, NamedTuple

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.clearance.area import Area, area_state, frame_of, in_plane, middles_m, over_area, required_words
from auv_mcm.clearance.clearance_map import HIGHEST_P, Clearance, LookModel, look_bit
from auv_mcm.clearance.detection_performance import CellView
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.plan.dubins import PlanePose
from auv_mcm.plan.limits import Limits, obstacle
from auv_mcm.plan.look_again import LEAVES_LEG_M, PlanRequest, Proposal, Run
from auv_mcm.plan.plan_words import area_words
from auv_mcm.plan.propose import propose
from auv_mcm.plan.reinspect import SETTLING_RADII, most_undecided
from auv_mcm.plan.survey import Plan, SurveyState, replan
from auv_mcm.records import SEABED_TYPES, SIDES, Contact, CoveragePatch, EchoTrace, Ping, Side
from auv_mcm.settings.config import Config

# after which a cell is given up and reported: sailing on would not change why it was in vain
MAX_VAIN_PASSES: Final = 2
SHOWN_AFTER_S: Final = 120.0  # longest time from the end of a leg to the tiles that show it
_VAIN: Final = 0.1  # of what was expected
_CLOCK_STEP_S: Final = 1.0  # s: a step back of less is a late ping, of more a clock that was set, as the intake has it
_SAME_PLACE_M: Final = 1.0  # m: ends of legs nearer than that are the same request


def wished(required: float) -> float:
    """Set the wanted clearance of each cell for a mean of `required`.

    Half as many mines may be missed as in the mean, so that hard sea floor may stay below where easy sea floor is
    above.
    """
    return 1.0 - 0.5 * (1.0 - required)


def floor_ahead(ground: Clearance) -> Clearance:
    """Expect cells not seen yet to be like the nearest that was seen; flat before any was.

    Plans for the worst of all floors would lay legs closer than most areas need. If the floor turns out harder, the
    next plan knows.
    """
    if not ground.seen.any():
        return msgspec.structs.replace(ground, seabed=np.full_like(ground.seabed, SEABED_TYPES.index("flat")))
    unseen = (~ground.seen).astype(np.uint8)
    _, nearest = cv2.distanceTransformWithLabels(unseen, cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL)
    seen = np.flatnonzero(ground.seen)
    at = np.zeros(seen.size + 1, dtype=np.intp)
    at[nearest.ravel()[seen]] = seen  # each seen cell has a label of its own
    at = at[nearest]
    layers: dict[str, NDArray[np.generic]] = {
        name: getattr(ground, name).ravel()[at] for name in ("seabed", "ripple_rad", "unevenness_db")
    }
    return msgspec.structs.replace(ground, **layers)


class _Known(NamedTuple):
    """Hold the miss exponents of the cells of the area's box, and the plane that they lie in."""

    plane: LocalFrame
    exponent: NDArray[np.float64]


class _Flown(NamedTuple):
    """Hold a survey leg that was flown. until_s: mission time of its end. before: as known before it."""

    ends_deg: Run
    until_s: float
    before: _Known | None


class ClearArea:
    """Plan the clearing of an area, in the perception process.

    Pings and patches are taken in the order in which they come.
    """

    def __init__(self, config: Config, model: LookModel) -> None:
        self._config = config
        self._model = model
        self._slant_range_m = 0.0
        self._now_s = self._seen_s = -math.inf  # the latter of the last ping
        self._shown_until_s: dict[Side, float] = {}
        self._pending: list[_Flown] = []
        self._known: _Known | None = None  # at the last request; none is made on a leg
        self._plane: LocalFrame | None = None
        self._vain = np.zeros((0, 0), dtype=np.uint8)  # passes, per cell of the area's box
        self._previous: Plan | None = None

    def see(self, ping: Ping) -> None:
        """Take a ping that was fed to the pipeline: it shows how far the sonar reaches."""
        if math.isfinite(ping.time_s) and ping.time_s != self._seen_s:
            before_s, self._seen_s = self._seen_s, ping.time_s
            # The middle of three, as a time far from those before and behind it is a wrong one.
            now_s = sorted((self._now_s, before_s, ping.time_s))[1] if math.isfinite(before_s) else ping.time_s
            if now_s < self._now_s - _CLOCK_STEP_S:  # no leg before can be compared with what comes
                self._pending, self._shown_until_s = [], {}
            self._now_s = now_s
        reach_m = max(map(_reach_m, (ping.port, ping.starboard)))
        self._slant_range_m = min(reach_m, self._config.sonar.max_range_m) if reach_m > 0.0 else self._slant_range_m

    def add(self, patch: CoveragePatch) -> None:
        """Take a patch that has become part of the clearance."""
        if patch.stop_s <= self._now_s + _CLOCK_STEP_S:  # else it is of a clock that was set back since
            self._shown_until_s[patch.side] = patch.stop_s

    def propose(
        self,
        clearance: Clearance | None,
        contacts: Iterable[Contact],
        request: PlanRequest,
        more_time: Callable[[], bool],
    ) -> Proposal:
        """State how the search of the area stands and, where the payload may command at all, plan from here.

        Parameters
        ----------
        clearance
            Of everything seen.
        more_time
            As for `replan`.
        """
        plan = self._config.plan
        area = over_area(clearance, plan.area_deg, plan.cell_m)
        if area.frame != self._plane or self._vain.shape != area.cells.shape:
            self._plane, self._vain, self._previous = area.frame, np.zeros(area.cells.shape, dtype=np.uint8), None
        state = area_state(area, plan.required_clearance)
        if not self._config.vehicle.command:
            return Proposal(
                (), (), state._replace(verdict=_done(area, plan.required_clearance) if state.is_reached else "")
            )
        limits = self._limits(area.frame, request)
        self._learn_of(area, request, limits)
        self._known = _Known(area.frame, area.ground.exponent)
        ground = self._expected(floor_ahead(area.ground), limits)
        is_enough = area_state(area._replace(ground=ground), plan.required_clearance).is_reached
        wanted = area.cells & (self._vain < MAX_VAIN_PASSES) & (not is_enough)
        if not wanted.any():
            verdict = "" if self._pending else self._given_up(area)
            verdict = _done(area, plan.required_clearance) if state.is_reached else verdict
            proposal = propose(contacts, request, plan, self._config.vehicle, more_time)
            return proposal._replace(area=state._replace(verdict=verdict))
        pose = _pose(request, area.frame)
        if limits.budget_m > 0.0 and (hindrance := self._hindrance(pose, limits)):
            return Proposal((), (), state._replace(verdict=f"not yet, because {hindrance}"))
        asking = most_undecided((contact for contact in contacts if contact.id not in request.left_out), plan)
        p = ground.p_detected
        mean = (
            plan.required_clearance * np.count_nonzero(area.cells) - p[area.cells & ~wanted].sum()
        ) / np.count_nonzero(wanted)
        world = SurveyState(ground, wanted, wished(plan.required_clearance), self._model, asking, float(mean))
        self._previous = found = replan(world, pose, limits, self._previous, more_time)
        verdict = "" if found.legs or self._pending else found.verdict
        return Proposal(found.waypoints, (), state._replace(verdict=verdict))

    def _limits(self, plane: LocalFrame, request: PlanRequest) -> Limits:
        config, vehicle = self._config, self._config.vehicle
        near_m = vehicle.altitude_m / math.tan(math.radians(config.waterfall.max_grazing_deg))
        far_m = math.sqrt(max(self._slant_range_m**2 - vehicle.altitude_m**2, 0.0))
        return Limits(
            turn_radius_m=config.plan.turn_radius_m,
            budget_m=config.plan.max_track_m - request.sailed_m,
            fence=in_plane(vehicle.fence_deg, plane),
            altitude_m=vehicle.altitude_m,
            min_altitude_m=vehicle.min_altitude_m,
            swath=(near_m, far_m),
            settling_m=max(SETTLING_RADII * config.plan.turn_radius_m, vehicle.arrival_radius_m + LEAVES_LEG_M),
            fence_margin_m=vehicle.fence_margin_m + vehicle.arrival_radius_m,
        )

    def _hindrance(self, pose: PlanePose, limits: Limits) -> str:
        """State why nothing can be planned from here and now; the cause may pass by itself."""
        if not self._slant_range_m:
            return "no ping has shown how far the sonar reaches"
        return obstacle(pose, limits)

    def _learn_of(self, area: Area, request: PlanRequest, limits: Limits) -> None:
        """Record legs flown since the last request, and judge earlier ones that are shown by now."""
        known = {leg.ends_deg for leg in self._pending}  # a request may come again after a restart
        self._pending += [
            _Flown(ends_deg, request.time_s, self._known) for ends_deg in request.flown if ends_deg not in known
        ]
        if self._previous is not None:
            gone = [in_plane(ends_deg, area.frame) for ends_deg in request.flown]
            left = tuple(
                leg for leg in self._previous.legs if not any(_is_same(leg.entry, leg.exit, ends) for ends in gone)
            )
            self._previous = msgspec.structs.replace(self._previous, legs=left)
        shown_until_s = min(self._shown_until_s.values(), default=-math.inf)
        for leg in self._pending:
            if max(shown_until_s, self._now_s - SHOWN_AFTER_S) >= leg.until_s:
                self._judge(leg, area, limits)
        self._pending = [leg for leg in self._pending if max(shown_until_s, self._now_s - SHOWN_AFTER_S) < leg.until_s]

    def _judge(self, leg: _Flown, area: Area, limits: Limits) -> None:
        """Count the cells that a leg passed in vain."""
        before, nothing = leg.before, np.zeros(area.cells.shape)
        was = before.exponent if before is not None and before.plane == area.frame else nothing
        promised = self._with_look(area.ground, leg, limits, was) - was
        seen = promised > 0.0
        vain = area.ground.exponent - was < _VAIN * promised
        self._vain = np.where(seen, np.where(vain, np.minimum(self._vain, 254) + 1, 0), self._vain).astype(np.uint8)

    def _expected(self, ground: Clearance, limits: Limits) -> Clearance:
        """Add what pending legs are expected to clear where they are not shown yet."""
        for leg in self._pending:
            exponent = self._with_look(ground, leg, limits, ground.exponent, self._shown_until_s)
            looks = np.where(exponent > ground.exponent, np.minimum(ground.looks, 254) + 1, ground.looks).astype(
                np.uint8
            )
            heading = _heading_rad(in_plane(leg.ends_deg, frame_of(ground)))
            both_sides = np.bitwise_or.reduce(look_bit([heading - 0.5 * math.pi, heading + 0.5 * math.pi]))
            towards = np.where(exponent > ground.exponent, ground.towards | both_sides, ground.towards)
            ground = msgspec.structs.replace(ground, exponent=exponent, looks=looks, towards=towards)
        return ground

    def _with_look(
        self,
        ground: Clearance,
        leg: _Flown,
        limits: Limits,
        exponent: NDArray[np.float64],
        shown_until_s: Mapping[Side, float] | None = None,
    ) -> NDArray[np.float64]:
        """Add a view from the leg to the miss exponents of cells abeam of its run, less the settling.

        shown_until_s: leave out what was abeam until then.
        """
        entry, leave = in_plane(leg.ends_deg, frame_of(ground))
        along = (leave - entry) / max(float(np.hypot(*(leave - entry))), 1e-9)
        place = middles_m(ground) - entry
        ahead_m = place @ along
        to_right_m = place @ np.array([along[1], -along[0]])
        near_m, far_m = limits.swath
        length_m = float(np.hypot(*(leave - entry)))
        seen = (np.abs(to_right_m) >= near_m) & (np.abs(to_right_m) <= far_m)
        seen &= (ahead_m >= limits.settling_m) & (ahead_m <= length_m - limits.settling_m)
        if shown_until_s is not None:
            port_s, starboard_s = (shown_until_s.get(side, -math.inf) for side in SIDES)
            abeam_s = leg.until_s - (length_m - ahead_m) / self._config.vehicle.speed_mps
            seen &= abeam_s > np.where(to_right_m > 0.0, starboard_s, port_s)
        heading = _heading_rad(np.stack([entry, leave]))
        look = np.mod(heading + np.sign(to_right_m[seen]) * 0.5 * math.pi, 2.0 * math.pi).astype(np.float32)
        view = CellView(
            seabed=ground.seabed[seen],
            ground_range_m=np.abs(to_right_m[seen]).astype(np.float32),
            altitude_m=np.float32(limits.altitude_m),
            look_rad=look,
            ripple_rad=ground.ripple_rad[seen],
            unevenness_db=ground.unevenness_db[seen],
        )
        renewed = np.where(ground.looks[seen] > 0, 1.0 - self._model.other_look_correlation, 1.0)
        added = exponent.copy()
        added[seen] -= renewed * np.log1p(-np.clip(self._model.p_look(view), 0.0, HIGHEST_P))
        return added

    def _given_up(self, area: Area) -> str:
        """State why the clearance cannot be reached, where no cell is left to try."""
        given_up = area.cells & (self._vain >= MAX_VAIN_PASSES)
        return (
            f"cannot, because no leg adds to it any more: {area_words(given_up.sum() * area.ground.cell_m**2)} of "
            f"{area_words(area.cells.sum() * area.ground.cell_m**2)} were passed {MAX_VAIN_PASSES} times in vain and "
            "given up"
        )


def _done(area: Area, required: float) -> str:
    state, words = area_state(area, required), required_words(required)
    n_digits = max(3, len(words.partition(".")[2]))  # never reads as less than required
    return (
        f"done: mines in the {area_words(area.cells.sum() * area.ground.cell_m**2)} are found with probability "
        f"{state.p_detected:.{n_digits}f}, {words} was required"
    )


def _pose(request: PlanRequest, plane: LocalFrame) -> PlanePose:
    """Give the pose where a plan begins, in the plane.

    The plane's north differs from true north far from its origin and near the poles.
    """
    here = LocalFrame(latitude_deg=request.latitude_deg, longitude_deg=request.longitude_deg)
    ahead_deg = here.to_geodetic([math.sin(request.heading_rad), math.cos(request.heading_rad), 0.0])[:2]
    start, ahead = in_plane(
        [(request.latitude_deg, request.longitude_deg), (float(ahead_deg[0]), float(ahead_deg[1]))], plane
    )
    return PlanePose(float(start[0]), float(start[1]), math.atan2(ahead[0] - start[0], ahead[1] - start[1]))


def _heading_rad(ends: NDArray[np.float64]) -> float:
    east, north = (ends[1] - ends[0]).tolist()
    return math.atan2(east, north)


def _reach_m(trace: EchoTrace | None) -> float:
    return 0.0 if trace is None else trace.first_range_m + trace.spacing_m * trace.samples.size


def _is_same(entry: PlanePose, leave: PlanePose, ends: NDArray[np.float64]) -> bool:
    return float(np.hypot(*(np.array([entry[:2], leave[:2]]) - ends).T).max()) < _SAME_PLACE_M
