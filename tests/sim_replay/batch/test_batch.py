"""An archive of small simulated logs, some damaged: interrupted, killed, on a cluster, and the index of it."""

from __future__ import annotations

import html.parser
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from threading import Thread
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from auv_mcm.cli import main
from auv_mcm.errors import BadInputError, HardwareError, UsageError
from auv_mcm.program import program
from auv_mcm.settings.config import Config, ConfirmConfig, ContactsConfig
from sim_replay.batch import missions as batch_missions
from sim_replay.batch.index import write_index
from sim_replay.batch.missions import MISSIONS, MissionOutcome, MissionTask, locked, replay_missions
from sim_replay.fitting.cascade.farm import Farm
from sim_replay.logs.archive import ArchivedLog, logs_of
from sim_replay.logs.xtf_writer import write_xtf
from sim_replay.replay import replay
from sim_replay.results_folder import is_replayed, kept_alone
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.scene import Lawnmower, Scene, SceneObject, Sonar, Track
from tests.dask_cluster import dask_cluster
from tests.make.records import patch_of
from tests.make.results import write_results

SPHERE = SceneObject(kind="sphere", leg=0, along_m=6.0, across_m=10.0)
CYLINDER = SceneObject(
    kind="cylinder", leg=0, along_m=11.0, across_m=-12.0, azimuth_deg=10.0, length_m=1.8, width_m=0.5
)
DAYS = {"day1/a.xtf": (SPHERE,), "day2/b <i>.xtf": (SPHERE, CYLINDER), "day3/c.xtf": (CYLINDER,)}


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three days over the same ground: a cylinder appears and a sphere goes. Two logs are damaged."""
    folder = tmp_path_factory.mktemp("archive")
    for day, (name, objects) in enumerate(DAYS.items()):
        scene = Scene(
            seed=day + 1,
            sonar=Sonar(range_m=30.0, ping_rate_hz=15.0, beam_lines=3),
            track=Track(plan=Lawnmower(n_legs=1, leg_m=16.0), altitude_m=5.0, start_time_s=1.7e9 + 86_400.0 * day),
            objects=objects,
        )
        (folder / name).parent.mkdir()
        write_xtf(folder / name, Mission(scene).events())
    (folder / "day1" / "cut.xtf").write_bytes((folder / "day1" / "a.xtf").read_bytes()[:5000])
    (folder / "day3" / "not-a-log.jsf").write_bytes(b"nonsense" * 100)
    return folder


@pytest.fixture(scope="module")
def undisturbed(archive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("undisturbed")
    assert main(["batch", str(archive), "--out", str(out)]) == BadInputError.exit_code
    return out


def content(out: Path) -> dict[str, bytes]:
    """Every file but those with the time that the replay took."""
    return {
        str(path.relative_to(out)): path.read_bytes()
        for path in sorted(out.rglob("*"))
        if path.is_file() and path.name not in ("summary.json", "report.html", "report-contents.bin", ".lock")
    }


def tasks_of(archive: Path, out: Path) -> list[MissionTask]:
    return [MissionTask(log, out / MISSIONS / log.name, None) for log in logs_of(archive, out)]


def features(out: Path, kind: str) -> list[dict[str, Any]]:
    found = json.loads((out / "index.geojson").read_bytes())["features"]
    return [one["properties"] for one in found if one["properties"]["kind"] == kind]


def test_what_a_killed_run_left_at_work_is_waited_for(archive: Path, tmp_path: Path) -> None:
    task = tasks_of(archive, tmp_path)[0]
    outcomes: list[MissionOutcome] = []
    task.folder.mkdir(parents=True)
    with kept_alone(task.folder):
        run = Thread(target=lambda: outcomes.append(batch_missions.replay_mission(task)))
        run.start()
        run.join(1.0)  # where it does not wait, it has failed by then
    run.join()
    assert [outcome.failure for outcome in outcomes] == [""]


def test_a_log_has_the_bytes_of_a_replay_by_itself(archive: Path, undisturbed: Path, tmp_path: Path) -> None:
    name = "day2/b <i>.xtf"  # a day is enough: each is replayed by itself in a process of its own
    replay([archive / name], tmp_path, Config())
    own = content(tmp_path)
    assert own == content(undisturbed / MISSIONS / name)
    assert "contacts.geojson" in own


def test_the_index_says_what_is_new_gone_and_seen_again_and_why_a_log_failed(undisturbed: Path) -> None:
    called = {one["class"]: one for one in features(undisturbed, "object") if one["called"]}
    assert called["sphere"]["change"] == "gone"
    assert [one["mission"] for one in called["sphere"]["history"]] == list(DAYS)
    assert called["sphere"]["history"][-1]["contact"] is None
    assert called["cylinder"]["change"] == "seen again"
    missions = {one["name"]: one["failure"] for one in features(undisturbed, "mission")}
    assert [name for name, failure in missions.items() if failure is None] == list(DAYS)
    assert "no usable side-scan ping" in missions["day1/cut.xtf"]
    assert "is not a readable log" in missions["day3/not-a-log.jsf"]


def test_a_copy_of_a_log_sees_no_object_again(undisturbed: Path, tmp_path: Path) -> None:
    outcomes = [MissionOutcome(ArchivedLog(tmp_path, name), undisturbed / MISSIONS / "day2/b <i>.xtf") for name in "ab"]
    objects = write_index(tmp_path, outcomes, ContactsConfig())
    assert objects
    assert {one.change for one in objects} == {"seen once"}
    assert [one["repeats"] for one in features(tmp_path, "mission")] == [None, "a"]
    assert "the same pings as a" in (tmp_path / "index.html").read_text("utf-8")


def test_the_page_links_to_every_report_and_shows_names_as_they_are(undisturbed: Path) -> None:
    links: list[str] = []

    class Links(html.parser.HTMLParser):
        def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
            links.extend(value for name, value in attrs if tag == "a" and name == "href" and value)

    page = (undisturbed / "index.html").read_text("utf-8")
    Links().feed(page)
    assert f"{MISSIONS}/day2/b%20%3Ci%3E.xtf/report.html" in links
    assert "b &lt;i&gt;.xtf" in page
    assert "<i>" not in page


def test_an_archive_at_the_antimeridian_and_of_names_that_are_no_text_is_indexed(tmp_path: Path) -> None:
    outcomes = []
    for number, (west, east) in enumerate([(179.999, 180.001), (-180.003, -180.002)]):
        log = ArchivedLog(tmp_path, os.fsdecode(b"\xe9%d.xtf" % number))
        ring = np.array([(west, -17.0), (east, -17.0), (east, -16.999), (west, -17.0)])
        patch = patch_of(rings_deg=(ring,), covered_m2=1.0)
        (folder := tmp_path / MISSIONS / log.name).mkdir(parents=True)
        write_results(folder, [], [patch], [], "")
        figures = {"pings": 1, "covered_km2": 0.1, "contacts": 0, "contacts_called": 0}
        (folder / "summary.json").write_text(json.dumps(figures))
        outcomes.append(MissionOutcome(log, folder))
    write_index(tmp_path, outcomes, ContactsConfig())
    across, west = json.loads((tmp_path / "index.geojson").read_bytes())["features"]
    longitudes = [[point[0] for point in part[0]] for part in across["geometry"]["coordinates"]]
    assert sorted((min(part), max(part)) for part in longitudes) == [(-180.0, -179.999), (179.999, 180.0)]
    assert [point[0] for point in west["geometry"]["coordinates"][0]].count(179.998) == 2
    page = (tmp_path / "index.html").read_text("utf-8")
    left = [float(part.split('"')[0]) for part in page.split('<rect x="')[1:]]
    assert f"{MISSIONS}/%E90.xtf/report.html" in page
    assert abs(left[0] - left[1]) > 100.0, "side by side on the map, not a world apart"


def test_a_run_that_was_stopped_half_way_ends_with_the_same_bytes(
    archive: Path, undisturbed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tasks = tasks_of(archive, tmp_path)
    replay([tasks[0].log.path], tasks[0].folder, Config())
    (tasks[0].folder / "summary.json").unlink()  # killed before its end
    (tasks[0].folder / "contacts.geojson").write_bytes(b"{")
    (tasks[0].folder / ".80a0f70f6dc685af.new").write_bytes(b"{")  # what was being written
    replay([tasks[2].log.path], tasks[2].folder, Config())
    kept = (tasks[2].folder / "summary.json").read_bytes()
    monkeypatch.setattr(batch_missions, "_alone", batch_missions.replay_mission)  # no process per log: faster
    assert main(["batch", str(archive), "--out", str(tmp_path), "--workers", "1"]) == BadInputError.exit_code
    assert content(tmp_path) == content(undisturbed)
    assert (tasks[2].folder / "summary.json").read_bytes() == kept


def test_results_of_another_configuration_or_of_a_log_that_changed_are_made_anew(
    archive: Path, undisturbed: Path, tmp_path: Path
) -> None:
    folder = undisturbed / MISSIONS / "day1/a.xtf"
    assert is_replayed(folder, Config())
    assert not is_replayed(folder, Config(contacts=ContactsConfig(min_p_mine=0.5)))
    assert not is_replayed(tmp_path, Config())
    summary = (folder / "summary.json").read_text()
    of_another_build = shutil.copytree(folder, tmp_path / "copy")
    (of_another_build / "summary.json").write_text(summary.replace(program(), "of another checkout"))
    assert not is_replayed(of_another_build, Config())
    (of_another_build / "summary.json").write_text('{"logs": ["a.xtf"]}')
    assert not is_replayed(of_another_build, Config())
    log = archive / "day1" / "a.xtf"
    times = os.stat(log).st_atime_ns, os.stat(log).st_mtime_ns
    try:
        os.utime(log)
        assert not is_replayed(folder, Config())
    finally:
        os.utime(log, ns=times)


def test_results_are_made_anew_after_a_file_that_the_configuration_names_has_changed(
    archive: Path, tmp_path: Path
) -> None:
    mines, task = tmp_path / "mines.yaml", tasks_of(archive, tmp_path)[0]
    mines.write_text("mines: [{kind: wedge}]")
    config = Config(confirm=ConfirmConfig(targets=str(mines)))
    replay([task.log.path], task.folder, config)
    assert is_replayed(task.folder, config)
    mines.write_text("mines: [{kind: sphere}]")
    assert not is_replayed(task.folder, config)
    mines.unlink()
    assert not is_replayed(task.folder, config), "so that a replay says which file is missing"


def end_process(task: MissionTask) -> None:
    os._exit(1)


def test_a_log_that_kills_its_process_fails_and_the_others_are_replayed(
    archive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def alone(task: MissionTask) -> batch_missions.MissionOutcome:
        return replayed_alone(task) if task.log.name == "day1/a.xtf" else batch_missions.MissionOutcome(*task[:2])

    replayed_alone: Callable[[MissionTask], batch_missions.MissionOutcome] = batch_missions._alone
    monkeypatch.setattr(batch_missions, "replay_mission", end_process)
    monkeypatch.setattr(batch_missions, "_alone", alone)
    outcomes = list(replay_missions(tasks_of(archive, tmp_path), Farm(workers=2)))
    assert [outcome.log.name for outcome in outcomes if outcome.failure] == ["day1/a.xtf"]
    assert "its process died" in outcomes[0].failure
    assert outcomes[0].exit_code == HardwareError.exit_code
    assert len(outcomes) == len(DAYS) + 2


@pytest.mark.parametrize(
    ("error", "failure", "exit_code"),
    [
        (ZeroDivisionError("of a test"), "defect: ZeroDivisionError: of a test", 1),
        (
            OSError(28, "No space left on device", "contacts.csv"),
            "contacts.csv: No space left on device",
            HardwareError.exit_code,
        ),
    ],
)
def test_a_defect_in_one_log_is_reported_as_such_and_a_full_disk_is_none(
    error: Exception, failure: str, exit_code: int, archive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(batch_missions, "replay", Mock(side_effect=error))
    outcome = batch_missions.replay_mission(tasks_of(archive, tmp_path)[0])
    assert (outcome.failure, outcome.exit_code) == (failure, exit_code)


def test_two_runs_into_one_folder_are_kept_apart(tmp_path: Path) -> None:
    with locked(tmp_path), pytest.raises(UsageError, match="another run writes"), locked(tmp_path):
        pass
    with locked(tmp_path):
        pass


def test_a_cluster_of_two_gives_the_same_bytes(archive: Path, undisturbed: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    with dask_cluster(tmp_path) as cluster:
        for _ in range(2):
            cluster.worker()
        arguments = ["batch", str(archive), "--out", str(out), "--scheduler", cluster.address]
        assert main(arguments) == BadInputError.exit_code
    assert content(out) == content(undisturbed)
