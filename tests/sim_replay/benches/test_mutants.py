"""Damaged logs: what the bench does to them, and that it sees what is wrong with the results."""

from __future__ import annotations

import json
import os
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from auv_mcm.cli import main
from auv_mcm.errors import BadInputError, SelfCheckError
from auv_mcm.records import Ping
from auv_mcm.settings.config import Config
from sim_replay.benches import mutant_runs, mutants
from sim_replay.benches.mutant_seeds import Seed, write_seeds
from sim_replay.benches.mutant_traps import traps_of
from sim_replay.benches.mutants import Case, cases_of, judge_case, judge_mutant, kinds_of, table, wrong_results
from sim_replay.benches.mutations import CHANGES, FILE_HEADER_BYTES, JUMPS, mutated, split
from sim_replay.logs.open_log import FORMATS, find_format, open_log
from sim_replay.replay import replay
from tests.sim_replay.logs.xtf_logs import navigated, ping, written

SHORT = 70  # pings: a few more than the transfer is decided from


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("log") / "short.xtf", navigated(ping(number) for number in range(SHORT)))


def damaged(log: Path, *kinds: str, seed: int = 0) -> bytes:
    return mutated(split(log.read_bytes(), SHORT), kinds, np.random.default_rng(seed))


def test_a_log_taken_apart_is_the_same_put_together(log: Path) -> None:
    data = log.read_bytes()
    assert split(data, SHORT).joined() == data
    assert len(split(data, 5).packets) == 5


@pytest.mark.parametrize("kind", list(CHANGES))
def test_damage_is_the_same_for_the_same_seed_and_changes_something(kind: str, log: Path) -> None:
    assert damaged(log, kind, seed=3) == damaged(log, kind, seed=3)
    assert any(damaged(log, kind, seed=seed) != log.read_bytes() for seed in range(10))


@pytest.mark.parametrize("kind", list(CHANGES))
def test_a_log_without_pings_can_be_damaged_too(kind: str, log: Path) -> None:
    data = log.read_bytes()[:FILE_HEADER_BYTES]
    for seed in range(5):
        mutated(split(data, SHORT), (kind,), np.random.default_rng(seed))


def test_jumps_span_ten_metres_to_ninety_degrees(log: Path) -> None:
    before = np.frombuffer(
        b"".join(packet[160:176] for packet in split(log.read_bytes(), SHORT).packets), dtype="<f8"
    ).reshape(-1, 2)
    lengths = []
    for seed in range(60):
        data = damaged(log, "jump and back", seed=seed)
        after = np.frombuffer(b"".join(packet[160:176] for packet in split(data, SHORT).packets), dtype="<f8").reshape(
            -1, 2
        )
        moved = np.hypot(*(after - before).T)
        assert 1 <= np.count_nonzero(moved) <= SHORT
        lengths.append(moved.max())
    assert 10.0 / 111_321.0 <= min(lengths) < 1e-3
    assert 30.0 < max(lengths) <= 90.0


def test_three_hundred_mutants_hold_every_kind_and_jumps_in_half_of_them() -> None:
    chosen = [kinds_of(number) for number in range(300)]
    assert {kind for kinds in chosen for kind in kinds} == set(CHANGES)
    assert sum(bool(set(kinds) & set(JUMPS)) for kinds in chosen) >= 150


@pytest.mark.parametrize(
    "kinds", [("jump and back",), ("every n-th fix elsewhere",), ("scattered fixes", "flipped bits"), ("cut off",)]
)
def test_a_damaged_log_passes(kinds: tuple[str, ...], log: Path, tmp_path: Path) -> None:
    mutant = judge_mutant(0, log.name, kinds, damaged(log, *kinds, seed=1), tmp_path)
    assert mutant.failures == ()
    assert mutant.code == 0
    assert mutant.cpu_s > 0.0
    assert 30.0 < mutant.rss_mb < 400.0


def test_a_log_of_which_nothing_is_left_passes_with_code_3(log: Path, tmp_path: Path) -> None:
    assert judge_mutant(0, log.name, ("cut off",), log.read_bytes()[: FILE_HEADER_BYTES - 1], tmp_path).code == 3


def test_results_that_cannot_be_are_seen(log: Path, tmp_path: Path) -> None:
    replay([log], tmp_path, Config())
    assert wrong_results(tmp_path, log) == []
    summary, contacts = json.loads((tmp_path / "summary.json").read_text()), (tmp_path / "contacts.geojson").read_text()

    def with_contact(longitude: float, latitude: float, sigma_m: float) -> list[str]:
        feature = {
            "geometry": {"type": "Point", "coordinates": [longitude, latitude]},
            "properties": {"id": "C1", "sigma_m": sigma_m},
        }
        (tmp_path / "contacts.geojson").write_text(json.dumps({"features": [feature]}))
        return wrong_results(tmp_path, log)

    assert with_contact(5.5, 43.0, 1.0) == []
    assert "from every position" in with_contact(5.5, 43.1, 1.0)[0]
    assert with_contact(5.5, 43.1, 20_000.0) == [], "a sigma that says so"
    assert "lies at" in with_contact(5.5, 143.1, 1.0)[0]
    (tmp_path / "contacts.geojson").write_text(contacts.replace("[]", "[NaN]"))
    assert "NaN is not JSON" in wrong_results(tmp_path, log)[0]
    (tmp_path / "contacts.geojson").write_text(contacts)
    summary["counters"]["pipeline.coverage_failed"] = 2
    (tmp_path / "summary.json").write_text(json.dumps(summary))
    assert wrong_results(tmp_path, log) == ["pipeline.coverage_failed is 2"]


