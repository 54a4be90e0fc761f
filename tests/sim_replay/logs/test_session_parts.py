"""A session that was cut off and went on is one mission: its recordings are joined, whatever of it is named."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import structs

from auv_mcm.cli import main
from auv_mcm.contacts.record_file import packed
from auv_mcm.errors import BadInputError, UsageError
from auv_mcm.records import Notice, Ping, SourceEvent
from auv_mcm.settings.config import Config, config_yaml
from auv_mcm.shell.recovery import JOURNAL
from drivers.port_intake import PortIntake
from drivers.recording.session_layout import SessionDescription, file_name
from drivers.recording.session_writer import SessionWriter
from sim_replay.export_source import find_source, tiles
from sim_replay.hil import joined_twin
from sim_replay.logs.archive import logs_of
from sim_replay.logs.open_log import logs_config, open_log
from sim_replay.logs.recorded import open_mission
from sim_replay.view.show import open_shown
from sim_replay.wire_logs import Run, write_session
from tests.sim_replay.logs.sonar_logs import contacts_of, live_events, run_of


class Cut(NamedTuple):
    """Where a start ended: behind so many chunks, in order or not, and how many came while nothing ran."""

    after: int
    is_in_order: bool = False
    n_skipped: int = 0


def write_parts(run: Run, folder: Path, cuts: Sequence[Cut]) -> list[Run]:
    """Write the session that was cut off so; return what each start received."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / JOURNAL).touch()
    parts, first = [], 0
    for number, cut in enumerate((*cuts, Cut(len(run.recorded), True)), 1):
        part = run._replace(recorded=run.recorded[first : cut.after])
        first = cut.after + cut.n_skipped
        parts.append(part)
        started = run.recorded[min(first, len(run.recorded) - 1)].stamp
        description = SessionDescription(
            version="0.1.0", started=started, config_yaml=config_yaml(part.config), ports=()
        )
        name = "recording" if number == 1 else f"recording-{number}"
        writer = SessionWriter(folder / name, description, reserve_bytes=0)
        for recorded in part.recorded:
            writer.add(recorded)
        if cut.is_in_order:
            writer.close()
        else:
            writer.flush()
            writer.abandon()
    return parts


def as_live(parts: Sequence[Run], cuts: Sequence[Cut]) -> list[SourceEvent]:
    """What the starts gave their chain, each with decoders of its own, by the rule."""
    events: list[SourceEvent] = []
    for part, is_finished in zip(parts, [*(cut.is_in_order for cut in cuts), True], strict=True):
        intake = PortIntake(part.config)
        for recorded in part.recorded:
            events += intake.feed(recorded.port, recorded.data, recorded.stamp)
        events += intake.finish() if is_finished else []
    return events


def without_reading_notices(events: Sequence[SourceEvent]) -> list[bytes]:
    return [packed(event) for event in events if not (isinstance(event, Notice) and event.code.startswith("session_"))]


@st.composite
def sessions(draw: st.DrawFn) -> list[Cut]:
    n_chunks = len(run_of("jsf").recorded)
    places = sorted(draw(st.sets(st.integers(1, n_chunks - 50), min_size=1, max_size=4)))
    cuts = []
    for place, following in zip(places, [*places[1:], n_chunks], strict=True):
        n_skipped = draw(st.integers(0, min(40, following - place - 1)))
        cuts.append(Cut(place, draw(st.booleans()), n_skipped))
    return cuts


