"""The law of measured sizes, fitted to looks drawn from a law that is known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from auv_mcm.classify.size_evidence import parse_size_model, shipped_size_model
from auv_mcm.errors import UsageError
from auv_mcm.kernels.shape import Solid
from sim_replay.fitting.fit_sizes import CLEAR_NATS, SizedLook, fit_sizes, true_log_sizes
from sim_replay.text_tables import json_lines

N_SIZES: dict[Solid, int] = {"cylinder": 2, "sphere": 1, "truncated_cone": 2, "wedge": 1}
TEMPER, SLOPE, OFFSET, SD, ASTRAY = 10.0, 0.8, -0.1, 0.1, 0.25


def drawn_looks(n_looks: int) -> list[SizedLook]:
    """Looks whose sizes are 0.8 ln true - 0.1 with an error of 10 %, a quarter of them astray."""
    random = np.random.Generator(np.random.PCG64(7))
    kinds = list(N_SIZES)
    looks = []
    for number in range(n_looks):
        costs = random.uniform(0.0, 40.0, len(kinds)) - (80.0 if number % 2 else 0.0)
        likelihood = np.exp(-(costs - costs.min()) / TEMPER)
        kind = kinds[int(random.choice(len(kinds), p=likelihood / likelihood.sum()))]
        true = random.normal(-0.3, 0.3, N_SIZES[kind])
        seen = OFFSET + SLOPE * true + random.normal(0.0, SD, N_SIZES[kind])
        astray = random.normal(-0.3, 0.5, N_SIZES[kind])
        measured = astray if random.uniform() < ASTRAY else seen
        cost = dict(zip(kinds, costs.tolist(), strict=True))
        looks.append(SizedLook(kind, tuple(true.tolist()), {kind: tuple(measured.tolist())}, cost))
    return looks


def test_the_law_that_looks_were_drawn_from_is_found_again() -> None:
    model = fit_sizes(drawn_looks(2400), "drawn looks", "this test")
    for kind, sizes in model.kinds.items():
        assert sizes.mean == pytest.approx([-0.3] * N_SIZES[kind], abs=0.05)
        assert sizes.sd == pytest.approx([0.3] * N_SIZES[kind], abs=0.03)
        for law in (sizes.clear, sizes.faint):
            assert law.slope == pytest.approx([SLOPE] * N_SIZES[kind], abs=0.12)
            assert law.offset == pytest.approx([OFFSET] * N_SIZES[kind], abs=0.06)
            assert [math.sqrt(row[k]) for k, row in enumerate(law.covariance)] == pytest.approx(
                [SD] * N_SIZES[kind], abs=0.03
            )
            assert law.astray == pytest.approx(ASTRAY, abs=0.12)
    assert model.temper == pytest.approx(TEMPER, rel=0.15)
    assert parse_size_model(json_lines(model), "drawn") == model


def test_too_few_looks_are_refused() -> None:
    with pytest.raises(UsageError, match="too few to fit on"):
        fit_sizes(drawn_looks(40), "drawn looks", "this test")


def test_true_sizes_are_those_that_solids_have() -> None:
    assert true_log_sizes("cylinder", 2.0, 0.5, 0.5) == (math.log(2.0), math.log(0.5))
    assert true_log_sizes("sphere", 0.9, 0.9, 0.9) == (math.log(0.9),)
    assert true_log_sizes("truncated_cone", 1.0, 1.0, 0.4) == (0.0, math.log(0.4))
    assert true_log_sizes("wedge", 1.02, 0.80, 0.385) == pytest.approx((math.log(1.02),))


def test_the_model_that_ships_was_made_by_this_command() -> None:
    model = shipped_size_model()
    assert "auv-mcm calibrate sizes --seeds 13000-13035" in model.made_by
    assert model.clear_nats == CLEAR_NATS
    assert {kind: len(sizes.mean) for kind, sizes in model.kinds.items()} == N_SIZES