def test_the_command_names_what_failed_keeps_it_and_ends_with_5(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(mutants, "MAX_RSS_MB", 1.0)
    code = main(["bench", "mutants", str(log), "--mutants", "1", "--pings", "20", "--keep", str(tmp_path / "kept")])
    assert code == SelfCheckError.exit_code
    said = capsys.readouterr()
    assert "FAILED 0 of short.xtf" in said.out
    assert "1 of 1 damaged logs did not pass" in said.err
    assert (tmp_path / "kept" / "mutant-0.xtf").exists()


def test_a_log_that_is_a_pipe_or_missing_is_refused_without_waiting(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    os.mkfifo(tmp_path / "pipe.xtf")
    for name, said in (("pipe.xtf", "is not a regular file"), ("none.xtf", "No such file")):
        assert main(["bench", "mutants", str(tmp_path / name), "--mutants", "1"]) == BadInputError.exit_code
        assert said in capsys.readouterr().err


def test_the_table_has_a_line_per_kind_and_one_for_all() -> None:
    rows = [
        mutants.Mutant(n, "a.xtf", (kind,), code, 1.5 * n, 100.0, ())
        for n, (kind, code) in enumerate([("a", 0), ("b", 3), ("a", 0)])
    ]
    lines = table(rows)
    assert [line.split() for line in lines[1:]] == [
        ["a", "2", "2", "0", "0", "3.0", "100"],
        ["b", "1", "0", "1", "0", "1.5", "100"],
        ["all", "3", "2", "1", "0", "3.0", "100"],
    ]


# --- every format ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def seeds(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Seed]:
    return {seed.name: seed for seed in write_seeds(tmp_path_factory.mktemp("seeds"))}


def test_there_is_a_seed_of_every_format_that_is_read_and_of_all_that_people_write(seeds: dict[str, Seed]) -> None:
    read = {find_format(seed.folder / seed.file).name for seed in seeds.values() if seed.role in ("log", "image")}
    assert read == {row.name for row in FORMATS}
    assert {seed.role for seed in seeds.values()} >= {"sidecar", "track", "configuration", "scene", "mine list"}


def test_seeds_are_sound(seeds: dict[str, Seed]) -> None:
    for seed in seeds.values():
        if seed.role in ("log", "image"):
            assert any(isinstance(event, Ping) for event in open_log(seed.folder / seed.file, Config())), seed.name


def test_mutants_are_the_same_for_the_same_seed_and_every_trap_is_among_them(seeds: dict[str, Seed]) -> None:
    chosen = [seeds[name] for name in ("npy", "svlog", "sidecar", "scene")]
    first, again = (cases_of(chosen, 200, 5) for _ in range(2))
    assert [case.kinds for case in first] == [case.kinds for case in again]
    for seed in chosen:
        assert set(traps_of(seed)) <= {case.kinds[0] for case in first if case.seed is seed}


@pytest.mark.parametrize(
    ("name", "trap", "code"),
    [
        ("npy", "a sidecar that is a pipe", 3),
        ("HDF5", "pixels in /etc/passwd", 3),
        ("PNG, 8 bits", "a text of 2 GiB that is not there", 3),
        ("configuration", "half a surrogate pair as a key", 2),
        ("scene", "a pipe in its place", 2),
    ],
)
def test_a_trap_passes(name: str, trap: str, code: int, seeds: dict[str, Seed], tmp_path: Path) -> None:
    write, refused = traps_of(seeds[name])[trap]
    mutant = judge_case(Case(0, seeds[name], (trap,), write, refused), tmp_path / "run")
    assert (mutant.failures, mutant.code) == ((), code)


def test_what_must_be_refused_and_is_taken_fails_and_is_kept(seeds: dict[str, Seed], tmp_path: Path) -> None:
    sound = Case(7, seeds["npy"], ("none",), lambda path: None, refused=True)
    mutant = judge_case(sound, tmp_path / "run", tmp_path / "keep")
    assert (mutant.failures, mutant.code) == (("it was taken, and must be refused",), 0)
    assert (tmp_path / "keep" / "mutant-7" / "files" / "plain.npy").exists()


def wait_for_ever(arguments: list[str], folder: Path, console: Path, usage: Path) -> None:
    """Stand in for a command that waits for a pipe."""
    threading.Event().wait()


def test_a_run_that_waits_is_ended_and_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mutant_runs, "_run", wait_for_ever)
    monkeypatch.setattr(mutant_runs, "MAX_WALL_S", 0.5)
    ended = mutant_runs.run_command(("replay", "x"), tmp_path, tmp_path)
    assert ended.code is not None
    assert ended.code < 0
    assert "still waiting" in ended.failures((0, 3), 400.0)[0]


def test_runs_beside_each_other_have_their_own_exit_codes(tmp_path: Path) -> None:
    """One in eighty that another thread asked first was taken for a crash, of code 255."""
    folders = [tmp_path / str(number) for number in range(60)]
    for folder in folders:
        folder.mkdir()
    with ThreadPoolExecutor(6) as pool:
        ended = list(pool.map(lambda folder: mutant_runs.run_command(["--version"], folder, folder), folders))
    assert {one.code for one in ended} == {0}


def test_neither_logs_nor_all_is_bad_usage(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "mutants"]) == 2
    assert "name XTF logs to damage, or give --all" in capsys.readouterr().err


def test_all_is_run_from_the_command_line_some_at_a_time(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "mutants", "--all", "--mutants", "2", "--jobs", "2"]) == 0
    assert "code 2" in capsys.readouterr().out
