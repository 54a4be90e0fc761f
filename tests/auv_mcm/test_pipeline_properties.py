"""The whole chain must not care about side, tile boundaries, place on Earth, or how its input was cut up."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import cache

import msgspec
import numpy as np
import pytest

from auv_mcm.classify.beliefs import MINE_LIKE_P
from auv_mcm.contacts.export import contacts_geojson
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import Contact, CoveragePatch, EchoTrace, Notice, Ping, PipelineEvent, SourceEvent
from auv_mcm.settings.config import Config, ContactsConfig, WaterfallConfig
from sim_replay.simulator.scene import Scene, SceneObject
from tests.auv_mcm.short_missions import SONAR, flown, one_leg, with_late_navigation

LENGTH_M = 44.0
OBJECTS = (
    SceneObject(
        kind="box", leg=0, along_m=14.0, across_m=9.0, azimuth_deg=20.0, length_m=0.8, width_m=0.6, height_m=0.4
    ),
    SceneObject(
        kind="box", leg=0, along_m=24.0, across_m=-12.0, azimuth_deg=70.0, length_m=1.2, width_m=0.5, height_m=0.5
    ),
    SceneObject(kind="sphere", leg=0, along_m=33.0, across_m=15.0, width_m=0.6),
)


def scene(latitude_deg: float = 50.0, longitude_deg: float = -4.0, heading_deg: float = 0.0) -> Scene:
    turned = [
        msgspec.structs.replace(scene_object, azimuth_deg=scene_object.azimuth_deg + heading_deg)
        for scene_object in OBJECTS
    ]
    return one_leg(
        turned,
        SONAR,
        length_m=LENGTH_M,
        altitude_m=4.0,
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        heading_deg=heading_deg,
    )


@cache
def mission() -> tuple[SourceEvent, ...]:
    return flown(scene())


def run(
    events: Sequence[SourceEvent], config: Config | None = None, threads: int = 1
) -> tuple[Pipeline, list[PipelineEvent]]:
    pipeline = Pipeline(config or Config(), threads=threads)
    out = [result for event in events for result in pipeline.feed(event)]
    return pipeline, out + pipeline.finish()


@cache
def referred() -> tuple[Pipeline, list[PipelineEvent]]:
    return run(mission())


def reference() -> tuple[Contact, ...]:
    return referred()[0].contacts


def with_samples(change: Callable[[np.ndarray], np.ndarray]) -> list[SourceEvent]:
    def changed(trace: EchoTrace | None) -> EchoTrace | None:
        return None if trace is None else msgspec.structs.replace(trace, samples=change(trace.samples))

    return [
        msgspec.structs.replace(event, port=changed(event.port), starboard=changed(event.starboard))
        if isinstance(event, Ping)
        else event
        for event in mission()
    ]


def places(contacts: Sequence[Contact]) -> list[tuple[str, float, float, float]]:
    """Side, grid row, grid column and score of every contact's first view, in a fixed order."""
    return sorted((c.views[0].side, c.views[0].row, c.views[0].column, c.views[0].score) for c in contacts)


def assert_same(
    found: Sequence[Contact], expected: Sequence[Contact], *, pixels: float = 1e-6, score: float = 1e-5
) -> None:
    a, b = places(found), places(expected)
    assert [p[0] for p in a] == [p[0] for p in b]
    np.testing.assert_allclose([p[1:3] for p in a], [p[1:3] for p in b], rtol=0.0, atol=pixels)
    np.testing.assert_allclose([p[3] for p in a], [p[3] for p in b], rtol=0.0, atol=score)


def test_finds_every_object_of_an_easy_mission_as_mine_like() -> None:
    for scene_object in OBJECTS:
        frame = LocalFrame(latitude_deg=50.0, longitude_deg=-4.0)
        place = np.array([scene_object.across_m, scene_object.along_m])
        found = [frame.to_enu(c.latitude_deg, c.longitude_deg, 0.0)[:2] for c in reference() if c.p_mine >= MINE_LIKE_P]
        assert min(np.linalg.norm(offset - place) for offset in found) < 0.6


