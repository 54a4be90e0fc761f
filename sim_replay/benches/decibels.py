"""Measure what wrong decibels per count cost in detection.

auv-mcm bench decibels      flies named scenes with a logarithmic recorder, reads the same pings with decibels per count
                            that are right, estimated, and wrong by known factors, and prints what is found
"""

from __future__ import annotations

from functools import partial
from typing import Final

import msgspec

from auv_mcm.pipeline import Pipeline
from sim_replay.benches.experiment import Column, Experiment, Task, add_experiment_arguments, run_experiment
from sim_replay.benches.mission_source import fly_through, mission_source
from sim_replay.benches.score_columns import density_at, pd_at_limit, pd_at_threshold
from sim_replay.missions import FIRST_SEED
from sim_replay.scoring.inputs import ScoredMission, as_reported
from sim_replay.simulator.scene import SampleRecorder, Scene

FACTORS: Final = {"right": 1.0, "-27%": 0.73, "-15%": 0.85, "+15%": 1.15, "+44%": 1.44}
"""Of the true decibels per count: within 15 % as most estimates are, and the worst estimates of `auv-mcm bench law`."""
ESTIMATED: Final = "estimated"
DB_PER_COUNT: Final = 0.3  # dB per count of the recorder simulated


def recorded_as_decibels(scene: Scene) -> Scene:
    """Give a scene an 8-bit logarithmic recorder."""
    recorder = SampleRecorder(samples="log_uint8", db_per_count=DB_PER_COUNT)
    return msgspec.structs.replace(scene, sonar=msgspec.structs.replace(scene.sonar, recorder=recorder))


def fly(task: Task) -> dict[str, ScoredMission]:
    """Fly a scene with a logarithmic recorder and read its pings in every way."""
    with mission_source(task, recorded_as_decibels) as source:
        config = source.config
        sonars = {
            name: msgspec.structs.replace(config.sonar, transfer="log", db_per_count=DB_PER_COUNT * factor)
            for name, factor in FACTORS.items()
        } | {ESTIMATED: config.sonar}
        pipelines = {name: Pipeline(msgspec.structs.replace(config, sonar=sonar)) for name, sonar in sonars.items()}
        fly_through(source.events, pipelines)
        truth = source.truth()
    return {
        name: ScoredMission(as_reported(pipeline.contacts, task.scene), truth, task.scene)
        for name, pipeline in pipelines.items()
    }


EXPERIMENT: Final = Experiment(
    name="decibels",
    scenes=("flat", "ripple", "mixed", "seagrass"),
    first_seed=FIRST_SEED,
    variant_title="decibels per count",
    variants=(*FACTORS, ESTIMATED),
    fly=fly,
    columns=(
        *(Column(f"Pd at {limit:g} FA/km²", partial(pd_at_limit, limit)) for limit in (10.0, 30.0, 100.0)),
        Column("Pd at p_mine 0.5", pd_at_threshold),
        Column("FA/km² at p_mine 0.5", density_at),
    ),
    by_scene=False,
)
add_arguments = partial(add_experiment_arguments, EXPERIMENT)
run = partial(run_experiment, EXPERIMENT)
