"""Associate detections into contacts, and combine the views of each.

Which detections are views of the same object, and what they show together.

Two detections of one passage are two objects: suppression and `repeats` have already left one for each, and nothing
lies to port and to starboard at once. Sub-apertures of a passage, known by their squints, are views of their own. A
detection of another passage joins a contact within the gate of Mahalanobis distance, one-to-one over what arrives
together, or opens a new one. Of several contacts it joins the one that it fits best by place and by kind: the two ends
of a cylinder may have made a likely mine and a speck beside it, and what now looks like a mine is another view of the
former.
"""

from __future__ import annotations

import contextlib
import math
import statistics
from collections.abc import Sequence
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from auv_mcm.classify.dimensions import Dimensions, dimensions
from auv_mcm.classify.fusion import fuse
from auv_mcm.contacts.pairing import IMPOSSIBLE, MIN_COVARIANCE_M2, pair_off, squared_deviation, unlikeness
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.records import Contact, ContactClass, Detection, contact_id, contact_number
from auv_mcm.settings.config import ContactsConfig

SAME_PASSAGE_S: Final = 30.0
"""Time within which one pass may show an object twice, s, in tiles that overlap; chosen, not measured."""
_SAME_LOOK_M: Final = 300.0  # m of track, 10 m/s for that time: a clock that was set may give it to a later pass
_SAME_TRACK_M: Final = 10.0  # m of track on which no vehicle comes back on its course: however long it stops, one look
_SAME_LOOK_RAD: Final = math.radians(45.0)
# share of the likeliest view's p_mine from which a view counts in full; a quarter does as well, measured
_WHOLE_SHARE: Final = 0.5
_LEAST_P: Final = 1e-9  # keeps shares of nothing finite
_SEARCH_M: Final = 1e-3  # beyond the gate, so that rounding leaves nothing out


class Contacts(Protocol):
    """Hold contacts by the number in their id, in memory or in a `ContactStore`.

    Reading may raise OSError, writing must not.
    """

    def __getitem__(self, number: int, /) -> Contact: ...

    def add(self, contact: Contact) -> None:
        """Take a new contact."""

    def add_view(self, contact: Contact, view: Detection) -> None:
        """Take a version of a contact that has one view more than the one before."""


class ContactsInMemory(dict[int, Contact]):
    """Hold the contacts of a short mission in memory."""

    def add(self, contact: Contact) -> None:
        """Take a new contact."""
        self[contact_number(contact.id)] = contact

    def add_view(self, contact: Contact, view: Detection) -> None:
        """Take a version of a contact that has one view more than the one before."""
        self.add(contact)


