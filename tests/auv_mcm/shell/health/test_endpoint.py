"""The endpoint answers monitors of this computer, and nothing else for long."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import pytest

from auv_mcm.errors import HardwareError
from auv_mcm.shell.health import endpoint
from auv_mcm.shell.health.endpoint import HealthEndpoint
from auv_mcm.shell.health.record import Health
from auv_mcm.shell.health.text import prometheus_text
from tests.auv_mcm.shell.health.measurements import record


def ask(request: bytes, newest: Callable[[], Health | None] = record) -> tuple[str, bytes]:
    """Send a request; give the status and the body of the answer, or nothing of both."""

    async def asked() -> bytes:
        served = HealthEndpoint(0, newest)
        await served.open()
        try:
            return await answer(served.port, request)
        finally:
            served.close()

    head, _, body = asyncio.run(asked()).partition(b"\r\n\r\n")
    return head.decode().partition("\r\n")[0].removeprefix("HTTP/1.1 "), body


async def answer(port: int, request: bytes) -> bytes:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(request)
    try:
        return await reader.read()
    except ConnectionResetError:
        return b""
    finally:
        writer.close()


def get(path: str, host: str = "127.0.0.1:9100") -> bytes:
    return f"GET {path} HTTP/1.1\r\nHost: {host}\r\nAccept: */*\r\n\r\n".encode()


def test_metrics_and_json_are_the_newest_record() -> None:
    assert ask(get("/metrics")) == ("200 OK", prometheus_text(record()).encode())
    assert ask(get("/health", "localhost")) == ("200 OK", record().to_json() + b"\n")


@pytest.mark.parametrize(
    ("request_", "status"),
    [
        (get("/"), "404 Not Found"),
        (get("/../../etc/passwd"), "404 Not Found"),
        (get("/metrics?x=1"), "404 Not Found"),
        (get("/metrics", "evil.example"), "403 Forbidden"),
        (get("/metrics", "evil.example:127.0.0.1"), "403 Forbidden"),
        (b"POST /metrics HTTP/1.1\r\nHost: localhost\r\n\r\n", "405 Method Not Allowed"),
        (b"\x00\xff\r\n\r\n", "400 Bad Request"),
        (b"GET /metrics SSH-2.0\r\n\r\n", "400 Bad Request"),
        (b"GET /metrics HTTP/1.1\r\nX: " + b"x" * 5000 + b"\r\n\r\n", ""),
    ],
)
def test_anything_else_is_refused(request_: bytes, status: str) -> None:
    assert ask(request_)[0] == status


def test_before_the_first_measurement_there_is_nothing() -> None:
    assert ask(get("/metrics"), lambda: None)[0] == "503 Service Unavailable"


def test_whoever_sends_nothing_or_comes_in_a_crowd_is_let_go(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(endpoint, "_PATIENCE_S", 0.2)

    async def crowd() -> list[bytes]:
        served = HealthEndpoint(0, record)
        await served.open()
        try:
            silent = [asyncio.ensure_future(answer(served.port, b"GET /met")) for _ in range(20)]
            given = [await each for each in silent]
            return [*given, await answer(served.port, get("/health"))]
        finally:
            served.close()

    *silent, last = asyncio.run(crowd())
    assert set(silent) == {b""}
    assert last.startswith(b"HTTP/1.1 200 OK\r\n")


async def test_it_listens_to_this_computer_alone_and_says_so_where_the_port_is_taken() -> None:
    served = HealthEndpoint(0, record)
    await served.open()
    try:
        with pytest.raises(HardwareError, match=f"service.health_port {served.port} cannot be opened: .*'ss -ltn'"):
            await HealthEndpoint(served.port, record).open()
    finally:
        served.close()
