"""The fault campaign: its faults leave whole what it calls whole, and it would notice a framer that loses messages."""

from __future__ import annotations

from collections.abc import Hashable
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.navigation.nav_protocols import TEXT_PROTOCOLS
from drivers.sonar.sonars import SONARS
from sim_replay.fakes.damage import FAULT_KINDS, cut, damaged, n_missing
from sim_replay.fakes.framed_wires import WIRES, FramedWire, Read
from sim_replay.fakes.worst_bytes import WORST_BYTES

MESSAGES_PER_STREAM, FAULTS_PER_STREAM = 200, 50


class Campaign(NamedTuple):
    """Count the messages of all streams of one wire that were damaged.

    n_lost: intact ones that were not read. n_other: read from damaged or repeated bytes. n_false: of those, messages
    that nobody sent.
    """

    n_faults: int
    n_intact: int
    n_lost: int
    n_other: int
    n_false: int


def campaign(wire: FramedWire, n_faults: int, seed: int) -> Campaign:
    """At least so many faults in streams of the wire's messages."""
    total = Campaign(0, 0, 0, 0, 0)
    stream_seed = 0
    while total.n_faults < n_faults:
        random = np.random.Generator(np.random.PCG64([seed, stream_seed]))
        stream_seed += 1
        messages = wire.messages(random, MESSAGES_PER_STREAM)
        keys = wire.read(messages)
        assert len(keys) == len(messages), f"{wire.name}: not every intact message of a clean stream is read"
        result = damaged(messages, FAULTS_PER_STREAM, random)
        found = wire.read(cut(result.stream, random))
        wanted = [key for key, whole in zip(keys, result.intact, strict=True) if whole]
        n_lost = n_missing(wanted, found)
        n_false = sum(item not in set(keys) for item in found)
        more = (sum(result.n_faults.values()), len(wanted), n_lost, len(found) - (len(wanted) - n_lost), n_false)
        total = Campaign(*(sum(pair) for pair in zip(total, more, strict=True)))
    return total


def numbered(random: np.random.Generator, n: int) -> list[bytes]:
    return [b"<" + b"%05d" % i + bytes([65 + i % 26]) * int(random.integers(20)) + b">" for i in range(n)]


@given(seed=st.integers(0, 2**32), n_faults=st.integers(0, 12))
def test_a_message_called_intact_is_in_the_stream(seed: int, n_faults: int) -> None:
    random = np.random.Generator(np.random.PCG64(seed))
    messages = numbered(random, 20)
    result = damaged(messages, n_faults, random)
    assert sum(result.n_faults.values()) <= n_faults
    at = 0
    for message, intact in zip(messages, result.intact, strict=True):
        if intact:
            at = result.stream.index(message, at) + len(message)
    if n_faults == 0:
        assert result.stream == b"".join(messages)
        assert all(result.intact)


def test_every_kind_of_fault_is_made_and_the_same_seed_makes_the_same() -> None:
    def made() -> tuple[bytes, list[bool], dict[str, int]]:
        random = np.random.Generator(np.random.PCG64(8))
        stream, intact, n_by_kind = damaged(numbered(random, 400), 60, random)
        return stream, intact, {str(kind): n for kind, n in n_by_kind.items()}

    stream, intact, n_by_kind = made()
    assert (stream, intact, n_by_kind) == made()
    assert all(n_by_kind[kind] > 3 for kind in FAULT_KINDS)
    assert 0.3 < np.mean(intact) < 0.95


def test_chunks_join_to_the_stream() -> None:
    stream = bytes(range(256)) * 9
    assert b"".join(cut(stream, np.random.Generator(np.random.PCG64(2)))) == stream


def test_missing_items_are_counted_in_order() -> None:
    assert n_missing(list("abc"), list("xaxbxc")) == 0
    assert n_missing(list("abc"), list("acb")) == 1
    assert n_missing(list("abc"), []) == 3


@pytest.mark.parametrize("wire", WIRES, ids=lambda wire: wire.name)
def test_no_intact_message_is_lost(wire: FramedWire) -> None:
    row = campaign(wire, 300, seed=11)
    assert row.n_faults >= 300
    assert row.n_lost == 0
    assert row.n_intact > 500


@pytest.mark.parametrize("name", ["ping_protocol", "water_linked"])
def test_damage_seldom_passes_a_checksum(name: str) -> None:
    row = campaign(next(wire for wire in WIRES if wire.name == name), 300, seed=11)
    assert row.n_false <= 3


def test_messages_that_nobody_sent_are_counted() -> None:
    good = next(wire for wire in WIRES if wire.name == "water_linked")

    def inventive() -> Read:
        reader, chunks = good.reader(), list[bytes]()

        def read(data: bytes) -> list[Hashable]:
            chunks.append(data)
            return [*reader(data), *(["never sent"] * (not data and len(chunks) != 201))]

        return read

    honest, row = (campaign(good._replace(reader=reader), 50, seed=1) for reader in (good.reader, inventive))
    assert row.n_false > honest.n_false
    assert row.n_other - honest.n_other == row.n_false - honest.n_false


def test_a_framer_that_believes_lengths_is_found_out() -> None:
    good = next(wire for wire in WIRES if wire.name == "ping_protocol")

    def trusting() -> Read:
        kept: list[bytes] = []

        def read(data: bytes) -> list[Hashable]:
            kept.append(data)
            stream, at, found = b"".join(kept), 0, list[Hashable]()
            while not data and (at := stream.find(b"BR", at)) >= 0 and at + 4 <= len(stream):
                stop = at + 10 + int.from_bytes(stream[at + 2 : at + 4], "little")
                found += good.read([stream[at:stop]])[:1]
                at = stop
            return found

        return read

    assert campaign(good._replace(reader=trusting), 100, seed=1).n_lost > 0


def test_every_protocol_of_a_configuration_is_in_the_campaign() -> None:
    # A bus is damaged where it becomes bytes, at the adapter, and where its messages span frames.
    protocols = {
        *SONARS,
        *TEXT_PROTOCOLS,
        "pixse",
        "imc",
        "bluefin",
        "iver",
        "recon",
        "slcan",
        "fast_packet",
        "vehicle_can",
    }
    assert {wire.name for wire in WIRES} == protocols


@pytest.mark.parametrize("wire", WIRES, ids=lambda wire: wire.name)
def test_messages_of_a_wire_differ_from_each_other(wire: FramedWire) -> None:
    keys = wire.read(wire.messages(np.random.Generator(np.random.PCG64(3)), 200))
    assert len(set(keys)) == len(keys) == 200


def test_every_wire_has_its_worst_bytes() -> None:
    assert set(WORST_BYTES) == {wire.name for wire in WIRES}
