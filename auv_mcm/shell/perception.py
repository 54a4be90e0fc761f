"""Run perception in a process of its own, so that its computations never delay the ports of the main process.

The parent writes a ping's samples into a ring in shared memory and sends the rest down a pipe; the worker copies them
out, feeds its pipeline and answers each message with the events that came of it, tiles left out and a picture in place
of what it is drawn from. The answer also gives the ring space back. The process is spawned, not forked: it starts clean
whatever the parent has open. The shared memory has no name: it goes with the last of the two processes, however they
end, all killed at once included.

Contacts and coverage go to a file that the parent opened and both hold, so that a long mission needs no more memory
than a short one. Their places in it cross with the answers. A contact crosses as well, without its pictures: its
announcement must not wait for the disk to give it back, and no contact is lost where the disk takes no more.
"""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import multiprocessing
import os
import signal
import tempfile
from collections import deque
from multiprocessing.reduction import ForkingPickler
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from auv_mcm import errors
from auv_mcm.contacts.record_file import RecordFile
from auv_mcm.plan.look_again import PlanRequest
from auv_mcm.records import Ping, SourceEvent
from auv_mcm.settings.config import Config
from auv_mcm.shell.checkpoint import Keeping
from auv_mcm.shell.perception_chain import MakePipeline, standard_pipeline
from auv_mcm.shell.perception_messages import (
    Checkpointed,
    Failure,
    Fed,
    Finished,
    Numbered,
    PerceptionError,
    Planned,
    Reserve,
    Started,
)
from auv_mcm.shell.perception_worker import work
from auv_mcm.shell.ping_ring import Ring, bytes_in_ring, into_ring

RING_BYTES: Final = 1 << 23  # about a minute of the largest pings in use
MAX_IN_FLIGHT: Final = 64  # messages not yet answered; small enough never to fill the pipe
_MAX_NOT_TAKEN: Final = 1024  # answers: some 15 s of 20 pings and 50 samples of navigation a second; bounds memory
_READ_BYTES: Final = 1 << 18  # in one turn of the event loop: as much as the kernel holds of a pipe
_SIZE_BYTES: Final = 4  # before each message, as multiprocessing writes it: its size, big-endian
_USER_TICKS: Final = 10  # place of utime in the line, from the field after the state on
_WAITING_STATES: Final = "STt"  # sleeping, stopped, traced; R runs or wants to, D waits for the disk


class WorkDone(NamedTuple):
    """Hold what a process has done so far.

    n_answered: answers so far. cpu_s: processor time used. waits: none of its threads has anything to compute or
    waits for the disk.
    """

    n_answered: int
    cpu_s: float
    waits: bool


def _work_done(pid: int, n_answered: int) -> WorkDone | None:
    """Read proc_pid_stat(5) of the process and of each of its threads; None where there is none."""
    process = Path(f"/proc/{pid}")
    try:
        _, *fields = (process / "stat").read_text().rpartition(")")[2].split()
        states = [path.read_text().rpartition(")")[2].split()[0] for path in process.glob("task/*/stat")]
    except (OSError, ValueError):
        return None  # a thread may just have ended
    user_ticks, system_ticks = map(int, fields[_USER_TICKS : _USER_TICKS + 2])
    waits = all(state in _WAITING_STATES for state in states)
    return WorkDone(n_answered, (user_ticks + system_ticks) / os.sysconf("SC_CLK_TCK"), waits)


