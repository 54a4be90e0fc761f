"""Read sessions back: whole, cut off at any byte, damaged, and other files."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import Writer

from auv_mcm.errors import BadInputError
from drivers.recording.session_layout import Recorded, file_name
from sim_replay.logs.session_reader import Session
from tests.drivers.recording.session_samples import description, traffic, write_session


@pytest.mark.parametrize("file_bytes", [1, 4000, 1 << 30])
def test_what_was_recorded_is_read_back_across_files(tmp_path: Path, file_bytes: int) -> None:
    chunks = traffic(1, 200)
    write_session(tmp_path, chunks, per_flush=9, file_bytes=file_bytes)
    session = Session(tmp_path)
    assert list(session) == chunks
    assert list(session) == chunks  # every iteration starts anew
    assert not session.counters
    assert not session.notices
    assert session.description == description()
    assert session.bytes_read == sum(session.sizes_bytes.values())
    assert (len(session.sizes_bytes) > 1) == (file_bytes < 1 << 30)


def test_a_single_file_of_a_session_can_be_read_alone(tmp_path: Path) -> None:
    chunks = traffic(1, 200)
    write_session(tmp_path, chunks, per_flush=9, file_bytes=4000)
    read = list(session := Session(tmp_path / file_name(1)))
    at = chunks.index(read[0])
    assert read == chunks[at : at + len(read)]
    assert not session.counters


def test_other_tools_read_a_session(tmp_path: Path) -> None:
    """The MCAP library's own indexed reader, as the tools around the format use it."""
    chunks = traffic(2, 50)
    write_session(tmp_path, chunks, per_flush=10)
    with (tmp_path / file_name(0)).open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        found = [
            (channel.metadata["port"], message.data)
            for _, channel, message in reader.iter_messages()
            if channel.topic != "session/head"
        ]
        summary = reader.get_summary()
    assert sorted(found) == sorted((chunk.port, chunk.data) for chunk in chunks)
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == len(chunks) + 1


@pytest.fixture(scope="module")
def long_file(tmp_path_factory: pytest.TempPathFactory) -> tuple[bytes, list[Recorded], list[tuple[int, int]]]:
    """A finished session's file, what is in it, and after each flush: the file's size and how many chunks are in it."""
    folder = tmp_path_factory.mktemp("long")
    chunks = traffic(3, 18, max_bytes=8)
    durable = []
    writer = write_session(folder, [], per_flush=1, close=False)
    path = folder / file_name(0)
    durable.append((path.stat().st_size, 0))
    for k, chunk in enumerate(chunks, 1):
        writer.add(chunk)
        if k % 6 == 0:
            writer.flush()
            durable.append((path.stat().st_size, k))
    writer.close()
    return path.read_bytes(), chunks, durable


def test_a_file_cut_off_at_any_byte_gives_all_that_was_made_durable(
    tmp_path: Path, long_file: tuple[bytes, list[Recorded], list[tuple[int, int]]]
) -> None:
    data, chunks, durable = long_file
    path = tmp_path / file_name(0)
    first_whole = durable[0][0]
    for n_bytes in range(len(data)):
        path.write_bytes(data[:n_bytes])
        n_durable = max((n_chunks for size, n_chunks in durable if size <= n_bytes), default=0)
        try:
            read = list(session := Session(tmp_path))
        except BadInputError:
            assert n_bytes < first_whole
            continue
        assert n_durable <= len(read) <= n_durable + 6
        assert read == chunks[: len(read)]
        assert session.counters["session.files_unfinished"] == 1
        assert [notice.code for notice in session.notices] == ["session_cut_off"]


@given(
    damage=st.lists(st.tuples(st.floats(0.0, 1.0, exclude_max=True), st.integers(1, 255)), min_size=1, max_size=5),
    zeros=st.booleans(),
)
def test_no_damage_makes_up_data_or_a_traceback(
    tmp_path_factory: pytest.TempPathFactory,
    long_file: tuple[bytes, list[Recorded], list[tuple[int, int]]],
    damage: list[tuple[float, int]],
    zeros: bool,
) -> None:
    data, chunks, _ = long_file
    damaged = bytearray(data)
    for where, flip in damage:
        damaged[int(where * len(data))] ^= flip
    if zeros:  # as file systems leave them behind a power cut
        at = int(damage[0][0] * len(data))
        damaged[at:] = bytes(len(data) - at)
    folder = tmp_path_factory.mktemp("damaged")
    (folder / file_name(0)).write_bytes(damaged)
    try:
        read = list(session := Session(folder))
    except BadInputError:
        return
    assert set(read) <= set(chunks)
    assert session.notices or read == chunks[: len(read)]


def test_a_damaged_chunk_costs_that_chunk_and_is_reported(
    tmp_path: Path, long_file: tuple[bytes, list[Recorded], list[tuple[int, int]]]
) -> None:
    data, chunks, durable = long_file
    damaged = bytearray(data)
    damaged[durable[1][0] + 60] ^= 1
    (tmp_path / file_name(0)).write_bytes(damaged)
    read = list(session := Session(tmp_path))
    assert read == chunks[: durable[1][1]] + chunks[durable[2][1] :]
    assert session.counters == {"session.chunks_damaged": 1, "session.messages_missing": 6}
    assert [notice.code for notice in session.notices] == ["session_chunk_damaged", "session_messages_missing"]


def test_a_missing_file_is_reported(tmp_path: Path) -> None:
    chunks = traffic(1, 200)
    write_session(tmp_path, chunks, per_flush=9, file_bytes=4000)
    (tmp_path / file_name(1)).unlink()
    read = list(session := Session(tmp_path))
    assert len(read) + session.counters["session.messages_missing"] == len(chunks)
    assert [notice.code for notice in session.notices] == ["session_messages_missing"]


def test_a_file_of_another_session_is_left_out(tmp_path: Path) -> None:
    write_session(tmp_path / "a", chunks := traffic(1, 20), per_flush=5)
    write_session(tmp_path / "b", [], per_flush=5)
    other = (tmp_path / "b" / file_name(0)).read_bytes().replace(b"harbour", b"estuary")
    (tmp_path / "a" / file_name(1)).write_bytes(other)
    (tmp_path / "a" / file_name(2)).write_bytes(b"")
    read = list(session := Session(tmp_path / "a"))
    assert read == chunks
    assert [notice.code for notice in session.notices] == ["session_file_unusable"] * 2


def test_what_is_no_session_is_refused_in_words(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="does not exist"):
        Session(tmp_path / "nowhere")
    with pytest.raises(BadInputError, match="holds no recorded session"):
        Session(tmp_path)
    (text := tmp_path / "notes.txt").write_text("not a session, but long enough to look into")
    with pytest.raises(BadInputError, match=r"notes\.txt is not a recorded session"):
        Session(text)
    with (other := tmp_path / "other.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        writer.finish()  # type: ignore[no-untyped-call]  # mcap leaves it unannotated
    with pytest.raises(BadInputError, match="profile 'ros2'"):
        Session(other)
    for name in (file_name(0), file_name(1)):
        (tmp_path / name).write_bytes(b"\x89MCAP0\r\n")
    with pytest.raises(BadInputError, match="nothing of this session can be read"):
        Session(tmp_path)
