"""Give one mission of an experiment: a named scene, or a recorded line with targets embedded."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec

from sim_replay.benches.experiment import Task
from sim_replay.flights import Flight, flight_along, flight_through
from sim_replay.simulator.scene import Scene
from sim_replay.simulator.scene_file import named_scenes, read_scene


@contextmanager
def mission_source(task: Task, change: Callable[[Scene], Scene] = lambda scene: scene) -> Iterator[Flight]:
    """Prepare a task's mission; files that it needs go when it is left. change: of a named scene, after its seed."""
    gc.collect()  # a mission refers to itself: the sea floor of the one before, 300 MB, would stay for long
    if task.scene in named_scenes():
        yield flight_through(change(msgspec.structs.replace(read_scene(task.scene), seed=task.seed)))
        return
    with flight_along(Path(task.scene), task.seed) as flight:
        yield flight
