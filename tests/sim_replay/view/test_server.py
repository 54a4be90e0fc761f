"""The server answers a page of its own and refuses everybody else: other names, other paths, too much, other forms."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import aiohttp
import pytest

from auv_mcm.errors import HardwareError
from sim_replay.verdicts import VERDICTS_FILE, newest_verdicts, read_verdicts
from sim_replay.view.chart import Chart
from sim_replay.view.server import MAX_REQUEST_BYTES, MissionServer
from tests.sim_replay.view.shown_missions import feature, filled_store, shown, write_results

STORE = filled_store(512, 300)
Ask = Callable[[MissionServer, aiohttp.ClientSession], Awaitable[None]]


def serve(
    folder: Path,
    ask: Ask,
    features: list[dict[str, Any]] | None = None,
    host: str = "127.0.0.1",
    chart: Chart | None = None,
) -> None:
    """Serve a folder as long as `ask` runs."""
    mission = shown(write_results(folder, [feature(1)] if features is None else features), STORE)

    async def run() -> None:
        server = MissionServer(mission, host, chart=chart)
        await server.open()
        try:
            async with aiohttp.ClientSession(base_url=server.url.replace("0.0.0.0", "127.0.0.1")) as session:
                await ask(server, session)
        finally:
            await server.close()

    asyncio.run(run())


async def raw(server: MissionServer, request: str) -> tuple[int, bytes]:
    """Send bytes that no browser would and read the answer's status and all of it."""
    port = int(server.url.rstrip("/").rpartition(":")[2])
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(request.encode())
    await writer.drain()
    answer = await asyncio.wait_for(reader.read(), 20)
    writer.close()
    return int(answer.split(b" ", 2)[1]), answer


def test_the_page_and_all_its_parts_come_from_here_and_may_load_nothing_else(tmp_path: Path) -> None:
    async def ask(server: MissionServer, session: aiohttp.ClientSession) -> None:
        async with session.get("/") as answer:
            page = await answer.text()
            policy = answer.headers["Content-Security-Policy"]
            assert answer.headers["X-Content-Type-Options"] == "nosniff"
        assert "default-src 'none'" in policy
        assert "script-src 'self'" in policy
        assert "unsafe" not in policy
        assert "http" not in page
        for name in ("main.js", "style.css", "icon.svg"):
            assert f'"page/{name}"' in page
            async with session.get(f"/page/{name}") as answer:
                assert answer.status == 200
                assert "https://" not in await answer.text()

    serve(tmp_path, ask)


def test_state_contacts_tiles_and_places_come_as_asked(tmp_path: Path) -> None:
    async def ask(server: MissionServer, session: aiohttp.ClientSession) -> None:
        async with session.get("/api/state") as answer:
            assert (await answer.json())["stop_row"] == 512
        async with session.get("/api/contacts") as answer:
            assert (await answer.json())["id"] == ["C00001"]
        async with session.get("/api/tile/0/1/-1") as answer:
            assert await answer.read() == STORE.picture(0, 1, -1).tobytes()
        async with session.post("/api/place", json={"points": [[100.0, 20.0]]}) as answer:
            assert (await answer.json())["depth_m"] == [pytest.approx(15.0, abs=0.01)]
        ends = [[100.0, 10.0], [100.0, 11.0]]
        async with session.post("/api/measure", json={"quantity": "shadow", "ends": ends}) as answer:
            assert (await answer.json())["height_m"] == pytest.approx(0.374, abs=0.001)
        for path in ("/api/track", "/api/layers", "/api/strips/0/512"):
            async with session.get(path) as answer:
                assert answer.status == 200
                await answer.json()

    serve(tmp_path, ask)


