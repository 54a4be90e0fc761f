"""The queue is bounded: a source that can wait is held back, and of one that cannot the oldest event of a kind is
dropped."""

from __future__ import annotations

import asyncio
from collections import Counter

from auv_mcm.records import NavSample, Ping, SourceEvent
from auv_mcm.shell.event_queue import EventQueue, Queued
from tests.auv_mcm.shell import fake_pipelines as fake


async def rest_of(queue: EventQueue) -> list[SourceEvent]:
    events = []
    while (queued := await queue.get()) is not None:
        events.append(queued.event)
    return events


def test_the_oldest_ping_is_dropped_and_everything_else_is_bounded_too() -> None:
    seen: list[SourceEvent] = []

    async def run() -> tuple[list[SourceEvent], Counter[str]]:
        counters: Counter[str] = Counter()

        def see(event: SourceEvent) -> int:
            seen.append(event)
            return len(seen)

        queue = EventQueue(3, counters, see)
        for number in range(5):
            queue.push(fake.navigation(number))
            queue.push(fake.ping(number))
        for number in range(100):
            queue.push(fake.navigation(100 + number))
        queue.close()
        return await rest_of(queue), counters

    events, counters = asyncio.run(run())
    assert [event.number for event in events if isinstance(event, Ping)] == [2, 3, 4]
    navigation = [event.time_s - fake.START_S for event in events if isinstance(event, NavSample)]
    assert navigation == [*range(152, 200)]
    assert counters == {"service.ping_dropped": 2, "service.event_dropped": 105 - len(navigation)}
    assert len(seen) == 110, "what is dropped was seen all the same"


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
