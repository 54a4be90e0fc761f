"""Place points of the waterfall on Earth and measure between them, by the geometry that places contacts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.geometry.georeference import NOMINAL_SOUND_SPEED_MPS, EchoGeometry, locate
from auv_mcm.geometry.pose_track import interpolate_track
from auv_mcm.geometry.shadow import shadow_height_m
from auv_mcm.records import SIDES, PoseTrack
from auv_mcm.settings.config import SonarConfig
from sim_replay.view.waterfall_store import WaterfallStore


class WaterfallPoint(NamedTuple):
    """Hold a point of the waterfall. row: from the upper edge of row 0; across_m: ground range, negative to port."""

    row: float
    across_m: float


class SeabedPlaces(msgspec.Struct, frozen=True, kw_only=True, eq=False):
    """Hold where n points of the waterfall lie; every array is (n,) float64 (`stale`: bool), NaN where not known.

    depth_m: of the sea floor there, below the surface. altitude_m: of the sonar, by the first bottom return. time_s:
    when the vehicle passed.
    """

    latitude_deg: NDArray[np.float64]
    longitude_deg: NDArray[np.float64]
    depth_m: NDArray[np.float64]
    altitude_m: NDArray[np.float64]
    slant_range_m: NDArray[np.float64]
    time_s: NDArray[np.float64]
    stale: NDArray[np.bool_]


class Measured(NamedTuple):
    """Hold what two points of the waterfall give, m. height_m: NaN unless they bound a shadow."""

    length_m: float
    height_m: float


def place_points(store: WaterfallStore, sonar: SonarConfig, points: Sequence[WaterfallPoint]) -> SeabedPlaces:
    """Place points on the sea floor."""
    row, across_m = np.array(points, dtype=np.float64).reshape(-1, 2).T
    position = row - 0.5  # poses stand at row centres
    below = np.floor(position).astype(np.int64)
    around = np.column_stack([below, below + 1]).ravel()
    track, return_m = store.poses(around)
    pose = interpolate_track(track, 2.0 * np.arange(len(row)) + (position - below))
    low_m, high_m = return_m.reshape(-1, 2).T
    blended_m = low_m + (position - below) * (high_m - low_m)
    first_return_m = np.where(np.isnan(blended_m), np.fmax(low_m, high_m), blended_m)
    slant_range_m = np.hypot(across_m, first_return_m)
    latitude_deg, longitude_deg, height_m = (np.full(len(row), np.nan) for _ in range(3))
    for side in SIDES:
        here = (across_m < 0.0) == (side == "port")
        echoes = EchoGeometry(
            side=side,
            pose=_some(pose, here),
            slant_range_m=slant_range_m[here],
            first_return_m=first_return_m[here],
            sound_speed_mps=np.full(int(here.sum()), NOMINAL_SOUND_SPEED_MPS),
        )
        latitude_deg[here], longitude_deg[here], height_m[here] = locate(echoes, sonar)
    mounted_rad = math.radians(sonar.pitch_offset_deg)
    return SeabedPlaces(
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        depth_m=np.where(np.isnan(pose.depth_m), np.nan, -height_m),
        altitude_m=first_return_m * np.cos(np.nan_to_num(pose.pitch_rad) + mounted_rad),
        slant_range_m=slant_range_m,
        time_s=pose.time_s,
        stale=pose.stale,
    )


def measure_length(store: WaterfallStore, sonar: SonarConfig, ends: Sequence[WaterfallPoint]) -> Measured:
    """Measure the distance over the sea floor between two points."""
    places = place_points(store, sonar, ends)
    frame = LocalFrame(latitude_deg=float(places.latitude_deg[0]), longitude_deg=float(places.longitude_deg[0]))
    east_north_m = frame.to_enu(places.latitude_deg, places.longitude_deg, 0.0)[:, :2]
    return Measured(float(np.hypot(*(east_north_m[1] - east_north_m[0]))), math.nan)


def measure_shadow(store: WaterfallStore, ends: Sequence[WaterfallPoint]) -> Measured:
    """Measure the length of a shadow and the height of what throws it.

    The nearer point is where the object ends and its shadow begins, the other one the shadow's end; their ranges count,
    and the altitude half way between their rows. NaN for points on both sides of the track.
    """
    near, far = sorted(ends, key=lambda point: abs(point.across_m))
    if near.across_m * far.across_m < 0.0:
        return Measured(math.nan, math.nan)
    top_m, end_m = abs(near.across_m), abs(far.across_m)
    rows = np.array([math.floor(0.5 * (near.row + far.row))], dtype=np.int64)
    _, first_return_m = store.poses(rows)
    return Measured(end_m - top_m, shadow_height_m(float(first_return_m[0]), top_m, end_m))


def _some(pose: PoseTrack, chosen: NDArray[np.bool_]) -> PoseTrack:
    return PoseTrack(**{name: getattr(pose, name)[chosen] for name in pose.__struct_fields__})
