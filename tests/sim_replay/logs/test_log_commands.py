"""Logs of every format at every command that takes one."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from auv_mcm.cli import main
from auv_mcm.records import Ping
from drivers.recording.session_layout import file_name
from sim_replay.fakes.feed import mission_events
from sim_replay.wire_logs import write_jsf, write_session, write_svlog
from tests.sim_replay.logs.sonar_logs import SonarKind, live_contacts, mission, run_of


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("logs")
    session = write_session(run_of("jsf"), folder / "session")
    return {
        "jsf": write_jsf(run_of("jsf"), folder / "survey.jsf"),
        "svlog": write_svlog(run_of("ping_protocol"), folder / "survey.svlog"),
        "folder": session,
        "mcap": session / file_name(0),
    }


@pytest.mark.parametrize(
    ("name", "kind"), [("jsf", "jsf"), ("svlog", "ping_protocol"), ("folder", "jsf"), ("mcap", "jsf")]
)
def test_replay_takes_every_format(name: str, kind: SonarKind, logs: dict[str, Path], tmp_path: Path) -> None:
    (tmp_path / "vehicle.yaml").write_text(
        f"ports: [{{name: sonar, link: 'tcp://10.0.0.2:1601', device: {kind}}},"
        " {name: compass, link: 'tcp://10.0.0.3:2000', device: nmea0183, navigation: {latency_s: "
        "0.026666666666666668}}]"
    )
    with_config = [] if name in ("folder", "mcap") else ["--config", str(tmp_path / "vehicle.yaml")]
    assert main(["replay", str(logs[name]), "--out", str(tmp_path / "out"), *with_config]) == 0
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["contacts"] == len(live_contacts(kind))
    assert summary["pings"] == 212
    features = json.loads((tmp_path / "out" / "contacts.geojson").read_text())["features"]
    for feature, contact in zip(features, live_contacts(kind), strict=True):
        assert feature["geometry"]["coordinates"][:2] == pytest.approx(
            [contact.longitude_deg, contact.latitude_deg], abs=3e-8
        )


@pytest.mark.usefixtures("without_perception")
def test_check_looks_into_logs(logs: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "c.yaml").write_text(f"service: {{source: 'replay://{logs['svlog']}?speed=max'}}")
    assert main(["check", str(logs["jsf"]), "--config", str(tmp_path / "c.yaml")]) == 0
    printed = capsys.readouterr().out
    assert "log survey.jsf" in printed
    assert "EdgeTech JSF, 0.9 MB, first ping 2023-11-14 22:13:20+00:00" in printed
    assert "Ping Protocol (svlog)" in printed
    (tmp_path / "cut.jsf").write_bytes(logs["jsf"].read_bytes()[:100])
    assert main(["check", str(tmp_path / "cut.jsf")]) == 5
    assert "FAILED  log cut.jsf" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "words"), [("jsf", "EdgeTech JSF"), ("svlog", "Ping Protocol"), ("folder", "recorded session")]
)
def test_augment_writes_xtf_alone(
    name: str, words: str, logs: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "targets.yaml").write_text("targets: [{kind: sphere, side: port, ground_range_m: 9.0, along_m: 5.0}]")
    command = ["augment", str(logs[name]), "--targets", str(tmp_path / "targets.yaml"), "--out", str(tmp_path / "out")]
    assert main(command) == 3
    printed = capsys.readouterr().err
    assert words in printed
    assert "Export it as XTF" in printed


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("empty.jsf", b"", "is empty"),
        ("short.jsf", b"\x01\x16\x0e", "holds no side-scan message"),
        ("short.svlog", b"BR\x04", "no usable side-scan ping"),
        ("short.mcap", b"\x89MCAP0\r\n", "not a recorded session, or nothing is left of it"),
        ("text.svlog", b"ping,range\n1,30\n" * 100, "is not a readable log"),
    ],
)
def test_what_cannot_be_replayed_is_exit_code_3_in_words(
    name: str, content: bytes, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    assert main(["replay", str(path), "--out", str(tmp_path / "out")]) == 3
    printed = capsys.readouterr().err
    assert words in printed
    assert str(path) in printed
    assert "Traceback" not in printed


def test_fake_devices_play_a_log_of_intensities_as_amplitudes(logs: dict[str, Path]) -> None:
    played = [event for event in mission_events(logs["svlog"], None) if isinstance(event, Ping)]
    recorded = [event for event in mission() if isinstance(event, Ping)]
    assert len(played) == len(recorded)
    for one, other in ((played[50].port, recorded[50].port), (played[50].starboard, recorded[50].starboard)):
        assert one is not None
        assert other is not None
        loud = other.samples > 0.05 * other.samples.max()
        assert one.samples[loud] == pytest.approx(other.samples[loud].astype(float), rel=0.02)
