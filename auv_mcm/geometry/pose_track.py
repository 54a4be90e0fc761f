"""Interpolate and cut tracks of poses."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from auv_mcm.geometry.geodesy import ecef_to_geodetic, geodetic_to_ecef
from auv_mcm.records import PoseTrack

# Quantities interpolated between two rows of a track besides the position, and whether it is stale.
_BLENDED: Final = (
    "time_s",
    "depth_m",
    "heading_rad",
    "pitch_rad",
    "roll_rad",
    "speed_mps",
    "altitude_m",
    "position_sigma_m",
    "heading_sigma_rad",
)


def interpolate_track(track: PoseTrack, position: NDArray[np.float64]) -> PoseTrack:
    """Interpolate poses at fractional row indices `position` (n,), linear between rows.

    Indices beyond the ends give the end rows. A NaN in one of the two rows leaves the other row's value. `stale` if any
    row that contributes is. Raises ValueError for a track without rows or an index that is not finite.
    """
    rows = np.asarray(position, dtype=np.float64)
    if len(track) == 0 or not np.isfinite(rows).all():
        raise ValueError("interpolate_track: needs a track with at least one row and finite row indices")
    rows = np.clip(rows, 0.0, len(track) - 1.0)
    below = np.floor(rows).astype(np.int64)
    above = np.minimum(below + 1, len(track) - 1)
    fraction = rows - below

    # Earth-centred, so that any place will do; all in one array, (n, quantities), since each operation costs more than
    # its numbers.
    known = np.column_stack(
        [geodetic_to_ecef(track.latitude_deg, track.longitude_deg, 0.0), *(getattr(track, name) for name in _BLENDED)]
    )
    low, high, weight = known[below], known[above], fraction[:, np.newaxis]
    values = np.where(np.isnan(low), high, np.where(np.isnan(high) | (weight == 0.0), low, low + weight * (high - low)))
    latitude, longitude, _ = ecef_to_geodetic(values[:, :3])
    return PoseTrack(
        latitude_deg=latitude,
        longitude_deg=longitude,
        stale=track.stale[below] | (track.stale[above] & (fraction > 0.0)),
        **dict(zip(_BLENDED, np.ascontiguousarray(values[:, 3:].T), strict=True)),
    )


def slice_pose(pose: PoseTrack, rows: slice) -> PoseTrack:
    """Take some rows of a track."""
    return PoseTrack(**{name: getattr(pose, name)[rows] for name in pose.__struct_fields__})
