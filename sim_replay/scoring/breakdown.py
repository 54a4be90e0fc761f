"""Break a mission set's rates down at one threshold, and measure how good positions and sizes are.

Rates are broken down by kind, range and sea floor.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Final, NamedTuple, get_args

import msgspec
import numpy as np

from auv_mcm.records import NAN, ContactClass
from sim_replay.scoring.inputs import ReportedContact, TruthObject
from sim_replay.scoring.intervals import Density, Proportion, density, proportion
from sim_replay.scoring.layout import UNKNOWN, MissionLayout, Outcome, State
from sim_replay.scoring.matching import UNMATCHED

RANGE_BANDS_M: Final = (0.0, 10.0, 20.0, 30.0, 50.0, 75.0, 150.0)  # m of ground range, edges of the bands
NOT_CALLED: Final = "not called"
_BEYOND: Final = f"over {RANGE_BANDS_M[-1]:g} m"
_BANDS: Final = (*(f"{near:g}-{far:g} m" for near, far in pairwise(RANGE_BANDS_M)), _BEYOND, UNKNOWN)
_CLASSES: Final = get_args(ContactClass)


class KindRow(msgspec.Struct, frozen=True, kw_only=True):
    """Count the objects of one kind.

    `called`: those with a contact; detections for targets, mistakes for others.
    """

    kind: str
    is_target: bool
    called: Proportion


class Group(msgspec.Struct, frozen=True, kw_only=True):
    """Hold the rates of one group of objects and false alarms."""

    name: str
    pd: Proportion
    false_alarms: Density


class ConfusionRow(msgspec.Struct, frozen=True, kw_only=True):
    """Count the contacts on objects of a kind, by the class they were given, in order of the matrix' columns."""

    kind: str
    is_target: bool
    counts: tuple[int, ...]


class Confusion(msgspec.Struct, frozen=True, kw_only=True):
    """Compare the truth's kinds against the classes given.

    The last column is objects without a contact; `nothing_there` are the false alarms that lie on no known object.
    """

    columns: tuple[str, ...]
    rows: tuple[ConfusionRow, ...]
    nothing_there: tuple[int, ...]


class PositionSpread(msgspec.Struct, frozen=True, kw_only=True):
    """Hold the median of signed errors, and the size that 95 % of them stay below; None without any."""

    n: int
    median: float | None
    p95_absolute: float | None


class PositionErrors(msgspec.Struct, frozen=True, kw_only=True):
    """Hold errors of position, contact less truth of the detections.

    `in_sigmas` is the total error by the contact's own 1-sigma error.
    """

    east_m: PositionSpread
    north_m: PositionSpread
    total_m: PositionSpread
    in_sigmas: PositionSpread


class SizeErrors(msgspec.Struct, frozen=True, kw_only=True):
    """Hold errors of size, contact less truth of the detections; the true height is what stands above the sea floor."""

    length_m: PositionSpread
    width_m: PositionSpread
    height_m: PositionSpread


class FoundObject(NamedTuple):
    """Hold an object that took part, and the contact on it."""

    truth_object: TruthObject
    seabed: str
    is_seen: bool
    contact: ReportedContact | None
    offset_m: tuple[float, float]


class FalseAlarm(NamedTuple):
    """Hold a contact that is on no target."""

    contact: ReportedContact
    seabed: str
    on_clutter: bool


def objects_of(layout: MissionLayout, state: State) -> Iterator[FoundObject]:
    """Yield the objects of a mission, each with its contact."""
    holder = {
        truth_object: contact
        for contact, truth_object in enumerate(state.matched.tolist())
        if truth_object != UNMATCHED
    }
    for index, truth_object in enumerate(layout.objects):
        contact = holder.get(index)
        east_m, north_m = (NAN, NAN) if contact is None else layout.offset_m[contact, index].tolist()
        yield FoundObject(
            truth_object=truth_object,
            seabed=layout.object_seabed[index],
            is_seen=bool(layout.is_seen[index]),
            contact=None if contact is None else layout.contacts[contact],
            offset_m=(east_m, north_m),
        )


def false_alarms_of(layout: MissionLayout, state: State) -> Iterator[FalseAlarm]:
    """Yield the contacts of a mission that are false alarms."""
    for index, outcome in enumerate(state.outcome.tolist()):
        if outcome in (Outcome.ON_CLUTTER, Outcome.ELSEWHERE):
            yield FalseAlarm(layout.contacts[index], layout.contact_seabed[index], outcome == Outcome.ON_CLUTTER)


def by_kind(found: Sequence[FoundObject]) -> tuple[KindRow, ...]:
    """Count seen objects and those called, by kind, targets first."""
    total = Counter((not item.truth_object.is_target, item.truth_object.kind) for item in found if item.is_seen)
    called = Counter(
        (not item.truth_object.is_target, item.truth_object.kind) for item in found if item.is_seen and item.contact
    )
    return tuple(
        KindRow(kind=key[1], is_target=not key[0], called=proportion(called[key], total[key])) for key in sorted(total)
    )


def rocks_called(found: Sequence[FoundObject]) -> Proportion:
    """Compute the share of rocks seen that were called."""
    others = [item for item in found if item.is_seen and not item.truth_object.is_target]
    return proportion(sum(item.contact is not None for item in others), len(others))


