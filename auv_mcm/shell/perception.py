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
import gc
import math
import multiprocessing
import os
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter, deque
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Protocol, TypeAlias

import msgspec
import numpy as np

from auv_mcm import errors
from auv_mcm.clean_text import clean_lines
from auv_mcm.clearance.clearance_map import Clearance, ClearanceMap
from auv_mcm.clearance.detection_performance import Performance, configured_performance
from auv_mcm.contacts.contact import best_view
from auv_mcm.contacts.contact_store import ContactStore
from auv_mcm.contacts.coverage_store import CoverageStore, StoredPatch, store_patch
from auv_mcm.contacts.operating_point import OperatingPoint
from auv_mcm.contacts.record_file import RecordFile, RecordPlace
from auv_mcm.frozen_state import StateError, freeze, thaw
from auv_mcm.memory import return_freed_memory
from auv_mcm.plan.look_again import PlanRequest, Proposal
from auv_mcm.records import (
    Contact,
    CoveragePatch,
    Detection,
    EarlyContact,
    Notice,
    Ping,
    PipelineEvent,
    SourceEvent,
    contact_number,
)
from auv_mcm.settings.config import Config
from auv_mcm.shell.checkpoint import read_checkpoints, write_checkpoint
from auv_mcm.shell.ping_ring import Ring, RingPing, bytes_in_ring, into_ring, out_of_ring
from auv_mcm.shell.tally import Tally

if TYPE_CHECKING:
    from auv_mcm.contacts.ledger import Contacts
    from auv_mcm.plan.clear_area import ClearArea

RING_BYTES: Final = 1 << 23  # about a minute of the largest pings in use
MAX_IN_FLIGHT: Final = 64  # messages not yet answered; small enough never to fill the pipe
_NICENESS: Final = 5  # of the worker: where processors are few, ports come first, for pings wait and bytes do not
_PLANNING_S: Final = 0.2  # of processor time for a plan to get better
_MAX_PLANNING_S: Final = 1.0  # while pings wait
CHECKPOINT_S: Final = 10.0
"""s between two checkpoints after tiles, minimum: bounds what is written, 4 to 9 MB each time, and what is replayed."""
_LONGEST_S: Final = 60.0  # s between two where no tile comes, as with navigation alone
_PR_SET_PDEATHSIG: Final = 1  # prctl(2)
_USER_TICKS: Final = 10  # place of utime in the line, from the field after the state on
_WAITING_STATES: Final = "STt"  # sleeping, stopped, traced; R runs or wants to, D waits for the disk
_NO_PICTURE: Final = np.empty((0, 0), dtype=np.uint8)
_NO_OUTLINE: Final = np.empty((0, 2))


_Shared: TypeAlias = "ctypes.Array[ctypes.c_ubyte]"


class Perceiving(Protocol):
    """Define what a pipeline offers; see auv_mcm.pipeline."""

    @property
    def counters(self) -> Counter[str]: ...

    @property
    def places(self) -> dict[str, Any]: ...

    @property
    def operating_point(self) -> OperatingPoint | None: ...

    def asking(self, min_p_mine: float) -> tuple[Contact, ...]: ...

    constants: dict[str, object]

    def state(self) -> dict[str, Any]: ...

    def restore(self, state: dict[str, Any]) -> None: ...

    def reserve(self, n_contacts: int) -> None: ...

    def leave_room(self, room: float) -> None: ...

    def feed(self, event: SourceEvent) -> list[PipelineEvent]: ...

    def finish(self) -> list[PipelineEvent]: ...


MakePipeline: TypeAlias = "Callable[[Config, Contacts], Perceiving]"
"""Makes a pipeline, given where to keep contacts."""


def standard_pipeline(config: Config, kept: Contacts) -> Perceiving:
    """Make the standard pipeline, imported only in the process that runs it."""
    from auv_mcm.memory import return_large_arrays
    from auv_mcm.pipeline import Pipeline

    return_large_arrays()
    return Pipeline(config, kept=kept, early=True)


class Fed(NamedTuple):
    """Answer one event, or the end of the mission, with what became final because of it.

    events: contacts, early ones among them, without what their pictures are made of, and notices. snippets: a PNG
    picture per contact id. places: in the file of records, of the contacts by number, without those that the disk did
    not take. patches: coverage, in that file too. number: of the event.
    """

    events: tuple[Contact | EarlyContact | Notice, ...]
    snippets: dict[str, bytes]
    places: dict[int, RecordPlace]
    patches: tuple[StoredPatch, ...]
    number: int = 0


