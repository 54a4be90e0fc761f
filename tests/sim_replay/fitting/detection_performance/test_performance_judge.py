"""Judging predictions against counting by hand, and the bench and the command around it."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from auv_mcm.clearance.detection_performance import FLOORS, Band, Floor, Performance, parse_performance
from auv_mcm.cli import main
from sim_replay.fitting.detection_performance import calibrate_performance as calibrate
from sim_replay.fitting.detection_performance.calibrate_performance import Flight, performance_json
from sim_replay.fitting.detection_performance.fit_performance import Outcomes
from sim_replay.fitting.detection_performance.judge import judge_predictions, mean_error, share
from sim_replay.fitting.detection_performance.looks import CellPass
from sim_replay.fitting.detection_performance.performance_missions import target_scene
from sim_replay.fitting.theatre import Theatre

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


def drawn(n: int, seed: int = 1) -> Outcomes:
    """Draw looks that find as much as the tables predict."""
    rng = np.random.Generator(np.random.PCG64(seed))
    floor = rng.integers(0, len(FLOORS), n)
    aspect_deg = np.array([0.0, 0.0, 45.0, 90.0, 0.0, 0.0])[floor]
    return Outcomes(
        mission=rng.integers(0, 10, n),
        target=np.arange(n),
        time_s=np.zeros(n),
        floor=floor,
        seabed=np.array(SEABED)[floor],
        ground_range_m=rng.uniform(3.0, 75.0, n),
        altitude_m=np.full(n, 6.0),
        look_rad=np.radians(aspect_deg),
        ripple_rad=np.zeros(n),
        found=rng.uniform(size=n) < np.array([P[name] for name in FLOORS])[floor],
    )


def test_brier_score_and_shares_are_those_of_counting() -> None:
    seen = drawn(500)
    found = judge_predictions(tables(), seen)
    p = [P[FLOORS[floor]] for floor in seen.floor]
    assert found.brier == pytest.approx(sum((a - b) ** 2 for a, b in zip(p, seen.found, strict=True)) / 500)
    assert sum(place.share.n for place in found.places) == 500
    for place in found.places:
        index = ("flat", "ripple", "rough", "vegetation").index(place.seabed)
        here = [
            i for i in range(500) if seen.seabed[i] == index and place.near_m <= seen.ground_range_m[i] < place.far_m
        ]
        assert place.share.realised == pytest.approx(sum(bool(seen.found[i]) for i in here) / len(here))
        assert place.share.predicted == pytest.approx(sum(p[i] for i in here) / len(here))
    assert found.same is None


def test_right_tables_are_off_by_chance_alone() -> None:
    errors = [mean_error(judge_predictions(tables(), drawn(2000, seed)).judged) for seed in range(12)]
    error, by_chance, by_mission = np.mean(errors, axis=0)
    assert error == pytest.approx(by_chance, rel=0.25)
    assert by_chance <= by_mission < 1.5 * by_chance


def test_missions_unlike_each_other_carry_less_information() -> None:
    p, mission = np.full(400, 0.5), np.repeat(np.arange(4), 100)
    apart = share(p, mission % 2 == 0, mission)
    assert apart.by_mission > 5.0 * apart.by_chance
    assert (
        share(p[:1], np.array([True]), mission[:1]).by_mission == share(p[:1], np.array([True]), mission[:1]).by_chance
    )


def test_two_looks_are_judged_by_what_the_further_one_adds() -> None:
    one = drawn(300)
    again = one._replace(time_s=one.time_s + 9.0)
    other = one._replace(time_s=one.time_s + 20.0, look_rad=one.look_rad + math.pi)
    found = judge_predictions(
        tables(), Outcomes(*(np.concatenate(parts) for parts in zip(one, again, other, strict=True)))
    )
    assert found.same is not None
    assert found.other is not None
    assert (found.same.n, found.other.n) == (300, 600)
    assert found.same.predicted == pytest.approx(np.mean([P[FLOORS[floor]] for floor in one.floor]))
    assert found.other.predicted > found.same.predicted
    assert found.other.realised == found.same.realised  # the same draw each time


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
        )
        for target in range(120)
    ]


def test_the_command_writes_tables_that_the_bench_judges(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(calibrate, "fly_scene", looks_of_flight)
    command = ["calibrate", "performance", "--seeds", "800-801", "--flights", "2", "--workers", "1", "--out"]
    assert main([*command, str(tmp_path / "p.json")]) == 0
    assert "480 looks at 480 targets in 4 simulated missions: seeds 800 to 801, 2 each" in capsys.readouterr().out
    assert main([*command, str(tmp_path / "again.json")]) == 0
    assert (tmp_path / "p.json").read_bytes() == (tmp_path / "again.json").read_bytes()
    parse_performance((tmp_path / "p.json").read_bytes(), "p.json")
    capsys.readouterr()
    bench = ["bench", "performance", "--seeds", "3", "--workers", "1", "--tables", str(tmp_path / "p.json")]
    assert main([*bench, "--markdown"]) == 0
    printed = capsys.readouterr().out
    assert "360 looks in 3 missions" in printed
    assert "Brier score" in printed
    assert "| two looks, others | - | - |" in printed


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["calibrate", "performance", "--out", "{there}"], 2, "exists and is not overwritten"),
        (["calibrate", "performance", "--out", "{none}/p.json"], 2, "Make it first"),
        (["bench", "performance", "--tables", "{none}"], 3, "cannot be read"),
        (["bench", "performance", "--tables", "{there}"], 3, "calibrate performance"),
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
    assert performance_json(tables()) == performance_json(parse_performance(performance_json(tables()), "here"))
