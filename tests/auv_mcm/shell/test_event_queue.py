"""The queue is bounded: a source that can wait is held back, and of one that cannot the oldest event of a kind is
dropped."""

from __future__ import annotations

import asyncio
from collections import Counter
from itertools import zip_longest

from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.records import Ping, SourceEvent
from auv_mcm.shell.event_queue import EventQueue, Queued
from tests.auv_mcm.shell import fake_pipelines as fake


@given(st.lists(st.booleans(), max_size=300), st.integers(1, 6), st.lists(st.integers(0, 3), max_size=300))
def test_a_chatty_navigation_wire_displaces_no_ping(is_ping: list[bool], max_pings: int, n_taken: list[int]) -> None:
    """Pings and others come and are taken in any order: each kind keeps the newest that fit in its own room."""

    async def run() -> None:
        counters: Counter[str] = Counter()
        seen: list[SourceEvent] = []

        def see(event: SourceEvent) -> int:
            seen.append(event)
            return len(seen)

        queue = EventQueue(max_pings, counters, see)
        expected: list[tuple[int, bool]] = []
        n_dropped: Counter[str] = Counter()
        for number, (ping, n) in enumerate(zip_longest(is_ping, n_taken)):
            if ping is None:
                break
            queue.push(fake.ping(number) if ping else fake.navigation(number))
            expected.append((number, ping))
            of_kind = [entry for entry in expected if entry[1] == ping]
            if len(of_kind) > max_pings * (1 if ping else 16):
                expected.remove(of_kind[0])
                n_dropped["service.ping_dropped" if ping else "service.event_dropped"] += 1
            for _ in range(min(n or 0, len(expected))):
                taken = await queue.get()
                assert taken is not None
                number, was_ping = expected.pop(0)
                assert taken.number == number + 1
                assert taken.event.time_s == fake.START_S + number  # type: ignore[union-attr]
                assert isinstance(taken.event, Ping) == was_ping
        assert counters == n_dropped
        assert len(seen) == len(is_ping), "what is dropped was seen all the same"
        assert queue.pings == sum(ping for _, ping in expected)

    asyncio.run(run())


def test_a_source_that_can_wait_is_held_back_and_loses_nothing() -> None:
    async def run() -> tuple[list[SourceEvent], Counter[str], list[int]]:
        counters: Counter[str] = Counter()
        queue = EventQueue(3, counters)
        waiting: list[int] = []

        async def bring() -> None:
            for number in range(50):
                await queue.put(fake.ping(number))
            queue.close()

        bringing = asyncio.ensure_future(bring())
        events = []
        while (queued := await queue.get()) is not None:
            waiting.append(queue.pings)
            events.append(queued.event)
            await asyncio.sleep(0)
        await bringing
        return events, counters, waiting

    events, counters, waiting = asyncio.run(run())
    assert [event.number for event in events if isinstance(event, Ping)] == [*range(50)]
    assert not counters
    assert max(waiting) <= 3


def test_an_empty_queue_is_waited_for_until_it_is_closed() -> None:
    async def run() -> tuple[Queued | None, Queued | None]:
        queue = EventQueue(3, Counter())
        taking = asyncio.ensure_future(queue.get())
        await asyncio.sleep(0)
        assert not taking.done()
        queue.push(fake.ping(1))
        first = await taking
        taking = asyncio.ensure_future(queue.get())
        await asyncio.sleep(0)
        queue.close()
        return first, await taking

    first, after = asyncio.run(run())
    assert first is not None
    assert isinstance(first.event, Ping)
    assert after is None