class Ledger:
    """Hold the contacts of one mission, in order of first view.

    prior: log-odds of a mine that every detection's p_mine contains. kept: where contacts go, empty; in memory if None.
    """

    def __init__(self, config: ContactsConfig, prior: float = 0.0, kept: Contacts | None = None) -> None:
        self._config = config
        self._prior = prior
        self._kept: Contacts = ContactsInMemory() if kept is None else kept
        self._n_contacts = 0
        self._segment_row = -math.inf  # the first of the newest segment
        self._frame: LocalFrame | None = None
        self._positions_m = np.empty((0, 2))  # (at least as many as contacts, 2)
        self._asking_p = np.empty(0)  # p_mine of contacts for which a further view would help, NaN of the others
        # by place in the ledger: 1 for contacts that have reached the lowest p_mine reported
        self._reported = bytearray()

    @property
    def contacts(self) -> tuple[Contact, ...]:
        """Read all contacts that have been reported and can be read, by id."""
        return tuple(self._read([number for number, reported in enumerate(self._reported) if reported]).values())

    def numbered(self, numbers: Sequence[int]) -> list[Contact]:
        """Read contacts by the numbers in their ids, without those that the disk does not give back."""
        return list(self._read([number - 1 for number in numbers]).values())

    def asking(self, min_p_mine: float) -> tuple[Contact, ...]:
        """List likely mines for which a further view from a known direction would help."""
        return tuple(self._read(np.flatnonzero(self._asking_p[: self._n_contacts] >= min_p_mine).tolist()).values())

    def reserve(self, n_contacts: int) -> None:
        """Leave out numbers up to n_contacts that are not in use. No detection joins what they stand for."""
        n_before, self._n_contacts = self._n_contacts, max(self._n_contacts, n_contacts)
        self._positions_m = _with_room(self._positions_m, self._n_contacts)
        self._positions_m[n_before : self._n_contacts] = math.nan
        self._asking_p = _with_room(self._asking_p, self._n_contacts)
        self._asking_p[n_before : self._n_contacts] = math.nan
        self._reported.extend(bytes(self._n_contacts - len(self._reported)))

    def start_segment(self, row: float) -> None:
        """Take rows from this one on as of a vehicle that may have come back before: they do not go on from others."""
        self._segment_row = row

    def add(self, detections: list[Detection]) -> list[Contact]:
        """Take the detections that became final together, in any order; return the contacts to report, by id.

        A contact is reported from the first time that its p_mine reaches the lowest one configured, and whenever it
        changes after that.
        """
        if not detections:
            return []
        if self._frame is None:
            first = detections[0]
            self._frame = LocalFrame(latitude_deg=first.latitude_deg, longitude_deg=first.longitude_deg, height_m=0.0)
        moved: dict[int, Contact] = {}
        for passage in _passages(detections):
            moved |= self._take(passage)
        self._reported.extend(bytes(self._n_contacts - len(self._reported)))
        for number, contact in moved.items():
            self._reported[number] |= contact.p_mine >= self._config.min_p_mine
        return [moved[number] for number in sorted(moved) if self._reported[number]]

    def _take(self, detections: list[Detection]) -> dict[int, Contact]:
        """Join the detections of one passage to contacts; return those opened or changed, by their place in the
        ledger."""
        places_m = self._east_north(detections)
        near = self._near(places_m)
        changed: dict[int, Contact] = {}
        for detection, match in zip(detections, self._assign(detections, places_m, near), strict=True):
            if match is None:
                match = self._n_contacts
                self._n_contacts += 1
                changed[match] = contact_from_views(contact_id(self._n_contacts), (detection,), self._prior)
                self._kept.add(changed[match])
            else:
                known = near[match]
                views = tuple(sorted([*known.views, detection], key=lambda d: d.time_s))
                changed[match] = contact_from_views(known.id, views, self._prior)
                self._kept.add_view(changed[match], detection)
        moved = sorted(changed)
        self._positions_m = _with_room(self._positions_m, self._n_contacts)
        self._positions_m[moved] = self._east_north([changed[number] for number in moved])
        self._asking_p = _with_room(self._asking_p, self._n_contacts)
        self._asking_p[moved] = [
            changed[number].p_mine if changed[number].next_look_deg else math.nan for number in moved
        ]
        return changed

    def _east_north(self, placed: Sequence[Contact | Detection]) -> NDArray[np.float64]:
        assert self._frame is not None
        latitude = np.array([item.latitude_deg for item in placed])
        longitude = np.array([item.longitude_deg for item in placed])
        return np.asarray(self._frame.to_enu(latitude, longitude, 0.0)[..., :2])

    def _near(self, places_m: NDArray[np.float64]) -> dict[int, Contact]:
        """Find contacts within the gate of any of the places, (n, 2), by their place in the ledger, in its order."""
        positions_m, reach_m = self._positions_m[: self._n_contacts], self._config.max_gate_m + _SEARCH_M
        low_m, high_m = np.fmin.reduce(places_m) - reach_m, np.fmax.reduce(places_m) + reach_m
        candidates = np.arange(self._n_contacts)
        # One axis after the other: the second has few left to look at, of a mission's 100,000.
        for axis in range(2):
            axis_m = positions_m[candidates, axis] if axis else positions_m[:, axis]
            candidates = candidates[(axis_m >= low_m[axis]) & (axis_m <= high_m[axis])]
        within = np.zeros(len(candidates), dtype=np.bool_)
        for place_m in places_m:
            offset = positions_m[candidates] - place_m
            within |= np.hypot(offset[:, 0], offset[:, 1]) <= self._config.max_gate_m
        return self._read(candidates[within].tolist())

    def _read(self, numbers: Sequence[int]) -> dict[int, Contact]:
        """Read contacts by their place in the ledger.

        Those that the disk does not give back are left out: what is seen there is new.
        """
        contacts: dict[int, Contact] = {}
        for number in numbers:
            with contextlib.suppress(OSError):
                contacts[number] = self._kept[number + 1]  # ids begin with 1
        return contacts

    def _assign(
        self, detections: list[Detection], places_m: NDArray[np.float64], near: dict[int, Contact]
    ) -> list[int | None]:
        """Assign each detection the contact it belongs to, one of those near, or None for a new one."""
        numbers = list(near)
        cost = np.full((len(detections), len(near)), IMPOSSIBLE)
        unlike = np.full(cost.shape, IMPOSSIBLE)
        for row, (detection, place) in enumerate(zip(detections, places_m, strict=True)):
            offset = self._positions_m[numbers] - place
            for column in np.flatnonzero(np.hypot(offset[:, 0], offset[:, 1]) <= self._config.max_gate_m):
                contact = near[numbers[column]]
                if any(_same_look(detection, view, self._segment_row) for view in contact.views):
                    continue
                distance2 = squared_deviation(offset[column], detection.covariance_m2, contact.covariance_m2)
                if distance2 <= self._config.gate_chi2:
                    cost[row, column] = distance2
                    unlike[row, column] = unlikeness(detection.p_mine, contact.p_mine)
        chosen = pair_off(cost, unlike, self._config.gate_chi2)
        return [None if column is None else numbers[column] for column in chosen]


