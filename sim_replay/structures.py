"""Group contacts that crowd together as one structure, such as a wreck, with its outline and size.

A structure is something to show: its members stay contacts, and what is called stays called. Contacts within LINK_M of
one another form a group, and a group is a structure where it is denser than the contacts around it can be by chance: by
the tail of a Poisson distribution, with as many trials as there are contacts.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from auv_mcm.contacts.antimeridian import split_ring
from auv_mcm.contacts.geojson import METRE_DIGITS, one_or_multi, positions_of
from auv_mcm.geometry.geodesy import LocalFrame

Array = NDArray[np.float64]
Feature = Mapping[str, Any]

STRUCTURES: Final = "structures"
"""Layer of what `find_structures` finds."""

LINK_M: Final = 5.0
"""Distance in m up to which two contacts are parts of one structure: the 4 m up to which views may be of one object
(`contacts.max_gate_m`), and half a metre for the reach of either."""
MIN_MEMBERS: Final = 5  # contacts; fewer are objects that lie near one another
_CELL_M: Final = 0.1  # m, far below LINK_M and the error of any contact
_MANY: Final = 500  # places, beyond which the table of all distances costs more than SciPy's import
_AROUND_M: Final = 25.0  # m: width of the ring whose contacts say how many there are by chance
_MOST_BY_CHANCE: Final = 1e-3
"""Structures expected in a mission, if groups were chosen blindly; of 900 draws of 200 to 800 scattered contacts 8 have
one."""
_SMALLEST_M: Final = 0.5  # m: radius of a member whose length is not known, as a mine has it
_LARGEST_M: Final = 5.0  # m: radius of a member at the most; longer lengths are shadows or ridges
_CORNERS: Final = 16  # of the disc that a member takes


class Member(NamedTuple):
    """Hold a contact that may be part of a structure. length_m: NaN if not known; called: see Contact."""

    contact_id: str
    latitude_deg: float
    longitude_deg: float
    length_m: float
    p_mine: float
    called: bool


class Structure(NamedTuple):
    """Hold one structure.

    outline_deg: (n, 2) longitude, latitude of its convex hull, closed, counter-clockwise. length_m, width_m: of the
    smallest rectangle around it. members: all of them, by id, those called too.
    """

    id: str
    outline_deg: Array
    latitude_deg: float
    longitude_deg: float
    length_m: float
    width_m: float
    area_m2: float
    members: tuple[Member, ...]

    @property
    def called(self) -> tuple[str, ...]:
        """List members that are called mines, by id."""
        return tuple(member.contact_id for member in self.members if member.called)

    @property
    def p_mine(self) -> float:
        """Return that of the likeliest member."""
        return max(member.p_mine for member in self.members)


def find_structures(contacts: Sequence[Member]) -> tuple[Structure, ...]:
    """Find all structures among contacts, the largest first; those without a position belong to none."""
    placed = [one for one in contacts if math.isfinite(one.latitude_deg) and math.isfinite(one.longitude_deg)]
    placed.sort(key=lambda one: one.contact_id)
    if len(placed) < MIN_MEMBERS:
        return ()
    frame = LocalFrame(latitude_deg=placed[0].latitude_deg, longitude_deg=placed[0].longitude_deg)
    places = frame.to_enu([one.latitude_deg for one in placed], [one.longitude_deg for one in placed], 0.0)[:, :2]
    # Contacts at one place make as many pairs as one.
    cells, cell_of, n_in_cell = np.unique(np.round(places / _CELL_M), axis=0, return_inverse=True, return_counts=True)
    if not _may_group(cells * _CELL_M, n_in_cell):
        return ()
    from scipy.spatial import cKDTree  # 0.3 s of a replay

    pairs = cKDTree(cells * _CELL_M).query_pairs(LINK_M, output_type="ndarray")
    found = []
    for group in _groups(pairs, len(cells), cell_of.ravel()):
        if len(group) < MIN_MEMBERS:
            continue
        ring = _outline([placed[index] for index in group], places[group])
        away_m, _ = cKDTree(places[group]).query(places, distance_upper_bound=LINK_M + _AROUND_M)
        n_near = int(np.count_nonzero(np.isfinite(away_m)))
        if not _by_chance(len(group), n_near - len(group), ring, len(placed)):
            found.append((ring, [placed[index] for index in group]))
    found.sort(key=lambda one: (-len(one[1]), one[1][0].contact_id))
    return tuple(_structure(f"S{number:03d}", *one, frame) for number, one in enumerate(found, 1))


def _may_group(places: Array, n_contacts: NDArray[np.int64]) -> bool:
    """Check whether any MIN_MEMBERS contacts may be linked; beyond _MANY places the answer is yes.

    places: (n, 2) m. n_contacts: (n,) at each.
    """
    if len(places) > _MANY:
        return True
    apart = places[:, np.newaxis] - places
    near = (np.hypot(*apart.transpose(2, 0, 1)) <= LINK_M).astype(np.float32)
    for _ in range(2):  # each doubles the links on the way: a group has MIN_MEMBERS within four
        near = np.minimum(near @ near, np.float32(1.0))
    return bool((near @ n_contacts.astype(np.float32)).max() >= MIN_MEMBERS)


def _groups(pairs: NDArray[np.int64], n_cells: int, cell_of: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """List contacts by group. pairs: (k, 2) cells that are linked. cell_of: (n,) of each contact."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    linked = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n_cells, n_cells))
    label = connected_components(linked, directed=False)[1][cell_of]
    order = np.argsort(label, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(label[order])) + 1)


