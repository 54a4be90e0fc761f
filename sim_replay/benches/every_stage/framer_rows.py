"""Measure framers: messages found in whole and damaged bytes, and what junk costs."""

from __future__ import annotations

import contextlib
import io
import time
from collections.abc import Hashable, Iterable
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from typing import Final

import numpy as np

from sim_replay.benches.every_stage.rows import Other, Row
from sim_replay.fakes.damage import damaged, n_missing
from sim_replay.fakes.framed_wires import WIRES, FramedWire
from sim_replay.fakes.worst_bytes import WORST_BYTES

MAX_S_PER_MB: Final = 0.3
"""Processor time that a framer may take for a megabyte, whatever it is: 9 % of a core at 921600 baud with nothing to
spare.
"""
_CHUNK_BYTES: Final = 4096  # of a read
_DATAGRAM_BYTES: Final = 97  # of a small datagram, each read by itself; a prime, so that pieces are cut anywhere
_JUNK_BYTES: Final = 20_000  # of each kind, per input


def framer_rows(n: int) -> list[Row]:
    """Frame every wire's messages, whole and damaged, and its worst junk; Ping Protocol beside brping's parser."""
    rows = []
    missing = "" if find_spec("brping") is not None else "brping is not installed: pip install bluerobotics-ping"
    for wire in WIRES:
        random = np.random.Generator(np.random.PCG64(4))
        messages = wire.messages(random, 40 * n)
        hurt = damaged(messages, 10 * n, random)
        whole, keys = b"".join(messages), wire.read(messages)
        for name, stream, intact in (("whole", whole, [True] * len(messages)), ("damaged", hurt.stream, hurt.intact)):
            other = None
            if wire.name == "ping_protocol":
                theirs = [] if missing else _by_brping(whole)
                other = Other("brping", partial(_by_brping, stream), partial(_lost, theirs, intact), missing=missing)
            work, lost = partial(wire.read, list(_chunks(stream, _CHUNK_BYTES))), partial(_lost, keys, intact)
            setting = f"{wire.name}, {name}, {len(stream)} bytes"
            rows.append(Row("framers", setting, work, lost, "intact messages lost", 0.0, other))
        junk, bound = partial(worst_junk_s_per_mb, wire, _JUNK_BYTES * n), None if n < 4 else MAX_S_PER_MB
        rows.append(Row("framers", f"{wire.name}, worst junk", junk, float, "s per MB of junk", bound))
    return rows


def _lost(sent: list[Hashable], intact: list[bool], found: list[Hashable]) -> float:
    """Count intact messages that were not found, and those that were not even found among whole ones."""
    if len(sent) != len(intact):
        return float(abs(len(intact) - len(sent)))
    return float(n_missing([message for message, whole in zip(sent, intact, strict=True) if whole], found))


def worst_junk_s_per_mb(wire: FramedWire, n_bytes: int) -> float:
    """Feed so much of every kind of junk in chunks of 4 KiB, and a quarter in datagrams of 97 bytes.

    Returns the processor time of the dearest.
    """
    noise, worst_s = np.random.Generator(np.random.PCG64(2)).bytes(1 << 16), 0.0
    for piece in (noise, bytes(1 << 16), *WORST_BYTES[wire.name].values()):
        stream = (piece * (n_bytes // len(piece) + 1))[:n_bytes]
        for chunk_bytes, part in ((_CHUNK_BYTES, stream), (_DATAGRAM_BYTES, stream[: n_bytes // 4])):
            reader, began_s = wire.reader(), time.thread_time()
            for chunk in _chunks(part, chunk_bytes):
                reader(chunk)
            worst_s = max(worst_s, 1e6 * (time.thread_time() - began_s) / len(part))
    return worst_s


def _chunks(stream: bytes, n_bytes: int) -> Iterable[bytes]:
    return (stream[at : at + n_bytes] for at in range(0, len(stream), n_bytes))


def _by_brping(stream: bytes) -> list[Hashable]:
    brping = import_module("brping")
    parser, found = brping.PingParser(), list[Hashable]()
    with contextlib.redirect_stdout(io.StringIO()):  # it prints the numbers of messages that it does not know
        for byte in stream:
            if parser.parse_byte(byte) == brping.PingParser.NEW_MESSAGE:
                found.append(bytes(parser.rx_msg.msg_data))
    return found
