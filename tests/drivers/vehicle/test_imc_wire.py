"""IMC packets in a stream: both byte orders, checksums, and lengths that are not believed."""

from __future__ import annotations

import random
from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from drivers.framing import Framer
from drivers.vehicle import imc_crc
from drivers.vehicle import imc_messages as imc
from drivers.vehicle.imc_codec import MAX_PAYLOAD_BYTES, encode
from drivers.vehicle.imc_crc import crc16_arc
from drivers.vehicle.imc_wire import ImcGrammar, ImcPacket, packed, to_wire

HEARTBEAT = bytes.fromhex("54fe9600000000001040fc54d9410060051e00ff4a31")
SONAR_DATA = bytes.fromhex("54fe1401160000001040fc54d9410060051e00ff00d0dd060000003200100000803f0000040001000200553d")


def found(stream: bytes) -> tuple[list[ImcPacket], Framer[ImcPacket]]:
    framer = Framer(ImcGrammar())
    return [framed.message for framed in framer.feed(stream)], framer


def bitwise_crc(data: bytes) -> int:
    crc = 0
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ (0xA001 if crc & 1 else 0)
    return crc


@given(st.binary(max_size=64))
def test_checksum_is_that_of_the_definition(data: bytes) -> None:
    assert crc16_arc(data) == bitwise_crc(data)


def test_checksum_has_the_published_check_value() -> None:
    assert crc16_arc(b"123456789") == 0xBB3D


@pytest.mark.parametrize("golden", [HEARTBEAT, SONAR_DATA], ids=["Heartbeat", "SonarData"])
def test_a_packet_is_read_and_written_whether_its_kind_is_known_or_not(golden: bytes) -> None:
    (packet,), _ = found(golden)
    assert (packet.source, packet.source_entity, packet.destination) == (0x6000, 5, 0x1E)
    assert to_wire(packet) == golden


def test_both_byte_orders_in_one_stream() -> None:
    message = imc.Target("MLC-00001", 0.7, -0.1)
    packets = [ImcPacket(800, encode(message, order), 0x1E, time_s=1.5, order=order) for order in ("<", ">", ">", "<")]
    again, _ = found(b"\x54" + b"".join(map(to_wire, packets)))
    assert again == packets


@pytest.mark.parametrize("n_payload", [1, 100, 0xFFFF])
def test_a_wrong_length_of_a_known_message_costs_nothing_behind_it(n_payload: int) -> None:
    damaged = HEARTBEAT[:4] + n_payload.to_bytes(2, "little") + HEARTBEAT[6:]
    packets, framer = found(damaged + HEARTBEAT)
    assert len(packets) == 1
    assert framer.counters["imc.refused.length"] == 1


def test_a_wrong_length_of_another_message_is_not_waited_for_beyond_the_longest() -> None:
    promise = ImcPacket(9999, bytes(MAX_PAYLOAD_BYTES), 0x1E)
    assert found(to_wire(promise))[0] == [promise]
    packets, framer = found(to_wire(promise)[:40] + 200 * HEARTBEAT)
    assert len(packets) == 200
    assert framer.counters["imc.refused.checksum"] == 1
    too_long = to_wire(promise)[:4] + (MAX_PAYLOAD_BYTES + 1).to_bytes(2, "little") + bytes(20)
    assert len(found(too_long + HEARTBEAT)[0]) == 1


@given(garbage=st.binary(max_size=300))
def test_garbage_before_a_message_costs_no_message(garbage: bytes) -> None:
    framer = Framer(ImcGrammar())
    read = [framed.message for framed in (*framer.feed(garbage + HEARTBEAT), *framer.finish())]
    assert to_wire(read[-1]) == HEARTBEAT


def test_a_flipped_bit_is_noticed_wherever_it_is() -> None:
    wired = packed(imc.EntityState(1, 0, "well"), 0x6000)
    for bit in range(8 * len(wired)):
        flipped = bytearray(wired)
        flipped[bit // 8] ^= 1 << bit % 8
        framer = Framer(ImcGrammar())
        assert not [*framer.feed(flipped), *framer.finish()]


@pytest.mark.parametrize("n_read", [31, 97])
def test_junk_in_small_datagrams_is_searched_once(n_read: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Attack `drvfuzz2.py`: each datagram of 97 bytes looked at all candidates and summed up all that was held."""
    looked: Counter[str] = Counter()
    powers, first_in = imc_crc._powers, ImcGrammar._first_in

    def counted_powers(data: NDArray[np.uint8], phase: int) -> NDArray[np.uint16]:
        looked["summed"] += len(data)
        return powers(data, phase)

    def counted_first_in(self: ImcGrammar, buffer: bytearray, start: int, stop: int) -> tuple[int, int]:
        looked["searched"] += stop - start
        return first_in(self, buffer, start, stop)

    monkeypatch.setattr(imc_crc, "_powers", counted_powers)
    monkeypatch.setattr(ImcGrammar, "_first_in", counted_first_in)
    framer, source = Framer(ImcGrammar()), random.Random(1)
    junk = b"".join(HEARTBEAT[:2] + source.randbytes(3) + bytes([source.randrange(16)]) for _ in range(3000))
    for start in range(0, len(junk), n_read):
        list(framer.feed(junk[start : start + n_read]))
    assert looked["summed"] <= 4 * len(junk)
    assert 0 < looked["searched"] <= len(junk)
