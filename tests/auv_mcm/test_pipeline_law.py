"""What the chain does where the law of the recorder is not known, or changes on the way."""

from __future__ import annotations

from functools import cache

import msgspec
import numpy as np
import pytest

from auv_mcm.contacts.export import contacts_geojson
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import EchoTrace, Notice, Ping, PipelineEvent, SourceEvent, Tile
from auv_mcm.settings.config import Config, SonarConfig
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.scene import Lawnmower, SampleRecorder, Scene, Sonar, Track

N_AMPLITUDE = 280


@cache
def events(n_amplitude: int = N_AMPLITUDE) -> tuple[SourceEvent, ...]:
    """A leg of 120 m whose recorder stores amplitudes first, then averaged logarithms in 8 bits, as another one
    would."""
    recorder = SampleRecorder(samples="amplitude_float32", seabed_counts=1.0, full_scale=65535)
    sonar = Sonar(looks=3, n_samples=600, range_m=40.0, recorder=recorder)
    scene = Scene(seed=5, sonar=sonar, track=Track(plan=Lawnmower(n_legs=1, leg_m=120.0)))
    given = list(Mission(scene).events())
    n_pings = 0
    for index, event in enumerate(given):
        if isinstance(event, Ping):
            n_pings += 1
            traces = {side: _stored(getattr(event, side), n_pings > n_amplitude) for side in ("port", "starboard")}
            given[index] = msgspec.structs.replace(event, **traces)
    return tuple(given)


def _stored(trace: EchoTrace, logarithm: bool) -> EchoTrace:
    amplitude = trace.samples.astype(np.float64)
    counts = 130.0 + 20.0 * np.log10(np.maximum(amplitude, 1e-9)) / 0.35 if logarithm else 35.0 * amplitude
    return msgspec.structs.replace(trace, samples=np.clip(np.rint(counts), 0, 255).astype(np.uint8))


@cache
def run(sonar: SonarConfig, n_amplitude: int = N_AMPLITUDE) -> tuple[list[PipelineEvent], Pipeline]:
    pipeline = Pipeline(Config(sonar=sonar))
    out = [event for given in events(n_amplitude) for event in pipeline.feed(given)]
    return out + pipeline.finish(), pipeline


def last_texture(out: list[PipelineEvent]) -> float:
    """Standard deviation of ln intensity in the last tile: far less than it should be where logarithms are squared."""
    tile = [event for event in out if isinstance(event, Tile)][-1]
    return float(np.log(tile.intensity[tile.intensity > 0.0]).std())


def test_after_the_law_turns_the_picture_is_read_by_the_new_law_and_statistics_start_anew() -> None:
    out, pipeline = run(SonarConfig())
    codes = [event.code for event in out if isinstance(event, Notice) and event.code.startswith("transfer")]
    assert codes[:2] == ["transfer.chosen", "transfer.turned"]
    assert pipeline.counters["transfer.turned"] == len(codes) - 1
    as_recorded, _ = run(SonarConfig(transfer="log", db_per_count=0.35), 0)
    misread, _ = run(SonarConfig(transfer="amplitude"))
    assert last_texture(out) == pytest.approx(last_texture(as_recorded), rel=0.15)
    assert last_texture(misread) < 0.6 * last_texture(as_recorded)


def test_a_configured_law_stays_and_is_doubted() -> None:
    out, pipeline = run(SonarConfig(transfer="amplitude"))
    codes = [event.code for event in out if isinstance(event, Notice) and event.code.startswith("transfer")]
    assert codes == ["transfer.disagrees"]
    assert pipeline.counters["transfer.turned"] == 0


def test_a_law_that_turns_gives_the_same_contacts_each_time() -> None:
    _, first = run(SonarConfig())
    second = Pipeline(Config())
    for event in events():
        second.feed(event)
    second.finish()
    assert contacts_geojson(first.contacts) == contacts_geojson(second.contacts)
    assert first.counters == second.counters
