"""The bench over scenes: what it refuses, and what it tells the chain of a sonar."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import pytest

from auv_mcm.config import Config
from auv_mcm.errors import UsageError
from sim_replay.benches.scenes import add_arguments, config_for, run
from sim_replay.simulator.scene_file import read_scene


def run_with(*arguments: str) -> None:
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    run(parser.parse_args(arguments))


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("--scenes", "flat,reef"), "flat,reef"),
        (("--scenes", "flat,flat"), "flat,flat"),
        (("--scenes", ""), "--scenes"),
        (("--seeds", "0"), "--seeds 0"),
        (("--workers", "-1"), "--workers -1"),
        (("--first-seed", "-3"), "--first-seed -3"),
    ],
)
def test_what_makes_no_sense_is_refused_by_name(arguments: tuple[str, ...], named: str) -> None:
    with pytest.raises(UsageError, match=named):
        run_with(*arguments)


def test_scores_that_could_not_be_written_are_refused_before_flying(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no folder"):
        run_with("--json", str(tmp_path / "missing" / "scores.json"))


def test_the_chain_is_told_the_beam_width_and_nothing_else() -> None:
    deep = config_for(read_scene("deep"))
    assert deep.sonar.beam_width_deg == read_scene("deep").sonar.beam_width_deg
    assert (deep.detect, deep.waterfall, deep.navigation) == (Config().detect, Config().waterfall, Config().navigation)


def test_a_synthetic_aperture_has_the_beam_of_its_resolution_at_half_range() -> None:
    scene = read_scene("sas")
    assert scene.sonar.synthetic_aperture is not None
    width_m = math.radians(config_for(scene).sonar.beam_width_deg) * 0.5 * scene.sonar.range_m
    assert width_m == pytest.approx(scene.sonar.synthetic_aperture.along_track_resolution_m)
