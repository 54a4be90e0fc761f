"""The first minute at the page: open a line, an archive or a running session, see it, judge it, correct it, show it.

What it took from the server being up to the first pixels is recorded as a property of the test, and printed
(`pytest -rP`); no time is asserted.
"""

from __future__ import annotations

import asyncio
import json
import multiprocessing
import os
import shutil
import signal
import subprocess
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
import rasterio
from msgspec import structs
from pycocotools.coco import COCO

from auv_mcm.cli import main
from auv_mcm.records import NavSample, Ping
from auv_mcm.settings.config import ServiceConfig, WaterfallConfig
from auv_mcm.shell.service import Service
from drivers.port_source import PortSource
from sim_replay.benches.browser import BrowserPage, browser_page, find_browser
from sim_replay.fakes.net import FakeTcpServer
from sim_replay.logs.xtf_writer import write_xtf
from sim_replay.results_folder import summary_of
from sim_replay.verdicts import read_verdicts
from sim_replay.view.mission import ShownMission
from sim_replay.view.server import MissionServer
from sim_replay.view.show import logs_named, open_new, open_shown
from tests.manual_clock import ManualClock
from tests.sim_replay.logs import sonar_logs

pytestmark = pytest.mark.skipif(
    find_browser() is None, reason="needs Chromium: apt-get install chromium, or name one in CHROMIUM"
)

COLOURS = (
    "(() => {const c = document.querySelector('#waterfall-picture'), d = c.getContext('2d')"
    ".getImageData(0, 0, c.width, c.height).data; return new Set(new Uint32Array(d.buffer)).size})()"
)
Record = Callable[[str, object], None]


def archived_line(number: int) -> list[NavSample | Ping]:
    """The line's 12 m about its first object, 40 m east of the one before and 100 s later."""
    start_s = sonar_logs.mission()[0].time_s
    line: list[NavSample | Ping] = []
    for event in sonar_logs.mission():
        if 2.0 <= event.time_s - start_s <= 8.0:
            moved = structs.replace(event, time_s=event.time_s + 100.0 * number)
            if isinstance(moved, NavSample):
                moved = structs.replace(moved, longitude_deg=moved.longitude_deg + 6e-4 * number)
            line.append(moved)
    return line


def visit(mission: ShownMission, go: Callable[[BrowserPage, MissionServer], Awaitable[None]]) -> None:
    asyncio.run(visiting(mission, go))


async def visiting(mission: ShownMission, go: Callable[[BrowserPage, MissionServer], Awaitable[None]]) -> None:
    server = MissionServer(mission)
    await server.open()
    try:
        async with browser_page(1200, 800) as page:
            await go(page, server)
            # of scripts: refusals, and pictures that are not there, are answers
            assert [one for one in page.complaints if "Failed to load resource" not in one] == []
    finally:
        await server.close()
        if mission.replay is not None:
            mission.replay.close()
        mission.feed.close()


async def first_pixels(page: BrowserPage, server: MissionServer, record: Record) -> None:
    """Open the page and wait until sea floor is painted."""
    up_s = time.time()  # the server is up, and so is a browser
    await page.open(server.url)
    shown = "performance.getEntriesByName('sea floor shown')[0]"
    shown_s = 1e-3 * await page.wait_for(f"{shown} && performance.timeOrigin + {shown}.startTime")
    await page.wait_for(f"bench.state.stop_row > 0 && {COLOURS} > 50")
    first_pixels_s = round(shown_s - up_s, 3)
    record("first_pixels_s", first_pixels_s)
    print(json.dumps({"first_pixels_s": first_pixels_s}))


