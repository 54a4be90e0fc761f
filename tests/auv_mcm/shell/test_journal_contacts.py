"""Contacts are read back from the journal as they were announced, whatever is damaged beside them."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import structs

from auv_mcm.contacts.export import contact_feature
from auv_mcm.records import Contact
from auv_mcm.shell.journal import Journal
from auv_mcm.shell.journal_contacts import JOURNALLED, contacts_in, id_in
from tests.auv_mcm.shell import fake_pipelines as fake

ALL = range(1 << 30)


def announced(number: int, p_mine: float = 0.5) -> Contact:
    """A contact of which every figure is another one."""
    sizes = {"length_m": 1.9, "width_m": 0.5, "height_m": 0.4}
    sigmas = {"length_sigma_m": 0.1, "width_sigma_m": 0.02, "height_sigma_m": 0.03}
    seen = {"aspects_deg": (12.0, math.nan), "belief": {"sphere": 0.25, "unknown": 0.75}, "latitude_deg": 43.5}
    covariance_m2 = np.array([[4.0, 0.5], [0.5, 1.0]])
    named = structs.replace(fake.contact(number), id=f"C{number:05d}", p_mine=p_mine, covariance_m2=covariance_m2)
    return structs.replace(named, **sizes, **sigmas, **seen)


def write(path: Path, numbers: range, p_mine: float = 0.5) -> None:
    journal = Journal(path)
    contacts = [announced(number, p_mine) for number in numbers]
    journal.append([{"time": None, "event": 1, "contact": contact_feature(contact)} for contact in contacts])
    journal.close()


def test_the_last_announcement_counts_and_its_numbers_are_those_of_the_results(tmp_path: Path) -> None:
    path = tmp_path / "contacts.jsonl"
    write(path, range(1, 4))
    write(path, range(2, 3), p_mine=0.75)
    found = contacts_in(path, {1, 2})
    assert {number: contact.p_mine for number, contact in found.items()} == {1: 0.5, 2: 0.75}
    before, again = contact_feature(announced(1)), contact_feature(found[1])
    was, now = (one["properties"] for one in (before, again))
    assert isinstance(was, dict)
    assert isinstance(now, dict)
    assert now["reasons"] == [*fake.contact(1).reasons, JOURNALLED]
    for key in was.keys() - {"reasons"}:
        assert now[key] == was[key], key
    assert again["geometry"] == before["geometry"]


@given(data=st.data())
def test_damage_of_one_line_costs_that_line_alone(
    data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("journal") / "contacts.jsonl"
    write(path, range(1, 6))
    content = bytearray(path.read_bytes())
    at = data.draw(st.integers(0, len(content) - 1))
    content[at] = data.draw(st.integers(0, 255).filter(lambda byte: byte != 10))
    line = bytes(content[:at]).count(b"\n") + 1
    path.write_bytes(content)
    found = contacts_in(path, ALL)
    n_joined = 2 if bytes(path.read_bytes()).count(b"\n") < 5 else 1  # where the end of a line is damaged
    spared = set(range(1, 6)) - set(range(line, line + n_joined))
    assert spared <= found.keys()
    for number in spared:
        assert found[number].id == f"C{number:05d}"
        assert math.isfinite(found[number].latitude_deg)
        assert np.isfinite(found[number].covariance_m2).all()


def test_the_id_of_a_line_that_cannot_be_decoded_is_found() -> None:
    assert id_in(b'{"contact":{"geometry":\0\0,"properties":{"id":"C00012","time') == "C00012"
    assert id_in(b'{"contact":{"geometry":\0\0,"properties":{"id":"C0') == ""
