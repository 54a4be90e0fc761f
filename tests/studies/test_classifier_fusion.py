"""How classifiers are fused, and what is fitted on what they did not learn from."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sim_replay.fitting.cascade.classical.chips import N_COLUMNS, N_ROWS
from sim_replay.fitting.cascade.classical.train_classical import ChipSamples
from sim_replay.studies.classifier_fusion import (
    DETECTOR,
    POOLS,
    RULES,
    TOGETHER,
    Mission,
    dempster_shafer,
    judges_of,
    majority,
    maximum,
    mean_odds,
    product_of_probabilities,
    table,
)
from sim_replay.studies.paper_candidates import NORMALISED, CutChips, ImageCandidates, TileCandidates

N_TARGETS, N_OTHERS = 10, 40
ODDS = np.array([[3.0, 1.0, -2.0], [0.0, 0.0, 0.0], [-1.0, -1.0, 4.0]])


def _mission(seed: int, floor: str = "flat") -> Mission:
    """Draw a mission whose targets have a highlight and a shadow and whose candidates are its samples."""
    random = np.random.Generator(np.random.PCG64(seed))
    n = N_TARGETS + N_OTHERS
    contrast = random.normal(0.0, 1.0, (n, N_ROWS, N_COLUMNS))
    contrast[:N_TARGETS, 6:11, 8:16] += 1.0
    contrast[:N_TARGETS, 6:11, 20:32] -= 1.0
    chips = contrast.astype(np.float32)
    kinds = ("wedge",) * N_TARGETS
    name = f"{floor}/{seed}"
    tile = TileCandidates(
        rows=np.zeros(n, dtype=np.int32),
        columns=np.zeros(n, dtype=np.int32),
        chips={NORMALISED: CutChips(chips, np.ones(n, dtype=np.bool_))},
        detector_odds=random.normal(0.0, 1.0, n),
        ground_range_m=np.full(n, 20.0),
        object_index=np.where(np.arange(n) < N_TARGETS, np.arange(n), -1),
        covers=np.eye(n, dtype=np.bool_),
        on_surface=np.zeros(n, dtype=np.bool_),
        kinds=kinds,
        is_target=(True,) * N_TARGETS,
        object_range_m=(20.0,) * N_TARGETS,
        usable_m2=np.full(100, 100.0),
        column_m=1.0,
    )
    samples = ChipSamples(chips, kinds + ("",) * N_OTHERS, (name,) * n, np.ones(n))
    return Mission(samples, ImageCandidates(name, (tile,)))


def test_the_mean_orders_as_the_product_of_the_odds_does() -> None:
    assert np.array_equal(np.argsort(mean_odds(ODDS, 0.0)), np.argsort(np.exp(ODDS).prod(axis=1)))


def test_the_product_multiplies_probabilities() -> None:
    assert np.allclose(np.exp(product_of_probabilities(ODDS, 0.0)), (1.0 / (1.0 + np.exp(-ODDS))).prod(axis=1))


def test_more_than_half_of_the_members_reach_the_vote() -> None:
    for n_members in (3, 4, 8):
        odds = np.arange(float(n_members))[np.newaxis]
        assert (odds >= majority(odds, 0.0)).sum() > n_members / 2
        assert (odds > majority(odds, 0.0)).sum() <= n_members / 2
    assert maximum(ODDS, 0.0).tolist() == [3.0, 0.0, 4.0]


def test_evidence_equal_to_the_prior_says_nothing_to_dempsters_rule() -> None:
    prior = -3.0
    fused = dempster_shafer(np.array([[prior, prior], [prior + 2.0, prior], [prior - 2.0, prior]]), prior)
    assert math.isclose(fused[0], 0.0, abs_tol=1e-12)
    assert fused[2] < fused[0] < fused[1]


def test_agreement_outweighs_a_single_source_by_dempsters_rule() -> None:
    one, two = dempster_shafer(np.array([[2.0, 0.0], [2.0, 2.0]]), 0.0)
    assert two > one


@pytest.mark.filterwarnings("error")
def test_every_rule_fuses_every_pool_and_finds_what_is_plain() -> None:
    missions = [_mission(seed) for seed in (1, 2, 3)]
    judges, best = judges_of(missions)
    assert best != DETECTOR
    assert len(judges) == 9 + len(POOLS) * (len(RULES) + 1)
    images = [_mission(9, "flat").candidates, _mission(10, "rough").candidates]
    header, rows = table(judges, best, images)
    found = {row[0]: dict(zip(header, row, strict=True)) for row in rows}
    column = next(name for name in header if name.startswith("left out, Pd at 1000"))
    for name in (TOGETHER, *(name for name in judges if " of six" in name or " on six" in name)):
        assert float(found[name][column].split()[0]) > 0.8, name
    assert found[TOGETHER][f"left out, more than {TOGETHER}"] == ""
