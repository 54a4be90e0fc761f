"""Locate objects in a tile: from places on Earth back to pixels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.geometry.georeference import NOMINAL_SOUND_SPEED_MPS, EchoGeometry, locate
from auv_mcm.records import Tile
from auv_mcm.settings.config import SonarConfig
from sim_replay.fitting.cascade.tiles import TileObject

Floats = NDArray[np.float64]

_FAR_M: Final = 100.0  # gives the level direction of the beam
_ASTRIDE_M: Final = 2.0  # a step past the object that is longer than this is a jump of the track
_LIT: Final = 0.3  # of the way from the near side to the object's middle: where the middle of its highlight lies
_ROUND: Final = frozenset({"sphere", "truncated_cone", "tyre"})
_OVAL: Final = frozenset({"rock"})
_WIDESPREAD: Final = frozenset({"boulder_cluster", "debris", "anchor_scar", "fish_school", "point"})


class PlacedTarget(NamedTuple):
    """Describe an object on the sea floor.

    floor_depth_m: of the sea floor it stands on, NaN where nothing better is known than the flat floor of the tile.
    azimuth_rad: of its long axis, NaN if not known. Sizes as in truth.json, NaN if not known; burial_m of height_m is
    below the floor.
    """

    latitude_deg: float
    longitude_deg: float
    floor_depth_m: float
    kind: str
    is_target: bool
    seabed: str
    azimuth_rad: float
    length_m: float
    width_m: float
    height_m: float
    burial_m: float


def objects_in(tile: Tile, targets: Sequence[PlacedTarget], sonar: SonarConfig) -> tuple[TileObject, ...]:
    """List all passes over `targets` whose expected highlight lies in the tile, in the order of `targets`.

    The overlap of the tile counts.

    The inverse of `georeference.locate`: the row is where the beam's plane, lever arm, mounting and the way made during
    the ping included, crosses the object; the column follows from the slant range to half its height, a little behind
    the side that it turns to the sonar.
    """
    n_columns = tile.mask.shape[1]
    pose = tile.pose
    known = np.flatnonzero(np.isfinite(pose.latitude_deg) & np.isfinite(pose.longitude_deg))
    if not known.size or not targets:
        return ()
    frame = LocalFrame(
        latitude_deg=float(pose.latitude_deg[known[0]]), longitude_deg=float(pose.longitude_deg[known[0]])
    )
    beam = _Beam(tile, sonar, frame)
    latitude, longitude = (
        np.array([target.latitude_deg for target in targets]),
        np.array([target.longitude_deg for target in targets]),
    )
    places = frame.to_enu(latitude, longitude, np.zeros(len(targets)))[:, :2]
    swath_m = n_columns * tile.column_spacing_m
    found = []
    for target, place in zip(targets, places, strict=True):
        ahead_m, ground_m = beam.ahead_and_ground_m(place)
        step_m = ahead_m[:-1] - ahead_m[1:]
        for row in np.flatnonzero(
            (ahead_m[:-1] >= 0.0) & (ahead_m[1:] < 0.0) & (step_m < _ASTRIDE_M) & (ground_m[:-1] > 0.0)
        ).tolist():
            position = row + float(ahead_m[row] / step_m[row])
            ground_range_m = _at(ground_m, position)
            if ground_range_m > swath_m + target.length_m:
                continue
            look_rad = beam.look_rad(row)
            column = _column(tile, sonar, target, position, ground_range_m, look_rad)
            if 0.0 <= column < n_columns:
                found.append(
                    TileObject(
                        row=position + 0.5,  # poses stand at the centres of rows
                        column=column,
                        kind=target.kind,
                        is_target=target.is_target,
                        seabed=target.seabed,
                        ground_range_m=ground_range_m,
                        aspect_deg=math.degrees(look_rad - target.azimuth_rad) % 360.0,
                        length_m=target.length_m,
                        width_m=target.width_m,
                        height_m=target.height_m,
                    )
                )
    return tuple(found)


class _Beam:
    """Give the direction of every row's beam, in the plane of `frame`."""

    def __init__(self, tile: Tile, sonar: SonarConfig, frame: LocalFrame) -> None:
        self._tile, self._sonar, self._frame = tile, sonar, frame
        n_rows = len(tile.pose)
        self._below = self._at_ground_range(np.zeros(n_rows))
        level = self._at_ground_range(np.full(n_rows, _FAR_M)) - self._below
        self._level = level / np.linalg.norm(level, axis=1, keepdims=True)
        ahead = np.stack((-self._level[:, 1], self._level[:, 0]), axis=1)
        self._ahead = ahead if tile.side == "starboard" else -ahead

    def ahead_and_ground_m(self, place: Floats) -> tuple[Floats, Floats]:
        """Return how far a place (2,) lies ahead of the beam of each row, and its distance across the track, (n_rows,)
        each."""
        ground_m = ((place - self._below) * self._level).sum(axis=1)
        met = self._at_ground_range(np.maximum(ground_m, 0.0))
        return ((place - met) * self._ahead).sum(axis=1), ground_m

    def look_rad(self, row: int) -> float:
        """Return the look angle of a row, clockwise from north."""
        return math.atan2(float(self._level[row, 0]), float(self._level[row, 1]))

    def _at_ground_range(self, ground_m: Floats) -> Floats:
        tile = self._tile
        echoes = EchoGeometry(
            side=tile.side,
            pose=tile.pose,
            slant_range_m=np.hypot(ground_m, tile.first_return_m),
            first_return_m=tile.first_return_m,
            sound_speed_mps=np.full(len(tile.pose), NOMINAL_SOUND_SPEED_MPS),
        )
        latitude, longitude, _ = locate(echoes, self._sonar)
        return np.asarray(self._frame.to_enu(latitude, longitude, np.zeros(latitude.shape))[:, :2])


