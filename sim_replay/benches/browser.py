"""Drive a headless Chromium by its DevTools protocol: what a person does at the page, done by a script.

https://chromedevtools.github.io/devtools-protocol/
"""

from __future__ import annotations

import asyncio
import base64
import contextlib
import json
import os
import shutil
import tempfile
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any, Final

import aiohttp

from auv_mcm.errors import HardwareError
from sim_replay.view.mission import ShownMission
from sim_replay.view.server import MissionServer

_NAMES: Final = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome", "chrome")
_PATIENCE_S: Final = 60.0  # s for the browser to start, and for anything on the page to happen, on a busy computer
_POLL_S: Final = 0.02  # s between two looks at the page
_REPLACED: Final = "target navigated or closed"  # what Chromium answers for a script whose page is left meanwhile
_KEYS: Final = {"Enter": "\r", "Escape": "", "ArrowDown": "", "ArrowUp": "", "ArrowLeft": "", "ArrowRight": ""}


def find_browser() -> str | None:
    """Find a Chromium on this computer, or the one that the variable CHROMIUM names; None if there is none."""
    return os.environ.get("CHROMIUM") or next((path for name in _NAMES if (path := shutil.which(name))), None)


class BrowserPage:
    """Hold one page of a browser."""

    def __init__(self, socket: aiohttp.ClientWebSocketResponse) -> None:
        self._socket = socket
        self._number = 0
        self.complaints: list[str] = []
        """Errors of the page's scripts, and what its security policy blocked."""

    async def command(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Send one command of the protocol and wait for its answer. Raises RuntimeError for a refusal."""
        self._number += 1
        number = self._number
        await self._socket.send_json({"id": number, "method": method, "params": parameters})
        while True:
            answer = await asyncio.wait_for(self._socket.receive(), _PATIENCE_S)
            if answer.type != aiohttp.WSMsgType.TEXT:
                raise HardwareError(f"the browser has gone: {answer.type.name}")
            found = json.loads(answer.data)
            self._note(found)
            if found.get("id") == number:
                if "error" in found:
                    raise RuntimeError(f"{method}: {found['error'].get('message')}")
                return dict(found["result"])

    async def evaluate(self, script: str) -> Any:
        """Run JavaScript on the page and return its value, a promise's too. Raises RuntimeError where it throws."""
        found = await self.command("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True)
        if "exceptionDetails" in found:
            raise RuntimeError(f"{script}: {found['exceptionDetails']}")
        return found["result"].get("value")

    async def wait_for(self, script: str) -> Any:
        """Wait until JavaScript gives something true and return it. Raises TimeoutError that names it."""
        try:
            async with asyncio.timeout(_PATIENCE_S):
                while not (found := await self._evaluated_here(script)):
                    await asyncio.sleep(_POLL_S)
        except TimeoutError as error:
            raise TimeoutError(f"the page never came to: {script}; it complains: {self.complaints}") from error
        return found

    async def _evaluated_here(self, script: str) -> Any:
        """Evaluate JavaScript; None where the page loads itself again meanwhile."""
        try:
            return await self.evaluate(script)
        except RuntimeError as error:
            if _REPLACED not in str(error):
                raise
            return None

    async def open(self, url: str) -> None:
        """Go to an address and wait until it is loaded."""
        await self.command("Page.navigate", url=url)
        await self.wait_for("document.readyState === 'complete'")

    async def click(self, x: float, y: float) -> None:
        """Click at a point of the window."""
        await self.move(x, y)
        for kind in ("mousePressed", "mouseReleased"):
            await self.command("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=1, clickCount=1)

    async def click_on(self, selector: str) -> None:
        """Click the middle of an element."""
        box = await self.evaluate(
            f"(() => {{const box = document.querySelector({json.dumps(selector)}).getBoundingClientRect();"
            "return [box.left + box.width / 2, box.top + box.height / 2]})()"
        )
        await self.click(*box)

    async def move(self, x: float, y: float) -> None:
        """Move the pointer to a point of the window."""
        await self.command("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)

    async def wheel(self, x: float, y: float, delta: float) -> None:
        """Turn the wheel at a point of the window."""
        await self.command("Input.dispatchMouseEvent", type="mouseWheel", x=x, y=y, deltaX=0, deltaY=delta)

    async def press(self, key: str) -> None:
        """Press and release a key, by its name or character."""
        text = _KEYS.get(key, key)
        await self.command("Input.dispatchKeyEvent", type="keyDown", key=key, **({"text": text} if text else {}))
        await self.command("Input.dispatchKeyEvent", type="keyUp", key=key)

    async def write(self, text: str) -> None:
        """Write text where the focus is."""
        await self.command("Input.insertText", text=text)

    async def screenshot(self, path: Path, *, kind: str = "webp", quality: int = 80) -> None:
        """Save a picture of the window."""
        path.write_bytes(await self.captured(kind, quality=quality))

    async def captured(self, kind: str, **options: int) -> bytes:
        """Take a picture of the window: the bytes of a png, jpeg or webp file."""
        found = await self.command("Page.captureScreenshot", format=kind, **options)
        return base64.b64decode(found["data"])

    def _note(self, found: dict[str, Any]) -> None:
        match found.get("method"):
            case "Runtime.exceptionThrown":
                details = found["params"]["exceptionDetails"]
                self.complaints.append(str(details.get("exception", {}).get("description") or details.get("text")))
            case "Log.entryAdded" if found["params"]["entry"]["level"] == "error":
                self.complaints.append(str(found["params"]["entry"]["text"]))


@contextlib.asynccontextmanager
async def browser_page(width: int = 1440, height: int = 900) -> AsyncIterator[BrowserPage]:
    """Start a browser with one empty page; it ends with the block. Raises HardwareError where there is none.

    Parameters
    ----------
    width, height
        Of the window, pixels.
    """
    program = find_browser()
    if program is None:
        raise HardwareError("no Chromium is installed: sudo apt-get install chromium, or name one in CHROMIUM")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        process = await asyncio.create_subprocess_exec(
            program,
            *("--headless", "--no-sandbox", "--disable-gpu", "--disable-extensions", "--no-first-run"),
            *("--disable-background-networking", "--disable-dev-shm-usage", "--hide-scrollbars"),
            *(f"--user-data-dir={profile}", "--remote-debugging-port=0", f"--window-size={width},{height}"),
            "about:blank",
            stdout=asyncio.subprocess.DEVNULL,
            stderr=asyncio.subprocess.DEVNULL,
        )
        try:
            port = await _debugging_port(Path(profile), lambda: process.returncode is None)
            async with aiohttp.ClientSession() as session:
                async with session.get(f"http://127.0.0.1:{port}/json/list") as answer:
                    targets = await answer.json()
                address = next(target["webSocketDebuggerUrl"] for target in targets if target["type"] == "page")
                async with session.ws_connect(address, max_msg_size=0) as socket:
                    page = BrowserPage(socket)
                    for domain in ("Page", "Runtime", "Log"):
                        await page.command(f"{domain}.enable")
                    await page.command(
                        "Emulation.setDeviceMetricsOverride",
                        width=width,
                        height=height,
                        deviceScaleFactor=1,
                        mobile=False,
                    )
                    yield page
        finally:
            with contextlib.suppress(ProcessLookupError):
                process.terminate()
            try:
                await asyncio.wait_for(process.wait(), _PATIENCE_S)
            except TimeoutError:
                process.kill()
                await process.wait()


@contextlib.asynccontextmanager
async def mission_page(mission: ShownMission) -> AsyncIterator[BrowserPage]:
    """Serve a mission and open its page, whose waterfall, contacts and pictures are there when the block begins."""
    server = MissionServer(mission)
    await server.open()
    try:
        async with browser_page() as page:
            await page.open(server.url)
            n_contacts = len(mission.contacts()["id"])
            await page.wait_for(
                f"window.bench && bench.state.done && bench.contacts.length >= {n_contacts} && !bench.busy"
            )
            yield page
    finally:
        await server.close()


async def _debugging_port(profile: Path, is_alive: Callable[[], bool]) -> int:
    """Wait for the port that the browser writes down."""
    try:
        async with asyncio.timeout(_PATIENCE_S):
            while is_alive():
                with contextlib.suppress(OSError, ValueError, IndexError):
                    return int((profile / "DevToolsActivePort").read_text("ascii").split()[0])
                await asyncio.sleep(_POLL_S)
    except TimeoutError:
        pass
    raise HardwareError("the browser did not start: try it by hand with --headless --dump-dom about:blank")
