"""Measure what planning on the way saves: a square cleared by the payload's plans, and by lawnmowers.

auv-mcm bench survey                              flies, judges and prints

Each variant sails until the clearance required is reached, as the payload's own map has it. A lawnmower sails lanes,
then lanes across them, then lanes between, and ends as soon as it is reached.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from typing import Final, NamedTuple

import msgspec
import numpy as np

from auv_mcm.clearance.area import AreaState, area_state, over_area
from auv_mcm.clearance.clearance_map import ClearanceMap
from auv_mcm.clearance.detection_performance import configured_performance
from auv_mcm.errors import UsageError
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.pipeline import Pipeline
from auv_mcm.plan.clear_area import ClearArea
from auv_mcm.plan.look_again import LookAgain
from auv_mcm.records import Contact, CoveragePatch, NavSample, Ping, Waypoint
from auv_mcm.settings.config import Config
from sim_replay.benches.experiment import Column, Experiment, PairedColumn, Task, density, number, share
from sim_replay.missions import FIRST_SEED, config_for
from sim_replay.scoring.called import CalledPoint, called_point
from sim_replay.scoring.inputs import ScoredMission, Truth, TruthObject, as_reported, parse_truth
from sim_replay.scoring.intervals import Density, Proportion, proportion
from sim_replay.scoring.intervals import density as area_density
from sim_replay.scoring.score import GATE_M
from sim_replay.scoring.thresholds import BestScores, best_scores, found_at
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.plan import Leg, local_frame, planned_legs, swath_m
from sim_replay.simulator.scene import Lawnmower, Scene
from sim_replay.simulator.scene_file import read_scene

PLANNED: Final = "planned"
LANES: Final = {"lanes of 0.9 of the reach": 0.9, "of 0.7": 0.7, "of 1.1": 1.1}
_BEYOND_M: Final = 15.0  # that lanes reach beyond the square: legs of plans need as much to settle
_FENCE_M: Final = 120.0  # beyond the square
_MAX_TRACK_M: Final = 8000.0  # three times what a square takes
_STEP_M: Final = 10.0  # that the way is measured by: above errors of positions, below turns
_BEFORE_M: Final = 40.0  # from where the vehicle begins to the square
_LOITER_M: Final = 40.0  # there and back while there is no plan
_STEPS: Final = 300  # of the planner's search, about what a plan on the way has time for
_PASSES: Final = (0.5, 0.5, 0.0, 0.0, 0.25, 0.25, 0.75, 0.75)  # lanes of each pass, in spacings from the edge


class Survey(NamedTuple):
    """Hold a survey that has ended. way_m: sailed from the first plan or lane until the order was reached."""

    called: CalledPoint
    scores: BestScores
    way_m: float
    p_detected: float
    is_reached: bool


def fly(task: Task) -> dict[str, Survey]:
    """Clear one drawn square in every way."""
    side_m, required = float(task.options["side"]), task.options["percent"] / 100.0
    scene = _square(task.scene, task.seed, side_m)
    config = _ordered(scene, side_m, required)
    reach_m = swath_m(scene)
    sailed = {name: tuple(lanes_over(side_m, spacing * reach_m)) for name, spacing in LANES.items()} | {PLANNED: ()}
    return {name: _Search(scene, config, legs).sailed(side_m) for name, legs in sailed.items()}


def _square(name: str, seed: int, side_m: float) -> Scene:
    """Draw a square whose south-west corner is the origin, with the floor and the objects of a named scene.

    Its patches are half as wide as the square, so that legs can choose among them; the sonar reaches a fifth. Raises
    UsageError for a synthetic aperture.
    """
    scene = msgspec.structs.replace(read_scene(name), seed=seed)
    if scene.sonar.synthetic_aperture is not None:
        raise UsageError(f"--scenes {name}: images of whole legs cannot be planned on the way. Choose another scene")
    sonar, range_m = scene.sonar, side_m / 5.0
    sonar = msgspec.structs.replace(sonar, range_m=range_m, n_samples=round(sonar.n_samples * range_m / sonar.range_m))
    scene = msgspec.structs.replace(
        scene,
        sonar=sonar,
        world=msgspec.structs.replace(scene.world, patch_m=0.5 * side_m),
        scatter=tuple(msgspec.structs.replace(some, ground_range_m=None) for some in scene.scatter),
    )
    n_lanes = math.ceil(side_m / swath_m(scene))
    plan = Lawnmower(
        start_east_m=0.5 * side_m / n_lanes,
        start_north_m=-_BEFORE_M,
        n_legs=n_lanes,
        leg_m=side_m + 2.0 * _BEFORE_M,
        spacing_m=side_m / n_lanes,
    )
    return msgspec.structs.replace(scene, track=msgspec.structs.replace(scene.track, plan=plan))


def _ordered(scene: Scene, side_m: float, required: float) -> Config:
    """Order the square to be cleared, in a fence around it."""
    frame, config = local_frame(scene.origin), config_for(scene)
    inner, outer = ((low, low + length) for low, length in ((0.0, side_m), (-_FENCE_M, side_m + 2.0 * _FENCE_M)))
    area_deg, fence_deg = (
        tuple(_geodetic(frame, *corner) for corner in ((low, low), (low, high), (high, high), (high, low)))
        for low, high in (inner, outer)
    )
    track = scene.track
    radius_m = track.speed_mps / math.radians(track.turn_rate_deg_s)
    plan = msgspec.structs.replace(
        config.plan,
        area_deg=area_deg,
        required_clearance=required,
        turn_radius_m=radius_m,
        max_track_m=_MAX_TRACK_M,
        max_contacts=0,
    )
    vehicle = msgspec.structs.replace(
        config.vehicle, command=True, fence_deg=fence_deg, altitude_m=track.altitude_m, speed_mps=track.speed_mps
    )
    return msgspec.structs.replace(config, plan=plan, vehicle=vehicle)


def _geodetic(frame: LocalFrame, east_m: float, north_m: float) -> tuple[float, float]:
    latitude_deg, longitude_deg, _ = frame.to_geodetic([east_m, north_m, 0.0])
    return float(latitude_deg), float(longitude_deg)


def lanes_over(side_m: float, spacing_m: float) -> Iterator[Leg]:
    """Lay lanes along the square, across it, then between the first; spacing_m: at most, so that they share it."""
    n = math.ceil(side_m / spacing_m)
    length_m = side_m + 2.0 * _BEYOND_M
    for turn, share_of_spacing in enumerate(_PASSES):
        for lane in range(n):
            across_m, is_back = (lane + share_of_spacing) * side_m / n, lane % 2
            start_m = side_m + _BEYOND_M if is_back else -_BEYOND_M
            if turn % 2:
                yield Leg(start_m, across_m, 0.5 * math.pi + math.pi * is_back, length_m)
            else:
                yield Leg(across_m, start_m, math.pi * is_back, length_m)


class _Search:
    """Search a square by lanes, or (none) by the plans that the payload makes on the way."""

    def __init__(self, scene: Scene, config: Config, lanes: Sequence[Leg]) -> None:
        self._scene, self._config = scene, config
        self._mission, self._pipeline = Mission(scene), Pipeline(config)
        self._searched = ClearanceMap(configured_performance(config))
        self._area, self._again = ClearArea(config, configured_performance(config)), LookAgain(config)
        self._is_planned = not lanes
        self._frame = local_frame(scene.origin)
        self._way: list[tuple[float, float]] = []  # time, metres sailed
        self._place_m = np.full(2, np.nan)
        self._began_s, self._ended_s, self._moved_s = -math.inf, math.inf, -math.inf
        self._mission.follow(lanes or _idle(*planned_legs(scene.track.plan)[0][:3]))

    def sailed(self, side_m: float) -> Survey:
        """Sail until the order is reached or cannot be, and score what was found in the square."""
        for event in self._mission.events():
            patches = [one for one in self._pipeline.feed(event) if isinstance(one, CoveragePatch)]
            for patch in patches:
                self._searched.add(patch)
                self._area.add(patch)
            if isinstance(event, Ping):
                self._area.see(event)
            else:
                self._move(event)
            if (patches and self._is_reached_by(patches)) or self._is_given_up():
                break
        self._pipeline.finish()
        state, scored = self._state(), self._scored(side_m)
        called = called_point([scored], GATE_M)
        assert called is not None  # contacts state it
        return Survey(called, best_scores(scored), self._way_m(), state.p_detected, state.is_reached)

    def _move(self, nav: NavSample) -> None:
        """Take the vehicle's place, and once a second plan from there."""
        place_m = self._frame.to_enu(nav.latitude_deg, nav.longitude_deg, 0.0)[:2]
        step_m = float(np.hypot(*(place_m - self._place_m)))
        if not step_m < _STEP_M:
            self._way.append((nav.time_s, step_m if self._way else 0.0))
            self._place_m = place_m
        if not self._is_planned or nav.time_s < self._moved_s + 1.0:
            return
        self._moved_s = nav.time_s
        self._again.move(nav.latitude_deg, nav.longitude_deg, True, nav.time_s)
        request = self._again.request((nav.latitude_deg, nav.longitude_deg, nav.heading_rad), nav.time_s, nav.time_s)
        if request is None:
            return
        left = iter(range(_STEPS))
        proposal = self._area.propose(self._searched.snapshot(), (), request, lambda: next(left, None) is not None)
        plan = self._again.take(proposal, nav.time_s)
        if plan is not None:
            self._began_s = self._began_s if math.isfinite(self._began_s) else nav.time_s
            legs = list(legs_of(plan, self._frame))
            end = (*legs[-1].end, legs[-1].direction_rad) if legs else (*place_m.tolist(), nav.heading_rad)
            self._mission.follow([*legs, *_idle(*end)])

    def _is_reached_by(self, patches: Sequence[CoveragePatch]) -> bool:
        if not self._state().is_reached:
            return False
        self._ended_s = max(patch.stop_s for patch in patches)
        return True

    def _is_given_up(self) -> bool:
        return self._again.area is not None and self._again.area.verdict.startswith("cannot")

    def _state(self) -> AreaState:
        plan = self._config.plan
        return area_state(over_area(self._searched.snapshot(), plan.area_deg, plan.cell_m), plan.required_clearance)

    def _way_m(self) -> float:
        return sum(step_m for time_s, step_m in self._way if self._began_s < time_s <= self._ended_s)

    def _scored(self, side_m: float) -> ScoredMission:
        """Take what lies in the square; every object there counts, seen or not."""

        def is_inside(one: TruthObject | Contact) -> bool:
            place_m = self._frame.to_enu(one.latitude_deg, one.longitude_deg, 0.0)[:2]
            return bool(((place_m >= 0.0) & (place_m <= side_m)).all())

        truth = parse_truth(self._mission.truth(), self._scene.name)
        objects = tuple(msgspec.structs.replace(one, looks=None) for one in truth.objects if is_inside(one))
        contacts = as_reported([one for one in self._pipeline.contacts if is_inside(one)], self._scene.name)
        return ScoredMission(contacts, Truth(area_km2=side_m**2 * 1e-6, objects=objects))


