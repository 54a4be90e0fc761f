from __future__ import annotations

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim_replay.fakes.faults import FaultRates, Faults

MESSAGES = [bytes([n % 251]) * 100 for n in range(400)]


def came_through(faults: Faults) -> list[list[tuple[float, bytes]]]:
    return [faults.passed(message) for message in MESSAGES]


def test_without_faults_every_message_passes_as_it_is() -> None:
    assert came_through(Faults(FaultRates(), 1)) == [[(0.0, message)] for message in MESSAGES]


def test_the_same_seed_does_the_same_damage_and_another_does_not() -> None:
    rates = FaultRates(
        flip_byte=0.01, drop_byte=0.01, repeat_byte=0.01, lose=0.1, double=0.1, truncate=0.1, delay=0.1, delay_s=0.5
    )
    first, again, other = Faults(rates, 7), Faults(rates, 7), Faults(rates, 8)
    assert came_through(first) == came_through(again)
    assert first.counters == again.counters
    assert came_through(first) != came_through(other)


@pytest.mark.parametrize(
    ("rates", "name", "n_expected"),
    [
        (FaultRates(flip_byte=0.01), "fault.flipped", 400),
        (FaultRates(drop_byte=0.01), "fault.dropped", 400),
        (FaultRates(repeat_byte=0.01), "fault.repeated", 400),
        (FaultRates(lose=0.25), "fault.lost", 100),
        (FaultRates(double=0.25), "fault.doubled", 100),
        (FaultRates(truncate=0.25), "fault.truncated", 100),
        (FaultRates(delay=0.25, delay_s=1.0), "fault.delayed", 100),
    ],
)
def test_each_fault_does_as_named_at_its_set_rate(rates: FaultRates, name: str, n_expected: int) -> None:
    faults = Faults(rates, 3)
    passed = came_through(faults)
    assert 0.7 * n_expected <= faults.counters[name] <= 1.3 * n_expected
    assert +faults.counters == {name: faults.counters[name]}
    copies = [copy for message in passed for _, copy in message]
    n_bytes = sum(map(len, copies))
    match name:
        case "fault.flipped":
            bits = [
                (a ^ b).bit_count()
                for message, copy in zip(MESSAGES, copies, strict=True)
                for a, b in zip(message, copy, strict=True)
            ]
            assert sum(bits) == faults.counters[name]
            assert max(bits) == 1
        case "fault.dropped":
            assert n_bytes == 40_000 - faults.counters[name]
        case "fault.repeated":
            assert n_bytes == 40_000 + faults.counters[name]
        case "fault.lost":
            assert len(copies) == 400 - faults.counters[name]
        case "fault.doubled":
            assert len(copies) == 400 + faults.counters[name]
        case "fault.truncated":
            assert all(message.startswith(copy) for message, copy in zip(MESSAGES, copies, strict=True))
            assert sum(len(copy) < 100 for copy in copies) == faults.counters[name]
        case "fault.delayed":
            assert sum(0.0 < delay_s < 1.0 for message in passed for delay_s, _ in message) == faults.counters[name]


@given(st.binary(max_size=50), st.integers(0, 100))
def test_certain_loss_and_certain_damage(message: bytes, seed: int) -> None:
    assert Faults(FaultRates(lose=1.0), seed).passed(message) == []
    assert Faults(FaultRates(drop_byte=1.0), seed).passed(message) == [(0.0, b"")]
    doubled = b"".join(message[i : i + 1] * 2 for i in range(len(message)))
    assert Faults(FaultRates(repeat_byte=1.0), seed).passed(message) == [(0.0, doubled)]


@pytest.mark.parametrize("text", [b'{"lose": 1.5}', b'{"lose": -0.1}', b'{"loose": 0.1}', b'{"delay_s": -1.0}'])
def test_rates_that_make_no_sense_are_refused(text: bytes) -> None:
    with pytest.raises(msgspec.ValidationError):
        msgspec.json.decode(text, type=FaultRates)