class Started(NamedTuple):
    """Announce a worker that is ready, with the number of the last event in the checkpoint that it goes on from.

    contacts, coverage: the states of their stores then; tally: what had been fed. Number 0: it starts with nothing.
    """

    number: int
    contacts: Any = None
    coverage: Any = None
    tally: Tally | None = None


class Keeping(NamedTuple):
    """State where checkpoints go, and what they belong to: one of another kind is not gone on from.

    every_s: between two after tiles, minimum.
    """

    folder: Path
    kind: str
    every_s: float = CHECKPOINT_S


class Checkpointed(NamedTuple):
    """Report that a checkpoint was written after event `number`.

    It is to be committed once the answers before this one were announced.
    """

    number: int


class _Reserve(NamedTuple):
    n_contacts: int


class _Numbered(NamedTuple):
    number: int
    event: Any


class Planned(NamedTuple):
    """Answer a request for a plan."""

    proposal: Proposal


class Finished(NamedTuple):
    """Give the last answer."""

    counters: Counter[str]
    places: dict[str, Any]  # by range and strength, for the summary
    operating_point: OperatingPoint | None
    clearance: Clearance | None
    clearance_png: bytes  # its picture, empty without one


class WorkDone(NamedTuple):
    """Hold what a process has done so far.

    n_answered: answers so far. cpu_s: processor time used. waits: it has nothing to compute and does not wait
    for the disk.
    """

    n_answered: int
    cpu_s: float
    waits: bool


def _work_done(pid: int, n_answered: int) -> WorkDone | None:
    """Read proc_pid_stat(5); None where there is none."""
    try:
        state, *fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except (OSError, ValueError):
        return None
    user_ticks, system_ticks = map(int, fields[_USER_TICKS : _USER_TICKS + 2])
    return WorkDone(n_answered, (user_ticks + system_ticks) / os.sysconf("SC_CLK_TCK"), state in _WAITING_STATES)


class PerceptionError(errors.HardwareError):
    """Report that the perception process failed or died."""


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
            target=_work,
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
        """Hand one event to the worker, waiting for space in the ring.

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
            if len(self._in_flight) < MAX_IN_FLIGHT:
                offset = self._ring.take(n_bytes) if n_bytes else 0
                if offset is not None:
                    break
            self._room.clear()
            await self._room.wait()
        self._in_flight.append(bool(n_bytes))
        self._n_owed += 1
        self._send(
            _Numbered(number, into_ring(event, self._memory, offset, room) if isinstance(event, Ping) else event)
        )

    def reserve(self, n_contacts: int) -> None:
        """Have contacts to come numbered behind those announced before."""
        with contextlib.suppress(errors.AuvMcmError):  # the reader of the answers gets the error
            self._send(_Reserve(n_contacts))

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
        if isinstance(answer, Checkpointed):
            return answer
        if self._in_flight and self._in_flight.popleft():
            self._ring.give_back()
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
        try:
            answer = self._connection.recv()
        except (EOFError, OSError):
            self._die()
            return
        if isinstance(answer, _Failure):
            self._set_dead(answer.error())
        else:
            self._n_owed -= not isinstance(answer, Started | Checkpointed)
            self._n_answered += 1
            self._answers.put_nowait(answer)

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


class _Failure(NamedTuple):
    """Hold an exception of the worker, in words: not every exception survives pickling."""

    kind: str
    text: str

    def error(self) -> Exception:
        kind = getattr(errors, self.kind, PerceptionError)
        return kind(self.text) if issubclass(kind, errors.AuvMcmError) else PerceptionError(self.text)


def _work(
    connection: Connection,
    shared: _Shared,
    config: Config,
    make_pipeline: MakePipeline,
    records: RecordFile,
    keeping: Keeping | None,
) -> None:
    """Run the worker process."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    _end_with_parent()
    os.nice(_NICENESS)
    memory = np.frombuffer(memoryview(shared), np.uint8)
    place = "at its start"
    store = ContactStore(records)
    try:
        chain = _Chain(config, make_pipeline, records, store, keeping)
        gc.collect()
        gc.freeze()
        connection.send(chain.started)
        is_disk_sound, room = True, math.nan if chain.started.number else 1.0
        while (message := connection.recv()) is not None:
            if isinstance(message, PlanRequest):
                connection.send(Planned(_proposal(chain.pipeline, chain.searched, chain.area, message, config)))
                continue
            if isinstance(message, _Reserve):
                chain.pipeline.reserve(message.n_contacts)
                continue
            number, event = message
            if isinstance(event, RingPing):
                if event.room != room:
                    room = event.room
                    chain.pipeline.leave_room(room)
                event = out_of_ring(event, memory)
            place = getattr(event, "place", "") or place
            chain.tally.add(event)
            if chain.area is not None and isinstance(event, Ping):
                chain.area.see(event)
            events = chain.pipeline.feed(event)
            if is_disk_sound and store.n_in_memory:
                is_disk_sound = False
                events.append(_disk_full())
            _note_coverage(events, chain.searched, chain.area)
            answer = _answer(events, store, records)
            connection.send(answer)
            for patch in answer.patches:
                chain.coverage.keep(patch)
            if chain.is_checkpoint_due(bool(answer.patches)):
                if chain.checkpoint(number):
                    connection.send(Checkpointed(number))
                return_freed_memory()
        events = chain.pipeline.finish()
        _note_coverage(events, chain.searched, chain.area)
        connection.send(_answer(events, store, records))
        clearance = chain.searched.snapshot()
        of_disk = Counter(
            {"perception.kept_in_memory": store.n_in_memory, "perception.unreadable": records.n_unreadable}
        )
        png = b"" if clearance is None else _clearance_png(clearance)
        pipeline = chain.pipeline
        connection.send(
            Finished(pipeline.counters + of_disk, pipeline.places, pipeline.operating_point, clearance, png)
        )
    except (EOFError, BrokenPipeError, ConnectionResetError):
        pass  # the parent is gone: no reader for an answer
    except errors.AuvMcmError as error:
        connection.send(_Failure(type(error).__name__, str(error)))
    except Exception as error:
        print(clean_lines(traceback.format_exc()), file=sys.stderr)
        connection.send(
            _Failure(
                "PerceptionError",
                f"perception failed ({place}): {type(error).__name__}: {error}. This is a defect: report it with the "
                "log.",
            )
        )
    finally:
        records.close()


