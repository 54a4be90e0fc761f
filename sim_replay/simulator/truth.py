"""Write the objects of a mission and the views of each: truth.json."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from sim_replay.scoring.seabed_map import encode
from sim_replay.simulator.objects import PlacedObject, rise_m
from sim_replay.simulator.plan import local_frame
from sim_replay.simulator.sea import Sea
from sim_replay.simulator.vehicle import SonarPose

CELL_M: Final = 1.0  # m: of the area swept
STEEPEST_GRAZING_DEG: Final = 70.0  # nearer to the track nothing counts as swept
_SAMPLES_PER_CELL: Final = 2.0  # along and across: no cell swept is left out

Floats = NDArray[np.float64]
Codes = NDArray[np.int64]


class TruthLog:
    """Keep the sonar's positions and the floor that its swath swept on legs."""

    def __init__(self, sea: Sea) -> None:
        self._sea = sea
        self._tracks: list[Floats] = []
        self._last_sample_m = -math.inf
        self._way_m = 0.0
        self._before: SonarPose | None = None
        self._cells: list[Codes] = []
        self._labels: list[NDArray[np.uint8]] = []

    def add(self, poses: Sequence[SonarPose], altitudes_m: Sequence[float]) -> None:
        """Add another stretch, as it was flown."""
        self._tracks.append(
            np.array(
                [
                    (p.time_s, p.east_m, p.north_m, p.heading_rad, p.on_leg, a)
                    for p, a in zip(poses, altitudes_m, strict=True)
                ]
            )
        )
        sampled = []
        for pose, altitude in zip(poses, altitudes_m, strict=True):
            if self._before is not None:
                self._way_m += math.hypot(pose.east_m - self._before.east_m, pose.north_m - self._before.north_m)
            self._before = pose
            if pose.on_leg >= 0 and self._way_m - self._last_sample_m >= CELL_M / _SAMPLES_PER_CELL:
                self._last_sample_m = self._way_m
                sampled.append(self._swath(pose, altitude))
        if not sampled:
            return
        east, north = np.concatenate(sampled, axis=1)
        codes = np.unique(_code(np.floor(north / CELL_M).astype(np.int64), np.floor(east / CELL_M).astype(np.int64)))
        if self._cells:
            codes = np.setdiff1d(codes, self._cells[-1], assume_unique=True)
        rows, columns = _place(codes)
        if len(self._sea.world.covers) > 1:
            labels = self._sea.world.seabed_at((columns + 0.5) * CELL_M, (rows + 0.5) * CELL_M)
        else:
            labels = np.zeros(len(codes), dtype=np.uint8)
        self._cells.append(codes)
        self._labels.append(labels)

    def _swath(self, pose: SonarPose, altitude_m: float) -> Floats:
        """Return places across both sides, (2, n) east and north."""
        nearest, farthest = seen_ranges_m(altitude_m, self._sea.scene.sonar.range_m)
        if farthest <= nearest:
            return np.empty((2, 0))
        across = np.arange(nearest, farthest, CELL_M / _SAMPLES_PER_CELL)
        across = np.concatenate([-across[::-1], across])
        return np.stack(
            [pose.east_m + across * math.cos(pose.heading_rad), pose.north_m - across * math.sin(pose.heading_rad)]
        )

    def swept(self) -> tuple[Codes, Codes, NDArray[np.uint8]]:
        """Return rows and columns of swept cells, and the kind of floor there.

        Both count north and east from the origin.
        """
        if not self._cells:
            return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64), np.empty(0, dtype=np.uint8)
        codes, first = np.unique(np.concatenate(self._cells), return_index=True)
        rows, columns = _place(codes)
        return rows, columns, np.concatenate(self._labels)[first]

    def track(self) -> Floats:
        """Return (n, 6): time, east, north, heading, leg, altitude of every ping."""
        return np.concatenate(self._tracks) if self._tracks else np.empty((0, 6))


def _code(row: Codes, column: Codes) -> Codes:
    return (row << 32) + column


def _place(codes: Codes) -> tuple[Codes, Codes]:
    column = (codes + (1 << 31) & 0xFFFFFFFF) - (1 << 31)
    return (codes - column) >> 32, column


