"""What part of the sea floor a tile really covered, and how much was lost to what."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from auv_mcm.config import SonarConfig
from auv_mcm.georeference import EchoGeometry, locate
from auv_mcm.navigation import interpolate_track
from auv_mcm.records import LOW_RESOLUTION, TURN, VALID, CoveragePatch, Tile

_STRIP_M: Final = 5.0
_MIN_STRIP_COVER: Final = 0.2
_SOUND_SPEED_MPS: Final = 1500.0


def cover_tile(tile: Tile, sonar: SonarConfig) -> CoveragePatch:
    """Coverage of a tile's core. A pixel covers if it is valid, not of low resolution, not in a turn, and its row's navigation is fresh.

    The outline follows strips of five metres along track; strips that cover less than a fifth break it.
    """
    core = slice(tile.core_start, tile.core_stop)
    mask = tile.mask[core]
    stale = (tile.pose.stale[core] | ~np.isfinite(tile.pose.latitude_deg[core]))[:, None]
    valid = (mask & VALID) != 0
    coarse = valid & ((mask & LOW_RESOLUTION) != 0)
    turn = valid & ~coarse & ((mask & TURN) != 0)
    lost_position = valid & ~coarse & ~turn & stale
    covered = valid & ~coarse & ~turn & ~stale
    pixel_m2 = tile.row_spacing_m * tile.column_spacing_m
    lost = {"invalid": ~valid, "low_resolution": coarse, "turn": turn, "stale_navigation": lost_position}
    return CoveragePatch(
        side=tile.side,
        tile_index=tile.index,
        start_s=float(tile.pose.time_s[tile.core_start]),
        stop_s=float(tile.pose.time_s[tile.core_stop - 1]),
        rings_deg=_outlines(tile, covered, sonar),
        covered_m2=float(np.count_nonzero(covered)) * pixel_m2,
        lost_m2={reason: float(np.count_nonzero(pixels)) * pixel_m2 for reason, pixels in lost.items()},
    )


def _outlines(tile: Tile, covered: NDArray[np.bool_], sonar: SonarConfig) -> tuple[NDArray[np.float64], ...]:
    strip_rows = max(1, round(_STRIP_M / tile.row_spacing_m))
    rings: list[NDArray[np.float64]] = []
    run: list[tuple[int, int, int, int]] = []  # first row, stop row, near column, far column
    for start in range(0, covered.shape[0], strip_rows):
        strip = covered[start : start + strip_rows]
        any_row = strip.any(axis=1)
        share = float(strip.mean())
        if share < _MIN_STRIP_COVER or not any_row.any():
            rings += _ring(tile, run, sonar)
            run = []
            continue
        near = int(np.median(strip[any_row].argmax(axis=1)))
        far = int(np.median(strip.shape[1] - strip[any_row][:, ::-1].argmax(axis=1)))
        run.append((start, start + strip.shape[0], near, far))
    return tuple(rings + _ring(tile, run, sonar))


def _ring(tile: Tile, run: list[tuple[int, int, int, int]], sonar: SonarConfig) -> list[NDArray[np.float64]]:
    if not run:
        return []
    rows = [float(run[0][0])] + [0.5 * (first + stop) for first, stop, _, _ in run] + [float(run[-1][1] - 1)]
    near = [run[0][2]] + [strip[2] for strip in run] + [run[-1][2]]
    far = [run[0][3]] + [strip[3] for strip in run] + [run[-1][3]]
    position = tile.core_start + np.array(rows + rows[::-1])
    ground_m = np.array(near + far[::-1]) * tile.column_spacing_m
    first_return_m = np.interp(position, np.arange(len(tile.pose)), tile.first_return_m)
    echoes = EchoGeometry(
        side=tile.side,
        pose=interpolate_track(tile.pose, position),
        slant_range_m=np.hypot(ground_m, first_return_m),
        first_return_m=first_return_m,
        sound_speed_mps=np.full(position.shape, _SOUND_SPEED_MPS),
    )
    latitude, longitude, _ = locate(echoes, sonar)
    ring = np.column_stack([longitude, latitude])
    ring = ring[np.isfinite(ring).all(axis=1)]
    if ring.shape[0] < 3:
        return []
    # Seen from above, up the near edge and back down the far one is counter-clockwise to port, clockwise to starboard.
    ring = ring if tile.side == "port" else ring[::-1]
    return [np.concatenate([ring, ring[:1]])]
