"""Fly the missions that run time and error are measured on: named scenes with legs half as long, and recorded lines
with targets put in."""

from __future__ import annotations

import json
import math
import statistics
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple, TypeAlias

import msgspec
import numpy as np

from auv_mcm.records import NavSample, Ping
from auv_mcm.settings.config import Config
from sim_replay.augment.augment_log import augment
from sim_replay.augment.recorded_line import scattered
from sim_replay.logs.open_log import open_log
from sim_replay.logs.xtf_writer import write_xtf
from sim_replay.missions import config_for
from sim_replay.scoring.inputs import Truth, parse_truth
from sim_replay.simulate import simulate
from sim_replay.simulator.scene import Lawnmower, Scatter, Scene
from sim_replay.simulator.scene_file import read_scene

FIRST_SEED: Final = 9600  # on seeds from here on nothing was ever trained, fitted or tried
LEG_SHARE: Final = 0.5
"""Of a named scene's legs: two to three minutes of sonar, and some 1300 objects per km² on flat sand."""
MissionKind: TypeAlias = Literal["scene", "empty", "recorded", "long"]
"""scene: a named scene; empty: one without its objects; recorded: with targets put in; long: a recording repeated end
to end."""


class BenchMission(NamedTuple):
    """Name a mission to measure on. group: the scene or the recorded log."""

    name: str
    group: str
    kind: MissionKind
    log: Path
    config: Config
    truth: Truth


def with_short_legs(scene: Scene, seed: int) -> Scene:
    """Shorten a scene's legs and set its seed; all its objects lie on them."""
    plan = scene.track.plan
    if isinstance(plan, Lawnmower):
        plan = msgspec.structs.replace(plan, leg_m=plan.leg_m * LEG_SHARE)
    return msgspec.structs.replace(scene, seed=seed, track=msgspec.structs.replace(scene.track, plan=plan))


def fly_scene(scene: Scene, name: str, group: str, folder: Path, kind: MissionKind = "scene") -> BenchMission:
    """Simulate a scene into a folder of its own."""
    done = simulate(scene, folder / name.replace(" ", "-"))
    return BenchMission(
        name, group, kind, done.log, config_for(scene), parse_truth(json.loads(done.truth.read_bytes()), name)
    )


def fly_scenes(
    names: Sequence[str], seeds: Sequence[int], folder: Path, progress: Callable[[str], None]
) -> list[BenchMission]:
    """Fly named scenes with each of the seeds."""
    lines = []
    for name in names:
        for seed in seeds:
            progress(f"flying {name}, seed {seed}")
            lines.append(fly_scene(with_short_legs(read_scene(name), seed), f"{name} {seed}", name, folder))
    return lines


def fly_empty(name: str, seed: int, folder: Path) -> BenchMission:
    """Fly a named scene without any of its objects."""
    bare = without_objects(with_short_legs(read_scene(name), seed))
    return fly_scene(bare, f"{name} {seed} without objects", name, folder, "empty")


def without_objects(scene: Scene) -> Scene:
    """Empty the scene's sea floor."""
    return msgspec.structs.replace(scene, objects=(), scatter=())


def repeated(line: BenchMission, duration_s: float, folder: Path) -> BenchMission:
    """Repeat a line's recording end to end until it lasts so long; its truth holds for the first pass alone."""
    name = f"{line.name} repeated to {duration_s / 60.0:g} min"
    log = folder / (name.replace(" ", "-") + ".xtf")
    write_xtf(log, tiled(line.log, duration_s), sample_type=stored_sample_type(line.log))
    return line._replace(name=name, kind="long", log=log)


def tiled(log: Path, duration_s: float) -> Iterator[NavSample | Ping]:
    """Repeat the log end to end until `duration_s` is reached.

    Each copy is later in time and farther along its own line.
    """
    events = [event for event in open_log(log, Config()) if isinstance(event, NavSample | Ping)]
    times = [event.time_s for event in events if isinstance(event, Ping)]
    period_s = times[-1] - times[0] + statistics.median(np.diff(times).tolist())
    fixes = [event for event in events if isinstance(event, NavSample) and math.isfinite(event.latitude_deg)]
    step_deg = (
        (fixes[-1].latitude_deg - fixes[0].latitude_deg, fixes[-1].longitude_deg - fixes[0].longitude_deg)
        if fixes
        else (0.0, 0.0)
    )
    for copy in range(max(1, math.ceil(duration_s / period_s))):
        for event in events:
            if isinstance(event, Ping):
                yield msgspec.structs.replace(event, time_s=event.time_s + copy * period_s)
            else:
                yield msgspec.structs.replace(
                    event,
                    time_s=event.time_s + copy * period_s,
                    latitude_deg=event.latitude_deg + copy * step_deg[0],
                    longitude_deg=event.longitude_deg + copy * step_deg[1],
                )


def stored_sample_type(log: Path) -> Any:
    """Find the type of the samples of a log."""
    ping = next(event for event in open_log(log, Config()) if isinstance(event, Ping))
    trace = ping.port or ping.starboard
    assert trace is not None
    return str(trace.samples.dtype)


def crowded(scene: Scene, times: float) -> Scene:
    """Multiply a scene's scattered objects, at least one of each kind."""
    scatter: tuple[Scatter, ...] = tuple(
        msgspec.structs.replace(some, count=max(1, round(some.count * times)), apart_m=2.0) for some in scene.scatter
    )
    return msgspec.structs.replace(scene, scatter=scatter)


def augment_logs(
    logs: Sequence[Path], seeds: Sequence[int], folder: Path, progress: Callable[[str], None]
) -> list[BenchMission]:
    """Put targets and rocks into recorded lines, drawn by each of the seeds."""
    lines = []
    for log in logs:
        for seed in seeds:
            progress(f"putting targets into {log.name}, seed {seed}")
            written = augment(log, scattered(seed), folder / f"{log.stem}-{seed}", Config())
            truth = parse_truth(json.loads(written.truth.read_bytes()), log.name)
            lines.append(BenchMission(f"{log.stem} {seed}", log.stem, "recorded", written.log, Config(), truth))
    return lines
