"""The score as text, JSON and picture."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from auv_mcm.errors import UsageError
from sim_replay.scoring import Score, plot, score_json, score_missions, table
from tests.sim_replay.scoring.scoring_cases import contact, mission, random_mission, truth_object


@pytest.fixture(scope="module")
def score() -> Score:
    return score_missions([random_mission(seed) for seed in range(3)])


def test_table_shows_the_figures_with_their_intervals(score: Score) -> None:
    lines = table(score).splitlines()
    point = score.at_threshold
    (pd_line,) = (line for line in lines if line.startswith("Pd  "))
    assert f"{point.pd.value:.3f}" in pd_line
    assert f"{point.pd.low:.3f}-{point.pd.high:.3f}" in pd_line
    assert f"{point.pd.count} of {point.pd.of}" in pd_line
    (alarms,) = (line for line in lines if line.startswith("false alarms per km²"))
    assert f"{point.false_alarms.count}, {point.on_known_clutter} of them on known clutter" in alarms
    for word in (
        "mission 2",
        "truncated_cone",
        "30-50 m",
        "sea floor",
        "nothing there",
        "distance by sigma_m",
        "partial area",
        "resampled",
    ):
        assert any(word in line for line in lines), word
    assert max(map(len, lines)) <= 120
    assert not any(line != line.rstrip() for line in lines)


def test_table_of_nothing_says_so() -> None:
    text = table(score_missions([mission([], [])]))
    assert "note: no targets in the truth: there is no Pd, only false alarms" in text
    assert "1 mission, 0 targets, 0 other objects, 0 contacts" in text
    assert "nan" not in text
    assert "None" not in text


def test_table_warns_where_ranges_are_not_known() -> None:
    text = table(
        score_missions(
            [mission([contact(0.0, 0.0, ground_range_m=12.0)], [truth_object(0.0, 0.0), truth_object(20.0, 0.0)])]
        )
    )
    assert "no range of 1 missed target" in text


def test_json_holds_every_threshold_and_repeats_to_the_last_byte(score: Score) -> None:
    document = json.loads(score_json(score))
    assert document["at_threshold"]["pd"]["count"] == score.at_threshold.pd.count
    assert [point["threshold"] for point in document["froc"]] == [point.threshold for point in score.froc]
    assert score_json(score_missions([random_mission(seed) for seed in range(3)])) == score_json(score)


def test_plot_is_a_picture_with_a_curve(score: Score, tmp_path: Path) -> None:
    plot(score, tmp_path / "froc.png")
    picture = cv2.imread(str(tmp_path / "froc.png"))
    assert picture is not None
    assert min(picture.shape[:2]) >= 500
    curve = np.array([0x79, 0x4E, 0x1F])
    assert np.count_nonzero(np.abs(picture.astype(int) - curve).max(axis=2) < 20) > 1000


@pytest.mark.parametrize("contacts", [[], [contact(50.0, 0.0)], [contact(0.0, 0.0)]])
def test_plot_takes_curves_of_one_point_or_none(contacts: list[dict[str, object]], tmp_path: Path) -> None:
    plot(score_missions([mission(contacts, [truth_object(0.0, 0.0)])]), tmp_path / "froc.png")
    assert (tmp_path / "froc.png").stat().st_size > 5000


def test_plot_refuses_what_it_cannot_draw(score: Score, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"'\.xyz' is not a picture format"):
        plot(score, tmp_path / "froc.xyz")
    with pytest.raises(UsageError, match="no targets"):
        plot(score_missions([mission([contact(0.0, 0.0)], [])]), tmp_path / "froc.png")


def test_scoring_without_a_plot_does_not_load_matplotlib() -> None:
    code = "import sys, sim_replay.scoring; sys.exit('matplotlib' in sys.modules or 'scipy.stats' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
