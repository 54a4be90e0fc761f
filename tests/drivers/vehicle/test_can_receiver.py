"""Frames of the vehicle's CAN bus, damaged, lost, repeated and out of order: what came whole is read, nothing else
is."""

from __future__ import annotations

from collections import Counter

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from drivers.links.can_frame import CanFrame
from drivers.vehicle.can_messages import (
    GRANTS,
    MESSAGES,
    TRANSFER_S,
    CanMessage,
    Record,
    StateMessage,
    VehicleStatus,
    can_id_of,
    crc16,
    encode,
)
from drivers.vehicle.can_receiver import CanReceiver
from tests.drivers.vehicle.can_traffic import random_record, records

PAYLOAD, VEHICLE = 96, 32
OF_PAYLOAD = tuple(message for message in MESSAGES if message.sender == "payload")
OF_VEHICLE = tuple(message for message in MESSAGES if message.sender == "vehicle")
TRANSFERS = tuple(message for message in OF_PAYLOAD if message.is_transfer)
N_FAULTS = 10_000
MESSAGES_PER_STREAM, FAULTS_PER_STREAM = 200, 100
KINDS = ("flip", "flip_many", "identifier", "drop", "duplicate", "truncate", "extend", "swap", "noise")


def read(receiver: CanReceiver, frames: list[CanFrame], now_s: float = 0.0) -> list[Record]:
    return [received.record for frame in frames if (received := receiver.add(frame, now_s)) is not None]


def payload_receiver() -> CanReceiver:
    return CanReceiver("can", "payload", PAYLOAD, Counter())


def flipped(data: bytes, n_bits: int, random: np.random.Generator) -> bytes:
    bits = int.from_bytes(data, "little")
    for place in random.choice(8 * len(data), n_bits, replace=False).tolist():
        bits ^= 1 << place
    return bits.to_bytes(len(data), "little")


def damaged(
    frames: list[tuple[int, CanFrame]], n_faults: int, random: np.random.Generator
) -> tuple[list[CanFrame], set[int], Counter[str]]:
    """Frames after faults, which messages were hit, and how often by kind. frames: with the number of their message."""
    hit: set[int] = set()
    n_by_kind: Counter[str] = Counter()
    stream: list[tuple[int, CanFrame] | None] = list(frames)
    extra: dict[int, list[CanFrame]] = {}
    for place in random.choice(len(frames), n_faults, replace=False).tolist():
        kind = KINDS[random.integers(len(KINDS))]
        n_by_kind[kind] += 1
        number, frame = frames[place]
        if kind == "swap":
            other = min(place + int(random.integers(1, 4)), len(frames) - 1)
            stream[place], stream[other] = stream[other], stream[place]
            continue
        if kind == "duplicate":
            extra.setdefault(place, []).append(frame)
            continue
        if kind == "noise":
            extra.setdefault(place, []).append(CanFrame(frame.can_id, random.bytes(8)))
            hit.add(number)  # in the middle of it, with its identifier: it may take the place of a part
            continue
        hit.add(number)
        if kind == "drop":
            changed = None
        elif kind == "identifier":
            changed = frame._replace(can_id=frame.can_id ^ 1 << int(random.integers(29)))
        elif kind == "truncate":
            changed = frame._replace(data=frame.data[: int(random.integers(8))])
        elif kind == "extend":
            changed = frame._replace(data=frame.data + random.bytes(4))
        else:
            n_bits = 1 if kind == "flip" else int(random.integers(2, 30))
            changed = frame._replace(data=flipped(frame.data, n_bits, random))
        # Swaps have moved frames about: the damage follows its frame.
        at = stream.index(frames[place])
        stream[at] = None if changed is None else (number, changed)
    made: list[CanFrame] = []
    for place, item in enumerate(stream):
        made += [item[1]] if item is not None else []
        made += extra.get(place, [])
    return made, hit, n_by_kind


def test_after_ten_thousand_faults_every_whole_message_was_read_and_no_other() -> None:
    n_faults: Counter[str] = Counter()
    n_intact = n_messages = seed = 0
    while n_faults.total() < N_FAULTS:
        random = np.random.Generator(np.random.PCG64([5, seed]))
        seed += 1
        sent = [random_record(OF_PAYLOAD[random.integers(len(OF_PAYLOAD))], random) for _ in range(MESSAGES_PER_STREAM)]
        frames = [(number, frame) for number, record in enumerate(sent) for frame in encode(record, PAYLOAD, number)]
        stream, hit, n_by_kind = damaged(frames, FAULTS_PER_STREAM, random)
        receiver = payload_receiver()
        found = Counter(read(receiver, stream))
        wanted = Counter(record for number, record in enumerate(sent) if number not in hit)
        assert wanted <= found, f"seed {seed - 1}: a whole message was not read"
        assert set(found) <= set(sent), f"seed {seed - 1}: a message that nobody sent"
        n_faults += n_by_kind
        n_intact += wanted.total()
        n_messages += len(sent)
    assert set(n_faults) == set(KINDS)
    assert n_intact > 0.5 * n_messages


