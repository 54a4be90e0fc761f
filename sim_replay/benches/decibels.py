"""Measure what wrong decibels per count cost in detection.

auv-mcm bench decibels      flies named scenes with a logarithmic recorder, reads the same pings with decibels per count
                            that are right, estimated, and wrong by known factors, and prints what is found
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from itertools import product
from typing import Final, NamedTuple

import msgspec

from auv_mcm.contacts.export import contacts_geojson
from auv_mcm.pipeline import Pipeline
from sim_replay.arguments import count
from sim_replay.fitting.cascade.farm import Farm, run_tasks
from sim_replay.missions import FIRST_SEED, config_for
from sim_replay.scoring import Score, ScoredMission, parse_contacts, parse_truth, score_missions
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.scene import SampleRecorder
from sim_replay.simulator.scene_file import named_scenes, read_scene
from sim_replay.text_tables import columns, density_cell, markdown, share_cell

SCENES: Final = ("flat", "ripple", "mixed", "seagrass")
FACTORS: Final = (0.73, 0.85, 1.0, 1.15, 1.44)
"""Of the true decibels per count: within 15 % as most estimates are, and the worst estimates of `auv-mcm bench law`."""
DB_PER_COUNT: Final = 0.3  # dB per count of the recorder simulated
_HEADER: Final = (
    "decibels per count",
    "Pd at 10 FA/km²",
    "at 30",
    "at 100",
    "Pd at p_mine 0.5",
    "FA/km² at p_mine 0.5",
)


class MisreadMission(NamedTuple):
    """Hold one mission as read with right and wrong decibels per count.

    They are times each of FACTORS, and those that the payload estimates.
    """

    by_factor: tuple[ScoredMission, ...]
    estimated: ScoredMission


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `auv-mcm bench decibels`."""
    parser.add_argument(
        "--seeds", type=count, default=1, help=f"missions of each scene, from seed {FIRST_SEED} (default 1)"
    )
    parser.add_argument(
        "--scene",
        action="append",
        choices=named_scenes(),
        help=f"named scene, repeatable (default {', '.join(SCENES)})",
    )
    parser.add_argument("--workers", type=count, default=2, help="processes (default 2)")
    parser.add_argument("--markdown", action="store_true", help="print the table in Markdown")


def run(arguments: argparse.Namespace) -> int:
    """Fly, read, score and print; returns the exit code."""
    tasks = list(product(arguments.scene or SCENES, range(FIRST_SEED, FIRST_SEED + arguments.seeds)))
    missions: list[MisreadMission] = []
    for done, mission in enumerate(run_tasks(read_mission, tasks, Farm(arguments.workers)), 1):
        missions.append(mission)
        print(f"\r{done} of {len(tasks)} missions", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    print((markdown if arguments.markdown else columns)(_HEADER, rows(missions)))
    return 0


def read_mission(task: tuple[str, int]) -> MisreadMission:
    """Fly a scene, by name and seed, with an 8-bit logarithmic recorder and read its pings in every way."""
    name, seed = task
    scene = read_scene(name)
    recorder = SampleRecorder(samples="log_uint8", db_per_count=DB_PER_COUNT)
    scene = msgspec.structs.replace(scene, seed=seed, sonar=msgspec.structs.replace(scene.sonar, recorder=recorder))
    mission, config = Mission(scene), config_for(scene)
    misread = [
        msgspec.structs.replace(config.sonar, transfer="log", db_per_count=DB_PER_COUNT * factor) for factor in FACTORS
    ]
    pipelines = [Pipeline(msgspec.structs.replace(config, sonar=sonar)) for sonar in (*misread, config.sonar)]
    for event in mission.events():
        for pipeline in pipelines:
            pipeline.feed(event)
    place = f"{name}, seed {seed}"
    truth = parse_truth(mission.truth(), place)
    scored = []
    for pipeline in pipelines:
        pipeline.finish()
        scored.append(
            ScoredMission(parse_contacts(json.loads(contacts_geojson(pipeline.contacts)), place), truth, place)
        )
    return MisreadMission(tuple(scored[:-1]), scored[-1])


def rows(missions: Sequence[MisreadMission]) -> list[list[str]]:
    """Lay out what is found, by factor."""
    names = [f"{factor - 1.0:+.0%}" if factor != 1.0 else "right" for factor in FACTORS]
    read = [[mission.by_factor[k] for mission in missions] for k in range(len(FACTORS))]
    return [
        _row(name, score_missions(scored))
        for name, scored in zip(
            [*names, "estimated"], [*read, [mission.estimated for mission in missions]], strict=True
        )
    ]


def _row(name: str, score: Score) -> list[str]:
    point = score.at_threshold
    return [
        name,
        *(share_cell(headline.pd) for headline in score.headlines),
        share_cell(point.pd),
        density_cell(point.false_alarms),
    ]
