"""Measure how far the chain is from what could be had at all, step by step, and what a second view adds.

auv-mcm bench limit                               flies, judges and prints
auv-mcm bench limit --without-observer            the second view alone

Each named scene is flown along its own legs and then at right angles to them. On the pings of the first pass stands
beside the chain an observer who knows floor, pose and the law of speckle (`sim_replay/simulator/ideal_observer.py`):
what it misses is not in the data.

False alarms are rocks and whatever lies on no object; what is on other clutter counts neither way, since the observer
is not asked about it. For the observer, those on bare floor are bounded: no statistic of a likelihood ratio exceeds t
nats by chance more often than in exp(-t) of the places and hypotheses tried.
"""

from __future__ import annotations

import argparse
import gc
import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Final, NamedTuple, get_args

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.classify.fusion import fused_ratio
from auv_mcm.classify.odds import shipped_odds
from auv_mcm.records import LookStep
from sim_replay.arguments import count
from sim_replay.benches.flown_twice import (
    NOTHING_NATS,
    JudgedContact,
    Passes,
    TwiceFlown,
    first_poses,
    fly_twice,
    lawnmower_of,
    sorted_flight,
)
from sim_replay.benches.progress import counted
from sim_replay.fitting.cascade.farm import Farm, run_tasks
from sim_replay.missions import SCENES
from sim_replay.scoring.intervals import proportion
from sim_replay.scoring.thresholds import called_at, threshold_at
from sim_replay.simulator.ideal_observer import IdealObserver, log_mean_exp, mine_library, rock_library
from sim_replay.simulator.objects import PlacedObject
from sim_replay.simulator.plan import planned_legs, swath_m
from sim_replay.simulator.scene import Scene
from sim_replay.simulator.scene_file import read_scene
from sim_replay.simulator.sea import Sea
from sim_replay.text_tables import NOTHING, columns, markdown, share_cell

Floats = NDArray[np.float64]

FIRST_SEED: Final = 9700  # on seeds from here on nothing was fitted or tried before this bench
LIMITS_PER_KM2: Final = (10.0, 100.0, 300.0)  # false alarms per km² at which Pd is printed
ROCKS_PD: Final = 0.9  # Pd at which the share of rocks that are called is printed
EASY: Final = ("flat", "ripple", "mixed")  # scenes on which the share of rocks called is aimed for
TRIES_PER_KM2: Final = 6e9
"""Hypotheses tried per km²: a place every 8 cm across and 20 cm along the track, as far as pictures differ there, and
100 kinds, sizes and directions at each. A hundred times as many move the threshold by 4.6 nats."""
ROCKS_PER_KM2: Final = 300.0  # rocks of a mine's size in the named scenes, about
BETTER: Final = "the more mine-like view alone"
SHIPPED: Final = "as shipped: a fifth of the other beside it"
DEPENDENT: Final = "the sum over 1 + rho, rho fitted"
INDEPENDENT: Final = "the sum, as if independent"
RULES: Final = (BETTER, SHIPPED, DEPENDENT, INDEPENDENT)
_N_ROCKS: Final = (
    16  # other rocks that the observer knows per place; chosen for the run time: more of them can only help
)
_N_EMPTY: Final = 24  # places without an object per mission where the observer tries one of the mission's targets
_APART_M: Final = 8.0  # m from such a place to any object, minimum
_STREAM: Final = 0x4C494D49  # keeps these random numbers apart from others of the same seed


class Evidence(NamedTuple):
    """Hold what the observer makes of one object, nats.

    mine: for some mine of its library, at a target the one there among them, against bare floor. rock: for some rock of
    its library, never the one there, against bare floor. exact: for what really lies there against bare floor.
    """

    mine: float
    rock: float
    exact: float

    @property
    def mine_alone(self) -> float:
        """Weigh a mine against bare floor and rocks, each as dense as it is: the ratio that finds most at any limit."""
        return self.mine - float(np.logaddexp(0.0, self.rock + math.log(ROCKS_PER_KM2 / TRIES_PER_KM2)))


class Flight(NamedTuple):
    """Hold a mission flown twice, and what the observer makes of its first pass.

    evidence: by index of object, of targets and rocks that the first pass saw; empty if the observer was left out.
    bare: ratios of targets tried where nothing lies, (n,) nats.
    """

    flown: TwiceFlown
    evidence: dict[int, Evidence]
    bare: tuple[float, ...]


class Task(NamedTuple):
    """Name a scene and a seed, and whether the observer takes part."""

    scene: str
    seed: int
    with_observer: bool