def test_a_line_is_seen_then_its_contacts_corrected_replayed_and_exported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, record_property: Record
) -> None:
    monkeypatch.chdir(tmp_path)
    log = tmp_path / "line.xtf"
    write_xtf(log, sonar_logs.mission())
    mission = open_new(logs_named([log]), None, "kim")
    results = tmp_path / "line-results"

    async def go(page: BrowserPage, server: MissionServer) -> None:
        await first_pixels(page, server, record_property)
        assert await page.evaluate("bench.contacts.length") == 0  # nothing was looked for yet
        assert mission.replay is not None
        mission.replay.start()
        await asyncio.to_thread(mission.replay.join)
        await page.wait_for("bench.state.replay_done && bench.contacts.length > 0")
        for key in "jmjn":
            await page.press(key)
            await page.wait_for("bench.selected !== null && !document.querySelector('#card').hidden")
            if key in "mn":
                call = {"m": "mine_like", "n": "not_mine_like"}[key]
                await page.wait_for(f"bench.contacts.find((one) => one.key === bench.selected).call === '{call}'")
        # the water column shows, and two clicks and a drag make a stretch of the bottom line
        await page.press("Escape")
        await page.press("b")
        await page.wait_for(f"!document.querySelector('#bottom-tools').hidden && !bench.busy && {COLOURS} > 50")
        await page.click_on("#fit")
        for row, range_m in ((60.0, 4.0), (150.0, -4.2)):
            place = await page.evaluate(f"bench.screenOf({row}, {range_m})")
            await page.click(place["x"], place["y"])
        assert len(await page.evaluate("bench.bottom.stretches[0]")) == 2
        await page.click_on("#bottom-save")
        await page.wait_for("document.querySelector('#message').textContent.includes('bottom-line.json')")
        await page.wait_for("!document.querySelector('#replay-again').hidden")
        await page.click_on("#replay-again")
        await page.wait_for("window.bench && bench.state.generation === 1")
        await asyncio.to_thread(mission.replay.join)
        await page.wait_for("bench.state.replay_done")
        await page.wait_for("bench.contacts.some((one) => one.call === 'mine_like')")  # verdicts are found again

    visit(mission, go)
    summary = summary_of(results)
    assert summary is not None
    assert summary["counters"]["bottom.corrected"] > 30
    assert summary["bottom_lines"][0]["path"] == str(tmp_path / "line.xtf.bottom-line.json")
    exports = ["--pdf", "sheet.pdf", "--geotiff", "map.tif", "--crs", "utm", "--coco", "coco"]
    assert main(["export", str(results), *exports]) == 0
    with rasterio.open(tmp_path / "map.tif") as picture:
        assert picture.crs.is_projected
        assert 32600 < picture.crs.to_epsg() < 32800  # UTM on WGS 84
        assert np.count_nonzero(picture.read(1)) > 0
    coco = COCO(str(tmp_path / "coco" / "annotations.json"))
    assert {one["image_id"] for one in coco.loadAnns(coco.getAnnIds())} == set(coco.getImgIds()) != set()
    assert len(coco.getImgIds()) <= len(read_verdicts(results)) == 2
    if (pdfinfo := shutil.which("pdfinfo")) is not None:
        said = subprocess.run([pdfinfo, "sheet.pdf"], check=True, capture_output=True, text=True).stdout
        assert "A4" in said
    assert (tmp_path / "sheet.pdf").read_bytes().startswith(b"%PDF-")


def test_contacts_of_an_archive_come_while_it_is_replayed_and_ten_are_judged_by_keys(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, record_property: Record
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "surveys").mkdir()
    for number in range(20):
        write_xtf(tmp_path / "surveys" / f"line-{number:02d}.xtf", archived_line(number))
    mission = open_new(logs_named([Path("surveys")]), None, "kim")

    async def go(page: BrowserPage, server: MissionServer) -> None:
        await first_pixels(page, server, record_property)
        assert mission.replay is not None
        mission.replay.start()
        (child,) = multiprocessing.active_children()
        journal = mission.folder / "contacts.jsonl"
        while not journal.exists() or b"\n" not in journal.read_bytes():
            await asyncio.sleep(0.01)
        # held still, so that the page has the time to show what there is
        assert child.pid is not None
        os.kill(child.pid, signal.SIGSTOP)
        try:
            await page.wait_for("bench.contacts.length > 0")
            assert not await page.evaluate("bench.state.replay_done")
            said = await page.evaluate("document.querySelector('#progress').textContent")
            assert "looking for contacts: " in said
        finally:
            os.kill(child.pid, signal.SIGCONT)
        while len(mission.contacts()["id"]) < 10 and mission.replay.is_running:  # the page has it read them
            await asyncio.sleep(0.05)
        await page.wait_for("bench.state.done && bench.contacts.length >= 10")
        assert await page.evaluate("bench.state.pings") == 20 * sum(isinstance(one, Ping) for one in archived_line(0))
        await page.evaluate(
            "(() => {const show = document.querySelector('#show'); show.value = 'open';"
            "show.dispatchEvent(new Event('input')); show.dispatchEvent(new Event('change'))})()"
        )
        for number in range(10):
            await page.press("j")
            await page.wait_for("bench.selected !== null")
            await page.press("mnu"[number % 3])
            await page.wait_for(f"bench.contacts.filter((one) => one.call).length === {number + 1}")

    visit(mission, go)
    judged = read_verdicts(mission.folder)
    assert len({verdict.object for verdict in judged}) == len(judged) == 10


