"""Open TCP connections to a device."""

from __future__ import annotations

import asyncio
import socket
from collections import Counter
from typing import Any, Final

from auv_mcm.errors import HardwareError
from drivers.links.gather import GATHER_S
from drivers.links.stream import StreamPort

CONNECT_S: Final = 5.0  # s for a connection: long enough for a SYN packet repeated after 1 s and 3 s
_OPTIONS: Final = (
    (socket.IPPROTO_TCP, socket.TCP_NODELAY, 1),
    (socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1),
    (socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, 5),
    (socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, 2),
    (socket.IPPROTO_TCP, socket.TCP_KEEPCNT, 3),
    (socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, 10_000),
)


async def open_tcp(host: str, port: int, counters: Counter[str]) -> StreamPort:
    """Connect, trying each address of the host. Raises HardwareError that says what to do.

    A device that loses power leaves the connection standing: the kernel's keep-alive notices within 11 s; a link that
    is silent for as long as it may connects anew, which also helps against a device that hangs.
    """
    place = f"tcp://{host}:{port}"
    addresses = await addresses_of(host, port, socket.SOCK_STREAM, place)
    refused = HardwareError(f"{place}: no address")
    for family, address in addresses:
        connection = socket.socket(family, socket.SOCK_STREAM | socket.SOCK_NONBLOCK)
        try:
            for level, option, value in _OPTIONS:
                connection.setsockopt(level, option, value)
            async with asyncio.timeout(CONNECT_S):
                await asyncio.get_running_loop().sock_connect(connection, address)
        except OSError as error:  # a timeout is one, too
            connection.close()
            refused = HardwareError(_refusal(place, error))
            continue
        except BaseException:
            connection.close()
            raise
        return _port(connection, place, counters)
    raise refused


def _port(connection: socket.socket, place: str, counters: Counter[str]) -> StreamPort:
    def lost(error: OSError | None) -> str:
        how = "the device closed the connection" if error is None else f"the connection failed ({error.strerror})"
        return f"{place}: {how}. Check that it is running; it is connected again as soon as it answers."

    def on_silence() -> str:
        raise HardwareError(
            f"{place}: nothing received, so the connection counts as lost. Check that the device is running and sends."
        )

    return StreamPort(connection.fileno(), connection.close, lost, on_silence, GATHER_S, counters)


async def addresses_of(
    host: str, port: int, kind: socket.SocketKind, place: str, family: int = 0
) -> list[tuple[int, tuple[Any, ...]]]:
    """Return address family and socket address for each address of a host.

    Raises HardwareError for one that has none.
    """
    try:
        found = await asyncio.get_running_loop().getaddrinfo(host, port, type=kind, family=family)
    except (OSError, UnicodeError) as error:
        raise HardwareError(
            f"{place}: host '{host}' is unknown ({error}). Check its name, or write its address in numbers."
        ) from error
    return [(entry[0], entry[4]) for entry in found]


def _refusal(place: str, error: OSError) -> str:
    match error:
        case ConnectionRefusedError():
            return (
                f"{place}: refused. The host is there, but nothing listens on this port: check it, and start the "
                "device."
            )
        case TimeoutError():
            return f"{place}: no answer within {CONNECT_S:g} s. Check the cable, the device's power and its address."
    return f"{place}: cannot be reached ({error.strerror}). Check the cable, the network settings and the address."
