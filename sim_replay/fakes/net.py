"""Put devices on a network cable: a TCP server and a sender of UDP datagrams, with the faults of a serial port's
fake."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import struct
from collections import Counter
from collections.abc import Callable
from typing import Final

from sim_replay.fakes.faults import Faults

_RESET: Final = struct.pack("ii", 1, 0)  # SO_LINGER: discard and reset instead of an orderly end


class FakeTcpServer:
    """Serve a device that listens on `port` of this computer. Each send is a message of its own for `faults`.

    stalled: while set, what is sent or received is lost without a sign, as by a device that hangs. counters:
    tcp.connections, tcp.sent, tcp.received, tcp.cut (bytes).
    """

    def __init__(self, faults: Faults | None = None, on_bytes: Callable[[bytes], None] | None = None) -> None:
        self.port = 0
        self.stalled = False
        self.counters: Counter[str] = Counter()
        self._faults = faults
        self._on_bytes = on_bytes
        self._server: asyncio.Server | None = None
        self._clients: set[asyncio.StreamWriter] = set()

    @property
    def n_clients(self) -> int:
        """Count the clients that are connected."""
        return len(self._clients)

    async def start(self) -> None:
        """Listen, the second time on the same port as the first."""
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", self.port)
        self.port = self._server.sockets[0].getsockname()[1]

    async def stop(self, *, reset: bool = False) -> None:
        """End all connections, orderly or by a reset, and refuse new ones."""
        if self._server is not None:
            self._server.close()
            self._server = None
        await self.drop_clients(reset=reset)

    async def drop_clients(self, *, reset: bool = False) -> None:
        """End all connections; the clients may connect again."""
        clients, self._clients = self._clients, set()
        for client in clients:
            if reset:
                client.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET)
            client.close()
            with contextlib.suppress(OSError):
                await client.wait_closed()

    async def send(self, message: bytes) -> None:
        """Send to all clients."""
        for delay_s, data in [(0.0, message)] if self._faults is None else self._faults.passed(message):
            if delay_s:
                await asyncio.sleep(delay_s)
            if self.stalled:
                self.counters["tcp.cut"] += len(data)
                continue
            for client in list(self._clients):
                client.write(data)
                with contextlib.suppress(OSError):
                    await client.drain()
                self.counters["tcp.sent"] += len(data)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.counters["tcp.connections"] += 1
        self._clients.add(writer)
        with contextlib.suppress(OSError, asyncio.CancelledError):
            while data := await reader.read(1 << 16):
                self.counters["tcp.cut" if self.stalled else "tcp.received"] += len(data)
                if self._on_bytes is not None and not self.stalled:
                    self._on_bytes(data)
        self._clients.discard(writer)
        writer.close()


class FakeUdpDevice:
    """Play a device that sends datagrams to host:port of this computer, and hears what comes to its own `port`.

    Used in a running event loop.

    Delayed datagrams are overtaken by others. stalled: as for FakeTcpServer. counters: udp.sent, udp.received, udp.cut
    (datagrams).
    """

    def __init__(self, faults: Faults | None = None, on_bytes: Callable[[bytes], None] | None = None) -> None:
        self.stalled = False
        self.counters: Counter[str] = Counter()
        self._faults = faults
        self._on_bytes = on_bytes
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        self._socket.bind(("127.0.0.1", 0))
        self.port: int = self._socket.getsockname()[1]
        asyncio.get_running_loop().add_reader(self._socket, self._receive)

    def send(self, message: bytes, host: str, port: int) -> None:
        """Send a message as one datagram."""
        for delay_s, data in [(0.0, message)] if self._faults is None else self._faults.passed(message):
            asyncio.get_running_loop().call_later(delay_s, self._put, data, (host, port))

    def close(self) -> None:
        """Close; datagrams still delayed are lost."""
        asyncio.get_running_loop().remove_reader(self._socket)
        self._socket.close()

    def _put(self, data: bytes, to: tuple[str, int]) -> None:
        if self.stalled or self._socket.fileno() < 0:
            self.counters["udp.cut"] += 1
            return
        with contextlib.suppress(OSError):
            self._socket.sendto(data, to)
            self.counters["udp.sent"] += 1

    def _receive(self) -> None:
        with contextlib.suppress(OSError):
            data = self._socket.recv(1 << 16)
            self.counters["udp.cut" if self.stalled else "udp.received"] += 1
            if self._on_bytes is not None and not self.stalled:
                self._on_bytes(data)
