"""CAN links: an slcan adapter on a pseudo-terminal, python-can's virtual bus, and buses that die."""

from __future__ import annotations

import asyncio
import errno
import socket
from collections import Counter
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, NamedTuple

import can
import pytest

from auv_mcm.clock import SystemClock
from drivers.links.can_bus import CanBusPort
from drivers.links.can_frame import CanFrame
from drivers.links.link import Link
from drivers.links.slcan import encode
from sim_replay.fakes.port import FakePort
from sim_replay.fakes.slcan_adapter import FakeSlcanAdapter
from tests.drivers.links.link_watch import Watch, running, until, until_equal, up, watched_can

POSITION = CanFrame(0x09F80103, bytes.fromhex("406dab1cc0b9da06"))
DEPTH = CanFrame(0x0DF50B03, bytes.fromhex("00d2040000000000"))


class Plugged(NamedTuple):
    port: FakePort
    adapter: FakeSlcanAdapter
    link: Link[CanFrame]
    watch: Watch[CanFrame]


@asynccontextmanager
async def plugged_adapter(
    folder: Path, options: str = "", bitrate: int = 250000, on_frame: Callable[[CanFrame], None] | None = None
) -> AsyncIterator[Plugged]:
    """An adapter on a bus of `bitrate`, which the link to it takes for one of 250000 bit/s, and opened."""
    port = FakePort(folder / "tty", 115200)
    adapter = FakeSlcanAdapter(port, bitrate, on_frame)
    port.plug()
    link, watch = watched_can(f"slcan://{port.path}?bitrate=250000{options}")
    async with running(link):
        await until(lambda: adapter.is_open)
        yield Plugged(port, adapter, link, watch)
    port.unplug()


async def test_an_adapter_is_opened_at_the_bit_rate_and_frames_pass_both_ways(tmp_path: Path) -> None:
    taken: list[CanFrame] = []
    async with plugged_adapter(tmp_path, on_frame=taken.append) as (_, adapter, link, watch):
        await adapter.send(POSITION)
        await adapter.send(DEPTH)
        await until(lambda: watch.items == [POSITION, DEPTH])
        assert link.write(DEPTH)
        await until(lambda: taken == [DEPTH])
        assert not link.write(CanFrame(1, bytes(64)))
        assert link.counters["slcan.refused.unsendable"] == 1
        await until(lambda: link.counters["slcan.answers"] == 6)
    assert link.counters["slcan.refusals"] == 1, "closing what was not open"


async def test_an_unplugged_adapter_is_opened_again_when_it_is_back(tmp_path: Path) -> None:
    async with plugged_adapter(tmp_path) as (port, adapter, link, watch):
        for n in range(2):
            await until(lambda: adapter.is_open)
            await adapter.send(CanFrame(n, b""))
            await until_equal(lambda: len(watch.items), n + 1)
            port.unplug()
            adapter.power_cycle()
            await until(lambda: link.state == "down")
            assert not link.write(POSITION)
            port.plug()


async def test_an_adapter_that_lost_power_behind_its_port_is_opened_again(tmp_path: Path) -> None:
    async with plugged_adapter(tmp_path, "&silent_s=0.1") as (_, adapter, _, watch):
        await adapter.send(POSITION)
        await until(lambda: watch.items)
        adapter.power_cycle()
        await until(lambda: adapter.is_open)
        await adapter.send(DEPTH)
        await until(lambda: watch.items == [POSITION, DEPTH])


async def test_a_wrong_bit_rate_and_a_dead_adapter_are_distinguished(tmp_path: Path) -> None:
    async with plugged_adapter(tmp_path, "&silent_s=0.1", bitrate=500000) as (port, adapter, link, watch):
        await adapter.send(POSITION)
        await until(lambda: link.state == "silent")
        assert "The adapter answers: check that the bus has 250000 bit/s" in watch.reason
        port.stalled = True
        await until(lambda: "The adapter does not answer either" in watch.reason)
    assert not watch.items


async def test_bytes_that_are_no_frames_are_reported_as_such(tmp_path: Path) -> None:
    port = FakePort(tmp_path / "tty", 115200)
    port.plug()
    link, watch = watched_can(f"slcan://{port.path}?bitrate=250000&silent_s=0.1")
    async with running(link):
        advice = "What arrives is neither a CAN frame nor an answer of the adapter: check that the adapter speaks slcan"
        while link.state != "silent" or advice not in watch.reason:
            await port.send(b"\x00\xfc\x80\r")
            await asyncio.sleep(0.01)
    assert not watch.items
    port.unplug()


async def test_one_bad_byte_costs_one_frame(tmp_path: Path) -> None:
    async with plugged_adapter(tmp_path) as (port, _, link, watch):
        for n in range(13):
            text = encode(CanFrame(n, b"\x00"))
            await port.send(text.replace(b"T", b"\xc3") if n == 2 else text)
        await until(lambda: len(watch.items) == 12)
        assert [frame.can_id for frame in watch.items] == [0, 1, *range(3, 13)]
    assert link.counters["slcan.refused.line"] == 1


