"""Outline the object in a recorded picture, as confirmation does, and compare with the mask drawn by hand."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import cv2
import numpy as np

from auv_mcm.classify.odds import MineOdds
from auv_mcm.confirm.mrf import segment
from auv_mcm.confirm.region import HIGHLIGHT, Region
from auv_mcm.confirm.snake import FINE, Nodes, converge, start_from_detection, start_from_labels
from auv_mcm.confirm.snake_rules import contour_mask
from auv_mcm.confirm.speckle import grain_area
from auv_mcm.confirmation import confirm_detection, labels_near, region_of
from auv_mcm.detect.measure import ROWS_M
from auv_mcm.records import VALID, Detection, Tile
from sim_replay.scoring.overlap import overlap
from tests.real.pictures.real_pictures import Mask, Picture, Plane
from tests.real.pictures.real_tiles import Geometry, config_of, detections_of, tile_of_picture

_NEAR_M: Final = 0.5  # from the mask, for a detection to be of the object
_SNAKE_NODES: Final = max(nodes for nodes, _, _ in FINE)
_AROUND_PX: Final = 41
_ACROSS_M: Final = (3.0, 8.0)  # before and behind the place looked at
_SMOOTHED_PX: Final = 3
_AROUND_M: Final = 0.3


class Overlaps(NamedTuple):
    """Intersection over union with the mask: of all highlight labels of a region, of the connected ones at the place
    looked at, of the snake started at that place, of the one started from those labels, and of whichever of the two has
    the lower criterion.
    """

    labels: float
    own_labels: float
    snake: float
    snake_from_labels: float
    best_start: float


class PlacedRegion(NamedTuple):
    """Hold a region and its first row and column in the tile."""

    region: Region
    corner: tuple[int, int]


class Outlined(NamedTuple):
    """Hold the highlight of a region. labels: same shape bool, the object's own. contour: (n, 2) float64 nodes of the
    best snake.
    """

    placed: PlacedRegion
    labels: Mask
    contour: Nodes
    iou: Overlaps


class JudgedOutline(NamedTuple):
    """Judge one picture of the object.

    detected: some detection is near the mask. first: that is the one of highest p_mine. given, found: with the mask's
    centre and with the best detection near the mask as the place to look; found is None if there is none. looked_at:
    that detection before and after the confirmation. best_threshold: of any threshold on smoothed intensity with the
    mask. one_pixel: of the mask with itself grown by a pixel. few_nodes: with its outline by 16 nodes. contrast_db:
    mean intensity inside the mask over that around it.
    """

    picture: Picture
    geometry: Geometry
    detected: bool
    first: bool
    given: Outlined
    found: Outlined | None
    looked_at: tuple[Detection, Detection] | None
    best_threshold: float
    one_pixel: float
    few_nodes: float
    contrast_db: float


def judge_outlines(picture: Picture, geometry: Geometry, odds: MineOdds) -> JudgedOutline:
    """Find and outline the object in a picture that has a mask."""
    assert picture.mask is not None
    tile, config = tile_of_picture(picture, geometry), config_of(geometry)
    beam_width_rad = math.radians(geometry.beam_width_deg)
    mask = np.pad(picture.mask, ((0, 0), (geometry.n_columns_before, 0)))
    rows, columns = np.nonzero(mask)
    given = outline(cut_around(tile, float(rows.mean()) + 0.5, float(columns.mean()) + 0.5, beam_width_rad), mask)
    detections = sorted(detections_of(tile, config), key=lambda d: -d.p_mine)
    near = [
        d
        for d in detections
        if float(np.hypot(rows + 0.5 - d.row, columns + 0.5 - d.column).min()) * geometry.pixel_m <= _NEAR_M
    ]
    found, looked_at = None, None
    if near and (surroundings := near[0].surroundings) is not None:
        corner = round(near[0].row - surroundings.row), round(near[0].column - surroundings.column)
        found = outline(PlacedRegion(region_of(near[0], surroundings, beam_width_rad), corner), mask)
        looked_at = near[0], confirm_detection(near[0], beam_width_rad, odds, config.confirm)
    valid = (tile.mask & VALID) != 0
    intensity = tile.intensity.astype(np.float64)
    grown, around = (cv2.dilate(mask.astype(np.uint8), np.ones((side, side), np.uint8)) > 0 for side in (3, _AROUND_PX))
    inside, outside = (float(intensity[part & valid].mean()) for part in (mask, around & ~grown))
    return JudgedOutline(
        picture=picture,
        geometry=geometry,
        detected=found is not None,
        first=bool(near) and near[0] is detections[0],
        given=given,
        found=found,
        looked_at=looked_at,
        best_threshold=best_threshold(intensity, mask, geometry.pixel_m),
        one_pixel=overlap(mask, grown),
        few_nodes=overlap(mask, with_few_nodes(mask)),
        contrast_db=10.0 * math.log10(inside / outside),
    )


def cut_around(tile: Tile, row: float, column: float, beam_width_rad: float) -> PlacedRegion:
    """Return the region that confirmation would use for a detection at a place of the tile."""
    n_rows, n_columns = tile.mask.shape
    (before, after), reach = (
        (round(away_m / tile.column_spacing_m) for away_m in _ACROSS_M),
        round(ROWS_M / tile.row_spacing_m),
    )
    top, near = max(0, int(row) - reach), max(0, int(column) - before)
    part = slice(top, min(n_rows, int(row) + reach + 1)), slice(near, min(n_columns, int(column) + after + 1))
    region = Region(
        intensity=tile.intensity[part].astype(np.float64),
        valid=(tile.mask[part] & VALID) != 0,
        row_spacing_m=tile.row_spacing_m,
        column_spacing_m=tile.column_spacing_m,
        first_ground_range_m=near * tile.column_spacing_m,
        altitude_m=float(tile.first_return_m[int(row)]),
        row=row - top,
        column=column - near,
        beam_width_rad=beam_width_rad,
    )
    return PlacedRegion(region, (top, near))


def outline(placed: PlacedRegion, mask: Mask) -> Outlined:
    """Return labels and contours of a region's object, as confirmation makes them, beside a mask (n_rows, n_columns) of
    the tile.
    """
    region = placed.region
    area = grain_area(region.intensity, region.valid)
    labels = segment(region).labels
    own = labels_near(labels, region)
    snake = converge(region, start_from_detection(region), correlation_px=area)
    again = snake if own is None else converge(region, start_from_labels(region, own), correlation_px=area)
    best = again if again.criterion < snake.criterion else snake
    part = tuple(
        slice(corner, corner + size) for corner, size in zip(placed.corner, region.intensity.shape, strict=True)
    )
    inside, n_mask = mask[part], int(mask.sum())

    def share(found: Mask) -> float:
        both = int((found & inside).sum())
        return both / (int(found.sum()) + n_mask - both)

    contours = [contour_mask(c.highlight, inside.shape) for c in (snake, again, best)]
    own_highlight = np.zeros(inside.shape, dtype=np.bool_) if own is None else own == HIGHLIGHT
    return Outlined(
        placed=placed,
        labels=own_highlight,
        contour=best.highlight,
        iou=Overlaps(share(labels == HIGHLIGHT), share(own_highlight), *map(share, contours)),
    )


def best_threshold(intensity: Plane, mask: Mask, pixel_m: float) -> float:
    """Intersection over union of the mask with the best of all thresholds on the 3 x 3 mean, within a third of a metre
    of its box.
    """
    smooth = cv2.blur(intensity, (_SMOOTHED_PX, _SMOOTHED_PX))
    rows, columns = np.nonzero(mask)
    reach = round(_AROUND_M / pixel_m)
    part = (
        slice(max(rows.min() - reach, 0), rows.max() + reach + 1),
        slice(max(columns.min() - reach, 0), columns.max() + reach + 1),
    )
    levels = np.quantile(smooth[part], np.linspace(0.0, 1.0, 101))
    return max(overlap(smooth[part] >= level, mask[part]) for level in levels)


def with_few_nodes(mask: Mask) -> Mask:
    """Return the mask's largest part inside an outline of at most as many nodes as a snake has."""
    outlines, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    largest = max(outlines, key=len)
    coarse, tolerance_px = largest, 0.0
    while len(coarse) > _SNAKE_NODES:
        tolerance_px += 0.25
        coarse = cv2.approxPolyDP(largest, tolerance_px, closed=True)
    return cv2.fillPoly(np.zeros(mask.shape, dtype=np.uint8), [coarse], 1) > 0
