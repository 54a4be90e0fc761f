"""Bytes gather a little before they are read: fewer wake-ups, none of them late, lost or out of order. All times are
those of the loop."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections import Counter
from collections.abc import AsyncIterator
from typing import Final, NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from auv_mcm.clock import Stamp
from auv_mcm.errors import HardwareError
from drivers.links.can_frame import CanFrame
from drivers.links.gather import GATHER_S, PLENTY_BYTES, gather_s
from drivers.links.link import Link, Wire
from drivers.links.slcan import SlcanPort, encode
from drivers.links.stream import StreamPort
from drivers.links.uri import BAUD_RATES
from tests.drivers.links.link_watch import Watch, running, until, up
from tests.drivers.links.loop_time import LoopClock, LoopTime, run_in_loop_time

BYTES_PER_S: Final = 92_160.0
USB_PACKET_S: Final = 64 / BYTES_PER_S
TTY_BYTES: Final = 4096
ROUNDING_S: Final = 1e-9


class Late(NamedTuple):
    """Hold a chunk, and for how long its first byte waited."""

    n_bytes: int
    waited_s: float


class Far:
    """Run the far end of a wire in this process, and collect what arrives."""

    def __init__(self, link: Link[bytes], watch: Watch[bytes], wire: socket.socket) -> None:
        self.link, self.watch, self.wire = link, watch, wire
        self.sent = b""
        self._sent_s: list[tuple[int, float]] = []  # end of each piece in `sent`, and when it was sent

    async def send(self, *pieces: bytes, apart_s: float) -> None:
        for piece in pieces:
            self.put(piece)
            await asyncio.sleep(apart_s)

    def put(self, piece: bytes) -> None:
        self.wire.send(piece)
        self.sent += piece
        self._sent_s.append((len(self.sent), asyncio.get_running_loop().time()))

    def received(self) -> list[Late]:
        """Return all chunks so far, which are what was sent."""
        assert b"".join(self.watch.items) == self.sent
        late, start = [], 0
        for chunk, stamp in zip(self.watch.items, self.watch.stamps, strict=True):
            sent_s = next(at_s for end, at_s in self._sent_s if end > start)
            late.append(Late(len(chunk), stamp.mono_ns * 1e-9 - sent_s))
            start += len(chunk)
        return late


def stream_port(near: socket.socket, baud: int, counters: Counter[str]) -> StreamPort:
    return StreamPort(near.fileno(), near.close, lambda error: "hung up", lambda: "", gather_s(baud), counters)


@contextlib.asynccontextmanager
async def wired(baud: int = 921_600) -> AsyncIterator[Far]:
    near, far = socket.socketpair()
    near.setblocking(False)
    watch = Watch[bytes]()

    async def open_port(counters: Counter[str]) -> Wire[bytes]:
        return stream_port(near, baud, counters)

    link = Link("wire", open_port, watch.on_data, watch.on_state, LoopClock(), 60.0)
    with far:
        async with up(link):
            yield Far(link, watch, far)


def test_small_pieces_are_handed_on_in_fewer_chunks_and_none_waits_longer_than_it_may() -> None:
    async def scenario(loop: LoopTime) -> None:
        async with wired() as far:
            await far.send(*(bytes([k]) * 64 for k in range(200)), apart_s=USB_PACKET_S)
            await asyncio.sleep(0.1)
            late = far.received()
            assert len(late) <= 200 * USB_PACKET_S / GATHER_S + 2
            assert max(late.waited_s for late in late) <= GATHER_S + ROUNDING_S
            assert far.link.counters["link.reads"] == len(late) + 1

    run_in_loop_time(scenario)


def test_what_comes_after_a_pause_is_read_at_once() -> None:
    async def scenario(loop: LoopTime) -> None:
        async with wired(4800) as far:
            await far.send(*[b"$GPHDT,90.0,T*0C\r\n"] * 10, apart_s=0.1)
            late = far.received()
            assert [late.n_bytes for late in late] == [18] * 10
            assert max(late.waited_s for late in late) <= ROUNDING_S
            assert far.link.counters["link.reads"] == 20

    run_in_loop_time(scenario)


def test_a_wire_that_brings_much_at_once_is_never_made_to_wait() -> None:
    async def scenario(loop: LoopTime) -> None:
        async with wired() as far:
            await far.send(*[bytes(PLENTY_BYTES)] * 50, apart_s=1e-4)
            assert max(late.waited_s for late in far.received()) <= ROUNDING_S

    run_in_loop_time(scenario)


def test_a_hang_up_is_reported_within_the_time_of_gathering_and_no_byte_before_it_is_lost() -> None:
    async def scenario(loop: LoopTime) -> None:
        async with wired() as far:
            await far.send(b"a", b"b", apart_s=GATHER_S / 4)
            far.put(b"c")
            far.wire.close()
            hung_up_s = loop.time()
            while far.link.state != "down":
                await asyncio.sleep(GATHER_S / 8)
            assert loop.time() - hung_up_s <= 2.125 * GATHER_S  # what was left is read first
            assert b"".join(far.watch.items) == b"abc"
            assert "hung up" in far.watch.reason

    run_in_loop_time(scenario)


def test_closing_while_bytes_gather_leaves_no_timer() -> None:
    async def scenario(loop: LoopTime) -> int:
        async with wired() as far:
            await far.send(b"a", apart_s=GATHER_S / 4)
            far.put(b"b")
            assert loop.n_timers_set > 0
        return loop.n_timers_set

    assert run_in_loop_time(scenario) == 0


def test_a_receiver_that_loses_the_wire_leaves_no_timer() -> None:
    """A write that fails ends the wire from inside of what was read."""

    async def scenario(loop: LoopTime) -> None:
        near, far = socket.socketpair()
        near.setblocking(False)
        ports = [near]

        async def open_port(counters: Counter[str]) -> Wire[bytes]:
            return stream_port(ports.pop(), 921_600, counters)

        def answer(data: bytes, stamp: Stamp) -> None:
            far.close()
            link.write(b"answer")

        watch = Watch[bytes]()
        link = Link("wire", open_port, answer, watch.on_state, LoopClock(), 60.0)
        task = asyncio.ensure_future(link.run())
        await until(lambda: link.state == "up")
        far.send(b"question")
        await until(lambda: link.state == "down")
        assert link.counters["link.reads"] == 1
        task.cancel()
        await asyncio.wait([task])
        assert loop.n_timers_set == 0

    run_in_loop_time(scenario)


def test_a_wire_that_cannot_be_opened_is_tried_every_2_s_and_soon_again_once_it_brought_something() -> None:
    async def scenario(loop: LoopTime) -> list[float]:
        tries_s: list[float] = []

        async def open_port(counters: Counter[str]) -> Wire[bytes]:
            tries_s.append(loop.time())
            if len(tries_s) != 12:
                raise HardwareError("absent")
            near, far = socket.socketpair()
            near.setblocking(False)
            with far:
                far.send(b"hello")
            return stream_port(near, 921_600, counters)

        watch = Watch[bytes]()
        async with running(Link("wire", open_port, watch.on_data, watch.on_state, LoopClock(), 60.0)):
            await asyncio.sleep(20.0)
        return tries_s

    pauses_s = np.diff(run_in_loop_time(scenario))
    assert pauses_s[:7] == pytest.approx([0.1, 0.2, 0.4, 0.8, 1.6, 2.0, 2.0])
    assert pauses_s[11:13] == pytest.approx([0.1, 0.2], abs=2 * GATHER_S)


def test_frames_of_an_adapter_gather_as_well() -> None:
    async def scenario(loop: LoopTime) -> None:
        near, far = socket.socketpair()
        near.setblocking(False)

        async def open_port(counters: Counter[str]) -> Wire[CanFrame]:
            return SlcanPort(stream_port(near, 115_200, counters), 250_000, counters)

        watch = Watch[CanFrame]()
        link = Link("bus", open_port, watch.on_data, watch.on_state, LoopClock(), 60.0)
        with far:
            async with up(link):
                for k in range(40):
                    far.send(encode(CanFrame(k, b"")))
                    await asyncio.sleep(GATHER_S / 4)
                await asyncio.sleep(0.1)
                assert [frame.can_id for frame in watch.items] == list(range(40))
                assert len(set(watch.stamps)) <= 12

    run_in_loop_time(scenario)


@settings(max_examples=60)
@given(
    st.lists(
        st.tuples(st.binary(min_size=1, max_size=3000), st.sampled_from([0.0, 1e-5, 3e-4, 1e-3, 2e-3, 5e-3, 0.3])),
        max_size=30,
    ),
    st.sampled_from(BAUD_RATES),
)
def test_whatever_comes_however_cut_up_arrives_whole_in_order_and_in_time(
    pieces: list[tuple[bytes, float]], baud: int
) -> None:
    async def scenario(loop: LoopTime) -> None:
        async with wired(baud) as far:
            for piece, apart_s in pieces:
                await far.send(piece, apart_s=apart_s)
            await asyncio.sleep(0.1)
            assert max((late.waited_s for late in far.received()), default=0.0) <= GATHER_S + ROUNDING_S

    run_in_loop_time(scenario)


@pytest.mark.parametrize("baud", BAUD_RATES)
def test_no_more_gathers_than_a_fraction_of_what_the_kernel_holds(baud: int) -> None:
    assert 0.0 < gather_s(baud) <= 0.002
    assert gather_s(baud) * baud / 10 <= TTY_BYTES / 16
    assert gather_s(baud) == GATHER_S or gather_s(baud) * baud / 10 >= 250
