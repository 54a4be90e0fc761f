"""Count what the odds after contours reject at the threshold that keeps nearly all targets."""

from __future__ import annotations

import pytest

from auv_mcm.errors import UsageError
from sim_replay.studies import snakes
from sim_replay.studies.snakes import Handed, OddsRow, odds_row


def handed(label: snakes.Label, p_detector: float, p_contours: float, reported: bool = True) -> Handed:
    return Handed(label, p_detector, p_contours, reported)


def test_two_in_a_hundred_targets_may_be_lost_and_clutter_below_the_others_is_rejected(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    targets = [
        handed("target", 0.5, 0.01 * number) for number in range(1, 101)
    ]  # the lowest two, at 0.01 and 0.02, may go
    clutter = [handed("clutter", 0.4, 0.029), handed("clutter", 0.6, 0.0, reported=False), handed("clutter", 0.1, 0.03)]
    flown = {31: targets[:50] + clutter[:1], 32: targets[50:] + clutter[1:]}
    monkeypatch.setattr(snakes, "_handed_on", lambda name, seed: flown[seed])
    assert odds_row("ripple", (31, 32)) == OddsRow(
        scene="ripple", n_clutter=3, n_rejected=2, n_explained=1, n_by_detector=2, n_targets=100, n_lost=2
    )


def test_of_few_targets_none_is_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        snakes, "_handed_on", lambda name, seed: [handed("target", 0.5, 0.2), handed("clutter", 0.1, 0.1)]
    )
    assert odds_row("ripple", range(31, 37)).n_lost == 0


def test_without_a_detected_target_nothing_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(snakes, "_handed_on", lambda name, seed: [handed("clutter", 0.1, 0.1)])
    with pytest.raises(UsageError, match="no target was detected in ripple with seeds 31 to 36: give more seeds"):
        odds_row("ripple", range(31, 37))
