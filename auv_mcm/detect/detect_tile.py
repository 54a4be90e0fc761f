"""The detection stage: a tile in, measured and georeferenced detections out."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from msgspec import structs
from numpy.typing import NDArray

from auv_mcm.detect.belief import probability, with_measurement
from auv_mcm.detect.candidates import NO_FAINT_PLACES, Candidate, FaintPlaces, by_both, by_contrast
from auv_mcm.detect.cascade.model import CascadeModel
from auv_mcm.detect.gate import Gate
from auv_mcm.detect.measure import ROWS_M, Measurement, measure
from auv_mcm.detect.prescreen import CONTEXT_M, Peak
from auv_mcm.geometry.georeference import EchoGeometry, aspect_deg, locate, position_covariance, tile_echoes
from auv_mcm.geometry.pose_track import slice_pose
from auv_mcm.records import LOW_RESOLUTION, VALID, Detection, Surroundings, Tile
from auv_mcm.settings.config import Config
from auv_mcm.skips import NO_SKIPS, Skips
from auv_mcm.snippet import pack_snippet
from auv_mcm.waterfall.radiometry import LOCAL_MEAN_REACH_M

_REACH_M: Final = max(CONTEXT_M, ROWS_M) + 1.0  # of detection along the track; a metre for the margin of peaks
OVERLAP_M: Final = LOCAL_MEAN_REACH_M + _REACH_M
"""Along-track context a tile needs beyond its core for detections there to be independent of where it was cut."""

_STALE_SIGMA_M: Final = 25.0  # m, 1-sigma added where navigation is stale; chosen, not measured
_UNSEEN_BOTTOM: Final = 0.2  # relative error of the first return that only a bottom not seen has
_NEAR_M: Final = 3.0  # of the surroundings, before the object
_BEHIND_M: Final = 2.5  # and behind the longest shadow looked for
_TALLEST_M: Final = 0.8  # m above the sea floor: the object whose shadow the surroundings must hold
_FAR_M: Final = (8.0, 12.0)  # m behind the peak that surroundings reach, minimum and maximum
_DARKEST: Final = 1e-4  # an echo of nothing, which is not the same as no echo


class TileDetections(NamedTuple):
    """Hold what a tile gave.

    Detections (best first), candidates beyond the budget, detections that could not be placed on Earth.

    faint: places that cannot become contacts and were not measured, on the mission grid.
    n_windows: places that the trained cascade looked at, n_evaluations: comparisons it made, n_cut: windows it left
    since its budget was used up, of n_windows, n_rejected: windows that it rejected before its last group; all 0 where
    contrasts alone serve. n_bounded: pixels whose contrast was not weighed. clear_contrasts: only clear peaks of
    contrast were looked for. covered_share: of the tile's coverage that is earned, 0 to 1; less than 1 where the tile's
    budget left out windows or examinations, as `auv_mcm.budget` says. A detection whose examination is beyond the
    budget has no surroundings.
    """

    detections: tuple[Detection, ...]
    n_over_budget: int
    n_without_position: int
    faint: FaintPlaces = NO_FAINT_PLACES
    n_windows: int = 0
    n_evaluations: int = 0
    n_cut: int = 0
    n_rejected: int = 0
    n_bounded: int = 0
    clear_contrasts: bool = False
    covered_share: float = 1.0


def worth_looking(tile: Tile) -> bool:
    """Check whether any core pixel can hold a detection, neither masked nor near nadir."""
    core = tile.mask[tile.core_start : tile.core_stop]
    return bool(((core & (VALID | LOW_RESOLUTION)) == VALID).any())


def detect_tile(
    tile: Tile,
    config: Config,
    model: CascadeModel | None = None,
    gate: Gate | None = None,
    *,
    max_evaluations: int | None = None,
    without_skips: Skips = NO_SKIPS,
) -> TileDetections:
    """Find the objects whose score peaks in the tile's core.

    Positions are NaN-free; detections without a known pose are counted instead.

    Parameters
    ----------
    model
        The trained cascade; contrasts serve without one.
    gate
        Drops what cannot become a contact that is reported, before it is measured; without one everything is measured.
    max_evaluations
        Comparisons that the cascade may make, best windows first, None for all.
    without_skips
        Those that are switched off.
    """
    tile = _within_reach(tile)
    min_p_mine = config.contacts.min_p_mine
    if model is None:
        found = by_contrast(tile, config.detect, gate, min_p_mine, without_skips)
    else:
        budget = None if "cascade-budget" in without_skips else max_evaluations
        found = by_both(tile, model, config.detect, budget, gate, min_p_mine, without_skips)
    beam_width_rad = config.sonar.beam_width_rad
    measured = [measure(tile, candidate.floor, candidate.peak, beam_width_rad) for candidate in found.candidates]
    detections = _placed(tile, config, found.candidates, measured)
    return TileDetections(
        detections=detections,
        n_over_budget=found.n_over_budget,
        n_without_position=len(found.candidates) - len(detections),
        faint=found.faint._replace(rows=found.faint.rows + tile.first_row),
        n_windows=found.n_windows,
        n_evaluations=found.n_evaluations,
        n_cut=found.n_cut,
        n_rejected=found.n_rejected,
        n_bounded=found.n_bounded,
        clear_contrasts=found.clear_contrasts,
    )


def _within_reach(tile: Tile) -> Tile:
    """Cut off the rows that the local mean alone needed: a sixth of a tile of the default size."""
    reach = math.ceil(_REACH_M / tile.row_spacing_m) + 1
    rows = slice(max(tile.core_start - reach, 0), tile.core_stop + reach)
    return structs.replace(
        tile,
        first_row=tile.first_row + rows.start,
        core_start=tile.core_start - rows.start,
        core_stop=tile.core_stop - rows.start,
        intensity=tile.intensity[rows],
        mask=tile.mask[rows],
        pose=slice_pose(tile.pose, rows),
        first_return_m=tile.first_return_m[rows],
        first_return_sigma_m=tile.first_return_sigma_m[rows],
        ping_number=tile.ping_number[rows],
        level=None if tile.level is None else tile.level[rows],
    )


class _Places(NamedTuple):
    """Hold where n measurements lie. position: (n,) rows of their poses. covariance_m2: (n, 2, 2), north and east."""

    position: NDArray[np.float64]
    echoes: EchoGeometry
    ground_range_m: NDArray[np.float64]
    latitude_deg: NDArray[np.float64]
    longitude_deg: NDArray[np.float64]
    depth_m: NDArray[np.float64]
    covariance_m2: NDArray[np.float64]
    aspect_deg: NDArray[np.float64]
    first_return_sigma_m: NDArray[np.float64]


def _places_of(tile: Tile, config: Config, measured: list[Measurement]) -> _Places:
    """Locate measurements on Earth, NaN where that cannot be done."""
    # Measured rows count from the upper edge of row 0, poses stand at row centres.
    position = np.clip(np.array([m.row for m in measured]) - 0.5, 0.0, len(tile.pose) - 1.0)
    ground_range_m = np.array([m.column for m in measured]) * tile.column_spacing_m
    echoes = tile_echoes(tile, position, ground_range_m)
    pose = echoes.pose
    latitude, longitude, height = locate(echoes, config.sonar)
    depth_m = np.where(np.isfinite(pose.depth_m), -height, np.nan)  # without a depth, heights start at the vehicle
    sigma_m = _between(tile.first_return_sigma_m, position)
    covariance = position_covariance(echoes, config.sonar, config.navigation, sigma_m)
    added_m2 = pose.position_sigma_m**2 + np.where(pose.stale, _STALE_SIGMA_M**2, 0.0)
    covariance += added_m2[:, np.newaxis, np.newaxis] * np.eye(2)
    aspect = aspect_deg(echoes, config.sonar, tile.squint_rad)
    return _Places(position, echoes, ground_range_m, latitude, longitude, depth_m, covariance, aspect, sigma_m)


def _placed(
    tile: Tile, config: Config, candidates: list[Candidate], measured: list[Measurement]
) -> tuple[Detection, ...]:
    if not candidates:
        return ()
    places = _places_of(tile, config, measured)
    pose, first_return_m = places.echoes.pose, places.echoes.first_return_m
    detections = []
    for index, (candidate, m) in enumerate(zip(candidates, measured, strict=True)):
        if not (math.isfinite(places.latitude_deg[index]) and math.isfinite(places.longitude_deg[index])):
            continue
        odds, reasons = with_measurement(candidate.odds, m, config.detect.max_object_m)
        if places.first_return_sigma_m[index] > _UNSEEN_BOTTOM * first_return_m[index]:
            reasons = (*reasons, "bottom_not_seen")
        if pose.stale[index]:
            reasons = (*reasons, "stale_navigation")
        detections.append(
            Detection(
                side=tile.side,
                row=tile.first_row + m.row,
                column=m.column,
                time_s=float(pose.time_s[index]),
                ping_number=int(tile.ping_number[round(places.position[index])]),
                latitude_deg=float(places.latitude_deg[index]),
                longitude_deg=float(places.longitude_deg[index]),
                covariance_m2=places.covariance_m2[index],
                heading_rad=float(pose.heading_rad[index]),
                aspect_deg=float(places.aspect_deg[index]),
                ground_range_m=float(places.ground_range_m[index]),
                slant_range_m=float(places.echoes.slant_range_m[index]),
                altitude_m=float(
                    first_return_m[index]
                    * math.cos(pose.pitch_rad[index] + math.radians(config.sonar.pitch_offset_deg))
                ),
                depth_m=float(places.depth_m[index]),
                score=candidate.peak.score,
                cascade_score=candidate.cascade_score,
                highlight_db=m.highlight_db,
                shadow_db=m.shadow_db,
                length_m=max(m.along_m, m.across_m),
                width_m=min(m.along_m, m.across_m),
                height_m=m.height_m,
                shadow_length_m=m.shadow_length_m,
                p_mine=probability(odds),
                reasons=reasons,
                snippet=m.snippet,
                snippet_row=m.snippet_row,
                snippet_column=m.snippet_column,
                row_spacing_m=tile.row_spacing_m,
                column_spacing_m=tile.column_spacing_m,
                surroundings=_surroundings(tile, candidate.peak, m),
                squint_rad=tile.squint_rad,
            )
        )
    return tuple(detections)


def _surroundings(tile: Tile, peak: Peak, measured: Measurement) -> Surroundings:
    """Cut ROWS_M about the score's peak, which does not depend on where the tile was cut."""
    n_rows, n_columns = tile.mask.shape
    column_m = tile.column_spacing_m
    first_return_m = float(tile.first_return_m[peak.row])
    shadow_m = _TALLEST_M * peak.column * column_m / max(first_return_m - _TALLEST_M, 0.5)
    far_m = min(max(shadow_m + _BEHIND_M, _FAR_M[0]), _FAR_M[1])
    reach = round(ROWS_M / tile.row_spacing_m)
    top, near = max(0, peak.row - reach), max(0, peak.column - round(_NEAR_M / column_m))
    part = (
        slice(top, min(n_rows, peak.row + reach + 1)),
        slice(near, min(n_columns, peak.column + round(far_m / column_m) + 1)),
    )
    valid = (tile.mask[part] & VALID) != 0
    return Surroundings(
        codes=pack_snippet(np.maximum(tile.intensity[part], np.float32(_DARKEST))) * valid,
        row=measured.row - top,
        column=measured.column - near,
        first_ground_range_m=near * column_m,
        first_return_m=first_return_m,
    )


def _between(values: NDArray[np.float64], position: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.interp(position, np.arange(values.shape[0]), values)
