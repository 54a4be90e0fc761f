"""Read a georeferenced picture, such as a sea chart or a depth grid, as the background of the map."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
import tifffile
from numpy.typing import NDArray

from auv_mcm.errors import BadInputError, UsageError
from auv_mcm.safe_files import open_regular
from sim_replay.logs.image_place import affine_of
from sim_replay.logs.image_stored import parsing

MAX_SIDE: Final = 3000
"""Pixels along a side of the background: a chart of 6 km then has 2 m; larger ones are averaged."""
_MAX_BYTES: Final = 1 << 29  # of a file, packed or not: a chart of 1 by 1.3 m at 400 dpi has 320 MB in a palette
_GRID: Final = 65  # places along either axis that are projected; between them linear, within a pixel over 60 km
_STRETCH: Final = (2.0, 98.0)  # percentiles of figures that are black and white
_USER_DEFINED: Final = 32767  # EPSG: a reference system described by its parameters (OGC 19-008r4)
_NO_DATA_TAG: Final = 42113  # GDAL's, of the figure that stands for none
_WARP: Final = "gdalwarp -t_srs EPSG:4326 IN.tif OUT.tif"


class Chart(NamedTuple):
    """Hold a picture that is even in longitude and latitude. png: transparent where it shows nothing."""

    png: bytes
    west_deg: float
    south_deg: float
    east_deg: float
    north_deg: float


class _Placed(NamedTuple):
    """Hold where pixels lie. affine: (2, 3) from column, row and 1 to coordinates of the reference system `epsg`.

    no_data: the figure that stands for none. palette: (n, 3) uint8 blue, green and red of each figure.
    """

    affine: NDArray[np.float64]
    epsg: int
    no_data: float | None
    palette: NDArray[np.uint8] | None


def read_chart(path: Path) -> Chart:
    """Read a GeoTIFF of grey, figures, a palette, or red, green and blue with or without opacity.

    Raises UsageError without a file, BadInputError for one that is damaged, too large, or does not hold its place.
    """
    if not path.exists() or path.is_dir():
        raise UsageError(f"--chart {path}: there is no such file. Name a GeoTIFF")
    with (
        parsing(path, "is not a readable GeoTIFF", f"Fetch it again, or write it with '{_WARP}'."),
        open_regular(path) as file,
    ):
        placed = _placed(path, file)
        file.seek(0)
        pixels = _decoded(file.read())
        step = -(-max(pixels.shape[:2]) // (2 * MAX_SIDE))  # what is still finer is averaged
        skip = step // 2
        thinned = np.array([[step, 0.0, skip + 0.5 - step / 2], [0.0, step, skip + 0.5 - step / 2], [0.0, 0.0, 1.0]])
        placed = placed._replace(affine=placed.affine @ thinned)
        return _warped(path, _coloured(pixels[skip::step, skip::step], placed), placed)


def _placed(path: Path, file: Any) -> _Placed:
    """Read where pixels lie from the header."""
    with tifffile.TiffFile(file) as tiff:
        page: Any = tiff.pages.first
        if max(page.nbytes, os.fstat(file.fileno()).st_size) > _MAX_BYTES:
            raise BadInputError(
                f"{path} has {page.imagewidth} x {page.imagelength} pixels, more than 512 MiB. Make it coarser: "
                "gdal_translate -outsize 25% 25% IN.tif OUT.tif"
            )
        tags = dict(page.geotiff_tags or {})
        affine = affine_of(tags)
        epsg = int(tags.get("ProjectedCSTypeGeoKey") or tags.get("GeographicTypeGeoKey") or 0)
        if affine is None or not np.isfinite(affine).all() or abs(np.linalg.det(affine[:, :2])) == 0.0:
            raise BadInputError(f"{path} does not hold its place: export it as a GeoTIFF with its reference system")
        if epsg in (0, _USER_DEFINED):
            raise BadInputError(f"{path} names no EPSG code. Write it in one that has: {_WARP}")
        if int(tags.get("GTRasterTypeGeoKey", 1)) == 2:  # the tie lies in the middle of a pixel
            affine = affine @ np.array([[1.0, 0.0, -0.5], [0.0, 1.0, -0.5], [0.0, 0.0, 1.0]])
        no_data = page.tags.get(_NO_DATA_TAG)
        palette = None if page.colormap is None else (page.colormap[::-1].T >> 8).astype(np.uint8)
        return _Placed(affine, epsg, None if no_data is None else float(no_data.value.strip("\0 ")), palette)


def _decoded(data: bytes) -> NDArray[Any]:
    """Decode pixels by OpenCV, which otherwise prints a line for each tag that it does not know."""
    level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        pixels = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    finally:
        cv2.utils.logging.setLogLevel(level)
    if pixels is None:
        raise ValueError("its pixels cannot be decoded")
    return np.asarray(pixels)


def _coloured(pixels: NDArray[Any], placed: _Placed) -> NDArray[np.uint8]:
    """Make pixels blue, green, red and opacity, (n_rows, n_columns, 4); figures become grey."""
    if pixels.ndim == 2:
        figures = pixels.astype(np.float32)
        known = np.isfinite(figures)
        if placed.no_data is not None:
            known &= figures != np.float32(placed.no_data)
        low, high = np.percentile(figures[known], _STRETCH) if known.any() else (0.0, 1.0)
        if pixels.dtype == np.uint8:
            low, high = 0.0, 255.0
        grey = np.clip((np.where(known, figures, low) - low) / max(high - low, 1e-9), 0.0, 1.0) * 255.0
        shown = np.dstack([grey] * 3) if placed.palette is None else placed.palette[pixels]
        pixels = np.dstack([shown, np.where(known, 255, 0)]).astype(np.uint8)
    elif pixels.dtype != np.uint8:
        pixels = (pixels >> 8).astype(np.uint8) if pixels.dtype == np.uint16 else pixels.astype(np.uint8)
    if pixels.shape[2] == 3:
        pixels = np.dstack([pixels, np.full(pixels.shape[:2], 255, dtype=np.uint8)])
    return np.asarray(pixels)


def _warped(path: Path, pixels: NDArray[np.uint8], placed: _Placed) -> Chart:
    """Project a picture to even longitude and latitude."""
    from pyproj import Transformer

    n_rows, n_columns = pixels.shape[:2]
    to_degrees = Transformer.from_crs(placed.epsg, 4326, always_xy=True)
    edge = np.linspace(0.0, 1.0, _GRID)
    column = np.concatenate([edge, edge, np.zeros(_GRID), np.ones(_GRID)]) * n_columns
    row = np.concatenate([np.zeros(_GRID), np.ones(_GRID), edge, edge]) * n_rows
    longitude, latitude = to_degrees.transform(*(placed.affine @ np.stack([column, row, np.ones_like(row)])))
    west, east, south, north = longitude.min(), longitude.max(), latitude.min(), latitude.max()
    if not (np.isfinite(longitude).all() and np.isfinite(latitude).all() and east - west < 180.0):
        raise BadInputError(f"{path} reaches around the earth or beyond its map. Cut the area out: gdalwarp -te")
    shrunk = min(1.0, MAX_SIDE / max(n_rows, n_columns))
    width, height = max(int(n_columns * shrunk), 1), max(int(n_rows * shrunk), 1)
    if shrunk < 1.0:
        pixels = np.asarray(cv2.resize(pixels, (width, height), interpolation=cv2.INTER_AREA))
    grid = np.meshgrid(west + (east - west) * edge, north - (north - south) * edge)
    x, y = to_degrees.transform(grid[0], grid[1], direction="INVERSE")
    inverse = np.linalg.inv(np.vstack([placed.affine, [0.0, 0.0, 1.0]]))
    columns, rows, _ = np.tensordot(inverse, np.stack([x, y, np.ones_like(x)]), 1)
    across, down = _between(width), _between(height)
    source = [
        (down @ (place * scale) @ across.T - 0.5).astype(np.float32)
        for place, scale in ((columns, width / n_columns), (rows, height / n_rows))
    ]
    warped = cv2.remap(pixels, source[0], source[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    return Chart(cv2.imencode(".png", warped)[1].tobytes(), float(west), float(south), float(east), float(north))


def _between(n_pixels: int) -> NDArray[np.float64]:
    """Make the weights (n_pixels, _GRID) of places on the grid at the middles of pixels."""
    at = (np.arange(n_pixels) + 0.5) * (_GRID - 1) / n_pixels
    return np.stack([np.interp(at, np.arange(_GRID), one) for one in np.eye(_GRID)], axis=1)
