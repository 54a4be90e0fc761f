"""Lay a mission's contacts and objects out in one plane, and judge each contact at a threshold of p_mine."""

from __future__ import annotations

from collections.abc import Iterator
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.geometry.geodesy import LocalFrame
from sim_replay.scoring.inputs import ReportedContact, ScoredMission, Truth, TruthObject
from sim_replay.scoring.matching import UNMATCHED, gates_m, match_by_threshold
from sim_replay.scoring.seabed_map import NOT_SWEPT, decode, types_at

UNKNOWN = "unknown"


class Outcome(IntEnum):
    """Name the outcome of one contact; `ON_CLUTTER` and `ELSEWHERE` are the false alarms."""

    NOT_CALLED = 0  # p_mine below the threshold
    DETECTION = 1
    DUPLICATE = 2  # a further contact on a target that has one
    ON_CLUTTER = 3  # on an object that is no target, whether or not another contact is on it too
    ON_UNSEEN = 4  # on a target that no pass saw: neither found nor a false alarm
    ELSEWHERE = 5


class MissionLayout(NamedTuple):
    """Hold the contacts and objects that take part.

    Arrays are (n_contacts, n_objects), or as long as what they describe.
    """

    contacts: tuple[ReportedContact, ...]
    objects: tuple[TruthObject, ...]
    offset_m: NDArray[np.float64]  # (n_contacts, n_objects, 2) east, north from object to contact
    near: NDArray[np.bool_]
    p_mine: NDArray[np.float64]
    is_target: NDArray[np.bool_]
    is_seen: NDArray[np.bool_]
    contact_seabed: tuple[str, ...]
    object_seabed: tuple[str, ...]
    seabed_area_km2: dict[str, float]  # by type
    n_outside: int
    n_without_position: int
    n_unseen_clutter: int


class State(NamedTuple):
    """Hold a mission at one threshold: per contact its object, -1 for none, and its `Outcome`."""

    threshold: float
    matched: NDArray[np.int64]
    outcome: NDArray[np.int64]


def lay_out(mission: ScoredMission, gate_m: float) -> MissionLayout:
    """Lay a mission out, with the contacts and objects that can be scored.

    Left out are contacts without a position, contacts off the swept area that lie on no target, and clutter that no
    pass saw.
    """
    truth = mission.truth
    objects = tuple(one for one in truth.objects if one.is_target or is_seen(one))
    placed = tuple(
        contact for contact in mission.contacts if np.isfinite([contact.latitude_deg, contact.longitude_deg]).all()
    )
    frame = _frame(truth, placed)
    offset_m = _east_north(frame, placed)[:, None] - _east_north(frame, objects)[None]
    gate = gates_m(gate_m, np.array([contact.sigma_m for contact in placed], dtype=np.float64))
    near = np.hypot(offset_m[..., 0], offset_m[..., 1]) <= gate[:, None]
    is_target = np.array([one.is_target for one in objects], dtype=bool)
    seen = np.array([is_seen(one) for one in objects], dtype=bool)
    contact_seabed, swept = _seabed_under(truth, placed)
    object_seabed, _ = _seabed_under(truth, objects)
    # A target at the edge of the swath may well be reported from just beyond it.
    kept = np.flatnonzero(swept | near[:, is_target & seen].any(axis=1))
    return MissionLayout(
        contacts=tuple(placed[index] for index in kept),
        objects=objects,
        offset_m=offset_m[kept],
        near=near[kept],
        p_mine=np.array([placed[index].p_mine for index in kept], dtype=np.float64),
        is_target=is_target,
        is_seen=seen,
        contact_seabed=tuple(contact_seabed[index] for index in kept),
        object_seabed=tuple(one.seabed or below for one, below in zip(objects, object_seabed, strict=True)),
        seabed_area_km2=_seabed_areas(truth),
        n_outside=len(placed) - len(kept),
        n_without_position=len(mission.contacts) - len(placed),
        n_unseen_clutter=len(truth.objects) - len(objects),
    )