@given(cuts=sessions())
@settings(max_examples=10)  # each decodes the mission three times
def test_the_parts_feed_the_chain_what_the_starts_fed_it(
    cuts: list[Cut], tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("session")
    parts = write_parts(run_of("jsf"), folder, cuts)
    log = open_log(folder, run_of("jsf").config)
    live = without_reading_notices(as_live(parts, cuts))
    for _ in range(2):
        assert without_reading_notices(list(log)) == live
        assert log.counters["session.parts"] == len(parts)
        assert log.bytes_read == sum(log.sizes_bytes.values())


def test_a_session_that_was_killed_and_started_again_gives_the_contacts_of_the_undisturbed_mission(
    tmp_path: Path,
) -> None:
    """Killed between the two boxes, in the middle of a message, and started again a second later.

    They are the contacts of the starts to the byte. Of the undisturbed mission they are the same objects at the same
    places; how likely a mine is judged from what is left around it.
    """
    run = run_of("ping_protocol")
    cut = Cut(len(run.recorded) // 2, n_skipped=40)
    parts = write_parts(run, tmp_path / "session", [cut])
    undisturbed = contacts_of(live_events(run), run.config)
    found = contacts_of(open_mission([tmp_path / "session"], run.config).events(), run.config)
    live = contacts_of(iter(as_live(parts, [cut])), run.config)
    assert [packed(contact) for contact in found] == [packed(contact) for contact in live]
    mines = [contact for contact in undisturbed if contact.p_mine > 0.25]
    assert len(mines) == 2
    for mine in mines:
        near = min(found, key=lambda contact: abs(contact.latitude_deg - mine.latitude_deg))
        assert abs(near.latitude_deg - mine.latitude_deg) < 1e-6  # degrees: 0.1 m
        assert near.p_mine > 0.2


def test_what_differs_from_the_undisturbed_twin_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = run_of("jsf")
    write_parts(run, tmp_path, [Cut(200), Cut(450, n_skipped=9)])
    monkeypatch.setattr(
        joined_twin, "_results", lambda events, config: ([packed(event) for event in events], [])
    )  # without the chain
    n_events, _, problems = joined_twin.compared_with_twin(tmp_path, 3, run.config)
    assert n_events > 400
    assert problems == ()
    twin = joined_twin._twin
    monkeypatch.setattr(joined_twin, "_twin", lambda *args: list(twin(*args))[:-1])
    assert "events differ" in joined_twin.compared_with_twin(tmp_path, 3, run.config)[2]


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("out")
    write_parts(run_of("jsf"), folder / "session-1", [Cut(200, n_skipped=9), Cut(450, True)])
    (folder / "latest").symlink_to("session-1")
    return folder / "session-1"


def n_pings(paths: Sequence[Path], config: Config) -> int:
    return sum(isinstance(event, Ping) for event in open_mission(paths, config).events())


def test_folder_link_first_recording_and_all_recordings_are_the_same_mission(session: Path) -> None:
    latest = session.with_name("latest")
    config = logs_config([latest])
    assert config is not None
    whole = n_pings([session], config)
    recordings = [latest / "recording-3", latest / "recording", latest / "recording-2"]
    files = [part / file_name(0) for part in recordings]  # as results name it
    for named in ([latest], [latest / "recording"], recordings, files):
        assert n_pings(named, config) == whole
    assert n_pings([latest / "recording-2"], config) < whole / 2
    assert whole > 0.9 * sum(isinstance(event, Ping) for event in live_events(run_of("jsf")))


def test_some_recordings_of_a_session_are_refused_with_what_to_name(session: Path) -> None:
    with pytest.raises(UsageError, match="name its folder"):
        open_mission([session / "recording", session / "recording-2"], Config())
    with pytest.raises(UsageError, match="name its folder"):
        open_mission([session / "recording" / file_name(0), session / "recording-2" / file_name(0)], Config())
    with pytest.raises(UsageError, match="given twice"):
        open_mission([session / "recording", session / "recording"], Config())


@pytest.mark.parametrize("named", ["recording-2", f"recording/{file_name(0)}"])
def test_a_part_named_alone_says_that_others_lie_beside_it(named: str, session: Path) -> None:
    config = logs_config([session]) or Config()
    notices = [event for event in open_log(session / named, config) if isinstance(event, Notice)]
    (found,) = [notice for notice in notices if notice.code == "session_parts_beside"]
    assert "3 recordings" in found.text
    assert f"Name {session.resolve()}" in found.text


def test_a_recording_that_is_missing_or_empty_is_reported_and_the_others_serve(tmp_path: Path) -> None:
    write_parts(run_of("jsf"), tmp_path, [Cut(200), Cut(300), Cut(400)])
    (tmp_path / "recording-2" / file_name(0)).unlink()
    (tmp_path / "recording-4" / file_name(0)).write_bytes(b"")
    log = open_log(tmp_path, run_of("jsf").config)
    codes = [event.code for event in log if isinstance(event, Notice)]
    assert codes[:2] == ["session_file_unusable", "session_part_missing"]
    assert (log.counters["session.parts"], log.counters["session.parts_unusable"]) == (2, 1)
    for path in tmp_path.glob("recording*/*"):
        path.write_bytes(b"")
    with pytest.raises(BadInputError, match="nothing of this session can be read"):
        open_log(tmp_path, Config())


def test_a_start_with_another_link_is_decoded_with_its_own(tmp_path: Path) -> None:
    """A unit at 4800 baud sends its bytes for longer than one on a network."""
    run = run_of("jsf")
    parts = write_parts(run, tmp_path, [cut := Cut(300)])
    serial = structs.replace(run.config.ports[1], link="serial:///dev/ttyS0?baud=4800")
    again = parts[1]._replace(config=structs.replace(run.config, ports=(run.config.ports[0], serial)))
    (tmp_path / "recording-2" / file_name(0)).unlink()
    write_session(again, tmp_path / "recording-2")
    found = list(open_log(tmp_path, logs_config([tmp_path]) or Config()))
    assert without_reading_notices(found) == without_reading_notices(as_live([parts[0], again], [cut]))
    assert without_reading_notices(found) != without_reading_notices(as_live(parts, [cut]))


def test_every_command_takes_a_session_as_one_mission(
    session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    latest = session.with_name("latest")
    assert main(["replay", str(latest / "recording"), "--out", str(tmp_path / "results")]) == 0
    assert main(["report", str(latest / "recording"), "--out", str(tmp_path / "report")]) == 0
    capsys.readouterr()
    for name in ("contacts.geojson", "coverage.geojson"):
        assert (tmp_path / "results" / name).read_bytes() == (tmp_path / "report" / name).read_bytes()
    summary = json.loads((tmp_path / "results" / "summary.json").read_bytes())
    assert len(summary["logs"]) == 3
    source = find_source([latest / "recording"], None)
    assert source.logs == (session.resolve(),)
    of_results = find_source([tmp_path / "results"], None)
    assert len(list(tiles(source))) == len(list(tiles(of_results))) > 0
    assert [log.name for log in logs_of(session.parent, tmp_path / "results")] == ["session-1/recording"]
    shown = open_shown(latest / "recording", [], None, "kim")
    try:
        assert shown.folder == session.resolve()
    finally:
        shown.feed.close()
        shown.store.close()
