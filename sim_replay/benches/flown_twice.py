"""Fly a named scene twice over the same floor, along its own legs and at right angles to them, and sort the contacts.

So every object is seen by one pass from one side, and by both from aspects 90 degrees apart, in the same mission.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any, Final, Literal, NamedTuple, TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.classify.fusion import fuse
from auv_mcm.classify.odds import shipped_odds
from auv_mcm.contacts.ledger import contact_from_views
from auv_mcm.detect.belief import odds_of
from auv_mcm.errors import UsageError
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import Detection, LookStep
from sim_replay.missions import config_for
from sim_replay.scoring.matching import gates_m
from sim_replay.scoring.score import GATE_M
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.plan import Leg, local_frame, planned_legs, swath_m
from sim_replay.simulator.scene import Lawnmower, Scene
from sim_replay.simulator.sea import Sea
from sim_replay.simulator.vehicle import SonarPose, Vehicle

Floats = NDArray[np.float64]
Passes: TypeAlias = Literal["first", "second", "both"]

_REACH: Final = 0.9  # of the swath that the legs across go beyond the outer legs: objects lie up to about there
NOTHING_NATS: Final = -math.inf  # log-odds of what has no contact


class KnownObject(NamedTuple):
    """Hold an object of the truth: its number there, what it is, and whether each pass saw it."""

    number: int
    kind: str
    is_target: bool
    seen_first: bool
    seen_second: bool


class JudgedContact(NamedTuple):
    """Hold one contact by what its views of a pass, or of both, make of it.

    on: index of the object that it lies on, a target if there is one within the gate; -1 for bare floor. log_odds: of a
    mine after the last step, nats, where those passes have a view of it. by_step: after each step, from the first pass
    alone. ratios: evidence of the most mine-like view of each pass, nats, NaN where it has none.
    """

    on: int
    log_odds: dict[Passes, float]
    by_step: dict[LookStep, float]
    ratios: tuple[float, float]


class TwiceFlown(NamedTuple):
    """Hold the objects and contacts within the rectangle that both passes cover."""

    scene: str
    area_km2: float
    objects: tuple[KnownObject, ...]
    contacts: tuple[JudgedContact, ...]


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


def first_poses(scene: Scene, sea: Sea) -> list[SonarPose]:
    """List the true poses of all pings of the first pass, turns included."""
    track, world = scene.track, sea.world

    def depth_m(east_m: float, north_m: float) -> float:
        return scene.world.depth_m - world.floor_m(east_m, north_m)

    return list(Vehicle(track, planned_legs(track.plan), scene.seed, depth_m).poses(scene.sonar.ping_rate_hz))


def fly_twice(scene: Scene) -> tuple[list[tuple[Detection, ...]], Mapping[str, Any], float]:
    """Fly both passes with the chain as it ships.

    Returns the views of each contact, the truth, and when the first pass ended, s UTC. Raises UsageError for a scene
    whose plan is no lawnmower.
    """
    across = legs_across(scene)
    mission = Mission(scene)
    end_s = first_poses(scene, mission.sea)[-1].time_s
    mission.follow([*mission.vehicle.legs, *across])
    pipeline = Pipeline(config_for(scene))
    for event in mission.events():
        pipeline.feed(event)
    pipeline.finish()
    return [contact.views for contact in pipeline.contacts], mission.truth(), end_s


def sorted_flight(
    scene: Scene, views_of: Sequence[tuple[Detection, ...]], truth: Mapping[str, Any], end_s: float
) -> TwiceFlown:
    """Sort contacts by what they lie on, and weigh their views of the first pass, of the second, and of both.

    views_of, truth, end_s: as `fly_twice` returns them.
    """
    plan, (low_m, high_m) = lawnmower_of(scene), across_m(scene)
    first, frame = planned_legs(plan)[0], local_frame(scene.origin)
    prior = shipped_odds("cascade").prior

    def placed(latitude_deg: float, longitude_deg: float) -> tuple[float, float] | None:
        east, north, _ = frame.to_enu(latitude_deg, longitude_deg, 0.0)
        along, across = first.along_across(float(east), float(north))
        return (float(east), float(north)) if 0.0 <= along <= plan.leg_m and low_m <= across <= high_m else None

    objects, places = [], []
    for number, one in enumerate(truth["objects"]):
        place = placed(one["lat"], one["lon"])
        if place is None:
            continue
        times_s = [datetime.fromisoformat(look["time"]).timestamp() for look in one["looks"]]
        seen = [any(time_s <= end_s for time_s in times_s), any(time_s > end_s for time_s in times_s)]
        objects.append(KnownObject(number, one["kind"], one["is_target"], *seen))
        places.append(place)
    contacts = []
    for views in views_of:
        whole = contact_from_views("0", views, prior)
        place = placed(whole.latitude_deg, whole.longitude_deg)
        if place is None:
            continue
        sigma_m = math.sqrt(max(float(np.linalg.eigvalsh(whole.covariance_m2)[-1]), 0.0))
        on = _object_at(place, float(gates_m(GATE_M, np.array([sigma_m]))[0]), objects, places)
        contacts.append(_judged(views, on, end_s, prior))
    area_km2 = 1e-6 * plan.leg_m * (high_m - low_m)
    return TwiceFlown(scene.name, area_km2, tuple(objects), tuple(contacts))


def _object_at(
    place: tuple[float, float],
    gate_m: float,
    objects: Sequence[KnownObject],
    places: Sequence[tuple[float, float]],
) -> int:
    """Find the nearest target within the gate, or else the nearest object, or else -1."""
    found = [
        (not one.is_target, math.dist(place, there), index)
        for index, (one, there) in enumerate(zip(objects, places, strict=True))
        if math.dist(place, there) <= gate_m
    ]
    return min(found)[2] if found else -1


def _judged(views: tuple[Detection, ...], on: int, end_s: float, prior: float) -> JudgedContact:
    parts: dict[Passes, list[Detection]] = {
        "first": [view for view in views if view.time_s <= end_s],
        "second": [view for view in views if view.time_s > end_s],
        "both": list(views),
    }
    log_odds = {name: odds_of(fuse(some, prior).p_mine) for name, some in parts.items() if some}
    by_step: dict[LookStep, float] = {}
    if parts["first"]:
        steps: tuple[LookStep, ...] = ("detector", "contours", "shape")
        by_step = {
            step: odds_of(fuse([_as_after(view, steps[: k + 1]) for view in parts["first"]], prior).p_mine)
            for k, step in enumerate(steps)
        }
    first, second = (
        max((odds_of(view.p_mine) - prior for view in some), default=math.nan)
        for some in (parts["first"], parts["second"])
    )
    return JudgedContact(on, log_odds, by_step, (first, second))


def _as_after(view: Detection, steps: Sequence[LookStep]) -> Detection:
    """Return a view as it would be if it had not been confirmed beyond these steps."""
    known = [view.p_by_step[step] for step in steps if step in view.p_by_step]
    return msgspec.structs.replace(view, p_mine=known[-1], confirmation=None)