def _column(
    tile: Tile, sonar: SonarConfig, target: PlacedTarget, position: float, ground_range_m: float, look_rad: float
) -> float:
    """Return the column of the highlight's middle; NaN if that is nearer than the first bottom return."""
    pitch_rad = _at(tile.pose.pitch_rad, position) + math.radians(sonar.pitch_offset_deg)
    first_return_m = _at(tile.first_return_m, position)
    down_m = first_return_m
    if math.isfinite(target.floor_depth_m):
        down_m = (target.floor_depth_m - _at(tile.pose.depth_m, position) - sonar.lever_arm_m[2]) / math.cos(pitch_rad)
    showing_m = max(target.height_m - target.burial_m, 0.0)
    if math.isfinite(showing_m) and target.kind not in _WIDESPREAD:
        down_m -= 0.5 * showing_m
    square = (ground_range_m - (1.0 - _LIT) * near_side_m(target, look_rad)) ** 2 + (down_m - first_return_m) * (
        down_m + first_return_m
    )
    return math.sqrt(square) / tile.column_spacing_m if square >= 0.0 else math.nan


def near_side_m(target: PlacedTarget, look_rad: float) -> float:
    """Return how far the side turned to the sonar stands before the object's middle.

    0 for groups and where sizes are not known.
    """
    half_length, half_width = 0.5 * target.length_m, 0.5 * target.width_m
    if target.kind in _WIDESPREAD or not (half_length > 0.0 and half_width > 0.0):
        return 0.0
    if target.kind in _ROUND or math.isnan(target.azimuth_rad):
        return half_width
    cosine, sine = abs(math.cos(look_rad - target.azimuth_rad)), abs(math.sin(look_rad - target.azimuth_rad))
    if target.kind in _OVAL:
        return 1.0 / math.hypot(cosine / half_length, sine / half_width)
    return min(half_length / max(cosine, 1e-9), half_width / max(sine, 1e-9))


def _at(values: Floats, position: float) -> float:
    return float(np.interp(position, np.arange(len(values)), values))


def cropped(objects: Sequence[TileObject], start: int, stop: int) -> tuple[TileObject, ...]:
    """Return the objects of rows [start, stop), counted from there."""
    return tuple(
        msgspec.structs.replace(target, row=target.row - start) for target in objects if start <= target.row < stop
    )
