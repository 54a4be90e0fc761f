"""Name files that are no readable log by what they are, and say how to come to one that is.

A row per format: what it is called, how its first bytes begin, and what to do. Layouts are the makers' or of public
readers: SeaBat 7k (Teledyne, "7k Data Format Definition"), EM datagrams (Kongsberg, 850-160692), GSF (SAIC), SEG-Y
(SEG, rev. 2), SLG (opensounder), RSD (PINGVerter).
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Final, NamedTuple

_AS_XTF: Final = "Export it as XTF"
_MULTIBEAM: Final = (
    "It holds what a multibeam recorded: export its side scan as XTF with the maker's software, if there is any"
)
_FETCH: Final = "Fetch the file itself"


class ForeignFormat(NamedTuple):
    """Describe a format that is not read.

    begins: checks a file's first bytes. suffixes: of names, where bytes do not show it. is_image: it begins like a
    sonar image. remedy: what to do, without its full stop.
    """

    title: str
    begins: Callable[[bytes], bool]
    remedy: str
    suffixes: tuple[str, ...] = ()
    is_image: bool = False


def foreign_image(head: bytes) -> ForeignFormat | None:
    """Find what a file is that begins like a sonar image and is none; None for others."""
    return next((row for row in FOREIGN if row.is_image and row.begins(head)), None)


def name_foreign(head: bytes, path: Path) -> ForeignFormat | None:
    """Find what a file is by its first bytes, else by its name; None if neither shows it."""
    found = next((row for row in FOREIGN if row.begins(head)), None)
    suffix = path.suffix.lower()
    return found or next((row for row in FOREIGN if suffix in row.suffixes), None)


def _magic(*firsts: bytes) -> Callable[[bytes], bool]:
    return lambda head: head.startswith(firsts)


def _never(head: bytes) -> bool:
    return False


def _text(*words: bytes) -> Callable[[bytes], bool]:
    """Check for text that begins with one of these words, whatever its case and what stands before it."""
    return lambda head: head[:1024].lstrip(b"\xef\xbb\xbf \t\r\n").lower().startswith(words)


def _office(folder: bytes) -> Callable[[bytes], bool]:
    return lambda head: head.startswith(b"PK\x03\x04") and folder in head


def _number(head: bytes, at: int, form: str) -> int:
    """Unpack a number; -1 beyond the end."""
    size = struct.calcsize(form)
    return int(struct.unpack_from(form, head, at)[0]) if len(head) >= at + size else -1


def _is_s7k(head: bytes) -> bool:
    return 0x0000FFFF in (_number(head, 4, "<I"), _number(head, 4, ">I"))


def _is_em_datagram(head: bytes) -> bool:
    return (
        4 < _number(head, 0, "<I") < 1 << 20
        and head[4:5] == b"\x02"
        and head[5:6] in b"AaCDFGHhIiJjKkNnOPpRrSsUVWX3E1Q"
    )


def _is_gsf(head: bytes) -> bool:
    return b"GSF-v" in head[:64]


def _is_segy(head: bytes) -> bool:
    return len(head) >= 3600 and (
        head[:2] in (b"\xc3\xf1", b"\xc3\x40", b"C1", b"C ") and 0 < _number(head, 3224, ">h") <= 16
    )


def _is_dvs(head: bytes) -> bool:
    if len(head) < 18 or _number(head, 0, "<I") != 1:
        return False
    sample_m, lines_per_s, n_samples = struct.unpack_from("<ffi", head, 4)
    return 1e-3 < sample_m < 1.0 and 0.0 < lines_per_s < 1e3 and 0 < n_samples < 100_000 and max(head[16:18]) <= 1


def _is_mstiff(head: bytes) -> bool:
    return head.startswith(b"MSTL")


def _is_tar(head: bytes) -> bool:
    return head[257:262] == b"ustar"


FOREIGN: Final[tuple[ForeignFormat, ...]] = (
    ForeignFormat(
        "a Git LFS pointer, not the file it stands for",
        _magic(b"version https://git-lfs.github.com"),
        f"{_FETCH}: git lfs pull",
    ),
    ForeignFormat(
        "a git-annex pointer, not the file it stands for", _magic(b"/annex/objects"), f"{_FETCH}: git annex get"
    ),
    ForeignFormat(
        "a web page (HTML): the server answered with a page instead of the file",
        _text(b"<!doctype html", b"<html", b"<head", b"<body"),
        f"{_FETCH}: log in first, or take the direct link",
    ),
    ForeignFormat("an XML text, maybe a server's error", _text(b"<?xml", b"<error"), _FETCH),
    ForeignFormat("a Word document", _office(b"word/"), "Name the log that it describes"),
    ForeignFormat("an Excel sheet", _office(b"xl/"), "Name the log that it describes"),
    ForeignFormat("a StarFish log (.logdoc)", _office(b"logdoc"), f"{_AS_XTF} with StarFish Scanline", (".logdoc",)),
    ForeignFormat("compressed (zip)", _magic(b"PK\x03\x04", b"PK\x05\x06"), "Unpack it: unzip FILE"),
    ForeignFormat("compressed (gzip)", _magic(b"\x1f\x8b"), "Unpack it: gunzip FILE, or tar -xzf FILE for an archive"),
    ForeignFormat("compressed (bzip2)", _magic(b"BZh"), "Unpack it: bunzip2 FILE"),
    ForeignFormat("compressed (xz)", _magic(b"\xfd7zXZ\0"), "Unpack it: unxz FILE"),
    ForeignFormat("compressed (zstd)", _magic(b"\x28\xb5\x2f\xfd"), "Unpack it: unzstd FILE"),
    ForeignFormat("compressed (7z)", _magic(b"7z\xbc\xaf\x27\x1c"), "Unpack it: 7z x FILE"),
    ForeignFormat("compressed (rar)", _magic(b"Rar!\x1a\x07"), "Unpack it: unrar x FILE"),
    ForeignFormat("an archive (tar)", _is_tar, "Unpack it: tar -xf FILE"),
    ForeignFormat("a PDF document", _magic(b"%PDF"), "Name the log that it describes"),
    ForeignFormat("a database (SQLite)", _magic(b"SQLite format 3\0"), f"{_AS_XTF} with the program that wrote it"),
    ForeignFormat(
        "a ROS bag", _magic(b"#ROSBAG V"), "Write its pings with a reader of your own (page 'Read your own log format')"
    ),
    ForeignFormat(
        "a picture (JPEG), whose compression changes levels",
        _magic(b"\xff\xd8\xff"),
        "Name the log that it was made from, or a TIFF or PNG of it with a sidecar",
    ),
    ForeignFormat("a SeaBat 7k log (.s7k)", _is_s7k, _MULTIBEAM + " (records 7007 and 7057)", (".s7k",)),
    ForeignFormat("a Kongsberg log (.all, .wcd)", _is_em_datagram, _MULTIBEAM, (".all", ".wcd")),
    ForeignFormat(
        "a Kongsberg log (.kmall)",
        lambda head: len(head) > 8 and head[4:5] == b"#" and head[5:8].isalpha() and head[5:8].isupper(),
        _MULTIBEAM,
        (".kmall", ".kmwcd"),
    ),
    ForeignFormat("a Generic Sensor Format file (.gsf)", _is_gsf, f"{_MULTIBEAM}; GSF holds depths", (".gsf",)),
    ForeignFormat(
        "a SEG-Y file: sub-bottom or seismic traces",
        _is_segy,
        "Give the log of the side scan that was recorded beside it",
        (".sgy", ".segy", ".seg"),
    ),
    ForeignFormat("a Klein log (.sdfx)", _never, f"{_AS_XTF} with Klein SonarPro", (".sdfx",)),
    ForeignFormat(
        "a Marine Sonic log (MSTIFF)", _is_mstiff, f"{_AS_XTF} with Sea Scan Survey or SonarWiz", (".mst", ".mstiff")
    ),
    ForeignFormat(
        "a Lowrance log (SLG)",
        lambda head: head[:2] == b"\1\0" and head[4:8] in (b"\xb2\x07\0\0", b"\x80\x0c\0\0"),
        "Record it as SL2 or SL3",
        (".slg",),
    ),
    ForeignFormat(
        "a Garmin log (RSD)",
        lambda head: head[1:6] == b"\x04\x86\xda\xe9\xb7" or _is_rsd(head),
        f"{_AS_XTF} with SonarWiz, SonarTRX or ReefMaster",
        (".rsd",),
    ),
    ForeignFormat("a DeepVision log (DVS)", _is_dvs, f"{_AS_XTF} with DeepView", (".dvs",)),
    ForeignFormat(
        "a bathymetric grid (BAG): depths, not pings",
        lambda head: head.startswith(b"\x89HDF") and b"BAG_root" in head,
        "Give the log of the side scan",
        (".bag",),
        is_image=True,
    ),
    ForeignFormat("a CMAX log (.cm2)", _never, f"{_AS_XTF} with MaxView", (".cm2",)),
    ForeignFormat("a sonar log (.lsf)", _never, f"{_AS_XTF} with the program that wrote it", (".lsf",)),
    ForeignFormat(
        "an Imagenex log",
        _magic(b"81S", b"83B", b"87S", b"837", b"872", b"878"),
        f"{_AS_XTF} with Imagenex's converter",
        (".872", ".878", ".81s"),
    ),
    ForeignFormat("a Tritech log (.v4log)", _never, f"{_AS_XTF} with Seanet Pro", (".v4log",)),
    ForeignFormat(
        "a table of text",
        _text(b"lat", b"time,", b"date,", b"ping"),
        "Give the log that it was made from",
        (".csv", ".txt"),
    ),
)
"""Formats that are named and not read, the first that fits counts."""


def _is_rsd(head: bytes) -> bool:
    """Check for the marks of Garmin's records behind a header of 20480 bytes."""
    return b"\x86\xda\xe9\xb7" in head[20_000:24_000]