def seen_ranges_m(altitude_m: float, range_m: float) -> tuple[float, float]:
    """Return the ground ranges that count as seen from an altitude."""
    nearest = altitude_m / math.tan(math.radians(STEEPEST_GRAZING_DEG))
    return nearest, math.sqrt(max(0.0, (range_m - altitude_m) * (range_m + altitude_m)))


def truth_of(sea: Sea, log: TruthLog) -> dict[str, Any]:
    """Return the area swept on legs, every object with the passes that saw it, and a map of the swept floor."""
    frame = local_frame(sea.scene.origin)
    rows, columns, labels = log.swept()
    track = log.track()
    types = tuple(dict.fromkeys(cover.type for cover in sea.world.covers))
    of_cover = np.array([types.index(cover.type) for cover in sea.world.covers], dtype=np.int64)
    first_row, first_column = (int(rows.min()), int(columns.min())) if len(rows) else (0, 0)
    cells = np.full(
        (int(rows.max()) - first_row + 1, int(columns.max()) - first_column + 1) if len(rows) else (1, 1),
        -1,
        dtype=np.int64,
    )
    cells[rows - first_row, columns - first_column] = of_cover[labels]
    # The map's own plane touches at its corner: nearly parallel to the scene's, 1 mm apart after kilometres.
    corner = frame.to_geodetic([first_column * CELL_M, first_row * CELL_M, 0.0])
    return {
        "version": 1,
        "scene": sea.scene.name,
        "seed": sea.scene.seed,
        "area_km2": len(rows) * CELL_M * CELL_M / 1e6,
        "objects": [
            _object(sea, scene_object, types[of_cover[_label(sea, scene_object)]], track)
            for scene_object in sea.objects
        ],
        "seabed_map": msgspec.to_builtins(
            encode(cells, types=types, cell_m=CELL_M, latitude_deg=float(corner[0]), longitude_deg=float(corner[1]))
        ),
    }


def _label(sea: Sea, scene_object: PlacedObject) -> int:
    return int(sea.world.seabed_at(scene_object.east_m, scene_object.north_m))


def _object(sea: Sea, scene_object: PlacedObject, seabed: str, track: Floats) -> dict[str, Any]:
    latitude, longitude, _ = local_frame(sea.scene.origin).to_geodetic([scene_object.east_m, scene_object.north_m, 0.0])
    return {
        "kind": scene_object.kind,
        "lat": float(latitude),
        "lon": float(longitude),
        "is_target": scene_object.is_target,
        "azimuth_deg": math.degrees(scene_object.azimuth_rad) % 360.0,
        "length_m": scene_object.length_m,
        "width_m": scene_object.width_m,
        "height_m": scene_object.height_m,
        "rise_m": rise_m(scene_object),
        "burial_m": scene_object.burial_m,
        "tilt_deg": math.degrees(scene_object.tilt_rad),
        "strength_db": scene_object.strength_db,
        "seabed": seabed,
        "looks": list(_looks(scene_object, track, sea.scene.sonar.range_m)),
    }


def _looks(scene_object: PlacedObject, track: Floats, range_m: float) -> Iterator[dict[str, Any]]:
    """Yield the moments when the object lay abeam on a leg, within the ranges that count as seen."""
    if len(track) < 2:
        return
    time, east, north, heading, leg, altitude = track.T
    ahead = (scene_object.east_m - east) * np.sin(heading) + (scene_object.north_m - north) * np.cos(heading)
    across = (scene_object.east_m - east) * np.cos(heading) - (scene_object.north_m - north) * np.sin(heading)
    passed = np.flatnonzero((ahead[:-1] >= 0.0) & (ahead[1:] < 0.0) & (leg[:-1] >= 0.0) & (leg[:-1] == leg[1:]))
    for k in passed:
        part = float(ahead[k] / (ahead[k] - ahead[k + 1]))
        ground_range = float(across[k] + part * (across[k + 1] - across[k]))
        nearest, farthest = seen_ranges_m(float(altitude[k]), range_m)
        if nearest <= abs(ground_range) <= farthest:
            moment = datetime.fromtimestamp(float(time[k] + part * (time[k + 1] - time[k])), UTC)
            yield {
                "side": "starboard" if ground_range > 0.0 else "port",
                "ground_range_m": abs(ground_range),
                "time": moment.isoformat(timespec="milliseconds").replace("+00:00", "Z"),
            }
