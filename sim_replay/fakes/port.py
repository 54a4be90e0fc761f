"""Run a serial device's end of a pseudo-terminal, at a stable path, with the faults of cables."""

from __future__ import annotations

import array
import asyncio
import contextlib
import fcntl
import os
import select
import termios
import tty
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Final

from sim_replay.fakes.faults import Faults
from sim_replay.fakes.uart import misread

_SLICE_S: Final = 0.002  # on the line at once
_IN_TURN_S: Final = 0.0005  # s up to which a message follows the one before it without a break, on a busy computer
_PASSED_ON_S: Final = 0.01  # s after which a pseudo-terminal has passed on what was written; it takes some 10 us
_BITS_PER_BYTE: Final = 10  # 8N1
_KERNEL_BYTES: Final = 640 * 1024  # that Linux keeps for the reader of a tty (tty_buffer.c, TTYB_DEFAULT_MEM_LIMIT)
_BAUD_OF: Final = {
    getattr(termios, name): int(name[1:]) for name in dir(termios) if name[0] == "B" and name[1:].isdigit()
}


class FakePort:
    """Play a device's serial port; the host opens `path`. Used in a running event loop.

    Bytes leave at `baud`, in slices of 2 ms. A host that does not keep up loses bytes as behind a UART: what the kernel
    does not take is gone. A pseudo-terminal takes 12 kB; once a host has set up the port, the rest of what a tty's
    kernel holds waits here. A host set to another rate reads what a UART would. Rates that Linux has no name for cannot
    be seen and pass as set right.

    faults: damage to what is sent. on_bytes: what the host writes. stalled: while set, nothing passes in either
    direction, without a sign, as with a broken RS-232 cable. counters: port.sent, port.overrun, port.cut (bytes that
    were lost while unplugged, stalled or hung up), port.received.
    """

    def __init__(
        self, path: Path, baud: int, faults: Faults | None = None, on_bytes: Callable[[bytes], None] | None = None
    ) -> None:
        self.path = path
        self.baud = baud
        self.stalled = False
        self.on_bytes = on_bytes
        self.counters: Counter[str] = Counter()
        self._faults = faults
        self._master = self._slave = -1
        self._waiting = bytearray()  # of a set-up host that is busy
        self._is_hung_up = False
        self._line = asyncio.Lock()  # one message after the other
        self._free_s = 0.0  # loop time at which the line has carried all that was sent
        self._sent_s = 0.0  # loop time at which the last byte was written, somewhat later

    @property
    def plugged(self) -> bool:
        """Find whether the port is there."""
        return self._master >= 0

    @property
    def host_baud(self) -> int:
        """Return the rate the host has set, 0 for one that Linux has no name for.

        Raises RuntimeError while unplugged.
        """
        if not self.plugged:
            raise RuntimeError(f"{self.path}: no rate is set while the port is unplugged; plug it first")
        return _BAUD_OF.get(termios.tcgetattr(self._master)[5], 0)

    def plug(self) -> None:
        """Make the device appear at its path. No effect if it is there."""
        if self.plugged:
            return
        self._master, self._slave = os.openpty()  # without an open slave the master hangs up, too
        tty.setraw(self._slave)
        attributes = termios.tcgetattr(self._slave)
        attributes[4] = attributes[5] = getattr(termios, f"B{self.baud}", attributes[4])
        termios.tcsetattr(self._slave, termios.TCSANOW, attributes)
        os.set_blocking(self._master, False)
        asyncio.get_running_loop().add_reader(self._master, self._receive)
        new = self.path.with_name(self.path.name + ".new")
        new.unlink(missing_ok=True)
        new.symlink_to(os.ttyname(self._slave))
        new.replace(self.path)

    def unplug(self) -> None:
        """Remove the device at once, with all that the host has not read. No effect if it is not there."""
        if not self.plugged:
            return
        loop = asyncio.get_running_loop()
        loop.remove_reader(self._master)
        loop.remove_writer(self._master)
        self._cut(len(self._waiting))
        self._waiting.clear()
        self.path.unlink(missing_ok=True)
        os.close(self._slave)
        os.close(self._master)
        self._master = self._slave = -1

    def hang_up(self) -> None:
        """Close the host's end, as its kernel does when the program ends; what it had not read is lost.

        Nothing is kept for the next program until that has set up the port. No effect while unplugged.
        """
        if not self.plugged:
            return
        asyncio.get_running_loop().remove_writer(self._master)
        n_unread = 0  # FIONREAD leaves out what the pseudo-terminal still passes on
        while select.select([self._slave], [], [], _PASSED_ON_S)[0]:
            n_unread += len(os.read(self._slave, _KERNEL_BYTES))
        self._cut(n_unread + len(self._waiting))
        self._waiting.clear()
        attributes = termios.tcgetattr(self._slave)
        attributes[2] &= ~termios.CLOCAL
        termios.tcsetattr(self._slave, termios.TCSANOW, attributes)
        self._is_hung_up = True

    async def send(self, message: bytes) -> None:
        """Send a message after those before it; returns when its last byte has left. Losses are counted."""
        async with self._line:
            for delay_s, data in [(0.0, message)] if self._faults is None else self._faults.passed(message):
                if delay_s:
                    await asyncio.sleep(delay_s)
                await self._send(data)

    async def drain(self) -> None:
        """Wait until the host has read everything, or the device is unplugged."""
        n_unread = array.array("i", [1])
        while self.plugged:
            fcntl.ioctl(self._slave, termios.FIONREAD, n_unread)
            if n_unread[0] == 0 and not self._waiting:
                return
            await asyncio.sleep(_SLICE_S)

    async def _send(self, data: bytes) -> None:
        if self.plugged and self.host_baud not in (0, self.baud):
            data = misread(data, self.baud, self.host_baud)
        loop = asyncio.get_running_loop()
        bytes_per_s = self.baud / _BITS_PER_BYTE
        n_slice = max(int(bytes_per_s * _SLICE_S), 1)
        # A timer wakes up to a millisecond late. That is made up for in messages without a break between them, which
        # would never come to the line's rate otherwise.
        if loop.time() - self._sent_s > _IN_TURN_S:
            self._free_s = max(self._free_s, loop.time())
        for start in range(0, len(data), n_slice):
            piece = data[start : start + n_slice]
            self._free_s += len(piece) / bytes_per_s
            await asyncio.sleep(self._free_s - loop.time())
            self._put(piece)
        self._sent_s = loop.time()

    def _put(self, piece: bytes) -> None:
        if self._is_hung_up and self.plugged:
            self._is_hung_up = not self._is_set_up()
        if not self.plugged or self.stalled or self._is_hung_up:
            self.counters["port.cut"] += len(piece)
            return
        n_taken = 0 if self._waiting else self._written(piece)
        room = _KERNEL_BYTES - len(self._waiting) if self._is_set_up() else 0
        if n_taken < len(piece) and room > 0:
            kept = piece[n_taken : n_taken + room]
            self._waiting += kept
            n_taken += len(kept)
            asyncio.get_running_loop().add_writer(self._master, self._pass_on)
        self.counters["port.sent"] += n_taken
        self.counters["port.overrun"] += len(piece) - n_taken

    def _cut(self, n_bytes: int) -> None:
        """Count bytes as lost that were taken for sent."""
        if n_bytes == 0:
            return
        self.counters["port.sent"] -= n_bytes
        self.counters["port.cut"] += n_bytes

    def _written(self, data: bytes | bytearray) -> int:
        """Write, and return how many bytes the pseudo-terminal takes."""
        n_taken = 0
        with contextlib.suppress(BlockingIOError):
            while n_taken < len(data):
                n_taken += os.write(self._master, data[n_taken:])
        return n_taken

    def _pass_on(self) -> None:
        """Pass waiting bytes to the pseudo-terminal, as the host makes room."""
        del self._waiting[: self._written(self._waiting)]
        if not self._waiting:
            asyncio.get_running_loop().remove_writer(self._master)

    def _is_set_up(self) -> bool:
        """Report whether a program has set up the port.

        It then ignores modem lines, which a new pseudo-terminal does not.
        """
        return bool(termios.tcgetattr(self._master)[2] & termios.CLOCAL)

    def _receive(self) -> None:
        try:
            data = os.read(self._master, 1 << 16)
        except BlockingIOError:
            return
        if self.stalled:
            self.counters["port.cut"] += len(data)
            return
        self.counters["port.received"] += len(data)
        if self.on_bytes is not None:
            self.on_bytes(data)
