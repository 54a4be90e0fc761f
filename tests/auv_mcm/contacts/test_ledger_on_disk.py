"""Contacts on disk are those of a ledger that compares everything with everything in memory, wherever they are and
whatever fails.
"""

from __future__ import annotations

import gc
import math
import os
import tracemalloc
from collections.abc import Iterator
from contextlib import closing, contextmanager
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from auv_mcm.contacts.contact_store import ContactStore
from auv_mcm.contacts.ledger import Ledger, contact_from_views
from auv_mcm.contacts.record_file import RecordFile
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.records import Confirmation, Contact, Detection, ShapeModel, contact_id
from auv_mcm.settings.config import ContactsConfig
from tests.auv_mcm.classify import drawn_looks
from tests.auv_mcm.contacts.temporary_records import temporary_record_file

CONFIG = ContactsConfig(min_p_mine=0.0)
PRIOR = -4.0
FORBIDDEN = 1e9
SIZES = {"length_m": 2.0, "radius_m": 0.25, "azimuth_rad": 0.3}
PLACES = (
    LocalFrame(latitude_deg=43.7, longitude_deg=10.3),
    LocalFrame(latitude_deg=10.0, longitude_deg=180.0),
    LocalFrame(latitude_deg=89.9, longitude_deg=-120.0),
)


class Everything:
    """The oracle: each detection against each contact there is, by the rules of the ledger and nothing else."""

    def __init__(self) -> None:
        self.contacts: list[Contact] = []
        self.frame: LocalFrame | None = None

    def add(self, detections: list[Detection]) -> list[Contact]:
        if detections and self.frame is None:
            self.frame = LocalFrame(latitude_deg=detections[0].latitude_deg, longitude_deg=detections[0].longitude_deg)
        changed: set[int] = set()
        passage: list[Detection] = []
        for detection in sorted(detections, key=lambda d: (d.time_s, d.side, d.column)):
            if passage and not (
                detection.time_s - passage[-1].time_s < 30.0 and turned(detection, passage[0]) < math.pi / 4
            ):
                changed |= self.join(passage)
                passage = []
            passage.append(detection)
        changed |= self.join(passage)
        return [self.contacts[index] for index in sorted(changed)]

    def join(self, passage: list[Detection]) -> set[int]:
        known = list(self.contacts)
        pairs = {
            (d, c): cost
            for d in range(len(passage))
            for c in range(len(known))
            if (cost := self.cost(passage[d], known[c])) is not None
        }
        costs = np.full((len(passage), len(known) + len(passage)), FORBIDDEN)
        costs[:, len(known) :] = CONFIG.gate_chi2
        for (d, c), (distance2, unlike) in pairs.items():
            costs[d, c] = distance2 + unlike - min(cost[1] for pair, cost in pairs.items() if pair[0] == d)
        reached = [c for c in range(len(known)) if any(pair[1] == c for pair in pairs)]
        columns = [*reached, *range(len(known), costs.shape[1])]
        match = dict.fromkeys(range(len(passage)), -1)
        if reached:
            match |= {int(d): columns[k] for d, k in zip(*linear_sum_assignment(costs[:, columns]), strict=True)}
        changed = set()
        for d, detection in enumerate(passage):
            if 0 <= match[d] < len(known):
                views = tuple(sorted([*known[match[d]].views, detection], key=lambda view: view.time_s))
                self.contacts[match[d]] = contact_from_views(known[match[d]].id, views, PRIOR)
                changed.add(match[d])
            else:
                self.contacts.append(contact_from_views(contact_id(len(self.contacts) + 1), (detection,), PRIOR))
                changed.add(len(self.contacts) - 1)
        return changed

    def cost(self, detection: Detection, contact: Contact) -> tuple[float, float] | None:
        """Squared distance, and what being unlike costs; None where they cannot be one."""
        assert self.frame is not None
        here, there = (
            self.frame.to_enu([item.latitude_deg], [item.longitude_deg], 0.0)[0, :2] for item in (detection, contact)
        )
        if math.hypot(*(there - here)) > CONFIG.max_gate_m:
            return None
        if any(
            (abs(view.time_s - detection.time_s) < 30.0 or abs(view.row - detection.row) * view.row_spacing_m < 10.0)
            and turned(view, detection) < math.pi / 4
            for view in contact.views
        ):
            return None
        spread = detection.covariance_m2 + contact.covariance_m2 + 1e-4 * np.eye(2)
        distance2 = float((there - here) @ np.linalg.solve(spread, there - here))
        p, q = detection.p_mine, contact.p_mine
        return (
            None
            if distance2 > CONFIG.gate_chi2
            else (distance2, -2.0 * math.log(max(p * q + (1.0 - p) * (1.0 - q), 1e-3)))
        )


