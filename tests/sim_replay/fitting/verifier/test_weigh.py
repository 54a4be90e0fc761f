"""Tests of how the network is weighed beside the detector, and judged."""

import numpy as np
import pytest

from auv_mcm.classify.verifier import CLASSES, rest_ratio
from auv_mcm.errors import UsageError
from sim_replay.fitting.verifier.mill import FLOOR, MINE, OTHER
from sim_replay.fitting.verifier.weigh import Looks, auc_of, log_odds_of, pd_at, weighed


def looks(n: int = 20_000, seed: int = 1) -> Looks:
    """Draw looks whose mines have log-odds -2 + 0.7 * detector + 0.9 * network."""
    random = np.random.default_rng(seed)
    detector, network = random.normal(size=(2, n)) * 2.0
    is_mine = random.random(n) < 1.0 / (1.0 + np.exp(2.0 - 0.7 * detector - 0.9 * network))
    scores = np.full((n, len(CLASSES)), -60.0)
    scores[:, 0], scores[:, -1] = network, 0.0
    label = np.where(is_mine, MINE, FLOOR).astype(np.int8)
    kind = np.where(is_mine, 0, len(CLASSES) - 1).astype(np.int8)
    return Looks("scenes", detector, scores, kind, label, np.ones(n, dtype=np.bool_), int(is_mine.sum()), 1.0)


def test_weights_are_found_again() -> None:
    found = weighed([looks()], "0" * 64)
    assert found.detector == pytest.approx(0.7, abs=0.05)
    assert found.network == pytest.approx(0.9, abs=0.05)
    assert found.offset == pytest.approx(-2.0, abs=0.1)


def test_p_mine_is_right_on_average_where_weights_were_fitted() -> None:
    one = looks(seed=3)
    p_mine = 1.0 / (1.0 + np.exp(-log_odds_of(one, weighed([one], "0" * 64))))
    assert p_mine.mean() == pytest.approx((one.label == MINE).mean(), abs=1e-3)


def test_weights_need_mines() -> None:
    one = looks(50)
    with pytest.raises(UsageError, match="no mines"):
        weighed([one._replace(label=np.full(50, FLOOR, dtype=np.int8))], "0" * 64)


def test_pd_counts_the_mines_above_the_alarms_allowed() -> None:
    label = np.array([MINE, FLOOR, OTHER, MINE, FLOOR, MINE], dtype=np.int8)
    odds = np.array([5.0, 4.0, 3.0, 2.0, 1.0, 0.0])
    some = looks(6)
    one = some._replace(detector=odds, label=label, n_targets=4, area_km2=0.01)
    assert pd_at(one, odds, 99.0, others=False) == 0.25
    assert pd_at(one, odds, 100.0, others=False) == 0.5
    assert pd_at(one, odds, 100.0, others=True) == 0.25
    assert pd_at(one, odds, 200.0, others=False) == 0.75
    assert auc_of(one, odds) == pytest.approx(1.0 / 3.0)
    assert np.isnan(auc_of(one._replace(label=np.full(6, MINE, dtype=np.int8)), odds))


def test_the_network_s_evidence_is_against_all_else() -> None:
    scores = np.array([[1.0, 0.3, -np.inf, -np.inf, -np.inf, 0.5, 0.2]])
    mine = np.log(np.exp(1.0) + np.exp(0.3))
    assert rest_ratio(scores, 0.0)[0] == pytest.approx(mine - np.log(np.exp(0.5) + np.exp(0.2)))
