"""Looks become tables of performance: the command, its refusals, the missions it flies."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from auv_mcm.clearance.detection_performance import FLOORS, Band, Floor, Performance, parse_performance
from auv_mcm.cli import main
from sim_replay.fitting.detection_performance import calibrate_performance as calibrate
from sim_replay.fitting.detection_performance.calibrate_performance import Flight
from sim_replay.fitting.detection_performance.looks import CellPass
from sim_replay.fitting.detection_performance.performance_missions import target_scene
from sim_replay.fitting.theatre import Theatre
from sim_replay.text_tables import json_lines

P = {"flat": 0.8, "ripple_across": 0.2, "ripple_oblique": 0.5, "ripple_along": 0.4, "rough": 0.3, "vegetation": 0.1}
SEABED = (0, 1, 1, 1, 2, 3)  # of FLOORS


def tables() -> Performance:
    floors: dict[Floor, tuple[Band, ...]] = {
        name: (Band(n_looks=9, n_found=4, p=P[name], low=0.0, high=1.0),) * 2 for name in FLOORS
    }
    return Performance(
        fitted_on="a test",
        altitude_m=6.0,
        altitude_exponent=0.0,
        edges_m=(0.0, 30.0, 80.0),
        floors=floors,
        same_look_correlation=1.0,
        other_look_correlation=0.0,
    )


def looks_of_flight(flight: Flight, theatre: Theatre) -> list[CellPass]:
    rng = np.random.Generator(np.random.PCG64([flight.seed, flight.number]))
    return [
        CellPass(
            mission=1000 * flight.seed + flight.number,
            target=target,
            floor="sand",
            seabed=SEABED[target % 6],
            ripple_rad=0.0,
            ground_range_m=float(rng.uniform(3.0, 75.0)),
            altitude_m=6.0,
            look_rad=math.radians((0.0, 0.0, 45.0, 90.0, 0.0, 0.0)[target % 6]),
            time_s=0.0,
            p_mine=float(rng.uniform()),
            unevenness_db=2.0,
        )
        for target in range(120)
    ]


def test_the_command_writes_the_same_tables_each_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(calibrate, "fly_scene", looks_of_flight)
    command = ["calibrate", "performance", "--seeds", "800-801", "--flights", "2", "--workers", "1", "--out"]
    assert main([*command, str(tmp_path / "p.json")]) == 0
    assert "480 looks at 480 targets in 4 simulated missions: seeds 800 to 801, 2 each" in capsys.readouterr().out
    assert main([*command, str(tmp_path / "again.json")]) == 0
    assert (tmp_path / "p.json").read_bytes() == (tmp_path / "again.json").read_bytes()
    parse_performance((tmp_path / "p.json").read_bytes(), "p.json")


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["calibrate", "performance", "--out", "{there}"], 2, "exists and is not overwritten"),
        (["calibrate", "performance", "--out", "{none}/p.json"], 2, "Make it first"),
    ],
)
def test_bad_files_are_refused_before_anything_is_flown(
    arguments: list[str],
    code: int,
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def none_flown(flight: Flight, theatre: Theatre) -> list[CellPass]:
        raise AssertionError(flight)

    monkeypatch.setattr(calibrate, "fly_scene", none_flown)
    (tmp_path / "there.json").write_text("{}")
    places = {"there": tmp_path / "there.json", "none": tmp_path / "none"}
    assert main([argument.format(**places) for argument in arguments]) == code
    assert words in capsys.readouterr().err


@pytest.mark.parametrize("seeds", ["800", "9-8", "a-b", "-1-5", "1-", "1-99999999999999999999999999"])
def test_seeds_that_are_no_range_are_refused(seeds: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["calibrate", "performance", f"--seeds={seeds}"])
    assert ended.value.code == 2
    assert "800-815" in capsys.readouterr().err


def test_scenes_are_full_of_targets_that_keep_apart_and_differ_by_seed_and_flight() -> None:
    scenes = [target_scene(seed, flight) for seed in (800, 801) for flight in (0, 1)]
    assert len({scene.seed for scene in scenes}) == 4
    for scene in scenes:
        place = np.array(
            [(scene_object.east_m, scene_object.north_m) for scene_object in scene.objects], dtype=np.float64
        )
        apart_m = np.hypot(*(place[:, np.newaxis] - place).transpose(2, 0, 1)) + 1e9 * np.eye(len(place))
        assert len(place) > 100
        assert apart_m.min() >= 12.0
        assert apart_m.min(axis=1).max() < 15.0
    assert target_scene(800) == scenes[0]


def test_tables_in_json_are_the_same_bytes_each_time() -> None:
    assert json_lines(tables()) == json_lines(parse_performance(json_lines(tables()), "here"))
