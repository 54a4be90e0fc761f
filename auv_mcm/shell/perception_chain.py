"""Run the pipeline in the perception process with all that belongs to it, and keep and restore their state."""

from __future__ import annotations

import contextlib
import math
import sys
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol, TypeAlias

import msgspec
import numpy as np

from auv_mcm.clean_text import clean_lines
from auv_mcm.clearance.clearance_map import Clearance, ClearanceMap
from auv_mcm.clearance.detection_performance import Performance, configured_performance
from auv_mcm.contacts.contact import best_view
from auv_mcm.contacts.contact_store import ContactStore
from auv_mcm.contacts.coverage_store import CoverageStore, StoredPatch, store_patch
from auv_mcm.contacts.operating_point import OperatingPoint
from auv_mcm.contacts.placed_records import PlacedRecords, Selection
from auv_mcm.contacts.record_file import RecordFile
from auv_mcm.frozen_state import StateError, freeze, thaw
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
from auv_mcm.shell.checkpoint import Keeping, read_checkpoints, write_checkpoint
from auv_mcm.shell.perception_messages import Fed, Finished, Started
from auv_mcm.shell.tally import Tally

if TYPE_CHECKING:
    from auv_mcm.contacts.ledger import Contacts
    from auv_mcm.plan.clear_area import ClearArea

_PLANNING_S: Final = 0.2  # of processor time for a plan to get better
_MAX_PLANNING_S: Final = 1.0  # while pings wait
_LONGEST_S: Final = 60.0  # s between two checkpoints where no tile comes, as with navigation alone
_NO_PICTURE: Final = np.empty((0, 0), dtype=np.uint8)
_NO_OUTLINE: Final = np.empty((0, 2))


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