def turned(a: Detection, b: Detection) -> float:
    return abs(math.remainder(a.heading_rad - b.heading_rad, math.tau))


def contents(record: Any) -> Any:
    """Everything in a record, to the bit and with the kinds of its arrays; NaN is NaN."""
    match record:
        case msgspec.Struct():
            return [
                type(record).__name__,
                *((name, contents(getattr(record, name))) for name in record.__struct_fields__),
            ]
        case np.ndarray():
            return record.dtype.str, record.shape, record.tobytes()
        case dict():
            return [(key, contents(value)) for key, value in record.items()]
        case tuple():
            return [contents(value) for value in record]
        case _:
            return repr(float(record)) if isinstance(record, float) else repr(record)


def looked_at(log_ratio: float) -> Confirmation:
    outline = np.array([[0.5, 1.0], [2.5, 3.0]])
    solid = ShapeModel(
        classification="cylinder", sizes=SIZES, sigma=dict.fromkeys(SIZES, math.nan), highlight=outline, shadow=outline
    )
    labels = np.arange(6, dtype=np.uint8).reshape(2, 3)
    values: dict[str, Any] = {"labels": labels, "highlight": outline, "model": solid, "reasons": ("bend",)}
    return drawn_looks.confirmation(log_ratio, drawn_looks.like("cylinder"), **values)


@st.composite
def missions(draw: st.DrawFn) -> list[list[Detection]]:
    """Batches of detections at a few places far and near, seen again and again, now and then within one passage."""
    random = np.random.Generator(np.random.PCG64(draw(st.integers(0, 2**32))))
    frame = draw(st.sampled_from(PLACES))
    sites = np.concatenate([random.uniform(-6.0, 6.0, (4, 2)), random.uniform(-3000.0, 3000.0, (3, 2))])
    time_s, row, batches = 0.0, 0.0, []
    for _ in range(draw(st.integers(1, 8))):
        pause_s = float(random.choice([1.0, 40.0, 5000.0]))
        time_s, row = time_s + pause_s, row + 15.0 * pause_s
        heading = float(random.choice([0.0, math.pi, 1.2]))
        batch = []
        for east_m, north_m in random.permutation(sites)[: int(random.integers(0, 7))] + random.normal(
            0.0, 0.8, (1, 2)
        ):
            step_s = float(random.choice([0.1, 0.1, 35.0]))
            time_s, row = time_s + step_s, row + step_s * float(random.choice([0.1, 15.0]))
            heading += float(random.choice([0.0, 0.0, 0.0, math.pi]))
            latitude, longitude, _ = frame.to_geodetic([east_m, north_m, 0.0])
            log_ratio = float(random.normal(0.0, 4.0))
            width = random.uniform(0.2, 1.5, 2)
            batch.append(
                drawn_looks.detection(
                    time_s=time_s,
                    row=row,
                    latitude_deg=float(latitude),
                    longitude_deg=float(longitude),
                    covariance_m2=np.diag(width**2) + 0.1,
                    heading_rad=heading,
                    aspect_deg=float(random.uniform(0.0, 360.0)),
                    p_mine=1.0 / (1.0 + math.exp(-log_ratio - PRIOR)),
                    height_m=float(random.choice([math.nan, 0.4])),
                    column=float(random.integers(0, 3)),
                    snippet=random.integers(0, 255, (3, 4)).astype(np.uint8),
                    p_by_step={"detector": 0.1},
                    reasons=("no_shadow",),
                    confirmation=looked_at(log_ratio) if random.random() < 0.4 else None,
                )
            )
        batches.append([batch[k] for k in random.permutation(len(batch))])
    return batches


