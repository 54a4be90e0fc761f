"""Check the bench over scenes: what it rejects, and what the chain is given of a sonar."""

from __future__ import annotations

import argparse
import math

import pytest

from auv_mcm.contacts.background import LOWEST_P_MINE
from auv_mcm.contacts.ledger import Ledger
from auv_mcm.detect.cascade.choose import configured_model, fitting
from auv_mcm.errors import UsageError
from auv_mcm.records import Contact, Detector, LookStep
from auv_mcm.settings.config import Config, ContactsConfig
from sim_replay.benches import scenes
from sim_replay.benches.scenes import add_arguments, as_after, run
from sim_replay.missions import FIRST_SEED, config_for, served_by
from sim_replay.simulator.scene_file import read_scene
from tests.auv_mcm.classify.drawn_looks import confirmation, detection

PRIOR = math.log(0.02 / 0.98)


def run_with(*arguments: str) -> None:
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    run(parser.parse_args(arguments))


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("--scenes", "flat,reef"), "there is no 'reef'"),
        (("--scenes", "flat,flat"), "flat,flat"),
        (("--scenes", ""), "--scenes"),
    ],
)
def test_what_makes_no_sense_is_refused_by_name(arguments: tuple[str, ...], named: str) -> None:
    with pytest.raises(UsageError, match=named):
        run_with(*arguments)


@pytest.mark.parametrize(("arguments", "detector"), [((), "cascade"), (("--detector", "contrast"), "contrast")])
def test_the_chain_looks_at_what_the_detector_asked_for_finds(
    monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], detector: Detector
) -> None:
    asked = []

    def fly(name: str, seed: int, detector: Detector) -> scenes.FlownMission:
        asked.append((name, seed, detector))
        raise UsageError("enough")

    monkeypatch.setattr(scenes, "fly_mission", fly)
    with pytest.raises(UsageError, match="enough"):
        run_with("--scenes", "flat", "--seeds", "1", "--workers", "1", *arguments)
    assert asked == [("flat", FIRST_SEED, detector)]


def test_contrasts_serve_as_for_a_sonar_without_a_model() -> None:
    model, notice = fitting(configured_model(served_by("contrast", Config())), Config())
    assert model is None
    assert notice.code == "detect.contrast"
    assert fitting(configured_model(served_by("cascade", Config())), Config())[0] is not None


def test_the_chain_is_given_the_beam_width_and_nothing_else() -> None:
    deep = config_for(read_scene("deep"))
    assert deep.sonar.beam_width_deg == read_scene("deep").sonar.beam_width_deg
    assert (deep.detect, deep.waterfall, deep.navigation) == (Config().detect, Config().waterfall, Config().navigation)


def test_a_synthetic_aperture_has_the_beam_of_its_resolution_at_half_range() -> None:
    scene = read_scene("sas")
    assert scene.sonar.synthetic_aperture is not None
    width_m = math.radians(config_for(scene).sonar.beam_width_deg) * 0.5 * scene.sonar.range_m
    assert width_m == pytest.approx(scene.sonar.synthetic_aperture.along_track_resolution_m)


def looked_at(p_by_step: dict[LookStep, float]) -> Contact:
    """A contact of one view that went through these steps."""
    *_, last = p_by_step
    ledger = Ledger(ContactsConfig(min_p_mine=LOWEST_P_MINE), PRIOR)
    found = detection(p_mine=p_by_step[last], p_by_step=p_by_step, confirmation=confirmation(math.log(9.0)))
    (contact,) = ledger.add([found])
    return contact


@pytest.mark.parametrize(
    ("p_by_step", "after"),
    [
        ({"detector": 0.2, "contours": 0.4, "shape": 0.9}, {"detector": 0.2, "contours": 0.4, "shape": 0.9}),
        ({"detector": 0.2, "contours": 0.1}, {"detector": 0.2, "contours": 0.1, "shape": 0.1}),
        ({"detector": 0.01}, {"detector": 0.01, "contours": 0.01, "shape": 0.01}),
    ],
)
def test_a_contact_after_a_step_has_the_p_mine_of_the_last_step_taken_by_then(
    p_by_step: dict[LookStep, float], after: dict[LookStep, float]
) -> None:
    contact = looked_at(p_by_step)
    for step, p_mine in after.items():
        there = as_after(contact, step, PRIOR)
        assert there.p_mine == pytest.approx(p_mine)
        assert (there.id, there.latitude_deg, there.longitude_deg) == (
            contact.id,
            contact.latitude_deg,
            contact.longitude_deg,
        )
