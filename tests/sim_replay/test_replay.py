"""Replays of small simulated missions: every file, the same contacts whatever the circumstances."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from auv_mcm.cli import main
from auv_mcm.clock import SystemClock
from auv_mcm.errors import BadInputError, UsageError
from auv_mcm.records import NavSample
from auv_mcm.settings.config import Config
from auv_mcm.shell.sources import open_source, parse_source_uri
from sim_replay.logs.recorded import Pace, RecordedMission, parse_speed
from sim_replay.logs.xtf_writer import write_xtf
from sim_replay.replay import replay
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.scene import Lawnmower, Scene, SceneObject, Sonar, Track
from tests.manual_clock import ManualClock

ROOT = Path(__file__).parents[2]
FILES = {
    *("contacts.geojson", "contacts.csv", "contacts.kml", "waypoints.geojson", "coverage.geojson"),
    *("clearance.geojson", "clearance.png", "track.geojson", "summary.json", "report.html", "one-page.html"),
    "report-contents.bin",
    "snippets",
}
SAME = (
    *("contacts.geojson", "contacts.csv", "contacts.kml", "waypoints.geojson", "coverage.geojson"),
    *("clearance.geojson", "clearance.png"),
)


def scene(start_s: float, north_m: float) -> Scene:
    """A short leg past a sphere and a cylinder."""
    return Scene(
        sonar=Sonar(range_m=30.0, ping_rate_hz=15.0, beam_lines=3),
        track=Track(plan=Lawnmower(n_legs=1, leg_m=16.0, start_north_m=north_m), altitude_m=5.0, start_time_s=start_s),
        objects=(
            SceneObject(kind="sphere", leg=0, along_m=6.0, across_m=10.0),
            SceneObject(
                kind="cylinder", leg=0, along_m=11.0, across_m=-12.0, azimuth_deg=10.0, length_m=1.8, width_m=0.5
            ),
        ),
    )


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Two logs of one mission, the earlier one second by name."""
    folder = tmp_path_factory.mktemp("logs")
    first, second = folder / "z.xtf", folder / "a.xtf"
    write_xtf(first, Mission(scene(1_700_000_000.0, 0.0)).events())
    write_xtf(second, Mission(scene(1_700_000_100.0, 40.0)).events())
    return first, second


