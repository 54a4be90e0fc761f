"""Run a program of a scenario as a process, and keep what it prints with times.

Nothing outlives a run: a program ends with its standard input, which dies with this process; the service is the head of
a process group of its own, which is killed when it has not ended by itself.
"""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import json
import os
import resource
import signal
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from auv_mcm.errors import HardwareError
from auv_mcm.safe_files import open_for_append

GRACE_S: Final = 5.0
"""s for a program to end after a signal, before it is killed."""
_TAIL_LINES: Final = 5  # of the program's log, shown with a failure
_PR_SET_PDEATHSIG: Final = 1  # Linux, prctl.h: the signal at the parent's death


class Process:
    """Run a Python process; keep its output line by line, with times, and write it to a log."""

    def __init__(self, what: str, process: asyncio.subprocess.Process, log: Path) -> None:
        self.lines: list[tuple[float, str]] = []
        self.holds: list[tuple[float, float]] = []  # of a fake device: when it had waited, and for how long
        self.what = what
        self._process = process
        self._log = log
        self._more = asyncio.Condition()
        self._reading = asyncio.ensure_future(self._read())

    @classmethod
    async def begin(
        cls, what: str, arguments: Sequence[str], log: Path, environment: Mapping[str, str] | None = None
    ) -> Process:
        """Start it. environment: besides this process's own."""
        libc = ctypes.CDLL(None)

        def prepare() -> None:
            """Make the child end with its parent, even with a killed one."""
            libc.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)

        process = await asyncio.create_subprocess_exec(
            sys.executable,
            "-u",
            *arguments,
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.STDOUT,
            env={**os.environ, **(environment or {})},
            start_new_session=True,  # Ctrl-C is for us: whoever is to stop first is our affair
            preexec_fn=prepare,
        )
        return cls(what, process, log)

    async def printed(self, text: str, within_s: float | None, also: str = "") -> str:
        """Return the first line that contains a text, and also another.

        Raises HardwareError if none comes in time; None: before it ends.
        """

        def found() -> str | None:
            return next((line for _, line in self.lines if text in line and also in line), None)

        try:
            async with asyncio.timeout(within_s), self._more:
                await self._more.wait_for(lambda: self._reading.done() or found() is not None)
        except TimeoutError:
            raise HardwareError(f"{self.what} did not come up within {within_s:g} s{self._tail()}") from None
        if (line := found()) is not None:
            return line
        raise HardwareError(f"{self.what} ended before it was ready{self._tail()}")

    def limit_files(self, n_bytes: int) -> None:
        """Limit files of the process, though not of processes it has started, to n_bytes."""
        resource.prlimit(self._process.pid, resource.RLIMIT_FSIZE, (n_bytes, n_bytes))

    @property
    def pid(self) -> int:
        """Return its number."""
        return self._process.pid

    @property
    def has_ended(self) -> bool:
        """Report whether it has ended, by itself or not."""
        return self._process.returncode is not None

    def send_line(self, line: str) -> None:
        """Write a line to its standard input."""
        assert self._process.stdin is not None
        self._process.stdin.write(line.encode())

    def signal(self, number: signal.Signals) -> None:
        """Send it a signal, unless it has ended."""
        with contextlib.suppress(ProcessLookupError):
            self._process.send_signal(number)

    async def kill(self) -> None:
        """End it with all that it has started, at once."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        await self._process.wait()
        await self._reading

    async def ended(self, within_s: float | None) -> int:
        """Wait for the exit code. Raises TimeoutError, with None never."""
        async with asyncio.timeout(within_s):
            return await self._process.wait()

    async def end(self) -> None:
        """End it, by force if it does not end by itself, with all that it has started."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self.signal(signal.SIGTERM)
        with contextlib.suppress(TimeoutError):
            await self.ended(GRACE_S)
        await self.kill()

    async def _read(self) -> None:
        assert self._process.stdout is not None
        with open_for_append(self._log) as log:
            async for data in self._process.stdout:
                log.write(data)
                at_s, line = time.monotonic(), data.decode("utf-8", "replace").rstrip("\n")
                if hold_s := _hold_s(line):
                    self.holds.append((at_s, hold_s))
                async with self._more:
                    self.lines.append((at_s, line))
                    self._more.notify_all()
        async with self._more:
            self._more.notify_all()

    def _tail(self) -> str:
        return "".join([f". {self._log} ends:", *(f"\n  {line}" for _, line in self.lines[-_TAIL_LINES:])])


def _hold_s(line: str) -> float:
    """Return how long mission time stood still until a report; 0 for reports of anything else."""
    return float(json.loads(line)["for_s"]) if '"what": "held"' in line else 0.0