def _with_room(column: NDArray[np.float64], n: int) -> NDArray[np.float64]:
    """Give the column room for n values, and as many again where it has to grow."""
    if n <= len(column):
        return column
    return np.concatenate([column, np.empty((2 * n - len(column), *column.shape[1:]))])


def _passages(detections: list[Detection]) -> list[list[Detection]]:
    """Sort detections by time, split where the vehicle turned away or was silent.

    What follows may show the same objects again.
    """
    passages: list[list[Detection]] = []
    for detection in sorted(detections, key=lambda d: (d.squint_rad, d.time_s, d.side, d.column)):
        passage = passages[-1] if passages else []
        if (
            passage
            and detection.squint_rad == passage[-1].squint_rad
            and detection.time_s - passage[-1].time_s < SAME_PASSAGE_S
            and _turned_rad(detection, passage[0]) < _SAME_LOOK_RAD
        ):
            passage.append(detection)
        else:
            passages.append([detection])
    return passages


def _same_look(a: Detection, b: Detection, segment_row: float) -> bool:
    apart_m = abs(a.row - b.row) * a.row_spacing_m
    if a.squint_rad != b.squint_rad or apart_m >= _SAME_LOOK_M:
        return False
    is_one_track = apart_m < _SAME_TRACK_M and min(a.row, b.row) >= segment_row
    return same_passage(a, b) or (is_one_track and _turned_rad(a, b) < _SAME_LOOK_RAD)


def _beside(a: Detection, b: Detection) -> bool:
    """Check whether two views are of different sub-apertures of one passage."""
    return a.squint_rad != b.squint_rad and same_passage(a, b)


def same_passage(a: Detection, b: Detection) -> bool:
    """Check whether two views are of one passage: what it shows twice may be two objects, but no second look."""
    return abs(a.time_s - b.time_s) < SAME_PASSAGE_S and _turned_rad(a, b) < _SAME_LOOK_RAD


