"""Measure what the chain and each of its steps find in the named scenes, and what the plain script finds in the same
pings.

auv-mcm bench scenes                               flies, judges and prints
auv-mcm bench scenes --log LINE.xtf                the same with targets embedded in a recorded line as well
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple, get_args

import msgspec

from auv_mcm.classify.fusion import fuse
from auv_mcm.classify.odds import shipped_odds
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import Contact, Detector, LookStep, NavSample, Ping, SourceEvent
from sim_replay.benches import score_columns
from sim_replay.benches.experiment import Cell, Column, Experiment, PairedColumn, Task, number
from sim_replay.benches.mission_source import mission_source
from sim_replay.benches.run_time.plain_script import find_contacts
from sim_replay.flights import fly_through
from sim_replay.logs.xtf_writer import write_xtf
from sim_replay.missions import FIRST_SEED, SCENES, served_by, untrained_alone
from sim_replay.scoring.inputs import ReportedContact, ScoredMission, as_reported, parse_contacts, parse_truth
from sim_replay.scoring.thresholds import BestScores, banded_at, best_scores, found_at
from sim_replay.text_tables import NOTHING

STEPS: Final[dict[str, LookStep]] = {
    "the detector, with odds from what it measures": "detector",
    "+ contours": "contours",
    "+ Markov field and solids: the chain": "shape",
}
BASELINE: Final = "plain threshold"
UNTRAINED: Final = "contrasts alone, nothing trained"
_ORDER: Final = {step: number for number, step in enumerate(get_args(LookStep))}
_LIMIT_PER_KM2: Final = 100.0  # false alarms per km² at which gains are given


class SystemResult(NamedTuple):
    """Hold what one system reported of one mission. cost_s: processor time, NaN where it has none of its own."""

    mission: ScoredMission
    best: BestScores
    cost_s: float
    survey_s: float


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add which detector the chain has."""
    parser.add_argument(
        "--detector",
        choices=get_args(Detector),
        default="cascade",
        help="what the chain confirms: detections of the trained cascade, or of contrasts, as for a sonar without a "
        "model (default cascade)",
    )


def fly(task: Task) -> dict[str, SystemResult]:
    """Fly one mission with all systems, the chain with the detector that the options name."""
    detector: Detector = task.options["detector"]
    kept: list[NavSample | Ping] = []
    with mission_source(task) as source:
        chain = Pipeline(served_by(detector, source.config), timer=time.process_time)
        alone = Pipeline(untrained_alone(source.config), timer=time.process_time)
        fly_through(_keeping(source.events, kept), {"chain": chain, "alone": alone})
        truth = parse_truth(source.truth(), task.scene)
    times_s = [event.time_s for event in kept if isinstance(event, Ping)]
    prior = shipped_odds(detector).prior
    chain_s = sum(chain.costs_s.values())
    costs_s = {"shape": chain_s, "detector": chain_s - chain.costs_s.get("confirm", 0.0)}

    def result(contacts: tuple[ReportedContact, ...], cost_s: float = math.nan) -> SystemResult:
        mission = ScoredMission(contacts, truth, task.scene)
        return SystemResult(mission, best_scores(mission), cost_s, times_s[-1] - times_s[0])

    return {
        BASELINE: result(_by_plain_script(kept, task.scene)),
        UNTRAINED: result(as_reported(alone.contacts, task.scene), sum(alone.costs_s.values())),
    } | {
        name: result(
            as_reported([as_after(contact, step, prior) for contact in chain.contacts], task.scene),
            costs_s.get(step, math.nan),
        )
        for name, step in STEPS.items()
    }


def _by_plain_script(events: Sequence[NavSample | Ping], name: str) -> tuple[ReportedContact, ...]:
    """Find contacts as the script that `bench chain` is compared with does, in a log of these events."""
    with tempfile.TemporaryDirectory() as folder:
        log, found = Path(folder) / "mission.xtf", Path(folder) / "found.geojson"
        write_xtf(log, events, sample_type="float32")
        find_contacts(str(log), str(found))
        return parse_contacts(json.loads(found.read_bytes()), name)


def _keeping(events: Iterable[SourceEvent], kept: list[NavSample | Ping]) -> Iterator[SourceEvent]:
    for event in events:
        if isinstance(event, NavSample | Ping):
            kept.append(event)
        yield event


def as_after(contact: Contact, step: LookStep, prior: float) -> Contact:
    """Return the contact as it would be if no view had been confirmed beyond a step."""
    views = [
        msgspec.structs.replace(
            view,
            p_mine=[p for name, p in view.p_by_step.items() if _ORDER[name] <= _ORDER[step]][-1],
            confirmation=None,
        )
        for view in contact.views
    ]
    return msgspec.structs.replace(contact, p_mine=fuse(views, prior).p_mine)


def _cost(results: Sequence[SystemResult]) -> Cell:
    seconds = sum(one.cost_s for one in results) / sum(one.survey_s for one in results) * 3600.0
    return Cell(NOTHING) if math.isnan(seconds) else number(seconds)


def _band(results: Sequence[SystemResult]) -> Cell:
    value, low, high = banded_at([one.best for one in results], _LIMIT_PER_KM2)
    return Cell(f"{value:.2f} ({low:.2f}-{high:.2f})", value, low, high)


def _of_missions(column: Callable[[list[ScoredMission]], Cell]) -> Callable[[Sequence[SystemResult]], Cell]:
    return lambda results: column([one.mission for one in results])


EXPERIMENT: Final = Experiment(
    name="scenes",
    scenes=SCENES,
    first_seed=FIRST_SEED,
    n_seeds=3,
    n_draws=4,
    variant_title="after",
    variants=(BASELINE, UNTRAINED, *STEPS),
    fly=fly,
    columns=(
        Column("targets", _of_missions(score_columns.n_targets)),
        Column("km²", _of_missions(score_columns.area)),
        *(
            Column(f"Pd at {limit:g} FA/km²", _of_missions(partial(score_columns.pd_at_limit, limit)))
            for limit in (10.0, 50.0, _LIMIT_PER_KM2)
        ),
        Column("at 50 not on objects", _of_missions(partial(score_columns.pd_at_limit, 50.0, on_clutter=False))),
        Column(f"at {_LIMIT_PER_KM2:g}, missions drawn again", _band),
        PairedColumn(
            f"more at {_LIMIT_PER_KM2:g} than the plain threshold",
            lambda results: found_at([one.best for one in results], _LIMIT_PER_KM2).value or 0.0,
        ),
        Column("Pd at p_mine 0.5", _of_missions(score_columns.pd_at_threshold)),
        Column("FA/km² at p_mine 0.5", _of_missions(score_columns.density_at)),
        Column("rocks called", _of_missions(score_columns.rocks_called)),
        Column("error m", _of_missions(score_columns.position_error)),
        Column("s per hour of survey", _cost),
    ),
    add_options=add_options,
    own_options=("detector",),
)
