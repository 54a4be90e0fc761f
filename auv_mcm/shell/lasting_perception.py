"""Keep perception going: a process that dies or hangs is replaced by one that goes on where it was.

Every event that comes in is numbered and spooled to disk. Perception leaves a checkpoint after tiles. A new process
reads the newest one and is fed again what came after it, with the same room for work; the chain is deterministic, so it
gives the same answers, and those that were given out before are left out. It comes to the same contacts under the same
numbers, to the byte. Events that come meanwhile wait in the spool.

The same with a new service after a power cut: `start` then goes on from what the folder holds, and answers to events
that were spooled come anew, for the service to know them.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections import Counter, deque
from collections.abc import Callable
from functools import partial
from itertools import islice
from typing import Final, NamedTuple

from auv_mcm.contacts.record_file import RecordFile
from auv_mcm.errors import AuvMcmError
from auv_mcm.plan.look_again import PlanRequest
from auv_mcm.records import Contact, Ping, SourceEvent, contact_number
from auv_mcm.settings.config import Config
from auv_mcm.shell.checkpoint import Keeping, commit_checkpoint
from auv_mcm.shell.event_queue import Queued
from auv_mcm.shell.event_spool import EventSpool, Spooled
from auv_mcm.shell.perception import Perception, WorkDone
from auv_mcm.shell.perception_chain import MakePipeline
from auv_mcm.shell.perception_messages import Checkpointed, Fed, Finished, PerceptionError, Planned, Started
from auv_mcm.shell.ping_ring import bytes_in_ring

log = logging.getLogger(__name__)

_WATCH_S: Final = 0.25  # s between two looks at the process
_IDLE_S: Final = 1.0
"""s for which a process that owes answers may neither compute nor wait for the disk. One that lacks a processor wants
to compute, and is not taken for one that hangs."""
_IDLE_AT_START_S: Final = 10.0  # s, the same before it is ready: it waits for more than the disk there; chosen
_BUSY_S: Final = 120.0
"""s of processor time for one answer. A pair of tiles takes 1 to 2 s here; with numpy for the kernels, on a computer
five times slower, 60 to 120 s."""
_MAX_ENDS: Final = 2
"""Processes that may end at one event: it is the same for the next one, whatever it is, and no more is tried."""
_MAX_ENDS_AT_START: Final = 4  # and before the first answer or its start, where chance may have ended one as well
_READ_AT_ONCE: Final = 64  # events read from the spool in one go
_NEWEST_BYTES: Final = 20 << 20
"""Of pings, kept in memory while the spool is read: some seconds, as is the room for other events; chosen."""
_OTHER_BYTES: Final = 2048  # that an event without samples counts for: 10,000 fit, eight seconds of six quantities


class _Asked(NamedTuple):
    """Hold a request for a plan, and the number of the newest event when it came."""

    after: int
    request: PlanRequest


class LastingPerception:
    """Run perception as `Perception` does, and run it again where it ends too early.

    One task feeds, another takes the answers; used inside a running event loop.

    counters: perception.restarted.
    """

    def __init__(
        self,
        config: Config,
        make_pipeline: MakePipeline,
        records: RecordFile,
        spool: EventSpool,
        keeping: Keeping,
        on_handed: Callable[[SourceEvent], None] = lambda event: None,
    ) -> None:
        """records: for contacts and coverage. spool: takes events as they come, before they wait in any queue.

        on_handed: is given every event once, in order, when perception has it first; those before the checkpoint that
        `start` goes on from are left out.
        """
        self.counters: Counter[str] = Counter()
        self._spool = spool
        self._keeping = keeping
        self._checkpoints: deque[int] = deque([0, 0], 2)  # numbers of the two newest
        self._make: Callable[[], Perception] = partial(
            Perception, config, make_pipeline, records=records, keeping=keeping
        )
        self._perception = self._make()
        self._given = spool.last  # number of the newest event that was given to feed, here or before a power cut
        self._handed = 0  # number of the newest that this process has
        self._handed_first = 0  # number of the newest that any process had
        self._on_handed = on_handed
        self._is_behind = False  # what was given comes from the spool
        self._newest: deque[Spooled] = deque()  # given since the spool was read last, unless they are too many
        self._newest_bytes = 0  # that they count for
        self._is_whole = False  # all of them are
        self._pings_behind: deque[int] = deque()  # numbers of pings that were given since, and that no process has
        self._awaited: deque[int] = deque()  # numbers of events, in the order of their answers
        self._answered = 0  # number of the newest event that any process answered
        self._answered_here: int | None = None  # number of the newest event that this process answered
        self._ended_at: int | None = None  # the same, of the process before
        self._n_ended_there = 0  # processes in a row
        self._asked: deque[_Asked] = deque()  # without an answer yet
        self._to_ask: deque[_Asked] = deque()  # those of them that this process has not been asked
        self._refeeding: asyncio.Task[None] | None = None
        self._is_finishing = False
        self._reservations = spool.reservations()
        self._n_announced = 0  # contacts, by the highest number in an answer
        self._watching: asyncio.Task[None] | None = None

    @property
    def given(self) -> int:
        """Return the number of the newest event that was given to feed; what has a higher one came of the end."""
        return self._given

    @property
    def in_flight(self) -> int:
        """Count messages that the process has not answered yet."""
        return self._perception.in_flight

    @property
    def pings_in_flight(self) -> int:
        """Count the pings among them."""
        return self._perception.pings_in_flight

    @property
    def pings_waiting(self) -> int:
        """Count pings that came while the process was fed again, and wait in the spool for their turn.

        Those that it is fed again are left out: they are no sign that it is too slow for what comes.
        """
        return len(self._pings_behind)

    async def start(self) -> Started:
        """Start the process and go on from what was kept, if anything was. Raises PerceptionError."""
        self._watching = asyncio.create_task(self._watch())
        started = await self._started()
        self._checkpoints.append(started.number)
        self._answered = self._handed = self._handed_first = started.number
        self._is_behind = False
        if self._given > started.number:
            self._go_on(started)
        return started

    def reserve(self, n_contacts: int) -> None:
        """Number contacts to come behind those announced before. Called before a process is started."""
        self._n_announced = max(self._n_announced, n_contacts)
        self._spool.mark_reserved(self._given + 1, self._n_announced)
        self._reservations[self._given + 1] = self._n_announced

    async def feed(self, queued: Queued, room: float = 1.0, *, is_patient: bool = False) -> None:
        """Hand one event of the spool to the process, waiting for space.

        Where the process is being replaced it is fed from the spool, later.

        Parameters
        ----------
        room
            With a ping: share of the time that the work on tiles may take from it on.
        is_patient
            Wait for that as well: the source can, and the spool must not take all of it at once.

        Raises ValueError for a ping larger than the ring.
        """
        if queued.number > self._given + 1:
            self._spool.mark_dropped(self._given + 1, queued.number)
        if room != 1.0:
            self._spool.mark_room(queued.number, room)
        self._given = queued.number
        spooled = Spooled(queued.number, queued.event, room)
        if not self._is_behind:
            await self._hand(self._perception, spooled)
        else:
            self._wait_in_line(spooled)
        while is_patient and self._is_behind:
            await asyncio.sleep(_WATCH_S)

    def _wait_in_line(self, spooled: Spooled) -> None:
        """Keep an event in memory beside the spool, while those there are few."""
        if isinstance(spooled.event, Ping):
            self._pings_behind.append(spooled.number)
        self._is_whole = self._is_whole and self._newest_bytes <= _NEWEST_BYTES
        if self._is_whole:
            self._newest.append(spooled)
            self._newest_bytes += _weight(spooled.event)

    def ask(self, request: PlanRequest) -> bool:
        """Request a plan from the contacts known by then. False: none will come."""
        if self._is_finishing:
            return False
        asked = _Asked(self._given, request)
        self._asked.append(asked)
        if self._is_behind:
            self._to_ask.append(asked)
        else:
            self._perception.ask(request)  # a process that is dead is replaced, and that one asked again
        return True

    async def finish(self) -> None:
        """Signal that no event follows; the last answer is Finished."""
        self._is_finishing = True
        if not self._is_behind:
            await self._finish(self._perception)

    async def answer(self) -> Fed | Planned | Finished:
        """Receive the next answer, one per event in order, whatever becomes of the process.

        Raises AuvMcmError if it cannot go on: a process could not be started, or two ended at the same event.
        """
        while True:
            try:
                answer = await self._perception.answer()
            except PerceptionError as error:
                await self._replace(error)
                continue
            if isinstance(answer, Checkpointed):
                await self._commit(answer.number)
                continue
            if isinstance(answer, Planned):
                self._asked.popleft()
            if not isinstance(answer, Fed):
                return answer
            number = self._awaited.popleft() if self._awaited else self._given + 1  # behind all: the end of the mission
            self._answered_here = number
            if number > self._answered:
                self._answered = number
                new = [contact_number(event.id) for event in answer.events if isinstance(event, Contact)]
                self._n_announced = max([self._n_announced, *new])
                return answer._replace(number=number)

    def close(self) -> None:
        """End the process if it still runs. May be called at any time."""
        for task in (self._refeeding, self._watching):
            if task is not None:
                task.cancel()
        self._perception.close()

    async def _hand(self, perception: Perception, spooled: Spooled) -> None:
        """Hand an event over. One that meets a dead process is fed to the next."""
        self._leave_numbers_out(perception, spooled.number)
        while self._pings_behind and self._pings_behind[0] <= spooled.number:
            self._pings_behind.popleft()
        self._awaited.append(spooled.number)
        try:
            await perception.feed(spooled.event, spooled.room, spooled.number)
        except AuvMcmError:
            return  # whoever takes the answers replaces it
        except ValueError:
            if perception is self._perception:
                self._awaited.pop()
            raise
        if spooled.number > self._handed_first:
            self._handed_first = spooled.number
            self._on_handed(spooled.event)
        if perception is self._perception:
            self._handed = spooled.number
            self._ask_until(perception, spooled.number)

    def _ask_until(self, perception: Perception, number: int) -> None:
        """Request the plans that were asked for up to event `number`: before, it would not know what they are for."""
        while self._to_ask and self._to_ask[0].after <= number:
            perception.ask(self._to_ask.popleft().request)

    def _leave_numbers_out(self, perception: Perception, number: int) -> None:
        """Reserve what is to be reserved before event `number`."""
        for before, n_contacts in self._reservations.items():
            if self._handed < before <= number:
                perception.reserve(n_contacts)

    async def _finish(self, perception: Perception) -> None:
        self._leave_numbers_out(perception, self._given + 1)
        with contextlib.suppress(AuvMcmError):  # as in `_hand`
            await perception.finish()

    async def _replace(self, error: PerceptionError) -> None:
        """Start another process in place of one that ended. Raises PerceptionError where that is of no use."""
        self._put_away(error)
        started = await self._started()
        log.info("perception runs again: it is fed again from event %d of %d", started.number + 1, self._given)
        self._go_on(started)

    async def _started(self) -> Started:
        """Start the process, and another one where it ends before it is ready. Raises as `_replace`."""
        while True:
            try:
                return await self._perception.start()
            except PerceptionError as error:
                self._put_away(error)

    def _put_away(self, error: PerceptionError) -> None:
        """Make another process in place of one that ended. Raises PerceptionError where that is of no use."""
        self._n_ended_there = self._n_ended_there + 1 if self._answered_here == self._ended_at else 1
        self._ended_at, self._answered_here = self._answered_here, None
        if self._n_ended_there >= (_MAX_ENDS_AT_START if self._ended_at is None else _MAX_ENDS):
            raise error
        self._is_behind = True  # from here on events wait in the spool
        if self._refeeding is not None:
            self._refeeding.cancel()
        self._perception.close()
        self.counters["perception.restarted"] += 1
        log.warning("%s It is started again and goes on from its last checkpoint.", error)
        self._perception = self._make()
        self._awaited.clear()
        self._to_ask = deque(self._asked)
        if self._spool.n_lost:  # it is not fed all that those announced came of
            self.reserve(self._n_announced)

    def _go_on(self, started: Started) -> None:
        """Feed the process what is behind its checkpoint, and then what comes."""
        self._is_behind, self._handed = True, started.number
        self._refeeding = asyncio.create_task(self._refeed(self._perception))

    async def _refeed(self, perception: Perception) -> None:
        """Feed what was spooled behind the checkpoint, until all that was given is with the process.

        What comes while the spool is read is fed from memory: new events can come faster than a slow disk is read.
        """
        self._is_whole = False
        while not self._is_whole:
            until = self._given
            self._newest.clear()
            self._newest_bytes = 0
            self._is_whole = True
            await self._feed_spooled(perception, until)
            while self._newest:
                spooled = self._newest.popleft()
                self._newest_bytes -= _weight(spooled.event)
                with contextlib.suppress(ValueError):  # a ping too large, which was reported when it came
                    await self._hand(perception, spooled)
        self._handed = self._given
        self._is_behind = False
        self._pings_behind.clear()  # of those that the disk did not take, too
        self._ask_until(perception, self._given)
        if self._is_finishing:
            await self._finish(perception)

    async def _feed_spooled(self, perception: Perception, until: int) -> None:
        await asyncio.to_thread(self._spool.flush)
        entries = self._spool.read(self._handed, until)
        while batch := await asyncio.to_thread(list, islice(entries, _READ_AT_ONCE)):
            for spooled in batch:
                with contextlib.suppress(ValueError):  # as in `_refeed`
                    await self._hand(perception, spooled)
        self._handed = until

    async def _commit(self, number: int) -> None:
        """Have a checkpoint count, and let go of what it and the one before hold. All before it was announced."""
        try:
            await asyncio.to_thread(commit_checkpoint, self._keeping.folder, number)
        except OSError:
            return  # those before it serve
        if number != self._checkpoints[-1]:
            self._checkpoints.append(number)
        self._spool.forget(self._checkpoints[0])

    async def _watch(self) -> None:
        """End a process that hangs; it is replaced like one that died."""
        last: WorkDone | None = None
        cpu_s = idle_s = 0.0  # cpu_s: when it answered last
        while True:
            await asyncio.sleep(_WATCH_S)
            now = self._perception.work_done()
            if now is None or last is None or now.n_answered != last.n_answered:
                cpu_s, idle_s = 0.0 if now is None else now.cpu_s, 0.0
            else:
                idle_s = idle_s + _WATCH_S if now.waits and now.cpu_s == last.cpu_s else 0.0
                if idle_s >= (_IDLE_S if now.n_answered else _IDLE_AT_START_S) or now.cpu_s - cpu_s >= _BUSY_S:
                    log.error("the perception process hangs, and is ended")
                    self._perception.kill()
                    now = None
            last = now


def _weight(event: SourceEvent) -> int:
    return bytes_in_ring(event) or _OTHER_BYTES
