"""What the bench of sub-apertures counts, on made-up contacts, and the scenes that it draws."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from auv_mcm.records import Detection
from sim_replay.benches import apertures
from sim_replay.benches.apertures import SYSTEMS, Flown, Judged
from tests.auv_mcm.classify import drawn_looks

KINDS = ("cylinder", "sphere", "rock", "rock")


def contact(*p_mine: float) -> tuple[Detection, ...]:
    return tuple(drawn_looks.detection(p_mine=p, time_s=float(k), aspect_deg=7.0 * k) for k, p in enumerate(p_mine))


def flown(**judged: Any) -> Flown:
    return Flown(KINDS, {system: Judged(**judged) for system in SYSTEMS})


def test_a_target_has_its_likeliest_contact_and_a_rock_is_one_false_alarm() -> None:
    views = contact(0.2), contact(0.6), contact(0.5), contact(0.4), contact(0.3), contact(0.1)
    mission = flown(
        views=views, kinds=("wedge", "cylinder", "wedge", "wedge", "wedge", "sphere"), on=(0, 0, 2, 2, -1, -1)
    )
    scores = apertures.scores_of([mission], SYSTEMS[0], apertures.most_mine_like)
    (targets,), (named,), (false_alarms,) = scores
    assert targets[0] == pytest.approx(math.log(0.6 / 0.4))
    assert targets[1] == -math.inf
    assert named.tolist() == [True, False]
    assert np.sort(1.0 / (1.0 + np.exp(-false_alarms))) == pytest.approx([0.1, 0.3, 0.5])


def test_the_threshold_lets_no_more_false_alarms_pass_than_allowed() -> None:
    mission = flown(views=tuple(contact(p) for p in (0.1, 0.3, 0.5)), kinds=("wedge",) * 3, on=(-1, -1, -1))
    scores = apertures.scores_of([mission], SYSTEMS[0], apertures.most_mine_like)
    for allowed, p in ((0, 0.5), (1, 0.3), (2, 0.1)):
        limit_per_km2 = (allowed + 0.5) / apertures.area_km2()
        assert apertures.threshold(scores, limit_per_km2) == pytest.approx(math.log(p / (1.0 - p)))
    assert apertures.threshold(scores, 10.0 / apertures.area_km2()) == -math.inf


def test_scenes_keep_objects_apart_and_in_view_of_the_first_pass() -> None:
    one, other = apertures.drawn_scene(1), apertures.drawn_scene(2)
    assert one.objects != other.objects
    assert one == apertures.drawn_scene(1)
    places = np.array([(each.east_m, each.north_m) for each in one.objects], dtype=np.float64)
    assert (np.hypot(*places.T) < 32.0).all()
    assert (np.abs(places[:, 0]) > 8.0).all()
    gaps = np.hypot(*(places[:, np.newaxis] - places).transpose(2, 0, 1)) + 100.0 * np.eye(len(places))
    assert gaps.min() > 4.0


def test_the_judged_ground_is_the_disc_beyond_the_nadir_on_both_sides() -> None:
    random = np.random.Generator(np.random.PCG64(3))
    east, north = random.uniform(-32.0, 32.0, (2, 200_000))
    share = float(np.mean((np.hypot(east, north) < 32.0) & (np.abs(east) > 8.0)))
    assert apertures.area_km2() == pytest.approx(1e-6 * 64.0**2 * share, rel=0.01)


def test_views_that_repeat_each_other_are_correlated_in_the_report() -> None:
    repeated = [flown(views=(contact(p, p),), kinds=("cylinder",), on=(0,)) for p in (0.1, 0.5, 0.9)]
    assert apertures.dependence(repeated, SYSTEMS[1]) == pytest.approx(1.0)
    assert "rho" in apertures.report(repeated, in_markdown=True)
