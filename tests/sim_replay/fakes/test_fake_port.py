"""The fake device's end against a plain host that opens its path."""

from __future__ import annotations

import asyncio
import errno
import os
import select
import subprocess
import sys
import termios
import time
import tty
from pathlib import Path

import pytest

from sim_replay.fakes.faults import FaultRates, Faults
from sim_replay.fakes.port import FakePort

GENEROUS_S = 10.0


def opened(path: Path, baud: int | None = None) -> int:
    host = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    tty.setraw(host)
    if baud is not None:
        attributes = termios.tcgetattr(host)
        attributes[4] = attributes[5] = getattr(termios, f"B{baud}")
        termios.tcsetattr(host, termios.TCSANOW, attributes)
    return host


async def read_bytes(host: int, n_bytes: int) -> bytes:
    """So many, or those that come until the line has been quiet for 50 ms."""
    data = b""
    while len(data) < n_bytes:
        ready, _, _ = await asyncio.to_thread(select.select, [host], [], [], 0.05)
        if not ready:
            break
        data += os.read(host, n_bytes - len(data))
    return data


async def test_bytes_pass_both_ways_at_a_stable_path(tmp_path: Path) -> None:
    taken: list[bytes] = []
    port = FakePort(tmp_path / "sonar", 921600, on_bytes=taken.append)
    for _ in range(2):
        port.plug()
        host = opened(port.path)
        await port.send(b"from the device\x00\xff\r\n")
        assert await read_bytes(host, 19) == b"from the device\x00\xff\r\n"
        os.write(host, b"from the host")
        async with asyncio.timeout(GENEROUS_S):
            while b"".join(taken) != b"from the host":
                await asyncio.sleep(0.001)
        taken.clear()
        os.close(host)
        port.unplug()
        assert not port.path.is_symlink()
    assert port.counters == {"port.sent": 38, "port.overrun": 0, "port.received": 26}


async def test_a_line_is_no_faster_than_its_rate(tmp_path: Path) -> None:
    port = FakePort(tmp_path / "sonar", 115200)
    port.plug()
    start_s = time.monotonic()
    await asyncio.gather(port.send(bytes(600)), port.send(bytes(552)))
    assert time.monotonic() - start_s >= 0.1
    port.unplug()