def test_swapping_port_and_starboard_mirrors_the_contacts() -> None:
    swapped = [
        msgspec.structs.replace(event, port=event.starboard, starboard=event.port) if isinstance(event, Ping) else event
        for event in mission()
    ]
    mirrored = run(swapped)[0].contacts
    other = {"port": "starboard", "starboard": "port"}
    expected = sorted((other[side], *rest) for side, *rest in places(reference()))
    assert places(mirrored) == expected


def test_zeros_that_fill_up_traces_change_nothing() -> None:
    """As of recorders that keep the number of samples at a shorter range: their edge once passed for objects."""
    filled, events = run(with_samples(lambda samples: np.append(samples, np.zeros(200, dtype=samples.dtype))))
    assert_same(filled.contacts, reference())
    patches = [event for event in events if isinstance(event, CoveragePatch)]
    whole = [event for event in referred()[1] if isinstance(event, CoveragePatch)]
    assert [patch.covered_m2 for patch in patches] == pytest.approx([patch.covered_m2 for patch in whole], rel=1e-3)
    assert filled.counters["detect.candidate"] == referred()[0].counters["detect.candidate"]


def jittered(change: str) -> Iterator[SourceEvent]:
    """Ranges by a sound speed measured with each ping, or every second ping a sample shorter."""
    random = np.random.default_rng(1)
    for event in mission():
        if isinstance(event, Ping):
            factor = 1.0 + 1e-5 * float(random.uniform(-1.0, 1.0)) if change == "speed" else 1.0
            n_fewer = event.number % 2 if change == "count" else 0
            sides = {
                side: msgspec.structs.replace(
                    trace,
                    samples=trace.samples[: len(trace.samples) - n_fewer],
                    first_range_m=factor * trace.first_range_m,
                    spacing_m=factor * trace.spacing_m,
                )
                for side, trace in (("port", event.port), ("starboard", event.starboard))
                if trace is not None
            }
            event = msgspec.structs.replace(event, **sides)
        yield event


@pytest.mark.parametrize("change", ["speed", "count"])
def test_pings_whose_samples_differ_by_a_hair_cost_no_clearance(change: str) -> None:
    """Every ping once made a block of its own, which shows too little floor for its level: all of it was unknown."""
    pipeline, events = run(list(jittered(change)))
    assert_same(pipeline.contacts, reference(), pixels=0.2, score=0.2)
    kinds, expected = (
        np.concatenate([event.cells.seabed for event in some if isinstance(event, CoveragePatch) and event.cells])
        for some in (events, referred()[1])
    )
    assert np.mean(kinds == expected) > 0.9
    codes = [[event.code for event in some if isinstance(event, Notice)] for some in (events, referred()[1])]
    assert codes[0] == codes[1]


@pytest.mark.parametrize("n_times", [2, 3])
def test_pings_sent_several_times_change_no_byte(n_times: int) -> None:
    """Repeated speckle once passed for another law of samples, and a flat floor for a rough one."""
    repeated = [again for event in mission() for again in [event] * (n_times if isinstance(event, Ping) else 1)]
    assert contacts_geojson(run(repeated)[0].contacts) == contacts_geojson(reference())


@pytest.mark.parametrize("tile_rows", [64, 97, 200, 333])
def test_where_tiles_are_cut_changes_nothing(tile_rows: int) -> None:
    config = Config(waterfall=WaterfallConfig(tile_rows=tile_rows))
    pipeline, events = run(mission(), config)
    assert_same(pipeline.contacts, reference())
    covered = sum(event.covered_m2 for event in events if isinstance(event, CoveragePatch))
    whole = sum(event.covered_m2 for event in referred()[1] if isinstance(event, CoveragePatch))
    assert covered == pytest.approx(whole, rel=1e-9)