def _end_with_parent() -> None:
    """Have the system end this process with the service: a new service goes on with the same files at once."""
    with contextlib.suppress(OSError, AttributeError):  # Linux alone has it
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


class _Chain:
    """Hold all that the events so far have left behind in this process, and write and read it as checkpoints.

    started: what it begins with: the newest sound checkpoint of the folder, or nothing.
    """

    def __init__(
        self,
        config: Config,
        make_pipeline: MakePipeline,
        records: RecordFile,
        store: ContactStore,
        keeping: Keeping | None,
    ) -> None:
        self._records = records
        self._store = store
        self._keeping = keeping
        self._performance = configured_performance(config)
        self.pipeline = make_pipeline(config, store)
        self.searched = ClearanceMap(self._performance)
        self.area = _clear_area(config, self._performance)
        self.coverage = CoverageStore(records)
        self.tally = Tally()
        self.started = self._restored() or Started(0)
        self._kept_s = time.monotonic()

    def is_checkpoint_due(self, is_after_tile: bool) -> bool:
        """Decide whether to write one. Least waits in the chain after a tile."""
        age_s = time.monotonic() - self._kept_s
        return self._keeping is not None and age_s >= (self._keeping.every_s if is_after_tile else _LONGEST_S)

    def checkpoint(self, number: int) -> bool:
        """Write one. False if the disk does not take it: those before then have to serve."""
        assert self._keeping is not None
        state = freeze(
            {
                "kind": self._keeping.kind,
                "records_end": self._records.end,
                "pipeline": self.pipeline.state(),
                "searched": self.searched,
                "area": self.area,
                "contacts": self._store.state(),
                "coverage": self.coverage.state(),
                "tally": self.tally.state(),
            },
            self._constants(),
        )
        self._kept_s = time.monotonic()
        try:
            self._records.sync()
            write_checkpoint(self._keeping.folder, number, state)
        except OSError:
            return False
        return True

    def _restored(self) -> Started | None:
        if self._keeping is None:
            return None
        self._records.go_on()
        for number, data in read_checkpoints(self._keeping.folder):
            with contextlib.suppress(StateError):
                state = thaw(data, self._constants())
                if state["kind"] != self._keeping.kind or state["records_end"] > self._records.end:
                    continue
                self.pipeline.restore(state["pipeline"])
                self.searched, self.area = state["searched"], state["area"]
                self._store.restore(state["contacts"])
                self.coverage.restore(state["coverage"])
                self.tally.restore(state["tally"])
                return Started(number, state["contacts"], state["coverage"], self.tally)
        return None

    def _constants(self) -> dict[str, object]:
        return {**self.pipeline.constants, "kept": self._store, "performance": self._performance}


