"""What the bench of the operating point counts."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pytest

from auv_mcm.contacts.background import shipped_background
from auv_mcm.contacts.expected_alarms import called_from_nats
from auv_mcm.errors import BadInputError
from sim_replay.benches import experiment
from sim_replay.benches.experiment import experiment_rows
from sim_replay.benches.point import ASKED_PER_KM2, EXPERIMENT, PointResult, judged, reached
from sim_replay.commands.bench import opened
from tests.sim_replay.fitting.test_background_fit import drawn_mission


def test_a_mission_is_judged_by_a_prior_that_it_was_left_out_of() -> None:
    model = shipped_background()
    left = model.left_out[0]
    assert judged(drawn_mission(1, left.scene), model).prior == left.prior
    assert judged(drawn_mission(1, "a recorded line"), model).prior == model.cascade


def test_false_alarms_and_targets_are_counted_at_each_missions_own_level() -> None:
    some = [judged(drawn_mission(seed, "elsewhere"), shipped_background()) for seed in range(4)]
    found = reached(some, 100.0)
    levels = [called_from_nats(one.mission.everything, one.mission.area_km2, 100.0) for one in some]
    assert found.n_asked == pytest.approx(100.0 * 0.8)
    assert found.n_false_alarms == sum(
        np.count_nonzero(one.mission.background >= level) for one, level in zip(some, levels, strict=True)
    )
    on_objects = [one.mission.background[one.mission.on_objects] for one in some]
    assert found.n_on_objects == sum(
        np.count_nonzero(part >= level) for part, level in zip(on_objects, levels, strict=True)
    )
    assert found.n_called == sum(
        np.count_nonzero(one.mission.mines >= level) for one, level in zip(some, levels, strict=True)
    )
    on_bare_floor = 0.5 * found.n_without_mines  # half of the false alarms called are taken to lie there
    assert found.n_asked / 3.0 < on_bare_floor < 3.0 * found.n_asked
    assert found.n_judged == 4
    assert found.n_inside >= 3  # of intervals of 95 %
    pooled = np.concatenate([one.mission.background for one in some])
    above = np.sort(pooled)[::-1][found.n_false_alarms]
    assert found.best == sum(np.count_nonzero(one.mission.mines > above) for one in some)


def test_the_table_has_a_row_per_domain_and_density_asked() -> None:
    names = ("flat", "rough", "reef", "river")
    some = [judged(drawn_mission(number, name), shipped_background()) for number, name in enumerate(names, 1)]
    flown = [{name: PointResult(one, asked) for name, asked in ASKED_PER_KM2.items()} for one in some]
    rows = experiment_rows(EXPERIMENT, names, flown)
    assert [row.missions for row in rows[::3]] == [*names, "all simulated", "all recorded"]
    assert [row.cells["FA asked"].value for row in rows[:3]] == pytest.approx([6.0, 20.0, 60.0])


def test_a_log_that_cannot_be_read_is_rejected_before_any_mission_is_flown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (empty := tmp_path / "empty.xtf").touch()
    parser = argparse.ArgumentParser()
    run = opened("benches.point", parser)
    monkeypatch.setattr(experiment, "run_tasks", lambda *_: pytest.fail("a mission is flown"))
    with pytest.raises(BadInputError, match="is empty"):
        run(parser.parse_args(["--log", str(empty)]))
