"""Watch the health of the payload: judge each measurement against the one before, and hand that to monitors."""

from __future__ import annotations

import asyncio
import logging
from functools import partial
from pathlib import Path
from typing import Final

from auv_mcm import __version__
from auv_mcm.clock import Clock
from auv_mcm.errors import HardwareError
from auv_mcm.records import Notice
from auv_mcm.settings.config import ServiceConfig
from auv_mcm.shell.health.endpoint import HealthEndpoint
from auv_mcm.shell.health.files import HealthFiles
from auv_mcm.shell.health.judge import Measured, judge
from auv_mcm.shell.health.record import Health
from auv_mcm.shell.health.text import health_line

log = logging.getLogger(__name__)

_OWN_FAULTS: Final = ("journal_failed", "perception_stalled", "disk_full")  # that nothing else reports to the vehicle
_LAG_PROBE_S: Final = 0.25  # s between two measurements of how late the event loop wakes


class HealthWatch:
    """Judge how the payload is; made inside a running event loop.

    late_s: how late the event loop woke up at most since the last measurement, s.
    """

    def __init__(self, folder: Path, config: ServiceConfig, clock: Clock) -> None:
        """folder: of the session."""
        self._folder, self._config, self._clock = folder, config, clock
        self._newest: Health | None = None
        self._measured: Measured | None = None
        self._files = HealthFiles(folder)
        self._endpoint = HealthEndpoint(config.health_port, lambda: self._newest)
        self._on_disk: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._on_disk.set_result(None)  # nothing is being written
        self.late_s = 0.0

    @property
    def is_fault(self) -> bool:
        """Check whether the newest health is a fault."""
        return self._newest is not None and self._newest.state == "fault"

    @property
    def faults(self) -> list[str]:
        """List in words the faults that the newest health alone shows."""
        found = () if self._newest is None else (part.reasons for part in self._newest.parts)
        return [reason.replace("_", " ") for reasons in found for reason in reasons if reason in _OWN_FAULTS]

    async def open(self) -> list[Notice]:
        """Open the port for monitors, if there is one. Returns a notice where it cannot be had."""
        if self._config.health_port:
            try:
                await self._endpoint.open()
            except HardwareError as error:  # the mission does not need it
                return [Notice(code="service.health_port", text=f"no health over HTTP: {error}")]
        return []

    async def watch_lag(self) -> None:
        """Measure how late the loop wakes up: what a byte at a port waits."""
        while True:
            requested_s = self._clock.monotonic_s()
            await asyncio.sleep(_LAG_PROBE_S)
            self.late_s = max(self.late_s, self._clock.monotonic_s() - requested_s - _LAG_PROBE_S)

    def show(self, measured: Measured) -> str:
        """Judge how the payload is, and hand that to monitors. Returns the health line."""
        before, self._measured, self.late_s = self._measured or measured, measured, 0.0
        self._newest = health = Health(
            version=__version__,
            session=str(self._folder),
            utc_s=self._clock.utc_s(),
            period_s=self._config.health_period_s,
            parts=judge(measured, before),
        )
        if self._on_disk.done():  # a disk that hangs holds up no health line
            write = partial(self._files.write, health, measured.now_s)
            self._on_disk = asyncio.get_running_loop().run_in_executor(None, write)
        if "perception:perception_stalled" in health.reasons:
            log.warning("perception has taken no ping for %g s although pings wait", measured.now_s - before.now_s)
        return health_line(health)

    async def written(self) -> None:
        """Wait until what was shown last is on disk."""
        await self._on_disk

    def close(self) -> None:
        """Close the port and the files."""
        self._endpoint.close()
        self._files.close()
