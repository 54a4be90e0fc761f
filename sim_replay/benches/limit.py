"""Measure what a second view adds: each named scene is flown along its own legs and then at right angles to them.

auv-mcm bench limit                               flies, judges and prints

So every object is seen by one pass from one side, and by both from aspects 90 degrees apart, in the same mission. Only
what both passes saw counts. False alarms are rocks and whatever lies on no object; what is on other clutter counts
neither way.
"""

from __future__ import annotations

import gc
import math
from collections.abc import Mapping, Sequence
from datetime import datetime
from functools import partial
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np

from auv_mcm.classify.fusion import fuse
from auv_mcm.classify.odds import shipped_odds
from auv_mcm.contacts.ledger import contact_from_views
from auv_mcm.detect.belief import odds_of
from auv_mcm.errors import UsageError
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import Detection
from sim_replay.benches.experiment import (
    Cell,
    Column,
    Experiment,
    PairedColumn,
    Task,
    add_experiment_arguments,
    number,
    run_experiment,
    share,
)
from sim_replay.missions import SCENES, config_for
from sim_replay.scoring.matching import gates_m
from sim_replay.scoring.score import GATE_M
from sim_replay.scoring.thresholds import BestScores, found_at, rocks_called_at
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.plan import Leg, local_frame, planned_legs, swath_m
from sim_replay.simulator.scene import Lawnmower, Scene
from sim_replay.simulator.scene_file import read_scene
from sim_replay.simulator.vehicle import Vehicle
from sim_replay.text_tables import NOTHING

ROCKS_PD: Final = 0.9  # Pd at which the share of rocks that are called is printed
VIEWS: Final = ("one, along", "one, across", "both")
_REACH: Final = 0.9  # of the swath that the legs across go beyond the outer legs: objects lie up to about there


class KnownObject(NamedTuple):
    """Hold an object of the truth, and whether both passes saw it."""

    kind: str
    is_target: bool
    seen_twice: bool
    place_m: tuple[float, float]


def fly(task: Task) -> dict[str, BestScores]:
    """Fly a scene twice over the same floor, and judge the first pass, the second, and both."""
    gc.collect()  # a mission refers to itself: the sea floor of the one before, 300 MB, would stay for long
    scene = msgspec.structs.replace(read_scene(task.scene), seed=task.seed)
    return judged(scene, *fly_twice(scene))


def fly_twice(scene: Scene) -> tuple[list[tuple[Detection, ...]], Mapping[str, Any], float]:
    """Fly both passes with the chain as it ships.

    Returns the views of each contact, the truth, and when the first pass ended, s UTC. Raises UsageError for a scene
    whose plan is no lawnmower.
    """
    across = legs_across(scene)
    mission = Mission(scene)
    track, world = scene.track, mission.sea.world
    own = Vehicle(
        track,
        planned_legs(track.plan),
        scene.seed,
        lambda east, north: scene.world.depth_m - world.floor_m(east, north),
    )
    end_s = list(own.poses(scene.sonar.ping_rate_hz))[-1].time_s
    mission.follow([*mission.vehicle.legs, *across])
    pipeline = Pipeline(config_for(scene))
    for event in mission.events():
        pipeline.feed(event)
    pipeline.finish()
    return [contact.views for contact in pipeline.contacts], mission.truth(), end_s


def judged(
    scene: Scene, views_of: Sequence[tuple[Detection, ...]], truth: Mapping[str, Any], end_s: float
) -> dict[str, BestScores]:
    """Weigh contacts, as log-odds, by their views of the first pass, of the second, and of both.

    views_of, truth, end_s: as `fly_twice` returns them.
    """
    plan, (low_m, high_m) = lawnmower_of(scene), across_m(scene)
    first, frame = planned_legs(plan)[0], local_frame(scene.origin)
    prior = shipped_odds("cascade").prior

    def placed(latitude_deg: float, longitude_deg: float) -> tuple[float, float] | None:
        east, north, _ = frame.to_enu(latitude_deg, longitude_deg, 0.0).tolist()
        along, across = first.along_across(east, north)
        return (east, north) if 0.0 <= along <= plan.leg_m and low_m <= across <= high_m else None

    objects = []
    for one in truth["objects"]:
        place = placed(one["lat"], one["lon"])
        if place is not None:
            before = {datetime.fromisoformat(look["time"]).timestamp() <= end_s for look in one["looks"]}
            objects.append(KnownObject(one["kind"], one["is_target"], len(before) == 2, place))
    found: dict[str, list[tuple[int, float]]] = {name: [] for name in VIEWS}
    for views in views_of:
        whole = contact_from_views("0", views, prior)
        place = placed(whole.latitude_deg, whole.longitude_deg)
        if place is None:
            continue
        sigma_m = math.sqrt(max(float(np.linalg.eigvalsh(whole.covariance_m2)[-1]), 0.0))
        on = _object_at(place, float(gates_m(GATE_M, np.array([sigma_m]))[0]), objects)
        parts = ([one for one in views if one.time_s <= end_s], [one for one in views if one.time_s > end_s], views)
        for name, some in zip(VIEWS, parts, strict=True):
            if some:
                found[name].append((on, odds_of(fuse(some, prior).p_mine)))
    return {name: best_of(objects, contacts, _area_km2(scene)) for name, contacts in found.items()}


