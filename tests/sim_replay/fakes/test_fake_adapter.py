"""The fake slcan adapter, driven by its manual and by python-can."""

from __future__ import annotations

import asyncio
import os
import tty
from pathlib import Path

import can

from drivers.links.can_frame import CanFrame
from sim_replay.fakes.port import FakePort
from sim_replay.fakes.slcan_adapter import FakeSlcanAdapter

POSITION = CanFrame(0x09F80103, bytes.fromhex("406dab1cc0b9da06"))


async def expect_answer(host: int, command: bytes, answer: bytes) -> None:
    """Give a command; the answer must come."""
    os.write(host, command)
    data = b""
    async with asyncio.timeout(10.0):
        while len(data) < len(answer):
            try:
                data += os.read(host, 100)
            except BlockingIOError:
                await asyncio.sleep(0.001)
    assert data == answer, command


async def test_commands_are_answered_as_in_the_manual(tmp_path: Path) -> None:
    taken: list[CanFrame] = []
    port = FakePort(tmp_path / "can", 115200)
    adapter = FakeSlcanAdapter(port, 500000, taken.append)
    port.plug()
    host = os.open(port.path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    tty.setraw(host)
    for command, answer in [
        (b"\r", b"\r"),
        (b"C\r", b"\a"),  # is closed
        (b"O\r", b"\a"),  # has no bit rate
        (b"F\r", b"\a"),
        (b"t1230\r", b"\a"),
        (b"S9\r", b"\a"),
        (b"S5\r", b"\r"),
        (b"Z0\r", b"\r"),
        (b"O\r", b"\r"),
        (b"S6\r", b"\a"),  # is open
        (b"F\r", b"F80\r"),  # 250 kbit/s on a bus of 500
        (b"C\r", b"\r"),
        (b"S6\r", b"\r"),
        (b"O\r", b"\r"),
        (b"F\r", b"F00\r"),
        (b"V\r", b"V1013\r"),
        (b"N\r", b"NF4KE\r"),
        (b"t1232AABB\r", b"z\r"),
        (b"T000001230\r", b"Z\r"),
        (b"t1232AAB\r", b"\a"),
        (b"x" * 100 + b"\r", b"\a"),
    ]:
        await expect_answer(host, command, answer)
    assert taken == [CanFrame(0x123, b"\xaa\xbb", extended=False), CanFrame(0x123, b"")]
    await adapter.send(POSITION)
    await expect_answer(host, b"V\r", b"T09F801038406DAB1CC0B9DA06\rV1013\r")
    adapter.power_cycle()
    await adapter.send(POSITION)
    await expect_answer(host, b"V\r", b"V1013\r")
    assert adapter.counters["adapter.unheard"] == 1
    os.close(host)
    port.unplug()


async def test_another_implementation_of_the_protocol_is_served(tmp_path: Path) -> None:
    taken: list[CanFrame] = []
    port = FakePort(tmp_path / "can", 115200)
    adapter = FakeSlcanAdapter(port, 250000, taken.append)
    port.plug()

    def open_bus() -> can.BusABC:
        return can.Bus(
            interface="slcan", channel=str(port.path), bitrate=250000, sleep_after_open=0.0, ignore_config=True
        )

    bus = await asyncio.to_thread(open_bus)
    async with asyncio.timeout(10.0):
        while not adapter.is_open:
            await asyncio.sleep(0.001)
        await adapter.send(POSITION)
        message = await asyncio.to_thread(bus.recv, 10.0)
        assert message is not None
        assert (message.arbitration_id, bytes(message.data)) == (POSITION.can_id, POSITION.data)
        await asyncio.to_thread(bus.send, can.Message(arbitration_id=7, data=b"\x01"))
        while not taken:
            await asyncio.sleep(0.001)
    assert taken == [CanFrame(7, b"\x01")]
    await asyncio.to_thread(bus.shutdown)
    port.unplug()
