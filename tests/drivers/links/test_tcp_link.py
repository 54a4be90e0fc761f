from __future__ import annotations

import asyncio
import os
import socket
from collections import Counter
from typing import Any

import pytest

from drivers.links import tcp
from sim_replay.fakes.net import FakeTcpServer
from tests.drivers.links.link_watch import first_reason, open_descriptors, running, until, watched_bytes


async def test_bytes_pass_both_ways() -> None:
    taken: list[bytes] = []
    server = FakeTcpServer(on_bytes=taken.append)
    await server.start()
    link, watch = watched_bytes(f"tcp://127.0.0.1:{server.port}")
    async with running(link):
        await until(lambda: link.state == "up" and server.n_clients)
        await server.send(b"echo")
        await until(lambda: b"".join(watch.items) == b"echo")
        assert link.write(b"command")
        await until(lambda: b"".join(taken) == b"command")
    await server.stop()
    assert link.counters["link.bytes_in"] == 4
    assert link.counters["link.bytes_out"] == 7


async def test_a_host_that_loses_its_power_is_noticed_within_11_s() -> None:
    names = (socket.TCP_KEEPIDLE, socket.TCP_KEEPINTVL, socket.TCP_KEEPCNT, socket.TCP_USER_TIMEOUT)
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = await tcp.open_tcp("127.0.0.1", server.getsockname()[1], Counter())
        with socket.socket(fileno=os.dup(port.fileno())) as connection:
            assert connection.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE)
            idle_s, each_s, n_probes, sent_ms = (connection.getsockopt(socket.IPPROTO_TCP, name) for name in names)
        port.close()
    assert idle_s + each_s * n_probes == 11
    assert sent_ms == 10_000


async def test_every_address_of_a_host_is_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        number = server.getsockname()[1]
        found = [(socket.AF_INET, socket.SOCK_STREAM, 6, "", (host, number)) for host in ("127.0.0.2", "127.0.0.1")]
        monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: found)
        (await tcp.open_tcp("sonar", number, Counter())).close()


@pytest.mark.parametrize("reset", [False, True])
async def test_a_lost_connection_is_reported_and_made_again(reset: bool) -> None:
    server = FakeTcpServer()
    await server.start()
    link, watch = watched_bytes(f"tcp://127.0.0.1:{server.port}")
    async with running(link):
        await until(lambda: server.n_clients)
        await server.send(b"a")
        await until(lambda: watch.items)
        await server.stop(reset=reset)
        await until(lambda: link.state == "down")
        assert ("failed" if reset else "closed the connection") in watch.reason
        await until(lambda: link.counters["link.open_failed"] >= 1)
        await server.start()
        await until(lambda: server.n_clients)
        await server.send(b"b")
        await until(lambda: b"".join(watch.items) == b"ab")
        assert watch.states == ["up", "down", "up"], "that it is refused meanwhile is the same outage"
    await server.stop()


async def test_a_connection_that_died_without_a_word_is_made_anew() -> None:
    server = FakeTcpServer()
    await server.start()
    link, watch = watched_bytes(f"tcp://127.0.0.1:{server.port}?silent_s=0.05")
    async with running(link):
        await until(lambda: server.n_clients)
        server.stalled = True
        await server.send(b"lost")
        await until(lambda: server.counters["tcp.connections"] >= 3)
        assert any("counts as lost" in reason for _, reason in watch.reports)
        server.stalled = False
        while not watch.items:
            await server.send(b"heard")
            await asyncio.sleep(0.005)
    await server.stop()


async def test_a_server_that_hangs_up_at_once_is_not_asked_without_pause() -> None:
    n_connections = 0

    async def hang_up(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        nonlocal n_connections
        n_connections += 1
        writer.close()

    server = await asyncio.start_server(hang_up, "127.0.0.1", 0)
    link, _ = watched_bytes(f"tcp://127.0.0.1:{server.sockets[0].getsockname()[1]}")
    async with running(link):
        await asyncio.sleep(0.5)
    assert 1 <= n_connections <= 4
    server.close()
    await server.wait_closed()


def test_who_is_not_there_is_reported() -> None:
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        port = unused.getsockname()[1]
        assert first_reason(f"tcp://127.0.0.1:{port}") == (
            f"tcp://127.0.0.1:{port}: refused. The host is there, but nothing listens on this port: check it, and "
            "start the device."
        )
    assert "cannot be reached" in first_reason("tcp://255.255.255.255:5000")


def test_a_host_that_nobody_knows_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    assert "host 'a..b' is unknown" in first_reason("tcp://a..b:5000")

    known = socket.getaddrinfo

    def lookup(host: str, *others: Any, **named: Any) -> Any:
        if host == "sonar":
            raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")
        return known(host, *others, **named)

    monkeypatch.setattr(socket, "getaddrinfo", lookup)
    assert first_reason("tcp://sonar:5000").startswith(
        "tcp://sonar:5000: host 'sonar' is unknown ([Errno -2] Name or service not known)."
    )
    assert "host 'sonar' is unknown" in first_reason("udp://0.0.0.0:0?peer=sonar:5000")


def test_a_host_that_does_not_answer_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """A server that accepts nothing and whose queue is full leaves the next client without an answer."""
    monkeypatch.setattr(tcp, "CONNECT_S", 0.1)
    with socket.socket() as server, socket.socket() as first:
        server.bind(("127.0.0.1", 0))
        server.listen(0)
        first.connect(server.getsockname())
        before = open_descriptors()
        assert "no answer within 0.1 s" in first_reason(f"tcp://127.0.0.1:{server.getsockname()[1]}")
        assert open_descriptors() == before
