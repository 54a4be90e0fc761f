"""Tiles made by hand for the detection tests: speckle, boxes of highlight and shadow, a straight run north."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from auv_mcm.records import VALID, PoseTrack, Side, Tile
from tests.make.records import straight_pose, tile_with

ROW_M = 0.12
COLUMN_M = 0.06
FIRST_RETURN_M = 6.0
SPEED_MPS = 1.8

Plane = NDArray[np.float32]


def straight_track(n_rows: int, row_m: float = ROW_M, *, first_row: int = 0) -> PoseTrack:
    """North at constant speed, one pose per row centre; row 0 of the mission at 43.7, 10.3 and time 1000 s."""
    even = {"speed_mps": SPEED_MPS, "start_s": 1000.0, "depth_m": 20.0, "altitude_m": FIRST_RETURN_M}
    return straight_pose(n_rows, row_m, (43.7, 10.3), first_row=first_row, **even)


def make_tile(
    intensity: Plane,
    mask: NDArray[np.uint8] | None = None,
    *,
    side: Side = "starboard",
    first_row: int = 0,
    core: tuple[int, int] | None = None,
    row_m: float = ROW_M,
    column_m: float = COLUMN_M,
    first_return_m: float = FIRST_RETURN_M,
    pose: PoseTrack | None = None,
) -> Tile:
    """A tile of given intensity (0 where the mask is not VALID, as tiles are); all valid and all core unless given."""
    n_rows = intensity.shape[0]
    bits = np.full(intensity.shape, VALID, dtype=np.uint8) if mask is None else mask
    core_start, core_stop = (0, n_rows) if core is None else core
    return tile_with(
        np.where((bits & VALID) != 0, intensity, 0.0),
        bits,
        side=side,
        first_row=first_row,
        core_start=core_start,
        core_stop=core_stop,
        row_spacing_m=row_m,
        column_spacing_m=column_m,
        pose=straight_track(n_rows, row_m, first_row=first_row) if pose is None else pose,
        first_return_m=first_return_m,
        ping_number=first_row + np.arange(n_rows, dtype=np.int64),
    )


def speckle(seed: int, shape: tuple[int, int], *, spread_pixels: float = 0.0, texture_nu: float = 0.0) -> Plane:
    """Single-look intensity of mean 1: |complex Gaussian field|^2.

    spread_pixels: 1-sigma along columns of the Gaussian point-spread function the field is smeared by. texture_nu:
    shape of a Gamma-distributed texture in cells of 8 by 8 pixels (K-distributed intensity), 0 for none.
    """
    random = np.random.default_rng(seed)
    reach = int(np.ceil(4.0 * spread_pixels))
    field = random.standard_normal((2, shape[0], shape[1] + 2 * reach))
    if spread_pixels:
        kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / spread_pixels) ** 2)
        kernel /= np.sqrt((kernel**2).sum())
        field = sum(weight * field[:, :, k : k + shape[1]] for k, weight in enumerate(kernel))
    intensity = 0.5 * (field**2).sum(axis=0)
    if texture_nu:
        cells = random.gamma(texture_nu, 1.0 / texture_nu, (-(-shape[0] // 8), -(-shape[1] // 8)))
        intensity *= np.kron(cells, np.ones((8, 8)))[: shape[0], : shape[1]]
    return np.asarray(intensity, dtype=np.float32)
