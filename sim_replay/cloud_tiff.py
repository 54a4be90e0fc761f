"""Write a cloud-optimised BigTIFF: all directories first, then pixels, the coarsest overview first.

A reader that fetches parts of a file over a network (OGC 21-026) finds the directories in its first request, and the
picture of the whole area in its second.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO, Final, NamedTuple

from sim_replay.mosaic import BLOCK

_LAYOUT: Final = (
    b"LAYOUT=IFDS_BEFORE_DATA\nBLOCK_ORDER=ROW_MAJOR\nBLOCK_LEADER=SIZE_AS_UINT4\n"
    b"BLOCK_TRAILER=LAST_4_BYTES_REPEATED\nKNOWN_INCOMPATIBLE_EDITION=NO\n "
)
_NOTE: Final = b"GDAL_STRUCTURAL_METADATA_SIZE=%06d bytes\n%s" % (len(_LAYOUT), _LAYOUT)
"""What GDAL recognises the layout by, right after the header."""
_HEADER: Final = struct.Struct("<2sHHHQ")  # byte order, version, bytes of an offset, 0, first directory
_BIG_TIFF: Final = 43  # version of the format whose offsets have 8 bytes
_TYPES: Final = {"s": (2, 1), "H": (3, 2), "d": (12, 8), "Q": (16, 8)}  # code and bytes of a value, by the standard

Tag = tuple[int, str, Sequence[float] | str]
"""Number, type as of `struct` ("s" for text), values."""


class Page(NamedTuple):
    """Hold a picture of the file: its size in pixels, its tags beyond those of any tiled picture, and its tiles.

    tiles: row by row, compressed by deflate; b"" for one in which nothing was seen.
    """

    width: int
    height: int
    bands: int
    is_rgb: bool
    tags: Sequence[Tag]
    tiles: Iterator[bytes]


def write_cloud_tiff(path: Path, pages: Sequence[Page]) -> None:
    """Write the picture and its overviews, the finest first. Raises OSError."""
    places = [_HEADER.size + len(_NOTE) + -(_HEADER.size + len(_NOTE)) % 8]
    for number, page in enumerate(pages):
        nothing = [0] * _n_tiles(page)
        places.append(places[-1] + len(_directory(page, number, places[-1], 0, nothing, nothing)))
    with open(path, "wb") as file:
        end = file.write(b"\0" * places[-1])
        written: dict[int, tuple[list[int], list[int]]] = {}
        for number in reversed(range(len(pages))):
            offsets, lengths, end = _write_tiles(file, pages[number].tiles, end)
            written[number] = offsets, lengths
        file.seek(0)
        file.write(_HEADER.pack(b"II", _BIG_TIFF, 8, 0, places[0]) + _NOTE)
        for number, page in enumerate(pages):
            file.seek(places[number])
            following = 0 if number + 1 == len(pages) else places[number + 1]
            file.write(_directory(page, number, places[number], following, *written[number]))


def _n_tiles(page: Page) -> int:
    return -(-page.width // BLOCK) * -(-page.height // BLOCK)


def _write_tiles(file: IO[bytes], tiles: Iterator[bytes], end: int) -> tuple[list[int], list[int], int]:
    """Append tiles between their length and their last 4 bytes.

    Returns offsets and lengths, both 0 for an empty one, and the new end of the file.
    """
    offsets, lengths = [], []
    for tile in tiles:
        offsets.append(end + 4 if tile else 0)
        lengths.append(len(tile))
        if tile:
            end += file.write(struct.pack("<I", len(tile)) + tile + tile[-4:])
    return offsets, lengths, end


def _directory(
    page: Page, number: int, place: int, following: int, offsets: Sequence[int], lengths: Sequence[int]
) -> bytes:
    """Lay out a directory at `place`, with the values that do not fit into its entries right behind it."""
    tags: list[Tag] = [
        (254, "H", [1 if number else 0]),  # NewSubfileType: an overview
        (256, "Q", [page.width]),
        (257, "Q", [page.height]),
        (258, "H", [8] * page.bands),  # BitsPerSample
        (259, "H", [8]),  # Compression: deflate
        (262, "H", [2 if page.is_rgb else 1]),  # PhotometricInterpretation
        (277, "H", [page.bands]),
        (284, "H", [1]),  # PlanarConfiguration: bands of a pixel lie together
        (322, "H", [BLOCK]),
        (323, "H", [BLOCK]),
        (324, "Q", offsets),
        (325, "Q", lengths),
        (338, "H", [2 if page.is_rgb else 0]),  # ExtraSamples: opacity, or a figure
        *page.tags,
    ]
    entries, values = b"", b""
    behind = place + 8 + 20 * len(tags) + 8
    for tag, kind, data in sorted(tags, key=lambda each: each[0]):
        code, _ = _TYPES[kind]
        packed = data.encode() + b"\0" if isinstance(data, str) else struct.pack(f"<{len(data)}{kind}", *data)
        count = len(packed) // _TYPES[kind][1]
        if len(packed) > 8:
            held = struct.pack("<Q", behind + len(values))
            values += packed + b"\0" * (-len(packed) % 8)
        else:
            held = packed.ljust(8, b"\0")
        entries += struct.pack("<HHQ", tag, code, count) + held
    whole = struct.pack("<Q", len(tags)) + entries + struct.pack("<Q", following) + values
    return whole + b"\0" * (-len(whole) % 8)
