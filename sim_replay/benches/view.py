"""Take the pictures that the documentation shows of the page and of the report, in a real browser.

A script stands in for the analyst: it goes through the contacts of the scene `demo`, measures the shadow of a target by
clicking where it has to begin and end, and judges.
"""

from __future__ import annotations

import argparse
import asyncio
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from auv_mcm.errors import UsageError
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.settings.config import Config
from sim_replay.benches.browser import BrowserPage, browser_page, mission_page
from sim_replay.replay import replay
from sim_replay.report.report_file import redraw_report
from sim_replay.scoring.inputs import TruthObject, read_truth
from sim_replay.simulate import simulate
from sim_replay.simulator.scene_file import read_scene
from sim_replay.verdicts import VERDICTS_FILE
from sim_replay.view.mission import ShownMission
from sim_replay.view.mission_files import read_summary
from sim_replay.view.server import MissionServer
from sim_replay.view.show import open_shown, wait_for_session

_GATE_M: Final = 3.0  # m from a target, within which a contact is judged mine-like
_MEASURED: Final = 2  # of the targets, the one whose shadow is measured in the picture
_PICTURED: Final = "demo"  # of the named scenes: objects of every kind in three minutes
_LIVE_ROWS: Final = 600  # rows of 0.12 m of the live mission in the picture
_LIVE_SCENE: Final = """\
name: live
seed: 3
world: {depth_m: 18, relief_rms_m: 0.05, patch_m: 40, seabeds: [{type: sand, share: 0.6}, {type: rippled_sand}]}
sonar: {frequency_khz: 450, range_m: 30, n_samples: 600, ping_rate_hz: 10}
track:
  altitude_m: 5
  plan: {pattern: lawnmower, heading_deg: 35, n_legs: 1, leg_m: 180, spacing_m: 36}
objects:
  - {kind: cylinder, leg: 0, along_m: 15, across_m: 14, azimuth_deg: 35}
  - {kind: sphere, leg: 0, along_m: 30, across_m: -13}
  - {kind: truncated_cone, leg: 0, along_m: 50, across_m: 12}
  - {kind: cylinder, leg: 0, along_m: 75, across_m: -16, azimuth_deg: 90}
  - {kind: wedge, leg: 0, along_m: 95, across_m: 18, azimuth_deg: 125}
"""
_LIVE_SCENARIO: Final = """\
about: a running session to look at
scene: live-scene.yaml
speed: 2
run_s: 50
devices:
  sonar: {device: ping_protocol, link: serial, baud: 921600}
  nav: {device: nmea2000, link: slcan, baud: 921600}
service:
  service: {source: ports}
  ports:
    - {name: sonar, link: '{sonar}', device: ping_protocol, sonar: {range_m: 30, n_samples: 600}}
    - {name: nav, link: '{nav}', device: nmea2000}
expectations:
  - {test: the service ends when requested to stop, expected: {is: exit_code}}
"""


_REPORT_PX: Final = (1000, 2000)  # width and height of the report's picture
_TWO_FRAMES: Final = "new Promise((done) => setTimeout(() => requestAnimationFrame(done), 300))"  # 0.3 s for the map


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the bench's arguments."""
    parser.add_argument(
        "--out", metavar="DIR", type=Path, required=True, help="folder for missions and results; what is there is used"
    )
    made = parser.add_mutually_exclusive_group(required=True)
    made.add_argument("--pictures", metavar="DIR", type=Path, help="folder for screenshots of the documentation")
    made.add_argument(
        "--animation", metavar="FILE.webp", type=Path, help="film how contacts of the scene demo are judged"
    )


def run(arguments: argparse.Namespace) -> int:
    """Take the pictures or the film. Raises UsageError for --out."""
    if arguments.out.exists() and not arguments.out.is_dir():
        raise UsageError(f"--out {arguments.out} is a file. Name a folder")
    arguments.out.mkdir(parents=True, exist_ok=True)
    if arguments.animation is not None:
        from sim_replay.benches.view_animation import film_view

        print(f"{asyncio.run(film_view(arguments.out, arguments.animation))} frames: {arguments.animation}")
        return 0
    _renew_pictures(arguments.out, arguments.pictures)
    return 0


