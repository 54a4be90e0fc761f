"""Check the text of a CAN adapter: golden frames, damage, and cuts anywhere."""

from __future__ import annotations

from collections import Counter

import pytest
from can.interfaces.slcan import slcanBus
from hypothesis import example, given, settings
from hypothesis import strategies as st

from drivers.links.can_frame import CanFrame
from drivers.links.slcan import MAX_LINE_BYTES, SlcanParser, encode

POSITION = CanFrame(0x09F80103, bytes.fromhex("406dab1cc0b9da06"))
GOLDEN = {
    b"T09F801038406DAB1CC0B9DA06\r": POSITION,
    b"t7FF0\r": CanFrame(0x7FF, b"", extended=False),
    b"t1232AABB\r": CanFrame(0x123, b"\xaa\xbb", extended=False),
    b"T1FFFFFFF100\r": CanFrame(0x1FFFFFFF, b"\x00"),
}
DATA = st.binary(max_size=8)
FRAMES = st.builds(CanFrame, st.integers(0, 0x1FFFFFFF), DATA, st.just(True)) | st.builds(
    CanFrame, st.integers(0, 0x7FF), DATA, st.just(False)
)
TEXT_ALPHABET = st.sampled_from(b"tTrRzZVNF0123456789ABCDEFabcdef\r\a\x00\xc3")
GARBAGE = st.binary(max_size=60) | st.lists(TEXT_ALPHABET, max_size=80).map(bytes)


def parsed(*chunks: bytes) -> tuple[list[CanFrame], Counter[str]]:
    parser = SlcanParser(Counter())
    frames = [frame for chunk in chunks for frame in parser.feed(chunk)]
    return frames, +parser.counters


@pytest.mark.parametrize("text", GOLDEN)
def test_golden_frames_are_read_and_written(text: bytes) -> None:
    assert parsed(text)[0] == [GOLDEN[text]]
    assert parsed(text.replace(b"t", b"#").replace(b"T", b"!").lower().replace(b"#", b"t").replace(b"!", b"T"))[0] == [
        GOLDEN[text]
    ]
    assert encode(GOLDEN[text]) == text


@settings(max_examples=30)
@given(FRAMES)
def test_what_is_written_is_read_again_and_python_can_reads_the_same(frame: CanFrame) -> None:
    assert parsed(encode(frame)) == ([frame], Counter({"slcan.frames": 1}))
    oracle = slcanBus(channel="loop://", sleep_after_open=0.0, bitrate=250000)
    try:
        oracle.serialPortOrig.reset_input_buffer()
        oracle.serialPortOrig.write(encode(frame))
        message = oracle.recv(timeout=0.1)
    finally:
        oracle.shutdown()
    assert message is not None
    assert (message.arbitration_id, bytes(message.data), message.is_extended_id) == frame


@given(GARBAGE, st.lists(FRAMES, min_size=1, max_size=4))
@example(b"T09F801038406DAB1CC0B9DA06", [POSITION])  # its end is lost
@example(b"T09F8010384", [POSITION])
@example(b"\xc3", [POSITION])
@example(b"0" * 1000, [POSITION])
def test_the_next_intact_frame_is_read_whatever_stood_before(garbage: bytes, frames: list[CanFrame]) -> None:
    found, _ = parsed(garbage + b"".join(map(encode, frames)))
    assert found[len(found) - len(frames) :] == frames


@given(st.lists(FRAMES, min_size=2, max_size=6), st.data())
def test_damage_to_one_frame_leaves_the_others(frames: list[CanFrame], data: st.DataObject) -> None:
    texts = [encode(frame) for frame in frames]
    hit = data.draw(st.integers(0, len(frames) - 1))
    at = data.draw(st.integers(0, len(texts[hit]) - 1))
    kind = data.draw(st.sampled_from(["flip", "drop", "insert", "truncate"]))
    byte = data.draw(st.integers(0, 255))
    head, old, tail = texts[hit][:at], texts[hit][at], texts[hit][at + 1 :]
    texts[hit] = {
        "flip": head + bytes([old ^ (1 << byte % 8)]) + tail,
        "drop": head + tail,
        "insert": head + bytes([byte, old]) + tail,
        "truncate": head,
    }[kind]
    found, _ = parsed(b"".join(texts))
    assert found[:hit] == frames[:hit]
    after = frames[hit + 1 :]
    assert found[len(found) - len(after) :] == after


