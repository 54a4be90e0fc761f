"""Read a recorded session, in whatever state its recording ended."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import IO, BinaryIO, Final, NamedTuple, cast, get_args

import msgspec
from mcap.exceptions import McapError
from mcap.records import Channel, Chunk, Header, McapRecord, Message
from mcap.stream_reader import StreamReader, breakup_chunk

from auv_mcm.clock import Stamp
from auv_mcm.errors import BadInputError, UsageError
from auv_mcm.records import Notice
from auv_mcm.safe_files import open_regular
from auv_mcm.settings.config import Config, parse_config
from drivers.recording.session_layout import (
    FILE_PATTERN,
    LOST_TOPIC,
    PROFILE,
    SEQUENCE_SPAN,
    Direction,
    FileHead,
    Lost,
    Recorded,
    SessionDescription,
)

MAX_RECORD_BYTES: Final = 64 << 20  # far more than a chunk has; a damaged length does not claim memory
UNREADABLE: Final = (McapError, struct.error, ValueError, EOFError)
"""What the MCAP reader raises on damage; a wrong CRC is a ValueError."""


class _File(NamedTuple):
    path: Path
    size_bytes: int
    head: FileHead


class Session:
    """Read a session's folder, or one file of it, in the order of recording; every iteration starts anew.

    Counts, while iterating: session.files_unfinished (recording was cut off), .bytes_torn (behind the last whole record
    of such a file), .chunks_damaged (wrong CRC), .messages_missing (by their sequence), and what the recorder lost:
    .chunks_lost, .bytes_lost. `notices` report the same to a person.
    """

    def __init__(self, path: Path) -> None:
        """Read the head of every file. Raises BadInputError for a path without a session, or a session with nothing
        left.
        """
        if not path.exists():
            raise BadInputError(f"{path} does not exist. Check the path.")
        candidates = sorted(path.glob(FILE_PATTERN)) if path.is_dir() else [path]
        if not candidates:
            raise BadInputError(
                f"{path} holds no recorded session: it contains no {FILE_PATTERN}. Name a folder that was recorded "
                "into."
            )
        self._left_out: list[Notice] = []
        files = []
        for candidate in candidates:
            try:
                files.append(_File(candidate, candidate.stat().st_size, _read_head(candidate)))
            except BadInputError as error:
                if len(candidates) == 1:
                    raise
                self._left_out.append(
                    Notice(code="session_file_unusable", text=f"file left out: {error}", place=str(candidate))
                )
        if not files:
            raise BadInputError(
                "nothing of this session can be read:\n" + "\n".join(f"  {notice.text}" for notice in self._left_out)
            )
        files.sort(key=lambda file: file.head.file_number)
        self.description: SessionDescription = files[0].head.session
        self._files = [file for file in files if file.head.session == self.description]
        for file in files:
            if file.head.session != self.description:
                text = (
                    f"{file.path} was recorded in another session and is left out. Keep each session in a folder of "
                    "its own."
                )
                self._left_out.append(Notice(code="session_file_unusable", text=text, place=str(file.path)))
        self._whole = path.is_dir()
        self._begin()

    @property
    def sizes_bytes(self) -> dict[Path, int]:
        """Return the size of each file in use, in the order of recording."""
        return {file.path: file.size_bytes for file in self._files}

    def _begin(self) -> None:
        self.counters: Counter[str] = Counter()
        self.notices: list[Notice] = list(self._left_out)
        self.bytes_read = 0
        self.is_cut_off = False
        """Whether the recording ends within its last file: it was not ended in order."""
        self._next_sequence = 0 if self._whole else None

    def __iter__(self) -> Iterator[Recorded]:
        self._begin()
        return self._read()

    def _read(self) -> Iterator[Recorded]:
        for file in self._files:
            read_before = self.bytes_read
            with open_regular(file.path) as opened:
                channels: dict[int, Channel] = {}
                stream = _WholeReads(opened, file.size_bytes)
                for chunk in self._chunks(stream, file):
                    self.bytes_read = read_before + stream.n_bytes
                    yield from self._messages(chunk, channels, file)
            self.bytes_read = read_before + file.size_bytes

    def _chunks(self, stream: _WholeReads, file: _File) -> Iterator[Chunk]:
        whole_bytes = 0
        self.is_cut_off = False
        try:
            for record in _records(stream):
                whole_bytes = stream.n_bytes
                if isinstance(record, Chunk):
                    yield record
        except UNREADABLE:
            torn_bytes = file.size_bytes - whole_bytes
            self.is_cut_off = True
            self.counters["session.files_unfinished"] += 1
            self.counters["session.bytes_torn"] += torn_bytes
            text = (
                f"the recording of {file.path} was cut off: its last {torn_bytes} bytes cannot be read, all before "
                "them can."
            )
            self.notices.append(Notice(code="session_cut_off", text=text, place=f"{file.path}: byte {whole_bytes}"))

    def _messages(self, chunk: Chunk, channels: dict[int, Channel], file: _File) -> Iterator[Recorded]:
        try:
            records = _records_in(chunk)
        except UNREADABLE:
            self.counters["session.chunks_damaged"] += 1
            text = f"{file.path} has a damaged chunk, which is left out. Check the disk that it was recorded to."
            self.notices.append(Notice(code="session_chunk_damaged", text=text, place=str(file.path)))
            return
        for record in records:
            if isinstance(record, Channel):
                channels[record.id] = record
            elif isinstance(record, Message) and (channel := channels.get(record.channel_id)) is not None:
                if channel.topic == LOST_TOPIC:
                    self._note_lost(msgspec.json.decode(record.data, type=Lost), file)
                elif (recorded := recorded_in(record, channel)) and not self._is_read(record.sequence, file):
                    yield recorded

    def _is_read(self, sequence: int, file: _File) -> bool:
        """Check whether a message was read before: where the disk failed it may have been recorded twice."""
        n_missing = 0 if self._next_sequence is None else (sequence - self._next_sequence) % SEQUENCE_SPAN
        if n_missing >= SEQUENCE_SPAN // 2:
            return True
        if n_missing:
            self.counters["session.messages_missing"] += n_missing
            text = (
                f"{n_missing} messages are missing before this place in {file.path}: a damaged chunk, or a file that "
                "is not there."
            )
            self.notices.append(Notice(code="session_messages_missing", text=text, place=str(file.path)))
        self._next_sequence = (sequence + 1) % SEQUENCE_SPAN
        return False

    def _note_lost(self, lost: Lost, file: _File) -> None:
        n_bytes = sum(lost.n_bytes.values())
        self.counters["session.chunks_lost"] += lost.n_chunks
        self.counters["session.bytes_lost"] += n_bytes
        text = (
            f"{n_bytes} bytes of {', '.join(sorted(lost.n_bytes))} came too fast for the disk and were not recorded, "
            f"within {(lost.last.mono_ns - lost.first.mono_ns) / 1e9:.1f} s. A replay differs from the mission there."
        )
        self.notices.append(Notice(code="session_bytes_lost", text=text, place=str(file.path)))


def recorded_in(message: Message, channel: Channel) -> Recorded | None:
    """Return the bytes of a port that a message holds; None for one that holds anything else."""
    direction = channel.metadata.get("direction")
    if channel.topic == LOST_TOPIC or direction not in get_args(Direction):
        return None
    stamp = Stamp(mono_ns=message.publish_time, utc_ns=message.log_time)
    return Recorded(channel.metadata.get("port", channel.topic), cast(Direction, direction), stamp, message.data)


def recorded_config(session: Session) -> Config:
    """Parse the configuration that a session was recorded with. Raises BadInputError for one from another version."""
    try:
        return parse_config(session.description.config_yaml, "the session's configuration")
    except UsageError as error:
        raise BadInputError(
            f"{error}\nIt was recorded by version {session.description.version}; replay it with that, or give a "
            "configuration."
        ) from error


class _WholeReads:
    """Guard the file for the MCAP reader: a read is whole or none, and no length claims memory."""

    def __init__(self, stream: BinaryIO, size_bytes: int) -> None:
        self.n_bytes = 0
        self._stream = stream
        self._size_bytes = size_bytes

    def read(self, n_bytes: int) -> bytes:
        """Read n bytes. Raises EOFError where there are not as many."""
        if n_bytes > self._size_bytes - self.n_bytes:
            raise EOFError(f"it ends at byte {self._size_bytes}, within a record")
        self.n_bytes += n_bytes
        return self._stream.read(n_bytes)


def _records(stream: _WholeReads) -> Iterator[McapRecord]:
    yield from StreamReader(cast(IO[bytes], stream), emit_chunks=True, record_size_limit=MAX_RECORD_BYTES).records


def _records_in(chunk: Chunk) -> list[McapRecord]:
    if chunk.compression:
        raise ValueError("a session's chunks are not compressed")
    return breakup_chunk(chunk, validate_crc=True)


def _read_head(path: Path) -> FileHead:
    """Read the head. Raises BadInputError."""
    try:
        with open_regular(path) as stream:
            for record in _records(_WholeReads(stream, path.stat().st_size)):
                if isinstance(record, Header) and record.profile != PROFILE:
                    raise BadInputError(
                        f"{path} is an MCAP file of profile '{record.profile}', not a session ('{PROFILE}'). Name "
                        "another."
                    )
                if isinstance(record, Chunk):
                    return _head_in(record)
    except OSError as error:
        raise BadInputError(f"{path} cannot be read: {error}. Check the path.") from error
    except msgspec.MsgspecError as error:
        raise BadInputError(
            f"{path}: its head is not that of a session: {error}. It was recorded by another version."
        ) from error
    except UNREADABLE as error:
        raise BadInputError(
            f"{path} is not a recorded session, or nothing is left of it: {error}. Name a session's folder or file."
        ) from error
    raise BadInputError(f"{path} holds no messages. Name another recording.")


def _head_in(chunk: Chunk) -> FileHead:
    """Decode the first message. Raises msgspec.MsgspecError for another one, and the MCAP reader's errors on damage."""
    first = next((record for record in _records_in(chunk) if isinstance(record, Message)), None)
    return msgspec.json.decode(b"" if first is None else first.data, type=FileHead)
