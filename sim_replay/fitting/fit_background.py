"""Fit how a mission's background of non-mines scores, from mission to mission: `auv-mcm calibrate background`.

Simulated missions over the named scenes, but for those held out, are flown with seeds that the odds were not fitted on:
on their own missions odds are too good. The truth says which contacts are mines. Mean and covariance of the
background's log-density follow by expectation maximization over missions; as scenes are few, the covariance is drawn to
a smooth one. Each scene is judged by the prior that the others give.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple, TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.contacts.background import (
    BIN_NATS,
    KNOTS_NATS,
    LEVELS_NATS,
    LOWEST_P_MINE,
    BackgroundModel,
    BackgroundPrior,
    LeftOutScene,
    ReachedPoint,
    counted_log_odds,
    known_background,
)
from auv_mcm.contacts.expected_alarms import called_from_nats
from auv_mcm.contacts.seen_area import SeenArea
from auv_mcm.errors import UsageError
from auv_mcm.model_file import NONE
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import Contact, CoveragePatch, Detector
from auv_mcm.settings.config import Config
from sim_replay.fitting.cascade.farm import Farm, run_tasks
from sim_replay.fitting.theatre import USUAL, Theatre
from sim_replay.flights import Flight, flight_along, flight_through, fly_through
from sim_replay.missions import served_by
from sim_replay.scoring.inputs import ScoredMission, Truth, as_reported, parse_truth
from sim_replay.scoring.layout import Outcome, lay_out, states
from sim_replay.scoring.score import GATE_M
from sim_replay.simulator.scene import Scene
from sim_replay.simulator.scene_file import read_scene

Array = NDArray[np.float64]
Task: TypeAlias = tuple[str, int, Detector]

FIRST_SEED: Final = 1500  # odds, gate, cascade and performance were fitted on others, and rates are taken from 9100 on
ASKED_PER_KM2: Final = (30.0, 100.0, 300.0)  # false alarms per km² that the left-out scene is judged at
_SMOOTH_SD: Final = 1.0  # of the logarithm of the density from mission to mission: that of the ten scenes is 0.8 to 1.2
_SMOOTH_NATS: Final = 2.5  # over which densities go together
_SMOOTH_MISSIONS: Final = 4.0  # that the smooth covariance is worth
_STEPS: Final = 40  # of expectation and maximisation
_MIN_VARIANCE: Final = 1e-3  # of the prior along any axis, so that no scene is certain
_DIGITS: Final = 4  # decimals in the file


class SortedContacts(NamedTuple):
    """Hold the contacts of one mission sorted by what they are, as log-odds.

    everything: (n,) all contacts; background: (k,) those on no target; mines: (m,) those on targets. n_targets: that a
    pass saw. area_km2: as the payload itself knows it; truth_km2: as the truth has it. on_objects: (k,) bool,
    background on an object of the truth.
    """

    scene: str
    everything: Array
    background: Array
    mines: Array
    n_targets: int
    area_km2: float
    truth_km2: float
    on_objects: NDArray[np.bool_]


def sorted_contacts(scene: str, contacts: Sequence[Contact], truth: Truth, area_km2: float) -> SortedContacts:
    """Sort contacts by the truth, matched as `auv-mcm score` matches them."""
    reported = as_reported(contacts, scene)
    layout = lay_out(ScoredMission(reported, truth, scene), GATE_M)
    outcome = np.full(len(layout.contacts), int(Outcome.NOT_CALLED))
    for state in states(layout):
        outcome = state.outcome
    is_background = np.isin(outcome, (Outcome.ON_CLUTTER, Outcome.ELSEWHERE))
    placed = log_odds_of([contact.p_mine for contact in layout.contacts])
    return SortedContacts(
        scene=scene,
        everything=log_odds_of([contact.p_mine for contact in reported]),
        background=placed[is_background],
        mines=placed[outcome == Outcome.DETECTION],
        n_targets=int(np.count_nonzero(layout.is_target & layout.is_seen)),
        area_km2=area_km2,
        truth_km2=truth.area_km2,
        on_objects=outcome[is_background] == Outcome.ON_CLUTTER,
    )


def log_odds_of(p_mine: Sequence[float]) -> Array:
    """Compute log-odds, (n,), of probabilities; 0 and 1 become 1e-9 and what is as near to 1."""
    p = np.clip(np.asarray(p_mine, dtype=np.float64), 1e-9, 1.0 - 1e-9)
    return np.asarray(np.log(p) - np.log1p(-p))


def flown(task: Task, theatre: Theatre = USUAL) -> SortedContacts:
    """Fly one mission through a scene, with a seed and a detector, and sort its contacts."""
    name, seed, detector = task
    return flown_scene(name, msgspec.structs.replace(read_scene(name), seed=seed), detector, theatre)


def flown_scene(name: str, scene: Scene, detector: Detector, theatre: Theatre = USUAL) -> SortedContacts:
    """Fly a mission of a domain and sort its contacts."""
    flight = flight_through(*theatre.carried(scene, scene.seed))
    return _sorted(name, flight, _reporting_all(served_by(detector, flight.config)))


def flown_along(log: Path, seed: int) -> SortedContacts:
    """Embed targets and rocks drawn by a seed in a recorded line, replay it, and sort its contacts."""
    with flight_along(log, seed) as flight:
        return _sorted(log.stem, flight, flight.config)


def _sorted(name: str, flight: Flight, config: Config) -> SortedContacts:
    pipeline, area = Pipeline(config), SeenArea()
    fly_through(flight.events, {name: pipeline}, lambda one: area.add(one) if isinstance(one, CoveragePatch) else None)
    return sorted_contacts(name, pipeline.contacts, parse_truth(flight.truth(), name), area.km2)


def _reporting_all(config: Config) -> Config:
    """Lower both thresholds of p_mine to where the model of the background begins."""
    return msgspec.structs.replace(
        config,
        contacts=msgspec.structs.replace(config.contacts, min_p_mine=LOWEST_P_MINE),
        confirm=msgspec.structs.replace(config.confirm, min_p_mine=LOWEST_P_MINE),
    )


def fit_prior(missions: Sequence[SortedContacts]) -> BackgroundPrior:
    """Fit a prior to missions with known truth.

    Raises UsageError for missions without contacts on mines or without area.
    """
    mines = np.concatenate([mission.mines for mission in missions]) if missions else np.empty(0)
    area_km2 = sum(mission.area_km2 for mission in missions)
    if len(mines) < 2 or area_km2 <= 0.0:
        raise UsageError(
            f"{len(missions)} missions with {len(mines)} contacts on mines are too few to fit on. Fly more, with "
            "--seeds"
        )
    counts = [counted_log_odds(mission.background) for mission in missions]
    smooth = _SMOOTH_SD**2 * np.exp(-np.abs(KNOTS_NATS[:, np.newaxis] - KNOTS_NATS) / _SMOOTH_NATS)
    pooled = np.log((np.sum(counts, axis=0) + 0.5) / (area_km2 * BIN_NATS))
    mean, covariance = np.interp(KNOTS_NATS, LEVELS_NATS + 0.5 * BIN_NATS, pooled), smooth
    for _ in range(_STEPS):
        prior = _prior(mean, covariance, mines)
        known = [known_background(n, mission.area_km2, prior) for n, mission in zip(counts, missions, strict=True)]
        values = np.array([one for one, _ in known])
        mean = values.mean(axis=0)
        scatter = (values - mean).T @ (values - mean) + np.sum([own for _, own in known], axis=0)
        covariance = (_SMOOTH_MISSIONS * smooth + scatter) / (_SMOOTH_MISSIONS + len(missions))
    return _prior(mean, _never_opposed(covariance), mines)


def judged(missions: Sequence[SortedContacts], asked_per_km2: float) -> ReachedPoint:
    """Call contacts at an operating point, mission by mission, and count."""
    n_asked, n_reached, n_called = 0.0, 0, 0
    for mission in missions:
        level = called_from_nats(mission.everything, mission.area_km2, asked_per_km2)
        n_asked += asked_per_km2 * mission.truth_km2
        n_reached += int(np.count_nonzero(mission.background >= level))
        n_called += int(np.count_nonzero(mission.mines >= level))
    return ReachedPoint(
        asked_per_km2=asked_per_km2,
        n_asked=round(n_asked, _DIGITS),
        n_reached=n_reached,
        n_called=n_called,
        n_targets=sum(mission.n_targets for mission in missions),
    )


def left_out(missions: Sequence[SortedContacts]) -> tuple[LeftOutScene, ...]:
    """Judge the missions of each scene by the prior that the other scenes give; none if there is one alone."""
    found = []
    scenes = dict.fromkeys(mission.scene for mission in missions)
    for scene in scenes if len(scenes) > 1 else ():
        prior = fit_prior([mission for mission in missions if mission.scene != scene])
        own = [mission for mission in missions if mission.scene == scene]
        found.append(
            LeftOutScene(scene=scene, prior=prior, reached=tuple(judged(own, asked) for asked in ASKED_PER_KM2))
        )
    return tuple(found)


def calibrate_background(
    seeds: Sequence[int], farm: Farm, show: Callable[[int, int], None] = lambda done, of: None, theatre: Theatre = USUAL
) -> BackgroundModel:
    """Fly missions with these seeds through the named scenes that are not held out, and fit the model.

    Parameters
    ----------
    show
        Takes the missions flown so far, and how many there are.
    theatre
        What is flown; contacts of its own odds and gate, which have no background yet.

    Raises
    ------
    UsageError
        As fit_prior does.
    """
    tasks = background_tasks(seeds, theatre.flown)
    unfitted = theatre if theatre == USUAL else theatre.with_files(background=NONE)
    missions = list(run_tasks(partial(flown, theatre=unfitted), tasks, farm, lambda done: show(done, len(tasks))))
    return fitted_model(tasks, missions)


def background_tasks(seeds: Sequence[int], scenes: Sequence[str] = USUAL.flown) -> list[Task]:
    """List the missions to fly: every scene, by the cascade with all seeds and by contrasts with the first."""
    of_detector: tuple[tuple[Detector, Sequence[int]], ...] = (("cascade", seeds), ("contrast", seeds[:1]))
    return [(name, seed, detector) for detector, own in of_detector for name in scenes for seed in own]


def fitted_model(tasks: Sequence[Task], missions: Sequence[SortedContacts]) -> BackgroundModel:
    """Fit the model to missions that were flown, one per task."""
    by_detector: dict[Detector, list[SortedContacts]] = {"cascade": [], "contrast": []}
    for (_, _, detector), mission in zip(tasks, missions, strict=True):
        by_detector[detector].append(mission)
    n_contacts = sum(len(mission.everything) for mission in missions)
    scenes, seeds = (", ".join(map(str, dict.fromkeys(task[place] for task in tasks))) for place in (0, 1))
    return BackgroundModel(
        fitted_on=f"{n_contacts} contacts of {len(missions)} simulated missions: {scenes}; seeds {seeds}",
        cascade=fit_prior(by_detector["cascade"]),
        contrast=fit_prior(by_detector["contrast"]),
        left_out=left_out(by_detector["cascade"]),
    )


def _never_opposed(covariance: Array) -> Array:
    """Take out negative covariances, so that more background at some log-odds never makes less expected at others.

    A few scenes cannot separate a small negative correlation from none. The nearest covariance with eigenvalues above 0
    follows.
    """
    values, axes = np.linalg.eigh(np.maximum(covariance, 0.0))
    return np.asarray((axes * np.maximum(values, _MIN_VARIANCE)) @ axes.T)


def _prior(mean: Array, covariance: Array, mines: Array) -> BackgroundPrior:
    even = 0.5 * (covariance + covariance.T)
    return BackgroundPrior(
        mean=tuple(round(float(value), _DIGITS) for value in mean),
        covariance=tuple(tuple(round(float(value), _DIGITS) for value in row) for row in even),
        mine_mean_nats=round(float(mines.mean()), _DIGITS),
        mine_sd_nats=max(round(math.sqrt(float(mines.var())), _DIGITS), 0.1),
    )
