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
import signal
import sys
from collections import Counter
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, Final

import msgspec

from auv_mcm import __version__, kernels
from auv_mcm.clearance.clearance_map import Clearance
from auv_mcm.clock import Clock, SystemClock
from auv_mcm.contacts.contact_store import ContactStore
from auv_mcm.contacts.coverage_store import CoverageStore
from auv_mcm.contacts.export import contact_feature, iso_time
from auv_mcm.contacts.operating_point import MarkedContacts, OperatingPoint
from auv_mcm.contacts.record_file import open_record_file
from auv_mcm.errors import AuvMcmError, HardwareError
from auv_mcm.records import Contact, EarlyContact, Notice, Ping, PipelineEvent, SourceEvent, contact_id, contact_number
from auv_mcm.settings.config import Config
from auv_mcm.shell.checkpoint import CHECKPOINT_S, Keeping, newest_checkpoint
from auv_mcm.shell.event_queue import EventQueue
from auv_mcm.shell.event_spool import EventSpool
from auv_mcm.shell.health.endpoint import HealthEndpoint
from auv_mcm.shell.health.files import HealthFiles
from auv_mcm.shell.health.judge import Measured, judge
from auv_mcm.shell.health.measure import measure_computer, measure_process, perception_process
from auv_mcm.shell.health.record import Health
from auv_mcm.shell.health.text import health_line
from auv_mcm.shell.journal import Journal
from auv_mcm.shell.journal_contacts import contacts_in
from auv_mcm.shell.journal_stream import is_journal, journal_console
from auv_mcm.shell.lasting_perception import LastingPerception
from auv_mcm.shell.mission_totals import (
    area_totals,
    clearance_notices,
    contact_totals,
    notice_lists,
    point_totals,
    search_totals,
)
from auv_mcm.shell.perception_chain import MakePipeline, standard_pipeline
from auv_mcm.shell.perception_messages import Finished, Planned
from auv_mcm.shell.recovery import (
    EARLY_JOURNAL,
    JOURNAL,
    LOST_PINGS,
    RECORDING,
    RECORDS,
    STATE,
    SUMMARY,
    Ballast,
    SessionMemory,
    all_written,
    in_journal,
    in_recording,
    pings_lost,
    remove_state,
    results_missing,
    write_memory,
)
from auv_mcm.shell.results import plan_waypoints, result_writers, write_clearance
from auv_mcm.shell.service_manager import feed_watchdog, report
from auv_mcm.shell.session import AnnouncedBefore, open_session
from auv_mcm.shell.snippet_files import Snippets
from auv_mcm.shell.sources import open_source, parse_source_uri, start_recording
from auv_mcm.shell.tally import Tally
from auv_mcm.shell.vehicle_link import VehicleLink
from auv_mcm.shell.whole_files import write_json
from auv_mcm.source import LiveSource, Recorder, Source

log = logging.getLogger(__name__)


