"""The real service between fake devices, killed and stopped: its input and its announcements are on disk."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec import structs

from sim_replay.hil.announced import not_in_journal
from sim_replay.hil.evidence import Restart
from sim_replay.hil.resources import Sample, sampled, slope_of, steady
from sim_replay.hil.rules import EndsWithin, ExitCode, Expectation, JoinedAsTwin, Restarted, Rule
from sim_replay.hil.run import run_scenario
from sim_replay.hil.scenario import read_scenario
from sim_replay.hil.verdict import Evidence, judge

LINE = "contact C00012 updated: cylinder, p_mine 0.91, 43.0931026 5.8874099, 2 views"


def record(contact_id: str = "C00012", p_mine: float = 0.9123, longitude_deg: float = 5.88740988) -> bytes:
    """Write a line of contacts.jsonl."""
    feature = {
        "geometry": {"coordinates": [longitude_deg, 43.0931026]},
        "properties": {"id": contact_id, "class": "cylinder", "p_mine": p_mine},
    }
    return json.dumps({"time": "2026-01-01T00:00:00Z", "contact": feature}).encode() + b"\n"


def test_a_killed_service_is_ready_soon_and_loses_a_second_of_its_recording_at_most(tmp_path: Path) -> None:
    """Killed twice on the way, once by a power cut; the session replayed as one is its undisturbed twin."""
    read = read_scenario("cut_off")
    rules = (Restarted(ready_within_s=60.0), JoinedAsTwin(), ExitCode())
    short = structs.replace(
        read.scenario,
        run_s=60.0,  # so that a busy computer comes to the end of the mission, whose 15 s wait for it
        restarts_s=(3.0, 7.0),
        power_cut_every=2,
        expectations=tuple(Expectation(test=type(rule).__name__, expected=rule) for rule in rules),
    )
    evidence = run_scenario(read._replace(scenario=short), tmp_path, lambda line: None)
    assert [verdict for verdict in (judge(each, evidence) for each in short.expectations) if not verdict.passed] == []
    assert len(evidence.restarts) == 2


def test_an_announced_contact_is_looked_for_with_its_figures() -> None:
    console = ["notice port_up: port 'nav' is up", LINE]
    assert not_in_journal(console, record("C00001") + record()) == ()
    assert not_in_journal(console, b"") == (LINE,)
    assert not_in_journal(console, record("C00001")) == (LINE,)
    assert not_in_journal(console, record(p_mine=0.93)) == (LINE,)
    assert not_in_journal(console, record(longitude_deg=5.88741)) == ()
    assert not_in_journal(console, record(longitude_deg=5.8875)) == (LINE,)


def test_a_line_of_the_journal_that_was_cut_off_holds_nothing() -> None:
    assert not_in_journal([LINE], record("C00001") + record()[:-1]) == (LINE,)
    assert not_in_journal([LINE], record() + record("C00001")[:30]) == ()


def ended(stopped_s: float | None = 10.0, **found: Any) -> Evidence:
    return Evidence(0, (), {}, {}, (), (), None, stopped_s=stopped_s)._replace(**found)


@pytest.mark.parametrize(
    ("rule", "evidence", "passed", "words"),
    [
        (EndsWithin(within_s=5.0), ended(ended_s=14.0), True, "after 4.00 s"),
        (EndsWithin(within_s=5.0), ended(ended_s=15.1), False, "after 5.10 s"),
        (EndsWithin(within_s=5.0), ended(stopped_s=None, ended_s=11.0), False, "nan s"),
        (Restarted(ready_within_s=3.0), ended(), False, "not started again"),
        (Restarted(ready_within_s=3.0), ended(restarts=[Restart(1.0, 2.5)], lost_s=[0.4]), True, "1.50 s, 0.40 s"),
        (Restarted(ready_within_s=1.0), ended(restarts=[Restart(1.0, 2.5)], lost_s=[0.4]), False, "1.50 s"),
        (Restarted(ready_within_s=3.0), ended(restarts=[Restart(1.0, 2.5)], lost_s=[1.2]), False, "1.20 s lost"),
        (Restarted(ready_within_s=3.0), ended(restarts=[Restart(1.0, 2.5)]), False, "inf s lost"),
    ],
)
def test_a_stop_or_a_start_that_takes_long_and_a_loss_are_found(
    rule: Rule, evidence: Evidence, passed: bool, words: str
) -> None:
    verdict = judge(Expectation(test="it", expected=rule), evidence)
    assert verdict.passed == passed
    assert words in verdict.found


@pytest.mark.parametrize(("grows_mb", "passed"), [(0.0, True), (300.0, False)])
def test_memory_that_grows_within_starts_is_found_whatever_their_levels(grows_mb: float, passed: bool) -> None:
    random = np.random.default_rng(3)
    levels_mb = (
        np.repeat([100.0, 60.0, 80.0], 60) + grows_mb * (np.arange(180) % 60) / 60 + random.normal(0.0, 1.0, 180)
    )
    samples = [
        Sample(0.5 * k, 1 + k // 60, round(1e6 * level_mb), 90_000_000, 20, 9) for k, level_mb in enumerate(levels_mb)
    ]
    _, found, is_steady = steady(0.1, samples)
    assert is_steady == passed
    assert "open files of perception +0.00 ± 0.00 an hour" in found
    assert not steady(0.1, samples[:10])[2]


def test_a_growth_is_found_within_levels_that_differ_and_its_interval_holds_it() -> None:
    random = np.random.default_rng(3)
    starts = np.repeat([1, 2, 3], 40)
    at_h = np.tile(np.linspace(0.0, 2.0, 40), 3)
    values = 5.0 * at_h + np.array([100.0, 60.0, 80.0])[starts - 1] + random.normal(0.0, 1.0, 120)
    slope = slope_of(at_h, values, starts)
    assert abs(slope.middle - 5.0) <= slope.half <= 0.5
    assert slope_of(at_h, values, np.zeros(120, dtype=int)).half > 3.0


def test_the_processes_of_a_service_are_looked_at_while_they_live() -> None:
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as child:
        found = sampled(os.getpid(), 3, 1.5)
        assert found is not None
        assert (found.start, found.at_s) == (3, 1.5)
        assert min(found.service_bytes, found.perception_bytes, found.service_files, found.perception_files) > 0
        assert sampled(child.pid, 1, 0.0) is None, "it has no perception"
