"""Check that a replayed session gives what the service was given."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from auv_mcm.clock import Stamp
from auv_mcm.errors import BadInputError
from auv_mcm.records import Notice, SourceEvent
from drivers.recording.session_layout import Recorded, file_name
from sim_replay.logs.open_log import is_session
from sim_replay.logs.port_log import PortLog
from sim_replay.logs.session_reader import Session, recorded_config
from tests.drivers.recording.session_samples import description, traffic, write_session


class WholeStory:
    """Fake an intake that records everything it was fed: bytes, how they were cut up, and stamps."""

    def __init__(self) -> None:
        self.counters: Counter[str] = Counter()

    def feed(self, port: str, data: bytes, stamp: Stamp) -> list[SourceEvent]:
        self.counters[f"fed.{port}"] += 1
        return [Notice(code=port, text=data.hex(), place=str(stamp))]

    def finish(self) -> list[SourceEvent]:
        return [Notice(code="end", text="")]


def live(chunks: list[Recorded]) -> tuple[list[SourceEvent], Counter[str]]:
    intake = WholeStory()
    events = [
        event
        for chunk in chunks
        if chunk.direction == "in"
        for event in intake.feed(chunk.port, chunk.data, chunk.stamp)
    ]
    return events + intake.finish(), intake.counters


def test_a_replay_feeds_the_same_bytes_with_the_same_stamps(tmp_path: Path) -> None:
    write_session(tmp_path, chunks := traffic(4, 300), per_flush=20, file_bytes=5000)
    log = PortLog(Session(tmp_path), WholeStory)
    for _ in range(2):
        assert (list(log), log.counters) == live(chunks)
        assert log.bytes_read == sum(log.sizes_bytes.values())


def test_a_cut_off_session_is_replayed_to_its_end_and_reported(tmp_path: Path) -> None:
    write_session(tmp_path, chunks := traffic(4, 100), per_flush=20)
    path = tmp_path / file_name(0)
    path.write_bytes(path.read_bytes()[:4000])
    n_read = len(list(Session(tmp_path)))
    *events, notice, end = PortLog(Session(tmp_path), WholeStory)
    assert [*events, end] == live(chunks[:n_read])[0]
    assert isinstance(notice, Notice)
    assert notice.code == "session_cut_off"


def test_the_recorded_configuration_serves(tmp_path: Path) -> None:
    write_session(tmp_path, [], per_flush=1)
    assert recorded_config(Session(tmp_path)).mission == "harbour ü"


def test_a_configuration_of_another_version_is_refused_in_words(tmp_path: Path) -> None:
    write_session(tmp_path, [], per_flush=1)
    path = tmp_path / file_name(0)
    session = Session(path)
    session.description = type(description())(version="9", started=Stamp(0, 0), config_yaml="misson: x\n", ports=())
    with pytest.raises(BadInputError, match="recorded by version 9"):
        recorded_config(session)


def test_sessions_are_distinguished_from_other_files(tmp_path: Path) -> None:
    assert not is_session(tmp_path)
    assert not is_session(tmp_path / "nowhere")
    (tmp_path / "log.xtf").write_bytes(b"\x7b" * 1024)
    assert not is_session(tmp_path / "log.xtf")
    write_session(tmp_path / "session", [], per_flush=1)
    assert is_session(tmp_path / "session")
    assert is_session(tmp_path / "session" / file_name(0))
