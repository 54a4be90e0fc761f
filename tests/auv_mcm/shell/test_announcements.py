"""What is announced, and what of it was announced before a restart: each contact under what it is taken for now."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from auv_mcm.contacts.export import contact_feature
from auv_mcm.records import Contact, ContactClass, EarlyContact, Notice, report_number
from auv_mcm.shell.announcements import CLUTTER, NO_CLUTTER, Announcements
from auv_mcm.shell.recovery import Announced, SessionMemory, read_announced
from auv_mcm.shell.session import AnnouncedBefore, Session
from auv_mcm.source import AnnouncedContact
from tests.auv_mcm.classify import drawn_looks
from tests.manual_clock import ManualClock

NOTHING = Announced(frozenset(), {}, {})


def session(folder: Path, announced: Announced = NOTHING, notices: tuple[Notice, ...] = ()) -> Session:
    memory = SessionMemory(kind="kind", started_s=0.0, n_starts=2, elapsed_s=9.0, notices=notices)
    return Session(folder, memory, announced, ())


@contextmanager
def announcing(of: Session) -> Iterator[tuple[Announcements, list[str]]]:
    said: list[str] = []

    async def on_disk(write: Callable[[], None]) -> None:
        write()

    with closing(Announcements(of, Counter(), ManualClock(), said.append, on_disk)) as book:
        yield book, said


def contact(name: str, classification: ContactClass = "sphere", p_mine: float = 0.9) -> Contact:
    return drawn_looks.contact(id=name, classification=classification, p_mine=p_mine)


def test_a_contact_is_said_as_long_as_it_is_no_clutter_and_once_more_as_it_becomes_it(tmp_path: Path) -> None:
    mine, clutter = contact("C00001"), contact("C00001", "clutter", 0.01)
    with announcing(session(tmp_path)) as (book, said):
        book.announce(contact("C00002", "clutter"), mine, clutter, clutter, mine)
    place = "43.0000000 10.0000000, 0 views"
    assert said == [
        f"contact C00001 new: sphere, p_mine 0.90, {place}",
        f"contact C00001 updated: clutter, p_mine 0.01, {place}",
        f"contact C00001 updated: sphere, p_mine 0.90, {place}",
    ]
    assert (book.as_what.count(NO_CLUTTER), book.as_what.count(CLUTTER)) == (1, 1)


def test_a_restart_knows_as_what_contacts_were_announced(tmp_path: Path) -> None:
    before = Announced(frozenset(), {"C00001": False, "C00002": True, "C00003": True}, {})
    with announcing(session(tmp_path, before)) as (book, said):
        assert (book.as_what.count(NO_CLUTTER), book.as_what.count(CLUTTER)) == (1, 2)
        book.announce(contact("C00001", "clutter"), contact("C00002", "clutter"), contact("C00003"))
    assert [line.partition(",")[0] for line in said] == [
        "contact C00001 updated: clutter",
        "contact C00003 updated: sphere",
    ]


def test_notices_of_runs_before_are_kept_and_count_among_those_that_may_be(tmp_path: Path) -> None:
    lost = Notice(code="nav_quantity_lost", text="lost")
    with announcing(session(tmp_path, notices=(lost,) * 199)) as (book, said):
        book.announce(lost, lost)
    assert book.notices == [lost] * 200
    assert [line.partition(": ")[2] for line in said] == ["lost", "further ones are only counted"]


def test_what_events_that_are_fed_again_give_was_announced_as_often_as_it_is_known(tmp_path: Path) -> None:
    known = frozenset({(3, "C00001", ""), (3, "E00001", "found")})
    notice = Notice(code="port_down", text="gone")
    before = AnnouncedBefore(session(tmp_path, Announced(known, {}, {}), (notice,) * 2), fed_again_to=5)
    found = EarlyContact(contact=contact("E00001"), state="found")
    withdrawn = EarlyContact(contact=contact("E00001"), state="withdrawn")
    for number, event, is_known in (
        (3, contact("C00001"), True),
        (4, contact("C00001"), False),
        (3, contact("C00002"), False),
        (3, found, True),
        (3, withdrawn, False),
        (4, found, False),
        (6, notice, False),
        (5, notice, True),
        (5, notice, True),
        (5, notice, False),
    ):
        assert before.has(number, event) is is_known


@pytest.mark.parametrize("torn", [b"", b'{"event":9,"contact":{"pro'])
def test_what_was_announced_is_read_from_both_journals(torn: bytes, tmp_path: Path) -> None:
    def line(event: int, one: Contact, state: str = "") -> bytes:
        return json.dumps(
            {"event": event, "state": state, "contact": contact_feature(one)}, separators=(",", ":")
        ).encode()

    damaged = line(7, contact("C00003", p_mine=0.2)).replace(b'"coordinates"', b"\0" * 13)
    journal = [line(3, contact("C00001")), line(5, contact("C00001", "clutter", 0.1)), damaged]
    journal += [line(4, contact("C00002", "clutter", 0.1)), line(6, contact("C00002", p_mine=0.6))]
    early = [line(2, contact("E00001", p_mine=0.6), "found"), line(3, contact("E00001", p_mine=0.6), "became")]
    (tmp_path / "contacts.jsonl").write_bytes(b"\n".join([*journal, torn]))
    (tmp_path / "early.jsonl").write_bytes(b"\n".join([*early, torn]))
    of_contacts = {(3, "C00001", ""), (5, "C00001", ""), (4, "C00002", ""), (6, "C00002", "")}
    assert read_announced(tmp_path) == Announced(
        frozenset(of_contacts | {(2, "E00001", "found"), (3, "E00001", "became")}),
        {"C00001": True, "C00002": False, "C00003": False},
        {
            1: AnnouncedContact(2, 0.9),
            2: AnnouncedContact(2, 0.6),
            3: AnnouncedContact(1, 1.0),
            report_number("E00001"): AnnouncedContact(2, 0.6),
        },
    )
