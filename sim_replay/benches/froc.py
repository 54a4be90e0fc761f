"""Measure what each detector and each step finds at a given rate of false alarms.

On missions that nothing was trained or tuned on.

Simulated missions with seeds of their own, one scene of which shows a sea floor that no model was trained on, and
recorded lines with embedded targets, none of which any model was trained on. All systems see the same pings.
"""

from __future__ import annotations

import argparse
import gc
import json
import tempfile
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from importlib import resources
from itertools import chain as joined
from pathlib import Path
from typing import Final, NamedTuple, TypeAlias

import msgspec
import numpy as np

from auv_mcm.classify.odds import shipped_odds
from auv_mcm.contacts.export import contacts_geojson
from auv_mcm.detect.cascade.model import CascadeModel, parse_model
from auv_mcm.detect.detect_tile import TileDetections, detect_tile
from auv_mcm.errors import UsageError
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import Contact, LookStep, NavSample, Ping, SourceEvent, Tile
from auv_mcm.settings.config import Config
from auv_mcm.shell.whole_files import write_file
from sim_replay.arguments import new_file
from sim_replay.augment.augment_log import augment
from sim_replay.augment.recorded_line import scattered
from sim_replay.benches.mission_options import (
    add_line_options,
    add_scene_options,
    chosen_draws,
    chosen_scenes,
    chosen_seeds,
)
from sim_replay.benches.progress import counted
from sim_replay.benches.scenes import as_after
from sim_replay.fitting.cascade.classical.classical_model import parse_classical_model
from sim_replay.fitting.cascade.classical.detect_classical import detect_classical
from sim_replay.fitting.cascade.farm import Farm, run_tasks
from sim_replay.logs.recorded import RecordedMission
from sim_replay.missions import HELD_OUT, SCENES, config_for, unconfirmed, untrained_alone
from sim_replay.scoring import Score, ScoredMission, parse_contacts, parse_truth, score_json, score_missions
from sim_replay.scoring.baseline import baseline_contacts
from sim_replay.scoring.intervals import proportion
from sim_replay.scoring.matching import gates_m
from sim_replay.scoring.thresholds import pd_at
from sim_replay.simulator import mission as simulated
from sim_replay.simulator.scene_file import read_scene
from sim_replay.text_tables import columns, density_cell, markdown, share_cell

FIRST_SEED: Final = 9200  # on seeds from here on nothing was ever trained, fitted or tried
LIMITS_PER_KM2: Final = (10.0, 50.0, 100.0)  # false alarms per km² at which Pd is printed
BARE_LIMITS_PER_KM2: Final = (10.0, 50.0)
"""Limits of false alarms where no object was put; what of the rocks that were is called has a table of its own."""

_ROCKS_P: Final = 0.5  # p_mine from which a rock counts as called
_GATE_M: Final = 2.0  # m between contact and object, maximum, as in scoring
_STEPS: Final[dict[str, LookStep]] = {"confirmation": "contours", "chain": "shape"}
SYSTEMS: Final = {
    "baseline": "plain threshold",
    "contrast": "contrasts, nothing trained",
    "classical": "classical features",
    "stages": "stage cascade",
    "soft": "soft cascade",
    "confirmation": "+ confirmation",
    "chain": "+ classification: the chain",
}
_HEADER: Final = (
    *("missions", "system", "targets", "km²"),
    *(f"Pd at {limit:g} FA/km²" for limit in LIMITS_PER_KM2),
    *(f"at {limit:g} not on objects" for limit in BARE_LIMITS_PER_KM2),
    *("Pd at p_mine 0.5", "FA/km² at p_mine 0.5"),
)
_OUTDONE_HEADER: Final = ("missions", "thresholds of the plain one", "outdone in both errors at once by the chain")
_ROCK_HEADER: Final = ("mine-sized rocks of the chain", "called", "share")


class HeldOutSimulatedLine(NamedTuple):
    """Name a named scene with a seed."""

    name: str
    seed: int

    @property
    def group(self) -> str:
        """Name the group that the line is pooled in: its scene."""
        return self.name


class HeldOutAugmentedLine(NamedTuple):
    """Name a recorded log into which targets and rocks are embedded, drawn by a seed."""

    log: Path
    seed: int

    @property
    def group(self) -> str:
        """Name the group that the line is pooled in: its log."""
        return self.log.stem


Line: TypeAlias = HeldOutSimulatedLine | HeldOutAugmentedLine


