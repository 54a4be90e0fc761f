"""Judge every look at a target: a mission flown, and each pass that saw all of the floor around a target,
found or not."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import SEABED_TYPES, SIDES, CoveragePatch, Detection, Side
from sim_replay.fitting.seabed.seabed_missions import KIND_OF
from sim_replay.fitting.theatre import USUAL, Theatre
from sim_replay.scoring.matching import gates_m
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.plan import local_frame
from sim_replay.simulator.scene import Scene, SeabedType

GATE_M: Final = 2.0  # m between contact and target, maximum, as in scoring
_WHOLE: Final = 0.8  # of a target's cell must have been seen by the pass; cells are counted in coarse blocks
_SAME_PASS_S: Final = 60.0  # s between patches of one pass, as in clearance
_SAME_PASS_RAD: Final = math.radians(15.0)
_MARGIN_S: Final = 5.0  # a centroid may lie in the tile beside that of the target's cell


class CellPass(msgspec.Struct, frozen=True, kw_only=True, array_like=True):
    """Describe one pass that saw the whole cell in which a target lies.

    mission, target: which; the scene's seed stands for the mission. floor: the simulator's type. seabed: index into
    SEABED_TYPES of what that counts as. ripple_rad: direction in which crests follow one another, None without ripples.
    ground_range_m, altitude_m, look_rad: as the payload has them of the cell. time_s: since the mission's start.
    p_mine: the highest of a contact from this pass alone within the gate around the target, 0 if there is none.
    unevenness_db: of the cell, NaN where it was not measured.
    """

    mission: int
    target: int
    floor: SeabedType
    seabed: int
    ripple_rad: float | None
    ground_range_m: float
    altitude_m: float
    look_rad: float
    time_s: float
    p_mine: float
    unevenness_db: float


class Part(NamedTuple):
    """Describe what one tile saw of a target's cell."""

    side: Side
    start_s: float
    stop_s: float
    fraction: float
    ground_range_m: float
    altitude_m: float
    look_rad: float
    unevenness_db: float


def looks_of(scene: Scene, theatre: Theatre = USUAL) -> list[CellPass]:
    """Return every look at every target of a mission."""
    scene, config = theatre.carried(scene, scene.seed)
    mission = Mission(scene)
    pipeline = Pipeline(config)
    patches: list[CoveragePatch] = []
    for event in mission.events():
        patches += [output for output in pipeline.feed(event) if isinstance(output, CoveragePatch)]
    patches += [output for output in pipeline.finish() if isinstance(output, CoveragePatch)]
    detections = [view for contact in pipeline.contacts for view in contact.views]
    targets = [scene_object for scene_object in mission.sea.objects if scene_object.is_target]
    covers = mission.sea.world.seabed_at([t.east_m for t in targets], [t.north_m for t in targets])
    frame = local_frame(scene.origin)
    at_m = np.array([(t.east_m, t.north_m) for t in targets]).reshape(-1, 2)
    seen = seen_parts(at_m, patches, frame)
    best = _Best(at_m, detections, frame)
    looks = []
    for index, parts in enumerate(seen):
        cover = mission.sea.world.covers[int(covers[index])]
        ripple_rad = None if cover.ripples is None else math.radians(cover.ripples.direction_deg) % math.pi
        for side in SIDES:
            for group in cell_passes([part for part in parts if part.side == side]):
                if sum(part.fraction for part in group) < _WHOLE:
                    continue
                largest = max(group, key=lambda part: part.fraction)
                looks.append(
                    CellPass(
                        mission=scene.seed,
                        target=index,
                        floor=cover.type,
                        seabed=SEABED_TYPES.index(KIND_OF[cover.type]),
                        ripple_rad=ripple_rad,
                        ground_range_m=largest.ground_range_m,
                        altitude_m=largest.altitude_m,
                        look_rad=largest.look_rad,
                        time_s=largest.start_s - scene.track.start_time_s,
                        p_mine=best.p_mine(index, side, group[0].start_s - _MARGIN_S, group[-1].stop_s + _MARGIN_S),
                        unevenness_db=largest.unevenness_db,
                    )
                )
    return looks


def seen_parts(at_m: NDArray[np.float64], patches: Sequence[CoveragePatch], frame: LocalFrame) -> list[list[Part]]:
    """List each patch's view of the cell that a place lies in, in order of time.

    One list per place (n, 2) east and north in `frame`.
    """
    found: list[list[Part]] = [[] for _ in at_m]
    latitude, longitude, height = frame.to_geodetic(np.column_stack([at_m, np.zeros(len(at_m))]))
    for patch in sorted(patches, key=lambda patch: patch.start_s):
        cells = patch.cells
        if cells is None:
            continue
        plane = LocalFrame(latitude_deg=cells.origin_latitude_deg, longitude_deg=cells.origin_longitude_deg)
        index = np.floor(plane.to_enu(latitude, longitude, height)[:, :2] / cells.cell_m).astype(np.int64)
        where = {
            place: k for k, place in enumerate(zip(cells.east_index.tolist(), cells.north_index.tolist(), strict=True))
        }
        for target, place in enumerate(map(tuple, index.tolist())):
            k = where.get(place)
            if k is not None:
                columns = (
                    *(cells.fraction, cells.ground_range_m, cells.altitude_m, cells.look_rad),
                    cells.unevenness_db,
                )
                found[target].append(
                    Part(patch.side, patch.start_s, patch.stop_s, *(float(column[k]) for column in columns))
                )
    return found


def cell_passes(parts: Sequence[Part]) -> list[list[Part]]:
    """Group parts of one side, in order of time, by pass: parts within a minute and with the same look angle."""
    groups: list[list[Part]] = []
    for part in parts:
        last = groups[-1][-1] if groups else None
        if (
            last is not None
            and part.start_s - last.stop_s <= _SAME_PASS_S
            and abs(math.remainder(part.look_rad - last.look_rad, 2.0 * math.pi)) <= _SAME_PASS_RAD
        ):
            groups[-1].append(part)
        else:
            groups.append([part])
    return groups


class _Best:
    """Keep the most mine-like detection near each target."""

    def __init__(self, at_m: NDArray[np.float64], detections: Sequence[Detection], frame: LocalFrame) -> None:
        self._detections = detections
        self._near = np.zeros((len(at_m), len(detections)), dtype=np.bool_)
        if len(detections) and len(at_m):
            place = np.array([frame.to_enu(d.latitude_deg, d.longitude_deg, 0.0)[:2] for d in detections])
            sigma_m = np.sqrt([max(float(np.linalg.eigvalsh(d.covariance_m2)[-1]), 0.0) for d in detections])
            distance_m = np.hypot(*(at_m[:, np.newaxis] - place).transpose(2, 0, 1))
            self._near = distance_m <= gates_m(GATE_M, sigma_m)

    def p_mine(self, target: int, side: Side, start_s: float, stop_s: float) -> float:
        near = [self._detections[k] for k in np.flatnonzero(self._near[target]).tolist()]
        return max((d.p_mine for d in near if d.side == side and start_s <= d.time_s <= stop_s), default=0.0)