class PerceptionChain:
    """Run the pipeline with the map of what was searched and the planning of an area.

    started: what it begins with: the newest sound checkpoint of the folder, or nothing. place: of the newest event that
    has one, for messages.
    """

    def __init__(
        self, config: Config, make_pipeline: MakePipeline, records: RecordFile, keeping: Keeping | None
    ) -> None:
        """records: for contacts and coverage. keeping: of checkpoints; None for none."""
        self._config = config
        self._records = records
        self._keeping = keeping
        self._store = ContactStore(records)
        self._performance = configured_performance(config)
        self.pipeline = make_pipeline(config, self._store)
        self._searched = ClearanceMap(self._performance, config.plan.area_deg)
        # What the map is made of. It lies in the file: in checkpoints, most of them would be it after some hours.
        self._seen = PlacedRecords(records, CoveragePatch)
        self._area = _clear_area(config, self._performance)
        self._coverage = CoverageStore(records)
        self._tally = Tally()
        self.started = self._restored() or Started(0)
        self.place = "at its start"
        self._kept_s = time.monotonic()
        self._is_disk_sound = True
        self._room = math.nan if self.started.number else 1.0

    def leave_room(self, room: float) -> None:
        """Leave the work on tiles that share of the time; see `Pipeline.leave_room`."""
        if room != self._room:
            self._room = room
            self.pipeline.leave_room(room)

    def feed(self, event: SourceEvent) -> Fed:
        """Feed the pipeline one event, and give the parent what it needs of what came of it."""
        self.place = getattr(event, "place", "") or self.place
        self._tally.add(event)
        if self._area is not None and isinstance(event, Ping):
            self._area.see(event)
        events = self.pipeline.feed(event)
        if self._is_disk_sound and self._store.n_in_memory:
            self._is_disk_sound = False
            events.append(_disk_full())
        return self._answer(events)

    def keep(self, patches: Iterable[StoredPatch]) -> None:
        """Keep coverage for checkpoints, once it was answered."""
        for patch in patches:
            self._coverage.keep(patch)

    def finish(self) -> Fed:
        """End the mission, and answer what was still in the chain."""
        return self._answer(self.pipeline.finish())

    def last_answer(self) -> Finished:
        """Sum up the mission that `finish` has ended."""
        clearance = self._searched.snapshot()
        of_disk = Counter(
            {"perception.kept_in_memory": self._store.n_in_memory, "perception.unreadable": self._records.n_unreadable}
        )
        png = b"" if clearance is None else _clearance_png(clearance)
        pipeline = self.pipeline
        return Finished(pipeline.counters + of_disk, pipeline.places, pipeline.operating_point, clearance, png)

    def propose(self, request: PlanRequest) -> Proposal:
        """Make a plan. Contacts matter more than plans: a planner that fails does not stop perception."""
        from auv_mcm.plan.propose import propose

        config, busy_s, late_s = self._config, time.thread_time() + _PLANNING_S, time.monotonic() + _MAX_PLANNING_S

        def more_time() -> bool:
            return time.thread_time() < busy_s and time.monotonic() < late_s

        try:
            asking = self.pipeline.asking(config.plan.min_p_mine)
            if self._area is not None:
                return self._area.propose(self._searched.snapshot(), asking, request, more_time)
            return propose(asking, request, config.plan, config.vehicle, more_time)
        except Exception as error:
            print(clean_lines(traceback.format_exc()), file=sys.stderr)
            return Proposal(
                (), (("any contact", f"planning failed: {error!r}. This is a defect: report it with the log."),)
            )

    def _answer(self, events: list[PipelineEvent]) -> Fed:
        """Give the parent what it needs of events. Cells of patches stay here, in the map of what was searched."""
        patches = [event for event in events if isinstance(event, CoveragePatch)]
        for patch in patches:
            self._searched.add(patch)
            cells = msgspec.structs.replace(patch, rings_deg=(), lost_m2={})
            self._seen.keep(len(self._seen), self._records.append(cells) or cells)
            if self._area is not None:
                self._area.add(patch)
        contacts = [event for event in events if isinstance(event, Contact)]  # which are in the store already
        places = {number: self._store.place(number) for number in (contact_number(each.id) for each in contacts)}
        return Fed(
            events=tuple(
                _without_pictures(event) for event in events if isinstance(event, Contact | EarlyContact | Notice)
            ),
            snippets=_snippets(contacts),
            places={number: place for number, place in places.items() if place is not None},
            patches=tuple(store_patch(self._records, patch) for patch in patches),
        )

    def is_checkpoint_due(self, is_after_tile: bool) -> bool:
        """Decide whether to write one. Least waits in the chain after a tile."""
        age_s = time.monotonic() - self._kept_s
        return self._keeping is not None and age_s >= (self._keeping.every_s if is_after_tile else _LONGEST_S)

    def checkpoint(self, number: int) -> Callable[[], bool]:
        """Give what writes one, as of now; it may be called beside the chain.

        It returns False if none is kept, or the disk does not take it: those before then have to serve.
        """
        if self._keeping is None:
            return lambda: False
        state = freeze(
            {
                "kind": self._keeping.kind,
                "records_end": self._records.end,
                "pipeline": self.pipeline.state(),
                "seen": self._seen.state(),
                "area": self._area,
                "contacts": self._store.state(),
                "coverage": self._coverage.state(),
                "tally": self._tally.state(),
            },
            self._constants(),
        )
        self._kept_s = time.monotonic()
        return partial(self._write, self._keeping.folder, number, state)

    def _write(self, folder: Path, number: int, state: bytes) -> bool:
        try:
            self._records.sync()
            write_checkpoint(folder, number, state)
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
                self._area = state["area"]
                self._seen.restore(state["seen"])
                for patch in Selection(self._seen.__getitem__, range(len(self._seen))):
                    self._searched.add(patch)
                self._store.restore(state["contacts"])
                self._coverage.restore(state["coverage"])
                self._tally.restore(state["tally"])
                return Started(number, state["contacts"], state["coverage"], self._tally)
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