class Rock(NamedTuple):
    """Hold a rock with or without (n_views 0) a contact: whether it is called, and from how many views."""

    n_views: int
    called: bool


class FlownLine(NamedTuple):
    """Hold the contacts of every system of SYSTEMS on one line."""

    group: str
    reported: dict[str, ScoredMission]
    rocks: tuple[Rock, ...]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `auv-mcm bench froc`."""
    add_scene_options(parser, FIRST_SEED)
    add_line_options(parser, 4)
    parser.add_argument(
        "--scheduler", metavar="tcp://HOST:PORT", help="fly on the cluster of this dask scheduler instead"
    )
    parser.add_argument("--json", type=new_file, metavar="FILE", help="write all scores to FILE")


def run(arguments: argparse.Namespace) -> int:
    """Fly, score and print; returns the exit code. Raises UsageError for scenes that are not there."""
    names, seeds = chosen_scenes(arguments.scenes), chosen_seeds(arguments)
    lines: list[Line] = [HeldOutSimulatedLine(name, seed) for name in names for seed in seeds]
    lines += [HeldOutAugmentedLine(log, seed) for log in arguments.log for seed in chosen_draws(arguments)]
    flown = list(run_tasks(fly_line, lines, Farm(arguments.workers, arguments.scheduler), counted(len(lines))))
    scores = {
        (group, system): score_missions([one.reported[system] for one in some])
        for group, some in _groups(flown)
        for system in SYSTEMS
    }
    print(
        f"{arguments.seeds} missions per scene, seeds {seeds.start} to {seeds[-1]}; intervals are 95 %: Wilson's for "
        "Pd, exact"
    )
    print("Poisson for FA\n")
    laid_out = markdown if arguments.markdown else columns
    print(laid_out(_HEADER, [_row(group, SYSTEMS[system], score) for (group, system), score in scores.items()]))
    print()
    groups = dict.fromkeys(group for group, _ in scores)
    print(
        laid_out(
            _OUTDONE_HEADER,
            [_outdone_row(group, scores[group, "chain"], scores[group, "baseline"]) for group in groups],
        )
    )
    print()
    print(laid_out(_ROCK_HEADER, list(_rock_rows(list(joined.from_iterable(one.rocks for one in flown))))))
    if arguments.json is not None:
        encoded = {f"{group} {system}": json.loads(score_json(score)) for (group, system), score in scores.items()}
        try:
            write_file(arguments.json, json.dumps(encoded, indent=1).encode())
        except OSError as error:
            raise UsageError(f"--json {arguments.json} cannot be written: {error.strerror}") from error
    return 0


def fly_line(line: Line) -> FlownLine:
    """Fly one line with all systems."""
    gc.collect()  # a mission refers to itself: the sea floor of the one before, 300 MB, would stay for long
    if isinstance(line, HeldOutSimulatedLine):
        scene = msgspec.structs.replace(read_scene(line.name), seed=line.seed)
        mission = simulated.Mission(scene)
        return _seen(line, config_for(scene), mission.events(), mission.truth)
    with tempfile.TemporaryDirectory() as folder:
        written = augment(line.log, scattered(line.seed), Path(folder), Config())
        recorded = RecordedMission([written.log], Config())
        return _seen(line, Config(), recorded.events(), lambda: json.loads(written.truth.read_bytes()))


def outdone(score: Score, baseline: Score) -> tuple[int, int]:
    """Count the baseline's thresholds that find any target, and those that the other system outdoes.

    A threshold is outdone if one of the other finds as many or more with as many or fewer false alarms, and not the
    same of both.
    """
    found = [(point.pd.count, point.false_alarms.count) for point in baseline.froc if point.pd.count]
    ours = [(point.pd.count, point.false_alarms.count) for point in score.froc]
    beaten = [any(one != other and one[0] >= other[0] and one[1] <= other[1] for one in ours) for other in found]
    return len(found), sum(beaten)


def comparison_model(name: str) -> bytes:
    """Read a model for comparison by its name in this package."""
    return resources.files("sim_replay.benches").joinpath("models", f"{name}.json").read_bytes()


def _seen(
    line: Line, config: Config, events: Iterator[SourceEvent], truth_of: Callable[[], dict[str, object]]
) -> FlownLine:
    place = f"{line.group}, seed {line.seed}"
    alone = unconfirmed(config)
    untrained = untrained_alone(config)
    stages = parse_model(comparison_model("stages"), "stages.json")
    classical = parse_classical_model(comparison_model("classical"), "classical.json")
    pipelines = {
        "contrast": Pipeline(untrained),
        "classical": Pipeline(untrained, detect=partial(detect_classical, config=untrained, model=classical)),
        "stages": Pipeline(alone, detect=partial(_by_stages, config=alone, model=stages)),
        "soft": Pipeline(alone),
        "chain": Pipeline(config),
    }
    kept: list[NavSample | Ping] = []
    for event in events:
        if isinstance(event, NavSample | Ping):
            kept.append(event)
        for pipeline in pipelines.values():
            pipeline.feed(event)
    for pipeline in pipelines.values():
        pipeline.finish()
    truth = parse_truth(truth_of(), place)
    contacts: dict[str, Sequence[Contact]] = {name: pipeline.contacts for name, pipeline in pipelines.items()}
    prior = shipped_odds("cascade").prior
    for system, step in _STEPS.items():
        contacts[system] = [as_after(contact, step, prior) for contact in pipelines["chain"].contacts]
    reported = {
        name: ScoredMission(parse_contacts(json.loads(contacts_geojson(found)), place), truth, place)
        for name, found in contacts.items()
    }
    reported["baseline"] = ScoredMission(tuple(baseline_contacts(kept)), truth, place)
    return FlownLine(line.group, reported, tuple(_rocks(pipelines["chain"].contacts, reported["chain"])))


def _by_stages(tile: Tile, config: Config, model: CascadeModel) -> TileDetections:
    return detect_tile(tile, config, model)


def _rocks(contacts: Sequence[Contact], mission: ScoredMission) -> Iterator[Rock]:
    """List every rock, with the most mine-like contact within the gate of it."""
    for truth_object in mission.truth.objects:
        if truth_object.kind != "rock" or truth_object.looks == ():
            continue
        frame = LocalFrame(latitude_deg=truth_object.latitude_deg, longitude_deg=truth_object.longitude_deg)
        near = []
        for contact in contacts:
            east_m, north_m, _ = frame.to_enu(contact.latitude_deg, contact.longitude_deg, 0.0)
            sigma_m = np.sqrt([max(float(np.linalg.eigvalsh(contact.covariance_m2)[-1]), 0.0)])
            if float(np.hypot(east_m, north_m)) <= gates_m(_GATE_M, sigma_m)[0]:
                near.append(contact)
        best = max(near, key=lambda contact: contact.p_mine, default=None)
        yield Rock(0, False) if best is None else Rock(len(best.views), best.p_mine >= _ROCKS_P)


def _groups(flown: Sequence[FlownLine]) -> Iterator[tuple[str, list[FlownLine]]]:
    """Group missions by scene or log, then pool simulated ones on floors like those trained on, and recorded ones."""
    names = list(dict.fromkeys(one.group for one in flown))
    for name in names:
        yield name, [one for one in flown if one.group == name]
    pooled = {
        "all simulated but held-out sea floors": [
            one for one in flown if one.group in SCENES and one.group not in HELD_OUT
        ],
        "all recorded": [one for one in flown if one.group not in SCENES],
    }
    for title, some in pooled.items():
        if len({one.group for one in some}) > 1:
            yield title, some


def _row(group: str, system: str, score: Score) -> list[str]:
    pds = [share_cell(pd_at(score, limit)) for limit in LIMITS_PER_KM2]
    pds += [share_cell(pd_at(score, limit, on_clutter=False)) for limit in BARE_LIMITS_PER_KM2]
    at = score.at_threshold
    return [
        _title(group),
        system,
        str(score.n_targets),
        f"{score.area_km2:.3f}",
        *pds,
        share_cell(at.pd),
        density_cell(at.false_alarms),
    ]


def _outdone_row(group: str, chain: Score, baseline: Score) -> list[str]:
    n_thresholds, n_outdone = outdone(chain, baseline)
    return [_title(group), str(n_thresholds), str(n_outdone)]


def _title(group: str) -> str:
    return f"{group} (held out)" if group in HELD_OUT else group


def _rock_rows(rocks: Sequence[Rock]) -> Iterator[list[str]]:
    for words, views in (
        ("seen once", range(1, 2)),
        ("seen twice or more", range(2, 1000)),
        ("not detected", range(1)),
    ):
        some = [rock for rock in rocks if rock.n_views in views]
        called = sum(rock.called for rock in some)
        yield [words, f"{called} of {len(some)}", share_cell(proportion(called, len(some)))]
