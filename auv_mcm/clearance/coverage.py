"""Measure what part of the sea floor a tile covered, and how much was lost to which cause."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.clearance.cells import surveyed_cells
from auv_mcm.clearance.shadowed import in_large_shadow
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.geometry.georeference import locate, tile_echoes
from auv_mcm.records import LOW_RESOLUTION, SATURATED, TURN, VALID, CoveragePatch, SeabedCells, Tile
from auv_mcm.settings.config import SonarConfig

# m along the track that one outline covers: shorter follows turns more closely and makes larger files
_STRIP_M: Final = 5.0
# share of a strip's rows that have to be covered for a column to count; chosen, not measured
_MIN_ROW_COVER: Final = 0.2
_MAX_GAP_M: Final = 0.5  # a lost ping or two do not break an outline


class CoverageGrid(NamedTuple):
    """Define the mission's cells."""

    frame: LocalFrame
    cell_m: float


def cover_tile(
    tile: Tile,
    sonar: SonarConfig,
    evaluated_fraction: float = 1.0,
    grid: CoverageGrid | None = None,
    seabed: SeabedCells | None = None,
    blind_rows: NDArray[np.bool_] | None = None,
) -> CoveragePatch:
    """Compute the coverage of a tile's core.

    A pixel covers if it is valid, neither of low resolution nor of a ping that cannot show a mine, not in a turn, its
    row's navigation is fresh, it is not saturated, since among clipped echoes no highlight stands out, and it does not
    lie in the large shadow of something high. Of the area so covered only the evaluated fraction counts, since the
    detector's budget did not allow for the rest.

    The outlines follow the near and far end of the covered range in strips of five metres along track; they end where
    rows that cover less than a fifth of the range lie for more than half a metre.

    Parameters
    ----------
    grid
        The cells to lay the same area out in.
    seabed
        What kind of sea floor it is.
    blind_rows
        Rows of pings that cannot show a mine: samples too far apart, or no sea floor heard, (n_rows,); None for none.
    """
    covered, lost = _sorted_out(tile, blind_rows)
    pixel_m2 = tile.row_spacing_m * tile.column_spacing_m
    seen_m2 = float(np.count_nonzero(covered)) * pixel_m2
    return CoveragePatch(
        side=tile.side,
        tile_index=tile.index,
        start_s=float(tile.pose.time_s[tile.core_start]),
        stop_s=float(tile.pose.time_s[tile.core_stop - 1]),
        rings_deg=_outlines(tile, covered, sonar),
        covered_m2=seen_m2 * evaluated_fraction,
        lost_m2={
            **{reason: float(np.count_nonzero(pixels)) * pixel_m2 for reason, pixels in lost.items()},
            "over_budget": seen_m2 * (1.0 - evaluated_fraction),
        },
        evaluated_fraction=evaluated_fraction,
        cells=None
        if grid is None
        else surveyed_cells(tile, covered, sonar, grid.frame, grid.cell_m, seabed, evaluated_fraction),
        squint_rad=tile.squint_rad,
    )


def _sorted_out(
    tile: Tile, blind_rows: NDArray[np.bool_] | None
) -> tuple[NDArray[np.bool_], dict[str, NDArray[np.bool_]]]:
    """Find the pixels of a core that cover, and those that do not by the first reason that they are lost for."""
    core = slice(tile.core_start, tile.core_stop)
    mask = tile.mask[core]
    coarse = (mask & LOW_RESOLUTION) != 0
    if blind_rows is not None:
        coarse |= blind_rows[core, None]
    reasons = {
        "invalid": (mask & VALID) == 0,
        "low_resolution": coarse,
        "turn": (mask & TURN) != 0,
        "stale_navigation": (tile.pose.stale | ~placed_rows(tile))[core, None],
        "saturated": (mask & SATURATED) != 0,
        "shadow": in_large_shadow(tile)[core],
    }
    covered = np.ones(mask.shape, dtype=np.bool_)
    lost = {}
    for reason, pixels in reasons.items():
        lost[reason] = covered & pixels
        covered ^= lost[reason]
    return covered, lost


