"""Measure framers: messages found in whole and damaged bytes, and what junk costs."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Hashable, Iterable
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from typing import Final

import numpy as np

from sim_replay.benches.every_stage.rows import Other, Row, timed
from sim_replay.fakes.damage import damaged, n_missing
from sim_replay.fakes.framed_wires import WIRES, FramedWire
from sim_replay.fakes.worst_bytes import WORST_BYTES

MAX_S_PER_MB: Final = 0.3
"""Processor time that a framer may take for a megabyte, whatever it is: 9 % of a core at 921600 baud with nothing to
spare.
"""
_CHUNK_BYTES: Final = 4096  # of a read
_DATAGRAM_BYTES: Final = 97  # of a small datagram, each read by itself; a prime, so that pieces are cut anywhere
_MESSAGES_PER_INPUT: Final = 25  # 200 with all inputs: numbers of commands on CAN end at 255
_MESSAGES_PER_FAULT: Final = 4  # so that most stay whole
_JUNK_BYTES: Final = 20_000  # of each kind, per input


def framer_rows(n: int) -> list[Row]:
    """Frame every wire's messages, whole and damaged, and its worst junk; Ping Protocol beside brping's parser."""
    rows = []
    missing = "" if find_spec("brping") is not None else "brping is not installed: pip install bluerobotics-ping"
    for wire in WIRES:
        random = np.random.Generator(np.random.PCG64(4))
        messages = wire.messages(random, _MESSAGES_PER_INPUT * n)
        hurt = damaged(messages, len(messages) // _MESSAGES_PER_FAULT, random)
        whole, keys = b"".join(messages), wire.read(messages)
        for name, stream, intact in (("whole", whole, [True] * len(messages)), ("damaged", hurt.stream, hurt.intact)):
            other = None
            if wire.name == "ping_protocol":
                theirs = [] if missing else _by_brping(whole)
                other = Other("brping", partial(_by_brping, stream), partial(_lost, theirs, intact), missing=missing)
            work, lost = partial(wire.read, list(_chunks(stream, _CHUNK_BYTES))), partial(_lost, keys, intact)
            setting = f"{wire.name}, {name}, {len(stream)} bytes"
            rows.append(Row("framers", setting, work, lost, "intact messages lost", 0.0, other))
        n_runs, bound = (1, None) if n < 4 else (3, MAX_S_PER_MB)
        junk = partial(worst_junk_s_per_mb, wire, _JUNK_BYTES * n, n_runs)
        rows.append(Row("framers", f"{wire.name}, worst junk", junk, float, "s per MB of junk", bound))
    return rows


def _lost(sent: list[Hashable], intact: list[bool], found: list[Hashable]) -> float:
    """Count intact messages that were not found, and those that were not even found among whole ones."""
    if len(sent) != len(intact):
        return float(abs(len(intact) - len(sent)))
    return float(n_missing([message for message, whole in zip(sent, intact, strict=True) if whole], found))


def worst_junk_s_per_mb(wire: FramedWire, n_bytes: int, n_runs: int) -> float:
    """Feed so much of every kind of junk in chunks of 4 KiB, and a quarter in datagrams of 97 bytes.

    Returns the processor time of the dearest, of each the fastest of so many runs.
    """
    noise, worst_s = np.random.Generator(np.random.PCG64(2)).bytes(1 << 16), 0.0
    for piece in (noise, bytes(1 << 16), *WORST_BYTES[wire.name].values()):
        stream = (piece * (n_bytes // len(piece) + 1))[:n_bytes]
        for chunk_bytes, part in ((_CHUNK_BYTES, stream), (_DATAGRAM_BYTES, stream[: n_bytes // 4])):
            runs = timed(n_runs, partial(wire.read, list(_chunks(part, chunk_bytes))))
            worst_s = max(worst_s, 1e3 * min(runs[0][1].times_ms) / len(part))
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
