"""Measure whether replanning clears an area with less track than a lawnmower laid beforehand.

Over missions on mixed sea floor.

Both are flown through the same simulated worlds with the same chain; looks are worth the same to both planners. What
lies where is not known when the lawnmower is laid: it is the shortest that is expected to do what is ordered even on
the worst sea floor, and is flown to its end. The replanned flight goes on until the order is met and its map is as good
as the lawnmower would have made it, and a little better.
"""

from __future__ import annotations

import gc
import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Final, NamedTuple

import msgspec

from auv_mcm.classify.beliefs import MINE_LIKE_P
from auv_mcm.clearance.clearance_map import Clearance
from auv_mcm.clearance.detection_performance import Performance, shipped_performance
from auv_mcm.errors import UsageError
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.plan.dubins import PlanePose
from auv_mcm.plan.orienteering import MIN_ALIKE
from sim_replay.adaptive.decide import by_replanning
from sim_replay.adaptive.flight import AdaptiveFlight, fly_adaptive, fly_fixed
from sim_replay.adaptive.lawnmower import LawnmowerLegs, shortest_lawnmower, worst_seabed
from sim_replay.adaptive.order import REQUIRED, SIDE_M, Order, drawn_scene, limits_of, usual_order
from sim_replay.adaptive.ordered_ground import would_come_to
from sim_replay.benches.experiment import (
    Cell,
    Column,
    Experiment,
    PairedColumn,
    Task,
    add_experiment_arguments,
    density,
    number,
    run_experiment,
    share,
)
from sim_replay.missions import config_for
from sim_replay.scoring.inputs import ReportedContact, ScoredMission, Truth, TruthObject, as_reported, parse_truth
from sim_replay.scoring.intervals import density as area_density
from sim_replay.scoring.intervals import proportion
from sim_replay.scoring.score import GATE_M, score_missions
from sim_replay.simulator.plan import local_frame, planned_legs
from sim_replay.simulator.scene import Origin

ABOVE: Final = 0.02
"""By how much of mean clearance the replanned flight is to be better than what the lawnmower would give on the sea
floor as mapped."""
LAWNMOWER: Final = "lawnmower"
REPLANNED: Final = "replanned"


class Arm(NamedTuple):
    """Describe one flight.

    reached_m: track after which the map showed the order as met, None if never. believed: mean of the clearance map;
    believed_at_mines: its sum where mines lie. n_found, n_false: mines with a contact that is called mine-like, and
    such contacts elsewhere. planned_m, expected: of the lawnmower as laid, for the worst sea floor everywhere.
    """

    track_m: float
    duration_s: float
    reached_m: float | None
    believed: float
    believed_at_mines: float
    n_targets: int
    n_found: int
    n_false: int
    area_km2: float
    planned_m: float
    expected: float


def fly(task: Task) -> dict[str, Arm]:
    """Fly and score the world of a seed both ways, with the shipped settings."""
    gc.collect()  # a mission refers to itself: the sea floor of the one before, 300 MB, would stay for long
    order = usual_order()
    flights = fly_comparison(task.seed, order, shipped_performance())
    return {
        LAWNMOWER: arm_of(flights.fixed, order, flights.lawnmower),
        REPLANNED: arm_of(flights.adaptive, order, flights.lawnmower),
    }


class Flights(NamedTuple):
    """Hold both flights. lawnmower: that was flown as `fixed`."""

    adaptive: AdaptiveFlight
    fixed: AdaptiveFlight
    lawnmower: LawnmowerLegs


def fly_comparison(seed: int, order: Order, model: Performance) -> Flights:
    """Fly both ways over one square each.

    The lawnmower is the shortest that is expected to do what is ordered were the worst sea floor everywhere. The
    replanned flight goes on until the order is met and its map is ABOVE what the lawnmower would come to on the same
    sea floor, as the map has it by then. Maps and plans count the share MIN_ALIKE of a look from an earlier look's side
    as nothing new.

    Raises UsageError where no lawnmower is expected to do what is ordered, so that there is nothing to compare with.
    """
    scene = drawn_scene(seed, order.side_m)
    limits, config = limits_of(scene, order), config_for(scene)
    # Over vegetation the first pings may be taken for intensities; the integrator has configured what its recorder
    # writes.
    config = msgspec.structs.replace(config, sonar=msgspec.structs.replace(config.sonar, transfer="amplitude"))
    first = planned_legs(scene.track.plan)[0]
    start = PlanePose(first.east_m, first.north_m, first.direction_rad)
    lawnmower = shortest_lawnmower(
        order.side_m, order.required, {worst_seabed(model, limits): 1.0}, model, limits, start
    )
    if lawnmower is None:
        raise UsageError(
            f"no lawnmower is expected to find {order.required:g} of the mines on the worst sea floor: order less"
        )
    origin, legs = local_frame(scene.origin), lawnmower.legs
    careful = msgspec.structs.replace(model, same_look_correlation=max(model.same_look_correlation, MIN_ALIKE))

    def wanted(ground: Clearance) -> float:
        return max(order.required, would_come_to(ground, legs, origin, careful, limits) + ABOVE)

    adaptive = fly_adaptive(
        scene, order, by_replanning(order, careful, limits, origin), limits, careful, config, wanted
    )
    return Flights(adaptive, fly_fixed(scene, order, legs, careful, config), lawnmower)


