"""Confirmation within the chain: what it adds to contacts, what it costs them when it is left out, and its budget."""

from __future__ import annotations

from functools import cache

import msgspec
import pytest

from auv_mcm.classify.beliefs import FRAME
from auv_mcm.classify.odds import MineOdds, Weights
from auv_mcm.errors import UsageError
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import Contact, Detection, Notice, PipelineEvent, SourceEvent
from auv_mcm.settings.config import Config, ConfirmConfig, ContactsConfig
from sim_replay.simulator.scene import SampleRecorder, SceneObject, Sonar
from tests.auv_mcm.short_missions import flown, one_leg

OBJECTS = (
    SceneObject(kind="cylinder", leg=0, along_m=14.0, across_m=12.0, azimuth_deg=20.0, length_m=2.0, width_m=0.53),
    SceneObject(kind="sphere", leg=0, along_m=30.0, across_m=-14.0, width_m=0.8),
)
SONAR = Sonar(
    range_m=22.0,
    n_samples=512,
    ping_rate_hz=12.0,
    recorder=SampleRecorder(samples="amplitude_float32", seabed_counts=3000.0, full_scale=32767),
)


@cache
def mission() -> tuple[SourceEvent, ...]:
    return flown(one_leg(OBJECTS, SONAR, length_m=44.0, altitude_m=4.0))


@cache
def run(confirm: ConfirmConfig) -> tuple[Pipeline, tuple[PipelineEvent, ...]]:
    pipeline = Pipeline(msgspec.structs.replace(Config(), confirm=confirm))
    events = [output for event in mission() for output in pipeline.feed(event)]
    return pipeline, (*events, *pipeline.finish())


def best(contacts: tuple[Contact, ...]) -> list[Contact]:
    return sorted(contacts, key=lambda contact: -contact.p_mine)[: len(OBJECTS)]


def test_contacts_say_what_they_are_how_large_and_why() -> None:
    pipeline, _ = run(ConfirmConfig())
    found = sorted(best(pipeline.contacts), key=lambda contact: contact.time_s)
    assert [contact.classification for contact in found] == ["cylinder", "sphere"]
    for contact, length_m in zip(found, (2.0, 0.8), strict=True):
        assert contact.p_mine > 0.5
        assert abs(contact.length_m - length_m) < max(4.0 * contact.length_sigma_m, 0.1)
        assert set(contact.belief) == {*FRAME, "unknown"}
        (view,) = contact.views
        assert view.confirmation is not None
        assert view.confirmation.labels.shape == view.snippet.shape
        assert view.surroundings is None


def test_every_detection_is_looked_at_or_counted() -> None:
    for confirm in (ConfirmConfig(), ConfirmConfig(max_per_tile=1), ConfirmConfig(min_p_mine=0.2)):
        pipeline, _ = run(confirm)
        counted = sum(
            pipeline.counters[f"confirm.{code}"]
            for code in ("looked_at", "odds_too_low", "ended_at_verifier", "over_budget")
        )
        assert counted == sum(len(contact.views) for contact in pipeline.contacts)


def test_beyond_the_budget_the_detectors_odds_stand_and_it_is_reported() -> None:
    pipeline, events = run(ConfirmConfig(max_per_tile=0))
    assert pipeline.counters["confirm.looked_at"] == 0
    assert [event.code for event in events if isinstance(event, Notice)].count("confirm.over_budget") == 1
    assert all({"over_budget", "not_looked_at"} & set(contact.reasons) for contact in pipeline.contacts)
    assert all("over_budget" in contact.reasons for contact in best(pipeline.contacts))
    assert {contact.id for contact in pipeline.contacts} == {contact.id for contact in run(ConfirmConfig())[0].contacts}


def test_beyond_the_limit_of_examinations_the_verifiers_odds_stand_and_it_is_reported() -> None:
    pipeline, events = run(ConfirmConfig(max_examined_per_tile=0))
    spared = best(pipeline.contacts)
    assert pipeline.counters["confirm.looked_at"] == 0
    assert pipeline.counters["confirm.over_budget"] >= len(spared)
    for contact in spared:
        (view,) = contact.views
        assert view.confirmation is None
        assert "over_budget" in contact.reasons
        assert list(view.p_by_step) == ["detector", "verifier"]
        assert contact.p_mine == view.p_by_step["verifier"] > 0.5
    assert [event.code for event in events if isinstance(event, Notice)].count("confirm.over_budget") == 1


def test_without_a_close_look_contacts_carry_what_the_detector_found() -> None:
    pipeline, _ = run(ConfirmConfig(enabled=False))
    assert not any(code.startswith("confirm.") for code in pipeline.counters)
    for contact in pipeline.contacts:
        (view,) = contact.views
        assert view.confirmation is None
        assert view.surroundings is None
        assert contact.p_mine == view.p_mine
        assert contact.classification in ("clutter", "unknown")


def test_without_a_bound_every_detection_is_looked_at_whatever_features_the_odds_know(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    of_other_features = Weights(offset=0.0, weights={"of_another_detector": 1.0})
    odds = MineOdds(
        fitted_on="nothing", prior=-4.0, detector=of_other_features, contours=of_other_features, shape=of_other_features
    )
    monkeypatch.setattr("auv_mcm.chain_models.configured_odds", lambda name, detector: odds)
    seen: list[Detection] = []

    def look(detection: Detection) -> Detection:
        seen.append(detection)
        return detection

    config = Config(confirm=ConfirmConfig(min_p_mine=0.0), contacts=ContactsConfig(min_p_mine=0.0))
    pipeline = Pipeline(config, look=look)
    for event in mission():
        pipeline.feed(event)
    pipeline.finish()
    n_views = sum(len(contact.views) for contact in pipeline.contacts)
    assert len(seen) == n_views + pipeline.counters["contacts.repeated"] >= len(OBJECTS)


def test_a_list_of_mines_expected_that_cannot_be_read_stops_the_chain_before_it_starts() -> None:
    with pytest.raises(UsageError, match=r"confirm.targets: the list nowhere.yaml cannot be read"):
        Pipeline(Config(confirm=ConfirmConfig(targets="nowhere.yaml")))
