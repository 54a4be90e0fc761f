"""A small part of the draws of `auv-mcm bench law`, on seeds that nothing was fitted on."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sim_replay.benches.law import (
    FIRST_SEED,
    STORES,
    DrawnFloor,
    JudgedRecorder,
    draw_floor,
    fit_law,
    floor_intensity,
    judge_recorder,
    judged_floor,
    print_table,
    stored,
)
from sim_replay.text_tables import columns

SEED = FIRST_SEED + 900
PLAIN = DrawnFloor("flat", 1, 1.0, 0.0, "none", 0.5, (5.0, 5.0), 0.01, (1,) * len(STORES))


@pytest.fixture(scope="module")
def judged() -> list[JudgedRecorder]:
    return [one for seed in range(SEED, SEED + 2) for one in judged_floor(seed)]


def test_no_drawn_recorder_is_taken_for_the_other_kind_or_stretched_far(judged: list[JudgedRecorder]) -> None:
    assert [(one.floor, one.store.name) for one in judged if one.law.is_sure and math.isnan(one.stretched)] == []
    assert [(one.floor, one.store.name, one.stretched) for one in judged if one.stretched > 2.0] == []


def test_one_plain_floor_is_one_picture_whatever_recorder_stored_it() -> None:
    intensity = floor_intensity(PLAIN, SEED, n_pings=64)
    stretched = [judge_recorder(PLAIN, store, stored(intensity, store)).stretched for store in STORES]
    assert max(stretched) / min(stretched) < 1.5  # errors compress the picture
    assert min(stretched) > 0.7
    assert max(stretched) < 1.1


def test_coefficients_that_are_fitted_part_the_recorders_that_they_were_fitted_to(judged: list[JudgedRecorder]) -> None:
    coefficients = fit_law(judged)
    assert coefficients.shape == (4,)
    assert coefficients[1] > 0.0  # linear samples are skewed upwards
    assert coefficients[3] > 0.0  # and spread in proportion to their mean


def test_a_floor_is_the_same_each_time_and_others_differ() -> None:
    assert draw_floor(SEED) == draw_floor(SEED)
    assert len({draw_floor(seed) for seed in range(SEED, SEED + 20)}) == 20


def test_recorders_store_what_they_say() -> None:
    intensity = np.array([1.0, 100.0])
    by_name = {store.name: stored(intensity, store).astype(float) for store in STORES}
    assert by_name["amplitude, 16 bits"][1] == pytest.approx(10.0 * by_name["amplitude, 16 bits"][0], rel=1e-3)
    assert by_name["intensity"][0] == 1000.0
    assert by_name["amplitude^0.7"][1] == pytest.approx(100.0**0.35 * by_name["amplitude^0.7"][0], rel=1e-3)
    assert by_name["log of 0.35 dB"][1] - by_name["log of 0.35 dB"][0] == round(20.0 / 0.35)
    assert stored(np.array([1.0, 4.0, 9.0]), STORES[0], smoothed=2).tolist() == [4500]


def test_the_table_names_every_recorder(judged: list[JudgedRecorder], capsys: pytest.CaptureFixture[str]) -> None:
    print_table(judged, columns)
    out = capsys.readouterr().out
    for name in ("all", *(store.name for store in STORES), "taken for the other kind", "left open", "median"):
        assert name in out
