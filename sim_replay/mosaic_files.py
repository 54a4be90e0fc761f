"""Write a mosaic as a GeoTIFF with overviews and as a KMZ ground overlay, a block at a time."""

from __future__ import annotations

import math
import os
import secrets
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final
from xml.sax.saxutils import escape

import cv2
import numpy as np
from numpy.typing import NDArray

from auv_mcm.clean_text import clean
from auv_mcm.contacts.contact_picture import COLOURS, FLOOR_DB, LEVELS, encoded
from auv_mcm.errors import UsageError
from sim_replay.mosaic import BLOCK, ECHO_STEP_DB, SIGMA_STEP_M, Level

MAX_SIDE: Final = 1 << 20
"""Pixels along a side of a GeoTIFF: the table of its tiles takes 16 bytes for each 256 by 256 of them, 270 MB then."""
_MAX_TILES: Final = 1 << 22  # of a GeoTIFF, for the same reason: 64 MB of the file where nothing was seen
_OVERLAY: Final = 4  # blocks along a side of a picture of the KMZ: 1024 pixels, which every viewer takes
_FROM_PIXELS: Final = 512  # pixels on the screen, from which the pictures of the next finer level are shown
_COMPRESSION: Final = 6  # of zlib; 9 takes far longer for the same size, since speckle hardly repeats

# GeoTIFF 1.1 (OGC 19-008): keys of a geographic model, WGS 84 (EPSG 4326), degrees (EPSG 9102), pixels as areas.
_GEO_KEYS: Final = (1, 1, 1, 4, 1024, 0, 1, 2, 1025, 0, 1, 1, 2048, 0, 1, 4326, 2054, 0, 1, 9102)
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


def write_geotiff(path: Path, levels: Sequence[Level], max_sigma_m: float = math.inf) -> None:
    """Write the mosaic and its overviews as a tiled, compressed GeoTIFF in longitude and latitude (WGS 84).

    Band 1 is the echo over the sea floor around it in dB, band 2 the 1-sigma error of position in m; both are bytes
    with scale and offset, 0 where nothing was seen. max_sigma_m: what is placed worse than this is left out.

    Raises OSError, and UsageError for a mosaic that is too large.
    """
    import tifffile  # bench extra

    first = levels[0]
    n_tiles = (first.width // BLOCK) * (first.height // BLOCK)
    if max(first.width, first.height) > MAX_SIDE or n_tiles > _MAX_TILES:
        raise UsageError(
            f"the mosaic would have {first.width} x {first.height} pixels of {first.resolution_m:g} m. Choose a "
            "coarser --resolution, or export logs of distant sites apart."
        )
    with replaced_file(path) as temporary, tifffile.TiffWriter(temporary, bigtiff=True) as file:
        for number, level in enumerate(levels):
            file.write(
                _tiles(level, max_sigma_m),
                shape=(level.height, level.width, 2),
                dtype=np.uint8,
                tile=(BLOCK, BLOCK),
                photometric="minisblack",
                planarconfig="contig",
                extrasamples=["unspecified"],
                compression="deflate",
                subfiletype=1 if number else 0,
                metadata=None,
                software=False,
                extratags=_geo_tags(level) if number == 0 else [],
            )


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
            f"<name>{escape(clean(name))}</name>\n{''.join(overlays)}{''.join(folders)}</Document>\n</kml>\n"
        )
        file.writestr("doc.kml", text, zipfile.ZIP_DEFLATED)


def coloured(drawn: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Colour bytes of echo as the waterfall is: (n, m, 4) uint8 blue, green, red, opacity."""
    level = np.ceil(drawn[..., 0] * (LEVELS / 255.0)).astype(np.uint8)
    opacity = np.where(level > 0, np.uint8(255), np.uint8(0))[..., np.newaxis]
    return np.ascontiguousarray(np.concatenate([np.where(opacity > 0, COLOURS[level], np.uint8(0)), opacity], axis=-1))


def _tiles(level: Level, max_sigma_m: float) -> Iterator[bytes]:
    """Yield compressed tiles, row by row; empty ones, which a GeoTIFF may have where there is nothing, are b""."""
    for row in range(-(-level.height // BLOCK)):
        for column in range(-(-level.width // BLOCK)):
            drawn = level.bytes_of((column, row), max_sigma_m)
            yield b"" if drawn is None or not drawn.any() else zlib.compress(drawn.tobytes(), _COMPRESSION)


def _geo_tags(level: Level) -> list[tuple[int, str, int, object, bool]]:
    """List the tags of GeoTIFF and of GDAL: number, type, count, value, only on the first page."""
    return [
        (33550, "d", 3, (*level.step_deg, 0.0), True),  # ModelPixelScale
        (33922, "d", 6, (0.0, 0.0, 0.0, level.west_deg, level.north_deg, 0.0), True),  # ModelTiepoint
        (34735, "H", len(_GEO_KEYS), _GEO_KEYS, True),  # GeoKeyDirectory
        (42112, "s", 0, _GDAL_METADATA, True),  # GDAL_METADATA
        (42113, "s", 0, "0", True),  # GDAL_NODATA
    ]


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
    except BaseException:
        with suppress(OSError):
            temporary.unlink()
        raise
