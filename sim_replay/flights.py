"""Prepare a mission that is flown in this process: a scene, or a recorded line with targets embedded."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgspec

from auv_mcm.pipeline import Pipeline
from auv_mcm.records import PipelineEvent, SourceEvent
from auv_mcm.safe_files import read_regular
from auv_mcm.settings.config import Config
from sim_replay.augment.augment_log import augment
from sim_replay.augment.recorded_line import scattered
from sim_replay.logs.recorded import RecordedMission
from sim_replay.missions import config_for
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.scene import Scene

_USUAL: Final = Config()
_NO_LAW: Final = "recorded"  # of recorded lines, whose law is found out each time


class Flight(NamedTuple):
    """Hold a mission that is about to be flown.

    law: how samples are stored. events: its pings and navigation, once. truth: returns its truth after the last event.
    """

    law: str
    config: Config
    events: Iterator[SourceEvent]
    truth: Callable[[], dict[str, Any]]

    def objects(self) -> list[dict[str, Any]]:
        """Return the truth's objects, after the last event."""
        return list(self.truth()["objects"])


def flight_through(scene: Scene, config: Config | None = None) -> Flight:
    """Prepare a flight through a scene. config: of the payload, if not the usual one for the scene's sonar."""
    mission = Mission(scene)
    return Flight(scene.sonar.recorder.samples, config or config_for(scene), mission.events(), mission.truth)


def flight_with_targets(log: Path, truth: Path, config: Config) -> Flight:
    """Prepare the replay of a line with embedded targets. truth: the file that says where they lie."""
    return Flight(
        _NO_LAW, config, RecordedMission([log], config).events(), lambda: dict(json.loads(read_regular(truth)))
    )


@contextmanager
def flight_along(log: Path, seed: int, config: Config = _USUAL) -> Iterator[Flight]:
    """Embed targets and rocks drawn by a seed in a recorded line; its files go when it is left.

    Raises BadInputError or UsageError as augment does.
    """
    with tempfile.TemporaryDirectory() as folder:
        written = augment(log, scattered(seed), Path(folder), msgspec.structs.replace(_USUAL, sonar=config.sonar))
        yield flight_with_targets(written.log, written.truth, config)


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
