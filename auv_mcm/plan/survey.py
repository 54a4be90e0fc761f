"""Plan the mission anew from what is known now: legs over sea floor not clear yet and second views of contacts.

A cell that must be cleared wants the miss exponent -ln(1 - required). The gain of a leg is what it adds to the
probability that a mine there is found, up to what is wanted, in square metres of unsearched floor made clear. A view of
a contact gains what `contact_legs` states in the same measure. Where a mean over the area suffices, what exceeds it
gains nothing. `tracks` has the legs to choose from, `ladders` and `orienteering` choose and order them. The plan is a
proposal: the vehicle decides.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.clearance.area import required_words
from auv_mcm.clearance.clearance_map import Clearance, LookModel
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.plan.contact_legs import ContactLegs, contact_legs
from auv_mcm.plan.dubins import PlanePose, sample_path
from auv_mcm.plan.limits import Limits, obstacle
from auv_mcm.plan.orienteering import Problem, Wanting, gain_bound_m2, route_length_m, sailable, worth_m2
from auv_mcm.plan.plan_words import area_words, contact_words, survey_words
from auv_mcm.plan.reinspect import on_the_globe
from auv_mcm.plan.search import NEARLY_ALL, searched, wanting_m2_of
from auv_mcm.plan.tracks import Cells, Tracks, survey_tracks
from auv_mcm.plan.turns import ARC_STEP_RAD, Turns, ends_of
from auv_mcm.records import Contact, Waypoint

HIGHEST_REQUIRED: Final = 0.999  # probability: nearer to 1 no finite number of passes reaches it
BETTER: Final = 1.1  # factor by which a new plan must beat one that is being sailed
_MAX_CELLS: Final = 2000  # planned with; of more cells, every n-th stands for its neighbours
_ON_TRACK_RAD: Final = math.radians(15.0)
_MIN_STEP_M: Final = 1e-3  # m: places nearer than that are one
_KNOWN_LEGS: Final = 40  # legs of the plan before that are tried again; bounds time


class SurveyState(NamedTuple):
    """Hold what is known.

    area: bool, of the shape of the clearance's arrays (see `clearance_over`), cells that must be cleared; required: the
    probability, below 1, with which a mine in each has to be found; mean_required: the mean over the cells that
    suffices, 1 or more for none; performance: what views are worth; contacts: with `next_look_deg` where a view may
    decide.
    """

    clearance: Clearance
    area: NDArray[np.bool_]
    required: float
    performance: LookModel
    contacts: tuple[Contact, ...]
    mean_required: float = 1.0


class PlannedLeg(NamedTuple):
    """Hold a straight run in the mission's plane, settling included. contact_id: "" for survey legs."""

    entry: PlanePose
    exit: PlanePose
    gain_m2: float
    contact_id: str
    why: str


class Plan(msgspec.Struct, frozen=True, kw_only=True):
    """Hold legs in sailing order, and way-points on the globe.

    length_m: track from the vehicle to the end of the last leg. gain_m2: what they gain, square metres of unsearched
    floor made clear; bound_m2: no plan of the candidate legs gains more. verdict: "" for a plan that leads to the
    required clearance as far as it can be foreseen; else "done: ...", or "cannot, because ...", the latter also beside
    a plan that gets only part of the way.
    """

    waypoints: tuple[Waypoint, ...] = ()
    legs: tuple[PlannedLeg, ...] = ()
    length_m: float = 0.0
    gain_m2: float = 0.0
    bound_m2: float = 0.0
    verdict: str = ""


