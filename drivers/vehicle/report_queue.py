"""Queue contact reports for the vehicle: each contact in its latest revision, exactly once as the vehicle sees it.

A revision gets its number when it is sent. A change that comes before that replaces what was pending. The vehicle takes
a report with the number and revision of an earlier one as a repetition, so a report that was not acknowledged can be
sent again without harm.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from typing import Final, NamedTuple

import msgspec

from auv_mcm.contacts.contact import depth_m, sigma_m
from auv_mcm.records import EARLY_NUMBERS, Contact, report_number
from auv_mcm.source import AnnouncedContact
from drivers.clocks import wire_delay_s
from drivers.vehicle.dialect import ContactReport

MAX_CONTACTS: Final = 10_000
"""Contacts reported in one mission; the others are counted as vehicle.reports_not_kept."""
MAX_UNACKNOWLEDGED: Final = 64
"""Reports sent and not acknowledged, before new ones wait."""
_MAX_UNACKNOWLEDGED_REPEATS: Final = 8  # as above, before repetitions wait: new reports go first
_MAX_AT_ONCE: Final = (
    8  # reports per call, so that a slow wire without acknowledgements is not asked for more than it carries
)
_REPEAT_S: Final = (
    30.0  # without an answer on a link that stays up: the dialect's own repetitions have ended, or the answer was lost
)
_REVISIONS_PER_START: Final = 128
"""Revisions that one run of a session may send of a contact beyond those announced on disk, before the next run's."""
_MAX_STARTS: Final = 255  # runs whose revisions 16 bits hold
_MAX_ANNOUNCED: Final = 32_767  # revisions, as above, that they hold beside
_NOT_ANNOUNCED: Final = AnnouncedContact(0, 0.0)
_BYTES_PER_REPORT: Final = 400
"""Bytes of a serial line for a report: twice what most take, so that commands and health find the other half free."""
_MAX_TICKET: Final = 65_535  # 16 bits on the bus; 0 stands for none


class _QueuedContact:
    """Hold what is known and what was sent of one contact.

    latest: as it is known. revision: sent last; sent: that report, at sent_s. ticket: of the acknowledgement that it
    awaits.
    """

    def __init__(self, latest: ContactReport, revision: int) -> None:
        self.latest = latest
        self.revision = revision
        self.sent: ContactReport | None = None
        self.ticket: int | None = None
        self.sent_s = -math.inf


class DueReport(NamedTuple):
    """Hold a report to send now. ticket: identifies its acknowledgement."""

    report: ContactReport
    ticket: int


