"""Feed fake devices with a mission, recorded or simulated, on the time line of a run."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator, Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from msgspec import structs

from auv_mcm.errors import UsageError
from auv_mcm.records import NavSample, Ping, SourceEvent
from auv_mcm.settings.config import Config

_BATCH: Final = 16  # events read at once off the event loop


class TimedEvent(NamedTuple):
    """Time a ping or navigation sample in seconds after the run's start; its own time_s is the same."""

    at_s: float
    event: Ping | NavSample


def mission_events(log: Path | None, scene: str | None) -> Iterator[SourceEvent]:
    """Read events of a recorded log, or of a scene: a file or the name of one that ships with the package.

    Echo samples are taken for amplitudes unless a log marks them as intensities. Raises UsageError unless
    exactly one is given, or for a scene that stores logarithms; BadInputError for a log that cannot be used.
    """
    if (log is None) == (scene is None):
        raise UsageError("a fake device plays one mission: give either a log or a scene")
    if log is not None:
        from sim_replay.logs.recorded import RecordedMission  # either kind of mission costs most of a start

        return map(_of_amplitudes, RecordedMission([log], Config()).events())
    from sim_replay.simulator.mission import Mission
    from sim_replay.simulator.recording import complete
    from sim_replay.simulator.scene_file import read_scene

    assert scene is not None
    mission = Mission(read_scene(scene))
    samples = complete(mission.sea.recorder).samples
    if samples.startswith("log"):
        raise UsageError(
            f"scene {scene} stores '{samples}', but fake sonars are fed with amplitudes: give sonar.samples an "
            "amplitude"
        )
    return mission.events()


def _of_amplitudes(event: SourceEvent) -> SourceEvent:
    """Take the root of a ping's samples where they are intensities: fake sonars are fed with amplitudes."""
    if not isinstance(event, Ping) or event.transfer != "intensity":
        return event
    port, starboard = (
        None if trace is None else structs.replace(trace, samples=np.sqrt(trace.samples))
        for trace in (event.port, event.starboard)
    )
    return structs.replace(event, port=port, starboard=starboard, transfer="amplitude")


def time_line(events: Iterable[SourceEvent], speed: float) -> Iterator[TimedEvent]:
    """Play events at `speed` times real time, from the first one on, never going back; untimed events are dropped.

    The vehicle really is that much faster then: it reports `speed` times its speed, so that times, places and speeds
    agree.
    """
    start_s, last_s = math.nan, 0.0
    for event in events:
        if not isinstance(event, Ping | NavSample) or not math.isfinite(event.time_s):
            continue
        if math.isnan(start_s):
            start_s = event.time_s
        last_s = max(last_s, (event.time_s - start_s) / speed)
        if isinstance(event, NavSample):
            yield TimedEvent(last_s, structs.replace(event, time_s=last_s, speed_mps=event.speed_mps * speed))
        else:
            yield TimedEvent(last_s, structs.replace(event, time_s=last_s))


async def read_ahead(events: Iterator[TimedEvent]) -> AsyncIterator[TimedEvent]:
    """Read the same events off the event loop while earlier ones are played."""

    def read_on() -> asyncio.Future[list[TimedEvent]]:
        return asyncio.ensure_future(asyncio.to_thread(lambda: list(islice(events, _BATCH))))

    reading = read_on()
    while batch := await reading:
        reading = read_on()
        for fed in batch:
            yield fed
