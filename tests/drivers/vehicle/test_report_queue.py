"""Over a link that loses, repeats and delays, the vehicle gets the latest report of every contact, and each revision
once."""

from __future__ import annotations

import math
from collections import Counter
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from auv_mcm.records import NAN, Contact, EarlyContact
from auv_mcm.source import AnnouncedContact
from drivers.vehicle.dialect import ContactReport
from drivers.vehicle.report_queue import MAX_CONTACTS, MAX_UNACKNOWLEDGED, DueReport, ReportQueue, report_of
from tests.auv_mcm.classify import drawn_looks


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
        "aspects_deg": (90.0,),
    }
    return drawn_looks.contact(**{**fields, **changes})


def empty_queue(*, acknowledges: bool = True) -> ReportQueue:
    return ReportQueue(session=7, min_p_mine=0.2, acknowledges=acknowledges)


def revisions(due: list[DueReport]) -> list[tuple[int, int]]:
    return [(report.number, report.revision) for report, _ in due]


def test_a_report_says_what_the_contact_is() -> None:
    covariance_m2 = np.array([[2.5, 1.5], [1.5, 2.5]])  # semi-axes 2 and 1, turned by 45 degrees
    report = report_of(contact(12, covariance_m2=covariance_m2, length_sigma_m=0.1), 7)
    assert (report.session, report.number, report.label) == (7, 12, "MLC-00012")
    assert report.sigma_m == pytest.approx(2.0)
    assert (report.length_m, report.length_sigma_m, report.n_views) == (2.0, 0.1, 0)
    assert math.isnan(report.height_m)
    assert math.isnan(report.depth_m)
    assert report_of(contact(12, views=(drawn_looks.detection(depth_m=21.5),)), 7).depth_m == 21.5


def test_a_change_replaces_the_report_that_is_still_pending() -> None:
    queue = empty_queue()
    queue.add(contact(1, 0.5))
    queue.add(contact(1, 0.7))
    (due,) = queue.take_due(0.0)
    assert (due.report.revision, due.report.p_mine) == (1, 0.7)
    assert queue.take_due(0.1) == []
    queue.add(contact(1, 0.8))
    (due,) = queue.take_due(0.2)
    assert (due.report.revision, due.report.p_mine) == (2, 0.8)


def test_an_unchanged_contact_is_not_sent_again() -> None:
    queue = empty_queue()
    queue.add(contact(1))
    (due,) = queue.take_due(0.0)
    queue.add(contact(1))
    queue.acknowledge(due.ticket)
    queue.add(contact(1, 0.6))
    queue.add(contact(1))
    assert queue.take_due(0.1) == []
    assert queue.n_pending == 0


def test_an_unlikely_mine_is_sent_only_to_correct_an_earlier_report() -> None:
    queue = empty_queue()
    queue.add(contact(1, 0.1))
    queue.add(contact(2, 0.5))
    queue.add(contact(2, 0.1))  # before it was sent
    queue.add(contact(3, 0.2))
    assert revisions(queue.take_due(0.0)) == [(3, 1)]
    queue.add(contact(3, 0.01))
    (due,) = queue.take_due(0.1)
    assert (due.report.number, due.report.revision, due.report.p_mine) == (3, 2, 0.01)
    queue.add(contact(2, 0.6))
    assert revisions(queue.take_due(0.2)) == [(2, 1)]


def test_an_unacknowledged_report_is_sent_again_after_the_link_was_lost() -> None:
    queue = empty_queue()
    for number in (1, 2, 3):
        queue.add(contact(number))
    first = queue.take_due(0.0)
    queue.acknowledge(first[1].ticket)
    queue.link_lost()
    again = queue.take_due(10.0)
    assert revisions(again) == [(1, 1), (3, 1)]
    assert not {due.ticket for due in first} & {due.ticket for due in again}


def test_without_acknowledgements_all_reports_are_sent_again_after_the_link_was_lost() -> None:
    queue = empty_queue(acknowledges=False)
    for number in range(20):
        queue.add(contact(number))
    sent = [pair for _ in range(5) for pair in revisions(queue.take_due(0.0))]
    assert sent == [(number, 1) for number in range(20)]
    assert queue.n_pending == 0
    queue.link_lost()
    queue.add(contact(99))
    assert queue.n_pending == 21
    assert revisions(queue.take_due(1.0))[0] == (99, 1)  # new reports go first
    assert sorted(pair for _ in range(5) for pair in revisions(queue.take_due(1.0)))[-1] == (19, 1)
    assert queue.n_pending == 0


def test_a_report_is_sent_again_after_thirty_seconds_without_an_answer() -> None:
    queue = empty_queue()
    queue.add(contact(1))
    (due,) = queue.take_due(0.0)
    assert queue.take_due(29.0) == []
    (again,) = queue.take_due(31.0)
    assert again.report == due.report
    assert again.ticket != due.ticket
    queue.acknowledge(due.ticket)  # too late: not awaited any more
    assert queue.n_pending == 1
    queue.acknowledge(again.ticket)
    assert queue.n_pending == 0


