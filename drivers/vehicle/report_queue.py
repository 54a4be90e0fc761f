"""Contacts on their way to the vehicle: each in its latest revision, exactly once as the vehicle sees it.

A revision gets its number when it is told, not when it is known: what is known later before that takes its place. A report with the number
and revision of an earlier one is a repetition, and so nothing is lost by telling again whatever was not acknowledged.
"""

from __future__ import annotations

import math
from collections import Counter
from typing import Final, NamedTuple

import msgspec

from auv_mcm.contacts.contact import sigma_m
from auv_mcm.records import Contact, contact_number
from drivers.vehicle.dialect import ContactReport

MAX_CONTACTS: Final = 10_000
MAX_AWAITED: Final = 64  # acknowledgements, before new reports wait for them
_MAX_AWAITED_REPEATS: Final = 8  # as above, for what is told again: what is new comes first
_MAX_AT_ONCE: Final = 8  # without acknowledgements, so that a slow wire is not asked for more than it carries
_REPEAT_S: Final = 30.0  # with the link up all the time: the dialect has given up, or the answer was lost
_MAX_TICKET: Final = 65_535


class _Telling:
    """One contact. revision: told last, 0 for none."""

    def __init__(self, latest: ContactReport) -> None:
        self.latest = latest
        self.revision = 0
        self.told: ContactReport | None = None
        self.ticket: int | None = None  # awaited for the revision told last
        self.told_s = -math.inf


class Due(NamedTuple):
    """Tell this now."""

    report: ContactReport
    ticket: int


class Outbox:
    """Which reports are due. Holds at most 10,000 contacts, each once.

    session: of the run. min_p_mine: contacts less likely to be mines are not told, unless they were before. acknowledged: the vehicle says
    what it has got; if not, what was told is told again after every loss of the link.

    counters: vehicle.reports_told, .reports_repeated, .reports_acknowledged, .reports_rejected, .reports_not_kept (more than 10,000),
    .reports_without_place.
    """

    def __init__(self, *, session: int, min_p_mine: float, acknowledged: bool) -> None:
        self.counters: Counter[str] = Counter()
        self._session = session
        self._min_p_mine = min_p_mine
        self._acknowledged = acknowledged
        self._contacts: dict[int, _Telling] = {}
        self._new: dict[int, None] = {}  # numbers with something untold, in order
        self._again: dict[int, None] = {}  # numbers told, to be repeated, in order
        self._awaited: dict[int, int] = {}  # ticket: number
        self._last_ticket = 0

    @property
    def n_waiting(self) -> int:
        """Contacts of which the vehicle does not have, or has not acknowledged, the latest."""
        return len(self._new.keys() | self._again.keys() | set(self._awaited.values()))

    def tell(self, contact: Contact) -> None:
        """A contact that is new or has changed.

        Raises ValueError for an id that is not C and a number.
        """
        report = report_of(contact, self._session)
        telling = self._contacts.get(report.number)
        if not math.isfinite(report.latitude_deg + report.longitude_deg):
            self.counters["vehicle.reports_without_place"] += 1
            return
        if telling is None:
            if not report.p_mine >= self._min_p_mine:
                return
            if len(self._contacts) >= MAX_CONTACTS:
                self.counters["vehicle.reports_not_kept"] += 1
                return
            telling = self._contacts[report.number] = _Telling(report)
        telling.latest = report
        if telling.told is None and not report.p_mine >= self._min_p_mine:
            del self._contacts[report.number]
            self._new.pop(report.number, None)
        elif telling.told is not None and _same(report, telling.told):
            self._new.pop(report.number, None)
        else:
            self._new.setdefault(report.number)

    def take_due(self, now_s: float) -> list[Due]:
        """What to tell now, with the link up: new revisions first."""
        self._repeat_unanswered(now_s)
        due: list[Due] = []
        for numbers, room in ((self._new, MAX_AWAITED), (self._again, _MAX_AWAITED_REPEATS)):
            while numbers and len(due) < _MAX_AT_ONCE and len(self._awaited) < room:
                number = next(iter(numbers))
                self._new.pop(number, None)
                self._again.pop(number, None)
                due.append(self._tell(number, now_s))
        return due

    def acknowledged(self, ticket: int) -> None:
        """The vehicle has got it. Tickets that are not awaited mean nothing."""
        if self._answered(ticket) is not None:
            self.counters["vehicle.reports_acknowledged"] += 1

    def rejected(self, ticket: int) -> ContactReport | None:
        """The vehicle has refused it: it is not told again, though a later revision is. The report, if it was awaited."""
        telling = self._answered(ticket)
        if telling is None:
            return None
        self.counters["vehicle.reports_rejected"] += 1
        return telling.told

    def link_lost(self) -> None:
        """Whatever is under way is lost, and is told again."""
        numbers = self._awaited.values() if self._acknowledged else [n for n, telling in self._contacts.items() if telling.told is not None]
        for number in numbers:
            self._contacts[number].ticket = None
            self._again.setdefault(number)
        self._awaited.clear()

    def _repeat_unanswered(self, now_s: float) -> None:
        while self._awaited:
            ticket, number = next(iter(self._awaited.items()))
            telling = self._contacts[number]
            if now_s - telling.told_s <= _REPEAT_S:
                return
            del self._awaited[ticket]
            telling.ticket = None
            self._again.setdefault(number)

    def _tell(self, number: int, now_s: float) -> Due:
        telling = self._contacts[number]
        if telling.told is None or not _same(telling.latest, telling.told):
            telling.revision += 1
            telling.told = _revised(telling.latest, telling.revision)
            self.counters["vehicle.reports_told"] += 1
        else:
            self.counters["vehicle.reports_repeated"] += 1
        if telling.ticket is not None:
            del self._awaited[telling.ticket]  # of the revision before, which nobody needs any more
        ticket = self._free_ticket()
        telling.told_s = now_s
        if self._acknowledged:
            telling.ticket = ticket
            self._awaited[ticket] = number
        return Due(telling.told, ticket)

    def _free_ticket(self) -> int:
        """Tickets go round, so that those of answers that are late do not come again soon."""
        while True:
            self._last_ticket = self._last_ticket % _MAX_TICKET + 1
            if self._last_ticket not in self._awaited:
                return self._last_ticket

    def _answered(self, ticket: int) -> _Telling | None:
        number = self._awaited.pop(ticket, None)
        if number is None:
            return None
        telling = self._contacts[number]
        telling.ticket = None
        return telling


def report_of(contact: Contact, session: int) -> ContactReport:
    """A contact as it is told, revision 0. The depth of the sea floor is not known of contacts.

    Raises ValueError for an id that is not C and a number.
    """
    return ContactReport(
        session=session,
        number=contact_number(contact.id),
        revision=0,
        time_s=contact.time_s,
        latitude_deg=contact.latitude_deg,
        longitude_deg=contact.longitude_deg,
        sigma_m=sigma_m(contact),
        p_mine=contact.p_mine,
        classification=contact.classification,
        belief=dict(contact.belief),
        n_views=len(contact.views),
        length_m=contact.length_m,
        width_m=contact.width_m,
        height_m=contact.height_m,
        length_sigma_m=contact.length_sigma_m,
        width_sigma_m=contact.width_sigma_m,
        height_sigma_m=contact.height_sigma_m,
    )


def _revised(report: ContactReport, revision: int) -> ContactReport:
    return msgspec.structs.replace(report, revision=revision)


def _same(report: ContactReport, told: ContactReport) -> bool:
    """Whether they say the same. By their text: what is not known is the same as what was not known."""
    return repr(_revised(report, told.revision)) == repr(told)