async def test_frames_pass_both_ways_on_a_virtual_bus() -> None:
    other = can.Bus(interface="virtual", channel="both_ways", ignore_config=True)
    link, watch = watched_can("can-virtual://both_ways")
    async with up(link):
        other.send(can.Message(arbitration_id=POSITION.can_id, data=POSITION.data))
        other.send(can.Message(arbitration_id=0x123, data=b"\x01", is_extended_id=False))
        other.send(can.Message(arbitration_id=0x123, is_remote_frame=True))
        await until(lambda: watch.items == [POSITION, CanFrame(0x123, b"\x01", extended=False)])
        for frame in (DEPTH, CanFrame(0x123, b"\x01", extended=False)):
            assert link.write(frame)
            message = await asyncio.to_thread(other.recv, 5.0)
            assert message is not None
            assert (message.arbitration_id, bytes(message.data), message.is_extended_id) == frame
        assert not link.write(CanFrame(1 << 30, b""))
    assert link.counters["can.remote"] == 1
    assert link.counters["can.send_failed"] == 1
    other.shutdown()


class DyingBus:
    """Fake a bus on a descriptor; every byte written to `far` makes it give the next planned item, an error or a
    message."""

    def __init__(self, plan: list[can.Message | Exception]) -> None:
        self.near, self.far = socket.socketpair()
        self.near.setblocking(False)
        self.far.send(b"." * len(plan))
        self._plan = plan

    def fileno(self) -> int:
        return self.near.fileno()

    def recv(self, timeout: float) -> can.Message | None:
        try:
            self.near.recv(1)
        except BlockingIOError:
            return None
        step = self._plan.pop(0)
        if isinstance(step, Exception):
            raise step
        return step

    def send(self, message: can.Message, timeout: float) -> None:
        raise can.CanOperationError("Transmit buffer full")

    def shutdown(self) -> None:
        self.near.close()
        self.far.close()
        raise can.CanOperationError("a bus that is gone cannot even be closed")


@pytest.mark.parametrize(
    ("end", "words"),
    [
        (
            can.CanOperationError("Error receiving", errno.ENETDOWN),
            "the interface is down. Bring it up, e.g. ip link set can9 up",
        ),
        (can.CanOperationError("Error receiving", errno.ENODEV), "no such CAN interface"),
        (ValueError("something else altogether"), "the CAN bus failed (something else altogether)"),
        (can.Message(is_error_frame=True, arbitration_id=0x40), "switched itself off after too many errors"),
    ],
)
async def test_a_bus_that_dies_is_reported_at_once_and_opened_again(end: can.Message | Exception, words: str) -> None:
    plans: list[list[Any]] = [
        [can.Message(arbitration_id=1), can.Message(is_error_frame=True, arbitration_id=0x4)],
        [can.Message(arbitration_id=2)],
    ]
    plans[0].append(end)

    async def open_port(counters: Counter[str]) -> CanBusPort:
        return CanBusPort(DyingBus(plans.pop(0)), "socketcan://can9", counters)

    watch = Watch[CanFrame]()
    link = Link("socketcan://can9", open_port, watch.on_data, watch.on_state, SystemClock(), 5.0)
    async with running(link):
        await until(lambda: [frame.can_id for frame in watch.items][-1:] == [2])
        assert watch.states == ["up", "down", "up"]
        assert words in watch.reports[1][1]
        assert not link.write(POSITION)
        assert link.counters["can.error_frames"] >= 1
    assert link.counters["link.lost"] == 1


@pytest.mark.parametrize(
    ("last", "words"),
    [
        (can.Message(is_error_frame=True, arbitration_id=0x4), "Frames of errors came last: the bus has another bit"),
        (can.Message(arbitration_id=1), "Check that the bus has power, its bit rate"),
    ],
)
async def test_a_wrong_bit_rate_shows_in_frames_of_errors_alone(last: can.Message, words: str) -> None:
    async def open_port(counters: Counter[str]) -> CanBusPort:
        return CanBusPort(
            DyingBus([can.Message(is_error_frame=True, arbitration_id=0x4), last]), "socketcan://can9", counters
        )

    watch = Watch[CanFrame]()
    async with running(Link("socketcan://can9", open_port, watch.on_data, watch.on_state, SystemClock(), 0.1)):
        await until(lambda: watch.states[-1:] == ["silent"])
        assert words in watch.reason


async def test_an_interface_that_is_not_there_is_reported() -> None:
    link, watch = watched_can("socketcan://absent0")
    async with running(link):
        await until(lambda: watch.reports)
        assert watch.states == ["down"]
        assert "no such CAN interface" in watch.reason or "no SocketCAN" in watch.reason