def test_verdicts_of_two_people_at_one_moment_both_count(tmp_path: Path) -> None:
    features = [feature(number, 40.0 * number) for number in range(1, 9)]

    async def ask(server: MissionServer, session: aiohttp.ClientSession) -> None:
        async def judge(number: int) -> None:
            async with session.post("/api/verdicts", json={"contact_id": f"C{number:05d}"}) as answer:
                assert answer.status == 200

        await asyncio.gather(*map(judge, range(1, 9)))

    serve(tmp_path, ask, features)
    assert len(newest_verdicts(read_verdicts(tmp_path))) == 8


def test_a_chart_is_placed_and_served_and_none_is_where_there_is_none(tmp_path: Path) -> None:
    async def without(server: MissionServer, session: aiohttp.ClientSession) -> None:
        assert (await (await session.get("/api/state")).json())["chart"] is None
        assert (await session.get("/api/chart")).status == 404

    async def shown_below(server: MissionServer, session: aiohttp.ClientSession) -> None:
        assert (await (await session.get("/api/state")).json())["chart"] == [8.0, 54.0, 8.1, 54.1]
        async with session.get("/api/chart") as answer:
            assert (answer.content_type, await answer.read()) == ("image/png", b"png")

    serve(tmp_path / "without", without)
    serve(tmp_path / "with", shown_below, chart=Chart(b"png", 8.0, 54.0, 8.1, 54.1))


def test_a_verdict_is_kept_as_it_was_written_whatever_it_says(tmp_path: Path) -> None:
    script = "<script>alert(1)</script>"

    async def ask(server: MissionServer, session: aiohttp.ClientSession) -> None:
        verdict = {"contact_id": "C00001", "call": "mine_like", "comment": script}
        async with session.post("/api/verdicts", json=verdict) as answer:
            assert answer.status == 200
            assert answer.content_type == "application/json"
        async with session.get("/api/contacts") as answer:
            assert answer.content_type == "application/json"
            assert (await answer.json())["verdicts"]["C00001"]["comment"] == script

    serve(tmp_path, ask)
    assert read_verdicts(tmp_path)[0].comment == script


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:{port}", "127.0.0.1.evil.example", "", "169.254.1.1", "a@b:{port}"]
)
def test_another_host_name_is_refused(tmp_path: Path, host: str) -> None:
    async def ask(server: MissionServer, session: aiohttp.ClientSession) -> None:
        port = server.url.rstrip("/").rpartition(":")[2]
        status, body = await raw(
            server, f"GET /api/state HTTP/1.1\r\nHost: {host.format(port=port)}\r\nConnection: close\r\n\r\n"
        )
        assert status in (400, 403)
        assert b"stop_row" not in body

    serve(tmp_path, ask)


def test_at_all_addresses_only_numbers_and_this_computer_are_answered(tmp_path: Path) -> None:
    async def ask(server: MissionServer, session: aiohttp.ClientSession) -> None:
        for host, expected in {"192.168.1.7:80": 200, "localhost": 200, "evil.example": 403}.items():
            async with session.get("/api/state", headers={"Host": host}) as answer:
                assert answer.status == expected

    serve(tmp_path, ask, host="0.0.0.0")


def test_a_page_from_elsewhere_cannot_ask_or_judge(tmp_path: Path) -> None:
    verdict = {"contact_id": "C00001", "call": "mine_like"}

    async def ask(server: MissionServer, session: aiohttp.ClientSession) -> None:
        for headers in ({"Origin": "http://evil.example"}, {"Origin": "null"}, {"Sec-Fetch-Site": "cross-site"}):
            async with session.post("/api/verdicts", json=verdict, headers=headers) as answer:
                assert answer.status == 403
        # what a form can send without being asked
        async with session.post("/api/verdicts", data=json.dumps(verdict), headers={"Content-Type": "text/plain"}) as a:
            assert a.status == 415
        async with session.get("/api/state", headers={"Sec-Fetch-Site": "cross-site"}) as answer:
            assert answer.status == 403

    serve(tmp_path, ask)
    assert not (tmp_path / VERDICTS_FILE).exists()


