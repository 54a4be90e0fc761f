"""Simulate one short line past two objects, and judge what the chain makes of a recording of it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import cache
from typing import Final, NamedTuple

from msgspec import structs

from auv_mcm.pipeline import Pipeline
from auv_mcm.records import Contact, CoveragePatch, NavSample, Notice, Ping, SourceEvent
from auv_mcm.settings.config import Config
from drivers.navigation.corrections import offset_m
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.scene import EXACT, Lawnmower, Scene, SceneObject, Sonar, Track

RANGE_M: Final = 20.0
HEADING_DEG: Final = 20.0
_WITHIN_M: Final = 1.0  # of its true place an object has to be found
_AREA_SHARE: Final = 0.25  # by which the area covered may differ from that of the sound recording


class Line(NamedTuple):
    """Hold the events of the line in order of time, and the true places of its objects, latitude first, and sides."""

    events: tuple[NavSample | Ping, ...]
    objects: tuple[tuple[float, float, str], ...]


class Result(NamedTuple):
    """Hold what the chain made of a recording: contacts, codes of notices, area covered, m^2."""

    contacts: tuple[Contact, ...]
    codes: frozenset[str]
    area_m2: float


@cache
def line() -> Line:
    """Fly the line: 1.5 m/s or so, 40 m, a box on each side."""
    places = ((14.0, 10.0), (26.0, -9.0))
    objects = tuple(
        SceneObject(kind="box", leg=0, along_m=along_m, across_m=across_m, length_m=0.9, width_m=0.7, height_m=0.45)
        for along_m, across_m in places
    )
    sonar = Sonar(range_m=RANGE_M, n_samples=500, ping_rate_hz=10.0, beam_lines=3)
    track = Track(plan=Lawnmower(heading_deg=HEADING_DEG, n_legs=1, leg_m=40.0), altitude_m=5.0)
    mission = Mission(Scene(objects=objects, sonar=sonar, track=track, navigation_error=EXACT))
    events = tuple(mission.events())
    truth = mission.truth()
    return Line(
        events,
        tuple(
            (one["lat"], one["lon"], "starboard" if across_m > 0.0 else "port")
            for one, (_, across_m) in zip(truth["objects"], places, strict=True)
        ),
    )


def chain(events: Iterable[SourceEvent], config: Config) -> Result:
    """Run the chain over the events of a log."""
    pipeline = Pipeline(structs.replace(config, ports=()))
    codes: set[str] = set()
    area_m2 = 0.0
    for event in [*events, None]:
        if isinstance(event, Notice):
            codes.add(event.code)
            continue
        for one in pipeline.finish() if event is None else pipeline.feed(event):
            if isinstance(one, Notice):
                codes.add(one.code)
            elif isinstance(one, CoveragePatch):
                area_m2 += one.covered_m2
    return Result(tuple(pipeline.contacts), frozenset(codes), area_m2)


@cache
def sound() -> Result:
    """Run the chain over the line as it is."""
    return chain(line().events, Config())


def faults(result: Result) -> list[str]:
    """List what is wrong with a result: objects not found in their places, on the other side, or floor miscounted."""
    found = []
    for latitude, longitude, side in line().objects:
        near = [
            contact
            for contact in result.contacts
            if math.hypot(*offset_m((latitude, longitude), (contact.latitude_deg, contact.longitude_deg))) <= _WITHIN_M
        ]
        if not near:
            found.append(f"the object to {side} is not found within {_WITHIN_M:g} m")
        elif not any(detection.side == side for contact in near for detection in contact.views):
            found.append(f"the object to {side} is found on the other side")
    share = result.area_m2 / sound().area_m2
    if abs(share - 1.0) > _AREA_SHARE:
        found.append(f"{share:.2f} times the area is covered")
    return found
