"""Judge the operating point on missions that the odds were not fitted on: false alarms reached and requested, and Pd.

auv-mcm bench point                               flies, judges and prints
auv-mcm bench point --log LINE.xtf                the same with targets embedded in a recorded line

Contacts are called as the payload does, by the false alarms that their own odds make expect.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Iterator, Sequence
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
from auv_mcm.pipeline import Pipeline
from auv_mcm.settings.config import Config
from sim_replay.augment.augment_log import augment
from sim_replay.augment.recorded_line import check_lines, scattered
from sim_replay.benches.mission_options import (
    add_line_options,
    add_scene_options,
    chosen_draws,
    chosen_scenes,
    chosen_seeds,
)
from sim_replay.fitting.cascade.farm import Farm, run_tasks
from sim_replay.fitting.fit_background import SeenMission, SortedContacts, flown, sorted_contacts
from sim_replay.logs.recorded import RecordedMission
from sim_replay.missions import FIRST_SEED
from sim_replay.scoring.inputs import parse_truth
from sim_replay.scoring.intervals import density, proportion
from sim_replay.simulator.scene_file import named_scenes
from sim_replay.text_tables import columns, density_cell, markdown, share_cell

ASKED_PER_KM2: Final = (30.0, 100.0, 300.0)  # false alarms per km² that the operating point is set to
_HEADER: Final = (
    "domain",
    "targets",
    "km²",
    "asked",
    "FA asked",
    "FA reached",
    "of them on objects",
    "per km²",
    "in the interval",
    "FA, mines taken out",
    "Pd",
    "best Pd at as many FA",
)
Line = tuple[str, int]
"""A named scene or the path of a recorded line, and a seed."""


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


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `auv-mcm bench point`."""
    add_scene_options(parser, FIRST_SEED)
    add_line_options(parser, 3)


def run(arguments: argparse.Namespace) -> int:
    """Fly, judge and print; returns the exit code.

    Raises UsageError for unknown scenes, BadInputError for an unreadable log.
    """
    names = chosen_scenes(arguments.scenes)
    seeds = chosen_seeds(arguments)
    log_seeds = chosen_draws(arguments)
    check_lines(arguments.log, log_seeds)
    lines: list[Line] = [(name, seed) for name in names for seed in seeds]
    lines += [(str(log), seed) for log in arguments.log for seed in log_seeds]
    missions = list(counted_missions(run_tasks(fly, lines, Farm(arguments.workers)), len(lines)))
    print(report(missions, shipped_background(), in_markdown=arguments.markdown))
    return 0


def fly(line: Line) -> SortedContacts:
    """Fly one mission, simulated or recorded with embedded targets, and sort its contacts."""
    name, seed = line
    return flown((name, seed, "cascade")) if name in named_scenes() else fly_augmented(Path(name), seed)


def fly_augmented(log: Path, seed: int) -> SortedContacts:
    """Embed targets and rocks drawn by a seed in a recorded line, replay it, and sort its contacts."""
    with tempfile.TemporaryDirectory() as folder:
        written = augment(log, scattered(seed), Path(folder), Config())
        pipeline, seen = Pipeline(Config()), SeenMission()
        for event in RecordedMission([written.log], Config()).events():
            seen.take(pipeline.feed(event))
        seen.take(pipeline.finish())
        truth = parse_truth(json.loads(written.truth.read_bytes()), log.name)
        return sorted_contacts(log.stem, pipeline.contacts, truth, seen.area.km2)


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


def report(missions: Sequence[SortedContacts], model: BackgroundModel, *, in_markdown: bool = False) -> str:
    """Lay out every domain, and all simulated and all recorded ones together."""
    laid_out = markdown if in_markdown else columns
    some = [judged(mission, model) for mission in missions]
    groups = {
        name: [one for one in some if one.mission.scene == name]
        for name in dict.fromkeys(one.mission.scene for one in some)
    }
    for title, is_recorded in (("all simulated", False), ("all recorded", True)):
        pooled = [one for one in some if (one.mission.scene not in named_scenes()) is is_recorded]
        if len({one.mission.scene for one in pooled}) > 1:
            groups[title] = pooled
    rows = [_row(name, of, asked) for asked in ASKED_PER_KM2 for name, of in groups.items()]
    return laid_out(_HEADER, rows)


def _row(name: str, missions: Sequence[Judged], asked_per_km2: float) -> list[str]:
    found = reached(missions, asked_per_km2)
    n_targets = sum(one.mission.n_targets for one in missions)
    area_km2 = sum(one.mission.truth_km2 for one in missions)
    return [
        name,
        str(n_targets),
        f"{area_km2:.3f}",
        f"{asked_per_km2:g}",
        f"{found.n_asked:.1f}",
        str(found.n_false_alarms),
        str(found.n_on_objects),
        density_cell(density(found.n_false_alarms, area_km2)),
        f"{found.n_inside} of {found.n_judged}",
        str(found.n_without_mines),
        share_cell(proportion(found.n_called, n_targets)),
        f"{found.best / n_targets:.2f}" if n_targets else "-",
    ]


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


def counted_missions(results: Iterator[SortedContacts], total: int) -> Iterator[SortedContacts]:
    """Print how many missions have been flown."""
    for done, result in enumerate(results, 1):
        print(f"\r{done} of {total} missions flown", end="" if done < total else "\n", file=sys.stderr, flush=True)
        yield result
