"""Every verb answers in JSON alone where a script asks, or is excused by name; tables are plain off terminals."""

from __future__ import annotations

import argparse
import json
import re
from pathlib import Path

import pytest

from auv_mcm.cli import main
from auv_mcm.commands import Parser
from auv_mcm.commands.tables import show_table
from auv_mcm.shell.registry import COMMANDS, load
from sim_replay.verdicts import Place, Verdict, append_verdict, count_judged, evidence_words, read_verdicts
from tests.sim_replay.test_vector_layers import results as made_up_results

results = made_up_results

EXCUSED = {
    "view": "serves a page, whose interface is JSON",
    "run": "announces contacts as they come, and writes contacts.jsonl",
    "config": "--schema is JSON, --write is the configuration itself",
    "calibrate": "its answer is the file of JSON that --out or --write names",
    "bench": "its benches have --json PATH, each for itself",
}


@pytest.mark.parametrize("name", COMMANDS)
def test_every_verb_has_json_or_is_excused(name: str) -> None:
    commands = Parser().add_subparsers()
    load(COMMANDS[name])(commands)
    options = commands.choices[name]._option_string_actions
    assert ("--json" in options) != (name in EXCUSED)
    if name not in EXCUSED:
        assert isinstance(options["--json"], argparse.Action)
        assert "JSON" in (options["--json"].help or "")


@pytest.mark.parametrize(
    ("words", "key"),
    [
        (["export", "RESULTS", "--gpkg", "OUT/m.gpkg", "--geojson", "OUT/m.geojson"], "written"),
        (["verdicts", "RESULTS"], "missions"),
        (["simulate", "--list"], "scenes"),
        (["hil", "--list"], "scenarios"),
    ],
)
def test_standard_output_holds_json_alone(
    words: list[str], key: str, results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    places = {"RESULTS": str(results), "OUT": str(tmp_path)}
    named = ["/".join(places.get(part, part) for part in word.split("/")) for word in words]
    assert main([*named, "--json"]) == 0
    assert key in json.loads(capsys.readouterr().out)


def test_an_error_leaves_standard_output_empty(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["verdicts", str(tmp_path / "none"), "--json"]) == 2
    out, err = capsys.readouterr()
    assert not out
    assert "there is no folder" in err


def test_a_table_off_a_terminal_is_plain_columns(capsys: pytest.CaptureFixture[str]) -> None:
    show_table("title\x1b", ("a", "bb"), [("long", "1"), ("b", "\x1b[2J")], {"b": "red"})
    assert capsys.readouterr().out == "title\\x1b\n  a     bb\n  long  1\n  b     \\x1b[2J\n"
    show_table("", (), [])
    assert not capsys.readouterr().out


@pytest.mark.parametrize(("no_color", "coloured"), [({}, True), ({"NO_COLOR": "1"}, False)])
def test_a_table_on_a_terminal_is_drawn_by_rich(
    no_color: dict[str, str], coloured: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("rich")
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    monkeypatch.delenv("NO_COLOR", raising=False)
    for name, value in (no_color | {"TERM": "xterm-256color", "COLUMNS": "60"}).items():
        monkeypatch.setenv(name, value)
    show_table("", ("what", "found"), [("FAILED", "word " * 30)], {"FAILED": "red"})
    out = capsys.readouterr().out
    assert ("\x1b[31m" in out or "\x1b[1;31m" in out) is coloured
    plain = re.sub("\x1b.*?m", "", out)
    assert max(map(len, plain.splitlines())) <= 60, "fitted to the terminal"


def test_how_far_verdicts_are_from_correcting_the_odds(tmp_path: Path) -> None:
    places = []
    for number, call in enumerate(["mine_like"] * 4 + ["not_mine_like"] * 2 + ["undecided"], 1):
        at = {"object": f"V{number:04d}", "time": "2026-01-01T00:00:00Z", "by": "kim", "latitude_deg": 0.001 * number}
        append_verdict(tmp_path, Verdict(**at, longitude_deg=2.0, call=call, drawn=number in (1, 2)))  # type: ignore[arg-type]
        places += [Place(f"C{number:05d}", 0.001 * number, 2.0)] if number in (1, 3, 5, 7) else []
    judged = count_judged(read_verdicts(tmp_path), places)
    assert judged == (2, 1, 1, 2, 1), "only contacts have odds, also one that was drawn before a replay found it"
    assert "1 of 3 missions judged, 2 of 20 mine-like, 1 of 40 not mine-like" in evidence_words([judged])
    assert evidence_words([judged._replace(mine_like=7, not_mine_like=14)] * 3).startswith("enough to correct")