class ReportQueue:
    """Decide which reports are due. Holds at most 10,000 contacts, each once.

    Early contacts that were taken back make room for others.

    counters: vehicle.reports_told (revisions sent), .reports_repeated, .reports_acknowledged, .reports_rejected,
    .reports_not_kept (more than 10,000 contacts), .reports_without_place.
    """

    def __init__(self, *, session: int, min_p_mine: float, acknowledges: bool, baud: int = 0) -> None:
        """Start with an empty queue.

        session: number of the run. min_p_mine: contacts less likely to be mines are reported only if an earlier
        revision was. acknowledges: the vehicle acknowledges reports; if not, all that was sent is sent again after
        every loss of the link. baud: of a serial line (0: another), which gets no more reports than it carries, and
        fewer unacknowledged ones, for their repetitions take room as well.
        """
        self.counters: Counter[str] = Counter()
        self._session = session
        self._min_p_mine = min_p_mine
        self._acknowledges = acknowledges
        self._every_s = wire_delay_s(_BYTES_PER_REPORT, baud or None)
        self._next_s = -math.inf  # when the line has room for a report
        self._max_unacknowledged = _MAX_UNACKNOWLEDGED_REPEATS if baud else MAX_UNACKNOWLEDGED
        self._contacts: dict[int, _QueuedContact] = {}
        self._pending: dict[int, None] = {}  # contact numbers with a revision to be sent, in order
        self._repeats: dict[int, None] = {}  # contact numbers whose last report is to be sent again, in order
        self._unacknowledged: dict[int, int] = {}  # contact numbers by ticket
        self._last_ticket = 0
        self._first_revision = 0  # less one
        self._announced: Mapping[int, AnnouncedContact] = {}  # by runs before
        self._goes_on = False  # with a session that other runs began

    def go_on(self, session: int, n_starts: int, announced: Mapping[int, AnnouncedContact]) -> None:
        """Go on with a session that other runs began; called before the first contact.

        What they sent is not known for certain. So each contact that was ever likely enough comes again under its
        number, with a revision above all that they can have sent. After 255 runs revisions begin again, with the next
        number of a session.

        Parameters
        ----------
        n_starts
            Runs of the session before this one.
        announced
            What they announced, by the number of a report.
        """
        n_rounds, n_before = divmod(n_starts, _MAX_STARTS)
        self._session = session + n_rounds
        self._first_revision = n_before * _REVISIONS_PER_START
        self._announced = announced
        self._goes_on = n_starts > 0

    @property
    def n_pending(self) -> int:
        """Count the contacts whose latest revision the vehicle does not have, or has not acknowledged."""
        return len(self._pending.keys() | self._repeats.keys() | set(self._unacknowledged.values()))

    def add(self, contact: Contact) -> None:
        """Queue a contact that is new or has changed. Raises ValueError for an id that is not C or E and a number."""
        report = report_of(contact, self._session)
        queued = self._contacts.get(report.number)
        if not math.isfinite(report.latitude_deg + report.longitude_deg):
            self.counters["vehicle.reports_without_place"] += 1
            return
        # A run before may have reported the early contact that this takes back.
        takes_back = self._goes_on and report.number > EARLY_NUMBERS and not report.n_views
        before = self._announced.get(report.number, _NOT_ANNOUNCED)
        is_wanted = takes_back or max(report.p_mine, before.p_mine) >= self._min_p_mine
        if queued is None:
            if not is_wanted:
                return
            if len(self._contacts) >= MAX_CONTACTS and not self._let_go_early():
                self.counters["vehicle.reports_not_kept"] += 1
                return
            queued = self._contacts[report.number] = _QueuedContact(
                report, self._first_revision + min(before.n_revisions, _MAX_ANNOUNCED)
            )
        queued.latest = report
        if queued.sent is None and not is_wanted:
            del self._contacts[report.number]
            self._pending.pop(report.number, None)
        elif queued.sent is not None and _is_unchanged(report, queued.sent):
            self._pending.pop(report.number, None)
        else:
            self._pending.setdefault(report.number)

    def take_due(self, now_s: float) -> list[DueReport]:
        """Take the reports to send now, with the link up: new revisions first."""
        self._repeat_unanswered(now_s)
        due: list[DueReport] = []
        self._next_s = max(self._next_s, now_s - self._every_s)
        for numbers, room in ((self._pending, self._max_unacknowledged), (self._repeats, _MAX_UNACKNOWLEDGED_REPEATS)):
            while numbers and len(due) < _MAX_AT_ONCE and len(self._unacknowledged) < room and self._next_s <= now_s:
                self._next_s += self._every_s
                number = next(iter(numbers))
                self._pending.pop(number, None)
                self._repeats.pop(number, None)
                due.append(self._send(number, now_s))
        return due

    def acknowledge(self, ticket: int) -> None:
        """Note that the vehicle has a report. A ticket that is not awaited is ignored."""
        if self._answered(ticket) is not None:
            self.counters["vehicle.reports_acknowledged"] += 1

    def reject(self, ticket: int) -> ContactReport | None:
        """Note that the vehicle rejected a report, and return it, or None if its ticket is not awaited.

        It is not sent again; a later revision is.
        """
        queued = self._answered(ticket)
        if queued is None:
            return None
        self.counters["vehicle.reports_rejected"] += 1
        return queued.sent

    def link_lost(self) -> None:
        """Queue for repetition whatever was on its way when the link was lost."""
        numbers = (
            self._unacknowledged.values()
            if self._acknowledges
            else [n for n, queued in self._contacts.items() if queued.sent is not None]
        )
        for number in numbers:
            self._contacts[number].ticket = None
            self._repeats.setdefault(number)
        self._unacknowledged.clear()

    def _let_go_early(self) -> bool:
        """Let go of the first early contact whose last revision, which takes it back, is with the vehicle."""
        for number, queued in self._contacts.items():
            if number <= EARLY_NUMBERS or queued.latest.n_views or queued.sent is None or queued.ticket is not None:
                continue
            if number not in self._pending and number not in self._repeats:
                del self._contacts[number]
                return True
        return False

    def _repeat_unanswered(self, now_s: float) -> None:
        while self._unacknowledged:
            ticket, number = next(iter(self._unacknowledged.items()))
            queued = self._contacts[number]
            if now_s - queued.sent_s <= _REPEAT_S:
                return
            del self._unacknowledged[ticket]
            queued.ticket = None
            self._repeats.setdefault(number)

    def _send(self, number: int, now_s: float) -> DueReport:
        """Give the latest report of a contact, as a new revision if it changed since the last."""
        queued = self._contacts[number]
        if queued.sent is None or not _is_unchanged(queued.latest, queued.sent):
            queued.revision += 1
            queued.sent = _revised(queued.latest, queued.revision)
            self.counters["vehicle.reports_told"] += 1
        else:
            self.counters["vehicle.reports_repeated"] += 1
        if queued.ticket is not None:
            del self._unacknowledged[queued.ticket]  # of the revision before, which is superseded
        ticket = self._free_ticket()
        queued.sent_s = now_s
        if self._acknowledges:
            queued.ticket = ticket
            self._unacknowledged[ticket] = number
        return DueReport(queued.sent, ticket)

    def _free_ticket(self) -> int:
        """Take the next ticket that is not awaited; one is not used again soon, in case its answer is late."""
        while True:
            self._last_ticket = self._last_ticket % _MAX_TICKET + 1
            if self._last_ticket not in self._unacknowledged:
                return self._last_ticket

    def _answered(self, ticket: int) -> _QueuedContact | None:
        """Stop awaiting a ticket; return its contact, None if it was not awaited."""
        number = self._unacknowledged.pop(ticket, None)
        if number is None:
            return None
        queued = self._contacts[number]
        queued.ticket = None
        return queued


def report_of(contact: Contact, session: int) -> ContactReport:
    """Make the report of a contact, revision 0.

    Raises ValueError for an id that is not C or E and a number.
    """
    return ContactReport(
        session=session,
        number=report_number(contact.id),
        revision=0,
        time_s=contact.time_s,
        latitude_deg=contact.latitude_deg,
        longitude_deg=contact.longitude_deg,
        sigma_m=sigma_m(contact),
        p_mine=contact.p_mine,
        classification=contact.classification,
        belief=dict(contact.belief),
        n_views=len(contact.views),
        depth_m=depth_m(contact),
        length_m=contact.length_m,
        width_m=contact.width_m,
        height_m=contact.height_m,
        length_sigma_m=contact.length_sigma_m,
        width_sigma_m=contact.width_sigma_m,
        height_sigma_m=contact.height_sigma_m,
    )


def _revised(report: ContactReport, revision: int) -> ContactReport:
    return msgspec.structs.replace(report, revision=revision)


def _is_unchanged(report: ContactReport, sent: ContactReport) -> bool:
    """Check whether two reports say the same. Compares their text, in which NaN equals NaN."""
    return repr(_revised(report, sent.revision)) == repr(sent)