_NO_END: Final = "perception did not come to its end"
_REMEMBER_S: Final = 5.0  # s between two writes of what a restart has to know of this process
_CLOSE_S: Final = 2.0  # s of a stop for the vehicle's last word and for the results
_STOP_S: Final = 2.0  # for a live source to close its ports
_LAG_PROBE_S: Final = 0.25  # s between two measurements of how late the event loop wakes
_ATTEND_S: Final = 0.5  # s between two updates of the vehicle
_SWITCH_S: Final = (
    5e-4  # for which the thread that records may hold up the event loop; Python's own 5 ms are a ping's whole allowance
)
_SHED_FROM, _SHED_ALL = 0.25, 0.5
"""Shares of the queue of pings: from the first on, work on tiles is shed; from the second on all but the cheapest pass.
Tiles take half a minute to come and a second to work off, which does not fill a quarter of the queue."""
_CLUTTER: Final = 1  # what a contact was announced as, one byte each
_NO_CLUTTER: Final = 2  # see _CLUTTER


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
        checkpoint_every_s: float = CHECKPOINT_S,
    ) -> None:
        self._checkpoint_every_s = checkpoint_every_s
        self._config = config
        self._source = source
        self._clock: Clock = clock or SystemClock()
        self._console = console
        self._make_pipeline = make_pipeline
        self._counters: Counter[str] = Counter()
        self._tally = Tally()
        self._announced_as = bytearray()  # by number of a contact: what it was announced as
        self._notices: list[Notice] = []
        self._stop = asyncio.Event()
        self._source_failure: AuvMcmError | None = None
        self._lag_s = 0.0
        self._is_ready = False
        self._measured: Measured | None = None
        self._newest_health: Health | None = None
        self._is_finished = False
        self._pipeline_counters: Counter[str] = Counter()
        self._places: dict[str, Any] = {}
        self._operating_point: OperatingPoint | None = None
        self._clearance: Clearance | None = None
        self._clearance_png = b""
        self._recorder: Recorder | None = None
        self._vehicle_link: VehicleLink | None = None
        self._n_dropped_reported = 0
        self._n_lost_reported = 0
        self._disk = ThreadPoolExecutor(1, "disk")
        self._publishing: asyncio.Task[None] | None = None
        self._is_cut_short = False
        self._is_late = False  # the time to stop is over
        self._early_journal: Journal | None = None  # begins with the first early contact

    def stop(self) -> None:
        """Stop the source; `run` then works off the queue, writes everything and returns."""
        self._stop.set()

    async def run(self) -> Path:
        """Serve until the source ends or `stop` is called. Returns the folder with the results.

        Raises AuvMcmError; a failure of the source or of perception only after what is known has been written.
        """
        session = open_session(
            Path(self._config.service.output_directory),
            self._config,
            self._clock,
            may_resume=isinstance(self._source, LiveSource),
        )
        self._folder, self._memory = session.folder, session.memory
        self._notices += session.memory.notices
        self._counters.update(session.memory.counters)
        self._clutter_before = session.announced.is_clutter
        for name, is_clutter in self._clutter_before.items():
            self._note_announced(contact_number(name), _CLUTTER if is_clutter else _NO_CLUTTER)
        kept = self._folder / STATE
        with contextlib.suppress(OSError):  # a disk that is full is reported by who writes what matters
            kept.mkdir(exist_ok=True)
            write_memory(self._folder, self._memory)
        self._started_s = self._clock.monotonic_s()
        journal = Journal(self._folder / JOURNAL)
        self._health_files = HealthFiles(self._folder)
        self._health_on_disk: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._health_on_disk.set_result(None)  # nothing is being written
        self._snippets = Snippets(self._folder)
        self._records = open_record_file(kept / RECORDS)
        self._contacts, self._coverage = ContactStore(self._records), CoverageStore(self._records)
        self._ballast = await asyncio.to_thread(Ballast, self._folder)
        queue = EventQueue(self._config.service.queue_pings, self._counters, self._see)
        self._spool = EventSpool(kept, newest_checkpoint(kept))
        self._announced_before = AnnouncedBefore(session, self._spool.last)
        perception = LastingPerception(
            self._config,
            self._make_pipeline,
            self._records,
            self._spool,
            Keeping(kept, self._memory.kind, self._checkpoint_every_s),
            self._add_up,
        )
        if self._clutter_before:
            perception.reserve(max(map(contact_number, self._clutter_before)))
        endpoint = HealthEndpoint(self._config.service.health_port, lambda: self._newest_health)
        failure: AuvMcmError | None = None
        missing: HardwareError | None = None
        try:
            for notice in session.notices:
                self._announce(notice)
            if kernels.backend() == "numpy":
                self._announce(_no_kernels())
            await self._open(endpoint)
            await self._show_health(queue, perception)
            async with asyncio.TaskGroup() as tasks:
                starting = tasks.create_task(self._start(perception))
                await asyncio.to_thread(self._start_recording)
                self._start_vehicle_link()
                tasks.create_task(self._take_in(queue))  # events that come in while perception starts are not lost
                await starting
                gc.collect()
                gc.freeze()  # a collection would otherwise walk through every imported module and hold up the ports
                log.info("ready: source %s, results in %s", self._config.service.source or "given", self._folder)
                self._is_ready = True
                report("READY=1", f"STATUS=results in {self._folder}")
                health = [
                    tasks.create_task(feed_watchdog()),
                    tasks.create_task(self._watch_lag()),
                    tasks.create_task(self._report_health(queue, perception)),
                    tasks.create_task(self._remember()),
                ]
                if self._vehicle_link is not None:
                    health.append(tasks.create_task(self._attend_vehicle(self._vehicle_link, queue, perception)))
                    health.append(tasks.create_task(self._report_known(self._vehicle_link)))
                health.append(tasks.create_task(self._feed(queue, perception)))
                self._publishing = tasks.create_task(self._publish(perception, journal))
                if self._is_late:  # before perception had started
                    self._end_publishing()
                await asyncio.wait({self._publishing})
                for task in health:
                    task.cancel()
                await self._health_on_disk
                log.info("health %s", await self._show_health(queue, perception))  # as it ended, however short it was
                await self._health_on_disk
        except* AuvMcmError as group:
            failure = _first(group)
        finally:
            endpoint.close()
            self._health_files.close()
            try:
                await self._part_from_vehicle(failure or self._source_failure)
            finally:
                missing = self._close(perception, journal)
                # What cannot go on as it was is not tried again; what was cut short is.
                if failure or (self._is_finished and not missing and not self._source_failure):
                    remove_state(self._folder)
        if failure := failure or self._source_failure or missing:
            raise failure
        return self._folder

    async def _start(self, perception: LastingPerception) -> None:
        """Start perception and restore what its checkpoint holds."""
        started = await perception.start()
        if started.tally is not None:
            announced = frozenset(map(contact_number, self._clutter_before))
            self._contacts.restore(started.contacts, announced)  # perception has others, which were never likely mines
            self._coverage.restore(started.coverage)
            self._tally = started.tally

    async def _report_known(self, vehicle_link: VehicleLink) -> None:
        """Report to the vehicle what a run before has found; what it does not have for certain comes again."""
        if self._memory.n_starts == 1:
            return
        for contact in self._contacts.in_order():
            vehicle_link.report([contact])
            await asyncio.sleep(0.0)

    async def _remember(self) -> None:
        """Keep on disk what a restart has to know of this process."""
        while True:
            with contextlib.suppress(OSError):  # a disk that is full is reported by who writes what matters
                await self._on_disk(partial(write_memory, self._folder, self._so_far()))
            await asyncio.sleep(_REMEMBER_S)

    def _so_far(self) -> SessionMemory:
        return msgspec.structs.replace(
            self._memory,
            elapsed_s=self._memory.elapsed_s + self._clock.monotonic_s() - self._started_s,
            notices=tuple(self._notices),
            counters=dict(self._own_counters()),
            looks=self._memory.looks if self._vehicle_link is None else self._vehicle_link.so_far(),
        )

    def _close(self, perception: LastingPerception, journal: Journal) -> HardwareError | None:
        """Write everything that is known. Returns an error that names what the disk did not take."""
        report("STOPPING=1", "STATUS=writing results", "WATCHDOG=1")  # the event loop stands still meanwhile
        perception.close()
        self._spool.close()
        self._counters += perception.counters
        if self._recorder is not None:
            self._recorder.close()
            self._report_recording()
            if not self._is_finished and self._recorder.counters["session.bytes_recorded"]:
                why = "the stop came before all was worked off" if self._is_cut_short else _NO_END
                self._announce(in_recording(self._folder, why, is_gone_on_with=self._is_cut_short))
        self._report_lost_pings()
        self._disk.shutdown()
        with contextlib.suppress(OSError):
            self._folder.mkdir(parents=True, exist_ok=True)  # it may have been removed
        self._ballast.release()
        self._take_from_journal()
        try:
            missing = self._write()
        finally:
            self._records.close()
        for what, write in (
            ("contacts are missing from the journal", journal.close),
            ("early contacts are missing from their journal", self._close_early_journal),
            ("pictures of contacts are missing", self._snippets.write),
        ):
            try:
                write()
            except OSError as error:  # as on a full disk; what is known is still worth writing
                log.error("%s: %s", what, error)
        return missing

    def _take_from_journal(self) -> None:
        """Take contacts that were announced, and that the disk does not give back, from the journal."""
        unreadable = frozenset(self._contacts.unreadable())
        announced = [number for number, as_what in enumerate(self._announced_as) if as_what]
        lost = [number for number in announced if number in unreadable or number not in self._contacts]
        if not lost:
            return
        journalled: dict[int, Contact] = {}
        with contextlib.suppress(OSError):
            journalled = contacts_in(self._folder / JOURNAL, frozenset(lost))
        for contact in journalled.values():
            self._contacts.keep(contact, None)
        names = {number: contact_id(number) for number in lost}
        names |= {contact_number(name): name for name in self._clutter_before}
        names |= {number: contact.id for number, contact in journalled.items()}
        gone = [names[number] for number in lost if number not in journalled]
        self._announce(in_journal(self._folder, [names[number] for number in lost], gone))

    def _start_vehicle_link(self) -> None:
        if isinstance(self._source, LiveSource) and self._source.vehicle is not None:
            self._vehicle_link = VehicleLink(self._config, self._source.vehicle, self._clock)
            session = int(self._memory.started_s) & 0xFFFFFFFF
            self._vehicle_link.go_on(session, self._memory.n_starts - 1, self._memory.looks)
            self._vehicle_link.start(self._source.serve_vehicle())

    async def _attend_vehicle(
        self, vehicle_link: VehicleLink, queue: EventQueue, perception: LastingPerception
    ) -> None:
        while True:
            for notice in vehicle_link.attend(self._faults(queue, perception), perception.ask):
                self._announce(notice)
            await asyncio.sleep(_ATTEND_S)

    def _faults(self, queue: EventQueue, perception: LastingPerception) -> list[str]:
        """Give the payload's faults that the vehicle should know."""
        faults = self._source.faults() if isinstance(self._source, LiveSource) else []
        n_dropped, self._n_dropped_reported = self._n_dropped_reported, self._counters["service.ping_dropped"]
        n_waiting = queue.pings + perception.pings_waiting
        if self._n_dropped_reported > n_dropped or 2 * n_waiting > self._config.service.queue_pings:
            faults.append("perception is behind")
        return faults

    async def _part_from_vehicle(self, failure: AuvMcmError | None) -> None:
        if self._vehicle_link is not None:
            for notice in await self._vehicle_link.part(
                "the service ends" if failure is None else f"the service ends: {failure}"
            ):
                self._announce(notice)

    def _start_recording(self) -> None:
        if not isinstance(self._source, LiveSource) or not self._config.service.record:
            return
        names = (RECORDING, *(f"{RECORDING}-{number}" for number in range(2, 10_000)))  # one per start
        folder = next(self._folder / name for name in names if not (self._folder / name).exists())
        self._recorder = start_recording(folder, self._config, self._clock)
        self._source.record_with(self._recorder.record)

    def _report_recording(self) -> None:
        if self._recorder is not None:
            for notice in self._recorder.take_notices():
                self._announce(notice)

    async def _take_in(self, queue: EventQueue) -> None:
        """Move events from source to queue, until the source ends or the service is stopped."""
        reading = asyncio.ensure_future(self._source.run(queue))
        stopping = asyncio.ensure_future(self._stop.wait())
        try:
            await asyncio.wait({reading, stopping}, return_when=asyncio.FIRST_COMPLETED)
            if not reading.done():
                log.info("stopping: %d pings still queued", queue.pings)
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
            queue.close()

    def _end_publishing(self) -> None:
        """End the mission before all is worked off; what is left stays on disk."""
        self._is_late = True
        if self._publishing is not None and not self._publishing.done():
            self._is_cut_short = True
            self._publishing.cancel()

    def _see(self, event: SourceEvent) -> int:
        """Keep an event and show it to the vehicle link as it comes, however long it waits for perception."""
        if self._vehicle_link is not None:
            self._vehicle_link.see(event)
        return self._spool.append(event)

    async def _feed(self, queue: EventQueue, perception: LastingPerception) -> None:
        try:
            while (queued := await queue.get()) is not None:
                try:
                    n_waiting = queue.pings + perception.pings_waiting
                    room = self._room(n_waiting) if isinstance(queued.event, Ping) else 1.0
                    await perception.feed(queued, room, is_patient=self._source.lossless)
                except ValueError as error:
                    self._counters["service.ping_too_large"] += 1
                    log.error("ping skipped: %s", error)
            await perception.finish()
        except AuvMcmError:
            return  # what perception answered before it failed comes first; _publish meets the failure in its turn

    def _add_up(self, event: SourceEvent) -> None:
        """Take an event that perception has."""
        self._tally.add(event)
        if self._tally.pings == 1 and isinstance(event, Ping):
            log.info("first ping: %s", event.place or event.number)

    def _room(self, n_waiting: int) -> float:
        """Give the share of the time that work on tiles may take, 0 to 1: less than 1 while perception is behind.

        A source that waits for perception never drops a ping, so that nothing needs to be shed.
        """
        filled = n_waiting / self._config.service.queue_pings
        if self._source.lossless or filled <= _SHED_FROM:
            return 1.0
        self._counters["service.work_shed"] += 1
        if self._counters["service.work_shed"] == 1:
            self._announce(_work_shed(n_waiting))
        return max((_SHED_ALL - filled) / (_SHED_ALL - _SHED_FROM), 0.0)

    async def _publish(self, perception: LastingPerception, journal: Journal) -> None:
        """Write answers of perception to the journal, then to the console."""
        while not isinstance(answer := await perception.answer(), Finished):
            if isinstance(answer, Planned):
                if self._vehicle_link is not None:
                    self._vehicle_link.take(answer.proposal)
                continue
            contacts = [event for event in answer.events if isinstance(event, Contact)]
            early = [event for event in answer.events if isinstance(event, EarlyContact)]
            news = [event for event in answer.events if not self._announced_before.has(answer.number, event)]
            if contacts or early:
                await asyncio.to_thread(self._spool.flush)  # a restart comes to the same contacts
            if contacts:
                new = [event for event in news if isinstance(event, Contact)]
                await self._make_durable(new, answer.number, answer.snippets, journal)
                for contact in contacts:
                    self._contacts.keep(contact, answer.places.get(contact_number(contact.id)))
                if self._vehicle_link is not None:
                    self._vehicle_link.report(contacts)
            if early:
                new_early = [event for event in news if isinstance(event, EarlyContact)]
                await self._make_early_durable(new_early, answer.number)
                if self._vehicle_link is not None:
                    self._vehicle_link.report_early(early)
            for patch in answer.patches:
                self._coverage.keep(patch)
            for event in news:
                self._announce(event)
        self._is_finished = True
        self._pipeline_counters, self._places = answer.counters, answer.places
        self._operating_point = answer.operating_point
        self._clearance, self._clearance_png = answer.clearance, answer.clearance_png
        for notice in clearance_notices(self._clearance):
            self._announce(notice)

    async def _make_durable(
        self, contacts: list[Contact], number: int, snippets: dict[str, bytes], journal: Journal
    ) -> None:
        """Write contacts that came of an event to the journal, and pictures to their files."""
        now = iso_time(self._clock.utc_s())
        records = [{"time": now, "event": number, "contact": contact_feature(contact)} for contact in contacts]
        try:
            await self._on_disk(partial(journal.append, records))
        except OSError as error:
            # Contacts are announced even where the disk is full.
            self._counters["service.journal_failed"] += 1
            log.error(
                "contacts announced below are NOT on disk: %s: %s. Free space on the disk.",
                self._folder,
                error.strerror,
            )
        try:
            await self._on_disk(partial(self._snippets.write, snippets))
        except OSError as error:
            self._counters["service.snippets_failed"] += 1
            log.error(
                "pictures of contacts stay in memory: %s: %s. Free space on the disk.", self._folder, error.strerror
            )

    async def _make_early_durable(self, contacts: list[EarlyContact], number: int) -> None:
        now = iso_time(self._clock.utc_s())
        records = [
            {
                "time": now,
                "event": number,
                "state": early.state,
                "became": early.became,
                "contact": contact_feature(early.contact),
            }
            for early in contacts
        ]
        try:
            await self._on_disk(partial(self._append_early, records))
        except (OSError, AuvMcmError) as error:
            self._counters["service.early_journal_failed"] += 1
            log.error(
                "early contacts announced below are not on disk: %s: %s. Free space on the disk.", self._folder, error
            )

    def _append_early(self, records: list[dict[str, Any]]) -> None:
        if self._early_journal is None:
            self._early_journal = Journal(self._folder / EARLY_JOURNAL)
        self._early_journal.append(records)

    def _close_early_journal(self) -> None:
        if self._early_journal is not None:
            self._early_journal.close()

    async def _on_disk(self, write: Callable[[], None]) -> None:
        """Run a write beside the event loop: a slow disk must not hold up the ports."""
        await asyncio.get_running_loop().run_in_executor(self._disk, write)

    def _say(self, line: str) -> None:
        """Write a line to the console. One that went away, with its terminal or its disk, must not end the mission."""
        try:
            self._console(line)
        except (OSError, ValueError) as error:
            self._counters["service.console_failed"] += 1
            if self._counters["service.console_failed"] == 1:
                log.error("the console takes no more lines (%s); the results go on", error)

    def _announce(self, event: PipelineEvent) -> None:
        match event:
            case Contact():
                now = _CLUTTER if event.classification == "clutter" else _NO_CLUTTER
                before = self._note_announced(contact_number(event.id), now)
                if _NO_CLUTTER not in (before, now):
                    return  # in the journal and the results; a person watching needs the others
                word = "updated" if before else "new"
                self._say(
                    f"contact {event.id} {word}: {event.classification}, p_mine {event.p_mine:.2f}, "
                    f"{event.latitude_deg:.7f} {event.longitude_deg:.7f}, {len(event.views)} views"
                )
            case EarlyContact(contact=contact, state="found"):
                self._say(
                    f"early contact {contact.id}: {contact.classification}, p_mine {contact.p_mine:.2f}, "
                    f"{contact.latitude_deg:.7f} {contact.longitude_deg:.7f}"
                )
            case EarlyContact(contact=contact):
                self._say(f"early contact {contact.id} {'is ' + event.became if event.became else 'withdrawn'}")
            case Notice():
                self._notices.append(event)
                if event.for_the_record:
                    log.info("%s: %s", event.code, event.text)
                    return
                self._say(f"notice {event.code}: {event.text}" + (f" ({event.place})" if event.place else ""))

    def _note_announced(self, number: int, as_what: int) -> int:
        """Note what a contact is announced as; return as what it was before, 0 for a new one."""
        self._announced_as.extend(bytes(max(number + 1 - len(self._announced_as), 0)))
        before, self._announced_as[number] = self._announced_as[number], as_what
        return before

    async def _watch_lag(self) -> None:
        """Measure how late the loop wakes up: what a byte at a port waits."""
        while True:
            requested_s = self._clock.monotonic_s()
            await asyncio.sleep(_LAG_PROBE_S)
            self._lag_s = max(self._lag_s, self._clock.monotonic_s() - requested_s - _LAG_PROBE_S)

    async def _open(self, endpoint: HealthEndpoint) -> None:
        if not self._config.service.health_port:
            return
        try:
            await endpoint.open()
        except HardwareError as error:  # the mission does not need it
            self._announce(Notice(code="service.health_port", text=f"no health over HTTP: {error}"))

    def _report_lost_pings(self) -> None:
        """Report pings that did not come to perception, whatever the cause: the first, and each time ten times more."""
        n_lost = sum(self._counters[name] for name in LOST_PINGS)
        if n_lost >= max(1, 10 * self._n_lost_reported):
            self._n_lost_reported = n_lost
            self._announce(pings_lost({name: self._counters[name] for name in LOST_PINGS}, self._recorder is not None))

    async def _report_health(self, queue: EventQueue, perception: LastingPerception) -> None:
        while True:
            await asyncio.sleep(self._config.service.health_period_s)
            self._report_recording()
            self._report_lost_pings()
            line = await self._show_health(queue, perception)
            log.log(logging.WARNING if self._is_at_fault() else logging.INFO, "health %s", line)
            report(f"STATUS={line}")

    def _is_at_fault(self) -> bool:
        return self._newest_health is not None and self._newest_health.state == "fault"

    async def _show_health(self, queue: EventQueue, perception: LastingPerception) -> str:
        """Measure and judge how the payload is, and hand that to monitors. Returns the health line."""
        measured = await self._measure(queue, perception)
        before, self._measured, self._lag_s = self._measured or measured, measured, 0.0
        self._newest_health = health = Health(
            version=__version__,
            session=str(self._folder),
            utc_s=self._clock.utc_s(),
            period_s=self._config.service.health_period_s,
            parts=judge(measured, before),
        )
        if self._health_on_disk.done():  # a disk that hangs holds up no health line
            write = partial(self._health_files.write, health, measured.now_s)
            self._health_on_disk = asyncio.get_running_loop().run_in_executor(None, write)
        if "perception:perception_stalled" in health.reasons:
            log.warning("perception has taken no ping for %g s although pings wait", measured.now_s - before.now_s)
        return health_line(health)

    async def _measure(self, queue: EventQueue, perception: LastingPerception) -> Measured:
        now_s = self._clock.monotonic_s()
        link = self._vehicle_link
        return Measured(
            now_s=now_s,
            uptime_s=now_s - self._started_s,
            is_ready=self._is_ready,
            has_kernels=kernels.backend() == "c",
            late_s=self._lag_s,
            pings=self._tally.pings,
            queue_pings=queue.pings + perception.pings_waiting,
            queue_limit=self._config.service.queue_pings,
            in_flight=perception.in_flight,
            waits_on_purpose=self._source.lossless,
            contacts=self._announced_as.count(_NO_CLUTTER),
            clutter=self._announced_as.count(_CLUTTER),
            counters=self._counters
            + perception.counters
            + (Counter() if self._recorder is None else self._recorder.counters),
            source=self._source.health() if isinstance(self._source, LiveSource) else None,
            is_recording=self._recorder is not None,
            vehicle=None if link is None else link.health(),
            service=measure_process(os.getpid()),
            perception=measure_process(perception_process()),
            computer=await asyncio.to_thread(measure_computer, self._folder),
        )

    def _write(self) -> HardwareError | None:
        """Write each result, whatever becomes of the others. Returns an error that names the missing ones."""
        contacts: Iterable[Contact] = self._contacts.in_order()
        coverage = self._coverage.in_order()
        if self._operating_point is not None:  # of the whole mission; those announced carry what was known then
            contacts = MarkedContacts(contacts, self._operating_point)
        proposed = None if self._vehicle_link is None else self._vehicle_link.plan
        waypoints = (
            plan_waypoints(contacts, self._tally, self._config.plan, self._counters) if proposed is None else proposed
        )
        writers = result_writers(self._folder, contacts, coverage, waypoints, self._config.mission)
        writers["clearance.geojson"] = partial(write_clearance, self._folder, self._clearance, self._clearance_png)
        errors = all_written(writers)
        if errors:
            self._announce(results_missing(self._folder, errors))
        summary: dict[str, Any] = {
            "version": __version__,
            "kernels": kernels.backend(),
            "source": self._config.service.source,
            **self._tally.totals(),
            **contact_totals(contacts, coverage),
            **point_totals(self._operating_point),
            **search_totals(self._clearance, contacts),
            **area_totals(
                self._clearance, self._config.plan, "" if self._vehicle_link is None else self._vehicle_link.verdict
            ),
            "waypoints": len(waypoints),
            **({} if self._vehicle_link is None else {"vehicle": self._vehicle_link.health()}),
            "elapsed_s": round(self._so_far().elapsed_s, 3),
            "counters": dict(sorted(self._all_counters().items())),
            "places": self._places,
            **notice_lists(self._notices),
        }
        errors |= all_written({SUMMARY: partial(write_json, self._folder / SUMMARY, summary)})
        return HardwareError(results_missing(self._folder, errors).text) if errors else None

    def _all_counters(self) -> Counter[str]:
        n_in_memory = self._contacts.n_in_memory + self._coverage.n_in_memory
        of_disk = Counter({"service.kept_in_memory": n_in_memory, "service.unreadable": self._records.n_unreadable})
        return self._own_counters() + self._pipeline_counters + of_disk

    def _own_counters(self) -> Counter[str]:
        """Count everything but what perception counts."""
        counters = self._counters + self._source.counters() + Counter({"service.not_spooled": self._spool.n_lost})
        return counters if self._recorder is None else counters + self._recorder.counters


