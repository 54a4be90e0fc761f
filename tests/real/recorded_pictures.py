"""Recorded pictures of sea floor, range growing to the right, as the tiles that the chain would make of them.

`sdvd_20240429` holds side-scan tiles with masks of an effigy's highlight (Jaszcz et al. 2024), `sas` synthetic-aperture
snippets (NSWC PCD). All are 8-bit pictures with marks of the program that drew them. They have neither scale nor
geometry: what the chain needs to know of them is assumed here.
"""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path
from typing import Final, NamedTuple

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.detect.detect_tile import detect_tile
from auv_mcm.detect.suppress import Suppressor
from auv_mcm.records import SATURATED, VALID, Detection, Tile
from auv_mcm.settings.config import Config
from auv_mcm.waterfall.radiometry import AngleCurve, local_mean
from tests.make.records import straight_pose, tile_with

Mask = NDArray[np.bool_]
Plane = NDArray[np.float64]
Counts = NDArray[np.uint8]

_BRIGHTEST: Final = 255
_MIN_FILL_PX: Final = 600
_TICK_PX: Final = 8
_LABEL_PX: Final = (66, 10)  # rows above a tick's end, columns beside it
_DARK_M: Final = 1.0
_DARK: Final = 0.04  # of the median: the water column
_SPEED_MPS: Final = 1.5


class Geometry(NamedTuple):
    """The geometry assumed: pixel size, slant range of the first bottom return, ground range of the near edge."""

    pixel_m: float
    first_return_m: float
    first_ground_range_m: float
    beam_width_deg: float

    @property
    def n_columns_before(self) -> int:
        """Columns of the ground-range grid before the picture."""
        return round(self.first_ground_range_m / self.pixel_m)

    @property
    def config(self) -> Config:
        """The default configuration with the beam of the sonar that made the picture."""
        config = Config()
        return msgspec.structs.replace(
            config, sonar=msgspec.structs.replace(config.sonar, beam_width_deg=self.beam_width_deg)
        )


SIDE_SCAN: Final = Geometry(pixel_m=0.032, first_return_m=4.0, first_ground_range_m=5.0, beam_width_deg=0.3)
SAS: Final = Geometry(pixel_m=0.025, first_return_m=8.0, first_ground_range_m=30.0, beam_width_deg=0.01)


def read_picture(path: Path) -> Counts:
    """A picture's counts; names that begin with `left_` are mirrored."""
    picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    assert picture is not None, path
    counts = np.asarray(picture, dtype=np.uint8)
    return np.ascontiguousarray(counts[:, ::-1]) if path.name.startswith("left_") else counts


def tile_of_picture(counts: Counts, geometry: Geometry) -> Tile:
    """The angle response and the local mean taken off, in ground range.

    Columns before the picture's near edge are not valid. The track runs north at constant speed.
    """
    n_rows, n_columns = counts.shape
    offset = geometry.n_columns_before
    intensity = np.maximum(counts.astype(np.float64), 0.5) ** 2
    seen = ~(_fill(counts) | _range_marks(counts))
    measured = seen & ~_dark_stretches(intensity, seen, geometry.pixel_m)
    ground_m = geometry.first_ground_range_m + (np.arange(n_columns) + 0.5) * geometry.pixel_m
    tangent = np.broadcast_to(geometry.first_return_m / ground_m, intensity.shape)
    log_intensity = np.log(intensity)
    log_intensity -= AngleCurve().learn(log_intensity, measured, tangent)
    levelled = np.where(measured, np.exp(log_intensity), 0.0).astype(np.float32)
    mean, known = local_mean(levelled, measured, geometry.pixel_m, geometry.pixel_m)
    valid = measured & known
    shape = n_rows, offset + n_columns
    plane, bits = np.zeros(shape, dtype=np.float32), np.zeros(shape, dtype=np.uint8)
    plane[:, offset:] = np.where(valid, levelled / np.maximum(mean, 1e-9), 0.0)
    bits[:, offset:] = np.where(valid, VALID, 0) | np.where(valid & (counts >= _BRIGHTEST), SATURATED, 0)
    return tile_with(
        plane,
        bits,
        row_spacing_m=geometry.pixel_m,
        column_spacing_m=geometry.pixel_m,
        pose=straight_pose(
            n_rows, geometry.pixel_m, (45.0, 5.0), speed_mps=_SPEED_MPS, altitude_m=geometry.first_return_m
        ),
        first_return_m=geometry.first_return_m,
        first_return_sigma_m=np.full(n_rows, 0.05 * geometry.first_return_m),
    )


def detections_of(tile: Tile, config: Config) -> list[Detection]:
    """The detections of one tile after suppression."""
    suppressor = Suppressor(config.detect, tile.row_spacing_m, Counter())
    settled = suppressor.add(detect_tile(tile, config).detections, math.inf)
    return [*settled, *suppressor.flush()]


def _fill(counts: Counts) -> Mask:
    """Large areas of zeros, where the tile goes beyond the recording."""
    _, parts, stats, _ = cv2.connectedComponentsWithStats((counts == 0).astype(np.uint8), connectivity=4)
    large = stats[:, cv2.CC_STAT_AREA] >= _MIN_FILL_PX
    large[0] = False
    return np.asarray(large[parts])


def _range_marks(counts: Counts) -> Mask:
    """Ticks of the range scale, white between black with the label above, and the transmit pulse, which looks alike."""
    wide = np.pad(counts.astype(np.int64), ((0, 0), (2, 2)), mode="edge")
    tick = (wide[:, 2:-2] > 180) & (wide[:, :-4] < 70) & (wide[:, 4:] < 70)
    long = cv2.erode(
        tick.astype(np.uint8), np.ones((_TICK_PX, 1), np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=0
    )
    above, beside = _LABEL_PX
    marked = np.zeros(counts.shape, dtype=np.bool_)
    for row, column in np.argwhere(long).tolist():
        marked[max(row - above, 0) : row + _TICK_PX, max(column - beside, 0) : column + beside + 1] = True
    return marked


def _dark_stretches(intensity: Plane, measured: Mask, pixel_m: float) -> Mask:
    """The water column: metres without echo. Shadows of wrecks go with it."""
    side = 2 * round(0.5 * _DARK_M / pixel_m) + 1
    total = cv2.boxFilter(
        np.where(measured, intensity, 0.0), -1, (side, side), normalize=True, borderType=cv2.BORDER_REFLECT
    )
    share = cv2.boxFilter(measured.astype(np.float64), -1, (side, side), normalize=True, borderType=cv2.BORDER_REFLECT)
    level = float(np.median(intensity[measured])) if measured.any() else 1.0
    bright = float(np.quantile(intensity[measured], 0.75)) if measured.any() else 1.0
    return np.asarray(total < _DARK * max(level, 0.5 * bright) * np.maximum(share, 1e-6))