@asynccontextmanager
async def live_service(out: Path) -> AsyncIterator[tuple[Callable[[float], Awaitable[None]], Callable[[], None]]]:
    """Run the service on a sonar and a compass at TCP ports; gives what sends their messages by shares, and stop.

    Its clock goes on with the messages, each of which it has read before the next one is sent.
    """
    run = sonar_logs.run_of("jsf", leg_m=60.0)
    cables = {port.name: FakeTcpServer() for port in run.config.ports}
    for cable in cables.values():
        await cable.start()
    ports = tuple(structs.replace(port, link=f"tcp://127.0.0.1:{cables[port.name].port}") for port in run.config.ports)
    service = ServiceConfig(source="ports", output_directory=str(out), queue_pings=4096)
    config = structs.replace(run.config, ports=ports, service=service, waterfall=WaterfallConfig(tile_rows=64))
    clock = ManualClock(run.recorded[0].stamp.utc_ns * 1e-9)
    source = PortSource(config, clock)
    payload = Service(config, source, console=lambda line: None)
    serving = asyncio.ensure_future(payload.run())
    sent, messages = dict.fromkeys(cables, 0), iter(run.recorded)

    async def send(share: float) -> None:
        for message in islice(messages, round(share * len(run.recorded))):
            clock.advance_to(message.stamp.utc_ns * 1e-9)
            await cables[message.port].send(message.data)
            sent[message.port] += len(message.data)
            while {port.name: port.received_bytes for port in source.health().ports} != sent:
                await asyncio.sleep(0)

    try:
        while not all(cable.n_clients for cable in cables.values()):
            await asyncio.sleep(0.01)
        yield send, payload.stop
    finally:
        payload.stop()
        await serving
        for cable in cables.values():
            await cable.stop()


def test_a_service_that_runs_is_seen_and_its_contacts_judged_as_it_finds_them(
    tmp_path: Path, record_property: Record
) -> None:
    async def run() -> None:
        async with live_service(tmp_path) as (send, stop):
            await send(0.75)  # a provisional picture comes with ping 64 of 422, rows that stay with ping 256
            mission = open_shown(tmp_path / "latest", [], None, "kim")

            async def go(page: BrowserPage, server: MissionServer) -> None:
                await first_pixels(page, server, record_property)
                assert await page.evaluate("[bench.state.live, bench.state.done, bench.contacts.length]") == [
                    True,
                    False,
                    0,
                ]
                await send(0.17)
                await page.wait_for("bench.contacts.length === 1 && bench.contacts[0].row !== null")
                await page.wait_for("!bench.state.provisional")
                rows = await page.evaluate("bench.state.stop_row")
                await page.press("j")
                await page.press("m")
                await page.wait_for("bench.contacts[0].call === 'mine_like'")
                # the bottom line waits for the end of the session
                await page.press("b")
                await page.wait_for("!document.querySelector('#bottom-tools').hidden")
                await page.click_on("#bottom-save")
                await page.wait_for("document.querySelector('#message').textContent.includes('a session ended')")
                await send(1.0)
                stop()
                await page.wait_for(f"bench.state.done && bench.state.stop_row > {rows} && bench.contacts.length === 2")

            await visiting(mission, go)
        assert [verdict.call for verdict in read_verdicts(mission.folder)] == ["mine_like"]

    asyncio.run(run())