def test_a_change_before_the_answer_goes_out_once_and_answers_to_what_it_replaces_count_for_nothing() -> None:
    queue = empty_queue()
    queue.add(contact(1, 0.5))
    queue.take_due(0.0)
    queue.link_lost()
    queue.add(contact(1, 0.6))
    (replaced,) = queue.take_due(1.0)
    queue.add(contact(1, 0.7))
    (latest,) = queue.take_due(2.0)
    queue.acknowledge(replaced.ticket)
    assert (latest.report.revision, queue.counters["vehicle.reports_acknowledged"], queue.n_pending) == (3, 0, 1)


def test_a_rejected_revision_is_not_sent_again_and_a_later_one_is() -> None:
    queue = empty_queue()
    queue.add(contact(1))
    (due,) = queue.take_due(0.0)
    rejected = queue.reject(due.ticket)
    assert rejected is not None
    assert rejected.revision == 1
    assert queue.reject(due.ticket) is None
    queue.link_lost()
    queue.add(contact(1))
    assert queue.take_due(100.0) == []
    queue.add(contact(1, 0.95))
    assert revisions(queue.take_due(100.0)) == [(1, 2)]


def test_a_change_and_back_while_the_link_is_lost_repeats_the_unacknowledged_report() -> None:
    queue = empty_queue()
    queue.add(contact(1, 0.5))
    queue.take_due(0.0)
    queue.add(contact(1, 0.6))
    queue.link_lost()
    queue.add(contact(1, 0.5))
    assert revisions(queue.take_due(1.0)) == [(1, 1)]


def test_unacknowledged_reports_and_queued_contacts_are_bounded() -> None:
    queue = empty_queue()
    for number in range(MAX_CONTACTS + 5):
        queue.add(contact(number))
    n_sent = sum(len(queue.take_due(step / 10.0)) for step in range(100))
    assert n_sent == MAX_UNACKNOWLEDGED
    assert queue.n_pending == MAX_CONTACTS
    assert queue.counters["vehicle.reports_not_kept"] == 5


@pytest.mark.parametrize("acknowledges", [True, False])
def test_early_contacts_that_were_taken_back_cost_no_later_contact_its_place(acknowledges: bool) -> None:
    queue = empty_queue(acknowledges=acknowledges)

    def sends() -> None:
        while due := queue.take_due(0.0):
            for report in due:
                queue.acknowledge(report.ticket)

    views = (drawn_looks.detection(),)
    numbers = range(1, MAX_CONTACTS + 1)
    early = [EarlyContact(contact=contact(n, 0.6, id=f"E{n:05d}", views=views), state="found") for n in numbers]
    for each in early:
        queue.add(each.reported)
    sends()
    queue.add(contact(1))  # none is taken back yet
    assert queue.counters["vehicle.reports_not_kept"] == 1
    for each in early[:3]:
        queue.add(EarlyContact(contact=each.contact, state="withdrawn").reported)
    queue.add(contact(2))  # the vehicle does not know yet that they are
    assert queue.counters["vehicle.reports_not_kept"] == 2
    if acknowledges:
        queue.take_due(0.0)
        queue.add(contact(2))  # nor while its answers are awaited
        queue.link_lost()
        queue.add(contact(2))
    sends()
    for number in range(3, 7):
        queue.add(contact(number))
    assert revisions(queue.take_due(1.0)) == [(3, 1), (4, 1), (5, 1)]
    assert queue.counters["vehicle.reports_not_kept"] == 3 + 2 * acknowledges


def test_a_contact_without_a_position_is_not_sent() -> None:
    queue = empty_queue()
    queue.add(contact(1, latitude_deg=NAN))
    assert queue.take_due(0.0) == []
    assert queue.counters["vehicle.reports_without_place"] == 1


def test_tickets_wrap_around_and_skip_those_awaited() -> None:
    queue = empty_queue()
    queue.add(contact(1))
    (first,) = queue.take_due(0.0)
    tickets = set()
    changing = contact(2, 0.5), contact(2, 0.6)
    for turn in range(65_600):
        queue.add(changing[turn % 2])
        (due,) = queue.take_due(0.0)
        tickets.add(due.ticket)
        queue.acknowledge(due.ticket)
    assert tickets == set(range(1, 65_536)) - {first.ticket}


class FakeVehicle:
    """Keeps the latest revision of each contact, and checks that a repetition says the same."""

    def __init__(self) -> None:
        self.latest: dict[int, ContactReport] = {}
        self.seen: Counter[tuple[int, int, int]] = Counter()
        self.texts: dict[tuple[int, int, int], str] = {}

    def hear(self, report: ContactReport) -> None:
        key = (report.session, report.number, report.revision)
        assert self.texts.setdefault(key, repr(report)) == repr(report)  # a revision never changes
        if key not in self.seen and (
            report.number not in self.latest or self.latest[report.number].revision < report.revision
        ):
            self.latest[report.number] = report
        self.seen[key] += 1


