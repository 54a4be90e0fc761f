"""Measure what wrong decibels per count cost in detection.

auv-mcm bench decibels      flies named scenes with a logarithmic recorder, reads the same pings with decibels per count
                            that are right, estimated, and wrong by known factors, and prints what is found
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import partial
from typing import Final

import msgspec

from auv_mcm.contacts.export import contacts_geojson
from auv_mcm.pipeline import Pipeline
from sim_replay.benches.experiment import (
    Cell,
    Column,
    Experiment,
    Task,
    add_experiment_arguments,
    density,
    run_experiment,
    share,
)
from sim_replay.missions import FIRST_SEED, config_for
from sim_replay.scoring import ScoredMission, parse_contacts, parse_truth, score_missions
from sim_replay.scoring.thresholds import pd_at
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.scene import SampleRecorder
from sim_replay.simulator.scene_file import read_scene

FACTORS: Final = {"right": 1.0, "-27%": 0.73, "-15%": 0.85, "+15%": 1.15, "+44%": 1.44}
"""Of the true decibels per count: within 15 % as most estimates are, and the worst estimates of `auv-mcm bench law`."""
ESTIMATED: Final = "estimated"
DB_PER_COUNT: Final = 0.3  # dB per count of the recorder simulated
LIMITS_PER_KM2: Final = (10.0, 30.0, 100.0)  # false alarms per km² at which Pd is printed


def fly(task: Task) -> dict[str, ScoredMission]:
    """Fly a scene with an 8-bit logarithmic recorder and read its pings in every way."""
    scene = read_scene(task.scene)
    recorder = SampleRecorder(samples="log_uint8", db_per_count=DB_PER_COUNT)
    scene = msgspec.structs.replace(
        scene, seed=task.seed, sonar=msgspec.structs.replace(scene.sonar, recorder=recorder)
    )
    mission, config = Mission(scene), config_for(scene)
    sonars = {
        name: msgspec.structs.replace(config.sonar, transfer="log", db_per_count=DB_PER_COUNT * factor)
        for name, factor in FACTORS.items()
    } | {ESTIMATED: config.sonar}
    pipelines = {name: Pipeline(msgspec.structs.replace(config, sonar=sonar)) for name, sonar in sonars.items()}
    for event in mission.events():
        for pipeline in pipelines.values():
            pipeline.feed(event)
    for pipeline in pipelines.values():
        pipeline.finish()
    place = f"{task.scene}, seed {task.seed}"
    truth = parse_truth(mission.truth(), place)
    return {
        name: ScoredMission(parse_contacts(json.loads(contacts_geojson(pipeline.contacts)), place), truth, place)
        for name, pipeline in pipelines.items()
    }


def _pd_at(missions: Sequence[ScoredMission], limit_per_km2: float) -> Cell:
    return share(pd_at(score_missions(missions), limit_per_km2))


EXPERIMENT: Final = Experiment(
    name="decibels",
    scenes=("flat", "ripple", "mixed", "seagrass"),
    first_seed=FIRST_SEED,
    variant_title="decibels per count",
    variants=(*FACTORS, ESTIMATED),
    fly=fly,
    columns=(
        *(Column(f"Pd at {limit:g} FA/km²", partial(_pd_at, limit_per_km2=limit)) for limit in LIMITS_PER_KM2),
        Column("Pd at p_mine 0.5", lambda missions: share(score_missions(missions).at_threshold.pd)),
        Column("FA/km² at p_mine 0.5", lambda missions: density(score_missions(missions).at_threshold.false_alarms)),
    ),
    by_scene=False,
)
add_arguments = partial(add_experiment_arguments, EXPERIMENT)
run = partial(run_experiment, EXPERIMENT)
