"""Serve the health to monitors of this computer: GET /metrics for Prometheus, GET /health as JSON."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Callable
from typing import Final

from auv_mcm.errors import HardwareError
from auv_mcm.shell.health.record import Health
from auv_mcm.shell.health.text import prometheus_text

log = logging.getLogger(__name__)

_HOST: Final = "127.0.0.1"
_NAMES: Final = (_HOST, "localhost")
_MAX_REQUEST_BYTES: Final = 4096  # a monitor's takes some 200
_MAX_CONNECTIONS: Final = 4  # at a time; more are closed at once
_PATIENCE_S: Final = 2.0  # for the whole of a request and its answer: then the connection is closed


class HealthEndpoint:
    """Answer monitors of this computer, as long as it is open. Requests are bounded in size, number and time."""

    def __init__(self, port: int, newest: Callable[[], Health | None]) -> None:
        """newest: gives the record to answer with, None while there is none. port: 0 for any that is free."""
        self._port = port
        self._newest = newest
        self._n_open = 0
        self._server: asyncio.Server | None = None

    @property
    def port(self) -> int:
        """Give the port that it listens at."""
        assert self._server is not None
        return int(self._server.sockets[0].getsockname()[1])

    async def open(self) -> None:
        """Listen. Raises HardwareError for a port that cannot be had."""
        try:
            self._server = await asyncio.start_server(self._serve, _HOST, self._port, limit=_MAX_REQUEST_BYTES)
        except OSError as error:
            raise HardwareError(
                f"service.health_port {self._port} cannot be opened: {error.strerror}. Choose another one: 'ss -ltn' "
                "lists those that are taken"
            ) from error

    def close(self) -> None:
        """Stop listening."""
        if self._server is not None:
            self._server.close()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._n_open += 1
        try:
            if self._n_open <= _MAX_CONNECTIONS:
                async with asyncio.timeout(_PATIENCE_S):
                    request = await reader.readuntil(b"\r\n\r\n")
                    writer.write(self._answer(request))
                    await writer.drain()
        except (OSError, TimeoutError, asyncio.IncompleteReadError, asyncio.LimitOverrunError):
            pass  # whoever sends no request in time gets no answer
        finally:
            self._n_open -= 1
            writer.close()
            with contextlib.suppress(OSError):
                await writer.wait_closed()

    def _answer(self, request: bytes) -> bytes:
        first, *headers = request.decode("latin-1").split("\r\n")
        method, _, rest = first.partition(" ")
        target, _, protocol = rest.partition(" ")
        hosts = [
            value.strip() for name, _, value in (line.partition(":") for line in headers) if name.lower() == "host"
        ]
        if not protocol.startswith("HTTP/1."):
            return _response("400 Bad Request", "not a request of HTTP/1.1\n")
        # A page in a browser on this computer may have its own name point here; it still sends that name.
        if any(host.rpartition(":")[0] not in _NAMES and host not in _NAMES for host in hosts):
            return _response("403 Forbidden", "ask by the address 127.0.0.1\n")
        if method != "GET":
            return _response("405 Method Not Allowed", "only GET\n", "Allow: GET\r\n")
        if target not in ("/metrics", "/health"):
            return _response("404 Not Found", "there are /metrics and /health\n")
        health = self._newest()
        if health is None:
            return _response("503 Service Unavailable", "nothing has been measured yet\n")
        if target == "/health":
            return _response("200 OK", health.to_json().decode() + "\n", kind="application/json")
        return _response("200 OK", prometheus_text(health), kind="text/plain; version=0.0.4; charset=utf-8")


def _response(status: str, text: str, more: str = "", kind: str = "text/plain; charset=utf-8") -> bytes:
    body = text.encode()
    head = (
        f"HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {len(body)}\r\nConnection: close\r\n{more}\r\n"
    )
    return head.encode() + body
