"""Over a link that loses, repeats and delays, the vehicle gets the latest of every contact, and each revision once."""

from __future__ import annotations

import math
from collections import Counter
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from auv_mcm.records import NAN, Contact
from drivers.vehicle.dialect import ContactReport
from drivers.vehicle.report_queue import MAX_AWAITED, MAX_CONTACTS, Due, Outbox, report_of


def contact(number: int, p_mine: float = 0.9, **changes: Any) -> Contact:
    fields: dict[str, Any] = {
        "id": f"C{number:05d}",
        "time_s": 1.7e9 + number,
        "latitude_deg": 54.0,
        "longitude_deg": 8.0,
        "covariance_m2": np.array([[4.0, 0.0], [0.0, 1.0]]),
        "p_mine": p_mine,
        "classification": "cylinder",
        "belief": {"cylinder": p_mine, "unknown": 1.0 - p_mine},
        "length_m": 2.0,
        "width_m": 0.5,
        "height_m": NAN,
        "aspects_deg": (90.0,),
        "reasons": (),
        "views": (),
    }
    return Contact(**{**fields, **changes})


def make(*, acknowledged: bool = True) -> Outbox:
    return Outbox(session=7, min_p_mine=0.2, acknowledged=acknowledged)


def revisions(due: list[Due]) -> list[tuple[int, int]]:
    return [(report.number, report.revision) for report, _ in due]


def test_a_report_says_what_the_contact_is() -> None:
    covariance_m2 = np.array([[2.5, 1.5], [1.5, 2.5]])  # semi-axes 2 and 1, turned by 45 degrees
    report = report_of(contact(12, covariance_m2=covariance_m2, length_sigma_m=0.1), 7)
    assert (report.session, report.number, report.label) == (7, 12, "MLC-00012")
    assert report.sigma_m == pytest.approx(2.0)
    assert (report.length_m, report.length_sigma_m, report.n_views) == (2.0, 0.1, 0)
    assert math.isnan(report.height_m)


def test_what_is_known_later_takes_the_place_of_what_was_not_yet_told() -> None:
    outbox = make()
    outbox.tell(contact(1, 0.5))
    outbox.tell(contact(1, 0.7))
    (due,) = outbox.take_due(0.0)
    assert (due.report.revision, due.report.p_mine) == (1, 0.7)
    assert outbox.take_due(0.1) == []
    outbox.tell(contact(1, 0.8))
    (due,) = outbox.take_due(0.2)
    assert (due.report.revision, due.report.p_mine) == (2, 0.8)


def test_nothing_new_is_not_told_again() -> None:
    outbox = make()
    outbox.tell(contact(1))
    (due,) = outbox.take_due(0.0)
    outbox.tell(contact(1))
    outbox.acknowledged(due.ticket)
    assert outbox.take_due(0.1) == []
    assert outbox.n_waiting == 0


def test_unlikely_mines_are_told_only_to_take_back_what_was_told() -> None:
    outbox = make()
    outbox.tell(contact(1, 0.1))
    outbox.tell(contact(2, 0.5))
    outbox.tell(contact(2, 0.1))  # before it was told
    outbox.tell(contact(3, 0.5))
    assert revisions(outbox.take_due(0.0)) == [(3, 1)]
    outbox.tell(contact(3, 0.01))
    (due,) = outbox.take_due(0.1)
    assert (due.report.number, due.report.revision, due.report.p_mine) == (3, 2, 0.01)
    outbox.tell(contact(2, 0.6))
    assert revisions(outbox.take_due(0.2)) == [(2, 1)]


def test_what_was_not_acknowledged_is_told_again_after_the_link_was_lost() -> None:
    outbox = make()
    for number in (1, 2, 3):
        outbox.tell(contact(number))
    first = outbox.take_due(0.0)
    outbox.acknowledged(first[1].ticket)
    outbox.link_lost()
    again = outbox.take_due(10.0)
    assert revisions(again) == [(1, 1), (3, 1)]
    assert not {due.ticket for due in first} & {due.ticket for due in again}


def test_without_acknowledgements_everything_told_is_told_again_after_the_link_was_lost() -> None:
    outbox = make(acknowledged=False)
    for number in range(20):
        outbox.tell(contact(number))
    told = [pair for _ in range(5) for pair in revisions(outbox.take_due(0.0))]
    assert told == [(number, 1) for number in range(20)]
    assert outbox.n_waiting == 0
    outbox.link_lost()
    outbox.tell(contact(99))
    assert outbox.n_waiting == 21
    assert revisions(outbox.take_due(1.0))[0] == (99, 1)  # what is new comes first
    assert sorted(pair for _ in range(5) for pair in revisions(outbox.take_due(1.0)))[-1] == (19, 1)
    assert outbox.n_waiting == 0


def test_a_lost_answer_is_waited_for_thirty_seconds() -> None:
    outbox = make()
    outbox.tell(contact(1))
    (due,) = outbox.take_due(0.0)
    assert outbox.take_due(29.0) == []
    (again,) = outbox.take_due(31.0)
    assert again.report == due.report
    assert again.ticket != due.ticket
    outbox.acknowledged(due.ticket)  # too late: nobody waits for it
    assert outbox.n_waiting == 1
    outbox.acknowledged(again.ticket)
    assert outbox.n_waiting == 0


