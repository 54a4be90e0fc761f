"""Bound what clients of the page may hold: connections, and time in which they neither ask nor take an answer."""

from __future__ import annotations

import asyncio
import logging
from typing import Final

from aiohttp import web
from aiohttp.http_exceptions import HttpProcessingError
from aiohttp.web_protocol import RequestHandler

log = logging.getLogger(__name__)

MAX_CONNECTIONS: Final = 64  # a browser opens six
IDLE_S: Final = 20.0
"""s without a request at work after which a connection is closed: a head takes a browser milliseconds, the largest
answer, 0.3 MB, a second at 3 Mbit/s. A browser opens another one when it needs it."""
BODY_S: Final = 10.0  # s for the 16 kB of a body, at most
_LOOK_S: Final = 1.0  # s between two looks for idle connections


class NotBadRequests(logging.Filter):
    """Leave out of the log what clients sent wrong: they get an answer, and nobody here has to do anything."""

    def filter(self, record: logging.LogRecord) -> bool:
        """Check whether a record is about anything but a bad request."""
        return not (record.exc_info and isinstance(record.exc_info[1], HttpProcessingError))


log.addFilter(NotBadRequests())


class Patience:
    """Accept connections up to a number, and close those that do nothing."""

    def __init__(self, max_connections: int = MAX_CONNECTIONS, idle_s: float = IDLE_S) -> None:
        self._max_connections = max_connections
        self._idle_s = idle_s
        self._at_work: dict[object, int] = {}  # requests being answered, by connection
        self._since_s: dict[object, float] = {}  # when each idle connection was first seen idle

    def begin(self, request: web.Request) -> None:
        """Note that a request is being answered."""
        self._at_work[request.protocol] = self._at_work.get(request.protocol, 0) + 1

    def end(self, request: web.Request) -> None:
        """Note that it was."""
        self._at_work.pop(request.protocol, None)
        self._since_s.pop(request.protocol, None)

    def accept(self, server: web.Server) -> asyncio.BaseProtocol:
        """Make the protocol of a new connection; one beyond the number is closed at once."""
        return _Refusal() if len(server.connections) >= self._max_connections else server()

    async def watch(self, server: web.Server) -> None:
        """Close idle connections until cancelled."""
        loop = asyncio.get_running_loop()
        while True:
            await asyncio.sleep(min(_LOOK_S, self._idle_s / 4.0))
            idle: list[RequestHandler] = [one for one in server.connections if one not in self._at_work]
            self._since_s = {one: self._since_s.get(one, loop.time()) for one in idle}
            for one in idle:
                if loop.time() - self._since_s[one] >= self._idle_s and one.transport is not None:
                    one.transport.abort()


class _Refusal(asyncio.Protocol):
    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        transport.close()
