"""Check the bench over scenes: what each system reports, and what the chain is given of a sonar."""

from __future__ import annotations

import math

import pytest

from auv_mcm.contacts.background import LOWEST_P_MINE
from auv_mcm.contacts.ledger import Ledger
from auv_mcm.detect.cascade.choose import configured_model, fitting
from auv_mcm.records import Contact, Detector, LookStep
from auv_mcm.settings.config import Config, ContactsConfig
from sim_replay.benches import mission_source
from sim_replay.benches.experiment import Task, experiment_rows
from sim_replay.benches.scenes import EXPERIMENT, as_after, fly
from sim_replay.missions import config_for, served_by
from sim_replay.simulator.scene_file import parse_scene, read_scene
from tests.auv_mcm.classify.drawn_looks import confirmation, detection

PRIOR = math.log(0.02 / 0.98)


SCENE = """
world: {depth_m: 12, seabeds: [{type: sand, stones_per_ha: 0}], relief_rms_m: 0}
sonar: {frequency_khz: 450, range_m: 25, n_samples: 500, ping_rate_hz: 10}
track: {altitude_m: 5, plan: {pattern: lawnmower, n_legs: 1, leg_m: 40}}
objects: [{kind: cylinder, leg: 0, along_m: 20, across_m: 12, azimuth_deg: 0, length_m: 2, width_m: 0.5}]
"""


@pytest.mark.parametrize("detector", ["cascade", "contrast"])
def test_every_system_reports_of_one_mission(detector: Detector, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mission_source, "read_scene", lambda name: parse_scene(SCENE, name))
    monkeypatch.setattr(mission_source, "named_scenes", lambda: ("one-target",))
    flown = fly(Task("one-target", 3, {"detector": detector}))
    assert list(flown) == list(EXPERIMENT.variants)
    *_, last = flown.values()
    assert all(one.mission.truth is last.mission.truth for one in flown.values())
    (row,) = (one for one in experiment_rows(EXPERIMENT, ["one-target"], [flown]) if one.variant.endswith("the chain"))
    assert row.cells["Pd at 100 FA/km²"].text.startswith("1.00")
    assert (row.cells["s per hour of survey"].value or 0.0) > 0.0


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
