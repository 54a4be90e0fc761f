"""The fault campaign: its faults leave whole what it calls whole, and it would notice a framer that loses messages."""

from __future__ import annotations

from collections.abc import Hashable, Iterable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.cli import main
from auv_mcm.errors import SelfCheckError
from drivers.navigation.nav_protocols import TEXT_PROTOCOLS
from drivers.sonar.sonars import SONARS
from sim_replay.benches import framers
from sim_replay.benches.framers import (
    FAULT_KINDS,
    FEEDS,
    MAX_S_PER_MB,
    WIRES,
    FramedWire,
    JunkRow,
    campaign,
    campaign_lines,
    cut,
    damaged,
    junk_lines,
    junk_row,
    n_missing,
    speed_lines,
)
from sim_replay.fakes.worst_bytes import WORST_BYTES


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

    def inventive(chunks: Iterable[bytes]) -> list[Hashable]:
        pieces = list(chunks)
        return good.read(pieces) + ["never sent"] * (len(pieces) != 200)

    honest, row = (
        campaign(FramedWire("inventive", good.messages, read), 50, seed=1) for read in (good.read, inventive)
    )
    assert row.n_false > honest.n_false
    assert row.n_other - honest.n_other == row.n_false - honest.n_false


def test_a_framer_that_believes_lengths_is_found_out() -> None:
    good = next(wire for wire in WIRES if wire.name == "ping_protocol")

    def trusting(chunks: Iterable[bytes]) -> list[Hashable]:
        stream, at, found = b"".join(chunks), 0, list[Hashable]()
        while (at := stream.find(b"BR", at)) >= 0 and at + 4 <= len(stream):
            stop = at + 10 + int.from_bytes(stream[at + 2 : at + 4], "little")
            found += good.read([stream[at:stop]])[:1]
            at = stop
        return found

    assert campaign(FramedWire("trusting", good.messages, trusting), 100, seed=1).n_lost > 0


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


def test_tables_have_a_row_for_each() -> None:
    rows = [campaign(wire, 1, seed=1) for wire in WIRES]
    for wire in WIRES:
        assert sum(line.startswith(wire.name) for line in campaign_lines(rows)) == 1
    for sonar in SONARS:
        assert sum(line.startswith(sonar) for line in speed_lines(2)) >= 2


def test_every_wire_has_its_worst_bytes_and_a_verdict() -> None:
    assert set(FEEDS) == set(WORST_BYTES) == {wire.name for wire in WIRES}
    rows = [junk_row(wire, 2000) for wire in FEEDS]
    assert [row.name for row in rows] == list(FEEDS)
    slow = JunkRow("imc", "syncs", 2.0 * MAX_S_PER_MB)
    assert junk_lines([slow._replace(s_per_mb=MAX_S_PER_MB)])[-1].endswith("held by all")
    assert "FAILED by imc" in junk_lines([slow])[-1]


@pytest.mark.parametrize(("allowed_s", "code"), [(1e9, 0), (0.0, SelfCheckError.exit_code)])
def test_the_command_ends_with_5_where_junk_takes_more_than_is_allowed(
    allowed_s: float, code: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(framers, "MAX_S_PER_MB", allowed_s)
    monkeypatch.setattr(framers, "FEEDS", {"imc": FEEDS["imc"]})
    monkeypatch.setattr(framers, "WIRES", [wire for wire in WIRES if wire.name == "imc"])
    assert main(["bench", "framers", "--faults", "1", "--pings", "1", "--junk", "100"]) == code
    assert ("in imc" in capsys.readouterr().err) == (code != 0)
