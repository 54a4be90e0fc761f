"""Measure what further views of a contact bring: missions flown along their legs, then across them.

auv-mcm bench views                               flies, judges and prints

Contacts are those of the whole mission; each arm fuses some of their views alone. Pd is at the threshold that gives the
false alarms not on objects, or on anything but mines.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.classify.fusion import fuse
from auv_mcm.classify.odds import shipped_odds
from auv_mcm.contacts.ledger import fused_position
from auv_mcm.detect.belief import odds_of
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import Detection
from sim_replay.benches.experiment import Cell, Column, Experiment, PairedColumn, Task, number, share
from sim_replay.flights import fly_through
from sim_replay.missions import FIRST_SEED, config_for
from sim_replay.scoring.inputs import parse_truth
from sim_replay.scoring.intervals import proportion
from sim_replay.scoring.score import GATE_M
from sim_replay.scoring.thresholds import threshold_at
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.plan import Leg, local_frame, planned_legs
from sim_replay.simulator.scene import Lawnmower, Scene
from sim_replay.simulator.scene_file import read_scene

Views = Sequence[Detection]
_NEVER: Final = -np.inf  # log-odds of what has no contact
_REACH_M: Final = 40.0  # that crossing legs go beyond the outermost leg


class SeenObjects(NamedTuple):
    """Hold the log-odds of a mission's contacts.

    mines, rocks: the best on each, _NEVER where there is none. floor: of contacts on no object; others: the best on
    each object that is no mine. off_m: of the best contacts of mines, how far they are from them.
    """

    mines: NDArray[np.float64]
    rocks: NDArray[np.float64]
    floor: NDArray[np.float64]
    others: NDArray[np.float64]
    off_m: NDArray[np.float64]
    area_km2: float


ARMS: Final[dict[str, Callable[[Views, Views], Views]]] = {
    "first view": lambda along, across: along[:1],
    "along": lambda along, across: along,
    "first view, and one across": lambda along, across: [*along[:1], *across[:1]],
    "along and across": lambda along, across: [*along, *across],
    "the best of these alone": lambda along, across: sorted([*along, *across], key=lambda view: -view.p_mine)[:1],
}
"""Views that are fused, of those from legs along and across, in order of time."""


def fly(task: Task) -> dict[str, SeenObjects]:
    """Fly a named scene both ways and sort its contacts by what they lie on, for each arm."""
    scene = msgspec.structs.replace(read_scene(task.scene), seed=task.seed)
    mission, legs = Mission(scene), both_ways(scene)
    mission.follow(legs)
    pipeline = Pipeline(config_for(scene))
    fly_through(mission.events(), {"": pipeline})
    truth, prior = parse_truth(mission.truth(), task.scene), shipped_odds("cascade").prior
    frame = local_frame(scene.origin)
    objects = np.array([_place(frame, one.latitude_deg, one.longitude_deg) for one in truth.objects]).reshape(-1, 2)
    sorted_views = []
    for contact in pipeline.contacts:
        apart_m = np.hypot(*(objects - _place(frame, contact.latitude_deg, contact.longitude_deg)).T)
        nearest = int(apart_m.argmin()) if apart_m.size and apart_m.min() <= GATE_M else -1
        turned = [math.cos(math.radians(view.aspect_deg) - legs[0].direction_rad) for view in contact.views]
        along, across = (
            [view for view, cosine in zip(contact.views, turned, strict=True) if (abs(cosine) < 0.5) is is_along]
            for is_along in (True, False)
        )
        sorted_views.append((nearest, along, across))
    kinds = np.array(["mine" if one.is_target else one.kind for one in truth.objects], dtype=np.str_)
    found = {}
    for name, arm in ARMS.items():
        best, off_m = np.full(len(kinds), _NEVER), np.full(len(kinds), np.nan)
        floor = []
        for nearest, along, across in sorted_views:
            if views := arm(along, across):
                log_odds = odds_of(fuse(views, prior).p_mine)
                if nearest < 0:
                    floor.append(log_odds)
                elif log_odds > best[nearest]:
                    best[nearest] = log_odds
                    off_m[nearest] = np.hypot(*(objects[nearest] - _place(frame, *fused_position(tuple(views))[:2])))
        mine, seen, area_km2 = kinds == "mine", best > _NEVER, float(truth.area_km2 or 0.0)
        others, off_m = best[~mine & seen], off_m[mine & seen]
        found[name] = SeenObjects(best[mine], best[kinds == "rock"], np.array(floor), others, off_m, area_km2)
    return found


def both_ways(scene: Scene) -> list[Leg]:
    """Lay the legs of a scene's lawnmower, then as many as it takes across them."""
    plan = scene.track.plan
    assert isinstance(plan, Lawnmower)
    legs = list(planned_legs(plan))
    n_across = max(round(plan.leg_m / plan.spacing_m), 1)
    ends_m = (-_REACH_M, (plan.n_legs - 1) * plan.spacing_m + _REACH_M)
    for index in range(n_across):
        start_m, end_m = ends_m if index % 2 else ends_m[::-1]
        along_m = (index + 0.5) * plan.leg_m / n_across
        direction = legs[0].direction_rad + math.copysign(0.5 * math.pi, end_m - start_m)
        legs.append(Leg(*legs[0].at(along_m, start_m), direction, abs(end_m - start_m)))
    return legs


