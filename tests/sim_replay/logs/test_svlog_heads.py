"""Check that the two heads of an svlog, whatever they count and however they are stored, give two-sided pings."""

from __future__ import annotations

import tracemalloc
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.recording.session_layout import Recorded
from drivers.sonar.ping_messages import OsMonoProfile, encode
from drivers.sonar.ping_protocol import PingDecoder
from drivers.sonar.sonar_decoder import SonarFrame
from sim_replay.logs.svlog_recording import NMEA_PORT, SONAR_PORT, SvlogRecording
from sim_replay.wire_logs import nmea_packet, svlog_head

UTC_S: Final = 1_700_000_000.0
PERIOD_MS: Final = 80
POWERED_UP_MS: Final = 2_000  # before the first transmission
ECHO_S: Final = 0.04  # of 30 m
OFF: Final = 40  # transmissions that a head misses while it restarts
SIDES: Final = "PS"


class Log(NamedTuple):
    """What is recorded: the heads' offsets, how many profiles of a head are stored together, what is missing."""

    n_ahead: int = 0  # of starboard's ping numbers
    ms_ahead: int = 0  # of starboard's clock
    batch: int = 1
    lost: frozenset[tuple[str, int]] = frozenset()
    restarts: str = ""  # the heads that restart half way
    n: int = 400
    stalls: bool = False

    def ms(self, i: int) -> int:
        """When a transmission was sent; stalls make the intervals uneven."""
        return PERIOD_MS * i + (700 * (i // 37) if self.stalls else 0)

    def has(self, side: str, i: int) -> bool:
        return (side, i) not in self.lost and not (side in self.restarts and self.n // 2 <= i < self.n // 2 + OFF)

    def profile(self, side: str, i: int) -> bytes:
        """A profile whose number of results gives its transmission."""
        number, counter_ms = i + 100, POWERED_UP_MS + self.ms(i)
        if side == "S":
            number, counter_ms = number + self.n_ahead, counter_ms + self.ms_ahead
        if side in self.restarts and i >= self.n // 2:
            number, counter_ms = i - self.n // 2 - OFF + 1, 900 + self.ms(i) - self.ms(self.n // 2)
        values = np.full(10 + i, 1000 * SIDES.index(side) + i, dtype=np.uint16)
        head = (
            number,
            0,
            30_000,
            counter_ms % 2**32,
            450_000,
            3,
            15_000,
            SIDES.index(side),
            1e-4,
            1.0,
            80.0,
            0.0,
            0,
            0,
        )
        return encode(OsMonoProfile(*head, values))

    def packets(self) -> Iterable[bytes]:
        """The packets in the order in which they are stored, a sentence after each batch."""
        for first in range(0, self.n, self.batch):
            for side in SIDES:
                yield from (
                    self.profile(side, i) for i in range(first, min(first + self.batch, self.n)) if self.has(side, i)
                )
            yield nmea_packet(b"$XX,%d\r\n" % (min(first + self.batch, self.n) - 1))

    def wanted(self) -> list[tuple[int, str]]:
        sides = [(i, "".join(side for side in SIDES if self.has(side, i))) for i in range(self.n)]
        return [(i, there) for i, there in sides if there]


class Read(NamedTuple):
    """What came out: transmission, sides and time of the frames, and transmission and time of the sentences, ms."""

    frames: list[tuple[int, str]]
    times_ms: list[float]
    sentences: list[tuple[int, float]]
    counters: Counter[str]


def read(path: Path, chunk_bytes: int = 1 << 20) -> Read:
    recording = SvlogRecording(path, None, chunk_bytes)
    decoder = PingDecoder()
    frames: list[SonarFrame] = []
    sentences: list[tuple[int, float]] = []
    for recorded in recording:
        if recorded.port == SONAR_PORT:
            frames += [item for item in decoder.feed(recorded.data, recorded.stamp) if isinstance(item, SonarFrame)]
        else:
            assert recorded.port == NMEA_PORT
            sentences.append((int(recorded.data[4:]), _ms(recorded)))
    frames += [item for item in decoder.finish() if isinstance(item, SonarFrame)]
    found = [(_transmission(frame), "P" * bool(frame.port) + "S" * bool(frame.starboard)) for frame in frames]
    times_ms = [1e-6 * frame.received.utc_ns - 1e3 * (UTC_S + ECHO_S) for frame in frames]
    return Read(found, times_ms, sentences, recording.counters + decoder.counters)


def _ms(recorded: Recorded) -> float:
    return 1e-6 * recorded.stamp.utc_ns - 1e3 * (UTC_S + ECHO_S)


def _transmission(frame: SonarFrame) -> int:
    there = {len(trace.samples) - 10 for trace in (frame.port, frame.starboard) if trace is not None}
    assert len(there) == 1, "the sides are of one transmission"
    return there.pop()


def written(log: Log, path: Path) -> Path:
    path.write_bytes(svlog_head(UTC_S) + b"".join(log.packets()))
    return path


def check(log: Log, path: Path) -> Read:
    result = read(written(log, path))
    assert result.frames == log.wanted()
    first = log.ms(log.wanted()[0][0])
    assert result.times_ms == pytest.approx([log.ms(i) - first for i, _ in log.wanted()], abs=1.5)
    assert result.sentences == sorted(result.sentences)
    return result


@pytest.mark.parametrize("batch", [1, 2, 5, 20])
@pytest.mark.parametrize("n_ahead", [0, 60, -7])
@pytest.mark.parametrize("ms_ahead", [0, 30, -30, 500, -900, 1737, -1990, 3_600_000, -2_005])
def test_both_sides_of_every_transmission_become_one_ping(
    batch: int, n_ahead: int, ms_ahead: int, tmp_path: Path
) -> None:
    result = check(Log(n_ahead, ms_ahead, batch), tmp_path / "log")
    assert result.counters["reader.sonar_restarted"] == 0


@pytest.mark.parametrize("batch", [1, 2, 5])
@pytest.mark.parametrize("n_ahead", [1, -1])
@pytest.mark.parametrize("ms_ahead", [0, 30, -30])
def test_heads_that_differ_by_one_ping_are_paired_by_their_clocks(
    batch: int, n_ahead: int, ms_ahead: int, tmp_path: Path
) -> None:
    check(Log(n_ahead, ms_ahead, batch), tmp_path / "log")


@pytest.mark.parametrize("batch", [1, 2, 3, 5, 20])
def test_sentences_have_the_time_of_the_batch_that_they_follow(batch: int, tmp_path: Path) -> None:
    result = check(Log(batch=batch), tmp_path / "log")
    late = [at_ms - PERIOD_MS * i for i, at_ms in result.sentences]
    assert min(late) >= 0.0
    assert max(late) <= PERIOD_MS + 1.5


@given(
    batch=st.sampled_from([1, 2, 3, 5, 20]),
    n_ahead=st.sampled_from([0, 60, -7, 3000]),
    ms_ahead=st.sampled_from([0, 25, -25, 400, -900, 1737, 60_000]),
    lost=st.frozensets(st.tuples(st.sampled_from(SIDES), st.integers(min_value=20, max_value=399)), max_size=120),
    stalls=st.booleans(),
)
@settings(max_examples=25, deadline=None)
def test_whatever_is_lost_the_rest_is_paired(
    batch: int,
    n_ahead: int,
    ms_ahead: int,
    lost: frozenset[tuple[str, int]],
    stalls: bool,
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    check(Log(n_ahead, ms_ahead, batch, lost, stalls=stalls), tmp_path_factory.getbasetemp() / "log")


@pytest.mark.parametrize("batch", [1, 2, 5])
@pytest.mark.parametrize("n_ahead", [0, 60])
@pytest.mark.parametrize("ms_ahead", [0, 500, 1737])
@pytest.mark.parametrize("restarts", ["P", "S"])
def test_a_head_that_restarts_is_paired_again(
    batch: int, n_ahead: int, ms_ahead: int, restarts: str, tmp_path: Path
) -> None:
    """All but those of the batch in which it comes back, and the other head's clock goes on."""
    log = Log(n_ahead, ms_ahead, batch, restarts=restarts)
    result = read(written(log, tmp_path / "log"))
    back = log.n // 2 + OFF
    assert [one for one in result.frames if abs(one[0] - back) > batch] == [
        one for one in log.wanted() if abs(one[0] - back) > batch
    ]
    assert {i for i, _ in result.frames} == set(range(log.n))
    apart_ms = [at_ms - log.ms(i) for (i, _), at_ms in zip(result.frames, result.times_ms, strict=True)]
    assert max(map(abs, apart_ms)) <= batch * PERIOD_MS
    assert [apart for (i, _), apart in zip(result.frames, apart_ms, strict=True) if abs(i - back) > batch] == (
        pytest.approx([0.0] * sum(abs(i - back) > batch for i, _ in result.frames), abs=1.5)
    )
    assert result.counters["reader.sonar_restarted"] == 0


@pytest.mark.parametrize("n_ahead", [0, 60])
def test_heads_that_both_restart_are_paired_and_it_is_reported(n_ahead: int, tmp_path: Path) -> None:
    log = Log(n_ahead, 500, 5, restarts="PS")
    result = read(written(log, tmp_path / "log"))
    assert result.frames == log.wanted()
    assert np.diff(result.times_ms).min() >= 0.0
    assert result.counters["reader.sonar_restarted"] == 1


@pytest.mark.parametrize("n", [1, 3, 7])
def test_a_log_too_short_to_compare_the_heads_is_read_in_its_order(n: int, tmp_path: Path) -> None:
    assert check(Log(n=n), tmp_path / "log").counters["pairing.lone_port"] == 0
    assert [i for i, _ in read(written(Log(n=n, batch=2), tmp_path / "batched")).frames]


@pytest.mark.parametrize("side", SIDES)
def test_a_single_head_is_read_in_its_order(side: str, tmp_path: Path) -> None:
    other = "S" if side == "P" else "P"
    log = Log(lost=frozenset((other, i) for i in range(400)))
    result = read(written(log, tmp_path / "log"))
    assert [i for i, _ in result.frames] == list(range(400))


def test_a_head_that_is_switched_on_late_is_paired(tmp_path: Path) -> None:
    check(Log(60, 900, 3, lost=frozenset(("S", i) for i in range(300)), n=900), tmp_path / "log")


def test_numbers_that_stand_still_are_paired_as_they_come(tmp_path: Path) -> None:
    log = Log()
    path = tmp_path / "log"
    parts = []
    for i in range(log.n):
        for side in SIDES:
            packet = log._replace(n_ahead=0).profile(side, i)
            parts.append(packet[:8] + bytes(4) + packet[12:-2])
    path.write_bytes(svlog_head(UTC_S) + b"".join(p + (sum(p) & 0xFFFF).to_bytes(2, "little") for p in parts))
    assert read(path).frames == log.wanted()


@pytest.mark.parametrize("chunk_bytes", [4096, 1 << 22])
def test_the_reading_does_not_depend_on_the_chunks(chunk_bytes: int, tmp_path: Path) -> None:
    path = written(Log(60, 500, 3, frozenset({("P", 50), ("S", 51)}), "S"), tmp_path / "log")
    assert read(path, chunk_bytes) == read(path)


def test_no_more_than_a_stretch_is_kept(tmp_path: Path) -> None:
    """A head that falls silent, and one that repeats itself for ever."""
    log = Log(60, 500, 3, n=500)
    head = svlog_head(UTC_S) + b"".join(log.packets())
    longer = log._replace(n=5000)
    parts: dict[str, Callable[[int], bytes]] = {
        "silent": lambda i: longer.profile("P", 500 + i),
        "repeated": lambda i: longer.profile("P", 500),
    }
    for name, part in parts.items():
        path = tmp_path / name
        path.write_bytes(head + b"".join(part(i) for i in range(4000)))
        tracemalloc.start()
        for _ in SvlogRecording(path, None, 1 << 16):
            pass
        peak_bytes = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak_bytes < path.stat().st_size // 2
