"""Tests of the comparison of a convolutional verifier with the odds of measurements."""

from pathlib import Path

import numpy as np
import pytest

from auv_mcm.errors import BadInputError
from sim_replay.benches import verifier
from sim_replay.benches.verifier import BOTH, NETWORK, TREES, FoldScores, FoldTask, compared, summed_scores
from sim_replay.fitting.cascade.farm import Farm
from sim_replay.fitting.left_out import Scored, dealt, pd_at
from sim_replay.fitting.looks import MissionLooks, place_of
from sim_replay.fitting.verifier.chips import N_COLUMNS, N_PLANES, N_ROWS
from sim_replay.fitting.verifier.flown_chips import Chips, all_chips
from tests.sim_replay.fitting.test_left_out import some_missions


def chips_of(mission: MissionLooks) -> Chips:
    """Chips whose first pixel says what the look is."""
    is_target = mission.looks.is_target
    chips = np.zeros((len(is_target), N_PLANES, N_ROWS, N_COLUMNS), dtype=np.float16)
    chips[:, 0, 0, 0] = is_target
    return chips


def scored(domain: str, seed: int) -> tuple[Scored, Scored]:
    """Two log-odds of the same looks that err independently."""
    random = np.random.Generator(np.random.PCG64(seed))
    is_target = np.arange(400) % 4 == 0
    one, other = (4.0 * is_target - 3.0 + random.normal(0.0, 2.0, 400) for _ in range(2))
    of = Scored(domain, one, is_target, np.ones(400), 100, 0.1)
    return of, of._replace(log_odds=other)


def test_the_sum_of_two_independent_log_odds_finds_more_than_either() -> None:
    pairs = [scored(domain, seed) for seed, domain in enumerate(("flat", "ripple", "mixed", "deep"))]
    one, other = [pair[0] for pair in pairs], [pair[1] for pair in pairs]
    both = summed_scores(one, other, [frozenset({"flat", "ripple"}), frozenset({"mixed", "deep"})])
    assert [some.domain for some in both] == ["flat", "ripple", "mixed", "deep"]
    assert pd_at(both, 100.0) > max(pd_at(one, 100.0), pd_at(other, 100.0)) + 0.1


def test_every_domain_has_a_row_per_method_from_a_network_that_never_saw_it(monkeypatch: pytest.MonkeyPatch) -> None:
    missions = some_missions()
    chips = [chips_of(mission) for mission in missions]
    n_trained: list[int] = []

    def trained(task: FoldTask) -> FoldScores:
        n_trained.append(len(task.weight))
        assert np.array_equal(task.chips[:, 0, 0, 0].astype(np.bool_), task.is_target)
        return FoldScores(b"", tuple(4.0 * own[:, 0, 0, 0].astype(np.float64) - 2.0 for own in task.judged))

    monkeypatch.setattr(verifier, "_trained", trained)
    monkeypatch.setattr(verifier, "_cost", lambda onnx, chips: "")
    lines = frozenset({"reef", "river"})
    table = compared(missions, chips, lines, dealt(missions, 3), 1, Farm(1))
    rows = [line for line in table.splitlines() if line.startswith(("flat ", "reef ", "all domains "))]
    assert len(rows) == 3 * len((TREES, NETWORK, BOTH))
    assert all(n < sum(len(own) for own in chips) - 120 for n in n_trained)  # without both lines and the fold


def test_chips_of_other_looks_and_damaged_ones_are_rejected_by_name(tmp_path: Path) -> None:
    mission = some_missions()[0]
    place = place_of(tmp_path, mission.task).with_suffix(".chips.npz")
    np.savez(place, chips=chips_of(mission), is_target=~mission.looks.is_target)
    with pytest.raises(BadInputError, match="chips of other looks"):
        all_chips([mission], tmp_path, Farm(1))
    place.write_bytes(b"no archive")
    with pytest.raises(BadInputError, match=place.name):
        all_chips([mission], tmp_path, Farm(1))
    np.savez(place, chips=chips_of(mission), is_target=mission.looks.is_target)
    assert np.array_equal(all_chips([mission], tmp_path, Farm(1))[0], chips_of(mission))
