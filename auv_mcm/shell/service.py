"""Run the service: a source -> a bounded queue -> perception in its own process -> a journal, then the console.

The event loop does input and output only; a thread does what may wait for the disk. A contact is on disk before it is
announced. SIGINT or SIGTERM stops the source; what is queued is still worked off and everything is written. A second
signal ends at once; the journal is complete even then. Contacts lie on disk until the end: the memory of a mission does
not grow with its length.
"""

from __future__ import annotations

import asyncio
import contextlib
import gc
import logging
import os
from collections import Counter
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, Final

import msgspec

from auv_mcm import kernels
from auv_mcm.clock import Clock, SystemClock
from auv_mcm.contacts.contact_store import ContactStore
from auv_mcm.contacts.coverage_store import CoverageStore
from auv_mcm.contacts.operating_point import MarkedContacts
from auv_mcm.contacts.record_file import open_record_file
from auv_mcm.errors import AuvMcmError, HardwareError, first_of
from auv_mcm.program import made_with
from auv_mcm.records import Contact, EarlyContact, Ping, SourceEvent, contact_number
from auv_mcm.settings.config import Config
from auv_mcm.shell.announcements import CLUTTER, NO_CLUTTER, Announcements
from auv_mcm.shell.capacity import no_kernels, room_for_tiles, work_shed
from auv_mcm.shell.checkpoint import Keeping, newest_checkpoint
from auv_mcm.shell.event_queue import EventQueue
from auv_mcm.shell.event_spool import EventSpool
from auv_mcm.shell.health.judge import Measured
from auv_mcm.shell.health.measure import measure_computer, measure_process, perception_process
from auv_mcm.shell.health.watch import HealthWatch
from auv_mcm.shell.lasting_perception import LastingPerception
from auv_mcm.shell.mission_totals import clearance_notices, notice_lists
from auv_mcm.shell.perception_chain import MakePipeline, standard_pipeline
from auv_mcm.shell.perception_messages import Finished, Planned
from auv_mcm.shell.recovery import (
    LOST_PINGS,
    RECORDING,
    RECORDS,
    STATE,
    SUMMARY,
    Ballast,
    SessionMemory,
    all_synced,
    all_written,
    in_recording,
    pings_lost,
    remove_state,
    results_missing,
    write_memory,
)
from auv_mcm.shell.results import MissionResults, plan_waypoints
from auv_mcm.shell.service_manager import feed_watchdog, report
from auv_mcm.shell.session import AnnouncedBefore, keep_session, open_session
from auv_mcm.shell.sources import start_recording
from auv_mcm.shell.tally import Tally
from auv_mcm.shell.vehicle_link import VehicleLink
from auv_mcm.shell.whole_files import write_json
from auv_mcm.source import LiveSource, Recorder, Source

log = logging.getLogger(__name__)

_NO_END: Final = "perception did not come to its end"
_REMEMBER_S: Final = 5.0  # s between two writes of what a restart has to know of this process
_CLOSE_S: Final = 2.0  # s of a stop for the vehicle's last word and for the results
_STOP_S: Final = 2.0  # for a live source to close its ports
_ATTEND_S: Final = 0.5  # s between two updates of the vehicle