def by_range(found: Sequence[FoundObject], false_alarms: Sequence[FalseAlarm], area_km2: float) -> tuple[Group, ...]:
    """Rate range bands: targets by their nearest look, or else their contact's range.

    False alarms by the contact's range.

    The area of a band is not known, so densities are over all of it and add up to the total. A target that was missed
    and has no looks is in the band `unknown`.
    """
    targets = [(_band(_range_m(item)), item) for item in found if item.is_seen and item.truth_object.is_target]
    alarms = Counter(_band(alarm.contact.ground_range_m) for alarm in false_alarms)
    groups = (_group(band, targets, alarms[band], area_km2) for band in _BANDS)
    return tuple(group for group in groups if group.pd.of or group.false_alarms.count)


def by_seabed(
    found: Sequence[FoundObject], false_alarms: Sequence[FalseAlarm], areas_km2: dict[str, float]
) -> tuple[Group, ...]:
    """Rate seabed types over each type's own swept area; `unknown` is what the missions without a map swept."""
    targets = [(item.seabed, item) for item in found if item.is_seen and item.truth_object.is_target]
    alarms = Counter(alarm.seabed for alarm in false_alarms)
    names = {seabed for seabed, _ in targets} | set(alarms) | set(areas_km2)
    groups = (
        _group(name, targets, alarms[name], areas_km2.get(name))
        for name in sorted(names, key=lambda name: (name == UNKNOWN, name))
    )
    return tuple(group for group in groups if group.pd.of or group.false_alarms.count or group.false_alarms.area_km2)


def confusion(found: Sequence[FoundObject], false_alarms: Sequence[FalseAlarm]) -> Confusion:
    """Count truth's kinds against the classes of the contacts on them, duplicates left out."""
    counts = Counter(
        (not item.truth_object.is_target, item.truth_object.kind, _class_of(item.contact))
        for item in found
        if item.is_seen
    )
    elsewhere = Counter(alarm.contact.classification for alarm in false_alarms if not alarm.on_clutter)
    used = {name for _, _, name in counts} | set(elsewhere)
    columns = (*(name for name in _CLASSES if name in used), *sorted(used - {*_CLASSES, NOT_CALLED}), NOT_CALLED)
    return Confusion(
        columns=columns,
        rows=tuple(
            ConfusionRow(kind=kind, is_target=not other, counts=tuple(counts[other, kind, name] for name in columns))
            for other, kind in sorted({(other, kind) for other, kind, _ in counts})
        ),
        nothing_there=tuple(elsewhere[name] for name in columns),
    )


def position_errors(found: Sequence[FoundObject]) -> PositionErrors:
    """Compute the errors of position over all detections."""
    hits = _detections(found)
    total_m = [math.hypot(*item.offset_m) for item, _ in hits]
    return PositionErrors(
        east_m=_spread([item.offset_m[0] for item, _ in hits]),
        north_m=_spread([item.offset_m[1] for item, _ in hits]),
        total_m=_spread(total_m),
        in_sigmas=_spread(
            [
                error / contact.sigma_m
                for error, (_, contact) in zip(total_m, hits, strict=True)
                if contact.sigma_m > 0.0
            ]
        ),
    )


def size_errors(found: Sequence[FoundObject]) -> SizeErrors:
    """Compute the errors of size over all detections."""
    hits = [(item.truth_object, contact) for item, contact in _detections(found)]
    return SizeErrors(
        length_m=_spread([contact.length_m - _known(truth_object.length_m) for truth_object, contact in hits]),
        width_m=_spread([contact.width_m - _known(truth_object.width_m) for truth_object, contact in hits]),
        height_m=_spread([contact.height_m - _rise_m(truth_object) for truth_object, contact in hits]),
    )


def _rise_m(truth_object: TruthObject) -> float:
    if truth_object.rise_m is None:
        return _known(truth_object.height_m) - truth_object.burial_m
    return truth_object.rise_m


def _detections(found: Sequence[FoundObject]) -> list[tuple[FoundObject, ReportedContact]]:
    return [
        (item, item.contact)
        for item in found
        if item.is_seen and item.truth_object.is_target and item.contact is not None
    ]


def _group(name: str, targets: Sequence[tuple[str, FoundObject]], n_alarms: int, area_km2: float | None) -> Group:
    members = [item for place, item in targets if place == name]
    return Group(
        name=name,
        pd=proportion(sum(item.contact is not None for item in members), len(members)),
        false_alarms=density(n_alarms, area_km2),
    )


def _range_m(item: FoundObject) -> float:
    if item.truth_object.looks:
        return min(look.ground_range_m for look in item.truth_object.looks)
    return NAN if item.contact is None else item.contact.ground_range_m


def _band(range_m: float) -> str:
    if math.isnan(range_m):
        return UNKNOWN
    return _BANDS[max(int(np.searchsorted(RANGE_BANDS_M, range_m, side="right")) - 1, 0)]


def _class_of(contact: ReportedContact | None) -> str:
    return NOT_CALLED if contact is None else contact.classification


def _known(size_m: float | None) -> float:
    return NAN if size_m is None else size_m


def _spread(errors: Sequence[float]) -> PositionSpread:
    known = np.array([error for error in errors if math.isfinite(error)], dtype=np.float64)
    if not known.size:
        return PositionSpread(n=0, median=None, p95_absolute=None)
    return PositionSpread(
        n=known.size, median=float(np.median(known)), p95_absolute=float(np.quantile(np.abs(known), 0.95))
    )
