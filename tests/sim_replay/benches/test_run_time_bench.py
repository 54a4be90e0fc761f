"""The bench of run time against error: the plain script, what is compared, the page, and the check of counts of
work."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import msgspec
import pytest

from auv_mcm.cli import main
from auv_mcm.errors import BadInputError, UsageError
from auv_mcm.settings.config import Config
from sim_replay.augment.recorded_line import scattered
from sim_replay.benches.run_time import plain_script
from sim_replay.benches.run_time.apart import WITHOUT_KERNELS, Apart
from sim_replay.benches.run_time.lines import BenchMission, with_short_legs, without_objects
from sim_replay.benches.run_time.measure import BenchMachine, MissionCost, SettingResult, run_once
from sim_replay.benches.run_time.one_run import DEFAULT
from sim_replay.benches.run_time.points import PLAIN, chain_settings
from sim_replay.benches.run_time.results import (
    RunTimeResults,
    changes_since,
    read_results,
    reason_words,
    require_same_missions,
)
from sim_replay.benches.run_time.targets import cost_targets, target_rows
from sim_replay.missions import config_for
from sim_replay.scoring import ScoredMission, parse_contacts, parse_truth, score_missions
from sim_replay.scoring.intervals import density, proportion
from sim_replay.simulate import simulate
from sim_replay.simulator.scene import Lawnmower
from sim_replay.simulator.scene_file import parse_scene, read_scene

BRIGHT = """
world: {depth_m: 12, seabeds: [{type: sand}]}
sonar: {frequency_khz: 450, range_m: 25, n_samples: 400, ping_rate_hz: 10}
track: {altitude_m: 5, plan: {pattern: lawnmower, n_legs: 1, leg_m: 40, spacing_m: 40}}
objects: [{kind: cylinder, leg: 0, along_m: 20, across_m: 12, azimuth_deg: 0, strength_db: -6}]
"""
MACHINE = BenchMachine(
    processor="one", cores=1, kernels="c", versions={"python": "3"}, date="2026-11-23", load=(0.0, 0.0)
)


def a_run(*process_s: float, contacts: int = 3, pings: int = 100, chain_s: tuple[float, ...] = (1.0,)) -> MissionCost:
    return MissionCost(
        process_s=process_s,
        elapsed_s=process_s,
        chain_s=chain_s,
        stages_s={"detect": 0.75 * chain_s[0]} if chain_s else {},
        peak_memory_mb=100.0,
        sonar_s=60.0,
        pings=pings,
        samples=10 * pings,
        contacts=contacts,
        covered_km2=0.01,
        counters={},
        called=(),
        contacts_sha256="0",
    )


def a_point(name: str, *process_s: float, found: int = 10, contacts: int = 30) -> SettingResult:
    pd = tuple(proportion(found, 20) for _ in range(3))
    runs = {"flat 1": a_run(*process_s)}
    return SettingResult(name=name, knob=name, value="", runs=runs, pd=pd, contacts=density(contacts, 0.01))


def of(*some: SettingResult, missions: tuple[str, ...] = ("flat 1",)) -> RunTimeResults:
    return RunTimeResults(machine=MACHINE, repeat=3, missions=missions, sonar_s=60.0, points=some, targets=())


PLAIN_POINT = a_point(PLAIN, 1.0, 1.0, 1.1, found=5)


def test_the_plain_script_finds_a_bright_cylinder_and_places_it(tmp_path: Path) -> None:
    done = simulate(parse_scene(BRIGHT, "bright"), tmp_path)
    script = str(Path(plain_script.__file__))
    subprocess.run([sys.executable, script, str(done.log), str(tmp_path / "found.json")], check=True, timeout=60)
    contacts = parse_contacts(json.loads((tmp_path / "found.json").read_bytes()), "found")
    score = score_missions(
        [ScoredMission(contacts, parse_truth(json.loads(done.truth.read_bytes()), "truth"), "bright")]
    )
    assert score.froc[-1].pd.count == 1


def test_the_plain_script_shares_no_code_with_the_chain() -> None:
    code = Path(plain_script.__file__).read_text("utf-8")
    assert "auv_mcm" not in code
    assert "sim_replay" not in code


def test_the_quick_check_holds_errors_and_counts_of_work(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "chain", "--quick"]) == 0
    assert "FAILED" not in capsys.readouterr().out


def test_points_have_names_of_their_own_and_each_turns_something() -> None:
    every = chain_settings()
    assert len({point.name for point in every}) == len(every)
    assert every[0].name == DEFAULT
    config = config_for(read_scene("flat"))
    for point in every[1:]:
        assert point.is_plain_script or point.configure(config) != config, point.name


def test_short_missions_keep_all_objects_and_empty_ones_have_none() -> None:
    scene = read_scene("flat")
    shortened = with_short_legs(scene, 7)
    assert isinstance(scene.track.plan, Lawnmower)
    assert isinstance(shortened.track.plan, Lawnmower)
    assert shortened.track.plan.leg_m == 0.5 * scene.track.plan.leg_m
    assert shortened.scatter == scene.scatter
    assert scattered(3) != scattered(4)
    assert without_objects(shortened).scatter == ()


def test_a_cost_has_moved_only_where_no_repeat_overlaps() -> None:
    old = of(a_point(DEFAULT, 10.0, 10.4, 10.2), PLAIN_POINT)
    assert changes_since(old, of(a_point(DEFAULT, 10.3, 10.1, 10.5), PLAIN_POINT)) == []
    (line,) = changes_since(old, of(a_point(DEFAULT, 5.0, 5.2, 5.1), PLAIN_POINT))
    assert line.startswith("default: cost 10.00 -> 5.00 of the plain script")


def test_a_slower_computer_is_no_change() -> None:
    old = of(a_point(DEFAULT, 10.0, 10.4, 10.2), PLAIN_POINT)
    slower = of(a_point(DEFAULT, 20.0, 20.8, 20.4), a_point(PLAIN, 2.0, 2.0, 2.2, found=5))
    assert changes_since(old, slower) == []


def test_errors_have_moved_where_they_leave_the_older_interval() -> None:
    old = of(a_point(DEFAULT, 10.0, found=10, contacts=30))
    assert changes_since(old, of(a_point(DEFAULT, 10.0, found=11, contacts=31))) == []
    said = changes_since(old, of(a_point(DEFAULT, 10.0, found=19, contacts=90)))
    assert [words.partition(": ")[2] for words in said] == [
        *(f"Pd at {limit} FA/km² 0.50 -> 0.95" for limit in (10, 100, 300)),
        "contacts per km² 3000 -> 9000",
    ]


def test_runs_on_other_missions_are_not_compared() -> None:
    with pytest.raises(UsageError, match="ripple 1"):
        require_same_missions(of(PLAIN_POINT), ["ripple 1"])


def test_results_survive_their_file_and_others_are_refused(tmp_path: Path) -> None:
    results = of(a_point(DEFAULT, 10.0, 11.0), PLAIN_POINT)
    (tmp_path / "a.json").write_bytes(msgspec.json.encode(results))
    assert read_results(tmp_path / "a.json") == results
    (tmp_path / "b.json").write_bytes(b"{}")
    with pytest.raises(BadInputError, match="bench chain --json"):
        read_results(tmp_path / "b.json")
    with pytest.raises(UsageError, match="cannot be read"):
        read_results(tmp_path / "none.json")


def test_points_that_cost_less_and_find_as_much_are_named_beside_the_reason_for_the_default() -> None:
    plain = a_point(PLAIN, 1.0, found=5)
    results = of(a_point(DEFAULT, 10.0), a_point("slower", 12.0), a_point("better", 12.0, found=12), plain)
    assert reason_words(results).endswith("at every limit: none")
    assert reason_words(of(a_point(DEFAULT, 10.0), a_point("cheaper", 9.0))).endswith("at every limit: cheaper")


def test_targets_say_what_missed_and_where_the_time_goes(tmp_path: Path) -> None:
    truth = parse_truth({"area_km2": 0.001, "objects": []}, "here")
    config = config_for(read_scene("flat"))
    lines = [
        BenchMission("flat 1", "flat", "scene", tmp_path, config, truth),
        BenchMission("flat 1 without objects", "flat", "empty", tmp_path, config, truth),
    ]
    runs = {"flat 1": a_run(3.0, chain_s=(2.0,)), "flat 1 without objects": a_run(1.5, chain_s=(0.4,))}
    chain = SettingResult(name=DEFAULT, knob="", value="", runs=runs, pd=(), contacts=density(0, None))
    plain = msgspec.structs.replace(chain, runs={name: a_run(1.0) for name in runs})
    found = {one.name: one for one in cost_targets(chain, plain, lines, Apart(worst_tile_s=0.4))}
    script = found["chain over plain script, flat, whole process"]
    assert (script.measured, script.met) == (3.0, False)
    assert script.profile == "detect 75%, other 25%"
    assert found["times real time, flat"].measured == 30.0
    empty = found["empty floor over busy floor: flat without objects over flat"]
    assert (empty.measured, empty.met, empty.profile) == (0.2, True, "")
    assert found["contacts per km², flat"].measured == 3000.0
    assert found["times real time, recorded line"].met is None
    assert found["worst drawn tile, s of a core for 30 s of track"].met is True
    assert [row[5] for row in target_rows(list(found.values()))].count("not measured") == 7


@pytest.mark.parametrize(("arguments", "words"), [(["--scenes", "moon"], "moon"), (["--knobs", "colour"], "colour")])
def test_what_is_not_there_is_refused(arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "chain", *arguments]) == 2
    assert words in capsys.readouterr().err


def test_without_kernels_the_bench_runs_numpy(tmp_path: Path) -> None:
    done = simulate(parse_scene(BRIGHT, "bright"), tmp_path / "sim")
    truth = parse_truth(json.loads(done.truth.read_bytes()), "bright")
    line = BenchMission("bright", "bright", "scene", done.log, Config(), truth)
    assert run_once(chain_settings()[0], line, tmp_path, environment=WITHOUT_KERNELS)["kernels"] == "numpy"
