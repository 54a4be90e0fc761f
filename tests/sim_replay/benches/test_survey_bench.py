"""What planning on the way saves: the same square by plans and by lanes."""

from __future__ import annotations

import numpy as np
import pytest

from auv_mcm.cli import main
from sim_replay.benches import survey
from sim_replay.benches.experiment import Task, experiment_rows
from sim_replay.benches.survey import EXPERIMENT, PLANNED, lanes_over


def test_plans_clear_a_square_as_lanes_do(monkeypatch: pytest.MonkeyPatch) -> None:
    """Single squares take 0.75 to 1.05 of the track of lanes; areas by the tables hold what is saved in the mean."""
    monkeypatch.setattr(survey, "LANES", {"lanes": 0.9})
    found = survey.fly(Task("mixed", 9704, {"side": 120, "percent": 80}))
    lanes, planned = found["lanes"], found[PLANNED]
    assert lanes.is_reached
    assert planned.is_reached
    assert min(lanes.p_detected, planned.p_detected) >= 0.8
    assert planned.way_m < 1.15 * lanes.way_m
    experiment = EXPERIMENT._replace(variants=("lanes", PLANNED))
    by_lanes, by_plans = experiment_rows(experiment, ["mixed"], [found])
    assert by_plans.cells["track, m"].value == pytest.approx(planned.way_m)
    assert by_lanes.cells["reached"].value == 1.0
    assert (by_plans.cells["Pd called"].value or 0.0) >= (by_lanes.cells["Pd called"].value or 0.0) - 0.15


@pytest.mark.parametrize("spacing_m", [20.0, 37.0, 80.0])
def test_every_pass_of_lanes_leaves_no_place_farther_than_half_a_spacing(spacing_m: float) -> None:
    legs = lanes_over(100.0, spacing_m)
    n = int(np.ceil(100.0 / spacing_m))
    passes = [[next(legs) for _ in range(n)] for _ in range(8)]
    places = np.random.default_rng(1).uniform(0.0, 100.0, (50, 2)).tolist()
    for place in places:
        for some in passes[:2]:
            assert min(leg.distance_m(*place) for leg in some) <= 0.5 * spacing_m
    headings = [round(np.degrees(some[0].direction_rad)) for some in passes]
    assert headings == [0, 90] * 4
    assert not list(legs)


@pytest.mark.parametrize("options", [["--side", "99"], ["--percent", "100"], ["--side", "a"]])
def test_an_order_that_cannot_be_is_refused(options: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["bench", "survey", *options])
    assert ended.value.code == 2
    assert "is not a whole number from" in capsys.readouterr().err


def test_images_of_whole_legs_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "survey", "--scenes", "sas", "--seeds", "1", "--workers", "1"]) == 2
    assert "cannot be planned on the way" in capsys.readouterr().err
