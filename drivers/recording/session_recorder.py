"""Record beside the event loop: it hands bytes over and never waits; a thread writes them and makes them durable."""

from __future__ import annotations

import errno
import logging
import threading
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Final

from auv_mcm.clock import Stamp
from auv_mcm.errors import UsageError
from auv_mcm.records import Notice
from auv_mcm.shell.whole_files import TAKES_NOTHING
from drivers.recording.session_layout import Direction, Lost, Recorded, SessionDescription
from drivers.recording.session_writer import FILE_BYTES, RESERVE_BYTES, DurableFile, SessionWriter, free_bytes

log = logging.getLogger(__name__)

QUEUE_BYTES: Final = 32 << 20  # bytes that wait for the disk; bounds memory while the disk stalls
_CHUNK_BYTES: Final = 256  # what a queued chunk takes beside its data
_TAKE_S: Final = 0.1  # a short while of Python at a time, which the event loop has to wait for
_TAKES_PER_FLUSH: Final = 5  # of _TAKE_S: flushed twice a second
_CLOSE_S: Final = 10.0  # s for the last flush at the end; a dead disk must not keep the service
RETRY_S: Final = 10.0  # s until a failed disk is tried again, twice as long each time: the queue bridges the first
_LONGEST_RETRY_S: Final = 600.0  # a file at most every ten minutes, as of a disk that does not fail


