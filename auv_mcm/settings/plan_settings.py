"""Define the `plan:` section of the configuration: what is requested of the vehicle, and the area to be cleared."""

from __future__ import annotations

import math
from itertools import combinations
from typing import Annotated, Final

import msgspec
from msgspec import Meta

from auv_mcm.settings.vehicle_settings import Latitude, Longitude

_FARTHEST_CORNER_M: Final = 50_000.0  # farther out the mission's plane bends straight lines
_MAX_CELLS: Final = 1_000_000  # of a planned area; bounds memory and time of a plan
_DEGREE_M: Final = 111_320.0  # m per degree of latitude, to 0.5 %; only for the count of cells


class PlanConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Set what is requested of the vehicle: second views of contacts and, with an area to clear, its survey."""

    cell_m: Annotated[
        float, Meta(ge=1.0, le=50.0, description="side of the cells in which coverage and sea floor are mapped, m")
    ] = 4.0
    max_contacts: Annotated[int, Meta(ge=0, le=1000, description="maximum number of contacts to view again")] = 12
    min_p_mine: Annotated[float, Meta(ge=0.0, le=1.0, description="minimum p_mine of a contact to view again")] = 0.2
    turn_radius_m: Annotated[float, Meta(gt=0.0, le=1000.0, description="smallest turn radius of the vehicle, m")] = (
        10.0
    )
    stand_off_m: Annotated[float, Meta(gt=0.0, le=200.0, description="ground range of the second view, m")] = 12.0
    leg_length_m: Annotated[float, Meta(gt=0.0, le=500.0, description="straight run past a contact, m")] = 30.0
    area_deg: Annotated[
        tuple[tuple[Latitude, Longitude], ...],
        Meta(
            description="corners [latitude, longitude] of the area to be cleared, in order; degrees; empty: second "
            "views alone"
        ),
    ] = ()
    required_clearance: Annotated[
        float, Meta(ge=0.5, le=0.99, description="probability, over the area, with which mines in it are to be found")
    ] = 0.9
    max_track_m: Annotated[float, Meta(gt=0.0, le=1e6, description="maximum total commanded track, m")] = 10_000.0

    def __post_init__(self) -> None:
        if not self.area_deg:
            return
        if len(self.area_deg) < 3:
            raise ValueError("plan: area_deg needs at least three corners [latitude, longitude]")
        if not all(math.isfinite(value) for corner in self.area_deg for value in corner):
            raise ValueError("plan: area_deg holds a corner that is not a finite number")
        corners_m = about_first(self.area_deg, self.area_deg[0])
        east_m, north_m = zip(*corners_m, strict=True)
        if max(map(math.hypot, east_m, north_m)) > _FARTHEST_CORNER_M:
            raise ValueError(
                f"plan: area_deg has corners more than {_FARTHEST_CORNER_M / 1e3:g} km apart; give the area of one "
                "mission"
            )
        twice_m2 = sum(east_m[n - 1] * north_m[n] - east_m[n] * north_m[n - 1] for n in range(len(east_m)))
        if abs(twice_m2) < 2.0 or _crosses_itself(corners_m):
            raise ValueError("plan: area_deg encloses no area: give its corners in order, without crossing edges")
        n_cells = (max(east_m) - min(east_m)) * (max(north_m) - min(north_m)) / self.cell_m**2
        if n_cells > _MAX_CELLS:
            raise ValueError(
                f"plan: area_deg spans {n_cells:.0f} cells of {self.cell_m:g} m, more than {_MAX_CELLS}: give a larger "
                "cell_m"
            )


def _crosses_itself(corners_m: list[tuple[float, float]]) -> bool:
    """Check whether edges of a polygon cross, not merely touch: what it encloses is then not what was meant."""

    def turn(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> float:
        return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])

    edges = list(zip(corners_m, [*corners_m[1:], corners_m[0]], strict=True))
    return any(
        turn(a, b, c) * turn(a, b, d) < 0.0 and turn(c, d, a) * turn(c, d, b) < 0.0
        for (a, b), (c, d) in combinations(edges, 2)
    )


def about_first(
    corners_deg: tuple[tuple[float, float], ...], first_deg: tuple[float, float]
) -> list[tuple[float, float]]:
    """Project to east and north, m, on a plane good enough to judge sizes; across the antimeridian as well."""
    shrunk = math.cos(math.radians(first_deg[0]))
    return [
        (math.remainder(lon - first_deg[1], 360.0) * _DEGREE_M * shrunk, (lat - first_deg[0]) * _DEGREE_M)
        for lat, lon in corners_deg
    ]
