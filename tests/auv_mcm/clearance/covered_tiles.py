"""Tiles of even sea floor on a straight track."""

from __future__ import annotations

import math

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.records import LOW_RESOLUTION, VALID, PoseTrack, Side, Tile
from tests.make.records import straight_pose, tile_with

ROW_M, COLUMN_M = 0.12, 0.25
FIRST_RETURN_M = 5.0


def track(
    n_rows: int, *, heading_deg: float = 0.0, latitude_deg: float = 43.7, longitude_deg: float = 10.3
) -> PoseTrack:
    """Straight, one pose at each row's centre; the upper edge of row 0 at the given place. Standing still during each
    ping."""
    moving = straight_pose(
        n_rows,
        ROW_M,
        (latitude_deg, longitude_deg),
        heading_rad=math.radians(heading_deg),
        speed_mps=1.0,
        altitude_m=FIRST_RETURN_M,
    )
    return msgspec.structs.replace(
        moving, time_s=np.asarray(100.0 + np.arange(n_rows) * 0.07, dtype=np.float64), speed_mps=np.zeros(n_rows)
    )


def tile_of(
    mask: NDArray[np.uint8],
    pose: PoseTrack | None = None,
    side: Side = "starboard",
    core: tuple[int, int] | None = None,
) -> Tile:
    first, stop = core or (0, len(mask))
    return tile_with(
        np.ones(mask.shape),
        mask,
        side=side,
        index=3,
        core_start=first,
        core_stop=stop,
        row_spacing_m=ROW_M,
        column_spacing_m=COLUMN_M,
        pose=track(len(mask)) if pose is None else pose,
        first_return_m=FIRST_RETURN_M,
    )


def plain(n_rows: int = 200, n_columns: int = 80) -> NDArray[np.uint8]:
    """Six metres of water column and steep bottom, then clear sea floor."""
    mask = np.full((n_rows, n_columns), VALID, dtype=np.uint8)
    mask[:, :8] = VALID | LOW_RESOLUTION
    mask[:, 72:] = 0
    return mask
