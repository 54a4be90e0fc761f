"""Read lines of pixels from an HDF5 or NetCDF-4 file through h5py, its packed chunks under a limit.

Its library opens whatever a file names as its storage, and unpacks deflate without end: both are looked at first.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import h5py
import numpy as np

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
)

# Filters of the HDF5 specification, IV.A.2.l
_DEFLATE, _SHUFFLE, _FLETCHER32 = 1, 2, 3
_PACKING: Final = ((("scale_factor",), 1.0), (("add_offset",), 0.0), (("_FillValue", "missing_value"), np.nan))
_CHECKSUM_BYTES: Final = 4  # of fletcher32
_NAMED: Final = 20  # planes that a message names at most


def open_hdf5(path: Path, dataset: str | None) -> Stored:
    """Open a plane of an HDF5 file, by name where the file holds several.

    Raises BadInputError for a file that is damaged, and for a plane whose pixels lie in another file or cannot be
    unpacked in bounded memory.
    """
    with parsing(path, "is not a readable HDF5 file", "Copy or export it again."):
        with open_regular(path) as opened:
            size = os.fstat(opened.fileno()).st_size
            file = h5py.File(f"/dev/fd/{opened.fileno()}", "r")  # the file that was looked at, not its name again
        data = file[_plane(path, file, dataset)]
        _require_own_pixels(path, data)
        require_size(path, data.shape, data.dtype.itemsize, size)
        check = _chunk_check(path, data)
        n_rows, n_columns = data.shape
        dtype = data.dtype
        # Attributes of packed numbers (NetCDF User's Guide, appendix A)
        scale, offset, no_data = (
            float(np.ravel(next((data.attrs[name] for name in names if name in data.attrs), usual))[0])
            for names, usual in _PACKING
        )

    def read(first: int, stop: int) -> Rows:
        try:
            check(first, stop)
            return np.asarray(data[first:stop])
        except Exception as error:  # of the library: several kinds, by what is damaged
            raise DamagedPixelsError(f"rows {first} to {stop} cannot be unpacked ({clean(str(error))})") from error

    return Stored(n_rows, n_columns, dtype, read, {}, no_data, scale, offset)


def _plane(path: Path, file: Any, dataset: str | None) -> str:
    """Name the data set that holds the image; links out of the file are not followed."""
    planes: list[str] = []
    file.visititems(
        lambda name, item: planes.append(name) if isinstance(item, h5py.Dataset) and item.ndim == 2 else None
    )
    wanted = dataset.strip("/") if dataset is not None else planes[0] if len(planes) == 1 else None
    if wanted in planes:
        return wanted
    names = ", ".join(map(clean, planes[:_NAMED])) + (f" and {len(planes) - _NAMED} more" * (len(planes) > _NAMED))
    raise BadInputError(f"{path}: name the image in it by `dataset` in the sidecar; it holds {names or 'no plane'}.")


def _require_own_pixels(path: Path, data: Any) -> None:
    """Refuse pixels that lie in other files: HDF5 opens those whatever they are, pipes and devices too."""
    if data.is_virtual or data.external:
        raise BadInputError(
            f"{path}: the pixels of {clean(data.name)} lie in other files ("
            f"{'a virtual data set' if data.is_virtual else 'external storage'}), which are not opened. Copy them into "
            "one file: h5repack -l CONTI IN.h5 OUT.h5"
        )


def _chunk_check(path: Path, data: Any) -> Callable[[int, int], None]:
    """Return what raises ValueError where a chunk of rows [first, stop) unpacks to more than its size.

    Raises BadInputError for chunks that are too large, or packed otherwise than by deflate.
    """
    if data.chunks is None:
        return lambda first, stop: None
    height, width = data.chunks
    chunk_bytes = height * width * data.dtype.itemsize
    if chunk_bytes > MAX_WHOLE_BYTES:
        raise BadInputError(
            f"{path} is stored in chunks of {height} x {width} pixels, more than the {MAX_WHOLE_BYTES >> 20} MiB that "
            "are unpacked at once. Write it in smaller ones: h5repack -l CHUNK=256x256 IN.h5 OUT.h5"
        )
    created = data.id.get_create_plist()
    filters = [created.get_filter(place)[0] for place in range(created.get_nfilters())]
    packed_at = filters.index(_DEFLATE) if _DEFLATE in filters else len(filters)
    if not {*filters[:packed_at]} <= {_SHUFFLE, _FLETCHER32} or not {*filters[packed_at + 1 :]} <= {_FLETCHER32}:
        raise BadInputError(
            f"{path} is packed by other filters than deflate ({', '.join(map(str, filters))}), whose memory is not "
            "bounded. Write it with deflate: h5repack -f GZIP=4 IN.h5 OUT.h5"
        )
    most_bytes = chunk_bytes + _CHECKSUM_BYTES * filters.count(_FLETCHER32)
    checked: set[tuple[int, int]] = set()

    def check(first: int, stop: int) -> None:
        for top in range(first - first % height, stop, height):
            for left in range(0, data.shape[1], width):
                if packed_at == len(filters) or (top, left) in checked:
                    continue
                try:
                    skipped, packed = data.id.read_direct_chunk((top, left))
                except (OSError, RuntimeError, ValueError):
                    continue  # not stored: the library fills it, or refuses to read it
                if not skipped >> packed_at & 1 and len(inflate(packed, most_bytes + 1)) > most_bytes:
                    raise ValueError(f"the chunk at {top}, {left} unpacks to more than its {chunk_bytes} bytes")
                checked.add((top, left))

    return check