def _renew_pictures(out: Path, pictures: Path) -> None:
    """Take every picture that the documentation shows of the page and of the report."""
    pictures.mkdir(parents=True, exist_ok=True)
    folder, results = out / _PICTURED, out / f"{_PICTURED}-results"
    if not (folder / "truth.json").exists():
        simulate(read_scene(_PICTURED), folder)
    if read_summary(results) is None:
        replay([folder / "mission.xtf"], results, Config())
    (results / VERDICTS_FILE).unlink(missing_ok=True)
    mission = open_shown(results, [], None, "bench")
    mission.feed.join()
    asyncio.run(_page_pictures(mission, read_truth(folder / "truth.json").objects, pictures))
    mission.feed.close()
    redraw_report(results)
    asyncio.run(_report_picture(results, pictures))
    asyncio.run(_live_picture(out, pictures))
    print(f"renewed in {pictures}")


async def _page_pictures(mission: ShownMission, truth: Sequence[TruthObject], pictures: Path) -> None:
    async with mission_page(mission) as page:
        await _overview_pictures(page, pictures)
        await _judge(page, mission, [one for one in truth if one.is_target], pictures)
        if page.complaints:
            raise RuntimeError(f"the page complains: {page.complaints[:3]}")


async def _judge(page: BrowserPage, mission: ShownMission, targets: Sequence[TruthObject], pictures: Path) -> None:
    """Judge all contacts by the truth; the shadow of the second target is measured before."""
    contacts = mission.contacts()
    near, n_targets = _nearest_target(contacts, targets), 0
    await page.click_on("#table .head button:first-child")  # sorted by name: from start to end
    for _ in contacts["id"]:
        await page.press("j")
        name = str(await page.evaluate("bench.selected"))
        target = near.get(name)
        n_targets += target is not None
        is_pictured = target is not None and n_targets == _MEASURED
        if target is not None and is_pictured:
            await page.wait_for("document.querySelector('#card h3') !== null")
            await _measure_shadow(page, mission, name, target)
            await page.wait_for("!bench.busy")
            await page.screenshot(pictures / "view-measure.webp", quality=30)
            await page.press("Escape")
        await page.press("n" if target is None else "m")
        await page.wait_for(f"bench.contacts.find((one) => one.id === '{name}').call")
        if is_pictured:
            await page.wait_for("!bench.busy && document.querySelector('#card img') !== null")
            await page.screenshot(pictures / "view-judge.webp", quality=30)


async def _measure_shadow(page: BrowserPage, mission: ShownMission, name: str, target: TruthObject) -> None:
    """Click where the shadow in the first view begins and ends on a level floor."""
    card = mission.contact(name) or {}
    view, row = card["views"][0], card["view_rows"][0]
    altitude_m = read_scene(_PICTURED).track.altitude_m
    height_m = (target.height_m or 0.0) - target.burial_m
    begin_m = view["ground_range_m"] + 0.5 * (target.width_m or 0.0)
    side = -1.0 if view["side"] == "port" else 1.0
    await page.press("s")
    for across_m in (begin_m, begin_m * altitude_m / (altitude_m - height_m)):
        place = await page.evaluate(f"bench.screenOf({row}, {side * across_m})")
        await page.click(place["x"], place["y"])
    await page.wait_for("document.querySelector('#sizes').textContent.includes('height')")