class SessionRecorder:
    """Record one session into a folder of its own.

    Bytes are durable within a second. A disk that is full or fails is tried again; what the queue holds is recorded
    then. Bytes that come while it is full are lost: counted, reported by a notice and, where anything is written after
    them, marked in the recording. Counts session.chunks_recorded, .bytes_recorded (durable),
    .chunks_lost and .bytes_lost.
    """

    def __init__(
        self,
        folder: Path,
        session: SessionDescription,
        *,
        file_bytes: int = FILE_BYTES,
        reserve_bytes: int = RESERVE_BYTES,
        queue_bytes: int = QUEUE_BYTES,
        retry_s: float = RETRY_S,
        open_file: Callable[[Path], DurableFile] = DurableFile,
        free_bytes: Callable[[Path], int] = free_bytes,
    ) -> None:
        """Begin the recording.

        file_bytes, reserve_bytes: as of `SessionWriter`; queue_bytes: memory for what the disk has not taken yet.
        retry_s: after which a disk that failed is tried again, twice as long each time.

        A disk that is full, fails or can only be read raises a notice. Raises UsageError for a folder that cannot be
        written to or holds a session already.
        """
        self._queue_bytes = queue_bytes
        self._retry_s = retry_s
        self._lock = threading.Lock()
        self._queue: list[Recorded] = []
        self.queued_bytes = 0
        self._lost_here: Lost | None = None
        self._counters: Counter[str] = Counter()
        self._notices: list[Notice] = []
        self._place = str(folder)
        self._stopped = False
        self._has_failed = False
        self._reported_slow = False
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="session-recorder", daemon=True)
        self._open = partial(
            SessionWriter,
            folder,
            session,
            file_bytes=file_bytes,
            reserve_bytes=reserve_bytes,
            open_file=open_file,
            free_bytes=free_bytes,
        )
        self._writer: SessionWriter | None = None
        try:
            self._writer = self._open()
        except FileExistsError as error:
            raise UsageError(
                f"{folder} already holds a recorded session. Record each session into a folder of its own."
            ) from error
        except OSError as error:
            if error.errno not in (*TAKES_NOTHING, errno.EIO):
                raise UsageError(
                    f"cannot record into {folder}: {error}. Check the path and its permissions."
                ) from error
            self._report_failure(error)
        self._thread.start()

    @property
    def counters(self) -> Counter[str]:
        """Return the counters so far."""
        with self._lock:
            return self._counters.copy()

    def record(self, port: str, direction: Direction, stamp: Stamp, data: bytes) -> None:
        """Take bytes of a port; empty ones record a tick of the clock. Neither waits nor raises."""
        with self._lock:
            size = len(data) + _CHUNK_BYTES
            # Once bytes are lost, so are all until the queue is taken: the mark then stands where they are missing.
            if self._stopped or self._lost_here or self.queued_bytes + size > self._queue_bytes:
                self._lose(port, stamp, data)
                return
            self._queue.append(Recorded(port, direction, stamp, data))
            self.queued_bytes += size

    def take_notices(self) -> list[Notice]:
        """Return the notices since the last call."""
        with self._lock:
            notices, self._notices = self._notices, []
            return notices

    def close(self) -> None:
        """Write what is queued, and end the recording; waits for the disk, ten seconds at most."""
        self._closing.set()
        if self._thread.is_alive():
            self._thread.join(_CLOSE_S)
        if self._thread.is_alive():
            self._report_failure(TimeoutError("the disk does not answer"))
            self._end([])

    def _run(self) -> None:
        unsafe: list[Recorded | Lost] = []  # taken, but not durable
        retry_s = self._retry_s
        while True:
            try:
                self._write(unsafe)
                return
            except OSError as error:
                self._report_failure(error)
                if self._closing.is_set():
                    break
            except Exception as error:  # whatever it is, the mission goes on; a defect would come again
                self._report_failure(error)
                break
            self._closing.wait(retry_s)
            retry_s = min(2.0 * retry_s, _LONGEST_RETRY_S)
        if self._writer is not None:
            self._writer.abandon()
        self._end(unsafe)

    def _write(self, unsafe: list[Recorded | Lost]) -> None:
        """Write what is unsafe, and on until the end. Raises OSError."""
        if self._writer is None:
            self._writer = self._open()
        elif self._has_failed:
            self._writer.go_on(self.counters["session.chunks_recorded"])
        add(self._writer, unsafe)
        n_takes = 0
        while not self._stopped:
            closing = self._closing.wait(_TAKE_S)
            with self._lock:
                taken: list[Recorded | Lost] = [*self._queue]
                taken += [] if self._lost_here is None else [self._lost_here]
                self._queue, self._lost_here = [], None
            unsafe += taken
            add(self._writer, taken)
            n_takes += 1
            if closing or n_takes % _TAKES_PER_FLUSH == 0:
                self._writer.flush()
                self._count_durable(unsafe)
            if closing:
                self._writer.close()
                self._stopped = True

    def _count_durable(self, unsafe: list[Recorded | Lost]) -> None:
        """Count what is durable now, and empty the list."""
        with self._lock:
            chunks = [one for one in unsafe if isinstance(one, Recorded)]
            unsafe.clear()
            self._counters["session.chunks_recorded"] += len(chunks)
            self._counters["session.bytes_recorded"] += sum(len(chunk.data) for chunk in chunks)
            self.queued_bytes -= sum(len(chunk.data) + _CHUNK_BYTES for chunk in chunks)
            if not self._has_failed:
                return
            self._has_failed = False
            text = (
                f"recording into {self._place} goes on; {self._counters['session.bytes_lost']} bytes are missing so "
                "far, and it marks where."
            )
            self._raise_notice(Notice(code="recording_resumed", text=text, place=self._place, for_the_record=True))

    def _lose(self, port: str, stamp: Stamp, data: bytes) -> None:
        self._counters["session.chunks_lost"] += 1
        self._counters["session.bytes_lost"] += len(data)
        if self._stopped:
            return
        lost = self._lost_here or Lost(n_chunks=0, n_bytes={}, first=stamp, last=stamp)
        n_bytes = {**lost.n_bytes, port: lost.n_bytes.get(port, 0) + len(data)}
        self._lost_here = Lost(n_chunks=lost.n_chunks + 1, n_bytes=n_bytes, first=lost.first, last=stamp)
        if not (self._reported_slow or self._has_failed):
            self._reported_slow = True
            text = (
                f"the disk under {self._place} is too slow for the data: bytes are missing from the recording, which "
                "marks where. The mission goes on. Record to a faster disk."
            )
            self._raise_notice(Notice(code="session_bytes_lost", text=text, place=self._place))

    def _report_failure(self, error: Exception) -> None:
        """Raise a notice where recording fails, once until it goes on."""
        with self._lock:
            if self._has_failed:
                return
            self._has_failed = True
            why = (error.strerror if isinstance(error, OSError) else None) or error
            is_tried = isinstance(error, OSError) and not self._closing.is_set()
            again = "it is tried again" if is_tried else "start again"
            text = (
                f"recording into {self._place} has stopped: {why}. The mission goes on without it; what was recorded "
                f"before can be read. Free disk space or check the disk; {again}."
            )
            self._raise_notice(Notice(code="session_stopped", text=text, place=self._place))

    def _end(self, unsafe: list[Recorded | Lost]) -> None:
        """Record no more: what waits is lost."""
        with self._lock:
            self._stopped = True
            given_up = [one for one in (*unsafe, *self._queue) if isinstance(one, Recorded)]
            self._queue, self.queued_bytes = [], 0
            self._counters["session.chunks_lost"] += len(given_up)
            self._counters["session.bytes_lost"] += sum(len(chunk.data) for chunk in given_up)

    def _raise_notice(self, notice: Notice) -> None:
        self._notices.append(notice)
        log.log(logging.INFO if notice.for_the_record else logging.ERROR, "%s", notice.text)


def add(writer: SessionWriter, entries: Sequence[Recorded | Lost]) -> None:
    """Give chunks, and marks of lost ones, to a writer in order. Raises OSError."""
    for one in entries:
        if isinstance(one, Lost):
            writer.add_lost(one)
        else:
            writer.add(one)
