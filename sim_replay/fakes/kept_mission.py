"""Run the service on a mission given event by event from a file, from a given event on; to be killed and started again.

python -m sim_replay.fakes.kept_mission CONFIG MISSION FIRST GIVEN CHECKPOINT_S

MISSION is a folder that an EventSpool wrote. Events behind FIRST are given as fast as perception takes them; the file
GIVEN holds, as 8 bytes, how many were. GIVEN.synced names the file of events that was synced last, and how many bytes
it had: what a power cut leaves for certain.
"""

from __future__ import annotations

import asyncio
import logging
import os
import struct
import sys
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Final

from auv_mcm.settings.config import parse_config
from auv_mcm.shell.event_spool import read_events
from auv_mcm.shell.service import Service
from auv_mcm.source import SourceHealth

if TYPE_CHECKING:
    from auv_mcm.source import EventSink, Record, VehiclePilot

COUNT: Final = struct.Struct("<Q")
"""What the file of the events given holds: how many were, and how many may be."""
SYNCED: Final = struct.Struct("<32sQ")
"""What the file of syncs holds: name and bytes."""
_EVENTS_PER_TURN: Final = 8  # of the event loop, which the service shares
_HELD_S: Final = 0.002  # s between two looks at how many may be given


class KeptMission:
    """Give the events of a mission, as ports would, but wait for perception, and for leave to give more."""

    lossless = True
    vehicle: VehiclePilot | None = None

    def __init__(self, mission: Path, first: int, given: Path) -> None:
        self._mission = mission
        self._first = first
        self._given = os.open(given, os.O_RDWR)
        self._stopped = False

    async def run(self, sink: EventSink) -> None:
        for n_given, spooled in enumerate(read_events(self._mission, self._first), 1):
            while not self._stopped and n_given > self._n_allowed():
                await asyncio.sleep(_HELD_S)
            if self._stopped:
                return
            await sink.put(spooled.event)
            os.pwrite(self._given, COUNT.pack(n_given), 0)
            if n_given % _EVENTS_PER_TURN == 0:
                await asyncio.sleep(0.0)

    def _n_allowed(self) -> int:
        return int(COUNT.unpack(os.pread(self._given, COUNT.size, COUNT.size))[0])

    def counters(self) -> Counter[str]:
        return Counter()

    def record_with(self, record: Record) -> None:
        """Record nothing: there are no bytes."""

    def stop(self) -> None:
        self._stopped = True

    def health(self) -> SourceHealth:
        return SourceHealth((), ())

    def faults(self) -> list[str]:
        return []

    async def serve_vehicle(self) -> None:
        """Return at once: there is no vehicle."""


def note_syncs(path: Path) -> None:
    """Write down the name and size of each file of events that this process syncs."""
    sync, noted = os.fsync, os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)

    def noting(descriptor: int) -> None:
        n_bytes = os.fstat(descriptor).st_size
        sync(descriptor)
        name = Path(os.readlink(f"/proc/self/fd/{descriptor}")).name
        if name.startswith("events-"):
            os.pwrite(noted, SYNCED.pack(name.encode(), n_bytes), 0)

    os.fsync = noting  # type: ignore[assignment]


def main(arguments: list[str]) -> None:
    """Serve the mission to its end."""
    logging.basicConfig(level=logging.INFO, stream=sys.stdout, format="%(message)s", force=True)
    config, mission, first, given, checkpoint_s = arguments
    note_syncs(Path(given + ".synced"))
    source = KeptMission(Path(mission), int(first), Path(given))
    service = Service(
        parse_config(Path(config).read_text(), config),
        source,
        console=lambda line: print(line, flush=True),
        checkpoint_every_s=float(checkpoint_s),
    )
    asyncio.run(service.run())


if __name__ == "__main__":
    main(sys.argv[1:])
