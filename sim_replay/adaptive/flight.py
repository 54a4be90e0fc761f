"""Fly and observe one mission: pings through the pipeline onto the clearance map, and new legs when a leg ends."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.clearance.clearance_map import Clearance, ClearanceMap, LookModel
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.pipeline import Pipeline
from auv_mcm.plan.dubins import PlanePose
from auv_mcm.plan.limits import Limits
from auv_mcm.records import SIDES, Contact, CoveragePatch, NavSample, Side
from auv_mcm.settings.config import Config
from sim_replay.adaptive.order import Order
from sim_replay.adaptive.ordered_ground import clearance_over_order, with_expected
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.plan import Leg, local_frame
from sim_replay.simulator.scene import Scene
from sim_replay.simulator.vehicle import RUN_IN_S

Array = NDArray[np.float64]

_BLOCK_PINGS: Final = 16  # simulated at once: decisions wait for no more
_TILE_ROWS: Final = 256  # rows per tile: shorter than usual, so that decisions come sooner
_ENDS_M: Final = 2.0  # before its end a leg counts as flown: the block under way is flown to its end in any case
_BESIDE_M: Final = 10.0  # m across the track, within which a vehicle is on its leg
_WAIT_LEG_M: Final = 40.0  # m of the leg that is flown while nothing is requested
_TRACK_EVERY: Final = 5  # pings between places kept of the track


class Situation(NamedTuple):
    """Describe what is known when new legs are requested.

    ground: the ordered area, with flown but unreported track as expected; required: mean clearance to reach. pose: in
    its plane; left_m: of the budget. complete: nothing is expected that a plan could wait for.
    """

    ground: Clearance
    required: float
    contacts: tuple[Contact, ...]
    pose: PlanePose
    left_m: float
    complete: bool


class LegDecision(NamedTuple):
    """Decide on legs.

    legs: in the plane of the situation's ground, each from where it is to be straight; none to end here. verdict, why:
    in words.
    """

    legs: tuple[Leg, ...]
    verdict: str
    why: str


Decide = Callable[[Situation], LegDecision]
Wanted = Callable[[Clearance], float]
"""The mean clearance that is to be reached, by what is known of the sea floor."""


class ReportedPd(NamedTuple):
    """Record the mean p_detected over the area as the vehicle knew it, after so many metres."""

    way_m: float
    p_detected: float


class AdaptiveFlight(NamedTuple):
    """Describe a mission's course.

    track: (n, 2) east and north in the scene's plane. ground: the ordered area at the end, every ping counted.

    reached_m: track after which the ordered clearance was known to be reached, infinite if it never was. reported: the
    mean p_detected known after each stretch. reasons: of each decision.
    """

    way_m: float
    duration_s: float
    reached_m: float
    verdict: str
    track: Array
    ground: Clearance
    contacts: tuple[Contact, ...]
    reported: tuple[ReportedPd, ...]
    reasons: tuple[str, ...]
    truth: dict[str, object]


def fly_fixed(scene: Scene, order: Order, legs: Sequence[Leg], model: LookModel, config: Config) -> AdaptiveFlight:
    """Fly legs (scene's plane) to the end, whatever is found."""
    return _Loop(scene, order, model, config, None, None, lambda ground: math.inf).fly(legs)


def fly_adaptive(
    scene: Scene, order: Order, decide: Decide, limits: Limits, model: LookModel, config: Config, wanted: Wanted
) -> AdaptiveFlight:
    """Fly legs decided on at the start and whenever one ends.

    The flight ends when the wanted clearance is reached, `decide` has no more, or the budget is used up.
    """
    return _Loop(scene, order, model, config, decide, limits, wanted).fly(())


class _Flown(NamedTuple):
    """Hold straight flight that has not been reported yet: time, east, north, heading in the scene's plane."""

    time_s: float
    east_m: float
    north_m: float
    heading_rad: float


class _Loop:
    def __init__(
        self,
        scene: Scene,
        order: Order,
        model: LookModel,
        config: Config,
        decide: Decide | None,
        limits: Limits | None,
        wanted: Wanted,
    ) -> None:
        config = msgspec.structs.replace(
            config, waterfall=msgspec.structs.replace(config.waterfall, tile_rows=_TILE_ROWS)
        )
        self._scene, self._order, self._model, self._config = scene, order, model, config
        self._decide, self._limits, self._wanted = decide, limits, wanted
        self._mission = Mission(scene, block_pings=_BLOCK_PINGS)
        self._pipeline = Pipeline(config)
        self._map = ClearanceMap(model)
        self._origin = local_frame(scene.origin)
        self._plane = self._origin
        self._reported_until: dict[Side, float] = dict.fromkeys(SIDES, -math.inf)
        self._unreported: list[_Flown] = []
        self._legs: list[Leg] = []  # yet to be flown, in the scene's plane
        self._on_leg = False
        self._way_m = 0.0
        self._last: NavSample | None = None
        self._heading_rate = 0.0
        self._waits_from_s = math.inf  # until the track flown by then is reported
        self._verdict = ""
        self._reached_m = math.inf
        self._reported: list[ReportedPd] = []
        self._reasons: list[str] = []
        self._track: list[tuple[float, float]] = []

    def fly(self, legs: Sequence[Leg]) -> AdaptiveFlight:
        first_leg = self._mission.vehicle.legs[0]
        start = _Flown(self._scene.track.start_time_s, first_leg.east_m, first_leg.north_m, first_leg.direction_rad)
        if self._decide is None:
            self._mission.follow(legs)
        else:
            self._replan(start)
        n_events = 0
        for event in self._mission.events() if not self._verdict else ():
            for result in self._pipeline.feed(event):
                if isinstance(result, CoveragePatch):
                    self._take(result)
            if isinstance(event, NavSample):
                here = self._move(event)
                if n_events % _TRACK_EVERY == 0:
                    self._track.append((here.east_m, here.north_m))
                n_events += 1
                if self._decide is not None:
                    self._steer(here)
                if self._verdict:
                    break
        for result in self._pipeline.finish():
            if isinstance(result, CoveragePatch):
                self._take(result)
        start_s = self._scene.track.start_time_s
        return AdaptiveFlight(
            way_m=self._way_m,
            duration_s=0.0 if self._last is None else self._last.time_s - start_s,
            reached_m=self._reached_m,
            verdict=self._verdict or "flown to the end",
            track=np.array(self._track).reshape(-1, 2),
            ground=self._ground(),
            contacts=self._pipeline.contacts,
            reported=tuple(self._reported),
            reasons=tuple(self._reasons),
            truth=self._mission.truth(),
        )

    def _move(self, sample: NavSample) -> _Flown:
        """Reckon the way, and keep what has been flown straight since the last patch."""
        east, north, _ = self._origin.to_enu(sample.latitude_deg, sample.longitude_deg, 0.0).tolist()
        here = _Flown(sample.time_s, east, north, sample.heading_rad)
        if self._last is not None:
            passed_s = sample.time_s - self._last.time_s
            self._way_m += sample.speed_mps * passed_s
            turned = math.remainder(sample.heading_rad - self._last.heading_rad, 2.0 * math.pi)
            self._heading_rate += min(passed_s, 1.0) * (turned / passed_s - self._heading_rate)
        self._last = sample
        if abs(self._heading_rate) < math.radians(self._config.waterfall.max_turn_rate_deg_s):
            self._unreported.append(here)
        return here

    def _take(self, patch: CoveragePatch) -> None:
        self._map.add(patch)
        self._reported_until[patch.side] = max(self._reported_until[patch.side], patch.stop_s)
        if patch.cells is not None:
            self._plane = LocalFrame(
                latitude_deg=patch.cells.origin_latitude_deg, longitude_deg=patch.cells.origin_longitude_deg
            )
        if patch.side != SIDES[-1]:
            return
        reported_s = min(self._reported_until.values())
        self._unreported = [flown for flown in self._unreported if flown.time_s > reported_s]
        ground = self._ground()
        p_detected = float(ground.p_detected.mean())
        self._reported.append(ReportedPd(self._way_m, p_detected))
        if p_detected < self._order.required:
            return
        self._reached_m = min(self._reached_m, self._way_m)
        if not self._verdict and p_detected >= self._wanted(ground):
            self._verdict = f"done: mines in the area are found with probability {p_detected:.3f}"

    def _ground(self) -> Clearance:
        return clearance_over_order(
            self._map.snapshot(), self._order, self._origin, self._plane, self._config.plan.cell_m
        )

    def _steer(self, here: _Flown) -> None:
        if self._verdict:
            return
        if self._way_m >= self._order.budget_m:
            self._verdict = f"cannot, because the budget of {self._order.budget_m:g} m is used up"
        elif min(self._reported_until.values()) >= self._waits_from_s or self._leg_ended(here):
            self._replan(here)

    def _leg_ended(self, here: _Flown) -> bool:
        leg = self._legs[0]
        along, across = leg.along_across(here.east_m, here.north_m)
        ahead = math.cos(here.heading_rad - leg.direction_rad) > 0.5 and abs(across) < _BESIDE_M
        self._on_leg |= ahead and 0.0 <= along < leg.length_m - _ENDS_M
        ended = self._on_leg and along >= leg.length_m - _ENDS_M
        if ended:
            self._on_leg = False
        return ended

    def _replan(self, here: _Flown) -> None:
        assert self._decide is not None
        assert self._limits is not None
        known = ground = self._ground()
        for side in SIDES:
            until = self._reported_until[side]
            ground = with_expected(
                ground,
                self._model,
                self._limits,
                side,
                self._in_plane([f for f in self._unreported if f.time_s > until]),
            )
        pose = PlanePose(*self._in_plane([here])[0].tolist())
        complete = self._last is None or min(self._reported_until.values()) >= min(self._waits_from_s, here.time_s)
        left_m = self._order.budget_m - self._way_m
        required = self._wanted(known)
        decision = self._decide(Situation(ground, required, self._pipeline.contacts, pose, left_m, complete))
        self._reasons.append(decision.why)
        if decision.legs:
            self._waits_from_s = math.inf
            self._fly_on([self._to_scene(leg) for leg in decision.legs], here)
        elif complete and ground.p_detected.mean() < required:
            self._verdict = decision.verdict
        else:
            # What was flown while waiting may be expected to do: then that is waited for, too.
            self._waits_from_s = here.time_s if complete else min(self._waits_from_s, here.time_s)
            self._fly_on([], here)

    def _fly_on(self, legs: list[Leg], here: _Flown) -> None:
        """Fly the legs, then back towards the middle of the area to wait.

        Each leg starts from where the vehicle has settled on its line.
        """
        run_in_m = RUN_IN_S * self._scene.track.speed_mps
        legs = [Leg(*leg.at(run_in_m, 0.0), leg.direction_rad, leg.length_m - run_in_m) for leg in legs]
        (east, north), middle = (legs[-1].end if legs else (here.east_m, here.north_m)), 0.5 * self._order.side_m
        towards = math.atan2(middle - east, middle - north)
        wait = Leg(*Leg(middle, middle, towards, 0.0).at(-0.5 * _WAIT_LEG_M, 0.0), towards, _WAIT_LEG_M)
        self._legs = [*legs, wait]
        self._on_leg = False
        self._mission.follow(self._legs)

    def _in_plane(self, flown: Sequence[_Flown]) -> Array:
        """Convert to (n, 3) east, north, heading in the mission's plane, which is nearly parallel to the scene's."""
        places = np.array([(f.east_m, f.north_m, f.heading_rad) for f in flown]).reshape(-1, 3)
        east, north, _ = self._plane.to_enu(self._origin.latitude_deg, self._origin.longitude_deg, 0.0)
        return np.asarray(places + np.array([float(east), float(north), 0.0]))

    def _to_scene(self, leg: Leg) -> Leg:
        east, north, _ = self._plane.to_enu(self._origin.latitude_deg, self._origin.longitude_deg, 0.0)
        return leg._replace(east_m=leg.east_m - float(east), north_m=leg.north_m - float(north))
