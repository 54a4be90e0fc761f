"""Check a serial link against a device on a pseudo-terminal with the faults of cables."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import fcntl
import os
import termios
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
import serial

from auv_mcm.clock import Stamp
from drivers.links.link import Link
from drivers.links.open_link import byte_link
from drivers.links.stream import MAX_QUEUED_BYTES
from drivers.links.uri import SerialAddress
from sim_replay.fakes.port import FakePort
from tests.drivers.links.link_watch import (
    Watch,
    first_reason,
    open_descriptors,
    running,
    until,
    until_equal,
    up,
    watched_bytes,
)
from tests.drivers.links.loop_time import LoopTime, run_in_loop_time
from tests.manual_clock import ManualClock

BAUD = 4000000


def link_at(path: Path, options: str = "") -> tuple[Link[bytes], Watch[bytes]]:
    return watched_bytes(f"serial://{path}?baud={BAUD}{options}")


@contextlib.asynccontextmanager
async def plugged(folder: Path, options: str = "") -> AsyncIterator[tuple[FakePort, Link[bytes], Watch[bytes]]]:
    """Plug in a device, and bring up a link to it."""
    port = FakePort(folder / "tty", BAUD)
    port.plug()
    link, watch = link_at(port.path, options)
    async with up(link):
        yield port, link, watch
    port.unplug()


async def test_bytes_pass_both_ways_with_the_stamp_of_their_reading(tmp_path: Path) -> None:
    taken: list[bytes] = []
    port = FakePort(tmp_path / "tty", 115200, on_bytes=taken.append)
    port.plug()
    clock = ManualClock(1_700_000_000.0)
    clock.advance_to(1_700_000_002.5)
    watch = Watch[bytes]()
    link = byte_link(SerialAddress(str(port.path), 115200), watch.on_data, watch.on_state, clock)
    async with up(link):
        assert port.host_baud == 115200
        await port.send(b"$GPHDT,90.0,T*0C\r\n")
        await until(lambda: b"".join(watch.items) == b"$GPHDT,90.0,T*0C\r\n")
        assert set(watch.stamps) == {Stamp(2_500_000_000, 1_700_000_002_500_000_000)}
        assert link.write(b"ping")
        assert link.write(b"-pong")
        await until(lambda: b"".join(taken) == b"ping-pong")
    assert link.counters["link.bytes_in"] == 18
    assert link.counters["link.bytes_out"] == 9
    assert watch.states == ["up", "down"]
    port.unplug()


async def test_an_unplugged_device_is_reported_at_once_and_served_again_when_it_is_back(tmp_path: Path) -> None:
    port = FakePort(tmp_path / "tty", BAUD)
    link, watch = link_at(port.path)
    async with running(link):
        await until(lambda: watch.reports)
        assert "no such device" in watch.reason
        for n in range(3):
            port.plug()
            await until(lambda: link.state == "up")
            await port.send(b"%d" % n)
            await until_equal(lambda: b"".join(watch.items), b"012"[: n + 1])
            port.unplug()
            await until(lambda: link.state == "down")
            reads = link.counters["link.reads"]
            assert "hung up" in watch.reason
            assert not link.write(b"into the void")
            await asyncio.sleep(0.05)
            assert link.counters["link.reads"] == reads, "a wire that hung up must not be read again"
    assert b"".join(watch.items) == b"012"
    assert link.counters["link.lost"] == 3
    assert link.counters["link.writes_refused"] == 3
    assert watch.states == ["down", *["up", "down"] * 3, "down"]


async def test_an_unplugged_device_is_reported_once_and_again_only_if_what_comes_back_cannot_be_opened(
    tmp_path: Path,
) -> None:
    async with plugged(tmp_path) as (port, link, watch):
        port.unplug()
        await until(lambda: link.state == "down")
        await asyncio.sleep(0.2)
        assert watch.states == ["up", "down"]
        port.path.write_bytes(b"no port")
        await until(lambda: len(watch.reports) == 3)
        assert "cannot be used as a serial port" in watch.reason
        port.path.unlink()
        port.plug()
        await until(lambda: link.state == "up")


def test_a_link_without_its_device_looks_for_it_50_times_a_second_and_tries_nothing_else(tmp_path: Path) -> None:
    async def scenario(loop: LoopTime) -> None:
        link, watch = link_at(tmp_path / "absent")
        async with running(link):
            await until(lambda: watch.reports)
            n_before = loop.n_wake_ups
            await asyncio.sleep(10.0)
            # To be woken takes a turn for the timer and one for the task.
            assert loop.n_wake_ups - n_before <= 2 * 50 * 10 + 10
            assert link.counters == {"link.open_failed": 1}

    run_in_loop_time(scenario)


async def test_a_cable_that_fails_without_a_word_is_reported_as_silent(tmp_path: Path) -> None:
    async with plugged(tmp_path, "&silent_s=0.05") as (port, link, watch):
        port.stalled = True
        await port.send(b"lost")
        await until(lambda: link.state == "silent")
        assert "nothing received for 0.05 s" in watch.reason
        assert f"{BAUD} baud" in watch.reason
        await until(lambda: link.counters["link.silences"] >= 3)
        port.stalled = False
        await port.send(b"again")
        await until(lambda: watch.items)
    assert watch.states[:3] == ["up", "silent", "up"], "reported once however long it lasts"
    assert link.counters["link.opened"] == 1


async def test_silence_is_measured_with_the_clock_that_is_given(tmp_path: Path) -> None:
    port = FakePort(tmp_path / "tty", BAUD)
    port.plug()
    clock = ManualClock()
    watch = Watch[bytes]()
    link = byte_link(SerialAddress(str(port.path), BAUD, 0.05), watch.on_data, watch.on_state, clock)
    async with up(link):
        clock.advance_to(0.04)
        await port.send(b"x")
        await until(lambda: watch.items)
        clock.advance_to(0.08)
        await asyncio.sleep(0.15)
        assert link.state == "up"
        clock.advance_to(0.1)
        await until(lambda: link.state == "silent")
        await asyncio.sleep(0.05)
        assert link.counters["link.silences"] == 1
    port.unplug()


async def test_writes_queue_up_to_a_bound_and_leave_in_order_when_the_device_reads_again(tmp_path: Path) -> None:
    """The device is a bare pseudo-terminal that nobody reads until the end."""
    master, slave = os.openpty()
    link, _ = link_at(Path(os.ttyname(slave)))
    async with up(link):
        sent = b""
        for n in range(100_000):
            piece = b"%06d" % n
            if not link.write(piece):
                break
            sent += piece
        assert link.counters["link.writes_refused"] == 1
        assert MAX_QUEUED_BYTES - 6 <= len(sent) - link.counters["link.bytes_out"] <= MAX_QUEUED_BYTES
        os.set_blocking(master, False)
        came = b""
        while len(came) < len(sent):
            try:
                came += os.read(master, 65536)
            except BlockingIOError:
                await asyncio.sleep(0.001)
        assert came == sent
        assert link.write(b"room again")
    os.close(master)
    os.close(slave)


async def test_being_woken_for_nothing_is_not_taken_for_a_hang_up(tmp_path: Path) -> None:
    """Others that read the same port get the bytes that the link was woken for."""
    port = FakePort(tmp_path / "tty", BAUD)
    port.plug()
    loop = asyncio.get_running_loop()
    stolen: list[bytes] = []

    def steal(thief: int) -> None:
        with contextlib.suppress(BlockingIOError):
            stolen.append(os.read(thief, 65536))

    thieves = [os.open(port.path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK) for _ in range(16)]
    link, watch = link_at(port.path)
    for thief in thieves[:8]:
        loop.add_reader(thief, steal, thief)
    async with up(link):
        for thief in thieves[8:]:
            loop.add_reader(thief, steal, thief)
        n_sent = 0
        while link.counters["link.reads"] == len(watch.items):  # until it was woken for nothing
            await port.send(b"x")
            n_sent += 1
        await until(lambda: len(b"".join(watch.items + stolen)) == n_sent)
        assert watch.states == ["up"]
        for thief in thieves:
            loop.remove_reader(thief)
            os.close(thief)
    port.unplug()


async def test_garbage_as_fast_as_it_comes_leaves_nothing_behind(tmp_path: Path) -> None:
    master, slave = os.openpty()
    n_bytes = 0

    def count(data: bytes, stamp: Stamp) -> None:
        nonlocal n_bytes
        assert len(data) <= 65536
        n_bytes += len(data)

    link = byte_link(SerialAddress(os.ttyname(slave), BAUD), count, lambda state, reason: None, ManualClock())
    async with up(link):
        os.set_blocking(master, False)
        garbage = bytes(range(256)) * 16
        n_sent = 0
        while n_sent < 2_000_000:
            try:
                n_sent += os.write(master, garbage)
            except BlockingIOError:
                await asyncio.sleep(0)
        await until(lambda: n_bytes == n_sent)
    os.close(master)
    os.close(slave)


def test_receivers_that_fail_do_not_stop_a_link(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    async def scenario() -> None:
        port = FakePort(tmp_path / "tty", BAUD)
        port.plug()
        n_calls = 0

        def fail(data: bytes, stamp: Stamp) -> None:
            nonlocal n_calls
            n_calls += 1
            raise RuntimeError("a decoder with a defect")

        def fail_too(state: str, reason: str) -> None:
            raise RuntimeError("a listener with a defect")

        link = byte_link(SerialAddress(str(port.path), BAUD), fail, fail_too, ManualClock())
        loop_errors: list[object] = []
        asyncio.get_running_loop().set_exception_handler(lambda loop, context: loop_errors.append(context))
        async with up(link):
            for n in range(1, 4):
                await port.send(b"x")
                await until_equal(lambda: n_calls, n)
        assert link.counters["link.callback_failed"] == 5
        assert not loop_errors
        port.unplug()

    asyncio.run(scenario())
    assert len([record for record in caplog.records if "a receiver failed" in record.message]) == 1


async def test_a_port_in_use_is_reported_with_a_way_to_find_who_uses_it(tmp_path: Path) -> None:
    port = FakePort(tmp_path / "tty", BAUD)
    port.plug()
    other = os.open(port.path, os.O_RDWR | os.O_NOCTTY)
    fcntl.flock(other, fcntl.LOCK_EX)
    link, watch = link_at(port.path)
    async with running(link):
        await until(lambda: watch.reports)
        assert watch.states == ["down"]
        assert (
            watch.reason
            == f"{port.path}: in use by another program. Stop that one: fuser -v {port.path} shows which it is."
        )
        os.close(other)
        await until(lambda: link.state == "up")
        second, second_watch = link_at(port.path)
        async with running(second):
            await until(lambda: second_watch.reports)
            assert "in use" in second_watch.reason
    port.unplug()


def reason_for(path: Path) -> str:
    return first_reason(f"serial://{path}?baud={BAUD}")


def test_a_path_that_is_not_a_serial_port_is_reported(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("not a port")
    assert "cannot be used as a serial port" in reason_for(tmp_path / "file")
    assert "cannot be used as a serial port" in reason_for(tmp_path)
    assert "no such device" in reason_for(tmp_path / "absent")


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (
            serial.SerialException(errno.EACCES, "could not open"),
            "permission denied. Add the user of this service to the group",
        ),
        (serial.SerialException(errno.ENODEV, "could not open"), "does not answer"),
        (termios.error(errno.EIO, "Input/output error"), "does not answer"),
        (ValueError("Failed to set custom baud rate"), "cannot be used"),
    ],
)
def test_whatever_opening_a_port_raises_is_reported(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, error: Exception, words: str
) -> None:
    def fail(self: serial.Serial) -> None:
        raise error

    monkeypatch.setattr(serial.Serial, "open", fail)
    assert words in reason_for(tmp_path / "tty")


def test_a_rate_that_the_port_silently_does_not_take_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    master, slave = os.openpty()
    monkeypatch.setattr(
        serial.Serial, "_reconfigure_port", lambda self, force_update=False: None
    )  # leaves the rate as it is
    assert f"does not take {BAUD} baud" in reason_for(Path(os.ttyname(slave)))
    os.close(master)
    os.close(slave)


def test_modem_lines_are_left_alone(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    touched: list[str] = []
    for name in ("_update_dtr_state", "_update_rts_state"):
        monkeypatch.setattr(serial.Serial, name, lambda self, name=name: touched.append(name))

    async def scenario() -> None:
        port = FakePort(tmp_path / "tty", BAUD)
        port.plug()
        link, _ = link_at(port.path)
        async with up(link):
            pass
        port.unplug()

    asyncio.run(scenario())
    assert not touched


async def test_no_descriptor_stays_open_whenever_a_link_is_ended(tmp_path: Path) -> None:
    port = FakePort(tmp_path / "tty", BAUD)
    port.plug()
    link, _ = link_at(port.path)
    async with up(link):
        pass
    before = open_descriptors()
    for wait_s in (0.0, 0.0002, 0.0005, 0.001, 0.002, 0.01):
        link, _ = link_at(port.path)
        async with running(link):
            await asyncio.sleep(wait_s)
    await until(lambda: open_descriptors() == before)
    port.unplug()
