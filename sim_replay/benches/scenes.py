"""Measure what the chain and each of its steps find in the named scenes, and what the baseline finds in the same
pings."""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Final, Literal, NamedTuple, TypeAlias, get_args

import msgspec
import numpy as np

from auv_mcm.classify.fusion import fuse
from auv_mcm.classify.odds import shipped_odds
from auv_mcm.confirmation import confirm_detection
from auv_mcm.contacts.export import contacts_geojson
from auv_mcm.errors import UsageError
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import Contact, Detection, Detector, LookStep, NavSample, Ping
from auv_mcm.shell.whole_files import write_file
from sim_replay.arguments import new_file
from sim_replay.benches.mission_options import add_scene_options, chosen_scenes, chosen_seeds
from sim_replay.benches.progress import counted
from sim_replay.missions import FIRST_SEED, config_for, served_by, untrained_alone
from sim_replay.scoring import Score, ScoredMission, parse_contacts, parse_truth, score_json, score_missions
from sim_replay.scoring.baseline import baseline_contacts
from sim_replay.scoring.intervals import density
from sim_replay.simulator import mission as simulated
from sim_replay.simulator.scene_file import read_scene
from sim_replay.text_tables import NOTHING, columns, density_cell, markdown, share_cell

_LIMIT_PER_KM2: Final = 100.0  # false alarms per km² at which Pd is printed

System: TypeAlias = Literal["chain", "detector", "baseline"]
SYSTEMS: Final[tuple[System, ...]] = get_args(System)
STEPS: Final[tuple[LookStep, ...]] = get_args(LookStep)
_DETECTED: Final[dict[Detector, str]] = {
    "cascade": "the trained detector, with odds from what it measures",
    "contrast": "contrasts, with odds from what they measure",
}
_LOOKED: Final = ("+ contours", "+ Markov field and solids: the chain")
_ORDER: Final = {step: number for number, step in enumerate(STEPS)}
_KEPT: Final = 0.98  # of the Pd of contrasts alone
_HEADER: Final = (
    "scene",
    "system",
    "targets",
    "km²",
    f"Pd at {_LIMIT_PER_KM2:g} FA/km²",
    "Pd at p_mine 0.5",
    "FA/km² at p_mine 0.5",
    "rocks called",
    "error m",
)
_SEABED_HEADER: Final = ("sea floor", "system", "targets", "km²", "Pd at p_mine 0.5", "FA/km² at p_mine 0.5")


_STEP_HEADER: Final = (
    "after",
    f"Pd at {_LIMIT_PER_KM2:g} FA/km²",
    "Pd at p_mine 0.5",
    "FA/km² at p_mine 0.5",
    f"FA/km² at {_KEPT:.0%} of contrasts' Pd",
    "of them not on objects",
    "looks",
    "s per hour of survey",
)