class Scores(NamedTuple):
    """Hold what a system gives to targets, and to what counts as a false alarm, in nats; NOTHING_NATS for none."""

    targets: Floats
    false_alarms: Floats
    area_km2: float
    tries_per_km2: float = 0.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `auv-mcm bench limit`."""
    parser.add_argument("--seeds", type=count, default=1, help="missions per scene (default 1)")
    parser.add_argument(
        "--first-seed", type=count, default=FIRST_SEED, help=f"seed of each first mission (default {FIRST_SEED})"
    )
    parser.add_argument(
        "--scenes", help="scenes by name, with commas between (default: the ten that rates are taken on)"
    )
    parser.add_argument("--without-observer", action="store_true", help="leave the observer out")
    parser.add_argument("--workers", type=count, default=2, help="missions flown at once (default 2)")
    parser.add_argument("--markdown", action="store_true", help="print tables in Markdown")


def run(arguments: argparse.Namespace) -> int:
    """Fly, judge and print; returns the exit code. Raises UsageError for scenes that are not there."""
    names = SCENES if arguments.scenes is None else tuple(arguments.scenes.split(","))
    for name in names:
        lawnmower_of(read_scene(name))
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    tasks = [Task(name, seed, not arguments.without_observer) for name in names for seed in seeds]
    flights = list(run_tasks(fly, tasks, Farm(arguments.workers), counted(len(tasks))))
    print(report(flights, in_markdown=arguments.markdown))
    return 0


def fly(task: Task) -> Flight:
    """Fly one mission twice, and let the observer judge its first pass."""
    gc.collect()  # a mission refers to itself: the sea floor of the one before, 300 MB, would stay for long
    scene = msgspec.structs.replace(read_scene(task.scene), seed=task.seed)
    return observed(scene, sorted_flight(scene, *fly_twice(scene)), with_observer=task.with_observer)


def observed(scene: Scene, flown: TwiceFlown, *, with_observer: bool = True) -> Flight:
    """Let the observer judge the first pass of a mission; a synthetic aperture has none."""
    if not with_observer or scene.sonar.synthetic_aperture is not None:
        return Flight(flown, {}, ())
    sea = Sea(scene)
    observer = IdealObserver(sea, first_poses(scene, sea))
    evidence = {
        index: weighed(observer, sea.objects[one.number])
        for index, one in enumerate(flown.objects)
        if one.seen_first and (one.is_target or one.kind == "rock")
    }
    bare = [float(observer.log_ratios(tried, [tried])[0]) for tried in _at_empty_places(scene, sea, observer)]
    return Flight(flown, evidence, tuple(bare))


def weighed(observer: IdealObserver, place: PlacedObject) -> Evidence:
    """Let the observer judge what lies at a place, without knowing what it is."""
    mines, rocks = mine_library(place), rock_library(place, _N_ROCKS)
    ratios = observer.log_ratios(place, [place, *mines, *rocks])
    exact, library, stones = float(ratios[0]), ratios[1 : 1 + len(mines)], ratios[1 + len(mines) :]
    return Evidence(log_mean_exp([exact, *library] if place.is_target else library), log_mean_exp(stones), exact)


def _at_empty_places(scene: Scene, sea: Sea, observer: IdealObserver) -> Iterator[PlacedObject]:
    """Draw places that were seen and where nothing lies, and put one of the scene's targets there in thought."""
    random = np.random.Generator(np.random.PCG64(np.random.SeedSequence([scene.seed, _STREAM])))
    targets = [one for one in sea.objects if one.is_target]
    legs, farthest_m = planned_legs(scene.track.plan), 0.9 * swath_m(scene)
    n_left = _N_EMPTY if targets else 0
    while n_left:
        leg = legs[int(random.integers(len(legs)))]
        across = float(random.uniform(0.2, 1.0)) * farthest_m * (1.0 if random.uniform() < 0.5 else -1.0)
        east, north = leg.at(float(random.uniform(0.0, leg.length_m)), across)
        target = targets[int(random.integers(len(targets)))]
        tried = target._replace(east_m=east, north_m=north)
        is_empty = all(math.hypot(east - o.east_m, north - o.north_m) >= _APART_M + o.reach_m for o in sea.objects)
        if is_empty and any(True for _ in observer.passages(tried)):
            n_left -= 1
            yield tried


def pd_count(scores: Scores, limit_per_km2: float) -> int:
    """Count the targets above the lowest threshold with no more false alarms than allowed."""
    return int(np.count_nonzero(_above(scores, limit_per_km2)))


