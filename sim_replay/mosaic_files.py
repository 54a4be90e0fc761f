"""Write a mosaic as a GeoTIFF with overviews and as a KMZ ground overlay, a block at a time."""

from __future__ import annotations

import math
import os
import secrets
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from html import escape
from pathlib import Path
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from auv_mcm.clean_text import clean
from auv_mcm.contacts.contact_picture import FLOOR_DB, LEVELS, coloured_levels, encoded
from auv_mcm.errors import UsageError
from sim_replay.cloud_tiff import Page, Tag, write_cloud_tiff
from sim_replay.mosaic import BLOCK, ECHO_STEP_DB, SIGMA_STEP_M, WGS84, Level

MAX_SIDE: Final = 1 << 20
"""Pixels along a side of a GeoTIFF: the table of its tiles takes 16 bytes for each 256 by 256 of them, 270 MB then."""
_MAX_TILES: Final = 1 << 22  # of a GeoTIFF, for the same reason: 64 MB of the file where nothing was seen
_OVERLAY: Final = 4  # blocks along a side of a picture of the KMZ: 1024 pixels, which every viewer takes
_FROM_PIXELS: Final = 512  # pixels on the screen, from which the pictures of the next finer level are shown
_COMPRESSION: Final = 6  # of zlib; 9 takes far longer for the same size, since speckle hardly repeats

# GeoTIFF 1.1 (OGC 19-008): keys of a geographic model, WGS 84 (EPSG 4326), degrees (EPSG 9102), pixels as areas.
_GEO_KEYS: Final = (1, 1, 1, 4, 1024, 0, 1, 2, 1025, 0, 1, 1, 2048, 0, 1, 4326, 2054, 0, 1, 9102)
# The same of a projected model: the system's EPSG code follows the 15th number, then metres (EPSG 9001).
_PROJECTED_KEYS: Final = (1, 1, 1, 4, 1024, 0, 1, 1, 1025, 0, 1, 1, 3072, 0, 1, 3076, 0, 1, 9001)
_GDAL_METADATA: Final = (
    "<GDALMetadata>"
    '<Item name="DESCRIPTION" sample="0" role="description">echo over the sea floor around</Item>'
    '<Item name="UNITTYPE" sample="0" role="unittype">dB</Item>'
    f'<Item name="SCALE" sample="0" role="scale">{ECHO_STEP_DB!r}</Item>'
    f'<Item name="OFFSET" sample="0" role="offset">{FLOOR_DB - ECHO_STEP_DB!r}</Item>'
    '<Item name="DESCRIPTION" sample="1" role="description">1-sigma error of position</Item>'
    '<Item name="UNITTYPE" sample="1" role="unittype">m</Item>'
    f'<Item name="SCALE" sample="1" role="scale">{SIGMA_STEP_M!r}</Item>'
    '<Item name="OFFSET" sample="1" role="offset">0</Item>'
    "</GDALMetadata>"
)


PALETTES: Final = ("copper", "grey", "viridis", "inferno")
"""Colours that a mosaic can have; copper is that of the waterfall."""
_OPENCV: Final = {"viridis": cv2.COLORMAP_VIRIDIS, "inferno": cv2.COLORMAP_INFERNO}


class Window(NamedTuple):
    """Hold the part of a level that is written: its corner and size in pixels of the level."""

    level: Level
    left: int
    top: int
    width: int
    height: int