def serve(config: Config, *, clock: Clock | None = None, make_pipeline: MakePipeline = standard_pipeline) -> Path:
    """Run the service in this process until its source ends or a signal stops it; returns the folder with the results.

    clock: this computer's own if None.

    Raises AuvMcmError, or KeyboardInterrupt after a second signal.
    """
    sys.setswitchinterval(_SWITCH_S)
    clock = clock or SystemClock()
    source = open_source(parse_source_uri(config.service.source), config, clock)

    async def main() -> Path:
        console = journal_console(print) if is_journal(sys.stdout) else print
        service = Service(config, source, clock=clock, console=console, make_pipeline=make_pipeline)
        loop = asyncio.get_running_loop()
        serving = asyncio.ensure_future(service.run())
        signals = 0

        def on_signal(number: signal.Signals) -> None:
            nonlocal signals
            signals += 1
            if signals == 1:
                log.info("%s: finishing; once more to end at once", number.name)
                service.stop()
            else:
                log.warning("%s again: ending at once", number.name)
                serving.cancel()

        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):  # SIGHUP: the terminal is gone
            loop.add_signal_handler(number, on_signal, number)
        try:
            return await serving
        except asyncio.CancelledError:
            raise KeyboardInterrupt from None

    return asyncio.run(main())


def _work_shed(n_waiting: int) -> Notice:
    return Notice(
        code="service.work_shed",
        text=f"perception is behind, {n_waiting} pings wait: until it has caught up work on the least likely places of "
        "tiles is left out, which then earn less coverage. Set budget.duty to what this computer affords, which "
        "'auv-mcm calibrate budget' measures, or use coarser pixels. Pings with less work are counted.",
    )


def _no_kernels() -> Notice:
    return Notice(
        code="service.no_kernels",
        text="numpy does the work of the C kernels, which takes some twelve times the processor time: pings may be "
        f"lost. {kernels.loaded().reason}. Install the wheel with compiled kernels that deploy/wheelhouse.sh makes.",
    )


def _first(group: BaseExceptionGroup[AuvMcmError]) -> AuvMcmError:
    error: BaseException = group
    while isinstance(error, BaseExceptionGroup):
        error = error.exceptions[0]
    assert isinstance(error, AuvMcmError)
    return error