EVENTS = st.lists(
    st.one_of(
        st.tuples(st.just("change"), st.integers(1, 6), st.sampled_from([0.05, 0.3, 0.6, 0.9])),
        st.tuples(st.sampled_from(["take", "lose", "answer", "swap", "link", "wait"]), st.integers(0, 5), st.just(0.0)),
    ),
    max_size=60,
)


@settings(max_examples=200, deadline=None)
@given(EVENTS, st.booleans())
def test_the_vehicle_ends_with_the_latest_of_every_contact(
    events: list[tuple[str, int, float]], acknowledges: bool
) -> None:
    """The oracle keeps the last p_mine of each contact, from the first that reached the threshold."""
    queue, vehicle = empty_queue(acknowledges=acknowledges), FakeVehicle()
    last: dict[int, float] = {}
    under_way: list[DueReport] = []
    answers: list[int] = []
    now_s = 0.0

    def arrive(due: DueReport) -> None:
        vehicle.hear(due.report)
        answers.append(due.ticket)

    for what, which, p_mine in events:
        if what == "change":
            queue.add(contact(which, p_mine))
            last[which] = p_mine
        elif what == "take":
            under_way += queue.take_due(now_s)
        elif what == "lose" and under_way and acknowledges:
            del under_way[which % len(under_way)]
        elif what == "swap" and under_way:
            arrive(under_way.pop(which % len(under_way)))
        elif what == "answer" and answers:
            queue.acknowledge(answers.pop(which % len(answers)))
        elif what == "link":
            under_way.clear()
            queue.link_lost()
        elif what == "wait":
            now_s += 10.0 * which
    for _ in range(20):  # a link that works
        under_way += queue.take_due(now_s)
        for due in under_way:
            arrive(due)
        under_way.clear()
        for ticket in answers:
            queue.acknowledge(ticket)
        answers.clear()
        now_s += 5.0
    assert queue.n_pending == 0
    for number, p_mine in last.items():
        if p_mine >= 0.2 or number in vehicle.latest:
            assert vehicle.latest[number].p_mine == p_mine
    assert all(report.revision >= 1 for report in vehicle.latest.values())


def test_an_early_contact_has_a_number_of_its_own_and_is_taken_back_by_a_revision() -> None:
    queue = empty_queue()
    early = EarlyContact(contact=contact(3, 0.6, id="E00003"), state="found")
    queue.add(early.reported)
    queue.add(contact(3, 0.6))
    assert revisions(queue.take_due(0.0)) == [(1_000_003, 1), (3, 1)]
    queue.add(EarlyContact(contact=early.contact, state="withdrawn").reported)
    (due,) = queue.take_due(0.1)
    assert (due.report.number, due.report.revision, due.report.p_mine, due.report.n_views) == (1_000_003, 2, 0.0, 0)
    assert due.report.classification == "unknown"


def test_after_a_restart_revisions_are_above_all_that_a_run_before_can_have_sent() -> None:
    queue = empty_queue()
    queue.go_on(3, 2, {1: AnnouncedContact(300, 0.5)})
    queue.add(contact(1, 0.5))
    queue.add(contact(2, 0.6))
    queue.add(EarlyContact(contact=contact(4, 0.6, id="E00004"), state="withdrawn").reported)  # it was found before
    assert revisions(queue.take_due(0.0)) == [(1, 557), (2, 257), (1_000_004, 257)]
    queue.add(contact(1, 0.7))
    (due,) = queue.take_due(0.1)
    assert (due.report.session, due.report.number, due.report.revision) == (3, 1, 558)


def test_after_a_restart_the_vehicle_hears_of_a_contact_that_is_no_longer_likely() -> None:
    queue = empty_queue()
    queue.go_on(3, 1, {1: AnnouncedContact(4, 0.6), 2: AnnouncedContact(1, 0.05)})
    queue.add(contact(1, 0.05))
    queue.add(contact(2, 0.05))
    (due,) = queue.take_due(0.0)
    assert (due.report.number, due.report.p_mine) == (1, 0.05)


def test_revisions_of_however_many_starts_fit_into_16_bits_and_come_once() -> None:
    sent = set()
    for n_starts in range(600):
        queue = empty_queue()
        queue.go_on(3, n_starts, {1: AnnouncedContact(1_000_000 * (n_starts > 300), 0.5)})
        queue.add(contact(1))
        (due,) = queue.take_due(0.0)
        assert due.report.revision + 127 <= 0xFFFF
        sent.add((due.report.session, due.report.revision))
    assert len(sent) == 600