async def test_short_messages_without_a_break_come_at_the_rate_of_the_line_though_timers_wake_late(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    port = FakePort(tmp_path / "can", 1_000_000)
    port.plug()
    now_s, yielded = 100.0, asyncio.sleep

    async def wake_late(delay_s: float) -> None:
        nonlocal now_s
        now_s += delay_s + 0.001 if delay_s > 0.0 else 0.0
        await yielded(0)

    monkeypatch.setattr(asyncio.get_running_loop(), "time", lambda: now_s)
    monkeypatch.setattr(asyncio, "sleep", wake_late)
    for _ in range(100):
        await port.send(bytes(27))
    assert now_s - 100.0 == pytest.approx(100 * 27 * 10 / 1e6, abs=0.002)
    now_s += 1.0  # a break gives no credit
    before_s = now_s
    await port.send(bytes(50))
    assert now_s - before_s >= 0.0005
    monkeypatch.undo()
    port.unplug()


async def test_messages_sent_at_once_leave_one_after_the_other(tmp_path: Path) -> None:
    port = FakePort(tmp_path / "sonar", 921600)
    port.plug()
    host = opened(port.path)
    messages = [bytes([n]) * 300 for n in range(8)]
    await asyncio.gather(*map(port.send, messages))
    assert await read_bytes(host, 2400) == b"".join(messages)
    os.close(host)
    port.unplug()


async def test_an_unplugged_device_hangs_up_and_what_it_sends_is_counted_as_cut(tmp_path: Path) -> None:
    port = FakePort(tmp_path / "sonar", 921600)
    port.plug()
    host = opened(port.path)
    port.unplug()
    port.unplug()
    assert os.read(host, 10) == b""
    with pytest.raises(OSError, match="Input/output error") as raised:
        os.write(host, b"anybody there?")
    assert raised.value.errno == errno.EIO
    await port.send(b"nobody hears this")
    await port.drain()
    assert port.counters["port.cut"] == 17
    with pytest.raises(RuntimeError, match="plug it first"):
        _ = port.host_baud
    os.close(host)


async def test_a_stalled_line_loses_both_ways_without_a_hang_up(tmp_path: Path) -> None:
    taken: list[bytes] = []
    port = FakePort(tmp_path / "sonar", 921600, on_bytes=taken.append)
    port.plug()
    host = opened(port.path)
    port.stalled = True
    await port.send(b"lost")
    os.write(host, b"lost, too")
    async with asyncio.timeout(GENEROUS_S):
        while port.counters["port.cut"] != 13:
            await asyncio.sleep(0.001)
    port.stalled = False
    await port.send(b"heard")
    assert await read_bytes(host, 100) == b"heard"
    assert not taken
    os.close(host)
    port.unplug()


async def test_a_busy_host_that_has_set_up_the_port_loses_nothing_that_a_kernel_would_hold(tmp_path: Path) -> None:
    port = FakePort(tmp_path / "sonar", 4000000)
    port.plug()
    host = opened(port.path, 4000000)
    attributes = termios.tcgetattr(host)
    attributes[2] |= termios.CLOCAL
    termios.tcsetattr(host, termios.TCSANOW, attributes)
    sent = bytes(range(250)) * 400
    await port.send(sent[:50_000])
    await port.send(sent[50_000:])
    assert port.counters["port.overrun"] == 0
    assert await read_bytes(host, len(sent)) == sent
    async with asyncio.timeout(GENEROUS_S):
        await port.drain()
    await port.send(sent)
    port.unplug()
    assert port.counters["port.cut"] > 50_000
    assert port.counters["port.sent"] + port.counters["port.cut"] == 2 * len(sent)
    os.close(host)


async def test_a_host_that_hung_up_loses_what_it_had_not_read_and_all_until_it_sets_the_port_up_again(
    tmp_path: Path,
) -> None:
    port = FakePort(tmp_path / "sonar", 4000000)
    port.plug()
    for _ in range(2):
        host = opened(port.path, 4000000)
        attributes = termios.tcgetattr(host)
        attributes[2] |= termios.CLOCAL
        termios.tcsetattr(host, termios.TCSANOW, attributes)
        await port.send(b"heard")
        assert await read_bytes(host, 100) == b"heard"
        await port.send(bytes(40_000))
        os.close(host)
        port.hang_up()
        await port.send(b"lost")
    assert port.counters == {"port.sent": 2 * 5, "port.overrun": 0, "port.cut": 2 * 40_004}
    port.unplug()


async def test_a_host_that_does_not_read_loses_what_the_kernel_cannot_hold(tmp_path: Path) -> None:
    port = FakePort(tmp_path / "sonar", 4000000)
    port.plug()
    host = opened(port.path, 4000000)
    await port.send(bytes(60_000))
    assert port.counters["port.overrun"] > 20_000
    assert port.counters["port.sent"] + port.counters["port.overrun"] == 60_000
    assert await read_bytes(host, 60_000) == bytes(port.counters["port.sent"])
    await port.drain()
    await port.send(b"room again")
    assert await read_bytes(host, 10) == b"room again"
    os.close(host)
    port.unplug()


async def test_a_host_at_another_rate_reads_what_a_uart_would(tmp_path: Path) -> None:
    port = FakePort(tmp_path / "sonar", 9600)
    port.plug()
    assert port.host_baud == 9600
    host = opened(port.path, 19200)
    assert port.host_baud == 19200
    await port.send(b"\xff")
    await port.send(b"\x55")
    assert await read_bytes(host, 10) == b"\xfe\x00\xe6"
    opened_again = opened(port.path, 9600)
    await port.send(b"\x55\xff")
    assert await read_bytes(host, 10) == b"\x55\xff"
    os.close(host)
    os.close(opened_again)
    port.unplug()


async def test_faults_are_drawn_per_message_and_the_same_for_the_same_seed(tmp_path: Path) -> None:
    rates = FaultRates(flip_byte=0.02, drop_byte=0.02, repeat_byte=0.02, truncate=0.1, delay=0.2, delay_s=0.001)
    messages = [bytes([n]) * 50 for n in range(40)]
    expected = Faults(rates, 5)
    damaged = b"".join(data for message in messages for _, data in expected.passed(message))
    port = FakePort(tmp_path / "sonar", 4000000, Faults(rates, 5))
    port.plug()
    host = opened(port.path, 4000000)
    for message in messages:
        await port.send(message)
    assert await read_bytes(host, len(damaged)) == damaged
    os.close(host)
    port.unplug()


async def test_a_host_in_another_process_is_served(tmp_path: Path) -> None:
    host = (
        "import serial, sys\n"
        "port = serial.Serial(sys.argv[1], 57600, timeout=10, exclusive=True)\n"
        "port.write(b'ready')\n"
        "sys.stdout.write(port.read(5).decode())\n"
    )
    ready = asyncio.Event()
    port = FakePort(tmp_path / "sonar", 57600, on_bytes=lambda data: ready.set())
    port.plug()
    process = await asyncio.create_subprocess_exec(sys.executable, "-c", host, str(port.path), stdout=subprocess.PIPE)
    async with asyncio.timeout(30.0):
        await ready.wait()
        assert port.host_baud == 57600
        await port.send(b"hello")
        out, _ = await process.communicate()
    assert out == b"hello"
    port.unplug()


async def test_a_stale_path_is_taken_over(tmp_path: Path) -> None:
    path = tmp_path / "sonar"
    path.symlink_to("/dev/pts/gone")
    path.with_name("sonar.new").symlink_to("/dev/pts/gone")
    port = FakePort(path, 9600)
    port.plug()
    port.plug()
    os.close(opened(path))
    port.unplug()
    assert list(tmp_path.iterdir()) == []
