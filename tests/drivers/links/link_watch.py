"""Run a link and record its reports."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Generic, TypeVar

from auv_mcm.clock import Stamp, SystemClock
from drivers.links.can_frame import CanFrame
from drivers.links.link import Link, LinkState
from drivers.links.open_link import byte_link, can_link
from drivers.links.uri import parse_link_uri

T = TypeVar("T")
GENEROUS_S = 10.0


class Watch(Generic[T]):
    def __init__(self) -> None:
        self.items: list[T] = []
        self.stamps: list[Stamp] = []
        self.reports: list[tuple[LinkState, str]] = []

    @property
    def states(self) -> list[LinkState]:
        return [state for state, _ in self.reports]

    @property
    def reason(self) -> str:
        return self.reports[-1][1]

    def on_data(self, item: T, stamp: Stamp) -> None:
        self.items.append(item)
        self.stamps.append(stamp)

    def on_state(self, state: LinkState, reason: str) -> None:
        self.reports.append((state, reason))


def watched_bytes(uri: str) -> tuple[Link[bytes], Watch[bytes]]:
    watch = Watch[bytes]()
    return byte_link(parse_link_uri(uri, "sonar.link"), watch.on_data, watch.on_state, SystemClock()), watch


def watched_can(uri: str) -> tuple[Link[CanFrame], Watch[CanFrame]]:
    watch = Watch[CanFrame]()
    return can_link(parse_link_uri(uri, "navigation.link"), watch.on_data, watch.on_state, SystemClock()), watch


@asynccontextmanager
async def running(link: Link[T]) -> AsyncIterator[None]:
    task = asyncio.ensure_future(link.run())
    try:
        yield
    finally:
        task.cancel()
        ended = await asyncio.gather(task, return_exceptions=True)
        assert isinstance(ended[0], asyncio.CancelledError)


async def until(holds: Callable[[], object]) -> None:
    async with asyncio.timeout(GENEROUS_S):
        while not holds():
            await asyncio.sleep(0.001)


async def until_equal(get: Callable[[], object], wanted: object) -> None:
    await until(lambda: get() == wanted)


def first_reason(uri: str) -> str:
    """Return the first report of a link."""

    async def scenario() -> str:
        link, watch = watched_bytes(uri)
        async with running(link):
            await until(lambda: watch.reports)
            return watch.reason

    return asyncio.run(scenario())


def open_descriptors() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


@asynccontextmanager
async def up(link: Link[T]) -> AsyncIterator[None]:
    """Run a link that is up."""
    async with running(link):
        await until(lambda: link.state == "up")
        yield
