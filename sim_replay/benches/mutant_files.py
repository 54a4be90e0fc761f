"""Damage files of any format, reproducibly from a seed: bytes, fields of YAML, checksums put right again."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from typing import Final

import numpy as np

Random = np.random.Generator
Change = Callable[[bytes, Random], bytes]

_HEADERS: Final = (64, 256, 1024)  # bytes from the start in which damage of fields is likeliest to matter
_FEW: Final = 600  # bytes inserted, removed or copied at most
_SVLOG_HEAD = struct.Struct("<2sHHBB")  # start, payload length, message, addresses (Ping Protocol)
_SVLOG_SUM_BYTES: Final = 2  # checksum behind a message (Ping Protocol)
_MCAP_RECORD = struct.Struct("<BQ")  # opcode, length
_MCAP_MAGIC_BYTES: Final = 8  # at either end of a file (MCAP)
_MCAP_CHUNK: Final = 0x06  # opcode
_MCAP_CHUNK_HEAD = struct.Struct("<QQQII")  # first and last time, unpacked size, checksum, length of the compression
_NO_CHECKSUM: Final = b"\0\0\0\0"  # a checksum of 0 is not checked (MCAP specification)
_NUMBERS: Final = (
    *(struct.pack("<I", value) for value in (0, 0xFFFFFFFF, 0x7FFFFFFF, 0x80000000, 1 << 16, 1 << 20, 1 << 28)),
    *(struct.pack("<Q", value) for value in (1 << 31, 1 << 32, 1 << 40, 1 << 62, (1 << 64) - 1)),
    *(struct.pack("<d", value) for value in (float("nan"), float("inf"), 1e308, -1e308)),
    *(struct.pack(f"{order}H", value) for order in "<>" for value in (0, 1, 0xFFFF, 0x8000)),
)
_SCALARS: Final = (
    *("-1", "0", "1e308", "-1e308", "1e-320", ".nan", ".inf", "9" * 5000, "[]", "{}", "[1, 2, 3]", "{a: {b: 1}}", "~"),
    *('""', "'x'", '"\\ud800"', '"\\0"', '"a\\0b"', '"\\x1b[2J"', '"\\ud83d\\ude00"', "true", "*x", "&x 1", "!!int 1"),
    *("!!python/object/apply:os.system ['true']", "0001-01-01T00:00:00+23:59", "9999-12-31T23:59:59Z", "'../x'"),
    *("1" * 400, "0.0000001", "1000000", "/dev/null", "x" * 300),
)


def damage(data: bytes, random: Random, change: Change) -> bytes:
    """Change a file once, twice or four times."""
    for _ in range(int(random.choice([1, 1, 1, 2, 4]))):
        data = change(data, random)
    return data


# --- bytes -----------------------------------------------------------------------------------------------------------


def _place(data: bytes, random: Random) -> int:
    """Draw a place, mostly in the header or near the end, where many formats have their tables."""
    if random.random() < 0.25:
        return max(0, len(data) - 1 - int(random.integers(400)))
    size = int(random.choice([*_HEADERS, max(len(data), 1)]))
    return int(random.integers(max(min(size, len(data)), 1)))


def _put(data: bytes, at: int, value: bytes) -> bytes:
    return (data[:at] + value + data[at + len(value) :])[: max(len(data), at)]


def _bit(data: bytes, random: Random) -> bytes:
    at = _place(data, random)
    return _put(data, at, bytes([data[at] ^ 1 << int(random.integers(8))])) if data else data


def _byte(data: bytes, random: Random) -> bytes:
    return _put(data, _place(data, random), bytes([int(random.choice([0, 1, 0x20, 0x2F, 0x7F, 0x80, 0xFF]))]))


def _number(data: bytes, random: Random) -> bytes:
    return _put(data, _place(data, random), _NUMBERS[int(random.integers(len(_NUMBERS)))])


def _cut(data: bytes, random: Random) -> bytes:
    return data[: int(random.integers(len(data) + 1))]


def _removed(data: bytes, random: Random) -> bytes:
    at = _place(data, random)
    return data[:at] + data[at + int(random.integers(1, 200)) :]


def _copied(data: bytes, random: Random) -> bytes:
    at, start = _place(data, random), int(random.integers(len(data) + 1))
    return data[:at] + data[start : start + int(random.integers(1, _FEW))] + data[at:]


def _inserted(data: bytes, random: Random) -> bytes:
    at = _place(data, random)
    return data[:at] + random.bytes(int(random.integers(1, 64))) + data[at:]


BYTES: Final[dict[str, Change]] = {
    "a bit": _bit,
    "a byte": _byte,
    "a number": _number,
    "cut off": _cut,
    "bytes removed": _removed,
    "bytes copied": _copied,
    "bytes inserted": _inserted,
}
"""Of any file."""


# --- formats with checksums ------------------------------------------------------------------------------------------


def svlog_resealed(data: bytes, random: Random) -> bytes:
    """Damage payloads of Ping Protocol packets, and put their checksums right."""
    out, at = bytearray(), 0
    while at + _SVLOG_HEAD.size + _SVLOG_SUM_BYTES <= len(data):
        n_payload = _SVLOG_HEAD.unpack_from(data, at)[1]
        packet = bytearray(data[at : at + _SVLOG_HEAD.size + n_payload])
        if n_payload and random.random() < 0.2:
            place = _SVLOG_HEAD.size + int(random.integers(min(n_payload, 64)))
            value = _NUMBERS[int(random.integers(len(_NUMBERS)))]
            packet[place : place + len(value)] = value[: len(packet) - place]
        out += packet + (sum(packet) & 0xFFFF).to_bytes(_SVLOG_SUM_BYTES, "little")
        at += len(packet) + _SVLOG_SUM_BYTES
    return bytes(out)


def mcap_unsealed(data: bytes, random: Random) -> bytes:
    """Damage what lies in the chunks of an MCAP file, and say that they have no checksum."""
    out, at = bytearray(data), _MCAP_MAGIC_BYTES
    while at + _MCAP_RECORD.size <= len(data):
        opcode, n_bytes = _MCAP_RECORD.unpack_from(data, at)
        body = at + _MCAP_RECORD.size
        if opcode == _MCAP_CHUNK and n_bytes > _MCAP_CHUNK_HEAD.size + 8:
            out[body + 24 : body + 28] = _NO_CHECKSUM
            first = body + _MCAP_CHUNK_HEAD.size + 8  # behind the length of the records
            for _ in range(int(random.integers(1, 6))):
                place = first + int(random.integers(max(int(n_bytes) - _MCAP_CHUNK_HEAD.size - 8, 1)))
                value = _NUMBERS[int(random.integers(len(_NUMBERS)))]
                out[place : place + len(value)] = value[: len(out) - place]
        at = body + int(n_bytes)
    return bytes(out)


def png_resealed(data: bytes, random: Random) -> bytes:
    """Damage chunks of a PNG, and put their checksums right."""
    out, at = bytearray(data[:8]), 8
    while at + 12 <= len(data):
        n_bytes = int.from_bytes(data[at : at + 4], "big")
        chunk = bytearray(data[at + 4 : at + 8 + n_bytes])
        if random.random() < 0.4 and len(chunk) > 4:
            place = int(random.integers(4, len(chunk)))
            chunk[place] = int(random.choice([0, 1, 2, 3, 4, 8, 16, 0x7F, 0xFF]))
        out += data[at : at + 4] + chunk + zlib.crc32(chunk).to_bytes(4, "big")
        at += 12 + n_bytes
    return bytes(out)


SEALED: Final[dict[str, Change]] = {".svlog": svlog_resealed, ".mcap": mcap_unsealed, ".png": png_resealed}
"""By the ending of a file's name."""