def chain_scores(
    flights: Sequence[Flight],
    log_odds_of: Callable[[JudgedContact], float | None],
    *,
    passes: Passes = "first",
    rocks_count: bool = True,
) -> Scores:
    """Collect the log-odds of the chain: the best contact of each target that those passes saw, and of each rock.

    log_odds_of: None where those passes have no contact.
    """
    targets, false_alarms = [], []
    for flight in flights:
        on_object: dict[int, float] = {}
        for contact in flight.flown.contacts:
            log_odds = log_odds_of(contact)
            if log_odds is None:
                continue
            if contact.on < 0:
                false_alarms.append(log_odds)
            else:
                on_object[contact.on] = max(on_object.get(contact.on, NOTHING_NATS), log_odds)
        for index, one in enumerate(flight.flown.objects):
            if one.is_target and _was_seen(one.seen_first, one.seen_second, passes):
                targets.append(on_object.get(index, NOTHING_NATS))
            elif one.kind == "rock" and rocks_count and index in on_object:
                false_alarms.append(on_object[index])
    return Scores(np.array(targets), np.array(false_alarms), sum(flight.flown.area_km2 for flight in flights))


def _was_seen(first: bool, second: bool, passes: Passes) -> bool:
    return {"first": first, "second": second, "both": first and second}[passes]


def observer_scores(flights: Sequence[Flight], value_of: Callable[[Evidence], float], *, rocks_count: bool) -> Scores:
    """Collect the observer's ratios of targets and rocks that the first pass saw."""
    targets: list[float] = []
    rocks: list[float] = []
    for flight in flights:
        for index, evidence in flight.evidence.items():
            (targets if flight.flown.objects[index].is_target else rocks).append(value_of(evidence))
    area_km2 = sum(flight.flown.area_km2 for flight in flights)
    return Scores(np.array(targets), np.array(rocks if rocks_count else []), area_km2, TRIES_PER_KM2)


def rocks_called(flights: Sequence[Flight], log_odds_of: Callable[[JudgedContact], float | None]) -> tuple[int, int]:
    """Count the rocks called where ROCKS_PD of the targets are, and all rocks; both of what both passes saw."""
    best: dict[bool, list[float]] = {True: [], False: []}
    for flight in flights:
        on_object: dict[int, float] = {}
        for contact in flight.flown.contacts:
            log_odds = log_odds_of(contact)
            if contact.on >= 0 and log_odds is not None:
                on_object[contact.on] = max(on_object.get(contact.on, NOTHING_NATS), log_odds)
        for index, one in enumerate(flight.flown.objects):
            if (one.is_target or one.kind == "rock") and one.seen_first and one.seen_second:
                best[one.is_target].append(on_object.get(index, NOTHING_NATS))
    if not best[True]:
        return 0, len(best[False])
    called = called_at(best[True], best[False], ROCKS_PD, NOTHING_NATS)
    n_called = sum(score > NOTHING_NATS for score in best[False]) if called is None else called.count
    return n_called, len(best[False])


def correlations(flights: Sequence[Flight]) -> dict[str, tuple[int, float]]:
    """Compute the correlation of two passes' evidence about one object, and the number of pairs, by what it is of."""
    pairs: dict[str, list[tuple[float, float]]] = {"targets": [], "rocks": [], "bare floor": []}
    for flight in flights:
        for contact in flight.flown.contacts:
            if not np.isfinite(contact.ratios).all():
                continue
            one = flight.flown.objects[contact.on] if contact.on >= 0 else None
            name = "bare floor" if one is None else "targets" if one.is_target else f"{one.kind}s"
            if name in pairs:
                pairs[name].append(contact.ratios)
    return {
        name: (len(some), float(np.corrcoef(np.array(some).T)[0, 1]) if len(some) > 2 else math.nan)
        for name, some in pairs.items()
    }


def fused_nats(rule: str, first: float, second: float, rho: float) -> float:
    """Fuse the evidence of two passes, nats, by one of RULES; where one is NaN, the other stands alone."""
    if math.isnan(first) or math.isnan(second):
        return second if math.isnan(first) else first
    if rule == SHIPPED:
        return fused_ratio([first, second], [0.0, 90.0])
    if rule == BETTER:
        return max(first, second)
    return (first + second) / (1.0 + (rho if rule == DEPENDENT else 0.0))


