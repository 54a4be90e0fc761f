"""Report start, life and end to the service manager that started this process, as sd_notify(3) of systemd asks for.

Datagrams go to the socket that the environment names, from the event loop: one that hangs is thus found by the manager
and started again. Without such a socket nothing happens.
"""

from __future__ import annotations

import asyncio
import logging
import os
import socket
from typing import Final

log = logging.getLogger(__name__)

_SOCKET, _WATCHDOG_US, _WATCHDOG_PID = "NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID"
_FEEDS_PER_PERIOD: Final = 3  # sd_watchdog_enabled(3) recommends two and more; the third allows for one that is late


def report(*states: str) -> None:
    """Send states such as `READY=1` to the service manager. A manager that cannot be reached costs a warning."""
    address = os.environ.get(_SOCKET, "")
    if not address.startswith(("/", "@")):
        return
    if address.startswith("@"):  # a name that is no file, Linux's own
        address = "\0" + address[1:]
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as sender:
            sender.setblocking(False)  # a manager that reads no more must not hold up the ports
            sender.connect(address)
            sender.send("\n".join(states).encode())
    except OSError as error:
        log.warning("the service manager takes no state at %s: %s", os.environ[_SOCKET], error.strerror)


def watchdog_s() -> float | None:
    """Return the time without a sign of life after which the manager ends this process, s; None if it does not."""
    if os.environ.get(_WATCHDOG_PID, str(os.getpid())) != str(os.getpid()):
        return None  # it watches the process that started this one
    try:
        period_us = int(os.environ.get(_WATCHDOG_US, "0"))
    except ValueError:
        return None
    return period_us * 1e-6 if period_us > 0 else None


async def feed_watchdog() -> None:
    """Give signs of life from the event loop for as long as the manager asks for them."""
    period_s = watchdog_s()
    while period_s is not None:
        report("WATCHDOG=1")
        await asyncio.sleep(period_s / _FEEDS_PER_PERIOD)