def _outline(members: Sequence[Member], places: Array) -> Array:
    """Draw the convex hull around the discs that members take, (k, 2) east and north in m, counter-clockwise."""
    angle = np.arange(_CORNERS) * (2.0 * math.pi / _CORNERS)
    lengths = np.array([one.length_m for one in members])
    radius = np.clip(np.where(np.isfinite(lengths), 0.5 * lengths, _SMALLEST_M), _SMALLEST_M, _LARGEST_M)
    corners = places[:, np.newaxis] + radius[:, np.newaxis, np.newaxis] * np.column_stack(
        [np.cos(angle), np.sin(angle)]
    )
    middle = places.mean(axis=0)  # float32 below has 0.1 mm within a kilometre
    hull = cv2.convexHull((corners.reshape(-1, 2) - middle).astype(np.float32))[:, 0].astype(np.float64)
    if _area_m2(hull) < 0.0:
        hull = hull[::-1]
    return np.asarray(hull + middle)


def _by_chance(n_members: int, n_around: int, ring: Array, n_contacts: int) -> bool:
    """Decide whether so many contacts may lie in the outline where others lie as densely as around it."""
    from scipy.special import pdtrc

    closed = np.vstack([ring, ring[:1]])
    round_m = float(np.hypot(*np.diff(closed, axis=0).T).sum())
    reach_m = 0.5 * LINK_M  # a contact farther out would have been a member, or it belongs to the ring
    inside_m2 = _area_m2(ring) + round_m * reach_m + math.pi * reach_m**2
    around_m2 = round_m * _AROUND_M + math.pi * _AROUND_M**2
    expected = (n_around + 1.0) / around_m2 * inside_m2
    return bool(pdtrc(n_members - 1, expected) > _MOST_BY_CHANCE / n_contacts)


def _structure(name: str, ring: Array, members: Sequence[Member], frame: LocalFrame) -> Structure:
    middle = ring.mean(axis=0)
    _, sides_m, _ = cv2.minAreaRect((ring - middle).astype(np.float32))
    closed = np.vstack([ring, ring[:1], middle])
    latitude, longitude, _ = frame.to_geodetic(np.column_stack([closed, np.zeros(len(closed))]))
    return Structure(
        id=name,
        outline_deg=np.column_stack([longitude, latitude])[:-1],
        latitude_deg=float(latitude[-1]),
        longitude_deg=float(longitude[-1]),
        length_m=float(max(sides_m)),
        width_m=float(min(sides_m)),
        area_m2=_area_m2(ring),
        members=tuple(members),
    )


def _area_m2(ring: Array) -> float:
    """Compute the area within a ring by the shoelace formula, negative if it runs clockwise."""
    east, north = ring.T
    return 0.5 * float(east @ np.roll(north, -1) - np.roll(east, -1) @ north)


def with_structures(layers: Mapping[str, Sequence[Feature]]) -> dict[str, Sequence[Feature]]:
    """Add a layer of structures, if there are any, and to each contact the `structure` that it is part of, or None."""
    contacts = layers.get("contacts", ())
    found = find_structures([_member(one) for one in contacts])
    part_of = {member.contact_id: one.id for one in found for member in one.members}
    parts = [
        {**one, "properties": {**one["properties"], "structure": part_of.get(one["properties"]["id"])}}
        for one in contacts
    ]
    named = {**layers, **({"contacts": parts} if "contacts" in layers else {})}
    return named | ({STRUCTURES: [structure_feature(one) for one in found]} if found else {})


def _member(feature: Feature) -> Member:
    properties = feature["properties"]
    longitude, latitude = (feature["geometry"] or {"coordinates": (math.nan, math.nan)})["coordinates"][:2]
    length_m = properties.get("length_m")
    return Member(
        contact_id=properties["id"],
        latitude_deg=latitude,
        longitude_deg=longitude,
        length_m=math.nan if length_m is None else length_m,
        p_mine=properties.get("p_mine") or 0.0,
        called=bool(properties.get("called")),
    )


def structure_feature(structure: Structure) -> dict[str, Any]:
    """Make a feature of GeoJSON: its outline, sizes and members."""
    pieces: list[Any] = [[positions_of(piece)] for piece in split_ring(structure.outline_deg)]
    properties = {
        "id": structure.id,
        "length_m": round(structure.length_m, METRE_DIGITS),
        "width_m": round(structure.width_m, METRE_DIGITS),
        "area_m2": round(structure.area_m2, METRE_DIGITS),
        "n_contacts": len(structure.members),
        "n_called": len(structure.called),
        "p_mine": structure.p_mine,
        "contacts": [member.contact_id for member in structure.members],
        "called_contacts": list(structure.called),
    }
    return {"type": "Feature", "geometry": one_or_multi("Polygon", pieces), "properties": properties}
