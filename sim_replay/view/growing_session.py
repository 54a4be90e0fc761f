"""Follow the recording of a session while it is written, without touching it, as the bytes that ports received."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, BinaryIO, Final, cast

from mcap.records import Channel, Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk

from auv_mcm.errors import BadInputError
from auv_mcm.records import Notice
from auv_mcm.safe_files import open_regular
from drivers.recording.session_layout import FILE_PATTERN, SEQUENCE_SPAN, PartEnd, Recorded
from sim_replay.logs.session_parts import recordings_of
from sim_replay.logs.session_reader import MAX_RECORD_BYTES, UNREADABLE, Session, recorded_in

POLL_S: Final = 0.25  # s between two looks for new bytes; the recorder makes them durable twice a second


class GrowingSession:
    """Read what a session's folder holds and then what comes, until the service has written its summary.

    Several recordings, of a session that was gone on with, follow one another, with a mark between them. What cannot be
    read ends its file.
    """

    def __init__(self, folder: Path, stop: threading.Event) -> None:
        """folder: of the session, which may not be there yet; stop: set to end at once."""
        self._folder = folder
        self._stop = stop
        self.bytes_read = 0
        self.counters: Counter[str] = Counter()
        self.notices: list[Notice] = []
        self._is_cut_off = False  # the file read last
        self._next_sequence = 0  # in its recording

    @property
    def sizes_bytes(self) -> dict[Path, int]:
        """Return the size of each file so far."""
        return {path: path.stat().st_size for path in self._files()}

    def wait_for_head(self) -> Session | None:
        """Wait until the recording has begun; None if it was stopped before."""
        while not self._stop.is_set():
            for recording in recordings_of(self._folder):
                try:
                    return Session(recording)
                except BadInputError:
                    pass  # its first chunk is not whole yet
            if self._has_ended():
                return None
            self._stop.wait(POLL_S)
        return None

    def __iter__(self) -> Iterator[Recorded | PartEnd]:
        done: set[Path] = set()
        recording: Path | None = None
        while True:
            ended = self._stop.is_set() or self._has_ended()  # before looking: what came until then is read
            new = [path for path in self._files() if path not in done]
            for path in new:
                done.add(path)
                if recording not in (None, path.parent):
                    yield PartEnd(is_cut_off=self._is_cut_off)
                    self._next_sequence = 0
                recording = path.parent
                yield from self._messages(path)
                if self._stop.is_set():
                    return
            if ended and not new:
                return
            if not new:
                self._stop.wait(POLL_S)

    def _messages(self, path: Path) -> Iterator[Recorded]:
        channels: dict[int, Channel] = {}
        self._is_cut_off = False
        with open_regular(path, buffering=0) as file:
            stream = _PatientReads(file, lambda: self._end_of(path), lambda: self._stop.wait(POLL_S))
            try:
                reader = StreamReader(cast(IO[bytes], stream), emit_chunks=True, record_size_limit=MAX_RECORD_BYTES)
                for record in reader.records:
                    if not isinstance(record, Chunk):
                        continue
                    self.bytes_read += len(record.data)
                    for held in breakup_chunk(record, validate_crc=True):
                        if isinstance(held, Channel):
                            channels[held.id] = held
                        elif isinstance(held, Message):
                            yield from self._new(held, channels)
            except UNREADABLE as error:
                self._is_cut_off = True
                if self._stop.is_set():
                    return
                self.notices.append(
                    Notice(code="session_cut_off", text=f"the rest of {path} cannot be read: {error}", place=str(path))
                )

    def _new(self, message: Message, channels: dict[int, Channel]) -> Iterator[Recorded]:
        """Give what a message holds, unless it was read before: where the disk failed it may be recorded twice."""
        channel = channels.get(message.channel_id)
        recorded = None if channel is None else recorded_in(message, channel)
        if recorded and (message.sequence - self._next_sequence) % SEQUENCE_SPAN < SEQUENCE_SPAN // 2:
            self._next_sequence = (message.sequence + 1) % SEQUENCE_SPAN
            yield recorded

    def _end_of(self, path: Path) -> str:
        """Say why a file grows no more; empty while it may."""
        if self._stop.is_set():
            return "nobody wants more"
        files = self._files()
        if path in files and files.index(path) < len(files) - 1:
            return "the next file has begun"
        return "the session has ended" if self._has_ended() else ""

    def _has_ended(self) -> bool:
        return (self._folder / "summary.json").exists()

    def _files(self) -> list[Path]:
        return [path for recording in recordings_of(self._folder) for path in sorted(recording.glob(FILE_PATTERN))]


class _PatientReads:
    """Read from a file that grows: a read is whole, however long that takes."""

    def __init__(self, file: BinaryIO, end: Callable[[], str], wait: Callable[[], object]) -> None:
        self._file, self._end, self._wait = file, end, wait

    def read(self, n_bytes: int) -> bytes:
        """Read n bytes. Raises EOFError if they will never come."""
        data, end = b"", ""
        while len(data) < n_bytes:
            more = self._file.read(n_bytes - len(data))
            data += more
            if more:
                continue
            if end:
                raise EOFError(end)
            end = self._end()  # and read once more: the rest may have come just before the end
            if not end:
                self._wait()
        return data