@contextmanager
def disk(takes: Iterator[bool]) -> Iterator[None]:
    """A disk that takes what it is said to take, and else a part of it, as when it runs full."""
    write = os.pwrite

    def part(descriptor: int, data: bytes, offset: int) -> int:
        if next(takes, True):
            return write(descriptor, data, offset)
        write(descriptor, data[: len(data) // 2], offset)
        raise OSError(28, "No space left on device")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("auv_mcm.contacts.record_file.os.pwrite", part)
        yield


@settings(max_examples=25, deadline=None)
@given(batches=missions())
def test_a_ledger_joins_what_comparing_everything_with_everything_joins(batches: list[list[Detection]]) -> None:
    ledger, oracle = Ledger(CONFIG, PRIOR), Everything()
    for batch in batches:
        assert [contents(contact) for contact in ledger.add(batch)] == [
            contents(contact) for contact in oracle.add(batch)
        ]
    assert [contents(contact) for contact in ledger.contacts] == [contents(contact) for contact in oracle.contacts]


@settings(max_examples=40, deadline=None)
@given(batches=missions(), takes=st.lists(st.booleans(), max_size=40))
def test_contacts_on_a_disk_that_fills_and_empties_are_those_in_memory(
    tmp_path_factory: pytest.TempPathFactory, batches: list[list[Detection]], takes: list[bool]
) -> None:
    with disk(iter(takes)), closing(temporary_record_file(tmp_path_factory.getbasetemp())) as records:
        store = ContactStore(records)
        on_disk, in_memory = Ledger(CONFIG, PRIOR, store), Ledger(CONFIG, PRIOR)
        for batch in batches:
            assert [contents(contact) for contact in on_disk.add(batch)] == [
                contents(contact) for contact in in_memory.add(batch)
            ]
        assert [contents(contact) for contact in on_disk.contacts] == [
            contents(contact) for contact in in_memory.contacts
        ]
        assert (store.n_in_memory > 0) <= (False in takes)


@settings(max_examples=30, deadline=None)
@given(batches=missions(), min_p_mine=st.floats(0.0, 1.0))
def test_contacts_that_ask_for_another_look_are_those_that_say_from_where(
    batches: list[list[Detection]], min_p_mine: float
) -> None:
    ledger = Ledger(CONFIG, PRIOR)
    for batch in batches:
        ledger.add(batch)
        asking = [contact for contact in ledger.contacts if contact.next_look_deg and contact.p_mine >= min_p_mine]
        assert list(ledger.asking(min_p_mine)) == asking


def test_what_the_disk_does_not_give_back_is_a_contact_of_its_own(
    records: RecordFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    ledger = Ledger(CONFIG, PRIOR, ContactStore(records))
    view = drawn_looks.detection(time_s=0.0)
    ledger.add([view])

    def broken(*_: object) -> bytes:
        raise OSError(5, "Input/output error")

    with monkeypatch.context() as patch:
        patch.setattr("auv_mcm.contacts.record_file.os.pread", broken)
        (contact,) = ledger.add([msgspec.structs.replace(view, time_s=900.0, row=13600.0)])
        assert (contact.id, len(contact.views)) == ("C00002", 1)
    assert records.n_unreadable == 1
    assert [contact.id for contact in ledger.contacts] == ["C00001", "C00002"]


def test_contacts_on_disk_cost_the_memory_of_their_places(records: RecordFile) -> None:
    """At both ends together; in memory these are 8 kB each."""
    frame = PLACES[0]
    latitude, longitude, _ = frame.to_geodetic(np.column_stack([np.arange(500.0) * 10.0, np.zeros(500), np.zeros(500)]))
    snippet = np.zeros((60, 80), dtype=np.uint8)
    batches = [
        [
            drawn_looks.detection(
                time_s=100.0 * k, latitude_deg=lat, longitude_deg=lon, snippet=snippet.copy(), p_mine=0.01
            )
        ]
        for k, (lat, lon) in enumerate(zip(latitude.tolist(), longitude.tolist(), strict=True))
    ]
    store, reader = ContactStore(records), ContactStore(records)
    ledger = Ledger(CONFIG, PRIOR, store)
    ledger.add(batches[0])
    tracemalloc.start()
    before, _ = tracemalloc.get_traced_memory()
    for number, batch in enumerate(batches[1:], 2):
        (contact,) = ledger.add(batch)
        reader.keep(contact, store.place(number))
    gc.collect()  # numpy leaves cycles, which are no memory of contacts
    after, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(list(reader.in_order())) == 499
    assert after - before < 100 * 500