def legs_of(plan: Sequence[Waypoint], frame: LocalFrame) -> Iterator[Leg]:
    """Turn a plan into the legs that it names; the vehicle turns from one to the next by itself."""
    for before, point in pairwise(plan):
        if point.kind == "leg_exit":
            (east_m, north_m), end_m = (
                frame.to_enu(one.latitude_deg, one.longitude_deg, 0.0)[:2].tolist() for one in (before, point)
            )
            off_m = end_m[0] - east_m, end_m[1] - north_m
            yield Leg(east_m, north_m, math.atan2(*off_m), math.hypot(*off_m))


def _idle(east_m: float, north_m: float, direction_rad: float) -> list[Leg]:
    """Sail on, then there and back, until there is a plan."""
    there = Leg(east_m, north_m, direction_rad, _LOITER_M)
    back = Leg(*there.at(_LOITER_M, _LOITER_M), direction_rad + math.pi, _LOITER_M)
    return [there, back] * 20


def _called(surveys: Sequence[Survey]) -> Proportion:
    return proportion(sum(one.called.pd.count for one in surveys), sum(one.called.pd.of for one in surveys))


def _false_alarms(surveys: Sequence[Survey]) -> Density:
    alarms = [one.called.false_alarms for one in surveys]
    return area_density(sum(one.count for one in alarms), sum(one.area_km2 or 0.0 for one in alarms))