def _turned_rad(a: Detection, b: Detection) -> float:
    return abs(math.remainder(a.heading_rad - b.heading_rad, 2.0 * math.pi))


def contact_from_views(name: str, views: tuple[Detection, ...], prior: float) -> Contact:
    """Combine the views of one object, in order of time, into a contact with the id `name`.

    prior: log-odds that each view's p_mine contains.
    """
    latitude, longitude, covariance = fused_position(views)
    verdict = fuse(views, prior)
    size = _dimensions(views, verdict.classification)
    reasons = (
        reason
        for view in views
        for reason in (*view.reasons, *(view.confirmation.reasons if view.confirmation else ()))
    )
    return Contact(
        id=name,
        time_s=views[0].time_s,
        latitude_deg=latitude,
        longitude_deg=longitude,
        covariance_m2=covariance,
        p_mine=verdict.p_mine,
        classification=verdict.classification,
        mine_kind=verdict.mine_kind,
        belief=verdict.belief,
        length_m=size.length_m,
        width_m=size.width_m,
        height_m=size.height_m,
        aspects_deg=tuple(v.aspect_deg for v in views),
        reasons=tuple(dict.fromkeys((*reasons, *verdict.reasons))),
        views=views,
        length_sigma_m=size.length_sigma_m,
        width_sigma_m=size.width_sigma_m,
        height_sigma_m=size.height_sigma_m,
        conflict=verdict.conflict,
        next_look_deg=verdict.next_look_deg,
    )


def fused_position(views: tuple[Detection, ...]) -> tuple[float, float, NDArray[np.float64]]:
    """Average latitude and longitude of views by their inverse covariances, and by their p_mine.

    A view less than half as likely to show a mine as the likeliest may be of what lies beside it: it counts in
    proportion. Sub-apertures of one passage share its navigation: together they count as one view. Returns both in
    degrees, and their east/north covariance (2, 2), m².
    """
    if len(views) == 1:
        return views[0].latitude_deg, views[0].longitude_deg, views[0].covariance_m2
    frame = LocalFrame(latitude_deg=views[0].latitude_deg, longitude_deg=views[0].longitude_deg, height_m=0.0)
    positions = np.array([frame.to_enu(v.latitude_deg, v.longitude_deg, 0.0)[:2] for v in views])
    information = np.linalg.inv(np.array([v.covariance_m2 for v in views]) + MIN_COVARIANCE_M2)
    p_mine = np.maximum([v.p_mine for v in views], _LEAST_P)
    information *= np.minimum(p_mine / (_WHOLE_SHARE * p_mine.max()), 1.0)[:, np.newaxis, np.newaxis]
    if any(v.squint_rad != views[0].squint_rad for v in views):
        n_together = [sum(a is b or _beside(a, b) for b in views) for a in views]
        information /= np.array(n_together)[:, np.newaxis, np.newaxis]
    covariance = np.linalg.inv(information.sum(axis=0))
    east_north = covariance @ np.einsum("nij,nj->i", information, positions)
    latitude, longitude, _ = frame.to_geodetic(np.array([east_north[0], east_north[1], 0.0]))
    return float(latitude), float(longitude), covariance


def _dimensions(views: tuple[Detection, ...], classification: ContactClass) -> Dimensions:
    """Choose the sizes of the solid of the contact's class in the view that shows it best.

    Without such a solid, the sizes that its views measured.
    """
    models = [
        (view.p_mine, -view.time_s, view.confirmation.model)
        for view in views
        if view.confirmation and view.confirmation.model and view.confirmation.model.classification == classification
    ]
    if models:
        return dimensions(max(models, key=lambda model: model[:2])[2])
    best = max(views, key=lambda v: (v.score, -v.time_s))
    return Dimensions(max(v.length_m for v in views), best.width_m, _median_known([v.height_m for v in views]))


def _median_known(values: list[float]) -> float:
    known = [value for value in values if math.isfinite(value)]
    return statistics.median(known) if known else math.nan
