"""Frame NMEA 0183: `$` or `!`, a body, `*`, the XOR of the body in hex. What follows, CR LF or not, does not matter.

IEC 61162-1, section 7: `$`, `!` and `*` never occur inside a body, so whatever came before an intact sentence cannot
swallow it. The standard's 82 characters are not enforced, since attitude and inertial units send more.
"""

from __future__ import annotations

import re
from functools import reduce
from operator import xor
from typing import Final

from drivers.framing import Grammar
from drivers.message_candidates import MessageCandidates

# the standard allows 82, but devices' own sentences are longer; bounds how long junk holds one back
MAX_SENTENCE_BYTES: Final = 255
_BODY: Final = rb"[\x20\x22\x23\x25-\x29\x2b-\x7e]"
_SENTENCE: Final = re.compile(rb"[$!](%b{4,%d})\*([0-9A-Fa-f]{2})\r?\n?" % (_BODY, MAX_SENTENCE_BYTES - 6))
_RUN: Final = re.compile(rb"[$!]%b*" % _BODY)
_MAX_RUN_BYTES: Final = MAX_SENTENCE_BYTES - 5  # of `$` and body, with room for the checksum and CR LF

_CANDIDATES: Final = MessageCandidates(
    (b"$", b"!"),
    alive=rb"[$!](?:%b{4,%d}+\*(?:[0-9A-Fa-f]{2}|[0-9A-Fa-f]?\Z)|%b{0,%d}+\Z)"
    % (_BODY, MAX_SENTENCE_BYTES - 6, _BODY, _MAX_RUN_BYTES - 1),
    dead=rb"((?:[$!](?=[$!]))++)|[$!](?:(%b{%d})|%b*+(?:(?=([$!]))|(?=(\*))|(?=([\r\n]))|(?=([\x80-\xff]))|()))"
    % (_BODY, _MAX_RUN_BYTES, _BODY),
    reasons=(
        "interrupted",
        "oversize",
        "interrupted",
        "checksum_malformed",
        "checksum_absent",
        "non_ascii",
        "control_character",
    ),
)


class NmeaGrammar(Grammar[str]):
    """Frame sentences; a message is a sentence's body, such as `GPHDT,123.4,T`.

    Its line end is not waited for; one that comes later counts as skipped.
    """

    name = "nmea"
    head_bytes = 1
    max_message_bytes = MAX_SENTENCE_BYTES
    proven = True
    find = staticmethod(_CANDIDATES.find)

    def read(self, buffer: bytearray, at: int) -> tuple[str, int] | int | str:
        match = _SENTENCE.match(buffer, at)
        if match is None:
            return self._incomplete(buffer, at)
        body, checksum = match.groups()
        if xor_of(body) != BYTE_OF_HEX[checksum]:
            return "checksum"
        return body.decode("ascii"), match.end() - at

    def _incomplete(self, buffer: bytearray, at: int) -> int | str:
        run = _RUN.match(buffer, at)
        assert run is not None  # `find` saw its first character
        end = run.end()
        if end - at > _MAX_RUN_BYTES:
            return "oversize"
        if end == len(buffer):
            return end - at + 3
        stop = buffer[end]
        if stop == ord("*"):
            return (
                end - at + 3
                if len(buffer) < end + 3 and _is_hex(buffer[end + 1 :]) and end - at > 4
                else "checksum_malformed"
            )
        if stop in b"$!":
            return "interrupted"
        if stop in b"\r\n":
            return "checksum_absent"
        return "non_ascii" if stop >= 0x80 else "control_character"


def sentence(body: str) -> bytes:
    """Encode a body such as `GPHDT,123.4,T` as a whole line, with CR LF.

    Raises UnicodeEncodeError unless it is ASCII.
    """
    data = body.encode("ascii")
    return b"$%b*%02X\r\n" % (data, xor_of(data))


def xor_of(data: bytes) -> int:
    """Return the XOR of at most 256 bytes.

    More than a few are folded in halves, several times faster than one by one.
    """
    if len(data) <= _FEW_BYTES:
        return reduce(xor, data, 0)
    folded = int.from_bytes(data, "big")
    for bits in (1024, 512, 256, 128, 64, 32, 16, 8):
        folded ^= folded >> bits
    return folded & 0xFF


_HEX_DIGITS: Final = b"0123456789abcdefABCDEF"
BYTE_OF_HEX: Final = {bytes((high, low)): int(bytes((high, low)), 16) for high in _HEX_DIGITS for low in _HEX_DIGITS}
_FEW_BYTES: Final = 16  # up to which folding is slower


def _is_hex(digits: bytearray) -> bool:
    return all(digit in _HEX_DIGITS for digit in digits)
