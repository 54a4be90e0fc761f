"""Check what a soak makes of a run: every counter and byte has a reason or is named, what has grown or was left behind
is named, and what died is reported with its cause."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from auv_mcm.cli import main
from auv_mcm.errors import SelfCheckError
from sim_replay.benches import soak
from sim_replay.benches.long_mission import (
    Account,
    accounts,
    found_dead,
    left_in_session,
    print_counters,
    settled,
    slope_of,
)
from sim_replay.benches.restarts import Cut, Session
from sim_replay.hil.evidence import Line, Report, Restart
from sim_replay.hil.verdict import Evidence

HEALTH = (
    "2026-01-01T00:00:05.000Z INFO health pings=9 queue=0/512 in_flight=0 dropped=0 contacts=1 clutter=2 lag_ms=0.1 "
    "ports=sonar:{}"
)


def evidence(lines: list[str], counters: dict[str, int], device: dict[str, int], exit_code: int = 0) -> Evidence:
    return Evidence(
        exit_code=exit_code,
        lines=[Line(0.0, line) for line in lines],
        reports={"sonar": [Report(0.0, "counters", device)]},
        summary={"counters": counters},
        contacts=(),
        targets=(),
        replayed=None,
    )


def test_a_counter_without_a_reason_is_named() -> None:
    run = evidence([], {"ping.received": 9, "nav.surprise": 2}, {})
    assert print_counters(run) == ["nav.surprise 2"]


def test_damage_is_explained_by_bytes_that_the_line_lost_and_by_nothing_else(
    capsys: pytest.CaptureFixture[str],
) -> None:
    damaged = {"port.sonar.ping_protocol.refused.checksum": 1, "port.sonar.ping_protocol.bytes_skipped": 800}
    assert len(print_counters(evidence([], damaged, {"port.overrun": 0}))) == 2
    assert print_counters(evidence([], damaged, {"port.overrun": 300})) == []
    assert "300  bytes that the line of the fake device 'sonar' lost" in capsys.readouterr().out


def test_a_run_that_lived_has_nothing_dead() -> None:
    assert found_dead(evidence([HEALTH.format("up")], {}, {})) == []


def test_what_died_is_reported_with_its_cause() -> None:
    raised = [
        "Traceback (most recent call last):",
        '  File "a.py", line 1, in f',
        "    1 / 0",
        "ZeroDivisionError: division by zero",
    ]
    dead = found_dead(evidence([HEALTH.format("down"), *raised], {}, {}, exit_code=4))
    assert dead == [
        "the service ended with 4",
        'ZeroDivisionError: division by zero (File "a.py", line 1, in f)',
        "at the end these ports were not up: sonar:down",
    ]


def test_a_growth_is_found_within_levels_that_differ_and_its_interval_holds_it() -> None:
    random = np.random.default_rng(3)
    starts = np.repeat([1, 2, 3], 40)
    at_h = np.tile(np.linspace(0.0, 2.0, 40), 3)
    values = 5.0 * at_h + np.array([100.0, 60.0, 80.0])[starts - 1] + random.normal(0.0, 1.0, 120)
    slope = slope_of(at_h, values, starts)
    assert abs(slope.middle - 5.0) <= slope.half <= 0.5
    assert slope_of(at_h, values, np.zeros(120, dtype=int)).half > 3.0


def test_what_is_sent_and_not_had_needs_a_reason(capsys: pytest.CaptureFixture[str]) -> None:
    fine = [Account("bytes", 100, 100), Account("pings", 100, 95, 5, "it was down")]
    assert settled(fine) == []
    assert "pings: 100, 95; 5 lost (5 may be: it was down)" in capsys.readouterr().out
    assert settled([Account("bytes", 100, 99), Account("pings", 95, 100, 5)]) == [
        "bytes: 1 lost, 0 may be",
        "pings: -5 lost, 5 may be",
    ]


@pytest.mark.parametrize(("n_restarts", "n_open"), [(0, 1), (1, 0)])
def test_pings_may_be_missing_only_where_the_service_was_down(n_restarts: int, n_open: int, tmp_path: Path) -> None:
    counters = {"ping.received": 70, "service.ping_dropped": 10}
    run = evidence([], counters, {"device.events": 100})._replace(
        stopped_s=100.0, restarts=[Restart(50.0, 69.0)] * n_restarts
    )
    run.summary["pings"] = 70  # type: ignore[index]
    found = [account for account in accounts(run, tmp_path) if account.what.startswith("pings: sent")]
    assert [account.lost for account in found] == [20]
    assert sum(not account.is_settled for account in found) == n_open


def test_a_file_without_a_reason_is_named(tmp_path: Path) -> None:
    (tmp_path / "snippets").mkdir()
    (tmp_path / "contacts.jsonl").write_text('{"contact": {"properties": {"id": "C00001"}}}\n')
    (tmp_path / "contacts.geojson").write_text('{"features": [{"properties": {"id": "C00001"}}]}')
    assert left_in_session(tmp_path) == []
    (tmp_path / "state").mkdir()
    (tmp_path / "state" / ".torn.new").touch()
    (tmp_path / "contacts.geojson").write_text('{"features": [{"properties": {"id": "C00002"}}]}')
    assert left_in_session(tmp_path) == [
        "a file of the session has no reason: state/.torn.new",
        "contacts of the results are not in the journal: C00002",
    ]


@pytest.mark.parametrize("problem", ["", "contacts.geojson differs"])
def test_sessions_that_were_cut_off_are_summed_up_by_way(
    problem: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def cut_off(mission: Path, n_events: int, n_cuts: int, seed: int, folder: Path) -> Session:
        cuts = [Cut("all", 100, 1.5 + seed, 3, 0.02), Cut("hang", 200, float("nan"), 0, 0.0)]
        return Session(cuts, 12, (problem,) if problem and seed == 8 else ())

    monkeypatch.setattr(soak, "simulate_mission", lambda folder, duration_s, vehicle_mps: (folder / "log", 200.0))
    monkeypatch.setattr(soak, "keep_mission", lambda log, folder: 6000)
    monkeypatch.setattr(soak, "cut_off", cut_off)
    exit_code = main(["bench", "soak", "--restarts", "40", "--seed", "7"])
    out = capsys.readouterr().out
    assert exit_code == (SelfCheckError.exit_code if problem else 0)
    assert [line.split() for line in out.splitlines() if line.startswith(("all", "hang"))] == [
        ["all", "2", "9.00", "9.50", "3", "0.02"],
        ["hang", "2", "nan", "nan", "0", "0.00"],
    ]
    assert (problem in out) if problem else ("session 2 of 2: 2 cuts, 12 contacts, as undisturbed" in out)