def _place(frame: LocalFrame, latitude_deg: float, longitude_deg: float) -> NDArray[np.float64]:
    return frame.to_enu(latitude_deg, longitude_deg, 0.0)[:2]


def _pooled(missions: Sequence[SeenObjects], part: str) -> NDArray[np.float64]:
    return np.concatenate([getattr(one, part) for one in missions])


def _n_found(missions: Sequence[SeenObjects], limit_per_km2: float, parts: Sequence[str]) -> int:
    n_allowed = limit_per_km2 * sum(one.area_km2 for one in missions)
    above = threshold_at(np.concatenate([_pooled(missions, part) for part in parts]), n_allowed)
    return int(np.count_nonzero(_pooled(missions, "mines") > above))


def _pd(missions: Sequence[SeenObjects], limit_per_km2: float, parts: Sequence[str]) -> Cell:
    return share(proportion(_n_found(missions, limit_per_km2, parts), len(_pooled(missions, "mines"))))


def _rocks_called(missions: Sequence[SeenObjects], pd: float) -> Cell:
    mines, rocks = np.sort(_pooled(missions, "mines"))[::-1], _pooled(missions, "rocks")
    least = mines[max(math.ceil(pd * len(mines)) - 1, 0)]
    return share(proportion(int(np.count_nonzero((rocks >= least) & (rocks > _NEVER))), len(rocks)))


def _gain(missions: Sequence[SeenObjects]) -> float:
    return _n_found(missions, 100.0, ("floor", "others")) / max(len(_pooled(missions, "mines")), 1)


_NOT_ON_OBJECTS: Final = ("floor",)
EXPERIMENT: Final = Experiment(
    name="views",
    scenes=("flat", "ripple", "mixed", "rough"),
    first_seed=FIRST_SEED + 400,
    n_seeds=3,
    variant_title="views",
    variants=tuple(ARMS),
    fly=fly,
    columns=(
        *(
            Column(f"Pd at {limit:g} FA/km²", partial(_pd, limit_per_km2=limit, parts=_NOT_ON_OBJECTS))
            for limit in (10.0, 30.0, 100.0)
        ),
        *(
            Column(f"at {limit:g}, objects counted", partial(_pd, limit_per_km2=limit, parts=("floor", "others")))
            for limit in (100.0, 300.0)
        ),
        PairedColumn("more at 100, objects counted", _gain),
        *(Column(f"rocks called at Pd {pd:g}", partial(_rocks_called, pd=pd)) for pd in (0.7, 0.8)),
        Column("off place, RMS, m", lambda some: number(float(np.sqrt((_pooled(some, "off_m") ** 2).mean())), 2)),
        Column("95 %, m", lambda some: number(float(np.quantile(_pooled(some, "off_m"), 0.95)), 2)),
    ),
    by_scene=False,
)
