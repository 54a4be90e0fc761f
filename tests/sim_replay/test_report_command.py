"""Reports of sessions: made from what was recorded so far, beside the session's own files."""

from __future__ import annotations

from pathlib import Path

import pytest
from msgspec import structs

from auv_mcm.cli import main
from drivers.recording.session_layout import file_name
from sim_replay.logs.session_parts import recordings_of
from sim_replay.verdicts import VERDICTS_FILE, Verdict, append_verdict
from sim_replay.wire_logs import write_session
from tests.sim_replay.logs.sonar_logs import run_of


def test_a_session_that_still_runs_has_a_report_and_keeps_its_files(tmp_path: Path) -> None:
    session = tmp_path / "session-1"
    session.mkdir()
    (session / "contacts.jsonl").write_bytes(b"{}\n")
    recording = write_session(run_of("jsf"), session / "recording")
    whole = (recording / file_name(0)).read_bytes()
    (recording / file_name(0)).write_bytes(whole[: len(whole) * 3 // 4])  # the last chunk is being written
    one = Verdict(
        object="V0001", time="2026-05-04T10:00:00Z", by="kim", latitude_deg=0.0, longitude_deg=0.0, drawn=True
    )
    append_verdict(session, one)
    assert main(["report", str(session)]) == 0
    assert {path.name for path in session.iterdir()} == {"contacts.jsonl", "recording", "report", VERDICTS_FILE}
    assert "V0001" in (session / "report" / "report.html").read_text(encoding="utf-8")
    assert {"report.html", "one-page.html", "contacts.geojson"} <= {
        path.name for path in (session / "report").iterdir()
    }


def test_recordings_are_taken_in_the_order_of_the_starts(tmp_path: Path) -> None:
    for name in ("recording-10", "recording", "recording-2", "recordings", "recording-old"):
        (tmp_path / name).mkdir()
    assert [path.name for path in recordings_of(tmp_path)] == ["recording", "recording-2", "recording-10"]


def test_what_is_no_session_says_what_to_do(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", str(tmp_path / "mission.xtf")]) == 2
    assert "mission.xtf --out results' makes the report" in capsys.readouterr().err


def test_the_recordings_of_a_session_that_was_gone_on_with_have_one_report(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    session = tmp_path / "session-1"
    session.mkdir()
    for name in ("recording", "recording-2"):
        write_session(run_of("jsf"), session / name)
    assert main(["report", str(session)]) == 0
    assert int(capsys.readouterr().out.split()[0]) == 2 * 212, "the pings of both"
    assert sorted(path.name for path in session.iterdir()) == ["recording", "recording-2", "report"]
    (session / "recording-2").rename(session / "recording-3")
    assert main(["report", str(session)]) == 0
    assert "notice: recording-2 of" in capsys.readouterr().out


def test_the_report_of_results_is_drawn_again_with_the_verdicts_of_now(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    results = tmp_path / "results"
    session = write_session(run_of("jsf"), tmp_path / "session-1" / "recording")
    assert main(["replay", str(session), "--out", str(results)]) == 0
    before = (results / "report.html").read_bytes()
    assert main(["report", str(results)]) == 0
    assert (results / "report.html").read_bytes() == before, "nobody judged"
    one = Verdict(
        object="V0001", time="2026-05-04T10:00:00Z", by="kim", latitude_deg=0.0, longitude_deg=0.0, drawn=True
    )
    append_verdict(results, structs.replace(one, call="not_mine_like"))
    append_verdict(results, one)  # a second thought about the same object
    capsys.readouterr()
    assert main(["report", str(results)]) == 0
    assert capsys.readouterr().out.startswith("1 verdicts: ")
    assert "V0001" in (results / "report.html").read_text(encoding="utf-8")
    assert "judged by kim" in (results / "one-page.html").read_text(encoding="utf-8")
    (results / "report-contents.bin").write_bytes(b"damaged")
    assert main(["report", str(results)]) == 3
    assert "Replay the log again" in capsys.readouterr().err
