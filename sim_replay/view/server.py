"""Serve the page of one mission to a browser: bounded, read-only but for verdicts, by its own address alone."""

from __future__ import annotations

import asyncio
import ipaddress
import json
import re
from collections import OrderedDict
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any, Final, TypeVar
from urllib.parse import urlsplit

import msgspec
from aiohttp import web

from auv_mcm.clean_text import clean
from auv_mcm.errors import AuvMcmError, BadInputError, HardwareError
from auv_mcm.safe_files import open_regular
from auv_mcm.shell.whole_files import finite
from sim_replay.verdicts import newest_verdicts
from sim_replay.view.chart import Chart
from sim_replay.view.mission import MAX_POINTS, Judgement, MeasuredQuantity, ShownMission
from sim_replay.view.patience import BODY_S, Patience
from sim_replay.view.patience import log as http_log
from sim_replay.view.places import WaterfallPoint
from sim_replay.view.waterfall_store import MAX_LEVEL, WaterfallStore

LOOPBACK: Final = "127.0.0.1"
_LOCAL_NAMES: Final = ("localhost", LOOPBACK, "::1")
MAX_REQUEST_BYTES: Final = 16384  # bytes of a body: a verdict with the longest comment, escaped, has 12 kB
BOTTOM_BYTES: Final = 1 << 19  # of a corrected bottom line: its 10 000 points of 40 bytes
_MAX_HEAD_BYTES: Final = 4096  # of the first line and of each header: a browser's have some 200
_LINGER_S: Final = 1.0  # s that the rest of a refused body is read, so that its sender reads the answer; chosen
_CACHED_TILES: Final = 512  # of 64 kB: 32 MB
_MAX_STRIP_ROWS: Final = 1 << 20  # rows of one answer: 16384 strips
_PAGE: Final = Path(__file__).parent / "page"
_KINDS: Final = {".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml"}
_HEADERS: Final = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
_CONTACT_ID: Final = re.compile(r"C[0-9]{1,12}")

Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]
_Body = TypeVar("_Body")