def test_a_rejected_revision_is_never_told_again_and_a_later_one_is() -> None:
    outbox = make()
    outbox.tell(contact(1))
    (due,) = outbox.take_due(0.0)
    rejected = outbox.rejected(due.ticket)
    assert rejected is not None
    assert rejected.revision == 1
    assert outbox.rejected(due.ticket) is None
    outbox.link_lost()
    outbox.tell(contact(1))
    assert outbox.take_due(100.0) == []
    outbox.tell(contact(1, 0.95))
    assert revisions(outbox.take_due(100.0)) == [(1, 2)]


def test_a_change_and_back_while_the_link_is_lost_still_repeats_what_was_not_acknowledged() -> None:
    outbox = make()
    outbox.tell(contact(1, 0.5))
    outbox.take_due(0.0)
    outbox.tell(contact(1, 0.6))
    outbox.link_lost()
    outbox.tell(contact(1, 0.5))
    assert revisions(outbox.take_due(1.0)) == [(1, 1)]


def test_answers_awaited_and_contacts_kept_are_bounded() -> None:
    outbox = make()
    for number in range(MAX_CONTACTS + 5):
        outbox.tell(contact(number))
    told = sum(len(outbox.take_due(step / 10.0)) for step in range(100))
    assert told == MAX_AWAITED
    assert outbox.n_waiting == MAX_CONTACTS
    assert outbox.counters["vehicle.reports_not_kept"] == 5


def test_a_contact_without_a_place_is_not_told() -> None:
    outbox = make()
    outbox.tell(contact(1, latitude_deg=NAN))
    assert outbox.take_due(0.0) == []
    assert outbox.counters["vehicle.reports_without_place"] == 1


def test_tickets_go_round_and_pass_over_those_awaited() -> None:
    outbox = make()
    outbox.tell(contact(1))
    (first,) = outbox.take_due(0.0)
    tickets = set()
    changing = contact(2, 0.5), contact(2, 0.6)
    for turn in range(65_600):
        outbox.tell(changing[turn % 2])
        (due,) = outbox.take_due(0.0)
        tickets.add(due.ticket)
        outbox.acknowledged(due.ticket)
    assert tickets == set(range(1, 65_536)) - {first.ticket}


class FakeVehicle:
    """Keeps the latest revision of each contact; what it has heard before it acknowledges and forgets."""

    def __init__(self) -> None:
        self.latest: dict[int, ContactReport] = {}
        self.seen: Counter[tuple[int, int, int]] = Counter()
        self.texts: dict[tuple[int, int, int], str] = {}

    def hear(self, report: ContactReport) -> None:
        key = (report.session, report.number, report.revision)
        assert self.texts.setdefault(key, repr(report)) == repr(report)  # the same revision never says something else
        if key not in self.seen and (report.number not in self.latest or self.latest[report.number].revision < report.revision):
            self.latest[report.number] = report
        self.seen[key] += 1


EVENTS = st.lists(
    st.one_of(
        st.tuples(st.just("tell"), st.integers(1, 6), st.sampled_from([0.05, 0.3, 0.6, 0.9])),
        st.tuples(st.sampled_from(["take", "lose", "answer", "swap", "link", "wait"]), st.integers(0, 5), st.just(0.0)),
    ),
    max_size=60,
)


@settings(max_examples=200, deadline=None)
@given(EVENTS, st.booleans())
def test_the_vehicle_has_the_latest_of_every_contact_in_the_end(events: list[tuple[str, int, float]], acknowledged: bool) -> None:
    """The oracle is what a person would keep: the last word on each contact, from the first one that was likely enough to be told."""
    outbox, vehicle = make(acknowledged=acknowledged), FakeVehicle()
    last: dict[int, float] = {}
    under_way: list[Due] = []
    answers: list[int] = []
    now_s = 0.0

    def arrive(due: Due) -> None:
        vehicle.hear(due.report)
        answers.append(due.ticket)

    for what, which, p_mine in events:
        if what == "tell":
            outbox.tell(contact(which, p_mine))
            last[which] = p_mine
        elif what == "take":
            under_way += outbox.take_due(now_s)
        elif what == "lose" and under_way and acknowledged:
            del under_way[which % len(under_way)]
        elif what == "swap" and under_way:
            arrive(under_way.pop(which % len(under_way)))
        elif what == "answer" and answers:
            outbox.acknowledged(answers.pop(which % len(answers)))
        elif what == "link":
            under_way.clear()
            outbox.link_lost()
        elif what == "wait":
            now_s += 10.0 * which
    for _ in range(20):  # a link that works
        under_way += outbox.take_due(now_s)
        for due in under_way:
            arrive(due)
        under_way.clear()
        for ticket in answers:
            outbox.acknowledged(ticket)
        answers.clear()
        now_s += 5.0
    assert outbox.n_waiting == 0
    for number, p_mine in last.items():
        if p_mine >= 0.2 or number in vehicle.latest:
            assert vehicle.latest[number].p_mine == p_mine
    assert all(report.revision >= 1 for report in vehicle.latest.values())