class Service:
    """Run one mission, from opening the source to the last file.

    `console` takes a line per notice and per contact that is not clutter.
    """

    def __init__(
        self,
        config: Config,
        source: Source,
        *,
        clock: Clock | None = None,
        console: Callable[[str], None] = print,
        make_pipeline: MakePipeline = standard_pipeline,
    ) -> None:
        self._config = config
        self._source = source
        self._clock: Clock = clock or SystemClock()
        self._console = console
        self._make_pipeline = make_pipeline
        self._counters: Counter[str] = Counter()
        self._tally = Tally()
        self._stop = asyncio.Event()
        self._source_failure: AuvMcmError | None = None
        self._is_ready = False
        self._finished: Finished | None = None  # the last answer of perception
        self._recorder: Recorder | None = None
        self._vehicle_link: VehicleLink | None = None
        self._n_dropped_reported = self._n_lost_reported = 0
        self._disk = ThreadPoolExecutor(1, "disk")
        self._starting: asyncio.Task[None] | None = None
        self._publishing: asyncio.Task[None] | None = None
        self._is_cut_short = False
        self._is_late = False  # the time to stop is over

    def stop(self) -> None:
        """Stop the source; `run` then works off the queue, writes everything and returns."""
        self._stop.set()

    async def run(self) -> Path:
        """Serve until the source ends or `stop` is called. Returns the folder with the results.

        Raises AuvMcmError; a failure of the source or of perception only after what is known has been written.
        """
        await self._open()
        failure: AuvMcmError | None = None
        missing: HardwareError | None = None
        try:
            self._say(*self._session.notices, *([no_kernels()] if kernels.backend() == "numpy" else []))
            self._say(*await self._health.open())
            await self._show_health()
            async with asyncio.TaskGroup() as tasks:
                await self._work(tasks)
        except* AuvMcmError as group:
            failure = first_of(group)
        finally:
            self._health.close()
            try:
                await self._part_from_vehicle(failure or self._source_failure)
            finally:
                missing = self._close()
                # What cannot go on as it was is not tried again; what was cut short is.
                if failure or (self._finished is not None and not missing and not self._source_failure):
                    remove_state(self._folder)
        if failure := failure or self._source_failure or missing:
            raise failure
        return self._folder

    async def _open(self) -> None:
        """Begin the session, or go on with the last one, and open what stays open until its end."""
        service = self._config.service
        may_resume = isinstance(self._source, LiveSource)
        session = open_session(Path(service.output_directory), self._config, self._clock, may_resume=may_resume)
        self._session, self._folder, self._memory = session, session.folder, session.memory
        self._counters.update(session.memory.counters)
        kept = self._folder / STATE
        with contextlib.suppress(OSError):  # a disk that is full is reported by who writes what matters
            kept.mkdir(exist_ok=True)
            (self._folder / SUMMARY).unlink(missing_ok=True)  # of a run before: the session has not ended
            write_memory(self._folder, self._memory)
        self._started_s = self._clock.monotonic_s()
        self._announcements = Announcements(session, self._counters, self._clock, self._console, self._on_disk)
        self._say = self._announcements.announce
        self._health = HealthWatch(self._folder, service, self._clock)
        self._records = open_record_file(kept / RECORDS)
        self._contacts, self._coverage = ContactStore(self._records), CoverageStore(self._records)
        self._ballast = await asyncio.to_thread(Ballast, self._folder)
        self._queue = EventQueue(service.queue_pings, self._counters, self._see)
        self._spool = EventSpool(kept, newest_checkpoint(kept))
        self._announced_before = AnnouncedBefore(session, self._spool.last)
        self._perception = LastingPerception(
            self._config,
            self._make_pipeline,
            self._records,
            self._spool,
            Keeping(kept, self._memory.kind),
            self._add_up,
        )
        if before := session.announced.is_clutter:
            self._perception.reserve(max(map(contact_number, before)))

    async def _work(self, tasks: asyncio.TaskGroup) -> None:
        """Start everything, and work until all that came in is worked off."""
        self._starting = tasks.create_task(self._start())
        await asyncio.to_thread(self._start_recording)
        self._start_vehicle_link()
        tasks.create_task(self._take_in())  # events that come in while perception starts are not lost
        reporting = tasks.create_task(self._report_health())
        await asyncio.wait({self._starting})
        if self._starting.cancelled():  # the time to stop is over
            reporting.cancel()
            return
        gc.collect()
        gc.freeze()  # a collection would otherwise walk through every imported module and hold up the ports
        log.info("ready: source %s, results in %s", self._config.service.source or "given", self._folder)
        self._is_ready = True
        report("READY=1", f"STATUS=results in {self._folder}")
        attending = [feed_watchdog(), self._health.watch_lag(), self._remember()]
        if self._vehicle_link is not None:
            known = self._contacts.in_order() if self._memory.n_starts > 1 else ()
            attending += [self._attend_vehicle(self._vehicle_link), self._vehicle_link.report_again(known)]
        running = [reporting, *(tasks.create_task(each) for each in (*attending, self._feed()))]
        self._publishing = tasks.create_task(self._publish())
        if self._is_late:  # before perception had started
            self._end_publishing()
        await asyncio.wait({self._publishing})
        for task in running:
            task.cancel()
        await self._health.written()
        log.info("health %s", await self._show_health())  # as it ended, however short it was
        await self._health.written()

    async def _start(self) -> None:
        """Start perception and restore what its checkpoint holds."""
        started = await self._perception.start()
        if started.tally is not None:
            announced = frozenset(map(contact_number, self._session.announced.is_clutter))
            self._contacts.restore(started.contacts, announced)  # perception has others, which were never likely mines
            self._coverage.restore(started.coverage)
            self._tally = started.tally

    async def _remember(self) -> None:
        """Keep on disk what a restart has to know of this process."""
        while True:
            await self._write_memory()
            await asyncio.sleep(_REMEMBER_S)

    async def _write_memory(self) -> None:
        with contextlib.suppress(OSError):  # a disk that is full is reported by who writes what matters
            write_journals = self._announcements.write_journals
            await self._on_disk(partial(keep_session, self._folder, self._so_far(), write_journals))

    def _so_far(self) -> SessionMemory:
        return msgspec.structs.replace(
            self._memory,
            elapsed_s=self._memory.elapsed_s + self._clock.monotonic_s() - self._started_s,
            notices=tuple(self._announcements.notices),
            counters=dict(self._own_counters()),
            looks=self._memory.looks if self._vehicle_link is None else self._vehicle_link.so_far(),
        )

    def _close(self) -> HardwareError | None:
        """Write everything that is known. Returns an error that names what the disk did not take."""
        report("STOPPING=1", "STATUS=writing results", "WATCHDOG=1")  # the event loop stands still meanwhile
        self._perception.close()
        self._disk.submit(self._spool.close)  # while the recording is closed: both wait for the disk
        self._counters += self._perception.counters
        if self._recorder is not None:
            self._recorder.close()
            self._report_recording()
            if self._finished is None and self._recorder.counters["session.bytes_recorded"]:
                is_gone_on_with = self._is_cut_short and not self._memory.is_over
                why = "the stop came before all was worked off" if self._is_cut_short else _NO_END
                self._say(in_recording(self._folder, why, is_gone_on_with=is_gone_on_with))
        self._report_lost_pings()
        self._disk.shutdown()
        for contact, place in self._announcements.unannounced:  # the end came while the disk took them
            self._contacts.keep(contact, place)
            self._say(contact)
        with contextlib.suppress(OSError):
            self._folder.mkdir(parents=True, exist_ok=True)  # it may have been removed
        self._ballast.release()
        self._announcements.take_from_journal(self._contacts)
        try:
            missing = self._write()
        finally:
            self._records.close()
        self._announcements.close()
        return missing

    def _start_vehicle_link(self) -> None:
        if isinstance(self._source, LiveSource) and self._source.vehicle is not None:
            self._vehicle_link = VehicleLink(self._config, self._source.vehicle, self._clock)
            memory, announced = self._memory, self._session.announced.contacts
            self._vehicle_link.go_on(int(memory.started_s) & 0xFFFFFFFF, memory.n_starts - 1, announced, memory.looks)
            self._vehicle_link.start(self._source.serve_vehicle())

    async def _attend_vehicle(self, vehicle_link: VehicleLink) -> None:
        while True:
            self._say(*vehicle_link.attend(self._faults(), self._perception.ask))
            await asyncio.sleep(_ATTEND_S)

    def _faults(self) -> list[str]:
        """Give the payload's faults that the vehicle should know."""
        faults = self._source.faults() if isinstance(self._source, LiveSource) else []
        n_dropped, self._n_dropped_reported = self._n_dropped_reported, self._counters["service.ping_dropped"]
        if self._n_dropped_reported > n_dropped or 2 * self._n_waiting > self._config.service.queue_pings:
            faults.append("perception is behind")
        return faults + self._health.faults

    @property
    def _n_waiting(self) -> int:
        """Count pings that wait for perception."""
        return self._queue.pings + self._perception.pings_waiting

    async def _part_from_vehicle(self, failure: AuvMcmError | None) -> None:
        if self._vehicle_link is not None:
            reason = "the service ends" if failure is None else f"the service ends: {failure}"
            self._say(*await self._vehicle_link.part(reason))

    def _start_recording(self) -> None:
        if isinstance(self._source, LiveSource) and self._config.service.record:
            names = (RECORDING, *(f"{RECORDING}-{number}" for number in range(2, 10_000)))  # one per start
            folder = next(self._folder / name for name in names if not (self._folder / name).exists())
            self._recorder = start_recording(folder, self._config, self._clock)
            self._source.record_with(self._recorder.record)

    def _report_recording(self) -> None:
        if self._recorder is not None:
            self._say(*self._recorder.take_notices())

    async def _take_in(self) -> None:
        """Move events from source to queue, until the source ends or the service is stopped."""
        reading = asyncio.ensure_future(self._source.run(self._queue))
        stopping = asyncio.ensure_future(self._stop.wait())
        try:
            await asyncio.wait({reading, stopping}, return_when=asyncio.FIRST_COMPLETED)
            if not reading.done():
                log.info("stopping: %d pings still queued", self._queue.pings)
                if self._vehicle_link is not None:
                    self._vehicle_link.release("the service is being stopped")
                if isinstance(self._source, LiveSource):
                    asyncio.get_running_loop().call_later(
                        self._config.service.stop_within_s - _CLOSE_S, self._end_publishing
                    )
                    self._source.stop()
                    await asyncio.wait({reading}, timeout=_STOP_S)
                reading.cancel()
                await asyncio.wait({reading})
            if not reading.cancelled() and (error := reading.exception()) is not None:
                # What came in before is worth working off; the failure is raised at the end.
                log.error("the source failed: %s", error, exc_info=None if isinstance(error, AuvMcmError) else error)
                self._source_failure = (
                    error if isinstance(error, AuvMcmError) else HardwareError(f"the source failed: {error!r}")
                )
        finally:
            reading.cancel()
            stopping.cancel()
            self._queue.close()

    def _end_publishing(self) -> None:
        """End the mission before all is worked off; what is left stays on disk."""
        self._is_late = True
        for task in (self._starting, self._publishing):
            if task is not None and not task.done():
                self._is_cut_short = True
                task.cancel()

    def _see(self, event: SourceEvent) -> int:
        """Keep an event and show it to the vehicle link as it comes, however long it waits for perception."""
        if self._vehicle_link is not None:
            self._vehicle_link.see(event)
        return self._spool.append(event)

    async def _feed(self) -> None:
        try:
            while (queued := await self._queue.get()) is not None:
                try:
                    await self._perception.feed(queued, self._room(queued.event), is_patient=self._source.lossless)
                except ValueError as error:
                    self._counters["service.ping_too_large"] += 1
                    log.error("ping skipped: %s", error)
            await self._perception.finish()
        except AuvMcmError:
            return  # what perception answered before it failed comes first; _publish meets the failure in its turn

    def _room(self, event: SourceEvent) -> float:
        """Give the room for work on tiles. A source that waits for perception never drops a ping: nothing is shed."""
        if self._source.lossless or not isinstance(event, Ping):
            return 1.0
        if (room := room_for_tiles(self._n_waiting, self._config.service.queue_pings)) < 1.0:
            self._counters["service.work_shed"] += 1
            if self._counters["service.work_shed"] == 1:
                self._say(work_shed(self._n_waiting))
        return room

    def _add_up(self, event: SourceEvent) -> None:
        """Take an event that perception has."""
        self._tally.add(event)
        if self._tally.pings == 1 and isinstance(event, Ping):
            log.info("first ping: %s", event.place or event.number)

    async def _publish(self) -> None:
        """Write answers of perception to the journal, then to the console."""
        while not isinstance(answer := await self._perception.answer(), Finished):
            if isinstance(answer, Planned):
                if self._vehicle_link is not None:
                    self._vehicle_link.take(answer.proposal)
                continue
            contacts = [event for event in answer.events if isinstance(event, Contact)]
            early = [event for event in answer.events if isinstance(event, EarlyContact)]
            news = [event for event in answer.events if not self._announced_before.has(answer.number, event)]
            if contacts or early:
                await asyncio.to_thread(self._spool.flush)  # a restart comes to the same contacts
            if contacts and answer.number > self._perception.given:
                self._memory = msgspec.structs.replace(self._memory, is_over=True)
                await self._write_memory()  # what lies in the last tile is not to be found again in a longer one
            if contacts:
                await self._announcements.keep_contacts(news, answer)
                for contact in contacts:
                    self._contacts.keep(contact, answer.places.get(contact_number(contact.id)))
                if self._vehicle_link is not None:
                    self._vehicle_link.report(contacts)
            if early:
                await self._announcements.keep_early(news, answer.number)
                if self._vehicle_link is not None:
                    self._vehicle_link.report_early(early)
            for patch in answer.patches:
                self._coverage.keep(patch)
            self._say(*news)
        self._finished = answer
        self._say(*clearance_notices(answer.clearance))

    async def _on_disk(self, write: Callable[[], None]) -> None:
        """Run a write beside the event loop: a slow disk must not hold up the ports."""
        await asyncio.get_running_loop().run_in_executor(self._disk, write)

    def _report_lost_pings(self) -> None:
        """Report pings that did not come to perception, whatever the cause: the first, and each time ten times more."""
        n_lost = sum(self._counters[name] for name in LOST_PINGS)
        if n_lost >= max(1, 10 * self._n_lost_reported):
            self._n_lost_reported = n_lost
            self._say(pings_lost({name: self._counters[name] for name in LOST_PINGS}, self._recorder is not None))

    async def _report_health(self) -> None:
        while True:
            await asyncio.sleep(self._config.service.health_period_s)
            self._report_recording()
            self._report_lost_pings()
            line = await self._show_health()
            log.log(logging.WARNING if self._health.is_fault else logging.INFO, "health %s", line)
            report(f"STATUS={line}")

    async def _show_health(self) -> str:
        """Measure and judge how the payload is, and hand that to monitors. Returns the health line."""
        return self._health.show(await self._measure())

    async def _measure(self) -> Measured:
        now_s = self._clock.monotonic_s()
        link, as_what = self._vehicle_link, self._announcements.as_what
        return Measured(
            now_s=now_s,
            uptime_s=now_s - self._started_s,
            is_ready=self._is_ready,
            has_kernels=kernels.backend() == "c",
            late_s=self._health.late_s,
            pings=self._tally.pings,
            queue_pings=self._n_waiting,
            queue_limit=self._config.service.queue_pings,
            in_flight=self._perception.in_flight,
            pings_in_flight=self._perception.pings_in_flight,
            waits_on_purpose=self._source.lossless,
            contacts=as_what.count(NO_CLUTTER),
            clutter=as_what.count(CLUTTER),
            counters=self._counters
            + self._perception.counters
            + (Counter() if self._recorder is None else self._recorder.counters),
            source=self._source.health() if isinstance(self._source, LiveSource) else None,
            is_recording=self._recorder is not None,
            vehicle=None if link is None else link.measured(),
            service=measure_process(os.getpid()),
            perception=measure_process(perception_process()),
            computer=await asyncio.to_thread(measure_computer, self._folder.parent),
        )

    def _write(self) -> HardwareError | None:
        """Write each result, whatever becomes of the others. Returns an error that names the missing ones."""
        contacts: Iterable[Contact] = self._contacts.in_order()
        finished = self._finished or Finished(Counter(), {}, None, None, b"")
        if (point := finished.operating_point) is not None:  # of the whole mission; those announced carry that of then
            contacts = MarkedContacts(contacts, point)
        link, config = self._vehicle_link, self._config
        proposed = None if link is None else link.plan
        waypoints = plan_waypoints(contacts, self._tally, config, self._counters) if proposed is None else proposed
        of_area = finished.clearance, finished.clearance_png
        results = MissionResults(contacts, self._coverage.in_order(), waypoints, self._tally, point, *of_area)
        writers = results.writers(self._folder, self._config.mission, durable=False)
        errors = all_written(writers) | all_synced(self._folder)
        if errors:
            self._say(results_missing(self._folder, errors))
        n_in_memory = self._contacts.n_in_memory + self._coverage.n_in_memory
        of_disk = Counter({"service.kept_in_memory": n_in_memory, "service.unreadable": self._records.n_unreadable})
        summary: dict[str, Any] = {
            **made_with(),
            "source": self._config.service.source,
            **results.totals(config.plan, "" if link is None else link.verdict),
            **({} if link is None else {"vehicle": link.health()}),
            "elapsed_s": round(self._so_far().elapsed_s, 3),
            "counters": dict(sorted((self._own_counters() + finished.counters + of_disk).items())),
            "places": finished.places,
            **notice_lists(self._announcements.notices),
        }
        errors |= all_written({SUMMARY: partial(write_json, self._folder / SUMMARY, summary)})
        return HardwareError(results_missing(self._folder, errors).text) if errors else None

    def _own_counters(self) -> Counter[str]:
        """Count everything but what perception counts."""
        counters = self._counters + self._source.counters() + Counter({"service.not_spooled": self._spool.n_lost})
        return counters if self._recorder is None else counters + self._recorder.counters
