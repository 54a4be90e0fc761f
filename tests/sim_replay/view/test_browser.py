"""The page in a real browser: what a person sees, presses and measures. One browser for all, for its start is dear."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Awaitable, Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from auv_mcm.records import SIDES
from sim_replay.benches.browser import BrowserPage, browser_page, find_browser
from sim_replay.verdicts import Verdict, read_verdicts
from sim_replay.view.chart import Chart
from sim_replay.view.mission import Judgement, ShownMission
from sim_replay.view.server import MissionServer
from sim_replay.view.waterfall_store import WaterfallStore
from tests.sim_replay.view.shown_missions import feature, shown, tile, write_results

pytestmark = pytest.mark.skipif(
    find_browser() is None, reason="needs Chromium: apt-get install chromium, or name one in CHROMIUM"
)

SCRIPT = "<img src=x onerror='window.hacked=1'><script>window.hacked=1</script>"
N_ROWS, N_COLUMNS = 512, 400
OBJECT_ROW, OBJECT_M, SHADOW_M, HEIGHT_M = 200.0, 12.0, 13.044, 0.376  # an edge 0.376 m high, 5 m under the sonar


def sea_floor() -> WaterfallStore:
    """Speckle with one object: a bright edge up to OBJECT_M and its shadow up to SHADOW_M."""
    store, speckle = WaterfallStore(), np.random.default_rng(3)
    for first_row in range(0, N_ROWS, 64):
        for side in SIDES:
            pixels = speckle.exponential(1.0, (64, N_COLUMNS)).astype(np.float32)
            if side == "starboard" and first_row <= OBJECT_ROW < first_row + 64:
                rows = slice(int(OBJECT_ROW) - 4 - first_row, int(OBJECT_ROW) + 4 - first_row)
                pixels[rows, 195:200], pixels[rows, 200:217] = 20.0, 0.01
            store.add(tile(side, first_row, pixels))
    return store


def in_browser(
    mission: ShownMission, visit: Callable[[BrowserPage], Awaitable[None]], chart: Chart | None = None
) -> None:
    async def run() -> None:
        server = MissionServer(mission, chart=chart)
        await server.open()
        try:
            async with browser_page(1200, 800) as page:
                await page.open(server.url)
                await page.wait_for("window.bench && bench.state.done && bench.contacts.length > 0")
                await visit(page)
                assert await page.evaluate("window.hacked === undefined")
                assert page.complaints == []
        finally:
            await server.close()

    asyncio.run(run())


async def click_at(page: BrowserPage, row: float, across_m: float) -> None:
    """Click at a place of the waterfall."""
    place = await page.evaluate(f"bench.screenOf({row}, {across_m})")
    await page.click(place["x"], place["y"])


async def look(page: BrowserPage) -> None:
    # a long table holds elements for what is in sight alone
    assert await page.evaluate("document.querySelector('#count').textContent") == "9999 of 9999"
    assert await page.evaluate("document.querySelectorAll('#table .row').length") < 80
    # the waterfall is painted: not one colour
    await page.wait_for("!bench.busy")
    colours = (
        "(() => {const c = document.querySelector('#waterfall-picture'), d = c.getContext('2d')"
        ".getImageData(0, 0, c.width, c.height).data; return new Set(new Uint32Array(d.buffer)).size})()"
    )
    assert await page.evaluate(colours) > 50


async def judge_and_measure(page: BrowserPage) -> None:
    # the likeliest contact comes first; a key judges it
    await page.press("j")
    assert await page.evaluate("bench.selected") == "C00001"
    await page.wait_for("document.querySelector('#card h3') !== null")
    # its shadow is measured with two clicks, three times; the median is kept with the verdict
    await page.press("s")
    for number, end_m in enumerate((SHADOW_M, SHADOW_M - 0.6, SHADOW_M), 1):
        for across_m in (OBJECT_M, end_m):
            await click_at(page, OBJECT_ROW, across_m)
        awaited = "height" if number == 1 else f"median of {number},"
        await page.wait_for(f"document.querySelector('#sizes').textContent.includes('{awaited}')")
    await page.press("Escape")
    await page.press("m")
    await page.wait_for("bench.contacts.find((one) => one.id === 'C00001').call === 'mine_like'")


async def comment(page: BrowserPage, mission: ShownMission) -> None:
    # a comment that is markup stays text
    await page.press("c")
    await page.write(SCRIPT)
    await page.click_on("#save")
    await page.wait_for("document.querySelector('#card').textContent.includes('onerror')")
    # a verdict from elsewhere draws the card anew; what is being written stays, and so does the cursor
    await page.press("c")
    await page.write("half ")
    mission.judge(Judgement(contact_id="C00001", call="undecided", comment=SCRIPT))
    await page.wait_for("document.querySelector('#call-undecided').getAttribute('aria-pressed') === 'true'")
    await page.write("a sentence")
    assert "half a sentence" in await page.evaluate("document.querySelector('#comment').value")
    await page.press("Escape")


async def judge_another_and_draw_one(page: BrowserPage) -> None:
    # another contact, whose very class is markup
    await page.press("j")
    await page.wait_for("bench.selected === 'C00002' && document.querySelector('#card h3') !== null")
    await page.press("n")
    await page.wait_for("bench.contacts.find((one) => one.id === 'C00002').call === 'not_mine_like'")
    # one that was missed
    await page.press("d")
    await page.evaluate("bench.view.along = 30, bench.view.across = 0, 0")
    await click_at(page, 260.0, 6.0)
    await page.wait_for("bench.contacts.some((one) => one.drawn)")


async def search_and_point(page: BrowserPage) -> None:
    # search and filter
    await page.press("/")
    await page.write("onerror")
    await page.wait_for("document.querySelector('#count').textContent.startsWith('1 of')")
    # every screen has its own look
    await page.press("Escape")
    grounds = set()
    for _ in range(3):
        await page.press("t")
        grounds.add(await page.evaluate("getComputedStyle(document.body).backgroundColor"))
    assert len(grounds) == 3
    # the cursor says where it is
    place = await page.evaluate("bench.screenOf(260, 6)")
    await page.move(place["x"] + 3, place["y"])
    await page.wait_for("document.querySelector('#cursor').textContent.includes('depth 15.0 m')")
    assert "starboard" in await page.evaluate("document.querySelector('#cursor').textContent")


def test_an_analyst_looks_judges_measures_and_draws(tmp_path: Path) -> None:
    others = [feature(number, 10.0 + number * 0.04, -15.0, p_mine=0.05) for number in range(3, 10_000)]
    hostile = feature(2, 300.0, -8.0, p_mine=0.5, **{"class": SCRIPT, "reasons": [SCRIPT]})
    folder = write_results(tmp_path, [feature(1, OBJECT_ROW, OBJECT_M), hostile, *others])
    mission = shown(folder, sea_floor())

    async def visit(page: BrowserPage) -> None:
        await look(page)
        await judge_and_measure(page)
        await comment(page, mission)
        await judge_another_and_draw_one(page)
        await search_and_point(page)

    in_browser(mission, visit)
    verdicts = read_verdicts(folder)
    assert [(one.contact_id, one.call) for one in verdicts] == [
        ("C00001", "mine_like"),
        ("C00001", "mine_like"),
        ("C00001", "undecided"),
        ("C00002", "not_mine_like"),
        ("", "mine_like"),
    ]
    assert verdicts[1].comment == SCRIPT
    assert verdicts[1].height_m == pytest.approx(HEIGHT_M, abs=0.03)  # a pixel of the screen is 4 cm there
    assert verdicts[4].drawn
    assert verdicts[4].ground_range_m == pytest.approx(6.0, abs=0.1)


def test_what_was_done_to_the_bottom_line_is_undone_step_by_step_and_else_to_be_saved(tmp_path: Path) -> None:
    async def visit(page: BrowserPage) -> None:
        steps = """(() => {
          const line = bench.bottom, noted = [], place = (row, range) => [row, range];
          const note = () => noted.push([line.isChanged, JSON.stringify(line.stretches)]);
          line.click({row: 10, across_m: 4}); line.click({row: 30, across_m: 4}); line.saved();
          line.press(10, 4, place); line.drag({row: 15, across_m: 6}); line.drag({row: 12, across_m: 6}); note();
          line.click({row: 20, across_m: 5}); line.clear(); note();
          line.undo(); line.undo(); note();
          line.undo(); note();
          return noted;
        })()"""
        assert await page.evaluate(steps) == [
            [True, "[[[12,6],[30,4]]]"],
            [True, "[]"],
            [True, "[[[12,6],[30,4]]]"],
            [False, "[[[10,4],[30,4]]]"],
        ]

    in_browser(shown(write_results(tmp_path, [feature(1)]), sea_floor()), visit)


def test_places_asked_for_before_the_waterfall_was_made_are_asked_for_again(tmp_path: Path) -> None:
    """The answer may come after the provisional picture is gone."""

    async def visit(page: BrowserPage) -> None:
        await page.evaluate("""(async () => {
          const {mapView} = await import("./page/map.js"), map = mapView(bench.tiles, {select() {}});
          const asked = window.asked = [], fetched = window.fetch;
          window.fetch = async (path) => {
            if (!path.includes("strips")) return fetched(path);
            asked.push(path.split("strips/")[1]);
            await new Promise((done) => { window.answer = done; });
            return fetched(path);
          };
          window.grid = (provisional, stop_row) => map.setGrid({...bench.state, provisional, stop_row});
          grid(true, 128);
          grid(false, 128);
          answer();
        })()""")
        await page.wait_for("asked.length === 2")
        await page.evaluate("answer()")
        await page.wait_for("grid(true, 256), asked.length === 3")
        await page.evaluate("grid(false, 512), answer()")
        await page.wait_for("asked.length === 4")
        assert await page.evaluate("answer(), asked") == ["0/128", "0/128", "128/256", "0/512"]

    in_browser(shown(write_results(tmp_path, [feature(1)]), sea_floor()), visit)


def test_a_chart_lies_below_the_map_until_it_is_switched_off(tmp_path: Path) -> None:
    folder = write_results(tmp_path, [feature(1, OBJECT_ROW, OBJECT_M)])
    mission = shown(folder, sea_floor())
    latitude, longitude = mission.track()["latitude"][0], mission.track()["longitude"][0]
    encoded, png = cv2.imencode(".png", np.full((4, 4, 4), (0, 0, 255, 255), dtype=np.uint8))
    chart = Chart(png.tobytes(), longitude - 0.01, latitude - 0.01, longitude + 0.01, latitude + 0.01)
    reds = (
        "(() => {const c = document.querySelector('#map-picture'), d = c.getContext('2d')"
        ".getImageData(0, 0, c.width, c.height).data; let n = 0;"
        "for (let i = 0; i < d.length; i += 4) n += d[i] === 255 && d[i + 1] === 0 && d[i + 2] === 0; return n})()"
    )

    async def visit(page: BrowserPage) -> None:
        await page.wait_for(f"{reds} > 1000")
        await page.click_on("[data-layer=chart]")
        await page.wait_for(f"{reds} === 0")

    assert encoded
    in_browser(mission, visit, chart)


def test_a_measure_far_from_the_chosen_contact_asks_whose_it_is(tmp_path: Path) -> None:
    folder = write_results(tmp_path, [feature(1, OBJECT_ROW, OBJECT_M), feature(2, 480.0, -10.0, p_mine=0.5)])

    async def visit(page: BrowserPage) -> None:
        await page.press("j")
        await page.press("j")
        await page.wait_for("bench.selected === 'C00002'")
        await page.press("l")
        await page.evaluate(f"bench.view.along = {OBJECT_ROW * 0.12}, bench.view.across = 12, 0")
        for across_m in (11.0, 12.0):
            await click_at(page, OBJECT_ROW, across_m)
        await page.wait_for("document.querySelector('#ask').open")
        assert "from C00002" in await page.evaluate("document.querySelector('#question').textContent")
        await page.click_on("#ask button[value=no]")
        await page.wait_for("!document.querySelector('#ask').open")
        assert "nothing measured" in await page.evaluate("document.querySelector('#sizes').textContent")

    in_browser(shown(folder, sea_floor()), visit)
    assert read_verdicts(folder) == ()


def test_a_contact_whose_pings_are_not_made_yet_says_so_and_is_jumped_to_when_they_are(tmp_path: Path) -> None:
    folder = write_results(tmp_path, [feature(1, 700.0, 12.0)])  # beyond the 512 rows there are
    mission = shown(folder, sea_floor())

    async def visit(page: BrowserPage) -> None:
        mission.feed.is_done = False
        await page.wait_for("!bench.state.done")
        await page.press("j")
        note = "document.querySelector('#waterfall-note')"
        await page.wait_for(f"!{note}.hidden && {note}.textContent.includes('C00001 is not made yet')")
        await page.press("n")
        await page.wait_for("document.querySelector('#ask').open")
        await page.click_on("#ask button[value=no]")
        for first_row in range(N_ROWS, 768, 64):
            for side in SIDES:
                mission.store.add(tile(side, first_row, np.ones((64, N_COLUMNS), dtype=np.float32)))
        await page.wait_for(f"{note}.hidden")
        assert abs(await page.evaluate("bench.view.along") - 700.0 * 0.12) < 1.0

    in_browser(mission, visit)
    assert read_verdicts(folder) == ()


def test_from_afar_a_called_contact_is_marked_among_many_however_low_its_p_mine(tmp_path: Path) -> None:
    called = feature(1, 100.0, 10.0, p_mine=0.1)
    others = [feature(number, 400.0, -10.0, p_mine=0.1, called=False) for number in range(2, 403)]
    marked = (
        "(() => {{const c = document.querySelector('#waterfall-marks'), b = c.getBoundingClientRect(),"
        " at = bench.screenOf({}, {}); return c.getContext('2d')"
        ".getImageData(at.x - b.left - 9, at.y - b.top - 9, 18, 18).data.some((value) => value > 0)}})()"
    )

    async def visit(page: BrowserPage) -> None:
        await page.evaluate("bench.view.scale = 3, bench.redraw(), 0")
        await page.wait_for(marked.format(100.0, 10.0))
        assert not await page.evaluate(marked.format(400.0, -10.0))

    in_browser(shown(write_results(tmp_path, [called, *others]), sea_floor()), visit)


def test_what_was_drawn_has_the_time_it_was_judged_at(tmp_path: Path) -> None:
    mission = shown(write_results(tmp_path, [feature(1, OBJECT_ROW, OBJECT_M)]), sea_floor())

    async def visit(page: BrowserPage) -> None:
        await page.press("d")
        await page.evaluate("bench.view.along = 30, bench.view.across = 0, 0")
        await click_at(page, 260.0, 6.0)
        await page.wait_for("document.querySelector('#card h3') !== null")
        text = await page.evaluate("document.querySelector('#card').textContent")
        assert "null" not in text
        assert "undefined" not in text
        assert "kim: mine-like" in text
        # a message stays to be read, however often the page asks the server meanwhile
        await page.press("Escape")
        await page.press("l")
        for across_m in (6.0, 8.0):
            await click_at(page, 260.0, across_m)
        await page.wait_for("!document.querySelector('#message').hidden")
        for _ in range(2):
            await page.evaluate("window.before = bench.state, 0")
            await page.wait_for("bench.state !== window.before")
        assert "choose a contact" in await page.evaluate("document.querySelector('#message:not([hidden])').textContent")
        await page.press("Escape")
        # on a small screen the card of a contact that is chosen is in sight, and the header is a line
        size = {"width": 390, "height": 844, "deviceScaleFactor": 1, "mobile": False}
        await page.command("Emulation.setDeviceMetricsOverride", **size)
        await page.wait_for("innerWidth === 390")
        await page.press("j")
        box = "document.querySelector('#card').getBoundingClientRect()"
        await page.wait_for(f"!document.querySelector('#card').hidden && {box}.top >= 0 && {box}.top < 600")
        assert await page.evaluate("document.querySelector('header').getBoundingClientRect().height") < 80

    in_browser(mission, visit)


def test_a_late_answer_takes_nobody_back_to_the_object_judged_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mission = shown(write_results(tmp_path, [feature(1, OBJECT_ROW, OBJECT_M)]), sea_floor())
    mission.judge(Judgement(row=20.0, across_m=-8.0, call="mine_like"))
    judge, may_answer = mission.judge, threading.Event()

    def judge_late(judgement: Judgement) -> Verdict:
        verdict = judge(judgement)
        may_answer.wait(60.0)
        return verdict

    monkeypatch.setattr(mission, "judge", judge_late)

    async def visit(page: BrowserPage) -> None:
        await page.wait_for("bench.contacts.length === 2")
        await page.press("k")
        await page.press("j")
        await page.wait_for("bench.selected === 'V0001'")
        await page.press("u")
        await page.press("k")
        await page.wait_for("bench.selected === 'C00001'")
        may_answer.set()
        await page.wait_for("bench.contacts.some((one) => one.call === 'undecided')")
        await page.press("n")
        await page.wait_for("bench.contacts.find((one) => one.id === 'C00001').call === 'not_mine_like'")
        assert [one.object for one in read_verdicts(tmp_path)] == ["V0001", "V0001", "V0002"]

    in_browser(mission, visit)


def test_what_was_begun_about_a_contact_goes_on_after_a_replay_and_to_no_other_of_its_id(tmp_path: Path) -> None:
    store = sea_floor()
    mission = shown(write_results(tmp_path, [feature(1, OBJECT_ROW, OBJECT_M)]), store)

    async def visit(page: BrowserPage) -> None:
        await page.press("j")
        await page.wait_for("bench.selected === 'C00001' && document.querySelector('#comment') !== null")
        await page.press("c")
        await page.write("a mine")
        write_results(tmp_path, [feature(1, 400.0, -10.0), feature(2, OBJECT_ROW, OBJECT_M)])
        await page.wait_for("window.bench && bench.contacts.length === 2 && bench.selected === 'C00002'")
        assert await page.evaluate("document.querySelector('#comment').value") == "a mine"
        # where nothing lies any more, what was written is shown, and given to nobody
        write_results(tmp_path, [feature(1, 400.0, -10.0)])
        await page.wait_for("window.bench && bench.contacts.length === 1 && document.querySelector('#ask').open")
        assert "a mine" in await page.evaluate("document.querySelector('#question').textContent")
        assert await page.evaluate("bench.selected") is None

    in_browser(mission, visit)
