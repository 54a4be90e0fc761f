"""Judge the operating point on missions that the odds were not fitted on: false alarms reached and requested, and Pd.

auv-mcm bench point                               flies, judges and prints
auv-mcm bench point --log LINE.xtf                the same with targets embedded in a recorded line as well

Contacts are called as the payload does, by the false alarms that their own odds make expect.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.contacts.background import (
    Background,
    BackgroundModel,
    BackgroundPrior,
    counted_log_odds,
    estimate_background,
    shipped_background,
)
from auv_mcm.contacts.expected_alarms import called_from_nats, expected_alarms
from sim_replay.benches.experiment import Cell, Column, Experiment, Task, density, number, share
from sim_replay.fitting.fit_background import SortedContacts, flown, flown_along
from sim_replay.missions import FIRST_SEED, SCENES
from sim_replay.scoring.intervals import density as area_density
from sim_replay.scoring.intervals import proportion
from sim_replay.simulator.scene_file import named_scenes

ASKED_PER_KM2: Final = {"30": 30.0, "100": 100.0, "300": 300.0}
"""False alarms per km² that the operating point is set to."""


class Judged(NamedTuple):
    """Hold one mission, with the background that its contacts show by a prior that it was left out of."""

    mission: SortedContacts
    prior: BackgroundPrior
    background: Background


class Reached(NamedTuple):
    """Hold missions pooled at an operating point.

    n_on_objects: false alarms on objects of the truth, such as rocks. n_without_mines: false alarms where mines'
    contacts are taken out. n_inside: missions whose false alarms lie in the 95 % interval of the estimate, of n_judged
    that have some. best: targets that the best threshold of p_mine calls with as many false
    alarms.
    """

    n_asked: float
    n_false_alarms: int
    n_on_objects: int
    n_without_mines: int
    n_inside: int
    n_judged: int
    n_called: int
    best: int


class PointResult(NamedTuple):
    """Hold a judged mission, and the operating point that it is called at, false alarms per km²."""

    one: Judged
    asked_per_km2: float


def fly(task: Task) -> dict[str, PointResult]:
    """Fly one mission, simulated or recorded with embedded targets, and sort its contacts; all points see the same."""
    if task.scene in named_scenes():
        mission = flown((task.scene, task.seed, "cascade"))
    else:
        mission = flown_along(Path(task.scene), task.seed)
    one = judged(mission, shipped_background())
    return {name: PointResult(one, asked_per_km2) for name, asked_per_km2 in ASKED_PER_KM2.items()}


def judged(mission: SortedContacts, model: BackgroundModel) -> Judged:
    """Estimate a mission's background by a prior that it was left out of."""
    prior = next((left.prior for left in model.left_out if left.scene == mission.scene), model.cascade)
    return Judged(mission, prior, estimate_background(counted_log_odds(mission.everything), mission.area_km2, prior))


def reached(missions: Sequence[Judged], asked_per_km2: float) -> Reached:
    """Call contacts of each mission at its own level, and pool."""
    n_asked, n_false_alarms, n_on_objects, n_without_mines, n_inside, n_judged, n_called = 0.0, 0, 0, 0, 0, 0, 0
    for one in missions:
        level = called_from_nats(one.mission.everything, one.mission.area_km2, asked_per_km2)
        n = _reaching(one.mission.background, level)
        n_asked += asked_per_km2 * one.mission.truth_km2
        n_false_alarms += n
        n_on_objects += _reaching(one.mission.background[one.mission.on_objects], level)
        n_called += _reaching(one.mission.mines, level)
        bare = called_from_nats(one.mission.background, one.mission.area_km2, asked_per_km2)
        n_without_mines += _reaching(one.mission.background, bare)
        if n:
            n_judged += 1
            n_inside += _is_inside(n, one, level)
    false_alarms = np.sort(np.concatenate([one.mission.background for one in missions]))[::-1]
    above = false_alarms[n_false_alarms] if n_false_alarms < len(false_alarms) else -np.inf
    best = sum(int(np.count_nonzero(one.mission.mines > above)) for one in missions)
    return Reached(n_asked, n_false_alarms, n_on_objects, n_without_mines, n_inside, n_judged, n_called, best)


def _reaching(log_odds: NDArray[np.float64], level: float) -> int:
    return int(np.count_nonzero(log_odds >= level))


def _is_inside(n: int, one: Judged, level: float) -> bool:
    """Check that a Poisson count with a mean in the interval makes so many, or so few, in more than one case of
    forty."""
    from scipy.special import pdtr

    expected = expected_alarms(one.mission.everything, one.mission.area_km2).false_alarms(level)
    low, high = expected.low * one.mission.truth_km2, expected.high * one.mission.truth_km2
    too_many = n > 0 and 1.0 - pdtr(n - 1, high) < 0.025
    return not too_many and pdtr(n, low) >= 0.025


def _pooled(results: Sequence[PointResult]) -> Reached:
    return reached([result.one for result in results], results[0].asked_per_km2)


def _n_targets(results: Sequence[PointResult]) -> int:
    return sum(result.one.mission.n_targets for result in results)


def _area_km2(results: Sequence[PointResult]) -> float:
    return sum(result.one.mission.truth_km2 for result in results)


def _inside(results: Sequence[PointResult]) -> Cell:
    found = _pooled(results)
    return Cell(f"{found.n_inside} of {found.n_judged}")


EXPERIMENT: Final = Experiment(
    name="point",
    scenes=SCENES,
    first_seed=FIRST_SEED,
    n_seeds=2,
    n_draws=3,
    variant_title="asked per km²",
    variants=tuple(ASKED_PER_KM2),
    fly=fly,
    columns=(
        Column("targets", lambda results: number(_n_targets(results))),
        Column("km²", lambda results: number(_area_km2(results), 3)),
        Column("FA asked", lambda results: number(_pooled(results).n_asked, 1)),
        Column("FA reached", lambda results: number(_pooled(results).n_false_alarms)),
        Column("of them on objects", lambda results: number(_pooled(results).n_on_objects)),
        Column("per km²", lambda results: density(area_density(_pooled(results).n_false_alarms, _area_km2(results)))),
        Column("in the interval", _inside),
        Column("FA, mines taken out", lambda results: number(_pooled(results).n_without_mines)),
        Column("Pd", lambda results: share(proportion(_pooled(results).n_called, _n_targets(results)))),
        Column("best Pd at as many FA", lambda results: share(proportion(_pooled(results).best, _n_targets(results)))),
    ),
)
