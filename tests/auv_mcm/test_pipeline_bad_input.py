"""Whatever arrives, the chain goes on: flagged, counted, degraded, but whole. Warnings are errors here, so nothing divides by zero."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from functools import cache

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import NAN, CoveragePatch, EchoTrace, NavSample, Notice, Ping, PipelineEvent, SourceEvent
from auv_mcm.settings.config import Config
from sim_replay.simulator.scene import SceneObject, Sonar
from tests.auv_mcm.short_missions import flown, one_leg

LATITUDE, LONGITUDE = 50.0, -4.0
TARGET = (22.0, 9.0)  # along, across, metres
Change = Callable[[int, Ping], Ping | None]


@cache
def mission() -> tuple[SourceEvent, ...]:
    target = SceneObject(kind="box", leg=0, along_m=TARGET[0], across_m=TARGET[1], length_m=0.9, width_m=0.7, height_m=0.45)
    sonar = Sonar(range_m=22.0, n_samples=512, ping_rate_hz=12.0, range_resolution_m=0.0, beam_lines=3)
    return flown(one_leg([target], sonar, length_m=44.0, altitude_m=4.0, latitude_deg=LATITUDE, longitude_deg=LONGITUDE))


def run(events: Iterable[SourceEvent]) -> tuple[Pipeline, list[PipelineEvent]]:
    pipeline = Pipeline(Config())
    out = [result for event in events for result in pipeline.feed(event)]
    return pipeline, out + pipeline.finish()


def changed(change: Change) -> Iterator[SourceEvent]:
    """The mission with every ping replaced by what `change` makes of its running number and itself; None leaves it out."""
    number = -1
    for event in mission():
        if not isinstance(event, Ping):
            yield event
            continue
        number += 1
        ping = change(number, event)
        if ping is not None:
            yield ping


def resampled(ping: Ping, make: Callable[[NDArray[np.generic]], NDArray[np.generic]]) -> Ping:
    def of(trace: EchoTrace | None) -> EchoTrace | None:
        return None if trace is None else msgspec.structs.replace(trace, samples=make(trace.samples))

    return msgspec.structs.replace(ping, port=of(ping.port), starboard=of(ping.starboard))


def finds_the_target(pipeline: Pipeline, within_m: float = 0.8) -> bool:
    frame = LocalFrame(latitude_deg=LATITUDE, longitude_deg=LONGITUDE)
    for contact in pipeline.contacts:
        east, north, _ = frame.to_enu(contact.latitude_deg, contact.longitude_deg, 0.0)
        if contact.p_mine > 0.5 and math.hypot(north - TARGET[0], east - TARGET[1]) < within_m:
            return True
    return False


def covered_m2(events: list[PipelineEvent]) -> float:
    return sum(event.covered_m2 for event in events if isinstance(event, CoveragePatch))


def test_the_undisturbed_mission_finds_its_target() -> None:
    assert finds_the_target(run(list(mission()))[0])


def half_the_samples(samples: NDArray[np.generic]) -> NDArray[np.generic]:
    return samples[: samples.shape[0] // 2]


SMALL_DISTURBANCES: dict[str, Change] = {
    "one ping with half as many samples": lambda n, p: resampled(p, half_the_samples) if n == 60 else p,
    "one ping with no samples": lambda n, p: resampled(p, lambda s: s[:0]) if n == 60 else p,
    "one ping of one sample": lambda n, p: resampled(p, lambda s: s[:1]) if n == 60 else p,
    "one ping with NaN": lambda n, p: resampled(p, lambda s: np.full(s.shape, np.nan)) if n == 60 else p,
    "one ping with infinity": lambda n, p: resampled(p, lambda s: np.full(s.shape, np.inf)) if n == 60 else p,
    "one ping all zero": lambda n, p: resampled(p, np.zeros_like) if n == 60 else p,
    "one ping all at full scale": lambda n, p: resampled(p, lambda s: np.full_like(s, 32767)) if n == 60 else p,
    "one ping of text": lambda n, p: resampled(p, lambda s: s.astype("U8")) if n == 60 else p,
    "one ping folded to two dimensions": lambda n, p: resampled(p, lambda s: s.reshape(2, -1)) if n == 60 else p,
    "one ping without either side": lambda n, p: msgspec.structs.replace(p, port=None, starboard=None) if n == 60 else p,
    "one ping at no time": lambda n, p: msgspec.structs.replace(p, time_s=NAN) if n == 60 else p,
    "one ping twice as late as it was": lambda n, p: msgspec.structs.replace(p, time_s=p.time_s - 0.1) if n == 60 else p,
    "sample type changes half-way": lambda n, p: resampled(p, lambda s: s.astype(np.float64)) if n > 100 else p,
    "port falls silent": lambda n, p: msgspec.structs.replace(p, port=None) if n > 30 else p,
    "port stuck": lambda n, p: msgspec.structs.replace(p, port=first_port()) if n > 30 else p,
    "one sample in a hundred missing": lambda n, p: resampled(p, lambda s: punched(s, n)),
    "every tenth ping lost": lambda n, p: None if n % 10 == 3 else p,
    "altitude wrong by a factor of three": lambda _, p: msgspec.structs.replace(p, altitude_m=12.0),
    "altitude negative": lambda _, p: msgspec.structs.replace(p, altitude_m=-1.0),
}


def first_port() -> EchoTrace | None:
    return next(event for event in mission() if isinstance(event, Ping)).port


def punched(samples: NDArray[np.generic], seed: int) -> NDArray[np.generic]:
    holed = samples.astype(np.float32)
    holed[np.random.default_rng(seed).random(holed.shape) < 0.01] = np.nan
    return holed


@pytest.mark.parametrize("name", list(SMALL_DISTURBANCES))
def test_a_disturbance_elsewhere_does_not_lose_the_target(name: str) -> None:
    pipeline, events = run(changed(SMALL_DISTURBANCES[name]))
    assert finds_the_target(pipeline)
    assert covered_m2(events) > 300.0


@pytest.mark.parametrize(
    ("name", "counter"),
    [
        ("one ping with NaN", "quality.sample_not_finite_or_negative"),
        ("one ping of text", "ping.trace_unusable"),
        ("one ping with no samples", "ping.trace_unusable"),
        ("one ping at no time", "ping.time_not_finite"),
        ("one ping without either side", "ping.without_samples"),
        ("one ping twice as late as it was", "ping.time_backwards"),
        ("port stuck", "quality.port_stuck"),
    ],
)
def test_what_was_refused_is_counted(name: str, counter: str) -> None:
    pipeline, _ = run(changed(SMALL_DISTURBANCES[name]))
    assert pipeline.counters[counter] > 0, dict(pipeline.counters)


LARGE_DISTURBANCES: dict[str, Change] = {
    "noise alone": lambda n, p: resampled(p, lambda s: np.random.default_rng(n).integers(0, 50, s.shape).astype(np.uint16)),
    "all zero": lambda _, p: resampled(p, np.zeros_like),
    "constant": lambda _, p: resampled(p, lambda s: np.full_like(s, 7)),
    "all full scale": lambda _, p: resampled(p, lambda s: np.full_like(s, 65535)),
    "all NaN": lambda _, p: resampled(p, lambda s: np.full(s.shape, np.nan, dtype=np.float32)),
    "one bit": lambda _, p: resampled(p, lambda s: np.greater(s.astype(np.int64), 1500).astype(np.uint8)),
    "checkerboard": lambda n, p: resampled(p, lambda s: ((np.arange(s.shape[0]) + n) % 2 * 1000).astype(np.uint16)),
    "largest floats": lambda _, p: resampled(p, lambda s: s.astype(np.float32) * np.float32(1e30)),
    "denormal floats": lambda _, p: resampled(p, lambda s: s.astype(np.float64) * 1e-312),
    "negative": lambda _, p: resampled(p, lambda s: -s.astype(np.int32)),
    "half of all pings lost at random": lambda n, p: None if np.random.default_rng(n).random() < 0.5 else p,
    "a layout of its own for every ping": lambda n, p: resampled(p, lambda s: s[: 512 - n % 7]),
    "clock runs backwards": lambda n, p: msgspec.structs.replace(p, time_s=2e9 - n),
    "clock steps back an hour half-way": lambda n, p: msgspec.structs.replace(p, time_s=p.time_s - 3600.0 * (n > 150)),
    "vehicle stands still": lambda n, p: msgspec.structs.replace(p, time_s=p.time_s + 1e-6 * n),
}


@pytest.mark.parametrize("name", list(LARGE_DISTURBANCES))
def test_the_chain_survives(name: str) -> None:
    pipeline, events = run(changed(LARGE_DISTURBANCES[name]))
    assert all(math.isfinite(contact.latitude_deg) and 0.0 <= contact.p_mine <= 1.0 for contact in pipeline.contacts)
    assert all(math.isfinite(event.covered_m2) for event in events if isinstance(event, CoveragePatch))


NavigationChange = Callable[[NavSample], NavSample | None]
REPLACE = msgspec.structs.replace
NAVIGATION: dict[str, NavigationChange] = {
    "none": lambda _: None,
    "all zero": lambda s: NavSample(time_s=s.time_s, latitude_deg=0.0, longitude_deg=0.0, heading_rad=0.0, depth_m=0.0, speed_mps=0.0),
    "all NaN": lambda s: NavSample(time_s=s.time_s),
    "positions alone": lambda s: NavSample(time_s=s.time_s, latitude_deg=s.latitude_deg, longitude_deg=s.longitude_deg),
    "no positions": lambda s: REPLACE(s, latitude_deg=NAN, longitude_deg=NAN),
    "no time": lambda s: REPLACE(s, time_s=NAN),
    "nonsense": lambda s: REPLACE(s, latitude_deg=1e9, longitude_deg=-1e9, heading_rad=1e9, pitch_rad=99.0, speed_mps=-5.0, depth_m=1e12),
    "infinite": lambda s: REPLACE(s, latitude_deg=math.inf, heading_rad=math.inf, speed_mps=math.inf),
}


@pytest.mark.parametrize("name", list(NAVIGATION))
def test_navigation_that_cannot_be_used_is_flagged_and_counted(name: str) -> None:
    events = [out for event in mission() if (out := NAVIGATION[name](event) if isinstance(event, NavSample) else event) is not None]
    pipeline, results = run(events)
    if name == "positions alone":  # heading and speed made good over the fixes will do
        assert finds_the_target(pipeline)
        assert pipeline.counters["navigation.heading_from_course"] > 0
        return
    assert not pipeline.contacts
    assert covered_m2(results) == 0.0
    assert pipeline.counters["navigation.ping_stale"] == pipeline.counters["ping.received"]
    assert pipeline.counters["detect.without_position"] > 0


def test_one_channel_only_is_enough() -> None:
    assert finds_the_target(run(changed(lambda _, ping: msgspec.structs.replace(ping, port=None)))[0])


@pytest.mark.parametrize("n_pings", [0, 1, 2, 63, 64, 65])
def test_a_mission_of_few_pings_ends_properly(n_pings: int) -> None:
    pings = [event for event in mission() if isinstance(event, Ping)][:n_pings]
    last_s = pings[-1].time_s if pings else -math.inf
    few = [event for event in mission() if isinstance(event, NavSample | Ping) and event.time_s <= last_s]
    pipeline, events = run(few)
    assert pipeline.counters["ping.received"] == n_pings
    assert any(isinstance(event, Notice) for event in events) == (n_pings > 0)


def test_candidates_beyond_the_budget_are_told() -> None:
    config = msgspec.convert({"detect": {"max_candidates_per_tile": 3}}, Config)
    pipeline = Pipeline(config)
    events = [result for event in mission() for result in pipeline.feed(event)] + pipeline.finish()
    assert pipeline.counters["detect.over_budget"] > 0
    assert any(isinstance(event, Notice) and event.code == "detect.over_budget" for event in events)
    assert finds_the_target(pipeline)  # the best first
