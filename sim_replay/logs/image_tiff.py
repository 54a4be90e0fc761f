"""Read lines of pixels from a TIFF, one row of strips or tiles at a time: headers by tifffile, pieces under a limit."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
import tifffile

from auv_mcm.clean_text import clean
from auv_mcm.errors import BadInputError
from auv_mcm.safe_files import open_regular
from sim_replay.logs.image_stored import (
    MAX_WHOLE_BYTES,
    DamagedPixelsError,
    Rows,
    Stored,
    inflate,
    parsing,
    require_size,
    unpack_bits,
)

_UNPACKED_BY: Final[dict[int, Callable[[bytes, int], bytes]]] = {
    1: lambda data, max_bytes: data,  # none (TIFF 6.0)
    8: inflate,  # Adobe's deflate (TIFF Technical Note 3)
    32946: inflate,  # deflate as first written
    32773: unpack_bits,  # PackBits (TIFF 6.0)
}

logging.getLogger("tifffile").disabled = True  # it writes lines with what a damaged file holds, and raises besides

_ORIENTATION: Final = 274  # tag; 1, as usual: the first row is at the top, the first column at the left (TIFF 6.0)
_NO_DATA: Final = 42113  # tag: the number of pixels that hold nothing, as text (GDAL's GeoTIFF driver)
_REMEDY: Final = "Write it without compression or with deflate: gdal_translate -co COMPRESS=DEFLATE IN.tif OUT.tif"


def open_tiff(path: Path) -> Stored:
    """Open a TIFF. Raises BadInputError for one that is damaged, cut off or no grey picture of plain numbers."""
    with (
        parsing(path, "is not a readable TIFF", "Fetch or export it again."),
        open_regular(path) as opened,
        tifffile.TiffFile(opened) as file,
    ):
        page: Any = file.pages.first
        size = os.fstat(opened.fileno()).st_size
        _require_grey(path, page)
        _require_whole(path, page, size)
        require_size(path, page.shape, page.dtype.itemsize, size)
        n_rows, n_columns = page.shape
        tags = dict(page.geotiff_tags or {})
        no_data = float(page.tags.valueof(_NO_DATA, default="nan").strip("\0 "))
        if page.is_memmappable:
            offset, dtype = page.dataoffsets[0], page.dtype.newbyteorder(file.byteorder)
            plain = np.memmap(opened, dtype, "r", offset, page.shape)
            return Stored(
                n_rows, n_columns, page.dtype, lambda first, stop: np.asarray(plain[first:stop]), tags, no_data
            )
        return Stored(n_rows, n_columns, page.dtype, _Bands(path, page).read, tags, no_data)


def _require_grey(path: Path, page: Any) -> None:
    if len(page.shape) != 2 or page.dtype is None or page.samplesperpixel != 1:
        raise BadInputError(
            f"{path} is a colour picture ({page.samplesperpixel} values a pixel): colours hold no echo strength. "
            "Export the numbers before the colour map, one value a pixel."
        )
    if page.photometric == tifffile.PHOTOMETRIC.PALETTE:
        raise BadInputError(f"{path} is a colour picture (palette). Export the numbers before the colour map.")
    if int(page.photometric) == 0 and page.dtype.kind in "uib":  # white is zero
        raise BadInputError(f"{path} stores white as zero, a scanned drawing's way. Export it with black as zero.")
    if page.tags.valueof(_ORIENTATION, default=1) != 1:
        raise BadInputError(
            f"{path} is stored turned or mirrored (its tag Orientation), so that its edges are not where programs show "
            "them. Export it upright, the first row at the top and the first column at the left."
        )
    if page.bitspersample != 8 * page.dtype.itemsize:
        raise BadInputError(f"{path} packs {page.bitspersample} bits a pixel. Export 8, 16 or 32 bits a pixel.")


def _require_whole(path: Path, page: Any, size: int) -> None:
    offsets, counts = page.dataoffsets, page.databytecounts
    if len(offsets) != len(counts):
        raise BadInputError(
            f"{path} is damaged: its header names {len(offsets)} pieces and the lengths of {len(counts)}. Copy or "
            "export it again."
        )
    ends = [offset + count for offset, count in zip(offsets, counts, strict=True) if count]
    if not ends or max(ends) > size:
        raise BadInputError(
            f"{path} is cut off: its pixels reach to byte {max(ends, default=0)}, the file ends at {size}. "
            "Copy or export it again."
        )


class _Bands:
    """Unpack a TIFF one row of strips or tiles at a time, and keep the newest."""

    def __init__(self, path: Path, page: Any) -> None:
        """Unpack the first piece. Raises BadInputError where that is impossible or takes too much memory."""
        n_rows, n_columns = page.shape
        self._height = int(page.tilelength if page.is_tiled else min(page.rowsperstrip, n_rows))
        self._width = int(page.tilewidth if page.is_tiled else n_columns)
        if min(self._height, self._width) < 1:
            raise BadInputError(f"{path} is damaged: its pieces have no size. Copy or export it again.")
        if self._height * max(self._width, n_columns) * page.dtype.itemsize > MAX_WHOLE_BYTES:
            raise BadInputError(
                f"{path} is stored in pieces of {self._height} rows, which take more than "
                f"{MAX_WHOLE_BYTES >> 20} MiB each to unpack. Write it without compression or in tiles."
            )
        self._path, self._page = path, page
        name = getattr(page.compression, "name", str(page.compression)).lower()
        unpack = _UNPACKED_BY.get(page.compression)
        if unpack is None or page.fillorder != 1:
            why = f"{name} is not read" if unpack is None else "its bits are stored lowest first"
            raise BadInputError(f"{path} cannot be unpacked ({why}). {_REMEDY}")
        self._unpack = unpack
        page.compression = tifffile.COMPRESSION.NONE  # what page.decode gets is unpacked
        self._across = -(-n_columns // self._width)
        self._held, self._rows = -1, np.empty((0, 0))
        try:
            self._band(0)
        except DamagedPixelsError as error:
            raise BadInputError(f"{path} cannot be unpacked ({name}: {error}). {_REMEDY}") from error

    def read(self, first: int, stop: int) -> Rows:
        """Read rows [first, stop)."""
        bands = range(first // self._height, -(-stop // self._height))
        rows = np.concatenate([self._band(number) for number in bands])
        start = first - bands.start * self._height
        return rows[start : start + stop - first]

    def _band(self, number: int) -> Rows:
        if number == self._held:
            return self._rows
        n_rows, n_columns = self._page.shape
        self._held, self._rows = -1, np.empty((0, 0))  # never two in memory
        rows = np.zeros((min(self._height, n_rows - number * self._height), n_columns), self._page.dtype)
        try:
            with open_regular(self._path) as file:
                for place in range(self._across):
                    index = number * self._across + place
                    file.seek(self._page.dataoffsets[index])
                    packed = file.read(self._page.databytecounts[index])
                    self._piece(packed, index, rows[:, place * self._width : (place + 1) * self._width])
        except Exception as error:  # of the package, which raises whatever damage leads to
            raise DamagedPixelsError(
                f"rows from {number * self._height} on cannot be unpacked ({clean(str(error))})"
            ) from error
        self._held, self._rows = number, rows
        return rows

    def _piece(self, packed: bytes, index: int, part: Rows) -> None:
        """Unpack one strip or tile into its part of the band."""
        unpacked = self._unpack(packed, self._height * self._width * self._page.dtype.itemsize)
        piece, _, _ = self._page.decode(unpacked, index)
        part[:] = piece.reshape(piece.shape[-3:-1])[: part.shape[0], : part.shape[1]]