# --- text ------------------------------------------------------------------------------------------------------------


def _lines(data: bytes) -> list[bytes]:
    return data.split(b"\n")


def _scalar(data: bytes, random: Random) -> bytes:
    """Put nonsense behind a colon or a comma."""
    places = [at for at, byte in enumerate(data) if byte in b":,"]
    if not places:
        return data
    at = places[int(random.integers(len(places)))] + 1
    stop = next((end for end in range(at + 1, len(data)) if data[end] in b",}]\n"), len(data))
    return data[:at] + b" " + _SCALARS[int(random.integers(len(_SCALARS)))].encode() + data[stop:]


def _line_removed(data: bytes, random: Random) -> bytes:
    lines = _lines(data)
    del lines[int(random.integers(len(lines)))]
    return b"\n".join(lines)


def _line_twice(data: bytes, random: Random) -> bytes:
    lines = _lines(data)
    lines.insert(int(random.integers(len(lines))), lines[int(random.integers(len(lines)))])
    return b"\n".join(lines)


def _indented(data: bytes, random: Random) -> bytes:
    lines = _lines(data)
    at = int(random.integers(len(lines)))
    lines[at] = b" " * int(random.integers(1, 5)) + lines[at].lstrip()
    return b"\n".join(lines)


TEXT: Final[dict[str, Change]] = {
    "nonsense for a value": _scalar,
    "a line removed": _line_removed,
    "a line twice": _line_twice,
    "a line indented": _indented,
    **BYTES,
}
"""Of YAML and tables."""
