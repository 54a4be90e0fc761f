"""What the odds after contours are said to reject: counted at the threshold that keeps nearly all targets."""

from __future__ import annotations

import pytest

from auv_mcm.errors import UsageError
from sim_replay.benches import snakes
from sim_replay.benches.snakes import Handed, OddsRow, odds_rows


def handed(label: snakes.Label, p_detector: float, p_contours: float, told: bool = True, called: bool = False) -> Handed:
    return Handed(label, called, p_detector, p_contours, told)


def test_two_in_a_hundred_targets_may_be_lost_and_clutter_below_the_others_is_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    targets = [handed("target", 0.5, 0.01 * number) for number in range(1, 101)]  # the lowest two, at 0.01 and 0.02, may go
    clutter = [handed("clutter", 0.4, 0.029), handed("clutter", 0.6, 0.0, told=False), handed("clutter", 0.1, 0.03)]
    flown = {31: targets[:50] + clutter[:1], 32: targets[50:] + clutter[1:]}
    monkeypatch.setattr(snakes, "_handed_on", lambda name, seed, detector: flown[seed])
    assert odds_rows("ripple", (31, 32)) == [
        OddsRow(scene="ripple", called=False, n_clutter=3, n_rejected=2, n_told=1, n_by_detector=2, n_targets=100, n_lost=2)
    ]


def test_false_alarms_of_the_detector_are_judged_beside_the_targets_that_it_calls(monkeypatch: pytest.MonkeyPatch) -> None:
    faint = [handed("target", 0.1, 0.001), handed("clutter", 0.1, 0.002)]
    called = [handed("target", 0.7, 0.3, called=True), handed("clutter", 0.6, 0.2, called=True), handed("clutter", 0.8, 0.4, called=True)]
    monkeypatch.setattr(snakes, "_handed_on", lambda name, seed, detector: faint + called)
    everything, alarms = odds_rows("ripple", (31,))
    assert (everything.called, everything.n_clutter, everything.n_rejected, everything.n_targets) == (False, 3, 0, 2)
    assert alarms == OddsRow(scene="ripple", called=True, n_clutter=2, n_rejected=1, n_told=1, n_by_detector=1, n_targets=1, n_lost=0)


def test_of_few_targets_none_is_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(snakes, "_handed_on", lambda name, seed, detector: [handed("target", 0.5, 0.2), handed("clutter", 0.1, 0.1)])
    assert odds_rows("ripple", range(31, 37))[0].n_lost == 0


def test_without_a_detected_target_nothing_can_be_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(snakes, "_handed_on", lambda name, seed, detector: [handed("clutter", 0.1, 0.1)])
    with pytest.raises(UsageError, match="no target was detected in ripple with seeds 31 to 36: give more seeds"):
        odds_rows("ripple", range(31, 37))