def _disk_full() -> Notice:
    return Notice(
        code="perception.disk_full",
        text=(
            "the disk takes no more of the contacts that perception lays aside; they stay in memory. Free space on "
            "the disk."
        ),
    )


def _clear_area(config: Config, model: Performance) -> ClearArea | None:
    if not config.plan.area_deg:
        return None
    from auv_mcm.plan.clear_area import ClearArea

    return ClearArea(config, model)


def _proposal(
    pipeline: Perceiving, searched: ClearanceMap, area: ClearArea | None, request: PlanRequest, config: Config
) -> Proposal:
    """Make a plan. Contacts matter more than plans: a planner that fails does not stop perception."""
    from auv_mcm.plan.propose import propose

    busy_s, late_s = time.thread_time() + _PLANNING_S, time.monotonic() + _MAX_PLANNING_S

    def more_time() -> bool:
        return time.thread_time() < busy_s and time.monotonic() < late_s

    try:
        asking = pipeline.asking(config.plan.min_p_mine)
        if area is not None:
            return area.propose(searched.snapshot(), asking, request, more_time)
        return propose(asking, request, config.plan, config.vehicle, more_time)
    except Exception as error:
        print(clean_lines(traceback.format_exc()), file=sys.stderr)
        return Proposal(
            (), (("any contact", f"planning failed: {error!r}. This is a defect: report it with the log."),)
        )


def _note_coverage(events: list[PipelineEvent], searched: ClearanceMap, area: ClearArea | None) -> None:
    """Add the cells of patches, which stay in this process, to the map of what was searched."""
    for event in events:
        if isinstance(event, CoveragePatch):
            searched.add(event)
            if area is not None:
                area.add(event)


def _answer(events: list[PipelineEvent], store: ContactStore, records: RecordFile) -> Fed:
    """Give the parent what it needs of events; contacts are in the store already."""
    contacts = [event for event in events if isinstance(event, Contact)]
    places = {number: store.place(number) for number in (contact_number(contact.id) for contact in contacts)}
    return Fed(
        events=tuple(
            _without_pictures(event) for event in events if isinstance(event, Contact | EarlyContact | Notice)
        ),
        snippets=_snippets(contacts),
        places={number: place for number, place in places.items() if place is not None},
        patches=tuple(store_patch(records, event) for event in events if isinstance(event, CoveragePatch)),
    )


def _without_pictures(event: Contact | EarlyContact | Notice) -> Contact | EarlyContact | Notice:
    """Leave out of a contact what its pictures are made of; that is most of it, and the worker makes them."""
    if isinstance(event, EarlyContact):
        return msgspec.structs.replace(event, contact=_bare(event.contact))
    return event if isinstance(event, Notice) else _bare(event)


def _bare(contact: Contact) -> Contact:
    return msgspec.structs.replace(contact, views=tuple(map(_without_picture, contact.views)))


def _without_picture(view: Detection) -> Detection:
    close = view.confirmation
    if close is not None:
        model = close.model and msgspec.structs.replace(close.model, highlight=_NO_OUTLINE, shadow=_NO_OUTLINE)
        close = msgspec.structs.replace(
            close, labels=_NO_PICTURE, highlight=_NO_OUTLINE, shadow=_NO_OUTLINE, model=model
        )
    return msgspec.structs.replace(view, snippet=_NO_PICTURE, confirmation=close)


def _clearance_png(clearance: Clearance) -> bytes:
    from auv_mcm.clearance.clearance_picture import clearance_png  # OpenCV: only in this process

    return clearance_png(clearance)


def _snippets(contacts: list[Contact]) -> dict[str, bytes]:
    if not contacts:
        return {}
    from auv_mcm.contacts.contact_picture import snippet_png  # OpenCV: only in this process

    return {contact.id: snippet_png(view) for contact in contacts if (view := best_view(contact)) is not None}
