"""Fly one order in the same world replanned on the way, and as a lawnmower laid beforehand; score both alike."""

from __future__ import annotations

import json
import math
from typing import Final, NamedTuple

import msgspec

from auv_mcm.classify.beliefs import MINE_LIKE_P
from auv_mcm.clearance.clearance_map import Clearance
from auv_mcm.clearance.detection_performance import Performance, shipped_performance
from auv_mcm.contacts.export import contacts_geojson
from auv_mcm.errors import UsageError
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.plan.dubins import PlanePose
from auv_mcm.plan.orienteering import MIN_ALIKE
from sim_replay.adaptive.decide import by_replanning
from sim_replay.adaptive.flight import AdaptiveFlight, fly_adaptive, fly_fixed
from sim_replay.adaptive.lawnmower import LawnmowerLegs, shortest_lawnmower, worst_seabed
from sim_replay.adaptive.order import Order, drawn_scene, limits_of, usual_order
from sim_replay.adaptive.ordered_ground import would_come_to
from sim_replay.missions import config_for
from sim_replay.scoring import ScoredMission, parse_contacts, parse_truth, score_missions
from sim_replay.scoring.inputs import ReportedContact, Truth, TruthObject
from sim_replay.simulator.plan import local_frame, planned_legs
from sim_replay.simulator.scene import Origin

ABOVE: Final = 0.02
"""By how much of mean clearance the replanned flight is to be better than what the lawnmower would give on the sea
floor as mapped."""
HALF_P: Final = 0.5  # p_mine: as likely a mine as not
GATE_M: Final = 2.0  # m between contact and target, maximum, as in scoring


class AreaMine(msgspec.Struct, frozen=True, kw_only=True):
    """Describe a mine in the area.

    Its probability of being found by the clearance map, and whether a mine-like contact lies within 2 m.
    """

    p_detected: float
    found: bool


class Counts(msgspec.Struct, frozen=True, kw_only=True):
    """Count mines found and false alarms among contacts that are called mine-like, and at p_mine 0.5."""

    n_found: int
    n_false: int
    n_found_half: int
    n_false_half: int


class Arm(msgspec.Struct, frozen=True, kw_only=True):
    """Describe one flight.

    reached_m: track after which the map showed the order as met, None if never. at_end: by all its contacts.
    """

    track_m: float
    duration_s: float
    reached_m: float | None
    verdict: str
    believed: float
    n_targets: int
    at_end: Counts
    targets: tuple[AreaMine, ...]


class Compared(msgspec.Struct, frozen=True, kw_only=True):
    """Compare both flights. planned_m, expected: of the lawnmower as laid, for the worst sea floor everywhere."""

    seed: int
    area_km2: float
    required: float
    adaptive: Arm
    fixed: Arm
    planned_m: float
    expected: float


def compare(seed: int) -> Compared:
    """Fly and score the world of a seed both ways, with the shipped settings."""
    order, model = usual_order(), shipped_performance()
    flights = fly_comparison(seed, order, model)
    return Compared(
        seed=seed,
        area_km2=order.side_m**2 / 1e6,
        required=order.required,
        adaptive=_arm(flights.adaptive, order),
        fixed=_arm(flights.fixed, order),
        planned_m=flights.lawnmower.length_m,
        expected=flights.lawnmower.expected,
    )


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


def _arm(flight: AdaptiveFlight, order: Order) -> Arm:
    """Score inside the ordered area alone; a mine there that was never swept is missed."""
    truth = parse_truth(flight.truth, "the flight's truth")
    frame = local_frame(Origin())

    def inside(target: ReportedContact | TruthObject) -> bool:
        east, north, _ = frame.to_enu(target.latitude_deg, target.longitude_deg, 0.0).tolist()
        return bool(0.0 <= east <= order.side_m and 0.0 <= north <= order.side_m)

    objects = tuple(msgspec.structs.replace(target, looks=None) for target in truth.objects)
    contacts = tuple(
        filter(inside, parse_contacts(json.loads(contacts_geojson(flight.contacts)), "the flight's contacts"))
    )
    scored = Truth(area_km2=order.side_m**2 / 1e6, objects=objects)
    called = [contact for contact in contacts if contact.p_mine >= MINE_LIKE_P]
    targets = tuple(
        AreaMine(
            p_detected=_p_at(flight.ground, target),
            found=any(_apart_m(target, contact) <= GATE_M for contact in called),
        )
        for target in objects
        if target.is_target
    )
    return Arm(
        track_m=flight.way_m,
        duration_s=flight.duration_s,
        reached_m=flight.reached_m if math.isfinite(flight.reached_m) else None,
        verdict=flight.verdict,
        believed=float(flight.ground.p_detected.mean()),
        n_targets=len(targets),
        at_end=_counts(ScoredMission(contacts, scored)),
        targets=targets,
    )


def _counts(mission: ScoredMission) -> Counts:
    mine_like, half = (
        score_missions([mission], gate_m=GATE_M, threshold=p).at_threshold for p in (MINE_LIKE_P, HALF_P)
    )
    return Counts(
        n_found=mine_like.pd.count,
        n_false=mine_like.false_alarms.count,
        n_found_half=half.pd.count,
        n_false_half=half.false_alarms.count,
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


def _apart_m(target: TruthObject, contact: ReportedContact) -> float:
    frame = LocalFrame(latitude_deg=target.latitude_deg, longitude_deg=target.longitude_deg)
    east, north, _ = frame.to_enu(contact.latitude_deg, contact.longitude_deg, 0.0).tolist()
    return math.hypot(east, north)
