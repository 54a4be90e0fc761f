"""Whatever a cable does to a stream, the next intact message is read; how the stream was cut into chunks makes no
difference."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Hashable
from typing import Any, Final

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.clock import Stamp
from drivers.framing import Framed, Framer, Grammar, StampedFramer
from drivers.navigation.dvl_pd6 import LineGrammar
from drivers.navigation.dvl_water_linked import TextGrammar, WaterLinkedAttitude, message_of
from drivers.navigation.nmea0183 import NmeaGrammar, sentence
from drivers.sonar.imagenex import IgxGrammar, IgxReturn, encode_return
from drivers.sonar.jsf import JsfGrammar
from drivers.sonar.jsf_messages import JsfMessage, SideScanData, SideScanHeader, encode_data
from drivers.sonar.jsf_messages import to_wire as jsf_to_wire
from drivers.sonar.ping_messages import AsciiText, OsMonoProfile, encode
from drivers.sonar.ping_protocol import PingGrammar
from tests.drivers.navigation.nav_damage import chunks_of, is_subsequence

Read = list[tuple[Hashable, int, int]]


def _profile(number: int, n: int) -> bytes:
    results = (np.arange(n) * 7919 + number * 104729).astype(np.uint16)
    return encode(
        OsMonoProfile(
            number, 0, 50_000, number * 67, 450_000, 3, 15_000, number & 1, 1e-4, 1.0, -10.0, -90.0, 0.0, 0.0, results
        )
    )


def _side(number: int, n: int) -> bytes:
    values = (np.arange(n) * 7919 + number * 104729).astype(np.uint16)
    return encode_data(SideScanData(SideScanHeader(ping_number=number, interval_ns=20_000), values), 21, number & 1)


def _nmea_in_jsf(number: int, n: int) -> bytes:
    return jsf_to_wire(JsfMessage(2002, number.to_bytes(4, "little") + bytes(n)))


def _igx(number: int, n: int) -> bytes:
    return encode_return(IgxReturn(30, 3, ((np.arange(400) * (n + 3) + number * 31) % 128).astype(np.uint8)))


def _text(number: int, n: int) -> bytes:
    return encode(AsciiText(f"{number} BR" * (n % 5)))


def _sentence(number: int, n: int) -> bytes:
    return sentence(f"SDDPT,{number}.{n},0.5")


def _pd6(number: int, n: int) -> bytes:
    return b":BD,+%011.2f,+00000001.20,-00000000.50, %5.2f,  0.00\r\n" % (number, n)


def _water_linked(number: int, n: int) -> bytes:
    return message_of(WaterLinkedAttitude(1.7e9 + number, 1.0, 2.0, 3.0, 0.1 * n, 0.1, -0.2, 3.0, 0))


def _key(message: Any) -> Hashable:
    return message.echo.tobytes() if isinstance(message, IgxReturn) else tuple(message)


Maker = Callable[[int, int], bytes]
FORMATS: Final[dict[str, tuple[Callable[[], Grammar[Any]], tuple[Maker, ...]]]] = {
    "ping_protocol": (PingGrammar, (_profile, _profile, _text)),
    "jsf": (JsfGrammar, (_side, _side, _nmea_in_jsf)),
    "sportscan": (IgxGrammar, (_igx,)),
    "nmea": (NmeaGrammar, (_sentence,)),
    "pd6": (LineGrammar, (_pd6,)),
    "water_linked": (TextGrammar, (_water_linked,)),
}
LINES: Final = ("nmea", "pd6", "water_linked")
MARKS: Final = (b"BR", b"\x01\x16", b"IGX", b"\xfc", b"$", b"!", b"$GPGGA,", b"*", b"*4", b":", b":BI,", b"w", b"wrz,")
every_format = pytest.mark.parametrize("name", FORMATS)


def read(grammar: Callable[[], Grammar[Any]], chunks: list[bytes]) -> tuple[Read, Counter[str]]:
    framer: Framer[Any] = Framer(grammar())
    found: list[Framed[Any]] = []
    for chunk in chunks:
        found += framer.feed(chunk)
    found += framer.finish()
    return [(_key(message), offset, n_bytes) for message, offset, n_bytes in found], framer.counters


def keys(found: Read) -> list[Hashable]:
    return [key for key, _, _ in found]


@st.composite
def message(draw: st.DrawFn, name: str) -> bytes:
    maker = draw(st.sampled_from(FORMATS[name][1]))
    return maker(draw(st.integers(0, 60_000)), draw(st.integers(1, 40)))


@st.composite
def pieces(draw: st.DrawFn, name: str) -> list[tuple[bytes, bool]]:
    """Intact messages between the remains of others and noise; whether each piece is intact."""
    found: list[tuple[bytes, bool]] = []
    for _ in range(draw(st.integers(1, 8))):
        kind = draw(st.sampled_from(["intact", "intact", "noise", "cut", "head", "tail", "flipped", "inserted"]))
        piece = draw(message(name))
        at = draw(st.integers(1, len(piece) - 1))
        if kind == "noise":
            piece = draw(st.lists(st.one_of(st.binary(max_size=9), st.sampled_from(MARKS)), max_size=8).map(b"".join))
        elif kind == "cut":
            piece = piece[:at] + piece[at + draw(st.integers(1, 30)) :]
        elif kind == "head":
            piece = piece[:at]
        elif kind == "tail":
            piece = piece[at:]
        elif kind == "flipped":
            piece = piece[:at] + bytes((piece[at] ^ 1 << draw(st.integers(0, 7)),)) + piece[at + 1 :]
        elif kind == "inserted":
            piece = piece[:at] + draw(st.binary(min_size=1, max_size=5)) + piece[at:]
        found.append((piece, kind == "intact"))
    return found


def slow_ping_messages(stream: bytes) -> list[tuple[int, int]]:
    """Offsets and lengths of all messages that do not begin inside another: try every byte."""
    found, at = [], 0
    while at + 10 <= len(stream):
        n = 10 + stream[at + 2] + 256 * stream[at + 3]
        kind = stream[at + 4] + 256 * stream[at + 5]
        good = stream[at : at + 2] == b"BR" and at + n <= len(stream)
        good = good and sum(stream[at : at + n - 2]) % 65536 == stream[at + n - 2] + 256 * stream[at + n - 1]
        if kind == 2198:
            good = good and n - 10 - 52 == 2 * (stream[at + 30] + 256 * stream[at + 31])
        elif kind == 3:
            good = good and n - 10 <= 1024
        if good:
            found.append((at, n))
        at += n if good else 1
    return found


@pytest.mark.parametrize("name", [name for name in FORMATS if name not in LINES])
def test_a_clean_stream_gives_every_message_and_skips_nothing(name: str) -> None:
    grammar, makers = FORMATS[name]
    wired = [makers[i % len(makers)](i, 10 + i) for i in range(30)]
    found, counters = read(grammar, [b"".join(wired)])
    assert [n for _, _, n in found] == [len(wire) for wire in wired]
    assert [offset for _, offset, _ in found] == [sum(map(len, wired[:i])) for i in range(30)]
    assert counters == {f"{name}.messages": 30}


@every_format
@given(data=st.data())
def test_every_intact_message_is_read_whatever_is_around_it(name: str, data: st.DataObject) -> None:
    grammar, _ = FORMATS[name]
    parts = data.draw(pieces(name))
    wanted = [keys(read(grammar, [piece])[0])[0] for piece, intact in parts if intact]
    stream = b"".join(piece for piece, _ in parts)
    assert is_subsequence(wanted, keys(read(grammar, data.draw(chunks_of(stream)))[0]))


@every_format
@given(data=st.data())
def test_chunks_make_no_difference(name: str, data: st.DataObject) -> None:
    grammar, _ = FORMATS[name]
    stream = b"".join(piece for piece, _ in data.draw(pieces(name)))
    whole, *others = (
        read(grammar, chunks)
        for chunks in ([stream], data.draw(chunks_of(stream)), [stream[i : i + 1] for i in range(len(stream))])
    )
    for other in others:
        assert keys(other[0]) == keys(whole[0])
        assert other == whole or name in LINES, "the end of a line may come with the next chunk"


@every_format
@given(data=st.data())
def test_every_byte_is_in_a_message_or_counted_as_skipped(name: str, data: st.DataObject) -> None:
    grammar, _ = FORMATS[name]
    stream = b"".join(piece for piece, _ in data.draw(pieces(name)))
    found, counters = read(grammar, data.draw(chunks_of(stream)))
    taken = np.zeros(len(stream), dtype=np.bool_)
    for _, offset, n_bytes in found:
        taken[offset : offset + n_bytes] = True
    assert counters[f"{name}.bytes_skipped"] == np.count_nonzero(~taken)
    assert counters[f"{name}.messages"] == len(found)


@given(data=st.data())
def test_ping_messages_are_those_that_trying_every_byte_finds(data: st.DataObject) -> None:
    stream = b"".join(piece for piece, _ in data.draw(pieces("ping_protocol")))
    found, _ = read(PingGrammar, data.draw(chunks_of(stream)))
    assert [(offset, n) for _, offset, n in found] == slow_ping_messages(stream)


@every_format
@given(stream=st.lists(st.one_of(st.binary(max_size=60), st.sampled_from(MARKS)), max_size=40).map(b"".join))
def test_no_bytes_raise_or_stay(name: str, stream: bytes) -> None:
    grammar, makers = FORMATS[name]
    framer: Framer[Any] = Framer(grammar())
    framer.feed(stream)
    assert framer.n_fed - framer.held_from <= grammar().max_message_bytes
    framer.finish()
    assert framer.held_from == framer.n_fed == len(stream)
    assert len(framer.feed(makers[0](1, 20))) == 1, "a new stream begins behind the end of the old one"


@every_format
def test_memory_stays_bounded_by_the_longest_message(name: str) -> None:
    grammar, makers = FORMATS[name]
    random = np.random.Generator(np.random.PCG64(3))
    promise = makers[0](1, 30)[:-5]
    framer: Framer[Any] = Framer(grammar())
    for _ in range(200):
        framer.feed(promise + random.bytes(int(random.integers(3000))))
        assert framer.n_fed - framer.held_from <= grammar().max_message_bytes


@every_format
def test_a_message_cut_off_by_the_end_hides_none_inside_it(name: str) -> None:
    grammar, makers = FORMATS[name]
    first, second = makers[0](1, 40), makers[0](2, 5)
    found, counters = read(grammar, [first[: len(first) // 2] + second])
    assert keys(found) == keys(read(grammar, [second])[0])
    assert sum(n for reason, n in counters.items() if ".refused." in reason) >= 1


def test_a_message_without_checksum_is_given_at_once_and_gives_back_what_it_swallowed() -> None:
    first, second = _nmea_in_jsf(1, 30), _side(2, 20)
    for n_lost in range(1, 16):
        framer: Framer[Any] = Framer(JsfGrammar())
        n_at_once = len(framer.feed(first[:-n_lost] + second[:n_lost]))
        assert n_at_once == 1, "nothing shows yet that it is damaged"
        assert [framed.n_bytes for framed in framer.feed(second[n_lost:])] == [len(second)]


def test_samples_that_look_like_a_header_do_not_cost_the_message() -> None:
    values = np.frombuffer(_nmea_in_jsf(9, 100)[:16] + bytes(184), np.uint16)
    looks_nested = encode_data(SideScanData(SideScanHeader(interval_ns=20_000), values), 21, 0)
    found, counters = read(JsfGrammar, [looks_nested + _side(1, 20)])
    assert [n for _, _, n in found] == [len(looks_nested), len(_side(1, 20))]
    assert counters == {"jsf.messages": 2}


def test_stamps_are_those_of_the_chunk_with_the_last_byte_even_if_proven_later() -> None:
    wire = _profile(1, 20)
    false_start = encode(AsciiText("x" * 400))[:12]
    framer: StampedFramer[Any] = StampedFramer(PingGrammar())
    stamps = [Stamp(i, 1000 + i) for i in range(20)]
    assert framer.feed(false_start + wire[:50], stamps[0]) == []
    assert framer.feed(wire[50:] + b"abc", stamps[1]) == [], "still inside what the false start promised"
    found = [arrived for stamp in stamps[2:] for arrived in framer.feed(bytes(50), stamp)]
    (arrived,) = found
    assert arrived.received == stamps[1]
    assert arrived.n_bytes == len(wire) + 3


@given(data=st.data())
def test_every_message_is_stamped_by_its_last_byte(data: st.DataObject) -> None:
    stream = b"".join(piece for piece, _ in data.draw(pieces("ping_protocol")))
    chunks = [chunk for chunk in data.draw(chunks_of(stream)) if chunk]
    framer: StampedFramer[Any] = StampedFramer(PingGrammar())
    arrived = [item for i, chunk in enumerate(chunks) for item in framer.feed(chunk, Stamp(i, i))] + framer.finish()
    ends = np.cumsum([len(chunk) for chunk in chunks])
    for (_, offset, n_bytes), item in zip(read(PingGrammar, [stream])[0], arrived, strict=True):
        chunk = int(np.searchsorted(ends, offset + n_bytes))
        assert item.received.mono_ns == chunk
        assert item.n_bytes == ends[chunk] - offset