def write_geotiff(path: Path, levels: Sequence[Level], max_sigma_m: float = math.inf, palette: str = "") -> None:
    """Write the mosaic and its overviews as a cloud-optimised GeoTIFF, without empty margins.

    Band 1 is the echo over the sea floor around it in dB, band 2 the 1-sigma error of position in m; both are bytes
    with scale and offset, 0 where nothing was seen. With a palette it has four bands instead: red, green, blue and
    opacity.

    Parameters
    ----------
    path
        Of the file.
    levels
        The mosaic and its overviews, as `Mosaic.levels` gives them.
    max_sigma_m
        What is placed worse than this is left out.
    palette
        One of PALETTES; "" for figures.

    Raises
    ------
    OSError
        From the disk, and UsageError for a mosaic that is too large.
    """
    windows = _windows(levels, max_sigma_m)
    first = windows[0]
    n_tiles = (-(-first.width // BLOCK)) * (-(-first.height // BLOCK))
    if max(first.width, first.height) > MAX_SIDE or n_tiles > _MAX_TILES:
        raise UsageError(
            f"the mosaic would have {first.width} x {first.height} pixels of {first.level.resolution_m:g} m. Choose a "
            "coarser --resolution, or export logs of distant sites apart."
        )
    pages = [
        Page(
            window.width,
            window.height,
            4 if palette else 2,
            bool(palette),
            _geo_tags(window, palette, is_first=number == 0),
            _tiles(window, max_sigma_m, palette),
        )
        for number, window in enumerate(windows)
    ]
    with replaced_file(path) as temporary:
        write_cloud_tiff(temporary, pages)


def write_kmz(
    path: Path, levels: Sequence[Level], name: str, max_sigma_m: float = math.inf, folders: Iterable[str] = ()
) -> None:
    """Write the mosaic as a KMZ of ground overlays; a viewer loads finer pictures where it comes near.

    folders: KML of what lies on it. Raises OSError.
    """
    with replaced_file(path) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_STORED) as file:
        overlays = []
        for number, level in enumerate(reversed(levels)):
            for key in sorted({(column // _OVERLAY, row // _OVERLAY) for column, row in level.blocks}):
                picture = _overlay(level, key, max_sigma_m)
                if not picture[..., 3].any():
                    continue
                inside = f"mosaic/{number}-{key[0]}-{key[1]}.png"
                file.writestr(inside, encoded(picture, ".png", [cv2.IMWRITE_PNG_COMPRESSION, 6]))
                overlays.append(_ground_overlay(level, key, picture.shape, inside, number))
        text = (
            '<?xml version="1.0" encoding="UTF-8"?>\n<kml xmlns="http://www.opengis.net/kml/2.2">\n<Document>\n'
            f"<name>{escape(clean(name), quote=False)}</name>\n"
            f"{''.join(folders)}{''.join(overlays)}</Document>\n</kml>\n"
        )
        file.writestr("doc.kml", text, zipfile.ZIP_DEFLATED)


def coloured(drawn: NDArray[np.uint8], palette: str = "copper") -> NDArray[np.uint8]:
    """Colour bytes of echo: (n, m, 4) uint8 blue, green, red, opacity. palette: of PALETTES."""
    echo = np.arange(256, dtype=np.uint8)[:, np.newaxis]
    if palette == "copper":
        colours = coloured_levels(np.ceil(echo * (LEVELS / 255.0)).astype(np.uint8))
    elif palette == "grey":
        colours = np.repeat(echo[..., np.newaxis], 3, axis=-1)
    else:
        colours = np.asarray(cv2.applyColorMap(echo, _OPENCV[palette]))
    table = np.full((256, 4), 255, dtype=np.uint8)
    table[:, :3], table[0] = colours[:, 0], 0
    pixels = cv2.LUT(np.ascontiguousarray(drawn[..., 0]), table.view(np.int32))
    return np.asarray(pixels[..., np.newaxis].view(np.uint8))


def _windows(levels: Sequence[Level], max_sigma_m: float) -> list[Window]:
    """Find the part of each level that holds anything.

    The corner lies on a whole pixel of the coarsest overview, so that every overview begins there too.
    """
    first, grid = levels[0], 1 << (len(levels) - 1)
    left, top, right, bottom = first.width, first.height, 0, 0
    for column, row in first.blocks:
        drawn = first.bytes_of((column, row), max_sigma_m)
        seen = np.zeros((1, 1), dtype=bool) if drawn is None else drawn[..., 0] > 0
        rows, columns = np.flatnonzero(seen.any(axis=1)), np.flatnonzero(seen.any(axis=0))
        if len(rows):
            left, right = min(left, column * BLOCK + int(columns[0])), max(right, column * BLOCK + int(columns[-1]) + 1)
            top, bottom = min(top, row * BLOCK + int(rows[0])), max(bottom, row * BLOCK + int(rows[-1]) + 1)
    if right <= left:  # all of it is placed too badly: the whole outline, empty
        left, top, right, bottom = 0, 0, first.width, first.height
    left, top = left // grid * grid, top // grid * grid
    return [
        Window(level, left >> number, top >> number, -(-(right - left) >> number), -(-(bottom - top) >> number))
        for number, level in enumerate(levels)
    ]


def _tiles(window: Window, max_sigma_m: float, palette: str) -> Iterator[bytes]:
    """Yield compressed tiles, row by row; empty ones, which a GeoTIFF may have where there is nothing, are b""."""
    for row in range(-(-window.height // BLOCK)):
        for column in range(-(-window.width // BLOCK)):
            drawn = _cut(window.level, window.left + column * BLOCK, window.top + row * BLOCK, max_sigma_m)
            if not drawn.any():
                yield b""
                continue
            if palette:
                drawn = np.ascontiguousarray(coloured(drawn, palette)[..., [2, 1, 0, 3]])
            yield zlib.compress(drawn.tobytes(), _COMPRESSION)


def _cut(level: Level, left: int, top: int, max_sigma_m: float) -> NDArray[np.uint8]:
    """Cut a tile out of a level, from up to four blocks of it."""
    cut = np.zeros((2 * BLOCK, 2 * BLOCK, 2), dtype=np.uint8)
    for down in (0, 1):
        for right in (0, 1):
            drawn = level.bytes_of((left // BLOCK + right, top // BLOCK + down), max_sigma_m)
            if drawn is not None:
                cut[down * BLOCK : (down + 1) * BLOCK, right * BLOCK : (right + 1) * BLOCK] = drawn
    return np.ascontiguousarray(cut[top % BLOCK : top % BLOCK + BLOCK, left % BLOCK : left % BLOCK + BLOCK])


def _geo_tags(window: Window, palette: str, is_first: bool) -> list[Tag]:
    """List the tags of GeoTIFF and of GDAL; overviews need none but what says where nothing was seen."""
    level = window.level
    outline = level.box(window.left, window.top, window.left + window.width, window.top + window.height)
    keys = _GEO_KEYS if level.epsg == WGS84 else (*_PROJECTED_KEYS[:15], level.epsg, *_PROJECTED_KEYS[15:])
    place: list[Tag] = [
        (33550, "d", (*level.step_deg, 0.0)),  # ModelPixelScale
        (33922, "d", (0.0, 0.0, 0.0, outline.west, outline.north, 0.0)),  # ModelTiepoint
        (34735, "H", keys),  # GeoKeyDirectory
    ]
    units: list[Tag] = [] if palette else [(42112, "s", _GDAL_METADATA)]
    nothing: list[Tag] = [] if palette else [(42113, "s", "0")]  # GDAL_NODATA
    return [*place, *units, *nothing] if is_first else nothing


def _overlay(level: Level, key: tuple[int, int], max_sigma_m: float) -> NDArray[np.uint8]:
    size = _OVERLAY * BLOCK
    height, width = (min(size, whole - part * size) for whole, part in ((level.height, key[1]), (level.width, key[0])))
    drawn = np.zeros((size, size, 2), dtype=np.uint8)
    for row in range(_OVERLAY):
        for column in range(_OVERLAY):
            block = level.bytes_of((key[0] * _OVERLAY + column, key[1] * _OVERLAY + row), max_sigma_m)
            if block is not None:
                drawn[row * BLOCK : (row + 1) * BLOCK, column * BLOCK : (column + 1) * BLOCK] = block
    return coloured(drawn[:height, :width])


def _ground_overlay(level: Level, key: tuple[int, int], shape: tuple[int, ...], inside: str, number: int) -> str:
    left, top = (part * _OVERLAY * BLOCK for part in key)
    west, south, east, north = level.box(left, top, left + shape[1], top + shape[0])
    sides = f"<north>{north:.10f}</north><south>{south:.10f}</south><east>{east:.10f}</east><west>{west:.10f}</west>"
    lod = _FROM_PIXELS if number else 0
    return (
        f"<GroundOverlay><name>{level.resolution_m:g} m, {key[0]} {key[1]}</name>"
        f"<Region><LatLonAltBox>{sides}</LatLonAltBox><Lod><minLodPixels>{lod}</minLodPixels></Lod></Region>"
        f"<drawOrder>{number}</drawOrder><Icon><href>{inside}</href></Icon>"
        f"<LatLonBox>{sides}</LatLonBox></GroundOverlay>\n"
    )


@contextmanager
def replaced_file(path: Path) -> Iterator[Path]:
    """Write a file under another name that takes the place of `path` once it is whole. Raises OSError."""
    temporary = path.with_name(f".{secrets.token_hex(8)}.new")
    try:
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
        yield temporary
        os.replace(temporary, path)
    except BaseException as error:
        with suppress(OSError):
            temporary.unlink()
        if isinstance(error, OSError) and error.strerror:
            raise OSError(error.errno, error.strerror, str(path)) from error  # of the file that is meant
        raise
