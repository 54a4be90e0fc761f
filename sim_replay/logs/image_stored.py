"""Bound what a sonar image may cost before a pixel of it is decoded, and name the file in what its parser raises."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.clean_text import clean
from auv_mcm.errors import BadInputError

MAX_WHOLE_BYTES: Final = 1 << 28  # decoded at once: bounds memory where a file cannot be read in parts
_MIN_PIXELS: Final = 16  # along either axis: fewer hold neither an object nor the sea floor around it
_MAX_LINE_PIXELS: Final = 1 << 17  # of a line: chosen, 655 m in pixels of 5 mm; bounds memory at some lines
_MAX_LINES: Final = 1 << 22  # chosen, 100 km in pixels of 25 mm; bounds the memory of the track at 130 MB
_DEFLATE_RATIO: Final = 1032  # bytes that deflate packs into one at most (zlib's technical details)

Rows = NDArray[Any]


class Stored(NamedTuple):
    """Hold an image as stored; read gives rows [first, stop), and raises DamagedPixelsError.

    no_data: what a pixel without a measurement holds, NaN where nothing else does. scale, offset: of packed numbers.
    """

    n_rows: int
    n_columns: int
    dtype: np.dtype[Any]
    read: Callable[[int, int], Rows]
    geo_tags: dict[str, Any]
    no_data: float = math.nan
    scale: float = 1.0
    offset: float = 0.0

    def measured(self, rows: Rows) -> Rows:
        """Unpack rows that were read, NaN where nothing was measured."""
        if (self.scale, self.offset) == (1.0, 0.0) and math.isnan(self.no_data):
            return rows
        unpacked = rows.astype(np.result_type(rows.dtype, np.float32)) * self.scale + self.offset
        return np.where(rows == self.no_data, np.nan, unpacked)


class DamagedPixelsError(Exception):
    """Signal lines that cannot be decoded."""


@contextmanager
def parsing(path: Path, what: str, remedy: str) -> Iterator[None]:
    """Turn whatever a parser of another package raises into BadInputError: a damaged file leads it anywhere.

    Parameters
    ----------
    path
        The file that is parsed.
    what
        What it then is, such as 'is not a readable TIFF'.
    remedy
        What to do, a sentence.
    """
    try:
        yield
    except BadInputError:
        raise
    except Exception as error:
        raise BadInputError(f"{path} {what}: {clean(str(error)) or type(error).__name__}. {remedy}") from error


def require_size(path: Path, shape: tuple[int, ...], itemsize: int, file_bytes: int) -> None:
    """Refuse by its header an image that is no plane, too small, too large, or more than its file can hold.

    Raises BadInputError.
    """
    if len(shape) != 2:
        raise BadInputError(f"{path} holds an array of {len(shape)} dimensions, an image has two. Save one plane.")
    n_rows, n_columns = shape
    size = f"{path} has {n_columns} x {n_rows} pixels"
    if min(shape) < _MIN_PIXELS:
        raise BadInputError(
            f"{size}; at least {_MIN_PIXELS} x {_MIN_PIXELS} are needed to see an object on the sea floor. Export the "
            "whole image, not a thumbnail or a cut."
        )
    if max(shape) > _MAX_LINES or min(shape) > _MAX_LINE_PIXELS:
        raise BadInputError(f"{size}; at most {_MAX_LINES} lines of {_MAX_LINE_PIXELS} are read. Export it in parts.")
    if n_rows * n_columns * itemsize > _DEFLATE_RATIO * file_bytes:
        raise BadInputError(
            f"{size}, more than its {file_bytes} bytes can hold: its header is damaged, or most of it was never "
            "written. Copy or export it again."
        )


def inflate(packed: bytes, max_bytes: int) -> bytes:
    """Unpack deflate up to a number of bytes; what goes beyond is left packed. Raises zlib.error and ValueError."""
    stream = zlib.decompressobj()
    unpacked = stream.decompress(packed, max_bytes)
    if not stream.eof and len(unpacked) < max_bytes:
        raise ValueError(f"the packed bytes end after {len(unpacked)} of {max_bytes}")
    return unpacked


def unpack_bits(packed: bytes, max_bytes: int) -> bytes:
    """Unpack PackBits (TIFF 6.0, section 9) up to a number of bytes; what goes beyond is left packed."""
    unpacked, at = bytearray(), 0
    while at < len(packed) and len(unpacked) < max_bytes:
        n = packed[at]
        if n < 128:
            unpacked += packed[at + 1 : at + 2 + n]
            at += 2 + n
        else:
            unpacked += packed[at + 1 : at + 2] * (257 - n if n > 128 else 0)
            at += 2 if n > 128 else 1
    return bytes(unpacked[:max_bytes])
