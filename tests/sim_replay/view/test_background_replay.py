"""A log is shown at once, and replayed meanwhile into a folder of its own."""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace as replaced

from auv_mcm.errors import BadInputError, UsageError
from auv_mcm.records import Ping
from auv_mcm.settings.config import Config, parse_config
from sim_replay.logs.xtf_writer import write_xtf
from sim_replay.replay import replay
from sim_replay.simulator.mission import Mission
from sim_replay.view.mission import ShownMission
from sim_replay.view.mission_feed import open_logs
from sim_replay.view.show import is_shown, logs_named, open_new, open_shown, show
from tests.sim_replay.test_replay import content, scene


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("logs") / "line.xtf"
    write_xtf(path, Mission(scene(1_700_000_000.0, 0.0)).events())
    return path


def ended(mission: ShownMission) -> ShownMission:
    """The mission after its waterfall and its replay are done."""
    mission.feed.join()
    if mission.replay is not None:
        mission.replay.start()
        mission.replay.join()
    mission.refresh()
    return mission


def test_the_waterfall_comes_before_the_contacts_and_they_are_those_of_a_replay(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    mission = open_new([log], None, "kim")
    mission.feed.join()
    early = mission.state()
    assert (early["name"], early["done"], early["replay"], early["replay_done"]) == ("line", True, 0.0, False)
    assert early["stop_row"] > 0
    state = ended(mission).state()
    assert (state["replay"], state["replay_done"], state["replay_problem"]) == (1.0, True, "")
    folder = tmp_path / "line-results"
    replay([log], tmp_path / "apart", Config())
    assert content(folder) == content(tmp_path / "apart")
    assert not (folder / "contacts.jsonl").exists()
    assert len(mission.contacts()["id"]) == len(json.loads((folder / "contacts.geojson").read_bytes())["features"]) > 0
    # the second time everything is there at once
    assert open_new([log], None, "kim").replay is None
    assert is_shown(folder)


def test_sigterm_ends_page_and_replay_as_ctrl_c_does(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("webbrowser.open", lambda url: os.kill(os.getpid(), signal.SIGTERM))
    assert show([log], logs=[], open_browser=True) == 0
    assert "closed\nthe replay is not finished" in capsys.readouterr().out
    assert multiprocessing.active_children() == []


def test_what_stops_a_replay_is_said_on_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty.xtf").write_bytes(b"")
    mission = ended(open_new([tmp_path / "empty.xtf"], None, "kim"))
    state = mission.state()
    assert "empty.xtf" in state["replay_problem"]
    assert "empty.xtf" in state["problem"]
    assert state["replay_done"]


def test_a_log_that_cannot_be_read_is_named_and_the_others_are_shown(
    log: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "empty.xtf").write_bytes(b"")
    opened = open_logs([log, tmp_path / "empty.xtf"], Config())
    assert opened.recorded is not None
    assert len(opened.recorded.logs) == 1
    assert "empty.xtf" in caplog.text


def test_a_folder_stands_for_the_logs_below_it(log: Path, tmp_path: Path) -> None:
    for name in ("b/two.xtf", "a/one.xtf"):
        (tmp_path / name).parent.mkdir()
        (tmp_path / name).write_bytes(log.read_bytes())
    assert logs_named([tmp_path]) == [tmp_path / "a" / "one.xtf", tmp_path / "b" / "two.xtf"]
    assert logs_named([log, tmp_path / "a"]) == [log, tmp_path / "a" / "one.xtf"]
    with pytest.raises(UsageError, match="there is no"):
        logs_named([tmp_path / "c"])
    (tmp_path / "nothing").mkdir()
    with pytest.raises(BadInputError, match="neither results nor a session nor a log"):
        logs_named([tmp_path / "nothing"])


def test_a_log_is_not_waited_for_as_a_session(log: Path, tmp_path: Path) -> None:
    for paths in ([log], [tmp_path / "one", tmp_path / "two"]):
        with pytest.raises(UsageError, match="--live follows one session"):
            show(paths, live=True, logs=[])


def test_a_corrected_bottom_line_is_kept_beside_its_log_and_shown_again(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    logs = [tmp_path / "one.xtf", tmp_path / "two.xtf"]
    write_xtf(logs[1], Mission(scene(1_700_000_100.0, 40.0)).events())
    logs[0].write_bytes(log.read_bytes())
    monkeypatch.chdir(tmp_path)
    mission = open_new(logs, None, "kim")
    mission.feed.join()
    stop = mission.state()["stop_row"]
    first, last = ([(row, 3.0), (row + 40.0, 3.5)] for row in (20.0, stop - 60.0))
    assert mission.correct_bottom([first, last]) == [logs[0].with_name(f"{one.name}.bottom-line.json") for one in logs]
    shown = mission.bottom()["stretches"]
    assert np.array(shown) == pytest.approx(np.array([first, last]), abs=0.6)  # a row stands for its ping
    again = open_new(logs, None, "kim")
    again.feed.join()
    rows = np.array(again.bottom()["row"])
    inside = (rows > 22.0) & (rows < 58.0)
    now_m, before_m = (np.array(one.bottom()["first_return"])[inside] for one in (again, mission))
    assert now_m == pytest.approx(np.interp(rows[inside], [20.0, 60.0], [3.0, 3.5]), abs=0.05)
    assert (before_m > 4.0).all()
    for refused in ([first[:1]], [[first[0], last[0]]], [[(-5.0, 3.0), first[0]]], [[(20.0, -1.0), (60.0, 3.0)]]):
        with pytest.raises(UsageError, match=r"stretch|bottom line"):
            mission.correct_bottom(refused)
    assert mission.correct_bottom([first]) == mission.correct_bottom([first, last])
    assert mission.correct_bottom([])
    assert not list(tmp_path.glob("*bottom-line.json"))
    for one in (mission, again):
        one.feed.close()


def test_a_bottom_line_is_not_kept_for_one_of_two_logs_of_the_same_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    logs = [tmp_path / "port.xtf", tmp_path / "starboard.xtf"]
    for path, other in zip(logs, ("starboard", "port"), strict=True):
        events = Mission(scene(1_700_000_000.0, 0.0)).events()
        write_xtf(path, (replaced(one, **{other: None}) if isinstance(one, Ping) else one for one in events))
    mission = open_new(logs, None, "kim")
    mission.feed.join()
    stop = mission.state()["stop_row"]
    with pytest.raises(UsageError, match="lies in several logs"):
        mission.correct_bottom([[(stop - 60.0, 3.0), (stop - 20.0, 3.5)]])
    mission.feed.close()


def test_results_replayed_again_from_the_page_keep_their_waterfall_and_the_last_configuration(
    log: Path, tmp_path: Path
) -> None:
    replay([log], tmp_path, Config())
    mission = open_shown(tmp_path, [], None, "kim")
    mission.feed.join()
    pings = mission.state()["pings"]
    replay([log], tmp_path, parse_config("contacts: {min_p_mine: 0.005}", "later"))  # meanwhile, elsewhere
    mission.refresh()
    mission.replay_again()
    assert mission.replay is not None
    mission.replay.join()
    mission.feed.join()
    mission.refresh()
    state = mission.state()
    assert (state["problem"], state["pings"], state["replay_done"], state["generation"]) == ("", pings, True, 2)
    summary = json.loads((tmp_path / "summary.json").read_bytes())
    assert summary["config"]["contacts"]["min_p_mine"] == 0.005
    mission.feed.close()