def uncovered(tile: Tile) -> CoveragePatch:
    """Give the coverage of a tile whose processing failed: none, all its valid pixels lost to `failed`."""
    core = slice(tile.core_start, tile.core_stop)
    failed_m2 = float(np.count_nonzero(tile.mask[core] & VALID)) * tile.row_spacing_m * tile.column_spacing_m
    return CoveragePatch(
        side=tile.side,
        tile_index=tile.index,
        start_s=float(tile.pose.time_s[tile.core_start]),
        stop_s=float(tile.pose.time_s[tile.core_stop - 1]),
        rings_deg=(),
        covered_m2=0.0,
        lost_m2={"failed": failed_m2},
        evaluated_fraction=0.0,
        squint_rad=tile.squint_rad,
    )


def placed_rows(tile: Tile) -> NDArray[np.bool_]:
    """Select rows whose echoes can be placed on Earth, (n_rows,)."""
    pose = tile.pose
    known = np.isfinite(
        [pose.latitude_deg, pose.longitude_deg, pose.heading_rad, pose.pitch_rad, pose.roll_rad, tile.first_return_m]
    )
    return np.asarray(known.all(axis=0))


def _outlines(tile: Tile, covered: NDArray[np.bool_], sonar: SonarConfig) -> tuple[NDArray[np.float64], ...]:
    strip_rows = max(1, round(_STRIP_M / tile.row_spacing_m))
    rings: list[NDArray[np.float64]] = []
    share = covered.view(np.uint8).sum(axis=1, dtype=np.uint32) / covered.shape[1]
    for first, stop in _runs(share >= _MIN_ROW_COVER, round(_MAX_GAP_M / tile.row_spacing_m)):
        run = []
        for start in range(first, stop, strip_rows):
            strip = covered[start : min(start + strip_rows, stop)]
            rows = strip[strip.any(axis=1)]
            near = int(np.median(rows.argmax(axis=1)))
            far = int(np.median(rows.shape[1] - rows[:, ::-1].argmax(axis=1)))
            run.append((start, start + strip.shape[0], near, far))
        rings += _ring(tile, run, sonar)
    return tuple(rings)


def _runs(covers: NDArray[np.bool_], max_gap: int) -> list[tuple[int, int]]:
    """Find stretches [first, stop) of rows that cover, across gaps of up to `max_gap` rows."""
    runs: list[tuple[int, int]] = []
    for row in np.flatnonzero(covers).tolist():
        if runs and row - runs[-1][1] <= max_gap:
            runs[-1] = (runs[-1][0], row + 1)
        else:
            runs.append((row, row + 1))
    return runs


def _ring(tile: Tile, run: list[tuple[int, int, int, int]], sonar: SonarConfig) -> list[NDArray[np.float64]]:
    """Trace the outline of strips given as first row, stop row, near and far column."""
    edges = [float(run[0][0]), *(0.5 * (first + stop) for first, stop, _, _ in run), float(run[-1][1])]
    near = [run[0][2]] + [strip[2] for strip in run] + [run[-1][2]]
    far = [run[0][3]] + [strip[3] for strip in run] + [run[-1][3]]
    # Rows count from the upper edge of row 0, poses stand at row centres.
    position = np.clip(tile.core_start + np.array(edges + edges[::-1]) - 0.5, 0.0, len(tile.pose) - 1.0)
    ground_m = np.array(near + far[::-1]) * tile.column_spacing_m
    latitude, longitude, _ = locate(tile_echoes(tile, position, ground_m), sonar)
    ring = np.column_stack([longitude, latitude])
    ring = ring[np.isfinite(ring).all(axis=1)]
    if ring.shape[0] < 3 or position.min() == position.max():
        return []
    # Seen from above, up the near edge and back down the far one is counter-clockwise to port, clockwise to starboard.
    ring = ring if tile.side == "port" else ring[::-1]
    return [np.concatenate([ring, ring[:1]])]
