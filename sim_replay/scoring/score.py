"""Score the contacts of missions against the truth: Pd, false alarms, and where they come from."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.clean_text import clean
from auv_mcm.errors import BadInputError, UsageError
from auv_mcm.geometry.geodesy import LocalFrame
from sim_replay.scoring.breakdown import (
    Confusion,
    Group,
    KindRow,
    PositionErrors,
    SizeErrors,
    by_kind,
    by_range,
    by_seabed,
    confusion,
    false_alarms_of,
    objects_of,
    position_errors,
    rocks_called,
    size_errors,
)
from sim_replay.scoring.calibration import Calibration, calibration
from sim_replay.scoring.called import CalledPoint, asked_beside, called_point, last_state
from sim_replay.scoring.froc import (
    Bootstrap,
    Headline,
    OperatingPoint,
    bootstrap,
    headlines,
    operating_points,
    partial_area,
    point_at,
    trace,
)
from sim_replay.scoring.inputs import ScoredMission, read_contacts, read_truth
from sim_replay.scoring.intervals import Density, Proportion, density, proportion
from sim_replay.scoring.layout import MissionLayout, Outcome, lay_out

GATE_M: Final = 2.0  # m between contact and target, maximum
THRESHOLD: Final = 0.5  # of p_mine
SAME_PLACE_M: Final = 20_000.0
"""Distance in m from every object beyond which contacts are of another mission; chosen, longer than a leg is flown."""
_LADDER: Final = (0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1, 0.0)  # thresholds of p_mine that are printed


class LeftOut(msgspec.Struct, frozen=True, kw_only=True):
    """Count what no rate includes."""

    targets_never_seen: int
    other_objects_never_seen: int
    contacts_outside_swept_area: int
    contacts_without_position: int


class MissionRow(msgspec.Struct, frozen=True, kw_only=True):
    """Hold the rates of one mission."""

    name: str
    pd: Proportion
    false_alarms: Density


class Score(msgspec.Struct, frozen=True, kw_only=True):
    """Hold missions pooled. All but `froc`, `ladder`, `headlines` and `partial_area` is at `threshold`.

    `false_alarms` of an operating point are all contacts on no target, those on known clutter among them;
    `rocks_called_mines` is the share of seen objects that are no targets but have a contact. `called` is what the
    payload itself calls; `calibration` how far p_mine holds over all contacts but those on targets that no pass saw.
    `froc` has a point per distinct p_mine, falling, `ladder` one per tenth.
    """

    gate_m: float
    threshold: float
    area_km2: float
    n_contacts: int
    n_targets: int
    left_out: LeftOut
    at_threshold: OperatingPoint
    rocks_called_mines: Proportion
    headlines: tuple[Headline, ...]
    partial_area: float | None
    bootstrap: Bootstrap | None
    missions: tuple[MissionRow, ...]
    kinds: tuple[KindRow, ...]
    ranges: tuple[Group, ...]
    seabeds: tuple[Group, ...]
    missed_targets_of_unknown_range: int
    confusion: Confusion
    position_errors: PositionErrors
    size_errors: SizeErrors
    ladder: tuple[OperatingPoint, ...]
    froc: tuple[OperatingPoint, ...]
    called: CalledPoint | None = None
    calibration: Calibration | None = None


def score_files(paths: Sequence[Path], *, gate_m: float = GATE_M, threshold: float = THRESHOLD) -> Score:
    """Score pairs of files: contacts, truth, contacts, truth ...

    Raises UsageError for files that are not in pairs, contacts named twice, or an impossible gate or threshold;
    BadInputError naming file, feature and key for files that cannot be used.
    """
    if not paths or len(paths) % 2:
        raise UsageError(f"{len(paths)} files, but they come in pairs: CONTACTS TRUTH [CONTACTS TRUTH ...]")
    repeated = next((path for path, times in Counter(path.resolve() for path in paths[::2]).items() if times > 1), None)
    if repeated is not None:
        raise UsageError(f"{repeated} is given twice: its contacts would count double. Name each contacts file once")
    _check(gate_m, threshold)
    pairs = zip(paths[::2], paths[1::2], strict=True)
    missions = [
        ScoredMission(read_contacts(contacts), read_truth(truth), clean(str(contacts)), asked_beside(contacts))
        for contacts, truth in pairs
    ]
    for mission, truth in zip(missions, paths[1::2], strict=True):
        _refuse_another_place(mission, truth)
    return score_missions(missions, gate_m=gate_m, threshold=threshold)


def _refuse_another_place(mission: ScoredMission, truth: Path) -> None:
    """Refuse a truth that no contact is near. Raises BadInputError.

    Either may be empty, and contacts may have no position.
    """
    places = [
        np.array([(one.latitude_deg, one.longitude_deg) for one in found], dtype=np.float64).reshape(-1, 2)
        for found in (mission.contacts, mission.truth.objects)
    ]
    contacts, objects = (found[np.isfinite(found).all(axis=1)] for found in places)
    if not len(contacts) or not len(objects):
        return
    frame = LocalFrame(latitude_deg=float(objects[0, 0]), longitude_deg=float(objects[0, 1]))
    contacts_m, objects_m = (frame.to_enu(found[:, 0], found[:, 1], 0.0) for found in (contacts, objects))
    nearest_m = min(float(np.linalg.norm(contacts_m - place, axis=1).min()) for place in objects_m)
    if nearest_m > SAME_PLACE_M:
        raise BadInputError(
            f"{truth} is the truth of another place: none of the {len(contacts)} contacts in {mission.name} is within "
            f"{SAME_PLACE_M / 1000.0:g} km of an object in it, the nearest is {nearest_m / 1000.0:.0f} km away. Pair "
            "each contacts file with the truth of its own mission."
        )


def score_missions(missions: Sequence[ScoredMission], *, gate_m: float = GATE_M, threshold: float = THRESHOLD) -> Score:
    """Score missions pooled. Raises UsageError for no missions, or an impossible gate or threshold."""
    _check(gate_m, threshold)
    if not missions:
        raise UsageError("no missions to score. Give one pair of contacts and truth or more")
    layouts = [lay_out(mission, gate_m) for mission in missions]
    curve, chosen = trace(layouts, [mission.truth.area_km2 for mission in missions], threshold)
    area_km2 = float(curve.area_km2.sum())
    found = [item for layout, state in zip(layouts, chosen, strict=True) for item in objects_of(layout, state)]
    false_alarms = [
        alarm for layout, state in zip(layouts, chosen, strict=True) for alarm in false_alarms_of(layout, state)
    ]
    seabed_area_km2: defaultdict[str, float] = defaultdict(float)
    for layout in layouts:
        for kind, kind_km2 in layout.seabed_area_km2.items():
            seabed_area_km2[kind] += kind_km2
    return Score(
        gate_m=gate_m,
        threshold=threshold,
        area_km2=area_km2,
        n_contacts=sum(len(layout.contacts) for layout in layouts),
        n_targets=int(curve.targets.sum()),
        left_out=LeftOut(
            targets_never_seen=sum(item.truth_object.is_target and not item.is_seen for item in found),
            other_objects_never_seen=sum(layout.n_unseen_clutter for layout in layouts),
            contacts_outside_swept_area=sum(layout.n_outside for layout in layouts),
            contacts_without_position=sum(layout.n_without_position for layout in layouts),
        ),
        at_threshold=point_at(curve, threshold),
        rocks_called_mines=rocks_called(found),
        headlines=headlines(curve),
        partial_area=partial_area(curve),
        bootstrap=bootstrap(curve, threshold),
        missions=tuple(
            MissionRow(
                name=mission.name or f"mission {number}",
                pd=proportion(_count(state.outcome, Outcome.DETECTION), int(targets)),
                false_alarms=density(
                    _count(state.outcome, Outcome.ON_CLUTTER, Outcome.ELSEWHERE), mission.truth.area_km2
                ),
            )
            for number, (mission, state, targets) in enumerate(zip(missions, chosen, curve.targets, strict=True), 1)
        ),
        kinds=by_kind(found),
        ranges=by_range(found, false_alarms, area_km2),
        seabeds=by_seabed(found, false_alarms, seabed_area_km2),
        missed_targets_of_unknown_range=sum(
            item.truth_object.is_target and item.is_seen and item.contact is None and not item.truth_object.looks
            for item in found
        ),
        confusion=confusion(found, false_alarms),
        position_errors=position_errors(found),
        size_errors=size_errors(found),
        ladder=tuple(point_at(curve, step) for step in _LADDER),
        froc=operating_points(curve),
        called=called_point(missions, gate_m),
        calibration=_calibrated(layouts),
    )


def score_json(score: Score) -> bytes:
    """Write a score as JSON."""
    return msgspec.json.format(msgspec.json.encode(score), indent=2) + b"\n"


def _calibrated(layouts: Sequence[MissionLayout]) -> Calibration:
    p_mine: list[float] = []
    on_mine: list[bool] = []
    for layout in layouts:
        outcome = last_state(layout).outcome
        judged = outcome != Outcome.ON_UNSEEN
        p_mine += layout.p_mine[judged].tolist()
        on_mine += np.isin(outcome[judged], (Outcome.DETECTION, Outcome.DUPLICATE)).tolist()
    return calibration(p_mine, on_mine)


def _count(outcome: NDArray[np.int64], *wanted: Outcome) -> int:
    return int(np.count_nonzero(np.isin(outcome, wanted)))


def _check(gate_m: float, threshold: float) -> None:
    if not (math.isfinite(gate_m) and gate_m > 0.0):
        raise UsageError(f"--gate-m {gate_m:g}: the gate is a distance in metres above 0. Usual are 1 to 3")
    if not 0.0 <= threshold <= 1.0:
        raise UsageError(f"--threshold {threshold:g}: p_mine lies from 0 to 1. Give a threshold within")
