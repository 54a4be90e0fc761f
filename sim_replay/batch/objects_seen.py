"""Find the objects that several missions saw: what is new, what is gone, and what was seen again.

Contacts of different missions are joined by the ledger's own rules (`auv_mcm.contacts.pairing`), mission after mission
in order of time. Whether an object should have been seen goes by the coverage of each mission.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from typing import Final, Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from auv_mcm.contacts.pairing import IMPOSSIBLE, MIN_COVARIANCE_M2, pair_off, squared_deviation, unlikeness
from auv_mcm.geometry.geodesy import LocalFrame, geodetic_to_ecef
from auv_mcm.settings.config import ContactsConfig

Array: TypeAlias = NDArray[np.float64]
Change: TypeAlias = Literal["new", "gone", "seen again", "seen once"]

SEARCHED_FRACTION: Final = 0.5
"""Least part of a patch that must have been searched before not seeing an object there means anything; chosen."""


class SeenContact(NamedTuple):
    """Hold a contact of one mission, as its results give it. covariance_m2: (2, 2) float64, east and north."""

    id: str
    latitude_deg: float
    longitude_deg: float
    covariance_m2: Array
    p_mine: float
    classification: str
    called: bool


class CoveredPatch(NamedTuple):
    """Hold the outline of a patch. ring_deg: (n, 2) float64, longitude and latitude."""

    ring_deg: Array
    evaluated_fraction: float


class SeenMission(NamedTuple):
    """Hold what one mission saw."""

    name: str
    contacts: tuple[SeenContact, ...]


class Sighting(NamedTuple):
    """Say that a mission saw an object, with its contact there, or covered its place and did not: contact None."""

    mission: str
    contact: SeenContact | None


class SeenObject(NamedTuple):
    """Hold an object of the sea floor with its history, in order of time.

    latitude_deg, longitude_deg, covariance_m2: of all its contacts together, weighted by their inverse covariances.
    """

    latitude_deg: float
    longitude_deg: float
    covariance_m2: Array
    history: tuple[Sighting, ...]

    @property
    def likeliest(self) -> SeenContact:
        """Return the contact with the highest p_mine, the first on ties."""
        return max((one.contact for one in self.history if one.contact is not None), key=lambda contact: contact.p_mine)

    @property
    def change(self) -> Change:
        """Say what the last mission that covered the place adds to those before it."""
        if len(self.history) == 1:
            return "seen once"
        if self.history[-1].contact is None:
            return "gone"
        n_seen = sum(one.contact is not None for one in self.history)
        return "new" if n_seen == 1 else "seen again"


class _Known(NamedTuple):
    """Hold an object while missions are added."""

    latitude_deg: float
    longitude_deg: float
    covariance_m2: Array
    contacts: tuple[tuple[int, SeenContact], ...]  # with the mission's place in the order


def objects_seen(
    missions: Sequence[SeenMission], coverage: Iterable[Sequence[CoveredPatch]], config: ContactsConfig
) -> list[SeenObject]:
    """Join the contacts of missions, given in order of time, into objects, in order of first sighting.

    Parameters
    ----------
    coverage
        Of each mission, in the same order; taken one by one.
    config
        Has the gate within which two contacts may be one object.
    """
    known: list[_Known] = []
    ecef_m = np.empty((0, 3))
    for place, mission in enumerate(missions):
        placed = [contact for contact in mission.contacts if np.isfinite(_ecef([contact])).all()]
        for contact, at in zip(placed, _matches(placed, known, ecef_m, config), strict=True):
            if at is None:
                known.append(
                    _Known(contact.latitude_deg, contact.longitude_deg, contact.covariance_m2, ((place, contact),))
                )
            else:
                known[at] = _joined(known[at], place, contact)
        ecef_m = _ecef(known)
    histories = [dict[int, SeenContact | None](one.contacts) for one in known]
    for place, patches in enumerate(coverage):
        for number in _covered(patches, known):
            histories[number].setdefault(place, None)
    return [
        SeenObject(
            one.latitude_deg,
            one.longitude_deg,
            one.covariance_m2,
            tuple(Sighting(missions[place].name, history[place]) for place in sorted(history)),
        )
        for one, history in zip(known, histories, strict=True)
    ]


def _ecef(placed: Sequence[SeenContact | _Known]) -> Array:
    latitude, longitude = np.array([(one.latitude_deg, one.longitude_deg) for one in placed]).reshape(-1, 2).T
    return geodetic_to_ecef(latitude, longitude, 0.0)


def _matches(
    contacts: Sequence[SeenContact], known: Sequence[_Known], ecef_m: Array, config: ContactsConfig
) -> list[int | None]:
    """Assign each contact of a mission the known object that it is a sighting of, or None; one to one."""
    from scipy.spatial import cKDTree  # late, as its package is

    matches: list[int | None] = [None] * len(contacts)
    if not contacts or not known:
        return matches
    close = cKDTree(ecef_m).query_ball_point(_ecef(contacts), config.max_gate_m)
    pairs: dict[tuple[int, int], tuple[float, float]] = {}  # contact and object: squared deviation and unlikeness
    for row, contact in enumerate(contacts):
        frame = LocalFrame(latitude_deg=contact.latitude_deg, longitude_deg=contact.longitude_deg, height_m=0.0)
        for column in close[row]:
            one = known[column]
            offset_m = frame.to_enu(one.latitude_deg, one.longitude_deg, 0.0)[:2]
            distance2 = squared_deviation(offset_m, contact.covariance_m2, one.covariance_m2)
            if distance2 <= config.gate_chi2:
                kind = unlikeness(contact.p_mine, max(seen.p_mine for _, seen in one.contacts))
                pairs[row, column] = distance2, kind
    for linked in _linked(pairs, len(contacts), len(known)):
        rows, columns = (sorted(set(numbers)) for numbers in zip(*linked, strict=True))
        costs = np.full((2, len(rows), len(columns)), IMPOSSIBLE)
        for row, column in linked:
            costs[:, rows.index(row), columns.index(column)] = pairs[row, column]
        for row, chosen in zip(rows, pair_off(costs[0], costs[1], config.gate_chi2), strict=True):
            matches[row] = None if chosen is None else columns[chosen]
    return matches


def _linked(pairs: Iterable[tuple[int, int]], n_rows: int, n_columns: int) -> Iterable[list[tuple[int, int]]]:
    """Sort pairs of a row and a column into sets that share neither: memory goes by the pairs, not by n_rows times
    n_columns.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    found = list(pairs)
    rows, columns = np.array(found, dtype=np.int64).reshape(-1, 2).T
    n_nodes = n_rows + n_columns
    links = coo_array((np.ones(len(found)), (rows, n_rows + columns)), shape=(n_nodes, n_nodes))
    sets: defaultdict[int, list[tuple[int, int]]] = defaultdict(list)
    for pair, place in zip(found, connected_components(links, directed=False)[1][rows].tolist(), strict=True):
        sets[place].append(pair)
    return sets.values()


