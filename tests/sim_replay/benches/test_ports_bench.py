"""The bench of ports: its line carries what it is given, its garbage is none, and a real service is measured at it."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

from auv_mcm.cli import main
from drivers.framing import Framer
from drivers.sonar.ping_protocol import PingGrammar
from sim_replay.benches.ports import GARBAGE, PacedLine, cost, latency, pings, start_up

BAUD = 921_600


def test_a_line_carries_every_byte_and_knows_when_each_message_ended() -> None:
    messages = pings(20_000)
    with PacedLine(messages, BAUD) as line:
        reader = os.open(line.path, os.O_RDONLY | os.O_NOCTTY)
        received, ended_s = b"", []
        while len(received) < sum(map(len, messages)):
            received += os.read(reader, 1 << 16)
            ended_s.append(time.monotonic())
        os.close(reader)
    assert received == b"".join(messages)
    assert line.n_lost == 0
    assert len(line.sent_s) == len(messages)
    assert line.sent_s == sorted(line.sent_s)
    assert line.sent_s[-1] <= ended_s[-1]


def test_a_line_that_nobody_reads_loses_what_does_not_fit() -> None:
    with PacedLine([bytes(1 << 20)], 1 << 30) as line:
        while not line.sent_s:
            time.sleep(0.01)
    assert line.n_lost > 0


def test_pings_are_whole_and_garbage_is_none() -> None:
    framer = Framer(PingGrammar())
    assert len(framer.feed(b"".join(pings(100_000)))) == 100_000 // len(b"".join(pings(5_000))) * 2
    for messages in GARBAGE.values():
        garbage = b"".join(messages(100_000))
        assert len(garbage) == pytest.approx(100_000, abs=10)
        assert Framer(PingGrammar()).feed(garbage) == []


def test_a_service_is_measured_from_its_start_to_its_first_ping(tmp_path: Path) -> None:
    ready_s, decoded_s, taken_s = start_up(tmp_path / "run", BAUD)
    assert 0.0 < decoded_s <= taken_s
    assert 0.0 < ready_s <= taken_s


def test_pings_are_queued_while_perception_is_busy(tmp_path: Path) -> None:
    measured = latency(
        1, tmp_path / "run", 230_400
    )  # ten pings a second, each of which keeps perception busy for 80 ms
    assert measured.n_pings > 0
    assert measured.perception_share > 0.0
    assert list(measured.spikes_ms) == sorted(measured.spikes_ms)


def test_a_part_is_measured_without_the_others(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "ports", "--only", "pings", "--seconds", "1", "--repeat", "1"]) == 0
    kinds = [line.split()[0] for line in capsys.readouterr().out.splitlines()[2:]]
    assert kinds == ["pings"]


def test_a_service_takes_processor_time_for_pings(tmp_path: Path) -> None:
    measured = cost(pings(1_000_000), 1, tmp_path / "run", BAUD)
    assert measured.wake_ups_hz > 0.0