def log_loss(flights: Sequence[Flight], rule: str, rho: float) -> tuple[float, int]:
    """Add up the log-loss of contacts that both passes saw, nats, and count them.

    The truth is whether it is a target.
    """
    ratios, is_mine = _pairs(flights)
    fused = np.array([fused_nats(rule, first, second, rho) for first, second in ratios.tolist()])
    return _total_loss(fused, is_mine), len(fused)


def dependence(flights: Sequence[Flight]) -> float:
    """Fit rho, 0 to 1, of views with equal errors that all depend on each other alike.

    The log-likelihood ratio of n such views is their sum over 1 + (n - 1) rho.
    """
    ratios, is_mine = _pairs(flights)
    tried: list[float] = np.linspace(0.0, 1.0, 21).tolist()
    return min(tried, key=lambda rho: _total_loss(ratios.sum(axis=1) / (1.0 + rho), is_mine))


def _pairs(flights: Sequence[Flight]) -> tuple[Floats, NDArray[np.bool_]]:
    """Collect the evidence of both passes, (n, 2) nats, about what both saw, and whether it is a target, (n,)."""
    pairs = [
        (contact.ratios, contact.on >= 0 and flight.flown.objects[contact.on].is_target)
        for flight in flights
        for contact in flight.flown.contacts
        if np.isfinite(contact.ratios).all()
    ]
    ratios = np.array([pair for pair, _ in pairs], dtype=np.float64).reshape(-1, 2)
    return ratios, np.array([is_mine for _, is_mine in pairs], dtype=np.bool_)


def _total_loss(fused: Floats, is_mine: NDArray[np.bool_]) -> float:
    odds = shipped_odds("cascade").prior + fused
    return float(np.logaddexp(0.0, np.where(is_mine, -odds, odds)).sum())


def report(flights: Sequence[Flight], *, in_markdown: bool = False) -> str:
    """Lay out what could be had, what is lost, and what a second view adds."""
    laid_out = markdown if in_markdown else columns
    groups = {
        name: [flight for flight in flights if flight.flown.scene == name]
        for name in dict.fromkeys(flight.flown.scene for flight in flights)
    }
    if len(groups) > 1:
        easy = [flight for flight in flights if flight.flown.scene in EASY]
        if {flight.flown.scene for flight in easy} == set(EASY):
            groups[", ".join(EASY)] = easy
        groups["all"] = list(flights)
    parts = ["Intervals are 95 %, Wilson's.\n"]
    if any(flight.evidence for flight in flights):
        watched = {name: [one for one in some if one.evidence] for name, some in groups.items()}
        watched = {name: some for name, some in watched.items() if some}
        parts += [
            laid_out(_LIMIT_HEADER, [row for name, some in watched.items() for row in _limit_rows(name, some)]),
            "",
            _bare_words([ratio for flight in flights for ratio in flight.bare]),
            "",
        ]
    parts += [
        laid_out(_VIEWS_HEADER, [row for name, some in groups.items() for row in _view_rows(name, some)]),
        "",
        laid_out(_TOGETHER_HEADER, list(_together_rows(flights))),
    ]
    if len({flight.flown.scene for flight in flights}) > 1:
        parts += ["", laid_out(_RULE_HEADER, list(_rule_rows(flights)))]
    return "\n".join(parts)


_LIMIT_HEADER: Final = (
    "scene",
    "FA/km²",
    "targets",
    "observer, no rocks counted",
    "observer",
    "observer who knows no rocks",
    "any contact",
    *("detector's odds", "+ contours", "p_mine"),
    "lost: no contact",
    "lost: odds too low",
)
_VIEWS_HEADER: Final = (
    "scene",
    "views",
    "targets",
    *(f"Pd at {limit:g} FA/km²" for limit in (10.0, 30.0, 100.0, 300.0)),
    *(f"at {limit:g} not on rocks" for limit in LIMITS_PER_KM2[:2]),
    f"rocks called at Pd {ROCKS_PD:g}",
)
_TOGETHER_HEADER: Final = ("views of", "pairs", "correlation of their evidence")
_RULE_HEADER: Final = (
    "rule, each scene judged by what the others give",
    "contacts seen twice",
    "log-loss",
    *(f"Pd at {limit:g} FA/km²" for limit in (10.0, 30.0, 100.0)),
    f"rocks called at Pd {ROCKS_PD:g}",
)