class FlownMission(NamedTuple):
    """Hold one mission as all systems reported it.

    detector: contrasts alone, without confirmation. steps: the chain as far as that step.

    steps: the chain as far as that step.

    n_looks: confirmations that went as far as each step; looks_s: time of each that went through all. costs_s: time on
    one core for all that was done up to each step, the detector's under `alone`. survey_s: duration of the mission.
    """

    chain: ScoredMission
    detector: ScoredMission
    baseline: ScoredMission
    steps: dict[LookStep, ScoredMission]
    n_looks: dict[LookStep, int]
    looks_s: tuple[float, ...]
    costs_s: dict[str, float]
    survey_s: float


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `auv-mcm bench scenes`."""
    add_scene_options(parser, FIRST_SEED, n_seeds=3)
    parser.add_argument(
        "--detector",
        choices=get_args(Detector),
        default="cascade",
        help="what the chain confirms: detections of the trained cascade, or of contrasts, as for a sonar without a "
        "model "
        "(default cascade)",
    )
    parser.add_argument("--json", type=new_file, metavar="FILE", help="write all scores to FILE")


def run(arguments: argparse.Namespace) -> int:
    """Fly, score and print; returns the exit code. Raises UsageError for unknown scenes."""
    names = chosen_scenes(arguments.scenes)
    seeds = chosen_seeds(arguments)
    flown: dict[str, list[FlownMission]] = {name: [] for name in names}
    progress = counted(len(names) * len(seeds))
    for done, (name, mission) in enumerate(_fly_all(names, seeds, arguments.workers, arguments.detector), 1):
        flown[name].append(mission)
        progress(done)
    pooled = dict(flown)
    if len(names) > 1:
        pooled["all"] = [mission for missions in flown.values() for mission in missions]
    scores = {
        (name, system): score_missions([getattr(mission, system) for mission in missions])
        for name, missions in pooled.items()
        for system in SYSTEMS
    }
    print(f"{len(seeds)} missions per scene, seeds {seeds.start} to {seeds.stop - 1}")
    print("intervals are 95 %: Wilson's for Pd, exact Poisson for FA; rocks called and errors at p_mine 0.5\n")
    laid_out = markdown if arguments.markdown else columns
    print(laid_out(_HEADER, [_row(name, system, score) for (name, system), score in scores.items()]))
    *_, last = pooled
    print()
    print(laid_out(_STEP_HEADER, list(_step_rows(pooled[last], arguments.detector))))
    looks_s = [look_s for mission in pooled[last] for look_s in mission.looks_s]
    if looks_s:
        middle_ms, slow_ms = (1e3 * np.quantile(looks_s, (0.5, 0.99))).tolist()
        print(
            f"\na look through all steps: {middle_ms:.0f} ms in the median, {slow_ms:.0f} ms at the 99th percentile of "
            f"{len(looks_s)}"
        )
    print()
    print(laid_out(_SEABED_HEADER, list(_seabed_rows({system: scores[last, system] for system in SYSTEMS}))))
    if arguments.json is not None:
        reported = {f"{name} {system}": json.loads(score_json(score)) for (name, system), score in scores.items()}
        try:
            write_file(arguments.json, json.dumps(reported, indent=1).encode())
        except OSError as error:
            raise UsageError(f"--json {arguments.json} cannot be written: {error.strerror}") from error
    return 0


def fly_mission(name: str, seed: int, detector: Detector) -> FlownMission:
    """Fly one mission through a named scene with all systems, the chain with one of the detectors."""
    scene = msgspec.structs.replace(read_scene(name), seed=seed)
    mission = simulated.Mission(scene)
    config = served_by(detector, config_for(scene))
    odds, beam_width_rad = shipped_odds(detector), config.sonar.beam_width_rad
    looks_s: dict[LookStep, list[float]] = {step: [] for step in STEPS}

    def timed_look(detection: Detection) -> Detection:
        start = time.perf_counter()
        looked_at = confirm_detection(detection, beam_width_rad, odds, config.confirm)
        *_, last = looked_at.p_by_step
        looks_s[last].append(time.perf_counter() - start)
        return looked_at

    chain = Pipeline(config, timer=time.perf_counter, look=timed_look)
    alone = Pipeline(untrained_alone(config), timer=time.perf_counter)
    kept: list[NavSample | Ping] = []
    for event in mission.events():
        kept.append(event)
        chain.feed(event)
        alone.feed(event)
    for pipeline in (chain, alone):
        pipeline.finish()
    place = f"{name}, seed {seed}"
    truth = parse_truth(mission.truth(), place)

    def reported(contacts: Sequence[Contact]) -> ScoredMission:
        return ScoredMission(parse_contacts(json.loads(contacts_geojson(contacts)), place), truth, place)

    pings = [event.time_s for event in kept if isinstance(event, Ping)]
    return FlownMission(
        chain=reported(chain.contacts),
        detector=reported(alone.contacts),
        baseline=ScoredMission(tuple(baseline_contacts(kept)), truth, place),
        steps={step: reported([as_after(contact, step, odds.prior) for contact in chain.contacts]) for step in STEPS},
        n_looks={step: sum(len(looks_s[later]) for later in STEPS if _ORDER[later] >= _ORDER[step]) for step in STEPS},
        looks_s=tuple(looks_s["shape"]),
        costs_s=_costs_s(alone.costs_s, chain.costs_s, looks_s),
        survey_s=pings[-1] - pings[0],
    )


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


def _costs_s(
    alone_s: Mapping[str, float], chain_s: Mapping[str, float], looks_s: Mapping[LookStep, Sequence[float]]
) -> dict[str, float]:
    """Compute seconds up to and with each step.

    Contours of confirmations that went on cost what those of confirmations that ended there did.
    """
    found = sum(cost for stage, cost in chain_s.items() if stage != "confirm")
    odds, ended, whole = (sum(looks_s[step]) for step in STEPS)
    contours = ended + min(ended / max(len(looks_s["contours"]), 1) * len(looks_s["shape"]), whole)
    return {
        "alone": sum(alone_s.values()),
        "detector": found + odds,
        "contours": found + odds + contours,
        "shape": found + odds + ended + whole,
    }


def _fly_all(
    names: Sequence[str], seeds: Sequence[int], workers: int, detector: Detector
) -> Iterator[tuple[str, FlownMission]]:
    """Fly every scene with every seed, in order."""
    tasks = [(name, seed, detector) for name in names for seed in seeds]
    if workers == 1:
        yield from ((name, fly_mission(name, seed, detector)) for name, seed, _ in tasks)
        return
    with ProcessPoolExecutor(min(workers, len(tasks)), mp_context=get_context("spawn")) as pool:
        for (name, *_), mission in zip(tasks, pool.map(fly_mission, *zip(*tasks, strict=True)), strict=True):
            yield name, mission


def _row(name: str, system: str, score: Score) -> list[str]:
    headline = next(headline for headline in score.headlines if headline.limit_per_km2 == _LIMIT_PER_KM2)
    rocks, error = score.rocks_called_mines, score.position_errors.total_m.median
    return [
        name,
        system,
        str(score.n_targets),
        f"{score.area_km2:.3f}",
        share_cell(headline.pd),
        share_cell(score.at_threshold.pd),
        density_cell(score.at_threshold.false_alarms),
        f"{rocks.count} of {rocks.of}",
        NOTHING if error is None else f"{error:.2f}",
    ]


def _seabed_rows(scores: dict[System, Score]) -> Iterator[list[str]]:
    for name in sorted({group.name for score in scores.values() for group in score.seabeds}):
        for system, score in scores.items():
            for group in score.seabeds:
                if group.name == name:
                    alarms = group.false_alarms
                    area_text = NOTHING if alarms.area_km2 is None else f"{alarms.area_km2:.3f}"
                    yield [
                        name.replace("_", " "),
                        system,
                        str(group.pd.of),
                        area_text,
                        share_cell(group.pd),
                        density_cell(alarms),
                    ]


def _step_rows(missions: Sequence[FlownMission], detector: Detector) -> Iterator[list[str]]:
    hours = sum(mission.survey_s for mission in missions) / 3600.0
    alone = score_missions([mission.detector for mission in missions])
    wanted = _KEPT * (alone.at_threshold.pd.value or 0.0)
    rows_of: list[tuple[str, str, str, Score]] = [("contrasts alone, nothing trained", "alone", "", alone)]
    for step, words in zip(STEPS, (_DETECTED[detector], *_LOOKED), strict=True):
        n_looks = str(sum(mission.n_looks[step] for mission in missions))
        rows_of.append((words, step, n_looks, score_missions([mission.steps[step] for mission in missions])))
    for words, cost, n_looks, score in rows_of:
        headline = next(headline for headline in score.headlines if headline.limit_per_km2 == _LIMIT_PER_KM2)
        enough = next((point for point in score.froc if (point.pd.value or 0.0) >= wanted), None)
        seconds = sum(mission.costs_s[cost] for mission in missions) / hours
        yield [
            words,
            share_cell(headline.pd),
            share_cell(score.at_threshold.pd),
            density_cell(score.at_threshold.false_alarms),
            NOTHING if enough is None else density_cell(enough.false_alarms),
            NOTHING
            if enough is None
            else density_cell(density(enough.false_alarms.count - enough.on_known_clutter, score.area_km2)),
            n_looks,
            f"{seconds:.0f}",
        ]
