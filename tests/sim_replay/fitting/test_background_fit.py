"""The fit of what backgrounds are like from mission to mission."""

from __future__ import annotations

import numpy as np
import pytest

from auv_mcm.contacts.background import BIN_NATS, KNOTS_NATS, LEVELS_NATS, interpolation, parse_background
from auv_mcm.errors import UsageError
from sim_replay.fitting import fit_background
from sim_replay.fitting.fit_background import (
    ASKED_PER_KM2,
    SortedContacts,
    background_tasks,
    fit_prior,
    fitted_model,
    judged,
    left_out,
)
from sim_replay.missions import HELD_OUT
from sim_replay.text_tables import json_lines

MEAN = np.array([7.0, 6.3, 5.5, 4.4, 3.0, 0.5])


def drawn_mission(seed: int, scene: str = "flat", area_km2: float = 0.2, shift: float = 0.0) -> SortedContacts:
    """Draw a mission whose background lies a normal deviate of 0.7 off the mean, with twenty mines."""
    random = np.random.Generator(np.random.PCG64(seed))
    values = MEAN + shift + 0.7 * random.standard_normal()
    middle = LEVELS_NATS + 0.5 * BIN_NATS
    background = np.repeat(middle, random.poisson(area_km2 * BIN_NATS * np.exp(interpolation(middle) @ values)))
    mines = random.normal(0.5, 1.5, 20)
    return SortedContacts(
        scene, np.concatenate([background, mines]), background, mines, 22, area_km2, area_km2, background > 0.0
    )


def test_the_fit_finds_what_missions_were_drawn_from() -> None:
    prior = fit_prior([drawn_mission(seed) for seed in range(30)])
    assert np.abs(np.array(prior.mean) - MEAN)[:-1].max() < 0.5
    assert np.sqrt(prior.covariance[0][0]) == pytest.approx(0.7, abs=0.3)
    assert (prior.mine_mean_nats, prior.mine_sd_nats) == pytest.approx((0.5, 1.5), abs=0.25)


def test_no_two_levels_are_opposed() -> None:
    prior = fit_prior([drawn_mission(seed, shift=float(seed % 3) - 1.0) for seed in range(6)])
    covariance = np.array(prior.covariance)
    assert (covariance >= -0.02).all()
    assert (np.linalg.eigvalsh(covariance) > 0.0).all()
    assert covariance.shape == (len(KNOTS_NATS),) * 2


def test_a_scene_is_judged_by_what_the_others_give() -> None:
    missions = [drawn_mission(seed, f"scene {seed % 3}") for seed in range(9)]
    scenes = left_out(missions)
    assert [one.scene for one in scenes] == ["scene 0", "scene 1", "scene 2"]
    for one in scenes:
        own = [mission for mission in missions if mission.scene == one.scene]
        others = [mission for mission in missions if mission.scene != one.scene]
        assert one.prior == fit_prior(others)
        assert one.reached == tuple(judged(own, point.asked_per_km2) for point in one.reached)
        assert [point.n_targets for point in one.reached] == [66] * len(ASKED_PER_KM2)
    assert left_out([drawn_mission(seed) for seed in range(3)]) == ()


def test_contacts_count_from_the_level_called_and_the_density_asked_is_over_the_true_area(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(fit_background, "called_from_nats", lambda everything, area_km2, asked_per_km2: area_km2)
    background, mines = np.array([-1.0, 0.2, 3.0, 4.0]), np.array([0.1, 0.2, 5.0])
    one = SortedContacts("flat", np.append(background, mines), background, mines, 7, 0.2, 0.5, background > 3.0)
    point = judged([one, one], 30.0)
    assert (point.n_asked, point.n_reached, point.n_called, point.n_targets) == (30.0, 6, 4, 14)


def test_a_model_is_read_back_as_it_was_written() -> None:
    tasks = background_tasks([7])
    assert {task[0] for task in tasks}.isdisjoint(HELD_OUT)
    model = fitted_model(tasks, [drawn_mission(number, task[0]) for number, task in enumerate(tasks)])
    assert parse_background(json_lines(model), "here") == model
    assert "seeds 7" in model.fitted_on
    assert len(model.left_out) == len({task[0] for task in tasks})


def test_missions_without_mines_are_too_few_to_fit_on() -> None:
    bare = drawn_mission(1)._replace(mines=np.empty(0))
    for missions in ([], [bare]):
        with pytest.raises(UsageError, match="too few to fit on"):
            fit_prior(missions)