def best_of(objects: Sequence[KnownObject], contacts: Sequence[tuple[int, float]], area_km2: float) -> BestScores:
    """Take the best score of each object. contacts: the object that each lies on, -1 for none, and its score."""
    best = [-math.inf] * len(objects)
    for on, score in contacts:
        if on >= 0:
            best[on] = max(best[on], score)
    bare = [score for on, score in contacts if on < 0]
    rocks = [score for one, score in zip(objects, best, strict=True) if one.kind == "rock" and score > -math.inf]
    both = [(one, score) for one, score in zip(objects, best, strict=True) if one.seen_twice]
    return BestScores(
        targets=np.array([score for one, score in both if one.is_target]),
        rocks=np.array([score for one, score in both if one.kind == "rock"]),
        false_alarms=np.array(bare + rocks),
        bare=np.array(bare),
        area_km2=area_km2,
    )


def lawnmower_of(scene: Scene) -> Lawnmower:
    """Return the scene's plan. Raises UsageError if it is no lawnmower."""
    plan = scene.track.plan
    if not isinstance(plan, Lawnmower):
        raise UsageError(
            f"scene '{scene.name}': `track.plan` is no lawnmower, which alone can be crossed. Take another"
        )
    return plan


def legs_across(scene: Scene) -> tuple[Leg, ...]:
    """Lay legs at right angles to the scene's own, over the same floor and as far apart, or a little nearer."""
    plan, (low_m, high_m) = lawnmower_of(scene), across_m(scene)
    first = planned_legs(plan)[0]
    n_legs = math.ceil(plan.leg_m / plan.spacing_m)
    legs = []
    for index in range(n_legs):
        side = -1.0 if index % 2 == 0 else 1.0
        start = first.at((index + 0.5) * plan.leg_m / n_legs, high_m if side < 0.0 else low_m)
        legs.append(Leg(*start, first.direction_rad + side * 0.5 * math.pi, high_m - low_m))
    return tuple(legs)


def across_m(scene: Scene) -> tuple[float, float]:
    """Return how far the rectangle that both passes cover reaches to port and starboard of the first leg."""
    plan, reach_m = lawnmower_of(scene), _REACH * swath_m(scene)
    return -reach_m, (plan.n_legs - 1) * plan.spacing_m + reach_m


def _area_km2(scene: Scene) -> float:
    low_m, high_m = across_m(scene)
    return lawnmower_of(scene).leg_m * (high_m - low_m) / 1e6


def _object_at(place_m: tuple[float, float], gate_m: float, objects: Sequence[KnownObject]) -> int:
    """Find the nearest target within the gate, or else the nearest object, or else -1."""
    found = [
        (not one.is_target, math.dist(place_m, one.place_m), index)
        for index, one in enumerate(objects)
        if math.dist(place_m, one.place_m) <= gate_m
    ]
    return min(found)[2] if found else -1


def _pd(flights: Sequence[BestScores], limit_per_km2: float, *, on_objects: bool = True) -> Cell:
    return share(found_at(flights, limit_per_km2, on_objects=on_objects))


def _rocks_called(flights: Sequence[BestScores]) -> Cell:
    called = rocks_called_at(flights, ROCKS_PD)
    return Cell(NOTHING) if called is None else share(called)


EXPERIMENT: Final = Experiment(
    name="limit",
    scenes=SCENES,
    first_seed=9700,  # on seeds from here on nothing was fitted or tried before this bench
    variant_title="views",
    variants=VIEWS,
    fly=fly,
    columns=(
        Column("targets", lambda flights: number(sum(len(one.targets) for one in flights))),
        *(Column(f"Pd at {limit:g} FA/km²", partial(_pd, limit_per_km2=limit)) for limit in (10.0, 30.0, 100.0, 300.0)),
        *(
            Column(f"at {limit:g} not on rocks", partial(_pd, limit_per_km2=limit, on_objects=False))
            for limit in (10.0, 100.0)
        ),
        PairedColumn("more at 100 than along", lambda flights: found_at(flights, 100.0).value or 0.0),
        Column(f"rocks called at Pd {ROCKS_PD:g}", _rocks_called),
    ),
)
add_arguments = partial(add_experiment_arguments, EXPERIMENT)
run = partial(run_experiment, EXPERIMENT)
