"""Announce contacts and notices: on disk first, then on the console."""

from __future__ import annotations

import contextlib
import logging
from collections import Counter
from collections.abc import Awaitable, Callable, Iterable, Sequence
from functools import partial
from typing import Any, Final, TypeAlias

from auv_mcm.clock import Clock
from auv_mcm.contacts.contact_store import ContactStore
from auv_mcm.contacts.export import contact_feature, iso_time
from auv_mcm.contacts.record_file import RecordPlace
from auv_mcm.errors import AuvMcmError
from auv_mcm.records import Contact, EarlyContact, Notice, PipelineEvent, contact_id, contact_number
from auv_mcm.shell.journal import Journal
from auv_mcm.shell.journal_contacts import contacts_in
from auv_mcm.shell.perception_messages import Fed
from auv_mcm.shell.recovery import EARLY_JOURNAL, JOURNAL, in_journal
from auv_mcm.shell.session import Session
from auv_mcm.shell.snippet_files import Snippets

log = logging.getLogger(__name__)

OnDisk: TypeAlias = Callable[[Callable[[], None]], Awaitable[None]]
"""Runs a write beside the event loop: a slow disk must not hold up the ports."""

CLUTTER: Final = 1  # what a contact was announced as, one byte each
NO_CLUTTER: Final = 2  # see CLUTTER
# of one code, in a session: a unit that is slower than its valid_s is lost and back with each value, and all are kept
_MAX_NOTICES: Final = 200