@given(st.lists(GARBAGE | FRAMES.map(encode), max_size=6))
def test_cuts_between_chunks_make_no_difference(pieces: list[bytes]) -> None:
    whole = b"".join(pieces)
    assert parsed(*pieces) == parsed(whole)
    assert parsed(*(whole[i : i + 1] for i in range(len(whole)))) == parsed(whole)


@given(GARBAGE)
def test_every_line_is_a_frame_or_counted(garbage: bytes) -> None:
    text = garbage.replace(b"\a", b"") + b"\r"
    found, counters = parsed(text)
    del counters["slcan.refused.before_frame"]
    assert counters["slcan.frames"] == len(found)
    assert counters.total() == text.count(b"\r")


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (b"T09F801038406DAB1CC0B9DA0\r", "slcan.refused.line"),
        (b"T09F801038406DAB1CC0B9DA\r", "slcan.refused.length"),
        (b"T09F8010380\r", "slcan.refused.line"),
        (b"T09F801037406DAB1CC0B9DA06\r", "slcan.refused.length"),
        (b"T09F801039406DAB1CC0B9DA06\r", "slcan.refused.line"),
        (b"T9F80103840 6DAB1CC0B9DA06\r", "slcan.refused.line"),
        (b"TFFFFFFFF0\r", "slcan.refused.identifier"),
        (b"t8000\r", "slcan.refused.identifier"),
        (b"hello\r", "slcan.refused.line"),
        (b"T09F801038406D\xc31CC0B9DA06\r", "slcan.refused.line"),
        (b"T09F801038406DAB1CC0B9DA06\a", "slcan.refused.line"),
        (b"9" * 500 + b"\r", "slcan.refused.line"),
    ],
)
def test_what_is_not_a_frame_is_counted_by_reason(text: bytes, reason: str) -> None:
    found, counters = parsed(text)
    assert not found
    assert counters[reason] == 1


def test_a_frame_that_lost_a_character_is_not_taken_for_another() -> None:
    """Measured on a driver in use: 0x09F80103 with a digit lost was read as 0x9F801038 without data."""
    assert parsed(b"T9F801038406DAB1CC0B9DA06\r")[0] == []


def test_answers_and_refusals_of_the_adapter_are_distinguished_from_frames() -> None:
    found, counters = parsed(b"\r\r\az\rZ\rV1013\rNF4KE\rF80\r\ar1232\rR000001230\r" + encode(POSITION))
    assert found == [POSITION]
    assert counters == {"slcan.answers": 7, "slcan.refusals": 2, "slcan.remote": 2, "slcan.frames": 1}


def test_an_endless_line_is_not_kept() -> None:
    parser = SlcanParser(Counter())
    for _ in range(100):
        assert parser.feed(b"7" * 65536) == []
    assert len(parser._rest) <= MAX_LINE_BYTES
    assert parser.feed(b"\r" + encode(POSITION)) == [POSITION]


@pytest.mark.parametrize(
    "frame", [CanFrame(0x20000000, b""), CanFrame(0x800, b"", extended=False), CanFrame(-1, b""), CanFrame(1, bytes(9))]
)
def test_frames_that_no_bus_carries_are_not_written(frame: CanFrame) -> None:
    with pytest.raises(ValueError, match="not a frame of a classic CAN bus"):
        encode(frame)


@pytest.mark.parametrize("extended", [False, True])
@pytest.mark.parametrize("n_data", [0, 1, 8])
def test_time_stamps_are_taken_off_an_adapter_that_sends_them(extended: bool, n_data: int) -> None:
    counters: Counter[str] = Counter()
    parser = SlcanParser(counters)
    sent = [CanFrame(0x123 + n, bytes(range(n_data)), extended) for n in range(20)]
    text = b"".join(encode(frame)[:-1] + b"%04X\r" % (17 * n) for n, frame in enumerate(sent))
    assert parser.feed(text[:50]) + parser.feed(text[50:]) == sent[2:]
    assert counters["slcan.time_stamps"] == 18
    assert counters["slcan.refused.length"] == 2
    plain = b"".join(map(encode, sent))
    assert parser.feed(plain) == sent[2:], "an adapter that was set up anew"


def test_a_damaged_length_among_plain_frames_is_no_time_stamp() -> None:
    counters: Counter[str] = Counter()
    parser = SlcanParser(counters)
    sent = [CanFrame(0x1ABCDE, bytes(8), True) for _ in range(7)]
    text = bytearray(b"".join(map(encode, sent)))
    for n in (1, 3, 5):
        text[n * 27 + 9] = ord("6")
    assert parser.feed(bytes(text)) == sent[:4]
    assert counters["slcan.refused.length"] == 3
