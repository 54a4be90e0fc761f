"""One mission stored by seven recorders gives the same calls and nearly the same p_mine, with nothing configured.

On flat sand, ripples and rough floor, 51 targets in all.
"""

from __future__ import annotations

import math
from functools import cache
from itertools import combinations
from typing import NamedTuple

import numpy as np
import pytest
from msgspec import structs

from auv_mcm.pipeline import Pipeline
from auv_mcm.records import Contact, Ping, SourceEvent
from auv_mcm.settings.config import Config
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.scene import TARGET_KINDS, Lawnmower, SampleRecorder, Scene
from sim_replay.simulator.scene_file import read_scene
from tests.make.recorders import STORES, Store, stored

SCENES = ("flat", "ripple", "rough")
SEED = 9100
LEG_M = 60.0
N_TARGETS = 17  # on each leg
GATE_M = 3.0


class Found(NamedTuple):
    """What a recorder's mission says of every target: its highest p_mine, 0 without a contact, and its call."""

    p_mine: tuple[float, ...]
    called: tuple[bool, ...]


def one_leg(name: str, leg_m: float = LEG_M, n_targets: int = N_TARGETS) -> Scene:
    """One leg of a shipped scene, crowded with targets, in linear amplitude of which nothing is lost."""
    scene = read_scene(name)
    assert isinstance(scene.track.plan, Lawnmower)
    kinds = [each for each in scene.scatter if each.kind in TARGET_KINDS]
    counts = [n_targets // len(kinds) + (number < n_targets % len(kinds)) for number in range(len(kinds))]
    others = [structs.replace(each, count=each.count // 3) for each in scene.scatter if each.kind not in TARGET_KINDS]
    targets = [structs.replace(each, count=n) for each, n in zip(kinds, counts, strict=True)]
    recorder = SampleRecorder(samples="amplitude_float32", seabed_counts=1.0, full_scale=65535)
    return structs.replace(
        scene,
        seed=SEED,
        scatter=tuple(each for each in (*others, *targets) if each.count),
        sonar=structs.replace(scene.sonar, recorder=recorder),
        track=structs.replace(scene.track, plan=structs.replace(scene.track.plan, n_legs=1, leg_m=leg_m)),
    )


def stored_as(event: SourceEvent, store: Store) -> SourceEvent:
    if not isinstance(event, Ping):
        return event
    traces = {
        side: structs.replace(trace, samples=stored(np.square(trace.samples.astype(np.float64)), store))
        for side, trace in (("port", event.port), ("starboard", event.starboard))
        if trace is not None
    }
    return structs.replace(event, **traces)


@cache
def found(name: str) -> dict[str, Found]:
    mission = Mission(one_leg(name))
    events = list(mission.events())
    targets = [each for each in mission.truth()["objects"] if each["is_target"]]
    by_store = {}
    for store in STORES:
        pipeline = Pipeline(Config())
        for event in events:
            pipeline.feed(stored_as(event, store))
        pipeline.finish()
        nearest = [best_at(target["lat"], target["lon"], pipeline.contacts) for target in targets]
        by_store[store.name] = Found(
            tuple(0.0 if one is None else one.p_mine for one in nearest),
            tuple(one is not None and bool(one.called) for one in nearest),
        )
    return by_store


def best_at(latitude_deg: float, longitude_deg: float, contacts: tuple[Contact, ...]) -> Contact | None:
    north_m, east_m = 111_132.0, 111_320.0 * math.cos(math.radians(latitude_deg))
    near = [
        contact
        for contact in contacts
        if math.hypot((contact.latitude_deg - latitude_deg) * north_m, (contact.longitude_deg - longitude_deg) * east_m)
        <= GATE_M
    ]
    return max(near, key=lambda contact: contact.p_mine, default=None)


def test_the_same_targets_are_called_however_the_mission_was_recorded() -> None:
    """Three of 51 targets at the most: p_mine lies at the threshold, or the detector's odds at theirs."""
    called = {store.name: np.concatenate([found(name)[store.name].called for name in SCENES]) for store in STORES}
    assert len(called[STORES[0].name]) >= 45, "targets that could be seen"
    differences = {(a, b): int((called[a] != called[b]).sum()) for a, b in combinations(called, 2)}
    assert {pair: n for pair, n in differences.items() if n > 3} == {}


@pytest.mark.parametrize("name", SCENES)
def test_p_mine_is_within_a_tenth_in_the_median(name: str) -> None:
    reference = np.array(found(name)[STORES[0].name].p_mine)
    for store in STORES[1:]:
        difference = np.abs(np.array(found(name)[store.name].p_mine) - reference)
        assert np.median(difference[reference > 0.0]) <= 0.1, store.name
