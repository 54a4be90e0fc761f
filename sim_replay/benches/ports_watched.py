"""Run the service and note when each ping was queued for perception, which is kept busy; for the bench of ports.

python -m sim_replay.benches.ports_watched CONFIG QUEUED    writes QUEUED, in JSON, when its stop was requested
"""

from __future__ import annotations

import asyncio
import json
import logging
import signal
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any, Final

import numpy as np

from auv_mcm.clock import SystemClock
from auv_mcm.commands import read_config
from auv_mcm.contacts.ledger import Contacts
from auv_mcm.contacts.operating_point import OperatingPoint
from auv_mcm.records import Contact, Ping, PipelineEvent, SourceEvent
from auv_mcm.settings.config import Config
from auv_mcm.shell.service import Service
from auv_mcm.source import EventSink
from drivers.port_source import PortSource

_BUSY_S: Final = 0.08  # of a core, per ping: more than there is between two pings at the rates that are measured
_N_SORTED: Final = 1 << 15  # numbers sorted at a time, to take processor time


class WatchedPorts(PortSource):
    """Watch the live source.

    queued_s: by number of ping, the instant of the monotonic clock at which the service had queued it.
    """

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.queued_s: dict[int, float] = {}

    async def run(self, sink: EventSink) -> None:
        await super().run(_WatchedSink(sink, self.queued_s))


class _WatchedSink:
    """Keep the queue of the service, and the instant at which each ping was in it."""

    def __init__(self, sink: EventSink, queued_s: dict[int, float]) -> None:
        self._sink = sink
        self._queued_s = queued_s

    async def put(self, event: SourceEvent) -> None:
        await self._sink.put(event)
        self._note(event)

    def push(self, event: SourceEvent) -> None:
        self._sink.push(event)
        self._note(event)

    def _note(self, event: SourceEvent) -> None:
        if isinstance(event, Ping):
            self._queued_s[event.number] = time.monotonic()


class BusyPipeline:
    """Keep perception busy: it finds nothing and is never done."""

    def __init__(self, config: Config, kept: Contacts) -> None:
        self.constants: dict[str, object] = {}
        self.counters: Counter[str] = Counter()
        self.places: dict[str, Any] = {}
        self.operating_point: OperatingPoint | None = None
        self._values = np.random.Generator(np.random.PCG64(1)).random(_N_SORTED)

    def state(self) -> dict[str, Any]:
        return {}

    def restore(self, state: dict[str, Any]) -> None:
        """Take nothing: it remembers nothing."""

    def reserve(self, n_contacts: int) -> None:
        """Leave out no number: it finds nothing."""

    def asking(self, min_p_mine: float) -> tuple[Contact, ...]:
        return ()

    def leave_room(self, room: float) -> None:
        """Ignore the request for room: work as much as ever."""

    def feed(self, event: SourceEvent) -> list[PipelineEvent]:
        end_s = time.thread_time() + _BUSY_S
        while isinstance(event, Ping) and time.thread_time() < end_s:
            np.sort(self._values)
        return []

    def finish(self) -> list[PipelineEvent]:
        return []


async def _serve(config: Config, queued: Path) -> None:
    clock = SystemClock()
    source = WatchedPorts(config, clock)
    service = Service(config, source, clock=clock, make_pipeline=BusyPipeline)

    def stop() -> None:
        queued.write_text(json.dumps(source.queued_s), "ascii")
        service.stop()

    asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, stop)
    await service.run()


if __name__ == "__main__":
    logging.basicConfig(level=logging.INFO)
    asyncio.run(_serve(read_config(Path(sys.argv[1])), Path(sys.argv[2])))
