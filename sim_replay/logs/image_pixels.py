"""Read lines of pixels from image files, a few at a time.

TIFF through tifffile, PNG through OpenCV, complex images from npy files (numpy) and HDF5 or NetCDF-4 files (h5py).
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.errors import BadInputError
from sim_replay.logs.image_sidecar import Sidecar

MIN_PIXELS: Final = 16  # along either axis: fewer hold neither an object nor the sea floor around it
_MAX_WHOLE_BYTES: Final = 1 << 28  # decoded at once: bounds memory where a file cannot be read in parts
_PNG_SIZE: Final = struct.Struct(">8x8xIIBB")  # width, height, bits and colour type in the first chunk (PNG, 11.2.1)
_PNG_GREY: Final = 0  # colour type
_NO_COMPRESSION: Final = 1  # of TIFF 6.0

Rows = NDArray[Any]


class Pixels(NamedTuple):
    """Hold how to read an image of n_lines lines of n_pixels, near to far, in the order in which they were recorded.

    read: lines [first, stop) as (stop - first, n_pixels) of any real or complex dtype; it raises DamagedPixelsError.
    geo_tags: of a GeoTIFF, else empty.
    """

    n_lines: int
    n_pixels: int
    read: Callable[[int, int], Rows]
    geo_tags: dict[str, Any]


class DamagedPixelsError(Exception):
    """Signal lines that cannot be decoded."""


class _Stored(NamedTuple):
    """Hold an image as stored; read gives rows [first, stop)."""

    n_rows: int
    n_columns: int
    dtype: np.dtype[Any]
    read: Callable[[int, int], Rows]
    geo_tags: dict[str, Any]


def open_pixels(path: Path, kind: str, sidecar: Sidecar) -> Pixels:
    """Open an image of kind tiff, png, npy or hdf5.

    Raises BadInputError for one that is damaged, has colours, signed or no numbers, or is too small to hold anything.
    """
    opener = {"tiff": _open_tiff, "png": _open_png, "npy": _open_npy, "hdf5": _open_hdf5}[kind]
    stored = opener(path, sidecar)
    _require_numbers(path, stored, sidecar)
    if min(stored.n_rows, stored.n_columns) < MIN_PIXELS:
        raise BadInputError(
            f"{path} has {stored.n_columns} x {stored.n_rows} pixels; at least {MIN_PIXELS} x {MIN_PIXELS} are needed "
            "to see an object on the sea floor. Export the whole image, not a thumbnail or a cut."
        )
    return _turned(path, stored, sidecar)


def _require_numbers(path: Path, stored: _Stored, sidecar: Sidecar) -> None:
    kind = stored.dtype.kind
    if (kind == "c") != (sidecar.samples == "complex"):
        what = "complex" if kind == "c" else str(stored.dtype)
        raise BadInputError(
            f"{path} holds {what} numbers, but its sidecar says `samples: {sidecar.samples}`. Write what they are."
        )
    if kind == "i" and sidecar.samples != "log":
        raise BadInputError(
            f"{path} holds signed integers ({stored.dtype}), and an {sidecar.samples} is never negative: half of its "
            "numbers would be lost. Export unsigned integers or float32, or write `samples: log` with `db_per_count` "
            "if these are decibels."
        )
    if kind not in "iufc":
        raise BadInputError(f"{path} holds numbers of type {stored.dtype}. Export integers, float32 or complex64.")


def _turned(path: Path, stored: _Stored, sidecar: Sidecar) -> Pixels:
    """Lay lines along rows, near to far, first recorded first."""
    read, n_lines, n_pixels = stored.read, stored.n_rows, stored.n_columns
    if sidecar.near_edge in ("top", "bottom"):
        if stored.n_rows * stored.n_columns * stored.dtype.itemsize > _MAX_WHOLE_BYTES:
            raise BadInputError(
                f"{path}: lines run down the picture (`near_edge: {sidecar.near_edge}`), and it is too large to turn "
                "in memory. Turn it by 90 degrees and write `near_edge: left` or `right`."
            )
        read, n_lines, n_pixels = _columns_of(stored), stored.n_columns, stored.n_rows
    backward, far_first = sidecar.lines == "backward", sidecar.near_edge in ("right", "bottom")

    def lines(first: int, stop: int) -> Rows:
        rows = read(n_lines - stop, n_lines - first)[::-1] if backward else read(first, stop)
        return rows[:, ::-1] if far_first else rows

    return Pixels(n_lines, n_pixels, lines, stored.geo_tags)


def _columns_of(stored: _Stored) -> Callable[[int, int], Rows]:
    whole: list[Rows] = []

    def columns(first: int, stop: int) -> Rows:
        if not whole:
            whole.append(stored.read(0, stored.n_rows))
        return whole[0][:, first:stop].T

    return columns


# --- files ---


def _open_tiff(path: Path, sidecar: Sidecar) -> _Stored:
    import tifffile

    try:
        with tifffile.TiffFile(path) as file:
            page = file.pages.first
            shape, dtype, tags = page.shape, page.dtype, dict(page.geotiff_tags or {})
    except Exception as error:  # the package raises whatever a damaged header leads to
        raise BadInputError(f"{path} is not a readable TIFF: {error}. Fetch or export it again.") from error
    if len(shape) != 2 or dtype is None or page.samplesperpixel != 1:
        raise BadInputError(
            f"{path} is a colour picture ({page.samplesperpixel} values a pixel): colours hold no echo strength. "
            "Export the numbers before the colour map, one value a pixel."
        )
    if page.photometric == tifffile.PHOTOMETRIC.PALETTE:
        raise BadInputError(f"{path} is a colour picture (palette). Export the numbers before the colour map.")
    ends = [offset + count for offset, count in zip(page.dataoffsets, page.databytecounts, strict=True) if count]
    size = path.stat().st_size
    if not ends or max(ends) > size:
        raise BadInputError(
            f"{path} is cut off: its pixels reach to byte {max(ends, default=0)}, the file ends at {size}. "
            "Copy or export it again."
        )
    n_rows, n_columns = shape
    bits = int(page.photometric) == 0 and dtype.kind in "uib"  # white is zero
    if bits:
        raise BadInputError(f"{path} stores white as zero, a scanned drawing's way. Export it with black as zero.")
    if page.is_memmappable:
        offset, order = page.dataoffsets[0], page.parent.byteorder
        plain = np.memmap(path, dtype.newbyteorder(order), "r", offset, (n_rows, n_columns))
        return _Stored(n_rows, n_columns, dtype, lambda first, stop: np.asarray(plain[first:stop]), tags)
    height = page.tilelength if page.is_tiled else min(page.rowsperstrip, n_rows)
    width = page.tilewidth if page.is_tiled else n_columns
    if height * n_columns * dtype.itemsize > _MAX_WHOLE_BYTES:
        raise BadInputError(
            f"{path} is compressed in pieces of {height} rows, which take more than "
            f"{_MAX_WHOLE_BYTES >> 20} MiB each to unpack. Write it without compression or in tiles."
        )
    _require_codec(path, page)
    bands = _Bands(path, page, height, width)
    return _Stored(n_rows, n_columns, dtype, bands.read, tags)


def _require_codec(path: Path, page: Any) -> None:
    try:
        page.decode  # noqa: B018 (looks the codec up)
        with open(path, "rb") as file:
            file.seek(page.dataoffsets[0])
            page.decode(file.read(page.databytecounts[0]), 0, jpegtables=page.jpegtables)
    except Exception as error:  # of a missing codec or of damage
        raise BadInputError(
            f"{path} cannot be unpacked ({page.compression.name.lower()}: {error}). Write it without compression or "
            "with deflate: gdal_translate -co COMPRESS=DEFLATE IN.tif OUT.tif"
        ) from error


class _Bands:
    """Unpack a compressed TIFF one row of strips or tiles at a time, and keep the newest."""

    def __init__(self, path: Path, page: Any, height: int, width: int) -> None:
        self._path, self._page, self._height, self._width = path, page, height, width
        self._across = -(-page.shape[1] // width)
        self._held = -1
        self._rows: Rows = np.empty((0, 0))

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
        rows = np.zeros((min(self._height, n_rows - number * self._height), n_columns), self._page.dtype)
        try:
            with open(self._path, "rb") as file:
                for place in range(self._across):
                    index = number * self._across + place
                    file.seek(self._page.dataoffsets[index])
                    data = file.read(self._page.databytecounts[index])
                    piece, _, _ = self._page.decode(data, index, jpegtables=self._page.jpegtables)
                    if piece is not None:
                        flat = piece.reshape(piece.shape[-3:-1])
                        left = place * self._width
                        part = rows[:, left : left + self._width]
                        part[:] = flat[: part.shape[0], : part.shape[1]]
        except Exception as error:  # codecs raise whatever they like
            raise DamagedPixelsError(f"rows from {number * self._height} on cannot be unpacked ({error})") from error
        self._held, self._rows = number, rows
        return rows


def _open_png(path: Path, sidecar: Sidecar) -> _Stored:
    import cv2

    head = path.read_bytes()[: _PNG_SIZE.size]
    if len(head) < _PNG_SIZE.size:
        raise BadInputError(f"{path} ends inside its header ({len(head)} bytes). Copy it again.")
    n_columns, n_rows, bits, colour = _PNG_SIZE.unpack(head)
    if colour != _PNG_GREY:
        raise BadInputError(
            f"{path} is a colour picture: colours hold no echo strength. Export a grey picture of the numbers before "
            "the colour map."
        )
    if n_columns * n_rows * max(bits // 8, 1) > _MAX_WHOLE_BYTES:
        raise BadInputError(
            f"{path} has {n_columns} x {n_rows} pixels, and a PNG cannot be read in parts. Write it as TIFF."
        )
    picture = cv2.imdecode(np.fromfile(path, np.uint8), cv2.IMREAD_UNCHANGED)
    if picture is None or picture.shape != (n_rows, n_columns) or not _png_is_whole(path):
        raise BadInputError(f"{path} is damaged or cut off: its pixels cannot be unpacked. Copy or export it again.")
    return _Stored(n_rows, n_columns, picture.dtype, lambda first, stop: np.asarray(picture[first:stop]), {})


def _png_is_whole(path: Path) -> bool:
    """Check that the file ends with the chunk that ends every PNG; OpenCV fills what is missing with zeros."""
    with path.open("rb") as file:
        file.seek(-min(path.stat().st_size, 64), 2)
        return b"IEND" in file.read()


def _open_npy(path: Path, sidecar: Sidecar) -> _Stored:
    try:
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except (ValueError, OSError, EOFError) as error:
        raise BadInputError(f"{path} cannot be read: {error}. Save one plain array with numpy.save.") from error
    _require_plane(path, array.shape)
    n_rows, n_columns = array.shape
    return _Stored(n_rows, n_columns, array.dtype, lambda first, stop: np.asarray(array[first:stop]), {})


def _open_hdf5(path: Path, sidecar: Sidecar) -> _Stored:
    import h5py

    try:
        file = h5py.File(path, "r")
    except OSError as error:
        raise BadInputError(f"{path} is not a readable HDF5 file: {error}. Copy or export it again.") from error
    planes: list[str] = []
    file.visititems(
        lambda name, item: planes.append(name) if isinstance(item, h5py.Dataset) and item.ndim == 2 else None
    )
    wanted = sidecar.dataset.strip("/") if sidecar.dataset is not None else planes[0] if len(planes) == 1 else None
    if wanted not in planes:
        raise BadInputError(
            f"{path}: name the image in it by `dataset` in the sidecar; it holds {', '.join(planes) or 'no plane'}."
        )
    data = file[wanted]

    def read(first: int, stop: int) -> Rows:
        try:
            return np.asarray(data[first:stop])
        except OSError as error:
            raise DamagedPixelsError(f"rows {first} to {stop} cannot be unpacked ({error})") from error

    n_rows, n_columns = data.shape
    return _Stored(n_rows, n_columns, data.dtype, read, {})


def _require_plane(path: Path, shape: tuple[int, ...]) -> None:
    if len(shape) != 2:
        raise BadInputError(f"{path} holds an array of {len(shape)} dimensions, an image has two. Save one plane.")
