"""Make files that only look like what they are: pipes, devices, packed bombs, storage in other files, endless text.

Each is a trap that a reader once fell into, or would where it trusts a header.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, Final, NamedTuple

import h5py
import numpy as np
import tifffile

from sim_replay.benches.mutant_seeds import Seed, write_sidecar
from sim_replay.logs.image_sidecar import sidecar_path

_BOMB_MIB: Final = 1200  # MiB that a bomb unpacks to: more than a mutant may take
_STRIP_OFFSETS, _STRIP_BYTES = 273, 279  # tags of TIFF 6.0
_ENDLESS_BYTES: Final = 3 << 30  # of a sparse file, which takes no room on the disk


class Trap(NamedTuple):
    """Hold a trap: what it writes over the sound file of a seed, and whether the reader has to refuse it."""

    write: Callable[[Path], None]
    refused: bool = True


def traps_of(seed: Seed) -> dict[str, Trap]:
    """List the traps for a seed by name."""
    traps = dict(_ANY)
    if seed.role in ("configuration", "scene", "mine list", "sidecar"):
        traps |= _YAML
    if seed.role == "image":
        traps |= _IMAGE
    if seed.role == "sidecar":
        traps |= _SIDECAR
    return traps | _FORMATS.get(seed.name, {})


def _replaced(write: Callable[[Path], Any]) -> Callable[[Path], None]:
    def trap(path: Path) -> None:
        path.unlink()
        write(path)

    return trap


def _endless(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(_ENDLESS_BYTES)


_ANY: Final = {
    "a pipe in its place": Trap(_replaced(os.mkfifo)),
    "a link to /dev/zero in its place": Trap(_replaced(lambda path: path.symlink_to("/dev/zero"))),
    "a directory in its place": Trap(_replaced(Path.mkdir)),
    "3 GiB of zeros": Trap(_replaced(_endless)),
    "nothing in it": Trap(_replaced(Path.touch), refused=False),
}


# --- text ------------------------------------------------------------------------------------------------------------


def _text(text: str | bytes) -> Trap:
    return Trap(lambda path: _write(path, text.encode() if isinstance(text, str) else text))


def _write(path: Path, data: bytes) -> None:
    path.write_bytes(data)


_YAML: Final = {
    "half a surrogate pair as a value": _text('side: "\\ud800"\nworld: {seabeds: [{type: "\\ud800"}]}\n'),
    "half a surrogate pair as a key": _text('"\\ud800": 1\n'),
    "200,000 brackets": _text("a: " + "[" * 200_000),
    "50,000 keys and the last one twice": _text("".join(f"k{n}: 1\n" for n in range(50_000)) + "k49999: 1\n"),
    "names that stand for ever more": _text("a: &a [1]\n" + "".join(f"b{n}: [*a, *a]\n" for n in range(30))),
    "a number of 100,000 digits": _text("a: " + "9" * 100_000 + "\n"),
    "a call": _text("a: !!python/object/apply:os.system ['touch called']\n"),
    "UTF-16": _text("side: port\n".encode("utf-16")),
    "null characters": _text(b"side: \0\0\n"),
}


def _sidecar(**changes: Any) -> Trap:
    """Change keys of the sidecar, whose path is given."""
    return Trap(lambda path: write_sidecar(path.with_suffix(".npy"), changes))


def _track_pipe(path: Path) -> None:
    os.mkfifo(path.with_name("pipe"))
    write_sidecar(path.with_suffix(".npy"), {"track": "pipe"})


_SIDECAR: Final = {
    "a track that is a pipe": Trap(_track_pipe),
    "a track that is /dev/zero": _sidecar(track="/dev/zero"),
    "a track with a null character": _sidecar(track="a\0b"),
    "a track that is a directory": _sidecar(track="/"),
    "corners in one point": _sidecar(
        track=None,
        corners={name: [43.0, 5.5] for name in ("near_first", "near_last", "far_first", "far_last")},
        range="slant",
        near_range_m=0.0,
    ),
    "a place in space": Trap(lambda path: _high_track(path)),
}


def _high_track(path: Path) -> None:
    """Let the altitude rise by 9 km along the lines."""
    track = path.with_name("track.csv")
    lines = track.read_text("utf-8").splitlines()
    rows = [line.rsplit(",", 1)[0] + f",{1.0 + 500.0 * number}" for number, line in enumerate(lines[1:])]
    track.write_text("\n".join((lines[0], *rows, "")), "utf-8")


# --- images ----------------------------------------------------------------------------------------------------------


@cache
def _bomb(mib: int = _BOMB_MIB) -> bytes:
    """Pack zeros by deflate: blocks that end at a byte can be repeated."""
    packer = zlib.compressobj(9)
    head = packer.compress(bytes(1 << 20)) + packer.flush(zlib.Z_FULL_FLUSH)
    block = packer.compress(bytes(1 << 20)) + packer.flush(zlib.Z_FULL_FLUSH)
    return head + block * (mib - 1) + packer.flush()


def _beside_pipe(path: Path) -> None:
    sidecar_path(path).unlink()
    os.mkfifo(sidecar_path(path))


def _beside_zero(path: Path) -> None:
    sidecar_path(path).unlink()
    sidecar_path(path).symlink_to("/dev/zero")


_IMAGE: Final = {"a sidecar that is a pipe": Trap(_beside_pipe), "a sidecar that is /dev/zero": Trap(_beside_zero)}


def _tiff_bomb(path: Path) -> None:
    """Write one strip of deflate, and let its offset and length name a bomb behind it."""
    tifffile.imwrite(path, np.ones((48, 96), np.uint16), compression="zlib", rowsperstrip=48)
    with tifffile.TiffFile(path) as file:
        tags: Any = file.pages.first.tags
        places = [tags[code].valueoffset for code in (_STRIP_OFFSETS, _STRIP_BYTES)]
    data = bytearray(path.read_bytes())
    for place, value in zip(places, (len(data), len(_bomb())), strict=True):
        struct.pack_into("<I", data, place, value)
    path.write_bytes(bytes(data) + _bomb())


def _png_chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + zlib.crc32(kind + data).to_bytes(4, "big")


def _png(width: int, height: int, before: bytes = b"", pixels: bytes = b"") -> Trap:
    head = _png_chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0))
    return _text(b"\x89PNG\r\n\x1a\n" + head + before + _png_chunk(b"IDAT", pixels) + _png_chunk(b"IEND", b""))


_PNG: Final = {
    "a text of 2 GiB that is not there": _png(96, 48, struct.pack(">I", (1 << 31) - 1) + b"tEXt"),
    "2^62 pixels": _png((1 << 31) - 1, (1 << 31) - 1),
    "16384 x 16384 pixels": _png(16384, 16384, pixels=zlib.compress(bytes(16385 * 16384), 9)),
    "a packed text": _png(96, 48, _png_chunk(b"zTXt", b"a\0\0" + _bomb(200)), zlib.compress(bytes(97 * 48)))._replace(
        refused=False
    ),
}


def _npy(header: str, data: bytes = b"", version: bytes = b"\1\0") -> Trap:
    text = header.encode() + b"\n"
    length = struct.pack("<H" if version == b"\1\0" else "<I", len(text))
    return _text(b"\x93NUMPY" + version + length + text + data)


_NPY: Final = {
    "a negative shape": _npy("{'descr':'<f4','fortran_order':False,'shape':(-5,5)}"),
    "2^62 numbers": _npy(f"{{'descr':'<f4','fortran_order':False,'shape':({1 << 31},{1 << 31})}}"),
    "9,900 minus signs": _npy("-" * 9900 + "1"),
    "9,000 brackets": _npy("(" * 9000),
    "9,000 braces": _npy("{" * 9000, version=b"\2\0"),
    "numbers without size": _npy("{'descr':'|V0','fortran_order':False,'shape':(96,96)}"),
    "objects": _npy("{'descr':'|O','fortran_order':False,'shape':(96,96)}", bytes(96 * 96 * 8)),
}


def _hdf5(make: Callable[[Any, Path], None]) -> Trap:
    def write(path: Path) -> None:
        path.unlink()
        with h5py.File(path, "w") as file:
            make(file, path)

    return Trap(write)


def _outside(name: str) -> Trap:
    def make(file: Any, path: Path) -> None:
        file.create_dataset("image", shape=(48, 96), dtype="u1", external=[(name, 0, 48 * 96)])

    return _hdf5(make)


def _outside_pipe(file: Any, path: Path) -> None:
    os.mkfifo(path.with_name("pipe"))
    file.create_dataset("image", (48, 96), "u1", external=[(os.fspath(path.with_name("pipe")), 0, 48 * 96)])


def _virtual(file: Any, path: Path) -> None:
    with h5py.File(path.with_name("source.h5"), "w") as other:
        other["image"] = np.ones((48, 96), np.float32)
    layout = h5py.VirtualLayout(shape=(48, 96), dtype="f4")
    layout[:] = h5py.VirtualSource(os.fspath(path.with_name("source.h5")), "image", shape=(48, 96))
    file.create_virtual_dataset("image", layout)


def _packed(shape: tuple[int, int]) -> Trap:
    """Write one chunk that unpacks to more than memory allows, or than the chunk holds."""

    def make(file: Any, path: Path) -> None:
        data = file.create_dataset("image", shape, "f4", chunks=shape, compression="gzip")
        data.id.write_direct_chunk((0, 0), _bomb())
        track = path.with_name("track.csv")
        rows = (f"{line},{43.0 + line * 0.1 / 111_120.0:.9f},5.5" for line in range(0, shape[0] + 100, 50))
        track.write_text("\n".join(("line,latitude_deg,longitude_deg", *rows, "")), "utf-8")

    return _hdf5(make)


def _sparse(file: Any, path: Path) -> None:
    file.create_dataset("image", (1 << 40, 1 << 20), "f4", chunks=(16, 16))


def _many(file: Any, path: Path) -> None:
    for number in range(2000):
        file.create_dataset(f"plane {number}\n\x1b[2J", (2, 2), "u1")


def _loop(file: Any, path: Path) -> None:
    file["image"] = h5py.SoftLink("/image")
    file["group/up"] = h5py.SoftLink("/group")
    file["other"] = h5py.ExternalLink("/dev/zero", "x")


_HDF5: Final = {
    "pixels in /etc/passwd": _outside("/etc/passwd"),
    "pixels in /dev/zero": _outside("/dev/zero"),
    "pixels in a pipe": _hdf5(_outside_pipe),
    "pixels in another file": _hdf5(_virtual),
    "a chunk of 1.2 GiB": _packed((20_000, 15_729)),
    "a small chunk that unpacks to 1.2 GiB": _packed((48, 96))._replace(refused=False),
    "2^60 pixels": _hdf5(_sparse),
    "2,000 planes": _hdf5(_many),
    "links to itself": _hdf5(_loop),
}

_FORMATS: Final[dict[str, dict[str, Trap]]] = {
    "TIFF, deflate": {"a strip that unpacks to 1.2 GiB": Trap(_tiff_bomb, refused=False)},
    "PNG, 8 bits": _PNG,
    "npy": _NPY,
    "HDF5": _HDF5,
}
"""By the name of the seed."""
