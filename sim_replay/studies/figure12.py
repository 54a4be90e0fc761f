"""Trace the source paper's figure 12 again: detection against false alarms per km², with bands, object by object.

auv-mcm bench figure12                            simulated missions
auv-mcm bench figure12 --log LINE.xtf             recorded lines with embedded objects as well; repeatable
auv-mcm bench figure12 --plot FILE                draws the curves, too (.png, .svg, .pdf)

The chain ranks by p_mine, as it ships; beside it the plain threshold, on the same pings. What ships was fitted on no
recorded line, and on the named scenes but seagrass, with other seeds. All draws of a line share its floor, so its false
alarms come again in each.
"""

from __future__ import annotations

import argparse
import gc
import json
import sys
import tempfile
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np

from auv_mcm.contacts.export import contacts_geojson
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import NavSample, Ping, SourceEvent
from auv_mcm.settings.config import Config
from sim_replay.arguments import new_file
from sim_replay.augment.augment_log import augment
from sim_replay.augment.recorded_line import check_lines
from sim_replay.benches.mission_options import (
    add_line_options,
    add_scene_options,
    chosen_draws,
    chosen_scenes,
    chosen_seeds,
)
from sim_replay.fitting.cascade.farm import Farm, run_tasks
from sim_replay.logs.recorded import RecordedMission
from sim_replay.missions import config_for
from sim_replay.scoring.baseline import baseline_contacts
from sim_replay.scoring.froc import MIN_BOOTSTRAP_MISSIONS
from sim_replay.scoring.inputs import ScoredMission, parse_contacts, parse_truth
from sim_replay.scoring.roc import RankedMission, ranked, resampled, roc
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.scene_file import named_scenes, read_scene
from sim_replay.studies.figure12_plot import DRAWN_PER_KM2, Panel, draw
from sim_replay.studies.paper_mines import MINES, embedded, with_mines
from sim_replay.text_tables import NOTHING, columns, markdown

FIRST_SEED: Final = 94_101  # on seeds from here on nothing was fitted or tried before this study
LIMITS_PER_KM2: Final = (10.0, 100.0, 300.0, 1000.0)  # false alarms per km² at which Pd is printed
SYSTEMS: Final = {"chain": "chain", "plain": "plain threshold"}
DIFFERENCE_PER_KM2: Final = 300.0  # at which systems are compared in pairs: two to three alarms on the recorded floors
_N_DRAWS: Final = 4  # of objects per recorded line
_HEADER: Final = (
    *("missions", "object", "system", "targets", "km²", "floor once, km²"),
    *(f"Pd at {limit:g} FA/km²" for limit in LIMITS_PER_KM2),
    f"Pd at {DIFFERENCE_PER_KM2:g} less that of the plain threshold",
)


class PaperLine(NamedTuple):
    """Name a mission: a named scene or the path of a recorded line, and a seed."""

    source: str
    seed: int


Flown = dict[str, RankedMission]
"""One mission as each of SYSTEMS ranks it."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `auv-mcm bench figure12`."""
    add_scene_options(parser, FIRST_SEED)
    add_line_options(parser, _N_DRAWS)
    parser.add_argument("--plot", type=new_file, metavar="FILE", help="draw the curves (.png, .svg, .pdf)")


def run(arguments: argparse.Namespace) -> int:
    """Fly, rank and print; return the exit code.

    Raises UsageError for unknown scenes or a picture that cannot be written, BadInputError for an unreadable log.
    """
    seeds, draws = chosen_seeds(arguments), chosen_draws(arguments)
    check_lines(arguments.log, draws, embedded)
    lines = [PaperLine(name, seed) for name in chosen_scenes(arguments.scenes) for seed in seeds]
    lines += [PaperLine(str(log), seed) for log in arguments.log for seed in draws]

    def progress(done: int) -> None:
        print(f"\r{done} of {len(lines)} missions", end="\n" if done == len(lines) else "", file=sys.stderr, flush=True)

    missions = list(run_tasks(fly, lines, Farm(arguments.workers), progress))
    print(report(missions, in_markdown=arguments.markdown))
    if arguments.plot is not None:
        draw(panels(missions), arguments.plot)
    return 0


def fly(line: PaperLine) -> Flown:
    """Fly one mission with both systems."""
    gc.collect()  # a mission refers to itself: the sea floor of the one before, 300 MB, would stay for long
    if line.source in named_scenes():
        scene = with_mines(msgspec.structs.replace(read_scene(line.source), seed=line.seed))
        mission = Mission(scene)
        return _seen(line.source, config_for(scene), mission.events(), mission.truth)
    log = Path(line.source)
    with tempfile.TemporaryDirectory() as folder:
        written = augment(log, embedded(line.seed), Path(folder), Config())
        recorded = RecordedMission([written.log], Config())
        return _seen(log.stem, Config(), recorded.events(), lambda: json.loads(written.truth.read_bytes()))