class Perception:
    """Run the parent's end. One task feeds, another takes the answers; used inside a running event loop."""

    def __init__(
        self,
        config: Config,
        make_pipeline: MakePipeline = standard_pipeline,
        ring_bytes: int = RING_BYTES,
        records: RecordFile | None = None,
        keeping: Keeping | None = None,
    ) -> None:
        """records: for contacts and coverage; the worker appends to it. Without it contacts stay in memory.

        keeping: where the worker goes on from, and leaves checkpoints; None for neither.
        """
        self._config = config
        self._make_pipeline = make_pipeline
        self._records = records or RecordFile(None)
        self._keeping = keeping
        self._n_owed = 0  # answers that have not come
        self._n_answered = 0
        self._ring = Ring(ring_bytes)
        self._came = bytearray()  # of an answer that is not whole
        self._in_flight: deque[bool] = deque()  # per unanswered message: does it hold ring space?
        self._room = asyncio.Event()
        self._answers: asyncio.Queue[Started | Fed | Planned | Checkpointed | Finished | Exception] = asyncio.Queue()
        self._dead: Exception | None = None
        self._finishing = False
        self._to_undo = contextlib.ExitStack()

    @property
    def in_flight(self) -> int:
        """Count messages the worker has not answered yet."""
        return len(self._in_flight)

    @property
    def pings_in_flight(self) -> int:
        """Count the pings among them."""
        return sum(self._in_flight)

    async def start(self) -> Started:
        """Spawn the process and wait until it is ready. Raises PerceptionError if it cannot start."""
        context = multiprocessing.get_context("spawn")
        try:
            shared = context.RawArray(ctypes.c_ubyte, self._ring.n_bytes)
        except OSError as error:
            raise PerceptionError(
                f"no {self._ring.n_bytes / 1e6:.0f} MB can be had that both processes share: {error.strerror}. They "
                f"are a file in {tempfile.gettempdir()} without a name: raise the largest size of a file (ulimit -f, "
                "LimitFSIZE= of a unit) above that, or make room."
            ) from error
        self._memory = np.frombuffer(memoryview(shared), np.uint8)
        self._connection, theirs = context.Pipe()
        self._process = context.Process(
            target=work,
            args=(theirs, shared, self._config, self._make_pipeline, self._records, self._keeping),
            name="perception",
            daemon=True,
        )
        # A terminal's Ctrl-C and a service manager's SIGTERM reach the whole group; the worker has to outlive them to
        # finish. It inherits the blocked signals, so that there is no moment at its start when one would kill it.
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM, signal.SIGHUP})
        try:
            self._process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
            theirs.close()
        self._n_owed = 1  # that it is ready
        self._to_undo.callback(self._end_process)
        self._to_undo.callback(self._connection.close)
        asyncio.get_running_loop().add_reader(self._connection.fileno(), self._receive)
        self._to_undo.callback(asyncio.get_running_loop().remove_reader, self._connection.fileno())
        started = await self._answers.get()
        if isinstance(started, Exception):
            raise started
        assert isinstance(started, Started)
        return started

    async def feed(self, event: SourceEvent, room: float = 1.0, number: int = 0) -> None:
        """Hand one event to the worker, waiting for space in the ring; also while far too many answers are not taken.

        Parameters
        ----------
        room
            With a ping: share of the time that the work on tiles may take from it on; see Pipeline.leave_room.
        number
            Of the event, for checkpoints.

        Raises PerceptionError, or ValueError for a ping larger than the ring.
        """
        n_bytes = bytes_in_ring(event)
        if n_bytes > self._ring.n_bytes:
            raise ValueError(f"a ping of {n_bytes} bytes does not fit into the ring of {self._ring.n_bytes} bytes")
        offset: int | None = None
        while True:
            self._raise_if_dead()
            if len(self._in_flight) < MAX_IN_FLIGHT and self._answers.qsize() < _MAX_NOT_TAKEN:
                offset = self._ring.take(n_bytes) if n_bytes else 0
                if offset is not None:
                    break
            self._room.clear()
            await self._room.wait()
        self._in_flight.append(bool(n_bytes))
        self._n_owed += 1
        self._send(Numbered(number, into_ring(event, self._memory, offset, room) if isinstance(event, Ping) else event))

    def reserve(self, n_contacts: int) -> None:
        """Have contacts to come numbered behind those announced before."""
        with contextlib.suppress(errors.AuvMcmError):  # the reader of the answers gets the error
            self._send(Reserve(n_contacts))

    def ask(self, request: PlanRequest) -> bool:
        """Request a plan from the contacts known by then.

        False: none will come, because the worker ends or is gone.
        """
        if self._finishing or self._dead is not None:
            return False
        self._in_flight.append(False)
        self._n_owed += 1
        with contextlib.suppress(errors.AuvMcmError):  # the reader of the answers gets the error
            self._send(request)
        return True

    async def finish(self) -> None:
        """Signal the worker that no event follows; its last answer is Finished."""
        self._finishing = True
        self._in_flight += [False, False]  # what was still in the chain comes first, the end of it after
        self._n_owed += 2
        self._send(None)

    async def answer(self) -> Fed | Planned | Checkpointed | Finished:
        """Receive the next answer: Fed for each event and for `finish`, Planned for each `ask`, then Finished.

        Checkpointed comes of itself, after the answer to its event.

        Raises PerceptionError if the worker failed or died.
        """
        answer = await self._answers.get()
        if isinstance(answer, Exception):
            raise answer
        assert not isinstance(answer, Started)
        self._room.set()
        return answer

    def close(self) -> None:
        """End the process if it still runs. May be called at any time."""
        self._to_undo.close()

    def kill(self) -> None:
        """End a process that hangs; the reader of the answers then gets the error."""
        self._process.kill()

    def work_done(self) -> WorkDone | None:
        """Return what the process is doing; None if it owes no answer, or where the system does not say."""
        if not self._n_owed or self._dead is not None:
            return None
        return _work_done(self._process.pid or 0, self._n_answered)

    def _end_process(self) -> None:
        self._process.kill()  # no effect on one that has ended
        self._process.join()
        self._process.close()

    def _send(self, message: Any) -> None:
        self._raise_if_dead()
        try:
            self._connection.send(message)
        except OSError:
            while self._dead is None:
                self._receive()  # what it answered before it died
            self._raise_if_dead()

    def _receive(self) -> None:
        """Take what has come. An answer that is not whole is not waited for: its writer may not get a processor."""
        came = b""
        with contextlib.suppress(OSError):
            came = os.read(self._connection.fileno(), _READ_BYTES)
        if not came:
            self._die()
        self._came += came
        while len(self._came) >= (stop := _SIZE_BYTES + int.from_bytes(self._came[:_SIZE_BYTES], "big")):
            answer = ForkingPickler.loads(self._came[_SIZE_BYTES:stop])
            del self._came[:stop]
            self._take(answer)

    def _take(self, answer: Any) -> None:
        if isinstance(answer, Failure):
            self._set_dead(answer.error())
        else:
            self._n_answered += 1
            self._answers.put_nowait(answer)
            if isinstance(answer, Checkpointed):
                return
            self._n_owed -= 1
            # Whoever takes the answers may wait for the disk; the worker must not wait with him.
            if self._in_flight and self._in_flight.popleft():
                self._ring.give_back()
            self._room.set()

    def _die(self) -> None:
        self._process.join(timeout=5.0)  # its end of the pipe is closed: it is gone or going
        code = self._process.exitcode
        how = (
            "did not end"
            if code is None
            else f"was killed by {signal.Signals(-code).name}"
            if code < 0
            else f"ended with code {code}"
        )
        self._set_dead(
            PerceptionError(
                f"the perception process {how}. Contacts announced so far are safe. Check memory and the system log."
            )
        )

    def _set_dead(self, error: Exception) -> None:
        if self._dead is None:
            self._dead = error
            self._answers.put_nowait(error)
        asyncio.get_running_loop().remove_reader(self._connection.fileno())
        self._room.set()

    def _raise_if_dead(self) -> None:
        if self._dead is not None:
            raise self._dead
