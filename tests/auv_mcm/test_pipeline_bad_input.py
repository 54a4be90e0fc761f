"""Whatever arrives, the chain goes on: flagged, counted, degraded, but whole.

Warnings are errors here, so nothing divides by zero.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from functools import cache

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from auv_mcm import pipeline as pipeline_module
from auv_mcm.clearance.coverage import cover_tile
from auv_mcm.contacts.contact import sigma_m
from auv_mcm.defects import DefectWarning
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import NAN, CoveragePatch, EchoTrace, NavSample, Notice, Ping, PipelineEvent, SourceEvent
from auv_mcm.settings.config import Config, WaterfallConfig
from sim_replay.simulator.scene import SceneObject, Sonar
from tests.auv_mcm.short_missions import flown, one_leg

LATITUDE, LONGITUDE = 50.0, -4.0
TARGET = (16.0, 9.0)  # along, across, metres
Change = Callable[[int, Ping], Ping | None]


@cache
def mission() -> tuple[SourceEvent, ...]:
    target = SceneObject(
        kind="box", leg=0, along_m=TARGET[0], across_m=TARGET[1], length_m=0.9, width_m=0.7, height_m=0.45
    )
    sonar = Sonar(range_m=22.0, n_samples=512, ping_rate_hz=12.0, range_resolution_m=0.0, beam_lines=3)
    return flown(
        one_leg([target], sonar, length_m=32.0, altitude_m=4.0, latitude_deg=LATITUDE, longitude_deg=LONGITUDE)
    )


def run(events: Iterable[SourceEvent]) -> tuple[Pipeline, list[PipelineEvent]]:
    pipeline = Pipeline(Config())
    out = [result for event in events for result in pipeline.feed(event)]
    return pipeline, out + pipeline.finish()


def changed(change: Change) -> Iterator[SourceEvent]:
    """The mission with every ping replaced by what `change` makes of its running number and itself; None leaves it
    out."""
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


@cache
def undisturbed() -> tuple[Pipeline, list[PipelineEvent]]:
    return run(mission())


def covered_m2(events: list[PipelineEvent]) -> float:
    return sum(event.covered_m2 for event in events if isinstance(event, CoveragePatch))


def test_the_undisturbed_mission_finds_its_target() -> None:
    assert finds_the_target(undisturbed()[0])


def test_an_object_at_the_end_of_one_log_and_the_beginning_of_the_next_is_one_contact() -> None:
    pipeline, of_m = Pipeline(Config(waterfall=WaterfallConfig(tile_rows=160))), len(mission()) / 32.0
    for event in mission()[: int(18.0 * of_m)]:
        pipeline.feed(event)
    for event in mission()[int(13.0 * of_m) :]:
        assert isinstance(event, Ping | NavSample)
        pipeline.feed(msgspec.structs.replace(event, time_s=event.time_s + 1000.0))
    pipeline.finish()
    (contact,) = (one for one in pipeline.contacts if one.p_mine > 0.5)
    assert len(contact.views) == 2
    assert abs(contact.views[1].row - contact.views[0].row) * contact.views[0].row_spacing_m < 10.0


@pytest.mark.parametrize(
    "stamped",
    [
        lambda n, event: NAN if n == 0 and isinstance(event, Ping) else event.time_s,
        lambda n, event: event.time_s + 1e6 * (n == 0 and isinstance(event, Ping)),
        lambda n, event: event.time_s - 3600.0 * (n >= 100),
    ],
    ids=["first ping at no time", "first ping far ahead", "clock set back"],
)
def test_no_wrong_stamp_earns_coverage_for_samples_too_far_apart(
    stamped: Callable[[int, Ping | NavSample], float],
) -> None:
    events, n_pings = [], 0
    for event in changed(lambda _, ping: coarser(ping, 16)):
        assert not isinstance(event, Notice)
        events.append(msgspec.structs.replace(event, time_s=stamped(n_pings, event)))
        n_pings += isinstance(event, Ping)
    _, out = run(events)
    patches = [event for event in out if isinstance(event, CoveragePatch)]
    assert patches
    assert [patch.covered_m2 for patch in patches] == [0.0] * len(patches)
    assert [event.code for event in out if isinstance(event, Notice)].count("coverage.samples_too_coarse") == 1


def coarser(ping: Ping, by: int) -> Ping:
    """The ping with every sample but each `by`-th left out."""

    def of(trace: EchoTrace | None) -> EchoTrace | None:
        kept = None if trace is None else trace.samples[::by]
        return None if trace is None else msgspec.structs.replace(trace, samples=kept, spacing_m=by * trace.spacing_m)

    return msgspec.structs.replace(ping, port=of(ping.port), starboard=of(ping.starboard))


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
    "one ping without either side": lambda n, p: (
        msgspec.structs.replace(p, port=None, starboard=None) if n == 60 else p
    ),
    "one ping at no time": lambda n, p: msgspec.structs.replace(p, time_s=NAN) if n == 60 else p,
    "one ping twice as late as it was": lambda n, p: (
        msgspec.structs.replace(p, time_s=p.time_s - 0.1) if n == 60 else p
    ),
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


REFUSED = {
    "one ping with NaN": "quality.sample_not_finite_or_negative",
    "one ping of text": "ping.trace_unusable",
    "one ping with no samples": "ping.trace_unusable",
    "one ping at no time": "ping.time_not_finite",
    "one ping without either side": "ping.without_samples",
    "one ping twice as late as it was": "ping.time_backwards",
    "port stuck": "quality.port_stuck",
}


@pytest.mark.parametrize("name", list(SMALL_DISTURBANCES))
def test_a_disturbance_elsewhere_does_not_lose_the_target_and_what_is_refused_is_counted(name: str) -> None:
    pipeline, events = run(changed(SMALL_DISTURBANCES[name]))
    assert finds_the_target(pipeline)
    assert covered_m2(events) > 300.0
    assert name not in REFUSED or pipeline.counters[REFUSED[name]] > 0, dict(pipeline.counters)


LARGE_DISTURBANCES: dict[str, Change] = {
    "noise alone": lambda n, p: resampled(
        p, lambda s: np.random.default_rng(n).integers(0, 50, s.shape).astype(np.uint16)
    ),
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
    "clock runs backwards": lambda n, p: msgspec.structs.replace(p, time_s=2e9 - n) if n < 80 else None,
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
    "all zero": lambda s: NavSample(
        time_s=s.time_s, latitude_deg=0.0, longitude_deg=0.0, heading_rad=0.0, depth_m=0.0, speed_mps=0.0
    ),
    "all NaN": lambda s: NavSample(time_s=s.time_s),
    "positions alone": lambda s: NavSample(time_s=s.time_s, latitude_deg=s.latitude_deg, longitude_deg=s.longitude_deg),
    "no positions": lambda s: REPLACE(s, latitude_deg=NAN, longitude_deg=NAN),
    "no time": lambda s: REPLACE(s, time_s=NAN),
    "nonsense": lambda s: REPLACE(
        s, latitude_deg=1e9, longitude_deg=-1e9, heading_rad=1e9, pitch_rad=99.0, speed_mps=-5.0, depth_m=1e12
    ),
    "infinite": lambda s: REPLACE(s, latitude_deg=math.inf, heading_rad=math.inf, speed_mps=math.inf),
}


@pytest.mark.parametrize("name", list(NAVIGATION))
def test_navigation_that_cannot_be_used_is_flagged_and_counted(name: str) -> None:
    events = [
        out
        for event in mission()
        if (out := NAVIGATION[name](event) if isinstance(event, NavSample) else event) is not None
    ]
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


@pytest.mark.parametrize("level", [3.0, 300.0])
def test_a_side_that_hears_noise_alone_earns_no_coverage_and_the_other_does(level: float) -> None:
    def noisy(number: int, ping: Ping) -> Ping:
        noise = resampled(ping, lambda s: np.random.default_rng(number).rayleigh(level, s.shape).astype(np.float32))
        return msgspec.structs.replace(ping, port=noise.port)

    pipeline, events = run(changed(noisy))
    patches = [event for event in events if isinstance(event, CoveragePatch)]
    assert covered_m2([patch for patch in patches if patch.side == "port"]) == 0.0
    assert covered_m2(list(patches)) == covered_m2(
        [e for e in undisturbed()[1] if isinstance(e, CoveragePatch) and e.side == "starboard"]
    )
    assert pipeline.counters["quality.port_floor_not_heard"] == pipeline.counters["ping.received"]


@pytest.mark.parametrize("n_pings", [0, 1, 2, 63, 64, 65])
def test_a_mission_of_few_pings_ends_properly(n_pings: int) -> None:
    pings = [event for event in mission() if isinstance(event, Ping)][:n_pings]
    last_s = pings[-1].time_s if pings else -math.inf
    few = [event for event in mission() if isinstance(event, NavSample | Ping) and event.time_s <= last_s]
    pipeline, events = run(few)
    assert pipeline.counters["ping.received"] == n_pings
    assert any(isinstance(event, Notice) for event in events) == (n_pings > 0)


def test_candidates_beyond_the_budget_are_reported() -> None:
    config = msgspec.convert(
        {"detect": {"model": "none", "max_candidates_per_tile": 3}, "contacts": {"min_p_mine": 0.0}}, Config
    )
    pipeline = Pipeline(config)
    events = [result for event in mission() for result in pipeline.feed(event)] + pipeline.finish()
    assert pipeline.counters["detect.over_budget"] > 0
    assert any(isinstance(event, Notice) and event.code == "detect.over_budget" for event in events)
    assert finds_the_target(pipeline)  # the best first


# --- a stage that fails ----------------------------------------------------------------------------------------------


class FailsOnce:
    """A stage whose first call fails."""

    def __init__(self, error: Exception, stage: Callable[..., object]) -> None:
        self._error: Exception | None = error
        self._stage = stage

    def __call__(self, *arguments: object, **options: object) -> object:
        error, self._error = self._error, None
        if error is not None:
            raise error
        return self._stage(*arguments, **options)


STAGES = {  # what fails: name in the pipeline, counter, what the notice says of it
    "detection": ("detect_tile", "pipeline.detection_failed", "not covered"),
    "coverage": ("cover_tile", "pipeline.coverage_failed", "not covered"),
    "sea floor": ("seabed_cells", "pipeline.coverage_failed", "not covered"),
    "confirmation": ("confirm_detection", "pipeline.close_look_failed", "keeps the detector's p_mine"),
}


@pytest.mark.filterwarnings("ignore::auv_mcm.defects.DefectWarning")
@pytest.mark.parametrize(
    "error",
    [MemoryError("Unable to allocate 4.9 GiB"), IndexError("index 7 is out of bounds")],
    ids=["memory", "index"],
)
@pytest.mark.parametrize("stage", list(STAGES))
def test_a_stage_that_fails_on_one_tile_costs_that_tile_and_not_the_mission(
    stage: str, error: Exception, monkeypatch: pytest.MonkeyPatch
) -> None:
    name, counter, consequence = STAGES[stage]
    whole = covered_m2(undisturbed()[1])
    monkeypatch.setattr(pipeline_module, name, FailsOnce(error, getattr(pipeline_module, name)))
    pipeline, events = run(list(mission()))
    assert pipeline.counters[counter] == 1
    (notice,) = [event for event in events if isinstance(event, Notice) and event.code == "pipeline.tile_failed"]
    assert str(error) in notice.text
    assert consequence in notice.text
    assert notice.place
    patches = [event for event in events if isinstance(event, CoveragePatch)]
    if stage == "confirmation":
        assert covered_m2(events) == whole
    else:
        assert sum(patch.lost_m2.get("failed", 0.0) for patch in patches) > 0.0
        assert covered_m2(events) < whole
    assert pipeline.finish() == []


def test_a_stage_that_fails_is_an_error_in_tests(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pipeline_module, "cover_tile", FailsOnce(KeyError("a slip of the pen"), cover_tile))
    with pytest.raises(DefectWarning, match="slip of the pen"):
        run(list(mission()))


# --- navigation that lies --------------------------------------------------------------------------------------------


def displaced(wrong: Callable[[int], bool], degrees: float) -> list[SourceEvent]:
    """The mission with some of its fixes, by their running number, elsewhere."""
    events: list[SourceEvent] = []
    number = -1
    for event in mission():
        if isinstance(event, NavSample) and math.isfinite(event.latitude_deg):
            number += 1
            if wrong(number):
                event = msgspec.structs.replace(
                    event, latitude_deg=event.latitude_deg + degrees, longitude_deg=event.longitude_deg + degrees
                )
        events.append(event)
    return events


def codes(events: list[PipelineEvent]) -> set[str]:
    return {event.code for event in events if isinstance(event, Notice)}


def n_fixes() -> int:
    return sum(isinstance(event, NavSample) and math.isfinite(event.latitude_deg) for event in mission())


@pytest.mark.parametrize("degrees", [0.01, 0.5, 80.0])
def test_fixes_far_off_for_a_moment_move_no_contact(degrees: float) -> None:
    middle = n_fixes() // 2
    pipeline, events = run(displaced(lambda n: middle <= n < middle + 20, degrees))
    assert finds_the_target(pipeline)
    assert "navigation.positions_rejected" in codes(events)
    assert covered_m2(events) > 300.0


def test_a_wrong_first_fix_moves_no_contact() -> None:
    pipeline, _ = run(displaced(lambda n: n == 0, 60.0))
    assert finds_the_target(pipeline)


def test_a_step_that_stays_is_reported_and_no_coverage_lies_between_the_places() -> None:
    middle = n_fixes() // 2
    _, events = run(displaced(lambda n: n >= middle, 0.5))
    assert "nav_position_jump" in codes(events)
    rings = [ring for event in events if isinstance(event, CoveragePatch) for ring in event.rings_deg]
    assert max(np.ptp(ring[:, 1]) for ring in rings) < 0.001
    assert {round(float(ring[0, 1]), 1) for ring in rings} == {50.0, 50.5}


def test_contacts_of_a_disputed_position_say_so_in_their_sigma_and_nothing_there_is_covered() -> None:
    pipeline, events = run(displaced(lambda n: n % 2 == 1, 0.01))
    assert {"navigation.position_disputed", "navigation.positions_rejected"} <= codes(events)
    assert pipeline.contacts
    assert all(sigma_m(contact) > 1000.0 for contact in pipeline.contacts)
    assert all("stale_navigation" in contact.views[0].reasons for contact in pipeline.contacts)
    assert covered_m2(events) == 0.0


def turned(degrees: float, digit_deg: float = 0.0) -> list[SourceEvent]:
    """The mission with every heading turned, and wavering by a digit or two as a compass does."""
    return [
        msgspec.structs.replace(event, heading_rad=event.heading_rad + math.radians(degrees + number % 3 * digit_deg))
        if isinstance(event, NavSample)
        else event
        for number, event in enumerate(longer_mission())
    ]


@cache
def longer_mission() -> tuple[SourceEvent, ...]:
    sonar = Sonar(range_m=12.0, n_samples=128, ping_rate_hz=6.0, range_resolution_m=0.0, beam_lines=1)
    return flown(one_leg([], sonar, length_m=70.0, altitude_m=4.0, latitude_deg=LATITUDE, longitude_deg=LONGITUDE))


@pytest.mark.parametrize(
    ("degrees", "words"), [(90.0, "90 degrees right"), (-90.0, "90 degrees left"), (180.0, "180 degrees")]
)
def test_a_heading_off_the_course_for_a_whole_mission_is_reported(degrees: float, words: str) -> None:
    _, events = run(turned(degrees))
    (notice,) = [
        event for event in events if isinstance(event, Notice) and event.code == "navigation.heading_off_course"
    ]
    assert words in notice.text


@pytest.mark.parametrize("degrees", [0.0, 35.0, -45.0])
def test_a_vehicle_that_crabs_in_a_current_raises_no_notice(degrees: float) -> None:
    assert "navigation.heading_off_course" not in codes(run(turned(degrees, digit_deg=0.1))[1])


@pytest.mark.parametrize(
    ("altitude_m", "code"), [(60.0, "navigation.altitude_beyond_range"), (0.0, "navigation.altitude_zero")]
)
def test_an_altitude_that_cannot_be_is_reported(altitude_m: float, code: str) -> None:
    events = [
        msgspec.structs.replace(event, altitude_m=altitude_m) if isinstance(event, Ping | NavSample) else event
        for event in mission()
    ]
    (notice,) = [event for event in run(events)[1] if isinstance(event, Notice) and event.code == code]
    assert "Check" in notice.text
    assert notice.place


@cache
def contacts_at_gain(gain: float) -> NDArray[np.float64]:
    """(n, 3) latitude and longitude, degrees, and p_mine."""
    pipeline, _ = run(changed(lambda _, p: resampled(p, lambda s: s.astype(np.float64) * gain)))
    return np.array([(contact.latitude_deg, contact.longitude_deg, contact.p_mine) for contact in pipeline.contacts])


@pytest.mark.parametrize("gain", [1e-30, 1e-25, 1e25])
def test_the_same_contacts_come_of_float_samples_at_any_gain(gain: float) -> None:
    np.testing.assert_allclose(contacts_at_gain(gain), contacts_at_gain(1.0), rtol=0.0, atol=1e-6)


@pytest.mark.parametrize(("n_bad", "n_notices"), [(19, 0), (20, 1), (400, 1)])
def test_a_side_whose_samples_cannot_be_used_is_reported_once(n_bad: int, n_notices: int) -> None:
    def spoilt(number: int, ping: Ping) -> Ping:
        assert ping.port is not None
        lost = 30 <= number < 30 + n_bad
        return REPLACE(ping, port=REPLACE(ping.port, spacing_m=-ping.port.spacing_m)) if lost else ping

    _, events = run(changed(spoilt))
    notices = [event for event in events if isinstance(event, Notice) and event.code == "quality.samples_unusable"]
    assert len(notices) == n_notices
    assert all("samples of port" in notice.text and notice.place for notice in notices)


def test_samples_that_are_all_negative_are_reported() -> None:
    pipeline, events = run(changed(lambda _, p: resampled(p, lambda s: -1.0 - s.astype(np.float32))))
    notices = [event for event in events if isinstance(event, Notice) and event.code == "quality.samples_negative"]
    assert len(notices) == 2, "one for each side"
    assert all("sonar.transfer" in notice.text and notice.place for notice in notices)
    assert pipeline.counters["quality.trace_all_negative"] > 100
