"""However much a wire brings, a turn of the event loop decodes a bounded part of it, in order, and what finds no room
is counted."""

from __future__ import annotations

import asyncio
import itertools

from auv_mcm.clock import Stamp, SystemClock
from auv_mcm.records import Notice
from drivers.backlog import MAX_WAITING_BYTES, TURN_S, Backlog, Chunk
from drivers.port_source import PortSource
from tests.drivers.port_traffic import Collected, config_of

GENEROUS_S = 60.0
IMC = "ports: [{name: auv, link: 'tcp://127.0.0.1:9', device: imc}]"
JUNK = (b"\x54\xfe\x0f" * 500)[:1400]


def chunk(number: int, port: str = "a", n_bytes: int = 100) -> Chunk:
    return Chunk(port, bytes([number % 256]) * n_bytes, Stamp(number, number))


def test_a_turn_ends_when_its_processor_time_is_used_up_and_the_next_goes_on_in_order() -> None:
    cost_s = 0.4 * TURN_S
    readings = itertools.count(1)
    backlog = Backlog(lambda: next(readings) // 2 * cost_s)  # each chunk takes so long
    decoded: list[int] = []
    for number in range(10):
        assert backlog.add(chunk(number, "ab"[number % 2]))
    n_turns = 0
    while backlog:
        backlog.begin_turn()
        n_before = len(decoded)
        backlog.work(lambda one: decoded.append(one.stamp.mono_ns))
        n_turns += 1
        assert 1 <= len(decoded) - n_before <= 3
    assert decoded == list(range(10))
    assert n_turns == 4
    assert not backlog.n_refused


def test_a_port_that_floods_takes_no_room_from_others() -> None:
    backlog = Backlog(lambda: 0.0, max_waiting_bytes=2000)
    taken = [backlog.add(chunk(number)) for number in range(10)]
    assert taken == [True] * 5 + [False] * 5
    assert backlog.add(chunk(10, "b"))
    assert backlog.n_refused == {"a": 500}
    backlog.work(lambda one: None)
    assert backlog.add(chunk(11)), "room again"


def test_a_chunk_that_is_larger_than_the_room_is_taken_when_none_waits() -> None:
    backlog = Backlog(lambda: 0.0, max_waiting_bytes=50)
    assert backlog.add(chunk(1))
    assert not backlog.add(chunk(2))


def test_what_is_given_up_is_counted() -> None:
    backlog = Backlog(lambda: 0.0)
    backlog.add(chunk(1))
    backlog.give_up()
    assert not backlog
    assert backlog.n_refused == {"a": 100}


class Flood:
    """Make a source whose decoding takes half a turn for each chunk."""

    def __init__(self) -> None:
        self.recorded: list[bytes] = []
        readings = itertools.count(1)
        self.source = PortSource(config_of(IMC), SystemClock(), cpu_s=lambda: next(readings) // 2 * 0.5 * TURN_S)
        self.source.record_with(lambda port, direction, stamp, data: self.recorded.append(data))
        self.n_sent = 0

    def send(self, n_chunks: int) -> None:
        for _ in range(n_chunks):
            self.n_sent += 1
            self.source.take("auv", JUNK, Stamp(self.n_sent, self.n_sent))

    @property
    def n_skipped(self) -> int:
        return self.source.counters()["imc.bytes_skipped"]


def test_a_flood_leaves_every_turn_of_the_event_loop_to_others() -> None:
    flood = Flood()
    progress: list[int] = []

    async def main() -> None:
        flood.send(40)
        async with asyncio.timeout(GENEROUS_S):
            while not progress or progress[-1] < 39 * len(JUNK) - 4200:
                progress.append(flood.n_skipped)
                await asyncio.sleep(0)

    asyncio.run(main())
    assert len(progress) >= 15
    assert max(after - before for before, after in itertools.pairwise(progress)) <= 4 * len(JUNK), (
        "a bounded part in each turn"
    )
    assert b"".join(flood.recorded) == 40 * JUNK
    assert flood.source.counters()["port.auv.bytes_undecoded"] == 0


def test_a_flood_that_finds_no_room_is_recorded_counted_and_reported_once() -> None:
    flood = Flood()
    n_chunks = 2 * MAX_WAITING_BYTES // len(JUNK)
    sink = Collected()

    async def main() -> None:
        reading = asyncio.ensure_future(flood.source.run(sink))
        await asyncio.sleep(0)
        flood.send(n_chunks)
        flood.source.stop()
        async with asyncio.timeout(GENEROUS_S):
            await reading

    asyncio.run(main())
    reported = [event for event in sink.events if isinstance(event, Notice) and event.code == "port_flooded"]
    assert len(reported) == 1
    assert "port 'auv'" in reported[0].text
    assert reported[0].place == "auv"
    assert sum(data == JUNK for data in flood.recorded) == n_chunks, "all of it is recorded"
    n_undecoded = flood.source.counters()["port.auv.bytes_undecoded"]
    n_decoded = n_chunks * len(JUNK) - n_undecoded
    assert n_undecoded > 0
    assert flood.n_skipped <= n_decoded <= flood.n_skipped + 4200, "every byte was decoded or is counted"
