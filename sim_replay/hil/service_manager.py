"""Listen to the service as its manager does, by sd_notify(3) of systemd: that it is ready, lives, and stops."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import time
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Final

from sim_replay.hil.evidence import Line
from sim_replay.hil.rules import Watched

_MAX_BYTES: Final = 65_536  # of one message
_US_PER_S: Final = 1e6  # microseconds per second


class ServiceManager:
    """Take what the service reports, with times of the monotonic clock; asks for nothing where watchdog_s is None."""

    def __init__(self, watchdog_s: float | None) -> None:
        """watchdog_s: within which signs of life have to come."""
        self.reports: list[tuple[float, str]] = []
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK | socket.SOCK_CLOEXEC)
        self._socket.bind("")  # Linux chooses a name that is no file
        name = self._socket.getsockname()[1:].decode("ascii")
        asked = {} if watchdog_s is None else {"WATCHDOG_USEC": str(round(_US_PER_S * watchdog_s))}
        self.environment: Final[Mapping[str, str]] = asked and {"NOTIFY_SOCKET": f"@{name}", **asked}

    def listen(self) -> None:
        """Listen from now on, in the running event loop."""
        asyncio.get_running_loop().add_reader(self._socket.fileno(), self._read)

    def close(self) -> None:
        """Listen no more."""
        asyncio.get_running_loop().remove_reader(self._socket.fileno())
        self._socket.close()

    def _read(self) -> None:
        with contextlib.suppress(BlockingIOError):
            while True:
                text = self._socket.recv(_MAX_BYTES).decode("utf-8", "replace")
                self.reports += [(time.monotonic(), state) for state in text.split("\n")]


def watched(rule: Watched, reports: Sequence[Line]) -> tuple[str, str, bool]:
    """Judge whether the service reported to its manager that it is ready, lives and stops.

    Returns
    -------
    tuple
        What was expected, what was found, and whether it is that.
    """
    expected = f"ready, signs of life at most {rule.watchdog_s:g} s apart, and stopping are reported to the manager"
    ready_s = [report.at_s for report in reports if report.text == "READY=1"]
    stopping_s = [report.at_s for report in reports if report.text == "STOPPING=1"]
    if not ready_s or not stopping_s:
        return expected, f"ready {len(ready_s)} times, stopping {len(stopping_s)} times", False
    alive_s = [report.at_s for report in reports if report.text == "WATCHDOG=1" and ready_s[0] <= report.at_s]
    ends_s = [ready_s[0], *(at_s for at_s in alive_s if at_s < stopping_s[-1]), stopping_s[-1]]
    longest_s = max(after_s - before_s for before_s, after_s in pairwise(ends_s))
    return expected, f"{len(alive_s)} signs of life, {longest_s:.1f} s apart at most", longest_s <= rule.watchdog_s