def is_seen(truth_object: TruthObject) -> bool:
    """Check whether a pass saw an object; assumed where the truth does not state it."""
    return truth_object.looks is None or len(truth_object.looks) > 0


def states(layout: MissionLayout) -> Iterator[State]:
    """Judge the mission at each distinct p_mine of its contacts, falling."""
    distance_m = np.hypot(layout.offset_m[..., 0], layout.offset_m[..., 1])
    seen_targets, unseen_targets = layout.is_target & layout.is_seen, layout.is_target & ~layout.is_seen
    left_over = np.select(
        [layout.near[:, seen_targets].any(axis=1), layout.near[:, unseen_targets].any(axis=1), layout.near.any(axis=1)],
        [Outcome.DUPLICATE, Outcome.ON_UNSEEN, Outcome.ON_CLUTTER],
        Outcome.ELSEWHERE,
    )
    on_object = np.select([seen_targets, unseen_targets], [Outcome.DETECTION, Outcome.ON_UNSEEN], Outcome.ON_CLUTTER)
    for threshold, matched in match_by_threshold(layout.near, distance_m, layout.p_mine):
        outcome = np.where(layout.p_mine >= threshold, left_over, Outcome.NOT_CALLED)
        has_object = matched != UNMATCHED
        outcome[has_object] = on_object[matched[has_object]]
        yield State(threshold, matched, outcome)


def nothing_called(layout: MissionLayout) -> State:
    """Make the state of a mission at a threshold that no contact reaches."""
    n_contacts = len(layout.contacts)
    return State(
        np.inf, np.full(n_contacts, UNMATCHED, dtype=np.int64), np.full(n_contacts, Outcome.NOT_CALLED, dtype=np.int64)
    )


def _frame(truth: Truth, placed: tuple[ReportedContact, ...]) -> LocalFrame:
    positioned: tuple[ReportedContact | TruthObject, ...] = (*truth.objects, *placed)
    if not positioned:
        return LocalFrame(latitude_deg=0.0, longitude_deg=0.0)
    return LocalFrame(latitude_deg=positioned[0].latitude_deg, longitude_deg=positioned[0].longitude_deg)


def _east_north(frame: LocalFrame, positioned: tuple[ReportedContact | TruthObject, ...]) -> NDArray[np.float64]:
    return frame.to_enu(*_latitude_longitude(positioned), 0.0)[..., :2]


def _latitude_longitude(
    positioned: tuple[ReportedContact | TruthObject, ...],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    return (
        np.array([one.latitude_deg for one in positioned], dtype=np.float64),
        np.array([one.longitude_deg for one in positioned], dtype=np.float64),
    )


def _seabed_under(
    truth: Truth, positioned: tuple[ReportedContact | TruthObject, ...]
) -> tuple[list[str], NDArray[np.bool_]]:
    """Look up the seabed type under each position, and whether the sonar swept there.

    Everything is swept where there is no map.
    """
    if truth.seabed_map is None:
        return [UNKNOWN] * len(positioned), np.ones(len(positioned), dtype=bool)
    kinds = types_at(truth.seabed_map, decode(truth.seabed_map), *_latitude_longitude(positioned))
    return [
        UNKNOWN if kind == NOT_SWEPT else truth.seabed_map.types[kind] for kind in kinds.tolist()
    ], kinds != NOT_SWEPT


def _seabed_areas(truth: Truth) -> dict[str, float]:
    if truth.seabed_map is None:
        return {UNKNOWN: truth.area_km2}
    cells = decode(truth.seabed_map)
    counts = np.bincount(cells[cells != NOT_SWEPT], minlength=len(truth.seabed_map.types))
    cell_km2 = truth.seabed_map.cell_m**2 / 1e6
    return {kind: count * cell_km2 for kind, count in zip(truth.seabed_map.types, counts.tolist(), strict=True)}
