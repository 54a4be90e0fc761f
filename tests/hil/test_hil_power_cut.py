"""A power cut leaves what was synced; a session that was cut off is held against its undisturbed twin."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from auv_mcm.errors import UsageError
from sim_replay.hil.evidence import Restart
from sim_replay.hil.power_cut import cut_power, note_syncs
from sim_replay.hil.rules import Expectation, JoinedAsTwin
from sim_replay.hil.scenario import parse_scenario, read_scenario
from sim_replay.hil.verdict import Evidence, judge


def test_a_power_cut_leaves_what_was_synced_and_any_part_of_the_rest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "fsync", os.fsync)  # put back afterwards
    session, notes = tmp_path / "session", tmp_path / "synced.txt"
    recording, spool, whole = (session / name for name in ("recording/a.mcap", "state/events-1.bin", "summary.json"))
    for path in (recording, spool, whole):
        path.parent.mkdir(parents=True, exist_ok=True)
    note_syncs(notes)
    with recording.open("wb", buffering=0) as file:
        file.write(bytes(100))
        os.fsync(file.fileno())
    journal = b'{"event":1}\n'
    sizes = set()
    for seed in range(60):
        for path in (recording, spool, whole):
            path.write_bytes(bytes(150))
        (session / "contacts.jsonl").write_bytes(journal)
        os.truncate(recording, 150)
        n_gone = cut_power(session, notes, np.random.default_rng(seed))
        recorded, spooled = recording.stat().st_size, spool.stat().st_size
        assert 100 <= recorded <= 150
        assert n_gone >= 300 - recorded - spooled
        assert whole.stat().st_size == 150
        sizes |= {("recorded", recorded), ("spooled", spooled)}
    assert min(size for what, size in sizes if what == "spooled") < 20
    assert len(sizes) > 40


def test_the_verdict_names_what_differs_and_no_evidence_is_no_pass() -> None:
    asked = Expectation(test="one mission", expected=JoinedAsTwin())

    def passed(problems: tuple[str, ...] | None) -> tuple[bool, str]:
        evidence = Evidence(0, (), {}, {}, (), (), None, restarts=[Restart(1.0, 2.0)], not_joined=problems)
        verdict = judge(asked, evidence)
        return verdict.passed, verdict.found

    assert passed(()) == (True, "1 cuts: to the byte")
    assert passed(("events differ",)) == (False, "1 cuts: events differ")
    assert not passed(None)[0]


def test_power_cuts_need_restarts_and_a_mission_that_waits() -> None:
    read = read_scenario("cut_off")
    text = (read.folder / "cut_off.yaml").read_text("utf-8")
    for line in ("waits: true\n", text[text.index("restarts_s") : text.index("power_cut_every")]):
        with pytest.raises(UsageError, match="power_cut_every"):
            parse_scenario(text.replace(line, ""), "mine.yaml")
