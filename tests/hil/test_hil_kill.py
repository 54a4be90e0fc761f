"""The real service between fake devices, killed: its input and its announcements are on disk."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from auv_mcm.cli import main
from auv_mcm.errors import SelfCheckError
from sim_replay.benches import soak
from sim_replay.benches.soak import MAX_LOST_S, KillOutcome, killed
from sim_replay.benches.stops import MAX_STOP_S, StopOutcome
from sim_replay.hil.announced import not_in_journal

LINE = "contact C00012 updated: cylinder, p_mine 0.91, 43.0931026 5.8874099, 2 views"


def record(contact_id: str = "C00012", p_mine: float = 0.9123, longitude_deg: float = 5.88740988) -> bytes:
    """Write a line of contacts.jsonl."""
    feature = {
        "geometry": {"coordinates": [longitude_deg, 43.0931026]},
        "properties": {"id": contact_id, "class": "cylinder", "p_mine": p_mine},
    }
    return json.dumps({"time": "2026-01-01T00:00:00Z", "contact": feature}).encode() + b"\n"


def a_kill(lost_s: float = 0.4, n_pings: int = 100, n_holes: int = 0, missing: tuple[str, ...] = ()) -> KillOutcome:
    return KillOutcome(
        at_s=3.0,
        lost_s=lost_s,
        n_bytes=1,
        n_pings=n_pings,
        n_pings_reported=90,
        n_holes=n_holes,
        n_contacts=1,
        not_in_journal=missing,
    )


def test_a_killed_service_loses_a_second_of_its_recording_at_most_and_no_announced_contact(tmp_path: Path) -> None:
    kills = list(killed(2, seed=12, folder=tmp_path))
    assert [kill.problems for kill in kills] == [()] * 2
    assert all(kill.lost_s <= MAX_LOST_S for kill in kills)
    assert not any(kill.not_in_journal for kill in kills)
    assert all(kill.n_bytes for kill in kills)
    assert any(kill.n_contacts for kill in kills)


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


@pytest.mark.parametrize(
    ("kill", "words"),
    [
        (a_kill(lost_s=1.2), "last 1.20 s"),
        (a_kill(lost_s=float("nan")), "last nan s"),
        (a_kill(n_holes=2), "2 messages are missing"),
        (a_kill(n_pings=89), "90 were reported"),
        (a_kill(missing=(LINE,)), "not in contacts.jsonl: contact C00012"),
    ],
)
def test_losses_are_printed_and_set_the_exit_code(
    kill: KillOutcome, words: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(soak, "killed", lambda n_kills, seed, folder: iter([a_kill(), kill]))
    assert main(["bench", "soak", "--kills", "2"]) == SelfCheckError.exit_code
    assert words in capsys.readouterr().out


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({}, ""),
        ({"took_s": MAX_STOP_S + 0.1}, "the stop took 5.10 s"),
        ({"exit_code": 4}, "ended with 4"),
        ({"n_unkept": 3}, "3 pings are in the recording alone"),
        ({"not_in_journal": (LINE,)}, "not in contacts.jsonl: contact C00012"),
    ],
)
def test_a_stop_that_takes_long_or_leaves_something_out_sets_the_exit_code(
    changes: dict[str, Any], words: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    fine = StopOutcome(2.0, 0, 1.5, 0, 9, False, 200, 0, ())
    monkeypatch.setattr(soak, "stopped", lambda n_stops, seed, folder: iter([fine, fine._replace(**changes)]))
    assert main(["bench", "soak", "--stops", "2"]) == (SelfCheckError.exit_code if words else 0)
    assert words in capsys.readouterr().out