@pytest.fixture(scope="module")
def results(logs: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("results")
    replay(logs, folder, Config())
    return folder


def content(folder: Path) -> dict[str, bytes]:
    return {
        **{name: (folder / name).read_bytes() for name in SAME},
        **{path.name: path.read_bytes() for path in sorted((folder / "snippets").iterdir())},
    }


def read(path: Path) -> Any:
    def refuse(word: str) -> None:
        raise AssertionError(f"{word} is no JSON")

    return json.loads(path.read_bytes(), parse_constant=refuse)


def test_every_file_of_the_contract_is_written(results: Path, logs: tuple[Path, Path]) -> None:
    assert {path.name for path in results.iterdir()} == FILES
    summary = read(results / "summary.json")
    assert [log["path"] for log in summary["logs"]] == [str(path.absolute()) for path in logs]
    assert [log["bytes"] for log in summary["logs"]] == [path.stat().st_size for path in logs]
    features = read(results / "contacts.geojson")["features"]
    assert summary["contacts"] == len(features) > 0
    assert summary["pings"] == summary["counters"]["ping.received"] > 0
    assert summary["distance_m"] == pytest.approx(32.0, abs=1.0)
    assert summary["config"]["sonar"]["transfer"] == "auto"
    assert {"read", "waterfall", "detect", "pictures"} <= set(summary["costs_s"])
    assert summary["covered_km2"] > 0.0
    for feature in features:
        assert (results / feature["properties"]["snippet"]).read_bytes().startswith(b"\x89PNG")
        assert feature["properties"]["depth_m"] == pytest.approx(20.0, abs=0.5)  # the floor of the scene


@pytest.mark.parametrize(
    ("step", "circumstances"), [(1, {"chunk_bytes": 1}), (-1, {"chunk_bytes": 4099, "threads": 2})]
)
def test_neither_the_order_of_logs_nor_chunks_or_threads_change_a_byte(
    step: int, circumstances: dict[str, Any], logs: tuple[Path, Path], results: Path, tmp_path: Path
) -> None:
    replay(logs[::step], tmp_path, Config(), **circumstances)
    assert content(tmp_path) == content(results)


@pytest.fixture(scope="module")
def served(logs: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a service that was given the first log; `loaded` holds what its process had imported."""
    folder = tmp_path_factory.mktemp("served")
    (folder / "c.yaml").write_text(f"service: {{source: 'replay://{logs[0]}?speed=max', output_directory: '{folder}'}}")
    code = (
        "import sys; from auv_mcm.cli import main\n"
        f"code = main(['run', '--config', '{folder / 'c.yaml'}'])\n"
        "print(code, sorted({'cv2', 'scipy', 'matplotlib', 'rich', 'jinja2'} & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    (folder / "loaded").write_text(done.stdout.splitlines()[-1])
    return folder


def test_the_process_that_serves_never_loads_what_perception_needs(served: Path) -> None:
    assert (served / "loaded").read_text() == "0 []"
    assert len(list((served / "latest" / "snippets").iterdir())) > 0


def test_a_mission_that_is_served_leaves_the_files_contacts_and_calls_of_its_replay(
    logs: tuple[Path, Path], served: Path, tmp_path: Path
) -> None:
    summary = replay(logs[:1], tmp_path, Config())
    latest = served / "latest"
    assert content(latest) == content(tmp_path)
    assert json.loads((latest / "summary.json").read_bytes())["operating_point"] == summary["operating_point"]
    lines = (latest / "contacts.jsonl").read_text().splitlines()
    announced = {
        feature["id"]: feature["called"] for line in lines for feature in [json.loads(line)["contact"]["properties"]]
    }
    features = json.loads((latest / "contacts.geojson").read_bytes())["features"]
    assert announced == {feature["properties"]["id"]: feature["properties"]["called"] for feature in features}


def test_replaying_again_replaces_results_and_leaves_other_files_alone(
    logs: tuple[Path, Path], results: Path, tmp_path: Path
) -> None:
    (tmp_path / "snippets").mkdir()
    (tmp_path / "snippets" / "C9999.png").write_bytes(b"stale")
    (tmp_path / "notes.txt").write_bytes(b"mine")
    (tmp_path / "contacts.geojson").write_bytes(b"stale")
    replay(logs, tmp_path, Config())
    assert content(tmp_path) == content(results)
    assert (tmp_path / "notes.txt").read_bytes() == b"mine"


def test_a_folder_that_a_replay_writes_to_is_refused_to_another(logs: tuple[Path, Path], tmp_path: Path) -> None:
    refused: list[object] = []

    def meanwhile(done: float) -> None:
        if not refused:
            with pytest.raises(UsageError, match="another run writes to") as error:
                replay(logs[1:], tmp_path / "out", Config())
            refused.append(error)

    replay(logs[:1], tmp_path / "out", Config(), progress=meanwhile)
    assert refused
    assert replay(logs[1:], tmp_path / "out", Config())["logs"][0]["path"] == str(logs[1])


def test_an_interrupted_replay_leaves_no_summary_that_would_vouch_for_the_files(
    logs: tuple[Path, Path], tmp_path: Path
) -> None:
    def interrupt(fraction: float) -> None:
        raise KeyboardInterrupt

    (tmp_path / "summary.json").write_bytes(b"{}")
    with pytest.raises(KeyboardInterrupt):
        replay(logs, tmp_path, Config(), progress=interrupt)
    assert not (tmp_path / "summary.json").exists()


def test_a_log_named_twice_is_refused(logs: tuple[Path, Path], tmp_path: Path) -> None:
    (tmp_path / "link.xtf").symlink_to(logs[0])
    with pytest.raises(UsageError, match="given twice"):
        replay([logs[0], tmp_path / "link.xtf"], tmp_path / "out", Config())


def test_one_unusable_log_of_several_is_left_out_loudly(logs: tuple[Path, Path], tmp_path: Path) -> None:
    bad = tmp_path / "bad.xtf"
    bad.write_bytes(b"")
    summary = replay([logs[0], bad], tmp_path / "out", Config())
    assert summary["counters"]["replay.log_unusable"] == 1
    assert [notice["place"] for notice in summary["notices"] if notice["code"] == "log_unusable"] == [str(bad)]
    assert len(summary["logs"]) == 1
    (tmp_path / "other.xtf").write_bytes(b"x" * 2000)
    with pytest.raises(BadInputError, match=r"(?s)none of the logs.*bad\.xtf.*other\.xtf"):
        replay([bad, tmp_path / "other.xtf"], tmp_path / "out", Config())


@pytest.mark.parametrize("place", ["file", "file/below"])
def test_an_output_directory_that_cannot_be_is_refused(place: str, logs: tuple[Path, Path], tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(UsageError, match="a file is in its place"):
        replay(logs, tmp_path / place, Config())


def test_command_line_prints_figures_progress_and_where_the_report_is(
    logs: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["replay", str(logs[0]), "--out", str(tmp_path)]) == 0
    captured = capsys.readouterr()
    *_, report, closing = captured.out.splitlines()
    assert report == f"report: {tmp_path / 'report.html'}"
    assert "called mine" in closing
    assert "of them with p_mine 0.2 or more" in captured.out
    tenths = [line for line in captured.err.splitlines() if line.startswith("replay: ")]
    assert "replay: 50 %" in tenths
    assert len(tenths) <= 10


def test_fraction_done_grows_to_one(logs: tuple[Path, Path]) -> None:
    mission = RecordedMission(logs, Config())
    fractions = [mission.fraction_done for _ in mission.events()]
    assert fractions == sorted(fractions)
    assert fractions[-1] > 0.9
    assert mission.fraction_done == 1.0


def paced(times_s: list[float], speed: float) -> list[float]:
    """When events of these times are let through, the clock advancing by exactly what is waited."""
    clock = ManualClock()
    pace = Pace(speed, clock)
    came_s = []
    for time_s in times_s:
        clock.advance_to(clock.utc_s() + pace.wait_s(NavSample(time_s=time_s)))
        came_s.append(clock.monotonic_s())
    return came_s


def test_pace_follows_the_log_and_shortens_its_holes() -> None:
    assert paced([100.0, 100.5, 102.5], 1.0) == [0.0, 0.5, 2.5]
    assert paced([100.0, 100.5, 102.5], 2.0) == [0.0, 0.25, 1.25]
    assert paced([100.0, 101.0, 5000.0, 5001.0], 1.0) == [0.0, 1.0, 6.0, 7.0]
    assert paced([100.0, 101.0, 100.5, 101.5], 1.0) == [0.0, 1.0, 1.0, 1.5], "small steps back do not add up"
    assert paced([5000.0, 100.0, 101.0], 1.0) == [0.0, 0.0, 1.0], "a clock set back starts anew"
    assert paced([100.0, math.nan, 101.0], 1.0) == [0.0, 0.0, 1.0]
    assert paced([100.0, 200.0], math.inf) == [0.0, 0.0]


@pytest.mark.parametrize("text", ["0", "-1", "nan", "fast", ""])
def test_a_speed_that_cannot_be_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match="speed"):
        parse_speed(text, "--speed")


@pytest.mark.parametrize(
    ("uri", "message"), [("replay:///a.xtf?pace=1", "unknown option 'pace'"), ("replay:?speed=1", "names no log")]
)
def test_a_replay_source_that_cannot_be_is_refused(uri: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        open_source(parse_source_uri(uri), Config(), SystemClock())
