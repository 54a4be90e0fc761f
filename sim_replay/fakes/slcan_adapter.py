"""Run a CAN adapter with the Lawicel (slcan) protocol, and the bus behind it."""

from __future__ import annotations

import asyncio
import re
from collections import Counter
from collections.abc import Callable
from typing import Final

from drivers.links.can_frame import CanFrame
from drivers.links.slcan import SlcanParser, encode
from drivers.links.uri import CAN_BITRATES
from sim_replay.fakes.port import FakePort

_ACCEPTED: Final = b"\r"
_REFUSED: Final = b"\a"
_MAX_COMMAND_BYTES: Final = 64  # longer than any command of slcan; bounds memory
_BUS_ERROR: Final = 0x80  # status flag


class FakeSlcanAdapter:
    """Answer C, O, S, Z, V, N, F, t and T on a port. Takes over the port's on_bytes.

    bus_bitrate: of the bus; an adapter set to another one hears nothing of it, and its status reports a bus error.
    on_frame: what the host sends. is_open: the channel, closed by `power_cycle`. counters: adapter.frames_sent,
    .frames_taken, .refused, .unheard.
    """

    def __init__(self, port: FakePort, bus_bitrate: int, on_frame: Callable[[CanFrame], None] | None = None) -> None:
        self.port = port
        self.bus_bitrate = bus_bitrate
        self.on_frame = on_frame
        self.counters: Counter[str] = Counter()
        self._rest = b""
        self._answers: set[asyncio.Task[None]] = set()
        self.power_cycle()
        port.on_bytes = self._receive

    def power_cycle(self) -> None:
        """Reset the adapter's settings; its port stays, as behind a real UART."""
        self.is_open = False
        self._bitrate = 0

    async def send(self, frame: CanFrame) -> None:
        """Send a frame on the bus. The host gets it if the channel is open at the bus's bit rate."""
        if self.is_open and self._bitrate == self.bus_bitrate:
            self.counters["adapter.frames_sent"] += 1
            await self.port.send(encode(frame))
        else:
            self.counters["adapter.unheard"] += 1

    def _receive(self, data: bytes) -> None:
        *commands, self._rest = (self._rest + data).split(b"\r")
        self._rest = self._rest[-_MAX_COMMAND_BYTES:]
        for command in commands:
            answer = self._answer(command)
            self.counters["adapter.refused"] += answer == _REFUSED
            task = asyncio.get_running_loop().create_task(self.port.send(answer))
            self._answers.add(task)
            task.add_done_callback(self._answers.discard)

    def _answer(self, command: bytes) -> bytes:
        match command[:1], command[1:]:
            case (b"", _):
                return _ACCEPTED
            case (b"C", b"") if self.is_open:
                self.is_open = False
            case (b"O", b"") if not self.is_open and self._bitrate:
                self.is_open = True
            case (b"S", digit) if not self.is_open and re.fullmatch(rb"[0-8]", digit):
                self._bitrate = CAN_BITRATES[int(digit)]
            case (b"Z", b"0") if not self.is_open:
                pass
            case (b"V", b""):
                return b"V1013\r"
            case (b"N", b""):
                return b"NF4KE\r"
            case (b"F", b"") if self.is_open:
                return b"F%02X\r" % (0 if self._bitrate == self.bus_bitrate else _BUS_ERROR)
            case (b"t" | b"T", _) if self.is_open and self._take(command):
                return b"z\r" if command[:1] == b"t" else b"Z\r"
            case _:
                return _REFUSED
        return _ACCEPTED

    def _take(self, command: bytes) -> bool:
        frames = SlcanParser(Counter()).feed(command + b"\r")
        if not frames:
            return False
        self.counters["adapter.frames_taken"] += 1
        if self.on_frame is not None:
            self.on_frame(frames[0])
        return True