def _limit_rows(name: str, flights: Sequence[Flight]) -> Iterator[list[str]]:
    bare = observer_scores(flights, lambda evidence: evidence.mine, rocks_count=False)
    alone = observer_scores(flights, lambda evidence: evidence.mine, rocks_count=True)
    whole = observer_scores(flights, lambda evidence: evidence.mine_alone, rocks_count=True)
    steps = [chain_scores(flights, partial(_after, step=step)) for step in get_args(LookStep)]
    final = chain_scores(flights, partial(_from_passes, passes="first"))
    placed = final.targets > NOTHING_NATS
    for per_km2 in LIMITS_PER_KM2:
        could = _above(whole, per_km2)
        shares = [
            _above(bare, per_km2),
            could,
            _above(alone, per_km2),
            placed,
            *(_above(scores, per_km2) for scores in steps),
            could & ~placed,
            could & placed & ~_above(final, per_km2),
        ]
        cells = (share_cell(proportion(int(np.count_nonzero(share)), len(placed))) for share in shares)
        yield [name, f"{per_km2:g}", str(len(placed)), *cells]


def _above(scores: Scores, per_km2: float) -> NDArray[np.bool_]:
    return np.asarray(scores.targets > threshold(scores, per_km2), dtype=np.bool_)


def threshold(scores: Scores, limit_per_km2: float) -> float:
    """Find the lowest threshold, nats, above which there are no more false alarms than allowed."""
    return threshold_at(
        scores.false_alarms,
        limit_per_km2 * scores.area_km2,
        n_tries=scores.tries_per_km2 * scores.area_km2,
        nothing=NOTHING_NATS,
    )


def _after(contact: JudgedContact, step: LookStep) -> float | None:
    return contact.by_step.get(step)


def _from_passes(contact: JudgedContact, passes: Passes) -> float | None:
    return contact.log_odds.get(passes)


def _bare_words(ratios: Sequence[float]) -> str:
    if not ratios:
        return "No target was tried on bare floor."
    return (
        f"Targets tried at {len(ratios)} places without an object: {np.mean(ratios):.0f} nats on average, "
        f"{max(ratios):.1f} at most."
    )


def _view_rows(name: str, flights: Sequence[Flight]) -> Iterator[list[str]]:
    words: dict[Passes, str] = {"first": "one, along", "second": "one, across", "both": "both"}
    for passes, views in words.items():
        scores = [
            chain_scores(
                flights,
                partial(_from_passes, passes=passes),
                passes="both",
                rocks_count=rocks_count,
            )
            for rocks_count in (True, False)
        ]
        n = len(scores[0].targets)
        pds = [pd_count(scores[0], limit) for limit in (10.0, 30.0, 100.0, 300.0)]
        pds += [pd_count(scores[1], limit) for limit in LIMITS_PER_KM2[:2]]
        rocks = rocks_called(flights, partial(_from_passes, passes=passes))
        yield [name, views, str(n), *(share_cell(proportion(k, n)) for k in pds), share_cell(proportion(*rocks))]


def _together_rows(flights: Sequence[Flight]) -> Iterator[list[str]]:
    for name, (n, correlation) in correlations(flights).items():
        yield [name, str(n), NOTHING if math.isnan(correlation) else f"{correlation:.2f}"]


def _rule_rows(flights: Sequence[Flight]) -> Iterator[list[str]]:
    names = list(dict.fromkeys(flight.flown.scene for flight in flights))
    if len(names) < 2:
        return
    rho_of = {name: dependence([one for one in flights if one.flown.scene != name]) for name in names}
    for rule in RULES:
        losses = [
            log_loss([one for one in flights if one.flown.scene == name], rule, rho) for name, rho in rho_of.items()
        ]
        n = sum(count for _, count in losses)
        judged = [_fused(flight, rule, rho_of[flight.flown.scene]) for flight in flights]
        scores = chain_scores(judged, _of_both, passes="both")
        low, high = min(rho_of.values()), max(rho_of.values())
        yield [
            f"{rule} ({low:.2f} to {high:.2f})" if rule == DEPENDENT else rule,
            str(n),
            f"{sum(loss for loss, _ in losses) / max(n, 1):.3f}",
            *(share_cell(proportion(pd_count(scores, limit), len(scores.targets))) for limit in (10.0, 30.0, 100.0)),
            share_cell(proportion(*rocks_called(judged, _of_both))),
        ]


def _of_both(contact: JudgedContact) -> float:
    return contact.log_odds["both"]


def _fused(flight: Flight, rule: str, rho: float) -> Flight:
    """Weigh all contacts of a flight by a rule."""
    contacts = tuple(
        contact._replace(log_odds={"both": fused_nats(rule, *contact.ratios, rho)}) for contact in flight.flown.contacts
    )
    return flight._replace(flown=flight.flown._replace(contacts=contacts))
