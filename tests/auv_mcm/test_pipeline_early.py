"""Early contacts come soon after an object was passed, and change nothing of what the finished mission says."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache

import msgspec
import pytest

from auv_mcm.contacts.export import contacts_geojson
from auv_mcm.defects import DefectWarning
from auv_mcm.early import EarlyLook
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import Contact, EarlyContact, NavSample, Ping, PipelineEvent, SourceEvent, Tile
from auv_mcm.settings.config import Config, SonarConfig
from sim_replay.simulator.scene import SceneObject
from tests.auv_mcm.short_missions import SONAR, flown, one_leg, with_late_navigation

SPEED_MPS = 1.8
RATE_HZ = SONAR.ping_rate_hz
LENGTH_M = 110.0
PLACES_M = (30.0, 55.0)
OBJECTS = (
    SceneObject(
        kind="box", leg=0, along_m=PLACES_M[0], across_m=9.0, azimuth_deg=20.0, length_m=0.8, width_m=0.6, height_m=0.4
    ),
    SceneObject(
        kind="box",
        leg=0,
        along_m=PLACES_M[1],
        across_m=-12.0,
        azimuth_deg=70.0,
        length_m=1.2,
        width_m=0.5,
        height_m=0.5,
    ),
)
CONFIG = Config(sonar=SonarConfig(transfer="amplitude"))  # stated, so that no ping waits for it


@cache
def mission() -> tuple[SourceEvent, ...]:
    return flown(one_leg(OBJECTS, SONAR, length_m=LENGTH_M, altitude_m=4.0, speed_mps=SPEED_MPS))


Announced = tuple[int, PipelineEvent]
"""What came out, and how many pings had been fed by then."""


def run(events: Sequence[SourceEvent], *, early: bool, threads: int = 1) -> tuple[Pipeline, list[Announced]]:
    pipeline = Pipeline(CONFIG, early=early, threads=threads)
    out: list[Announced] = []
    n_pings = 0
    for event in events:
        n_pings += isinstance(event, Ping)
        out += [(n_pings, result) for result in pipeline.feed(event)]
    return pipeline, [*out, *((n_pings, result) for result in pipeline.finish())]


@cache
def with_early() -> tuple[Pipeline, list[Announced]]:
    return run(mission(), early=True)


@cache
def without() -> tuple[Pipeline, list[Announced]]:
    return run(mission(), early=False)


def early_words(out: Sequence[Announced]) -> list[tuple[str, str, str, float]]:
    early = [event for _, event in out if isinstance(event, EarlyContact)]
    return [(each.contact.id, each.state, each.became, each.contact.p_mine) for each in early]


def finished(out: Sequence[Announced]) -> list[object]:
    """What does not come early, by content."""
    words: list[object] = []
    for n_pings, event in out:
        match event:
            case EarlyContact():
                continue
            case Tile():
                words.append((n_pings, event.side, event.first_row, event.intensity.tobytes(), event.mask.tobytes()))
            case Contact():
                words.append((n_pings, contacts_geojson([event])))
            case _:
                words.append((n_pings, repr(event)))
    return words


def test_everything_but_early_contacts_is_the_same_to_the_byte_with_them_and_without() -> None:
    (early_chain, early_out), (chain, out) = with_early(), without()
    assert finished(early_out) == finished(out)
    assert contacts_geojson(early_chain.contacts) == contacts_geojson(chain.contacts)
    assert early_chain.places == chain.places
    alike = {name: count for name, count in early_chain.counters.items() if not name.startswith("early.")}
    assert alike == dict(chain.counters)
    assert not early_words(out)


def test_where_the_sonar_stays_silent_all_is_announced_before_the_end_and_the_contacts_are_the_same() -> None:
    last = [event for event in mission() if isinstance(event, NavSample)][-100:]
    north_deg = (last[-1].latitude_deg - last[0].latitude_deg) / 99
    step_s = (last[-1].time_s - last[0].time_s) / 99
    silence = [
        msgspec.structs.replace(
            last[-1], time_s=last[-1].time_s + n * step_s, latitude_deg=last[-1].latitude_deg + n * north_deg
        )
        for n in range(1, math.ceil(60.0 / step_s))
    ]
    pipeline = Pipeline(CONFIG)
    out = [event for each in (*mission(), *silence) for event in pipeline.feed(each)]
    chain, ended = without()
    assert contacts_geojson(pipeline.contacts) == contacts_geojson(chain.contacts)
    assert [type(event) for event in out] == [type(event) for _, event in ended]
    assert not any(isinstance(event, Tile | Contact) for event in pipeline.finish())
    assert pipeline.counters == chain.counters


@pytest.mark.parametrize("threads", [1, 2])
def test_early_contacts_do_not_depend_on_how_input_was_cut_up_nor_on_threads(threads: int) -> None:
    chain, out = run(with_late_navigation(mission()), early=True, threads=threads)
    assert early_words(out) == early_words(with_early()[1])
    assert contacts_geojson(chain.contacts) == contacts_geojson(without()[0].contacts)


def test_each_target_is_announced_within_20_m_of_track_or_10_s_and_long_before_its_tile_is_finished() -> None:
    out = with_early()[1]
    limit_pings = RATE_HZ * max(10.0, 20.0 / SPEED_MPS)
    ping_s = [event.time_s for event in mission() if isinstance(event, Ping)]
    for place_m in PLACES_M:
        abeam = place_m / SPEED_MPS * RATE_HZ  # pings until the vehicle was beside it

        def is_there(contact: Contact, abeam: float = abeam) -> bool:
            return contact.p_mine >= 0.2 and abs(contact.time_s - (ping_s[0] + abeam / RATE_HZ)) < 4.0

        soon = min(
            n
            for n, event in out
            if isinstance(event, EarlyContact) and event.state == "found" and is_there(event.contact)
        )
        done = min(n for n, event in out if isinstance(event, Contact) and is_there(event))
        assert soon - abeam <= limit_pings
        assert done - abeam > limit_pings


def test_each_early_contact_is_resolved_once_and_what_it_became_lies_there() -> None:
    chain, out = with_early()
    early = [event for _, event in out if isinstance(event, EarlyContact)]
    found = {each.contact.id: each.contact for each in early if each.state == "found"}
    resolved = [each for each in early if each.state != "found"]
    assert len(found) >= len(PLACES_M)
    assert sorted(each.contact.id for each in resolved) == sorted(found)
    contacts = {contact.id: contact for contact in chain.contacts}
    became = [each for each in resolved if each.state == "became"]
    assert len(became) >= len(PLACES_M)
    for each in became:
        final = contacts[each.became]
        assert math.isclose(final.latitude_deg, each.contact.latitude_deg, abs_tol=2e-5)
        assert min(abs(view.time_s - each.contact.time_s) for view in final.views) < 2.0


def test_one_that_the_finished_tile_does_not_show_is_withdrawn() -> None:
    chain, out = with_early()
    found = next(event for _, event in out if isinstance(event, EarlyContact) and event.state == "found")
    look = chain._early
    assert look is not None
    view = found.contact.views[0]
    again = look._announced(view)
    gone = look.resolve({"port": math.inf, "starboard": math.inf}, [], [])
    assert [(each.contact.id, each.state, each.became) for each in gone] == [(again.contact.id, "withdrawn", "")]
    reported = gone[0].reported
    assert (reported.p_mine, reported.views, reported.latitude_deg) == (0.0, (), view.latitude_deg)


def test_an_early_look_that_fails_is_reported_once_and_costs_the_mission_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def failing(*_: object) -> None:
        raise ZeroDivisionError("division by zero")

    monkeypatch.setattr(EarlyLook, "look", failing)
    with pytest.warns(DefectWarning):
        chain, out = run(mission(), early=True)
    assert contacts_geojson(chain.contacts) == contacts_geojson(without()[0].contacts)
    assert chain.counters["pipeline.early_look_failed"] > 1
    codes = [getattr(event, "code", "") for _, event in out]
    assert codes.count("pipeline.tile_failed") == 1