def arm_of(flight: AdaptiveFlight, order: Order, planned: LawnmowerLegs) -> Arm:
    """Score a flight inside the ordered area alone; a mine there that was never swept is missed."""
    truth = parse_truth(flight.truth, "the flight's truth")
    frame = local_frame(Origin())

    def inside(target: ReportedContact | TruthObject) -> bool:
        east, north, _ = frame.to_enu(target.latitude_deg, target.longitude_deg, 0.0).tolist()
        return bool(0.0 <= east <= order.side_m and 0.0 <= north <= order.side_m)

    objects = tuple(msgspec.structs.replace(target, looks=None) for target in truth.objects)
    contacts = tuple(filter(inside, as_reported(flight.contacts, "the flight's contacts")))
    scored = Truth(area_km2=order.side_m**2 / 1e6, objects=objects)
    score = score_missions([ScoredMission(contacts, scored)], gate_m=GATE_M, threshold=MINE_LIKE_P)
    targets = [one for one in objects if one.is_target]
    return Arm(
        track_m=flight.way_m,
        duration_s=flight.duration_s,
        reached_m=flight.reached_m if math.isfinite(flight.reached_m) else None,
        believed=float(flight.ground.p_detected.mean()),
        believed_at_mines=sum(_p_at(flight.ground, one) for one in targets),
        n_targets=len(targets),
        n_found=score.at_threshold.pd.count,
        n_false=score.at_threshold.false_alarms.count,
        area_km2=scored.area_km2,
        planned_m=planned.length_m,
        expected=planned.expected,
    )


def _p_at(ground: Clearance, target: TruthObject) -> float:
    frame = LocalFrame(latitude_deg=ground.origin_latitude_deg, longitude_deg=ground.origin_longitude_deg)
    east, north, _ = frame.to_enu(target.latitude_deg, target.longitude_deg, 0.0).tolist()
    row, column = (
        math.floor(north / ground.cell_m) - ground.first_north,
        math.floor(east / ground.cell_m) - ground.first_east,
    )
    n_north, n_east = ground.exponent.shape
    return float(ground.p_detected[min(max(row, 0), n_north - 1), min(max(column, 0), n_east - 1)])


def _mean(arms: Sequence[Arm], of: Callable[[Arm], float]) -> float:
    return sum(map(of, arms)) / len(arms)


def _reached(arms: Sequence[Arm]) -> Cell:
    return share(proportion(sum(one.reached_m is not None for one in arms), len(arms)))


def _pd(arms: Sequence[Arm]) -> float:
    return sum(one.n_found for one in arms) / max(sum(one.n_targets for one in arms), 1)


def _words(flown: Sequence[Mapping[str, Arm]]) -> str:
    arms = [one[LAWNMOWER] for one in flown]
    both = [pair for pair in flown if all(one.reached_m is not None for one in pair.values())]
    until = {name: _mean([pair[name] for pair in both], lambda one: one.reached_m or 0.0) for name in flown[0] if both}
    return (
        f"worlds of {SIDE_M:g} m by {SIDE_M:g} m; clearance ordered: {REQUIRED:g} on average over the area\n"
        f"the lawnmower laid for the worst sea floor: {_mean(arms, lambda one: one.planned_m):.0f} m planned, "
        f"clearance expected there {_mean(arms, lambda one: one.expected):.3f}\n"
        f"track until the order was reached, m, in the {len(both)} worlds where both did: "
        + ", ".join(f"{name} {track_m:.0f}" for name, track_m in until.items())
    )


EXPERIMENT: Final = Experiment(
    name="adapt",
    scenes=(),
    first_seed=9430,  # on seeds from here on nothing was ever tuned
    n_seeds=30,
    variant_title="flight",
    variants=(LAWNMOWER, REPLANNED),
    fly=fly,
    columns=(
        Column("track, m", lambda arms: number(_mean(arms, lambda one: one.track_m))),
        PairedColumn("more track, m", lambda arms: _mean(arms, lambda one: one.track_m)),
        Column("time, s", lambda arms: number(_mean(arms, lambda one: one.duration_s))),
        Column("order reached", _reached),
        Column("clearance as believed", lambda arms: number(_mean(arms, lambda one: one.believed), 3)),
        Column(
            "the same where mines lie",
            lambda arms: number(sum(a.believed_at_mines for a in arms) / max(sum(a.n_targets for a in arms), 1), 3),
        ),
        Column(
            "Pd, mine-like",
            lambda arms: share(proportion(sum(one.n_found for one in arms), sum(one.n_targets for one in arms))),
        ),
        PairedColumn("more Pd", _pd),
        Column(
            "FA/km², mine-like",
            lambda arms: density(area_density(sum(a.n_false for a in arms), sum(a.area_km2 for a in arms))),
        ),
    ),
    by_scene=False,
    words=_words,
)
add_arguments = partial(add_experiment_arguments, EXPERIMENT)
run = partial(run_experiment, EXPERIMENT)
