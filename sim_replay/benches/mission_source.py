"""Give what one mission of an experiment consists of: a named scene, or a recorded line with targets embedded."""

from __future__ import annotations

import gc
import json
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import msgspec

from auv_mcm.pipeline import Pipeline
from auv_mcm.records import PipelineEvent, SourceEvent
from auv_mcm.settings.config import Config
from sim_replay.augment.augment_log import augment
from sim_replay.augment.recorded_line import scattered
from sim_replay.benches.experiment import Task
from sim_replay.logs.recorded import RecordedMission
from sim_replay.missions import config_for
from sim_replay.scoring.inputs import Truth, parse_truth
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.scene import Scene
from sim_replay.simulator.scene_file import named_scenes, read_scene


class MissionSource(NamedTuple):
    """Hold one mission to fly. truth: to be asked for when all events have been taken."""

    config: Config
    events: Iterator[SourceEvent]
    truth: Callable[[], Truth]


@contextmanager
def mission_source(task: Task, change: Callable[[Scene], Scene] = lambda scene: scene) -> Iterator[MissionSource]:
    """Prepare a task's mission; files that it needs go when it is left. change: of a named scene, after its seed."""
    gc.collect()  # a mission refers to itself: the sea floor of the one before, 300 MB, would stay for long
    place = f"{task.scene}, seed {task.seed}"
    if task.scene in named_scenes():
        scene = change(msgspec.structs.replace(read_scene(task.scene), seed=task.seed))
        mission = Mission(scene)
        yield MissionSource(config_for(scene), mission.events(), lambda: parse_truth(mission.truth(), place))
        return
    with tempfile.TemporaryDirectory() as folder:
        written = augment(Path(task.scene), scattered(task.seed), Path(folder), Config())
        recorded = RecordedMission([written.log], Config())
        yield MissionSource(
            Config(), recorded.events(), lambda: parse_truth(json.loads(written.truth.read_bytes()), place)
        )


def fly_through(
    events: Iterable[SourceEvent],
    pipelines: Mapping[str, Pipeline],
    take: Callable[[PipelineEvent], object] = lambda event: None,
) -> None:
    """Feed the same events to every pipeline, to their end. take: gets what each pipeline returns."""
    for event in events:
        for pipeline in pipelines.values():
            for result in pipeline.feed(event):
                take(result)
    for pipeline in pipelines.values():
        for result in pipeline.finish():
            take(result)