def replan(
    world: SurveyState, pose: PlanePose, limits: Limits, previous: Plan | None, more_time: Callable[[], bool]
) -> Plan:
    """Plan from here.

    The plan improves as long as `more_time` returns true; it is first called when the first legs are known. Equal input
    and equal answers give equal plans. The rest of `previous` is kept unless the new plan gains a tenth more, or as
    much with a tenth less track.

    Raises ValueError for an area whose shape is not the clearance's, or a required probability outside (0,
    HIGHEST_REQUIRED].
    """
    if world.area.shape != world.clearance.looks.shape:
        raise ValueError(
            f"area {world.area.shape} and clearance {world.clearance.looks.shape} are not laid out alike: use "
            "clearance_map.clearance_over"
        )
    if not 0.0 < world.required <= HIGHEST_REQUIRED:
        raise ValueError(f"required probability {world.required} is outside (0, {HIGHEST_REQUIRED}]")
    wanted = -math.log1p(-world.required)
    is_open = world.area & (world.clearance.exponent < NEARLY_ALL * wanted)
    asking = [contact for contact in world.contacts if contact.next_look_deg]
    if not is_open.any() and not asking:
        return Plan(verdict=_done(world))
    if reason := obstacle(pose, limits):
        return Plan(verdict=f"cannot, because {reason}")
    cells = _open_cells(world, is_open, wanted)
    known = _left_of(previous, pose)
    looks = contact_legs(asking, world.clearance, world.performance, limits)
    tracks = survey_tracks(
        cells, world.performance, limits, [(leg.entry, leg.exit) for leg in known if not leg.contact_id], more_time
    )
    problem = _problem(tracks, looks, cells, world.performance, pose, limits)._replace(enough_m2=_enough_m2(world))
    if not problem.tracks.n_legs:
        if not is_open.any():
            verdict = _done(world) + f"; {len(asking)} contacts request a view that no leg can give"
        else:
            verdict = f"cannot, because {_why_nothing(world, cells, is_open, limits)}"
        return Plan(verdict=verdict)
    if problem.tracks.length_m.min() > limits.budget_m:
        return Plan(verdict=_verdict(problem, [], world, is_open))
    found, began = searched(problem, more_time)
    prefixes = [began[:n] for n in sorted({0, len(began) // 2, len(began)})]
    bound_m2 = gain_bound_m2(problem, prefixes)
    problem, route = found.problem, found.route
    kept = _kept_route(problem, known)
    if kept and not _is_better(problem, route, kept):
        route = kept
    plan = _plan(problem, route, looks, world)
    return msgspec.structs.replace(
        plan, bound_m2=max(bound_m2, plan.gain_m2), verdict=_verdict(problem, route, world, is_open)
    )


def _open_cells(world: SurveyState, is_open: NDArray[np.bool_], wanted: float) -> Cells:
    clearance = world.clearance
    row, column = np.nonzero(is_open)
    thin = -(-len(row) // _MAX_CELLS) if len(row) else 1
    if thin > 1:  # of a regular pattern with as many cells in every row and column: the step shares no factor with thin
        step = next(step for step in range(1 + int(math.sqrt(thin)), 2 * thin) if math.gcd(step, thin) == 1)
        at = np.flatnonzero((column + row * step) % thin == 0)
        row, column = row[at], column[at]
    share = np.count_nonzero(is_open) / max(len(row), 1)
    at_cell = row, column
    return Cells(
        east_m=np.asarray((column + clearance.first_east + 0.5) * clearance.cell_m, dtype=np.float64),
        north_m=np.asarray((row + clearance.first_north + 0.5) * clearance.cell_m, dtype=np.float64),
        need=wanted - clearance.exponent[at_cell],
        weight_m2=share * clearance.cell_m**2 / -np.expm1(-wanted) * np.exp(-clearance.exponent[at_cell]),
        looked=clearance.looks[at_cell] > 0,
        towards=clearance.towards[at_cell],
        seabed=clearance.seabed[at_cell],
        ripple_rad=clearance.ripple_rad[at_cell],
        unevenness_db=clearance.unevenness_db[at_cell],
        cell_m=clearance.cell_m,
    )


def _enough_m2(world: SurveyState) -> float:
    """Compute what is still to be gained for the mean that is required."""
    if world.mean_required >= 1.0:
        return math.inf
    p = world.clearance.p_detected[world.area]
    return max(world.mean_required - float(p.mean()), 0.0) * p.size * world.clearance.cell_m**2 / world.required


def _problem(
    tracks: Tracks, looks: list[ContactLegs], cells: Cells, model: LookModel, pose: PlanePose, limits: Limits
) -> Problem:
    """Pose the problem: survey legs, then legs past contacts."""
    n_survey = tracks.n_legs
    n_sides = [len(look.runs) for look in looks]
    n = n_survey + sum(n_sides)
    nothing = np.zeros(n - n_survey, dtype=np.int64)
    other_side = np.arange(n)
    leg = n_survey
    for sides in n_sides:
        if sides == 2:
            other_side[[leg, leg + 1]] = leg + 1, leg
        leg += sides
    everything = tracks._replace(
        run=np.concatenate([tracks.run, *(look.runs for look in looks)]),
        first=np.append(tracks.first, nothing),
        last=np.append(tracks.last, nothing),
        line=np.append(tracks.line, nothing - 1),
        heading=np.append(tracks.heading, nothing - 1),
    )
    gain = np.append(np.zeros(n_survey), np.repeat([look.gain_m2 for look in looks], n_sides))
    return Problem(everything, gain, other_side, cells, model, pose, limits, Turns(pose, limits))


def _left_of(previous: Plan | None, pose: PlanePose) -> list[PlannedLeg]:
    """List legs left of the plan before; of one that is being sailed, what lies ahead."""
    if previous is None:
        return []
    legs = list(previous.legs[:_KNOWN_LEGS])
    for place, leg in enumerate(legs):
        sine, cosine = math.sin(leg.entry.heading_rad), math.cos(leg.entry.heading_rad)
        east, north = pose.east_m - leg.entry.east_m, pose.north_m - leg.entry.north_m
        along, beside = east * sine + north * cosine, east * cosine - north * sine
        turned = abs(math.remainder(pose.heading_rad - leg.entry.heading_rad, 2.0 * math.pi))
        length = math.hypot(leg.exit.east_m - leg.entry.east_m, leg.exit.north_m - leg.entry.north_m)
        if 0.0 < along < length and abs(beside) < 2.0 and turned < _ON_TRACK_RAD:
            ahead = PlanePose(
                leg.entry.east_m + along * sine, leg.entry.north_m + along * cosine, leg.entry.heading_rad
            )
            return [leg._replace(entry=ahead), *legs[place + 1 :]]
    return legs


def _kept_route(problem: Problem, known: list[PlannedLeg]) -> list[int]:
    """Keep legs of the plan before that can be sailed and still gain something."""
    runs = problem.tracks.run
    route: list[int] = []
    wanting = Wanting(problem)
    for leg in known:
        ends = np.array([leg.entry[:2], leg.exit[:2]])
        for way in (0, 1):
            there = runs[:, :: 1 - 2 * way, :2]
            match = (
                np.flatnonzero(np.abs(there - ends).max(axis=(1, 2), initial=0.0) < 0.01)
                if len(runs)
                else np.empty(0, dtype=int)
            )
            if len(match):
                number = int(match[-1])
                if wanting.gain_m2(number) > 1e-6:
                    wanting.take(number)
                    route.append(2 * number + way)
                break
    return sailable(problem, route)


def _is_better(problem: Problem, route: list[int], kept: list[int]) -> bool:
    gain, kept_gain = (worth_m2(problem, (way // 2 for way in ways)) for ways in (route, kept))
    if gain >= BETTER * kept_gain:
        return True
    return gain >= 0.999 * kept_gain and BETTER * route_length_m(problem, route) <= route_length_m(problem, kept)


def _plan(problem: Problem, route: list[int], looks: list[ContactLegs], world: SurveyState) -> Plan:
    """Make a plan with words of the route."""
    frame = LocalFrame(
        latitude_deg=world.clearance.origin_latitude_deg, longitude_deg=world.clearance.origin_longitude_deg
    )
    cells, tracks = problem.cells, problem.tracks
    of_leg = dict(
        zip(np.flatnonzero(tracks.heading < 0).tolist(), (look for look in looks for _ in look.runs), strict=True)
    )
    wanting = Wanting(problem)
    legs: list[PlannedLeg] = []
    points: list[tuple[PlanePose, int, str]] = []  # pose, number of the leg, kind
    pose, length_m = problem.pose, 0.0
    for number, way in enumerate(route, start=1):
        entry, leave = ends_of(tracks, way)
        leg = way // 2
        gain = wanting.gain_m2(leg)
        if leg in of_leg:
            contact_id, why = of_leg[leg].contact.id, contact_words(of_leg[leg])
        else:
            part, gained = wanting.per_cell(leg)
            cell, gained = tracks.cell[part][gained > 0.0], gained[gained > 0.0]
            contact_id, why = (
                "",
                survey_words(entry.heading_rad, gained, cells.seabed[cell], cells.ripple_rad[cell], cells.looked[cell]),
            )
        wanting.take(leg)
        legs.append(PlannedLeg(entry, leave, gain, contact_id, why))
        path = problem.turns.between(pose, entry)
        assert path is not None
        if not points:
            points.append((pose, number, "start"))
        turn = sample_path(path, ARC_STEP_RAD)
        steps = np.hypot(*np.diff(turn[:, :2], axis=0).T)
        away = np.hypot(*(turn[1:, :2] - entry[:2]).T)
        points += [
            (PlanePose(*place), number, "turn")
            for place in turn[1:][(steps > _MIN_STEP_M) & (away > _MIN_STEP_M)].tolist()
        ]
        points += [(entry, number, "leg_entry"), (leave, number, "leg_exit")]
        length_m += path.length_m + float(tracks.length_m[leg])
        pose = leave
    latitude, longitude, course = on_the_globe(np.array([place for place, _, _ in points]).reshape(-1, 3), frame)
    waypoints = tuple(
        Waypoint(
            leg=number,
            kind=kind,
            latitude_deg=float(latitude[at]),
            longitude_deg=float(longitude[at]),
            heading_rad=float(course[at]),
            contact_id=legs[number - 1].contact_id,
            why={"start": "where the plan starts", "turn": f"turn towards leg {number}"}.get(
                kind, legs[number - 1].why
            ),
        )
        for at, (_, number, kind) in enumerate(points)
    )
    return Plan(waypoints=waypoints, legs=tuple(legs), length_m=length_m, gain_m2=sum(leg.gain_m2 for leg in legs))


def _done(world: SurveyState) -> str:
    if not world.area.any():
        return "done: there is no area to clear and no contact that requests a view"
    return (
        f"done: required clearance of {required_words(world.required)} reached in all of "
        f"{area_words(world.area.sum() * world.clearance.cell_m**2)}"
    )


def _why_nothing(world: SurveyState, cells: Cells, is_open: NDArray[np.bool_], limits: Limits) -> str:
    not_clear = area_words(np.count_nonzero(is_open) * cells.cell_m**2)
    best = float(world.clearance.p_detected[world.area].mean())
    without = survey_tracks(cells, world.performance, limits._replace(fence=None), [], lambda: True)
    if not without.n_legs:
        reason = "the sonar finds nothing on such a sea floor"
    else:
        reason = "no straight leg over it with room for a turn at both ends fits into the fence"
    return (
        f"{not_clear} are not clear and no leg adds to that: {reason}. The best that can be reached is {best:.2f} on "
        "average"
    )


def _verdict(problem: Problem, route: list[int], world: SurveyState, is_open: NDArray[np.bool_]) -> str:
    """State the verdict; empty if the route, or legs that a later plan may sail, get all that is wanted."""
    cells, tracks, budget_m = problem.cells, problem.tracks, problem.limits.budget_m
    if not route:
        shortest_m = float(tracks.length_m.min())
        return (
            f"cannot, because no leg can be reached and sailed inside the fence with {budget_m:.0f} m of track; "
            f"the shortest alone takes {shortest_m:.0f} m"
        )
    renewed = np.where(cells.looked, 1.0 - problem.model.other_look_correlation, 1.0)
    max_added = np.bincount(tracks.cell, tracks.exponent * renewed[tracks.cell], len(cells.need))
    never = max_added < NEARLY_ALL * cells.need
    if never.any():
        wanted = -math.log1p(-world.required)
        n_clear, share = np.count_nonzero(world.area & ~is_open), np.count_nonzero(is_open) / len(cells.need)
        reach = -np.expm1(-(wanted - cells.need + np.minimum(max_added, cells.need)))
        mean = (n_clear * world.required + share * float(reach.sum())) / (n_clear + share * len(reach))
        short_m2, area_m2 = (n * cells.cell_m**2 for n in (share * np.count_nonzero(never), world.area.sum()))
        return (
            f"cannot, because {area_words(short_m2)} of {area_words(area_m2)} cannot be brought to "
            f"{required_words(world.required)} by any leg; the best that can be reached is {mean:.2f} on average and "
            f"{float(reach.min()):.2f} in the worst cell"
        )
    wanting_m2, gain_m2 = wanting_m2_of(problem), worth_m2(problem, (way // 2 for way in route))
    further_m = float(np.median(tracks.length_m)) + 2.0 * math.pi * problem.turns.radius_m
    if gain_m2 < NEARLY_ALL * wanting_m2 and route_length_m(problem, route) + further_m > budget_m:
        return f"cannot, because {budget_m:.0f} m of track suffice for {gain_m2 / wanting_m2:.0%} of what is wanting"
    return ""
