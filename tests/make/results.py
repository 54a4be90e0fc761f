"""Write the results of a mission of which a test states its contacts and coverage."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from auv_mcm.records import Contact, CoveragePatch, Waypoint
from auv_mcm.shell.results import MissionResults
from auv_mcm.shell.tally import Tally


def write_results(
    folder: Path,
    contacts: Iterable[Contact],
    coverage: Iterable[CoveragePatch],
    waypoints: Sequence[Waypoint],
    mission: str,
) -> None:
    results = MissionResults(contacts, coverage, waypoints, Tally(), None, None, b"")
    for write in results.writers(folder, mission).values():
        write()
