"""Write what a mission leaves on disk: contacts, coverage, way-points and the clearance map."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from auv_mcm.clearance.clearance_export import clearance_geojson
from auv_mcm.clearance.clearance_map import Clearance
from auv_mcm.contacts.export import (
    contact_order,
    contacts_csv_parts,
    contacts_geojson_parts,
    contacts_kml_parts,
    coverage_geojson_parts,
    coverage_order,
    waypoints_geojson,
)
from auv_mcm.contacts.operating_point import OperatingPoint
from auv_mcm.records import Contact, CoveragePatch, Waypoint
from auv_mcm.settings.config import Config
from auv_mcm.settings.plan_settings import PlanConfig
from auv_mcm.shell.mission_totals import area_totals, contact_totals, point_totals, search_totals
from auv_mcm.shell.tally import Tally
from auv_mcm.shell.whole_files import write_file, write_parts

T = TypeVar("T")


def plan_waypoints(
    contacts: Iterable[Contact], tally: Tally, config: Config, counters: Counter[str]
) -> tuple[Waypoint, ...]:
    """Make the re-inspection plan from the last known pose, inside the vehicle's fence where there is one.

    Empty if there is no pose. That, and contacts that the fence keeps from being viewed, are counted.
    """
    from auv_mcm.plan.look_again import PlanRequest
    from auv_mcm.plan.propose import propose
    from auv_mcm.plan.reinspect import needs_second_look, plan_reinspection

    plan, vehicle = config.plan, config.vehicle
    pose = (tally.latitude_deg, tally.longitude_deg, tally.direction_rad)
    if not all(map(math.isfinite, pose)):
        counters["plan.start_pose_unknown"] += 1
        return ()
    if not vehicle.fence_deg:
        return plan_reinspection(contacts, *pose, plan)
    asking = (contact for contact in contacts if needs_second_look(contact, plan.min_p_mine))
    proposal = propose(asking, PlanRequest(*pose, frozenset()), plan, vehicle)
    counters.update({"plan.outside_fence": len(proposal.refused)} if proposal.refused else {})
    return proposal.waypoints


class MissionResults(NamedTuple):
    """Hold what a mission has come to at its end.

    contacts, coverage: gone through several times; one at a time where they come in the order in which they are
    written. clearance_png: the picture of it, empty without one.
    """

    contacts: Iterable[Contact]
    coverage: Iterable[CoveragePatch]
    waypoints: Sequence[Waypoint]
    tally: Tally
    operating_point: OperatingPoint | None
    clearance: Clearance | None
    clearance_png: bytes

    def writers(self, folder: Path, mission: str, *, durable: bool = True) -> dict[str, Callable[[], None]]:
        """Give what writes each file in `folder`, whole or not at all, by the file's name; each raises OSError.

        Parameters
        ----------
        mission
            Its name.
        durable
            False where they are synced later, all at once.
        """
        contacts, coverage = _in_order(self.contacts, contact_order), _in_order(self.coverage, coverage_order)
        parts: dict[str, Callable[[], Iterable[bytes]]] = {
            "contacts.geojson": lambda: contacts_geojson_parts(contacts),
            "contacts.csv": lambda: (row.encode() for row in contacts_csv_parts(contacts)),
            "contacts.kml": lambda: (part.encode() for part in contacts_kml_parts(contacts, mission)),
            "coverage.geojson": lambda: coverage_geojson_parts(coverage),
            "waypoints.geojson": lambda: [waypoints_geojson(self.waypoints)],
        }
        clearance = partial(write_clearance, folder, self.clearance, self.clearance_png, durable=durable)
        writers = {
            name: partial(lambda name, of: write_parts(folder / name, of(), durable=durable), name, of)
            for name, of in parts.items()
        }
        return {**writers, "clearance.geojson": clearance}

    def totals(self, plan: PlanConfig, verdict: str = "") -> dict[str, Any]:
        """Sum up the mission for summary.json. verdict: of planning on the area, while it went on."""
        return {
            **self.tally.totals(),
            **contact_totals(self.contacts, self.coverage),
            **point_totals(self.operating_point),
            **search_totals(self.clearance, self.contacts),
            **area_totals(self.clearance, plan, verdict),
            "waypoints": len(self.waypoints),
        }


def _in_order(records: Iterable[T], key: Callable[[T], Any]) -> Iterable[T]:
    """Give the records themselves where they come in order, so that not all of them are held at once."""
    return (
        records if all(key(before) <= key(after) for before, after in pairwise(records)) else sorted(records, key=key)
    )


def write_clearance(folder: Path, clearance: Clearance | None, picture: bytes, *, durable: bool = True) -> None:
    """Write `clearance.geojson`, and `clearance.png` where anything was searched.

    A picture of an earlier replay is removed.
    """
    write_file(folder / "clearance.geojson", clearance_geojson(clearance), durable=durable)
    if picture:
        write_file(folder / "clearance.png", picture, durable=durable)
    else:
        (folder / "clearance.png").unlink(missing_ok=True)
