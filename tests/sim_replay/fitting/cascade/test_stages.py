from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim_replay.fitting.cascade.stages import DETECTION, FALSE_ALARMS, Stage, StageSamples, threshold, train_stage


def _samples(seed: int, shift: float, n: int = 4000) -> StageSamples:
    rng = np.random.Generator(np.random.PCG64(seed))
    is_target = rng.random(n) < 0.3
    return StageSamples(np.clip(rng.normal(120, 30, (12, n)) + shift * is_target, 0, 255).astype(np.uint8), is_target)


def _train(shift: float) -> Stage:
    return train_stage(_samples(1, shift), _samples(2, shift), np.random.Generator(np.random.PCG64(0)))


def test_a_stage_is_as_short_as_its_goals_allow() -> None:
    easy, hard = _train(60.0), _train(25.0)
    for stage in (easy, hard):
        assert stage.detection >= DETECTION
        assert stage.false_alarms <= FALSE_ALARMS
    assert len(easy.stumps) < len(hard.stumps)


def test_a_stage_that_misses_its_goal_still_keeps_the_targets() -> None:
    stage = _train(0.0)
    assert stage.detection >= DETECTION
    assert stage.false_alarms > FALSE_ALARMS


@given(st.lists(st.integers(-50, 50), min_size=1, max_size=300), st.sampled_from([0.5, 0.9, 0.99, 1.0]))
def test_threshold_keeps_the_share_and_no_higher_one_does(scores: list[int], detection: float) -> None:
    score = np.array(scores, dtype=np.int32)
    found = threshold(score, detection)
    assert np.mean(score >= found) >= detection - 1e-9
    above = score[score > found]
    assert not above.size or np.mean(score >= above.min()) < detection


def test_samples_without_targets_to_judge_by_are_refused() -> None:
    good = _samples(3, 50.0, 100)
    with pytest.raises(ValueError, match="0 targets among 100"):
        train_stage(
            good, StageSamples(good.bins, np.zeros(100, dtype=np.bool_)), np.random.Generator(np.random.PCG64(0))
        )
