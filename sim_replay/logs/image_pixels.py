"""Read lines of pixels from image files, a few at a time.

TIFF through tifffile, PNG through OpenCV, complex images from npy files (numpy) and HDF5 or NetCDF-4 files (h5py). Each
is opened by `safe_files`, and decoded under a limit that its header states (`image_stored`).
"""

from __future__ import annotations

import os
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO, Final, NamedTuple

import numpy as np
from numpy.lib import format as npy

from auv_mcm.clean_text import clean
from auv_mcm.errors import BadInputError
from auv_mcm.safe_files import open_regular
from sim_replay.logs.image_sidecar import Sidecar
from sim_replay.logs.image_stored import MAX_WHOLE_BYTES, Rows, Stored, parsing, require_size

_PNG_SIGNATURE: Final = b"\x89PNG\r\n\x1a\n"
_PNG_CHUNK: Final = struct.Struct(">I4s")  # length and type (PNG, 5.3)
_PNG_HEADER: Final = struct.Struct(">IIBB")  # width, height, bits and colour type, of the first chunk (PNG, 11.2.1)
_PNG_HEADER_BYTES: Final = 13  # all of that chunk
_PNG_GREY: Final = 0  # colour type
_PNG_KEPT: Final = (b"IHDR", b"IDAT", b"IEND")  # all that a grey picture needs
_CHECKSUM_BYTES: Final = 4  # behind each chunk


class Pixels(NamedTuple):
    """Hold how to read an image of n_lines lines of n_pixels, near to far, in the order in which they were recorded.

    read: lines [first, stop) as (stop - first, n_pixels) of any real or complex dtype; it raises DamagedPixelsError.
    geo_tags: of a GeoTIFF, else empty.
    """

    n_lines: int
    n_pixels: int
    read: Callable[[int, int], Rows]
    geo_tags: dict[str, Any]


def open_pixels(path: Path, kind: str, sidecar: Sidecar) -> Pixels:
    """Open an image of kind tiff, png, npy or hdf5.

    Raises BadInputError for one that is damaged, has colours, signed or no numbers, or is too small to hold anything.
    """
    if kind == "tiff":
        from sim_replay.logs.image_tiff import open_tiff

        stored = open_tiff(path)
    elif kind == "hdf5":
        from sim_replay.logs.image_hdf5 import open_hdf5

        stored = open_hdf5(path, sidecar.dataset)
    else:
        stored = _open_png(path) if kind == "png" else _open_npy(path)
    _require_numbers(path, stored, sidecar)
    return _turned(path, stored, sidecar)


def _require_numbers(path: Path, stored: Stored, sidecar: Sidecar) -> None:
    kind = stored.dtype.kind
    if (kind == "c") != (sidecar.samples == "complex"):
        what = "complex" if kind == "c" else str(stored.dtype)
        raise BadInputError(
            f"{path} holds {what} numbers, but its sidecar says `samples: {sidecar.samples}`. Write what they are."
        )
    if kind == "i" and sidecar.samples != "log" and (stored.scale, stored.offset) == (1.0, 0.0):
        raise BadInputError(
            f"{path} holds signed integers ({stored.dtype}), and an {sidecar.samples} is never negative: half of its "
            "numbers would be lost. Export unsigned integers or float32, or write `samples: log` with `db_per_count` "
            "if these are decibels."
        )
    if kind not in "iufc":
        raise BadInputError(f"{path} holds numbers of type {stored.dtype}. Export integers, float32 or complex64.")


def _turned(path: Path, stored: Stored, sidecar: Sidecar) -> Pixels:
    """Lay lines along rows, near to far, first recorded first."""
    read, n_lines, n_pixels = stored.read, stored.n_rows, stored.n_columns
    if sidecar.near_edge in ("top", "bottom"):
        if stored.n_rows * stored.n_columns * stored.dtype.itemsize > MAX_WHOLE_BYTES:
            raise BadInputError(
                f"{path}: lines run down the picture (`near_edge: {sidecar.near_edge}`), and it is too large to turn "
                "in memory. Turn it by 90 degrees and write `near_edge: left` or `right`."
            )
        read, n_lines, n_pixels = _columns_of(stored), stored.n_columns, stored.n_rows
    backward, far_first = sidecar.lines == "backward", sidecar.near_edge in ("right", "bottom")

    def lines(first: int, stop: int) -> Rows:
        rows = read(n_lines - stop, n_lines - first)[::-1] if backward else read(first, stop)
        return stored.measured(rows[:, ::-1] if far_first else rows)

    return Pixels(n_lines, n_pixels, lines, stored.geo_tags)