def _joined(known: _Known, place: int, contact: SeenContact) -> _Known:
    frame = LocalFrame(latitude_deg=known.latitude_deg, longitude_deg=known.longitude_deg, height_m=0.0)
    offset_m = frame.to_enu(contact.latitude_deg, contact.longitude_deg, 0.0)[:2]
    before = np.linalg.inv(known.covariance_m2 + MIN_COVARIANCE_M2)
    now = np.linalg.inv(contact.covariance_m2 + MIN_COVARIANCE_M2)
    covariance_m2 = np.linalg.inv(before + now)
    east_m, north_m = covariance_m2 @ now @ offset_m
    latitude_deg, longitude_deg, _ = frame.to_geodetic(np.array([east_m, north_m, 0.0]))
    return _Known(float(latitude_deg), float(longitude_deg), covariance_m2, (*known.contacts, (place, contact)))


def _covered(patches: Sequence[CoveredPatch], known: Sequence[_Known]) -> list[int]:
    """List the objects whose place lies in a patch that was searched."""
    if not known:
        return []
    covered = np.zeros(len(known), dtype=np.bool_)
    places_deg = np.array([(one.longitude_deg, one.latitude_deg) for one in known])
    for ring_deg in (patch.ring_deg for patch in patches if patch.evaluated_fraction >= SEARCHED_FRACTION):
        in_box = (places_deg >= ring_deg.min(axis=0)) & (places_deg <= ring_deg.max(axis=0))
        near = np.flatnonzero(in_box.all(axis=1) & ~covered)
        covered[near] = _inside(places_deg[near], ring_deg)
    return np.flatnonzero(covered).tolist()


def _inside(points: Array, ring: Array) -> NDArray[np.bool_]:
    """Find the points, (n, 2), inside a simple ring, (m, 2), by the crossings of a ray to the east, (n,)."""
    x, y = points[:, 0, None], points[:, 1, None]
    x1, y1 = ring.T
    x2, y2 = np.roll(ring, -1, axis=0).T
    crosses = (y1 > y) != (y2 > y)
    with np.errstate(divide="ignore", invalid="ignore"):
        at = x1 + (y - y1) * (x2 - x1) / (y2 - y1)
    return np.asarray((crosses & (x < at)).sum(axis=1) % 2 == 1)