def _way_m(surveys: Sequence[Survey]) -> float:
    return sum(one.way_m for one in surveys) / len(surveys)


def _whole(low: int, high: int) -> Callable[[str], int]:
    def parse(text: str) -> int:
        if not text.isdecimal() or not low <= int(text[:9]) <= high:
            raise argparse.ArgumentTypeError(f"'{text}' is not a whole number from {low} to {high}")
        return int(text)

    return parse


def _add_options(parser: argparse.ArgumentParser) -> None:
    side, percent = _whole(100, 500), _whole(50, 99)
    parser.add_argument("--side", type=side, default=200, metavar="M", help="side of the square (default 200 m)")
    parser.add_argument("--percent", type=percent, default=90, metavar="P", help="clearance required (default 90 %%)")


EXPERIMENT: Final = Experiment(
    name="survey",
    scenes=("mixed",),
    first_seed=FIRST_SEED + 600,
    n_seeds=30,
    variant_title="sailed by",
    variants=(*LANES, PLANNED),
    fly=fly,
    columns=(
        Column("track, m", lambda surveys: number(_way_m(surveys))),
        Column(
            "enough for nine in ten", lambda surveys: number(float(np.quantile([one.way_m for one in surveys], 0.9)))
        ),
        PairedColumn("logarithm against the first", lambda surveys: math.log(_way_m(surveys))),
        Column("reached", lambda surveys: share(proportion(sum(one.is_reached for one in surveys), len(surveys)))),
        Column("by tables", lambda surveys: number(sum(one.p_detected for one in surveys) / len(surveys), 3)),
        Column("Pd called", lambda surveys: share(_called(surveys))),
        PairedColumn("more called", lambda surveys: _called(surveys).value or 0.0),
        Column("FA/km² called", lambda surveys: density(_false_alarms(surveys))),
        Column("Pd at 100 FA/km²", lambda surveys: share(found_at([one.scores for one in surveys], 100.0))),
    ),
    by_scene=False,
    add_options=_add_options,
    own_options=("side", "percent"),
)