def _columns_of(stored: Stored) -> Callable[[int, int], Rows]:
    whole: list[Rows] = []

    def columns(first: int, stop: int) -> Rows:
        if not whole:
            whole.append(stored.read(0, stored.n_rows))
        return whole[0][:, first:stop].T

    return columns


# --- files ---


def _open_png(path: Path) -> Stored:
    import cv2

    with open_regular(path) as file, parsing(path, "is not a readable PNG", "Copy or export it again."):
        size = os.fstat(file.fileno()).st_size
        head = file.read(len(_PNG_SIGNATURE) + _PNG_CHUNK.size + _PNG_HEADER_BYTES)
        if len(head) < len(_PNG_SIGNATURE) + _PNG_CHUNK.size + _PNG_HEADER_BYTES:
            raise BadInputError(f"{path} ends inside its header ({len(head)} bytes). Copy it again.")
        n_columns, n_rows, bits, colour = _PNG_HEADER.unpack_from(head, len(_PNG_SIGNATURE) + _PNG_CHUNK.size)
        if colour != _PNG_GREY:
            raise BadInputError(
                f"{path} is a colour picture: colours hold no echo strength. Export a grey picture of the numbers "
                "before the colour map."
            )
        itemsize = max(bits // 8, 1)
        require_size(path, (n_rows, n_columns), itemsize, size)
        if n_columns * n_rows * itemsize > MAX_WHOLE_BYTES:
            raise BadInputError(
                f"{path} has {n_columns} x {n_rows} pixels, and a PNG cannot be read in parts. Write it as TIFF."
            )
        picture = cv2.imdecode(np.frombuffer(_png_picture(path, file, size), np.uint8), cv2.IMREAD_UNCHANGED)
        if picture is None or picture.shape != (n_rows, n_columns):
            raise _damaged_png(path, "its pixels cannot be unpacked")
    return Stored(n_rows, n_columns, picture.dtype, lambda first, stop: np.asarray(picture[first:stop]), {})


def _png_picture(path: Path, file: BinaryIO, size: int) -> bytearray:
    """Read of a PNG what makes its picture: a decoder unpacks texts, profiles and animations too, of any length.

    OpenCV fills what is missing with zeros, so that a file without its last chunk is refused here.
    """
    kept, kind = bytearray(_PNG_SIGNATURE), b""
    file.seek(len(_PNG_SIGNATURE))
    while kind != b"IEND":
        at = file.seek(0, os.SEEK_CUR)
        length, kind = (
            _PNG_CHUNK.unpack(head) if len(head := file.read(_PNG_CHUNK.size)) == _PNG_CHUNK.size else (0, b"")
        )
        stop = at + _PNG_CHUNK.size + length + _CHECKSUM_BYTES
        if not kind or stop > size:
            raise _damaged_png(
                path, f"chunk {clean(kind.decode('latin-1'))} at byte {at} reaches to byte {stop} of {size}"
            )
        if len(kept) + length > 2 * MAX_WHOLE_BYTES:
            raise _damaged_png(path, "it holds more packed bytes than pixels")
        if kind in _PNG_KEPT:
            kept += head + file.read(length + _CHECKSUM_BYTES)
        file.seek(stop)
    return kept


def _damaged_png(path: Path, why: str) -> BadInputError:
    return BadInputError(f"{path} is damaged or cut off: {why}. Copy or export it again.")


def _open_npy(path: Path) -> Stored:
    with (
        open_regular(path) as file,
        parsing(path, "cannot be read", "Save one plain array of numbers with numpy.save."),
    ):
        size = os.fstat(file.fileno()).st_size
        version = npy.read_magic(file)
        if version == (1, 0):
            shape, by_columns, dtype = npy.read_array_header_1_0(file)
        else:
            shape, by_columns, dtype = npy.read_array_header_2_0(file)
        require_size(path, shape, dtype.itemsize, size)
        start = file.seek(0, os.SEEK_CUR)
        stop = start + shape[0] * shape[1] * dtype.itemsize
        if stop > size:
            raise BadInputError(
                f"{path} is cut off: its numbers reach to byte {stop}, the file ends at {size}. Copy or "
                "export it again."
            )
        if dtype.kind not in "iufc":
            raise BadInputError(f"{path} holds {dtype}. Save one plain array of numbers with numpy.save.")
        array = np.memmap(file, dtype, "r", start, shape, "F" if by_columns else "C")
    return Stored(shape[0], shape[1], dtype, lambda first, stop: np.asarray(array[first:stop]), {})