@pytest.mark.parametrize(
    "path",
    [
        *(
            "/page/../server.py",
            "/page/..%2fserver.py",
            "/page/%2e%2e/server.py",
            "/page//etc/passwd",
            "/../etc/passwd",
        ),
        *("/api/snippets/..%2f..%2fsecret", "/api/snippets/../secret", "/api/snippets/C00001.png", "/page/"),
        *("/api/contacts/..%2fsecret", "/api/tile/13/0/0", "/api/tile/0/-1/0", "/secret.txt", "//secret.txt"),
    ],
)
def test_no_path_leads_out_of_the_page(tmp_path: Path, path: str) -> None:
    (tmp_path / "results").mkdir()
    (tmp_path / "secret.png").write_bytes(b"SECRET")
    (tmp_path / "secret.txt").write_bytes(b"SECRET")

    async def ask(server: MissionServer, session: aiohttp.ClientSession) -> None:
        status, body = await raw(server, f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n")
        assert status == 404
        assert b"SECRET" not in body

    serve(tmp_path / "results", ask)


def test_a_link_in_the_place_of_the_verdicts_is_not_followed(tmp_path: Path) -> None:
    (tmp_path / "results").mkdir()
    (tmp_path / "other").write_bytes(b"")

    async def ask(server: MissionServer, session: aiohttp.ClientSession) -> None:
        (tmp_path / "results" / VERDICTS_FILE).symlink_to(tmp_path / "other")
        async with session.post("/api/verdicts", json={"contact_id": "C00001"}) as answer:
            assert answer.status == 507

    serve(tmp_path / "results", ask)
    assert (tmp_path / "other").read_bytes() == b""


def test_too_much_is_refused(tmp_path: Path) -> None:
    async def ask(server: MissionServer, session: aiohttp.ClientSession) -> None:
        long = {"contact_id": "C00001", "comment": "x" * MAX_REQUEST_BYTES}
        async with session.post("/api/verdicts", json=long) as answer:
            assert answer.status == 413
        many = {"points": [[1.0, 1.0]] * 65}
        async with session.post("/api/place", json=many) as answer:
            assert answer.status == 400
        status, _ = await raw(server, f"GET /{'x' * 9000} HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
        assert status == 400
        status, _ = await raw(server, f"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX: {'x' * 9000}\r\n\r\n")
        assert status == 400

    serve(tmp_path, ask)
    assert not (tmp_path / VERDICTS_FILE).exists()


@pytest.mark.parametrize(
    "body", [b"", b"nonsense", b"[]", b'{"points": [[1]]}', b'{"points": [["a", 1]]}', b'{"call": "sunk"}', b"\xff\xfe"]
)
def test_what_is_not_understood_is_answered_in_one_line(tmp_path: Path, body: bytes) -> None:
    async def ask(server: MissionServer, session: aiohttp.ClientSession) -> None:
        for path in ("/api/place", "/api/measure", "/api/verdicts"):
            headers = {"Content-Type": "application/json"}
            async with session.post(path, data=body, headers=headers) as answer:
                assert answer.status == 400
                assert "\n" not in (await answer.json())["error"]

    serve(tmp_path, ask)
    assert not (tmp_path / VERDICTS_FILE).exists()


def test_nothing_is_changed_by_other_methods(tmp_path: Path) -> None:
    async def ask(server: MissionServer, session: aiohttp.ClientSession) -> None:
        for method in ("PUT", "DELETE", "PATCH", "OPTIONS"):
            async with session.request(method, "/api/verdicts", json={"contact_id": "C00001"}) as answer:
                assert answer.status == 405
        async with session.get("/api/verdicts") as answer:
            assert answer.status == 405

    serve(tmp_path, ask)


def test_a_port_that_is_taken_is_said(tmp_path: Path) -> None:
    async def ask(server: MissionServer, session: aiohttp.ClientSession) -> None:
        port = int(server.url.rstrip("/").rpartition(":")[2])
        with pytest.raises(HardwareError, match="Choose another --port"):
            await MissionServer(shown(tmp_path, STORE), port=port).open()

    serve(tmp_path, ask)