class _Points(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    points: list[WaterfallPoint]


class _Stretches(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    stretches: list[list[tuple[float, float]]]


class _Ends(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    quantity: MeasuredQuantity
    ends: tuple[WaterfallPoint, WaterfallPoint]
    contact_id: str = ""


class MissionServer:
    """Answer a browser, as long as it is open."""

    def __init__(
        self,
        mission: ShownMission,
        host: str = LOOPBACK,
        port: int = 0,
        patience: Patience | None = None,
        chart: Chart | None = None,
    ) -> None:
        """host: address to listen at; port: 0 for any that is free. Only browsers that ask for `host` are answered.

        patience: with clients that hold connections and do nothing; None for the usual one. chart: below the map.
        """
        self._mission, self._chart = mission, chart
        self._host, self._port = host, port
        self._tiles: OrderedDict[tuple[int, int, int, int], bytes] = OrderedDict()
        self._refreshing = asyncio.Lock()
        self._drawing = asyncio.Lock()
        self._judging = asyncio.Lock()
        self._page = {path.name: path for path in _PAGE.iterdir() if path.suffix in _KINDS}
        app = web.Application(client_max_size=BOTTOM_BYTES, middlewares=[self._guard])
        app.router.add_get("/", self._index)
        app.router.add_get("/page/{name}", self._file)
        app.router.add_get("/api/state", self._state)
        for kind, handler in (("tile", self._tile), ("slant", self._slant_tile)):
            app.router.add_get(rf"/api/{kind}/{{level:\d{{1,2}}}}/{{row:\d{{1,9}}}}/{{column:-?\d{{1,4}}}}", handler)
        app.router.add_get("/api/contacts", self._contacts)
        app.router.add_get("/api/contacts/{id}", self._contact)
        app.router.add_get("/api/snippets/{id}", self._snippet)
        app.router.add_get("/api/track", self._track)
        app.router.add_get(r"/api/strips/{first:\d{1,9}}/{stop:\d{1,9}}", self._strips)
        app.router.add_get("/api/layers", self._layers)
        app.router.add_get("/api/chart", self._chart_picture)
        app.router.add_post("/api/place", self._place)
        app.router.add_post("/api/measure", self._measure)
        app.router.add_post("/api/verdicts", self._judge)
        app.router.add_get("/api/bottom", self._bottom)
        app.router.add_post("/api/bottom", self._correct_bottom)
        app.router.add_post("/api/replay", self._replay)
        app.router.add_post("/api/report", self._report)
        self._runner = web.AppRunner(
            app,
            access_log=None,
            max_line_size=_MAX_HEAD_BYTES,
            max_field_size=_MAX_HEAD_BYTES,
            lingering_time=_LINGER_S,
            logger=http_log,
        )
        self._patience = patience or Patience()
        self._listening: asyncio.Server | None = None
        self._watching: asyncio.Task[None] | None = None

    @property
    def url(self) -> str:
        """Give the address of the page."""
        host = f"[{self._host}]" if ":" in self._host else self._host
        return f"http://{host}:{self._port}/"

    async def open(self) -> None:
        """Listen. Raises HardwareError for an address that cannot be had."""
        await self._runner.setup()
        try:
            assert self._runner.server is not None
            server = self._runner.server
            self._listening = await asyncio.get_running_loop().create_server(
                lambda: self._patience.accept(server), self._host, self._port
            )
        except OSError as error:
            await self._runner.cleanup()
            raise HardwareError(
                f"{self._host}, port {self._port} cannot be opened: {error.strerror or error}. Choose another --port: "
                "'ss -ltn' lists those that are taken."
            ) from error
        self._port = int(self._listening.sockets[0].getsockname()[1])
        self._watching = asyncio.create_task(self._patience.watch(server))

    async def close(self) -> None:
        """Stop listening."""
        if self._watching is not None:
            self._watching.cancel()
        if self._listening is not None:
            self._listening.close()
        await self._runner.cleanup()

    @web.middleware
    async def _guard(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Refuse whoever did not come by this server's own address, and answer errors as JSON."""
        self._patience.begin(request)
        try:
            response = self._refusal(request) or await handler(request)
        except web.HTTPException as error:
            response = _error(error.status, error.reason)
        except AuvMcmError as error:
            response = _error(400, str(error))
        except OSError as error:
            response = _error(507, f"{error.filename or 'the disk'}: {error.strerror}")
        finally:
            self._patience.end(request)
        response.headers.update(_HEADERS)
        return response

    def _refusal(self, request: web.Request) -> web.Response | None:
        # A page from elsewhere may have its own name point here; its requests still carry that name.
        if not self._is_own_name(request.headers.getall("Host", [])):
            return _error(403, f"ask for this page as {self.url}")
        if request.headers.get("Sec-Fetch-Site", "same-origin") not in ("same-origin", "none"):
            return _error(403, "asked from another page")
        if request.method == "POST":
            origin = request.headers.get("Origin")
            if origin is not None and urlsplit(origin).netloc != request.headers["Host"]:
                return _error(403, "asked from another page")
            if request.content_type != "application/json":
                return _error(415, "write JSON, as application/json")
        return None

    def _is_own_name(self, hosts: list[str]) -> bool:
        if len(hosts) != 1:
            return False
        try:
            name = (urlsplit(f"//{hosts[0]}").hostname or "").rstrip(".")
        except ValueError:
            return False
        if name == self._host or (_is_loopback(self._host) and name in _LOCAL_NAMES):
            return True
        # Listening at every address of this computer: by number, which no foreign name can stand for.
        return _is_any(self._host) and (name in _LOCAL_NAMES or _is_address(name))

    async def _index(self, request: web.Request) -> web.StreamResponse:
        return _file_response(self._page["index.html"])

    async def _file(self, request: web.Request) -> web.StreamResponse:
        path = self._page.get(request.match_info["name"])
        if path is None:
            raise web.HTTPNotFound
        return _file_response(path)

    async def _state(self, request: web.Request) -> web.StreamResponse:
        await self._refresh()
        return _json(self._mission.state() | {"chart": None if self._chart is None else self._chart[1:]})

    async def _tile(self, request: web.Request) -> web.StreamResponse:
        return await self._picture(request, self._mission.store)

    async def _slant_tile(self, request: web.Request) -> web.StreamResponse:
        return await self._picture(request, self._mission.feed.slant)

    async def _picture(self, request: web.Request, store: WaterfallStore) -> web.StreamResponse:
        level, row, column = (int(request.match_info[name]) for name in ("level", "row", "column"))
        if level > MAX_LEVEL:
            raise web.HTTPNotFound
        key = (id(store), level, row, column)
        is_final = store.is_final(level, row)
        data = self._tiles.get(key)
        if data is None:
            data = (await asyncio.to_thread(store.picture, level, row, column)).tobytes()
            if is_final:
                self._tiles[key] = data
                while len(self._tiles) > _CACHED_TILES:
                    self._tiles.popitem(last=False)
        else:
            self._tiles.move_to_end(key)
        headers = {"X-Final": str(int(is_final))}
        return web.Response(body=data, content_type="application/octet-stream", headers=headers)

    async def _contacts(self, request: web.Request) -> web.StreamResponse:
        await self._refresh()
        return _json(await asyncio.to_thread(self._mission.contacts))

    async def _contact(self, request: web.Request) -> web.StreamResponse:
        found = self._mission.contact(request.match_info["id"])
        if found is None:
            raise web.HTTPNotFound
        return _json(found)

    async def _snippet(self, request: web.Request) -> web.StreamResponse:
        name = request.match_info["id"]
        if not _CONTACT_ID.fullmatch(name):
            raise web.HTTPNotFound
        try:
            with open_regular(self._mission.folder / "snippets" / f"{name}.png") as file:
                data = file.read()
        except (OSError, BadInputError) as error:
            raise web.HTTPNotFound from error
        return web.Response(body=data, content_type="image/png")

    async def _track(self, request: web.Request) -> web.StreamResponse:
        return _json(await asyncio.to_thread(self._mission.track))

    async def _strips(self, request: web.Request) -> web.StreamResponse:
        first, stop = int(request.match_info["first"]), int(request.match_info["stop"])
        stop = min(stop, first + _MAX_STRIP_ROWS)
        return _json(await asyncio.to_thread(self._mission.strips, first, stop))

    async def _layers(self, request: web.Request) -> web.StreamResponse:
        return _json(await asyncio.to_thread(self._mission.layers))

    async def _chart_picture(self, request: web.Request) -> web.StreamResponse:
        if self._chart is None:
            raise web.HTTPNotFound
        return web.Response(body=self._chart.png, content_type="image/png")

    async def _place(self, request: web.Request) -> web.StreamResponse:
        asked = await _body(request, _Points)
        if not 0 < len(asked.points) <= MAX_POINTS:
            raise BadInputError(f"ask for 1 to {MAX_POINTS} points")
        places = self._mission.place(asked.points)
        return _json(finite({name: getattr(places, name).tolist() for name in places.__struct_fields__}))

    async def _measure(self, request: web.Request) -> web.StreamResponse:
        asked = await _body(request, _Ends)
        ends = list(asked.ends)
        found = self._mission.measure(asked.quantity, ends)._asdict()
        return _json(finite({**found, "distance_m": self._mission.distance_m(asked.contact_id, ends)}))

    async def _judge(self, request: web.Request) -> web.StreamResponse:
        judgement = await _body(request, Judgement)
        async with self._judging:  # each names its object behind those before
            verdict = await asyncio.to_thread(self._mission.judge, judgement)
        return _json(msgspec.to_builtins(verdict))

    async def _bottom(self, request: web.Request) -> web.StreamResponse:
        return _json(await asyncio.to_thread(self._mission.bottom))

    async def _correct_bottom(self, request: web.Request) -> web.StreamResponse:
        asked = await _body(request, _Stretches, BOTTOM_BYTES)
        files = await asyncio.to_thread(self._mission.correct_bottom, asked.stretches)
        return _json({"files": [clean(str(path)) for path in files]})

    async def _replay(self, request: web.Request) -> web.StreamResponse:
        await asyncio.to_thread(self._mission.replay_again)
        self._tiles.clear()
        return _json({"generation": self._mission.generation})

    async def _report(self, request: web.Request) -> web.StreamResponse:
        from sim_replay.report.report_file import REPORT, redraw_report  # late: half a second at the start of a page

        async with self._drawing:
            drawn = await asyncio.to_thread(redraw_report, self._mission.folder)
        path = clean(str(self._mission.folder / REPORT))
        return _json({"verdicts": len(newest_verdicts(drawn.mission.verdicts)), "path": path})

    async def _refresh(self) -> None:
        async with self._refreshing:
            await asyncio.to_thread(self._mission.refresh)


async def _body(request: web.Request, kind: type[_Body], max_bytes: int = MAX_REQUEST_BYTES) -> _Body:
    try:
        data = await asyncio.wait_for(request.read(), BODY_S)
        if len(data) > max_bytes:
            raise web.HTTPRequestEntityTooLarge(max_bytes, len(data))
        return msgspec.json.decode(data, type=kind)
    except TimeoutError as error:
        raise BadInputError(f"the request did not come whole within {BODY_S:g} s") from error
    except msgspec.MsgspecError as error:
        raise BadInputError(f"not understood: {clean(str(error))}") from error


def _json(data: Any) -> web.Response:
    text = json.dumps(data, allow_nan=False, ensure_ascii=False, separators=(",", ":"))
    return web.Response(body=text.encode("utf-8", "replace"), content_type="application/json")


def _error(status: int, text: str) -> web.Response:
    return web.Response(
        status=status, body=json.dumps({"error": clean(text)}).encode(), content_type="application/json"
    )


def _file_response(path: Path) -> web.Response:
    return web.Response(body=path.read_bytes(), content_type=_KINDS[path.suffix], charset="utf-8")


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def _is_loopback(host: str) -> bool:
    return host == "localhost" or (_is_address(host) and ipaddress.ip_address(host).is_loopback)


def _is_any(host: str) -> bool:
    return _is_address(host) and ipaddress.ip_address(host).is_unspecified