@pytest.mark.parametrize(
    ("latitude_deg", "longitude_deg", "heading_deg"),
    [
        (0.0, 10.0, 45.0),
        (89.0, 100.0, 200.0),
        (-89.0, -30.0, 10.0),
        (12.0, 179.99999, 90.0),
        (-45.0, -180.0, 271.0),
        (71.0, 179.9999, 359.9),
    ],
)
def test_place_and_heading_on_earth_change_nothing_relative(
    latitude_deg: float, longitude_deg: float, heading_deg: float
) -> None:
    moved = run(flown(scene(latitude_deg, longitude_deg, heading_deg)))[0].contacts

    def along_across(contacts: Sequence[Contact], latitude: float, longitude: float, heading: float) -> np.ndarray:
        frame = LocalFrame(latitude_deg=latitude, longitude_deg=longitude)
        direction = math.radians(heading)
        enu = np.array([frame.to_enu(c.latitude_deg, c.longitude_deg, 0.0) for c in contacts])
        along = enu[:, 0] * math.sin(direction) + enu[:, 1] * math.cos(direction)
        across = enu[:, 0] * math.cos(direction) - enu[:, 1] * math.sin(direction)
        return np.column_stack([along, across])

    found = along_across(moved, latitude_deg, longitude_deg, heading_deg)
    expected = along_across(reference(), 50.0, -4.0, 0.0)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-6)
    assert all(-180.0 <= contact.longitude_deg < 180.0 for contact in moved)


@pytest.mark.parametrize("threads", [1, 2])
def test_threads_and_repetition_give_the_same_bytes(threads: int) -> None:
    assert contacts_geojson(run(mission(), threads=threads)[0].contacts) == contacts_geojson(reference())


def test_navigation_arriving_late_gives_the_same_bytes() -> None:
    """Links deliver navigation and pings in bursts; only the times they carry may count."""
    late = with_late_navigation(mission())
    assert contacts_geojson(run(late)[0].contacts) == contacts_geojson(reference())


def test_every_announced_contact_is_called_or_not_and_in_the_end_as_the_whole_mission_says() -> None:
    pipeline, events = referred()
    announced = [event for event in events if isinstance(event, Contact)]
    assert announced
    assert all(contact.called is not None for contact in announced)
    assert all(contact.false_alarms_per_km2 > 0.0 for contact in announced)
    last = {contact.id: contact.called for contact in announced}
    assert last == {contact.id: contact.called for contact in pipeline.contacts}
    assert all(contact.called == pipeline.operating_point.calls(contact) for contact in pipeline.contacts)


def test_what_is_accepted_changes_calls_and_nothing_else() -> None:
    few, many = (
        run(mission(), Config(contacts=ContactsConfig(false_alarms_per_km2=accepted)))[0].contacts
        for accepted in (1e-3, 1e6)
    )
    assert sum(bool(contact.called) for contact in few) <= sum(bool(contact.called) for contact in many)
    assert all(contact.called for contact in many)
    assert not any(contact.called for contact in few if contact.p_mine < MINE_LIKE_P)
    alike = [[msgspec.structs.replace(contact, called=None) for contact in some] for some in (few, many)]
    assert contacts_geojson(alike[0]) == contacts_geojson(alike[1])


def test_the_gate_takes_nothing_from_what_is_reported() -> None:
    measured, _ = run(mission(), Config(contacts=ContactsConfig(min_p_mine=0.0)))
    likely = {contact.views[0].row: contact.p_mine for contact in measured.contacts if contact.p_mine >= 0.05}
    reported = {contact.views[0].row: contact.p_mine for contact in reference()}
    assert likely
    for row, p_mine in likely.items():
        nearest = min(reported, key=lambda other: abs(other - row))
        assert nearest == pytest.approx(row, abs=2.0)
        assert reported[nearest] == pytest.approx(p_mine, abs=0.05)
