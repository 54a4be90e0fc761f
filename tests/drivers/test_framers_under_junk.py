"""No junk costs a framer more than a bounded amount of work per byte, and none of it changes what is read.

The oracle looks at every candidate for itself and sums up each message from its beginning.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable
from types import FrameType
from typing import Any, Final, Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.framing import Framer, Grammar, Refused
from drivers.links.slcan import SlcanParser
from drivers.navigation.dvl_pd6 import LineGrammar
from drivers.navigation.dvl_water_linked import TextGrammar
from drivers.navigation.nmea0183 import NmeaGrammar
from drivers.sonar.imagenex import IgxGrammar
from drivers.sonar.jsf import JsfGrammar
from drivers.sonar.ping_protocol import PingGrammar
from drivers.vehicle.bluefin_sentences import BluefinGrammar
from drivers.vehicle.imc_crc import crc16_arc
from drivers.vehicle.imc_wire import ImcGrammar
from drivers.vehicle.iver_sentences import IverGrammar
from drivers.vehicle.recon_sentences import ReconGrammar
from sim_replay.fakes.worst_bytes import WORST_BYTES

GRAMMARS: Final[dict[str, tuple[type[Grammar[Any]], tuple[bytes, ...]]]] = {
    "ping_protocol": (PingGrammar, (b"BR",)),
    "jsf": (JsfGrammar, (b"\x01\x16",)),
    "sportscan": (IgxGrammar, (b"IGX",)),
    "nmea0183": (NmeaGrammar, (b"$", b"!")),
    "pixse": (NmeaGrammar, (b"$", b"!")),
    "bluefin": (BluefinGrammar, (b"$", b"!")),
    "iver": (IverGrammar, (b"$", b"!")),
    "water_linked": (TextGrammar, (b"w",)),
    "pd6": (LineGrammar, (b":",)),
    "recon": (ReconGrammar, (b"#",)),
    "imc": (ImcGrammar, (b"\x54\xfe", b"\xfe\x54")),
}
CASES: Final = [(wire, name) for wire in (*GRAMMARS, "slcan") for name in WORST_BYTES[wire]]
MAX_LINES_PER_BYTE: Final = 6.0


class _EveryCandidate:
    """A grammar that passes over nothing."""

    def __init__(self, wire: str) -> None:
        make, self._syncs = GRAMMARS[wire]
        self._grammar = make()
        self._wire = wire
        self.name = self._grammar.name
        self.head_bytes = self._grammar.head_bytes
        self.max_message_bytes = self._grammar.max_message_bytes
        self.proven = self._grammar.proven

    def find(self, buffer: bytearray, start: int, refused: Refused) -> int:
        if self._wire == "jsf":  # its header is a candidate only if it is plausible
            return next((at for at in range(start, len(buffer) - 15) if _plausible_jsf(buffer[at : at + 16])), -1)
        return min((at for at in (buffer.find(sync, start) for sync in self._syncs) if at >= 0), default=-1)

    def read(self, buffer: bytearray, at: int) -> tuple[Any, int] | int | str:
        alone = GRAMMARS[self._wire][0]().read(buffer, at)  # without sums from before
        if self._wire == "imc" and (alone == "checksum" or isinstance(alone, tuple)):
            order: Literal["little", "big"] = "little" if buffer[at] == 0x54 else "big"
            stop = at + 20 + int.from_bytes(buffer[at + 4 : at + 6], order)
            reported = int.from_bytes(buffer[stop : stop + 2], order)
            assert isinstance(alone, tuple) == (reported == crc16_arc(buffer[at:stop])), (
                "the checksum is that of the definition"
            )
        return alone

    def forget(self, n_bytes: int) -> None:
        pass


def _plausible_jsf(head: bytearray) -> bool:
    kind = int.from_bytes(head[4:6], "little")
    body_is_short = head[14] <= 3 and head[15] == 0
    return (
        head[:2] == b"\x01\x16"
        and head[2] <= 0x20
        and 1 <= kind < 0x2710
        and head[6] <= 3
        and head[8] <= 15
        and body_is_short
    )


def feed(grammar: Any, chunks: list[bytes]) -> tuple[list[tuple[Any, int, int]], Counter[str]]:
    framer: Framer[Any] = Framer(grammar)
    found = [framed for chunk in chunks for framed in framer.feed(chunk)] + framer.finish()
    return [(repr(message), offset, n_bytes) for message, offset, n_bytes in found], framer.counters


def pieces_of(wire: str) -> list[bytes]:
    syncs = GRAMMARS[wire][1]
    return [
        *WORST_BYTES[wire].values(),
        *syncs,
        *(sync[:1] for sync in syncs),
        b"\r\n",
        b"*",
        b"\0",
        b"\x0f",
        b"\x10\x00",
    ]


@st.composite
def streams(draw: st.DrawFn, wire: str) -> list[bytes]:
    """Worst bytes, intact messages of their kind and noise, cut up anyhow."""
    parts = []
    for _ in range(draw(st.integers(1, 8))):
        piece = draw(st.sampled_from(pieces_of(wire))) * draw(st.integers(1, 4))
        if draw(st.booleans()):
            at = draw(st.integers(0, len(piece) - 1))
            piece = piece[:at] + draw(st.binary(max_size=3)) + piece[at + draw(st.integers(0, 2)) :]
        parts.append(piece[: draw(st.integers(1, 700))])
        if draw(st.integers(0, 3)) == 0:
            parts.append(draw(st.sampled_from(INTACT[wire])))
    stream = b"".join(parts)
    cuts = sorted(draw(st.lists(st.integers(0, len(stream)), max_size=12)))
    return [stream[a:b] for a, b in zip([0, *cuts], [*cuts, len(stream)], strict=True)]


def _intact() -> dict[str, list[bytes]]:
    import numpy as np

    from sim_replay.fakes.framed_wires import WIRES

    random = np.random.Generator(np.random.PCG64(5))
    return {
        wire.name: [message for message in wire.messages(random, 8) if len(message) < 3000]
        for wire in WIRES
        if wire.name in GRAMMARS
    }


INTACT: Final = _intact()


@pytest.mark.parametrize("wire", GRAMMARS)
@given(data=st.data())
def test_passing_over_candidates_changes_neither_messages_nor_counters(wire: str, data: st.DataObject) -> None:
    chunks = data.draw(streams(wire))
    assert feed(GRAMMARS[wire][0](), chunks) == feed(_EveryCandidate(wire), chunks)
    whole = [b"".join(chunks)]
    assert feed(GRAMMARS[wire][0](), whole) == feed(_EveryCandidate(wire), whole)


def n_lines(work: Callable[[], object]) -> int:
    """Lines of Python that a call executes, itself included."""
    count = 0

    def trace(frame: FrameType, event: str, _: object) -> Any:
        nonlocal count
        count += event == "line"
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        work()
    finally:
        sys.settrace(before)
    return count


def framer_of(wire: str) -> Callable[[bytes], object]:
    return SlcanParser(Counter()).feed if wire == "slcan" else Framer(GRAMMARS[wire][0]()).feed


@pytest.mark.parametrize(("wire", "name"), CASES)
def test_worst_bytes_cost_a_bounded_number_of_steps_each(wire: str, name: str) -> None:
    piece = WORST_BYTES[wire][name]
    stream = piece * (16_384 // len(piece) + 1)
    feed_framer = framer_of(wire)
    feed_framer(piece)  # tables are made once

    def feed_all() -> None:
        for start in range(0, len(stream), 4096):
            feed_framer(stream[start : start + 4096])

    assert n_lines(feed_all) <= MAX_LINES_PER_BYTE * len(stream)