@given(st.data(), st.lists(records(TRANSFERS), min_size=1, max_size=4))
def test_the_order_of_frames_does_not_matter(data: st.DataObject, sent: list[Record]) -> None:
    frames = [frame for sequence, record in enumerate(sent) for frame in encode(record, PAYLOAD, sequence)]
    found = read(payload_receiver(), data.draw(st.permutations(frames)))
    assert sorted(map(str, found)) == sorted(map(str, sent))


@given(records(TRANSFERS), st.data())
def test_a_transfer_without_one_of_its_frames_is_nothing(record: Record, data: st.DataObject) -> None:
    frames = encode(record, PAYLOAD, 7)
    del frames[data.draw(st.integers(0, len(frames) - 1))]
    receiver = payload_receiver()
    assert read(receiver, frames + frames) == []
    assert receiver.counters["can.refused.repeated"] == len(frames)


@given(st.data())
def test_halves_of_two_transfers_are_nothing_even_with_one_sequence_number(data: st.DataObject) -> None:
    message = data.draw(st.sampled_from([message for message in TRANSFERS if message.name != "HEALTH_TEXT"]))
    one, other = (encode(data.draw(records((message,))), PAYLOAD, 3) for _ in range(2))
    cut = data.draw(st.integers(1, len(one) - 1))
    mixed = one[:cut] + other[cut:]
    if mixed not in (one, other):
        receiver = payload_receiver()
        assert read(receiver, mixed) == []
        assert receiver.counters == {"can.refused.crc": 1}


def test_a_transfer_that_takes_too_long_is_dropped() -> None:
    record = StateMessage(54.0, 1.0, 10.0, 1.5, 3.0, 0.0, 5.0, 0.0)
    first, *others = encode(record, VEHICLE, 1)
    receiver = CanReceiver("can", "vehicle", VEHICLE, Counter())
    assert read(receiver, [first], 10.0) == []
    assert read(receiver, others, 10.0 + TRANSFER_S + 0.01) == []
    assert receiver.counters["can.refused.incomplete"] == 1
    assert read(receiver, [first], 10.0 + TRANSFER_S + 0.02) == [record]


@given(records(OF_VEHICLE))
def test_frames_of_others_are_counted_and_left_alone(record: Record) -> None:
    receiver = CanReceiver("can", "vehicle", VEHICLE, Counter())
    frames = encode(record, VEHICLE)
    foreign = [frame._replace(can_id=frame.can_id ^ 1) for frame in frames]
    short = [frame._replace(can_id=frame.can_id & 0x7FF, extended=False) for frame in frames]
    assert read(receiver, foreign + short) == []
    assert read(payload_receiver(), frames) == [], "the other side hears itself, on some adapters"
    assert receiver.counters == {"can.refused.foreign": len(frames), "can.ignored": len(frames)}
    other_priority = [frame._replace(can_id=frame.can_id ^ 1 << 26) for frame in frames]
    assert list(map(str, read(receiver, other_priority))) == [str(record)]


@given(
    st.lists(
        st.tuples(st.sampled_from(MESSAGES), st.integers(0, 255), st.binary(max_size=64), st.booleans()), max_size=60
    ),
    st.floats(0.0, 1.0),
)
def test_no_frames_raise_or_are_believed(frames: list[tuple[CanMessage, int, bytes, bool]], step_s: float) -> None:
    receiver = CanReceiver("can", "vehicle", VEHICLE, Counter())
    status = VehicleStatus(2, 0, 1, 1, 4, 200)
    for number, (message, address, data, extended) in enumerate(frames):
        receiver.add(CanFrame(can_id_of(message, address), data, extended), step_s * number)
        receiver.add(CanFrame(can_id_of(message, VEHICLE), data, extended), step_s * number)
    assert receiver.counters["can.messages"] == 0
    assert read(receiver, encode(status, VEHICLE)) == [status]


def test_a_value_out_of_range_is_refused_though_its_checksum_is_right() -> None:
    content = bytes((len(GRANTS), 0, 1, 0, 0, 0))
    frame = encode(VehicleStatus(0, 0, 1, 0, 0, 0), VEHICLE)[0]._replace(
        data=content + crc16(0x81, VEHICLE, content).to_bytes(2, "little")
    )
    receiver = CanReceiver("can", "vehicle", VEHICLE, Counter())
    assert read(receiver, [frame]) == []
    assert receiver.counters == {"can.refused.value": 1}