def _nearest_target(contacts: dict[str, list[float]], targets: Sequence[TruthObject]) -> dict[str, TruthObject]:
    """Find the target that each contact is, by contact id."""
    placed = [index for index, latitude in enumerate(contacts["latitude"]) if latitude is not None]
    if not targets or not placed:
        return {}
    frame = LocalFrame(latitude_deg=targets[0].latitude_deg, longitude_deg=targets[0].longitude_deg)
    target_m = frame.to_enu([one.latitude_deg for one in targets], [one.longitude_deg for one in targets], 0.0)
    contact_m = frame.to_enu(
        [contacts["latitude"][index] for index in placed], [contacts["longitude"][index] for index in placed], 0.0
    )
    distance_m = np.hypot(*np.moveaxis(contact_m[:, None, :2] - target_m[None, :, :2], -1, 0))
    best = distance_m.argmin(axis=1)
    return {
        str(contacts["id"][index]): targets[best[order]]
        for order, index in enumerate(placed)
        if distance_m[order, best[order]] <= _GATE_M
    }


async def _overview_pictures(page: BrowserPage, folder: Path) -> None:
    await page.evaluate("document.querySelector('[data-layer=coverage]').click()")
    await page.wait_for("bench.tiles.size > 8 && !bench.busy")
    await page.evaluate(_TWO_FRAMES)
    await page.screenshot(folder / "view.webp", quality=30)
    for theme in ("night", "day", "dusk"):  # in the order of the key
        await page.press("t")
        await page.wait_for("!bench.busy")
        await page.evaluate(_TWO_FRAMES)
        if theme != "dusk":
            await page.screenshot(folder / f"view-{theme}.webp", quality=30)
    await _bottom_picture(page, folder)


async def _bottom_picture(page: BrowserPage, folder: Path) -> None:
    """Draw a stretch along the bottom line, which is not kept."""
    await page.press("b")
    await page.wait_for("!document.querySelector('#bottom-tools').hidden && !bench.busy")
    await page.evaluate("(bench.view.along = 40, bench.view.across = 0, bench.view.scale = 22, bench.redraw())")
    await page.evaluate(_TWO_FRAMES)
    await page.wait_for("!bench.busy")
    for row in (280.0, 340.0, 400.0):
        place = await page.evaluate(f"bench.screenOf({row}, bench.bottom.returnAt({row}))")
        await page.click(place["x"], place["y"])
    await page.evaluate(_TWO_FRAMES)
    await page.screenshot(folder / "view-bottom.webp", quality=30)
    await page.evaluate("bench.bottom.reset()")
    await page.press("Escape")


async def _report_picture(results: Path, folder: Path) -> None:
    """Take the report from its head to the first contacts."""
    async with browser_page(*_REPORT_PX) as page:
        await page.open((results / "report.html").resolve().as_uri())
        await page.evaluate(_TWO_FRAMES)
        await page.screenshot(folder / "report.jpg", kind="jpeg", quality=60)


async def _live_picture(out: Path, pictures: Path) -> None:
    """Follow a run of hardware in the loop at the page until it shows some track and a contact."""
    (out / "live-scene.yaml").write_text(_LIVE_SCENE, encoding="utf-8")
    (out / "live.yaml").write_text(_LIVE_SCENARIO, encoding="utf-8")
    shutil.rmtree(out / "live", ignore_errors=True)
    hil = ("-m", "auv_mcm", "hil", str(out / "live.yaml"), "--out", str(out / "live"))
    process = await asyncio.create_subprocess_exec(sys.executable, *hil, stdout=asyncio.subprocess.DEVNULL)
    session = out / "live" / "live" / "results" / "latest"
    try:
        await asyncio.to_thread(wait_for_session, session)
        mission = open_shown(session, [], None, "bench")
        server = MissionServer(mission)
        await server.open()
        async with browser_page() as page:
            await page.open(server.url)
            await page.wait_for("window.bench && bench.state.live")
            await page.wait_for(f"bench.state.stop_row > {_LIVE_ROWS} && bench.contacts.length && !bench.busy")
            await page.screenshot(pictures / "view-live.webp", quality=30)
        await server.close()
        mission.feed.close()
    finally:
        await process.wait()
