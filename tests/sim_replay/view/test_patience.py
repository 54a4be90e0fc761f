"""Clients that hold connections, never end a request or write nonsense keep nobody waiting, and leave no trace."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable
from pathlib import Path

import aiohttp
import pytest

from sim_replay.view.patience import Patience
from sim_replay.view.server import MissionServer
from tests.sim_replay.view.shown_missions import feature, filled_store, shown, write_results

STORE = filled_store(64, 300)
Ask = Callable[[int, str], Awaitable[None]]


def serve(folder: Path, ask: Ask, patience: Patience) -> None:
    mission = shown(write_results(folder, [feature(1)]), STORE)

    async def run() -> None:
        server = MissionServer(mission, patience=patience)
        await server.open()
        try:
            await ask(int(server.url.rstrip("/").rpartition(":")[2]), server.url)
        finally:
            await server.close()

    asyncio.run(run())


async def is_answered(url: str) -> bool:
    try:
        async with aiohttp.ClientSession() as session, session.get(f"{url}api/state") as answer:
            return answer.status == 200
    except aiohttp.ClientError:
        return False


async def until(condition: Callable[[], Awaitable[bool]]) -> None:
    async with asyncio.timeout(60):
        while not await condition():
            await asyncio.sleep(0.02)


def test_connections_beyond_the_limit_are_closed_at_once_and_room_is_given_back(tmp_path: Path) -> None:
    async def ask(port: int, url: str) -> None:
        held = [await asyncio.open_connection("127.0.0.1", port) for _ in range(3)]
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        assert await reader.read() == b""
        writer.close()
        for _, one in held:
            one.close()
        await until(lambda: is_answered(url))

    serve(tmp_path, ask, Patience(max_connections=3, idle_s=1e6))


@pytest.mark.parametrize(
    "beginning",
    [b"", b"GET /api/sta", b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Slow: ", b"POST /api/place HTTP/1.1\r\n"],
)
def test_a_request_that_never_ends_is_closed(beginning: bytes, tmp_path: Path) -> None:
    async def ask(port: int, url: str) -> None:
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(beginning)
        with contextlib.suppress(ConnectionError):
            assert await asyncio.wait_for(reader.read(), 60) == b""
        assert await is_answered(url)
        writer.close()

    serve(tmp_path, ask, Patience(idle_s=0.2))


def test_a_body_that_never_ends_is_answered_in_words(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sim_replay.view.server.BODY_S", 0.1)

    async def ask(port: int, url: str) -> None:
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        head = f"POST /api/place HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nContent-Type: application/json\r\n"
        writer.write(f"{head}Content-Length: 100\r\n\r\n{{".encode())
        answer = await asyncio.wait_for(reader.readuntil(b"}"), 60)
        assert answer.startswith(b"HTTP/1.1 400")
        assert b"did not come whole" in answer
        writer.close()

    serve(tmp_path, ask, Patience())


@pytest.mark.parametrize(
    "nonsense", [b"GET /" + b"a" * 9000 + b" HTTP/1.1\r\n\r\n", b"\xff\xfe\r\n\r\n", b"GET / HTTP/9\r\n\r\n"]
)
def test_nonsense_is_answered_and_leaves_no_traceback(
    nonsense: bytes, tmp_path: Path, caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
) -> None:
    async def ask(port: int, url: str) -> None:
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(nonsense)
        assert (await asyncio.wait_for(reader.readline(), 60)).startswith(b"HTTP/1.")
        writer.close()
        assert await is_answered(url)

    serve(tmp_path, ask, Patience())
    assert not [record for record in caplog.records if record.exc_info]
    assert "Traceback" not in "".join(capfd.readouterr())