def _seen(group: str, config: Config, events: Iterable[SourceEvent], truth_of: Callable[[], dict[str, Any]]) -> Flown:
    pipeline, kept = Pipeline(config), list[SourceEvent]()
    for event in events:
        if isinstance(event, NavSample | Ping):
            kept.append(event)
        pipeline.feed(event)
    pipeline.finish()
    truth = parse_truth(truth_of(), group)
    found = {
        "chain": parse_contacts(json.loads(contacts_geojson(pipeline.contacts)), group),
        "plain": tuple(baseline_contacts(kept)),
    }
    return {system: ranked(group, ScoredMission(contacts, truth, group)) for system, contacts in found.items()}


def pooled(missions: Sequence[Flown]) -> dict[str, list[Flown]]:
    """Pool recorded lines, and simulated missions; which of both there are."""
    groups: dict[str, list[Flown]] = {"recorded lines": [], "simulated missions": []}
    for one in missions:
        groups["simulated missions" if one["chain"].group in named_scenes() else "recorded lines"].append(one)
    return {title: some for title, some in groups.items() if some}


def floor_once_km2(missions: Sequence[Flown]) -> float:
    """Add the area of different floors: a recorded line counts once, however often objects were drawn on it."""
    own = [one["chain"] for one in missions]
    simulated = sum(one.area_km2 for one in own if one.group in named_scenes())
    return simulated + sum({one.group: one.area_km2 for one in own if one.group not in named_scenes()}.values())


def report(missions: Sequence[Flown], *, in_markdown: bool = False) -> str:
    """Lay out every object on recorded lines and in simulated missions, then all objects on each line and scene."""
    rows = []
    for title, some in pooled(missions).items():
        for name, kinds in _kinds().items():
            rows += _rows(title, some, name, kinds)
    for group in dict.fromkeys(one["chain"].group for one in missions):
        rows += _rows(group, [one for one in missions if one["chain"].group == group], "all", list(MINES))
    return (markdown if in_markdown else columns)(_HEADER, rows)


def panels(missions: Sequence[Flown]) -> list[Panel]:
    """Trace every curve that is drawn."""
    return [
        Panel(
            title=title,
            name=name,
            once_per_km2=1.0 / floor_once_km2(some),
            curves={SYSTEMS[system]: roc([one[system] for one in some], kinds, DRAWN_PER_KM2) for system in SYSTEMS},
        )
        for title, some in pooled(missions).items()
        for name, kinds in _kinds().items()
    ]


def _kinds() -> dict[str, list[str]]:
    own: dict[str, list[str]] = {mine.name: [kind] for kind, mine in MINES.items()}
    return own | {"all": list(MINES)}


def _rows(title: str, missions: Sequence[Flown], name: str, kinds: Sequence[str]) -> list[list[str]]:
    limits = np.array(LIMITS_PER_KM2)
    rows = []
    for system, words in SYSTEMS.items():
        own = [one[system] for one in missions]
        curve = roc(own, kinds, limits)
        cells = [
            f"{pd:.2f} ({low:.2f}-{high:.2f})" for pd, low, high in zip(curve.pd, curve.low, curve.high, strict=True)
        ]
        area = f"{sum(one.area_km2 for one in own):.3f}"
        once = f"{floor_once_km2(missions):.3f}"
        rows.append([title, name, words, str(curve.n_targets), area, once, *cells, NOTHING])
    if len(missions) >= MIN_BOOTSTRAP_MISSIONS:
        rows[0][-1] = _more(missions, kinds)
    return rows


def _more(missions: Sequence[Flown], kinds: Sequence[str]) -> str:
    """Write how much more Pd the chain has than the plain threshold, over missions drawn again in pairs."""
    limit = np.array([DIFFERENCE_PER_KM2])
    chain, plain = ([one[system] for one in missions] for system in SYSTEMS)
    middle = roc(chain, kinds, limit).pd[0] - roc(plain, kinds, limit).pd[0]
    drawn = (resampled(chain, kinds, limit) - resampled(plain, kinds, limit))[:, 0]
    low, high = np.nanquantile(drawn, [0.025, 0.975]).tolist()
    return f"{middle:+.2f} ({low:+.2f} to {high:+.2f})"