class Announcements:
    """Keep contacts in their journals and pictures in their files, and print what a person has to know.

    notices: all so far, those of runs before among them. as_what: what each contact was announced as, by its number; 0
    for one that was not. unannounced: contacts that are in the journal, each with its place in the file of records.
    """

    def __init__(
        self, session: Session, counters: Counter[str], clock: Clock, console: Callable[[str], None], on_disk: OnDisk
    ) -> None:
        """counters: of what disk and console do not take."""
        self._folder = session.folder
        self._counters, self._clock, self._console, self._on_disk = counters, clock, console, on_disk
        self._journal = Journal(self._folder / JOURNAL)
        self._early_journal: Journal | None = None  # begins with the first early contact
        self._snippets = Snippets(self._folder)
        self._before = session.announced.is_clutter
        self.notices = list(session.memory.notices)
        self._n_notices = Counter(notice.code for notice in self.notices)
        self.as_what = bytearray()
        self.unannounced: list[tuple[Contact, RecordPlace | None]] = []
        for name, is_clutter in self._before.items():
            self._note(contact_number(name), CLUTTER if is_clutter else NO_CLUTTER)

    async def keep_contacts(self, news: Iterable[PipelineEvent], answer: Fed) -> None:
        """Write the contacts among the news of an answer to the journal, and its pictures to their files.

        Contacts are announced even where the disk is full.
        """
        contacts = [event for event in news if isinstance(event, Contact)]
        failed = "contacts announced below are NOT on disk"
        await self._keep(partial(self._append, contacts, answer), "service.journal_failed", failed)
        failed = "pictures of contacts stay in memory"
        await self._keep(partial(self._snippets.write, answer.snippets), "service.snippets_failed", failed)

    async def keep_early(self, news: Iterable[PipelineEvent], number: int) -> None:
        """Write the early contacts among the news, which came of event `number`, to the journal of their own."""
        now = iso_time(self._clock.utc_s())
        records = [
            {"time": now, "event": number, "state": early.state, "became": early.became}
            | {"contact": contact_feature(early.contact)}
            for early in news
            if isinstance(early, EarlyContact)
        ]
        failed = "early contacts announced below are not on disk"
        await self._keep(partial(self._append_early, records), "service.early_journal_failed", failed)

    async def _keep(self, write: Callable[[], None], counter: str, what_failed: str) -> None:
        try:
            await self._on_disk(write)
        except (OSError, AuvMcmError) as error:
            self._counters[counter] += 1
            why = error.strerror if isinstance(error, OSError) else error
            log.error("%s: %s: %s. Free space on the disk.", what_failed, self._folder, why)

    def _append(self, contacts: Sequence[Contact], answer: Fed) -> None:
        now = iso_time(self._clock.utc_s())
        self._journal.append(
            {"time": now, "event": answer.number, "contact": contact_feature(contact)} for contact in contacts
        )
        self.unannounced = [(contact, answer.places.get(contact_number(contact.id))) for contact in contacts]

    def _append_early(self, records: list[dict[str, Any]]) -> None:
        if self._early_journal is None:
            self._early_journal = Journal(self._folder / EARLY_JOURNAL)
        self._early_journal.append(records)

    def write_journals(self) -> None:
        """Write what the disk did not take of the journals. Raises OSError."""
        for journal in (self._journal, *([] if self._early_journal is None else [self._early_journal])):
            journal.write_owed()

    def _close_early(self) -> None:
        if self._early_journal is not None:
            self._early_journal.close()

    def take_from_journal(self, contacts: ContactStore) -> None:
        """Take contacts that were announced, and that the disk does not give back, from the journal."""
        unreadable = frozenset(contacts.unreadable())
        announced = [number for number, as_what in enumerate(self.as_what) if as_what]
        lost = [number for number in announced if number in unreadable or number not in contacts]
        if not lost:
            return
        journalled: dict[int, Contact] = {}
        with contextlib.suppress(OSError):
            journalled = contacts_in(self._folder / JOURNAL, frozenset(lost))
        for contact in journalled.values():
            contacts.keep(contact, None)
        names = {number: contact_id(number) for number in lost}
        names |= {contact_number(name): name for name in self._before}
        names |= {number: contact.id for number, contact in journalled.items()}
        gone = [names[number] for number in lost if number not in journalled]
        self.announce(in_journal(self._folder, [names[number] for number in lost], gone))

    def close(self) -> None:
        """Write what is still owed, and close the journals."""
        for what, write in (
            ("contacts are missing from the journal", self._journal.close),
            ("early contacts are missing from their journal", self._close_early),
            ("pictures of contacts are missing", self._snippets.write),
        ):
            try:
                write()
            except OSError as error:  # as on a full disk; what is known is still worth writing
                log.error("%s: %s", what, error)

    def announce(self, *events: PipelineEvent) -> None:
        """Print notices, and contacts that are not clutter; notices for the record go to the log alone."""
        for event in events:
            self._announce(event)

    def _announce(self, event: PipelineEvent) -> None:
        match event:
            case Contact():
                self.unannounced = [each for each in self.unannounced if each[0] is not event]
                now = CLUTTER if event.classification == "clutter" else NO_CLUTTER
                before = self._note(contact_number(event.id), now)
                if NO_CLUTTER not in (before, now):
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
                if not self._is_kept(event):
                    return
                self.notices.append(event)
                if event.for_the_record:
                    log.info("%s: %s", event.code, event.text)
                    return
                self._say(f"notice {event.code}: {event.text}" + (f" ({event.place})" if event.place else ""))

    def _is_kept(self, notice: Notice) -> bool:
        """Check whether a notice is kept and printed, or one of too many with the same code."""
        self._n_notices[notice.code] += 1
        n_more = self._n_notices[notice.code] - _MAX_NOTICES
        if n_more == 1:
            self._say(f"notice {notice.code}: further ones are only counted")
        self._counters["service.notices_not_kept"] += n_more > 0
        return n_more <= 0

    def _note(self, number: int, as_what: int) -> int:
        """Note what a contact is announced as; return as what it was before, 0 for a new one."""
        self.as_what.extend(bytes(max(number + 1 - len(self.as_what), 0)))
        before, self.as_what[number] = self.as_what[number], as_what
        return before

    def _say(self, line: str) -> None:
        """Write a line to the console. One that went away, with its terminal or its disk, must not end the mission."""
        try:
            self._console(line)
        except (OSError, ValueError) as error:
            self._counters["service.console_failed"] += 1
            if self._counters["service.console_failed"] == 1:
                log.error("the console takes no more lines (%s); the results go on", error)
