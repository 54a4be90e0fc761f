"""Record beside the event loop: it hands bytes over and never waits; a thread writes them and makes them durable."""

from __future__ import annotations

import contextlib
import errno
import logging
import threading
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Final

from auv_mcm.clock import Stamp
from auv_mcm.errors import UsageError
from auv_mcm.records import Notice
from drivers.recording.session_layout import Direction, Lost, Recorded, SessionDescription
from drivers.recording.session_writer import FILE_BYTES, RESERVE_BYTES, DurableFile, SessionWriter, free_bytes

log = logging.getLogger(__name__)

QUEUE_BYTES: Final = 32 << 20  # bytes that wait for the disk; bounds memory while the disk stalls
_CHUNK_BYTES: Final = 256  # what a queued chunk takes beside its data
_TAKE_S: Final = 0.1  # a short while of Python at a time, which the event loop has to wait for
_TAKES_PER_FLUSH: Final = 5  # of _TAKE_S: flushed twice a second
_CLOSE_S: Final = 10.0  # s for the last flush at the end; a dead disk must not keep the service


class SessionRecorder:
    """Record one session into a folder of its own.

    Bytes are durable within a second. Those that come while the queue is full, and all after the disk was full or
    failed, are lost: counted, reported by a notice and, where anything is written after them, marked in the recording.
    A recorder that stopped does not start again. Counts session.chunks_recorded, .bytes_recorded (durable),
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
        open_file: Callable[[Path], DurableFile] = DurableFile,
        free_bytes: Callable[[Path], int] = free_bytes,
    ) -> None:
        """Begin the recording.

        file_bytes, reserve_bytes: as of `SessionWriter`; queue_bytes: memory for what the disk has not taken yet.

        A full disk raises a notice. Raises UsageError for a folder that cannot be written to or holds a session
        already.
        """
        self._queue_bytes = queue_bytes
        self._lock = threading.Lock()
        self._queue: list[Recorded] = []
        self.queued_bytes = 0
        self._lost_here: Lost | None = None
        self._counters: Counter[str] = Counter()
        self._notices: list[Notice] = []
        self._place = str(folder)
        self._stopped = False
        self._reported_slow = False
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="session-recorder", daemon=True)
        try:
            self._writer = SessionWriter(
                folder,
                session,
                file_bytes=file_bytes,
                reserve_bytes=reserve_bytes,
                open_file=open_file,
                free_bytes=free_bytes,
            )
        except FileExistsError as error:
            raise UsageError(
                f"{folder} already holds a recorded session. Record each session into a folder of its own."
            ) from error
        except OSError as error:
            if error.errno not in (errno.ENOSPC, errno.EDQUOT):
                raise UsageError(
                    f"cannot record into {folder}: {error}. Check the path and its permissions."
                ) from error
            self._stop(error, [])
        else:
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
            self._stop(TimeoutError("the disk does not answer"), [])

    def _run(self) -> None:
        unsafe: list[Recorded] = []  # taken, but not durable
        n_takes = 0
        try:
            while not self._stopped:
                closing = self._closing.wait(_TAKE_S)
                with self._lock:
                    batch, self._queue = self._queue, []
                    lost, self._lost_here = self._lost_here, None
                unsafe += batch
                for recorded in batch:
                    self._writer.add(recorded)
                if lost is not None:
                    self._writer.add_lost(lost)
                n_takes += 1
                if closing or n_takes % _TAKES_PER_FLUSH == 0:
                    self._writer.flush()
                    self._count_durable(unsafe)
                    unsafe = []
                if closing:
                    self._writer.close()
                    self._stopped = True
        except Exception as error:  # whatever it is, the mission goes on
            self._stop(error, unsafe)
            with contextlib.suppress(OSError):
                self._writer.abandon()

    def _count_durable(self, chunks: list[Recorded]) -> None:
        with self._lock:
            self._counters["session.chunks_recorded"] += len(chunks)
            self._counters["session.bytes_recorded"] += sum(len(chunk.data) for chunk in chunks)
            self.queued_bytes -= sum(len(chunk.data) + _CHUNK_BYTES for chunk in chunks)

    def _lose(self, port: str, stamp: Stamp, data: bytes) -> None:
        self._counters["session.chunks_lost"] += 1
        self._counters["session.bytes_lost"] += len(data)
        if self._stopped:
            return
        lost = self._lost_here or Lost(n_chunks=0, n_bytes={}, first=stamp, last=stamp)
        n_bytes = {**lost.n_bytes, port: lost.n_bytes.get(port, 0) + len(data)}
        self._lost_here = Lost(n_chunks=lost.n_chunks + 1, n_bytes=n_bytes, first=lost.first, last=stamp)
        if not self._reported_slow:
            self._reported_slow = True
            text = (
                f"the disk under {self._place} is too slow for the data: bytes are missing from the recording, which "
                "marks where. The mission goes on. Record to a faster disk."
            )
            self._raise_notice(Notice(code="session_bytes_lost", text=text, place=self._place))

    def _stop(self, error: Exception, unsafe: list[Recorded]) -> None:
        with self._lock:
            self._stopped = True
            given_up = unsafe + self._queue
            self._queue, self.queued_bytes = [], 0
            self._counters["session.chunks_lost"] += len(given_up)
            self._counters["session.bytes_lost"] += sum(len(chunk.data) for chunk in given_up)
            why = (error.strerror if isinstance(error, OSError) else None) or error
            text = (
                f"recording into {self._place} has stopped: {why}. The mission goes on without it; what was recorded "
                "before can be read. Free disk space or check the disk, then start again."
            )
            self._raise_notice(Notice(code="session_stopped", text=text, place=self._place))

    def _raise_notice(self, notice: Notice) -> None:
        self._notices.append(notice)
        log.error("%s", notice.text)
