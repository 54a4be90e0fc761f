"""Judge whole missions in a real browser, by key and click, and compare what was measured with the truth.

A script stands in for the analyst: it goes through the table from the first contact to the last, judges each by the
truth where there is one, and measures shadows by clicking at their edges as the pixels of the waterfall show them,
which know nothing of the truth. Then the mission is replayed again and the verdicts are looked for.
"""

from __future__ import annotations

import argparse
import asyncio
import math
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.errors import UsageError
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.settings.config import Config
from sim_replay.benches.browser import BrowserPage, browser_page, mission_page
from sim_replay.benches.shadow_edges import ShadowEdges, clearest_shadow
from sim_replay.replay import replay
from sim_replay.report.report_file import redraw_report
from sim_replay.scoring.inputs import TruthObject, read_truth
from sim_replay.simulate import simulate
from sim_replay.simulator.scene import Scene
from sim_replay.simulator.scene_file import read_scene
from sim_replay.text_tables import columns
from sim_replay.verdicts import VERDICTS_FILE, match_verdicts, newest_verdicts, read_verdicts
from sim_replay.view.mission import ShownMission
from sim_replay.view.mission_files import ContactFile, overview, read_summary
from sim_replay.view.places import WaterfallPoint
from sim_replay.view.server import MissionServer
from sim_replay.view.show import open_shown, wait_for_session

N_LEGS: Final = 14
"""Legs of the ripple scene, 290 m each at 2 m/s: 44 minutes with the turns, measured."""
_FLAT_LEGS: Final = 6  # at most, of the scene `flat`, where no relief takes part in the heights: 17 minutes
_GATE_M: Final = 3.0  # m from a target, within which a contact is judged mine-like
_HEIGHT_M: Final = 0.1  # m: error of a height that a decision can bear
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


class JudgedMission(NamedTuple):
    """Hold what came of judging one mission.

    heights_m: measured and true, (n, 2). n_found_again: verdicts that belong to a contact of the second replay, by
    another detector; n_marked: those that are shown as marks of their own.
    """

    name: str
    minutes: float
    n_contacts: int
    n_verdicts: int
    heights_m: NDArray[np.float64]
    n_found_again: int
    n_marked: int


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the bench's arguments."""
    parser.add_argument("logs", metavar="LOG", nargs="*", type=Path, help="recorded lines to judge as well")
    parser.add_argument(
        "--out", metavar="DIR", type=Path, required=True, help="folder for missions and results; what is there is used"
    )
    parser.add_argument("--pictures", metavar="DIR", type=Path, help="folder for screenshots of the documentation")
    parser.add_argument(
        "--animation", metavar="FILE.webp", type=Path, help="instead, film how contacts of the scene demo are judged"
    )
    parser.add_argument("--legs", metavar="N", type=int, default=N_LEGS, help=f"legs to simulate (default {N_LEGS})")


def run(arguments: argparse.Namespace) -> int:
    """Judge simulated missions and the logs; print a line for each. Raises UsageError for --out or --legs."""
    if not 0 <= arguments.legs <= 64:
        raise UsageError(f"--legs {arguments.legs} is not from 0 to 64")
    if arguments.out.exists() and not arguments.out.is_dir():
        raise UsageError(f"--out {arguments.out} is a file. Name a folder")
    arguments.out.mkdir(parents=True, exist_ok=True)
    if arguments.animation is not None:
        from sim_replay.benches.view_animation import film_view

        print(f"{asyncio.run(film_view(arguments.out, arguments.animation))} frames: {arguments.animation}")
        return 0
    if arguments.pictures is not None:
        _renew_pictures(arguments.out, arguments.pictures)
        return 0
    missions: list[tuple[str, Path, tuple[TruthObject, ...]]] = []
    scenes = {"ripple": arguments.legs, "flat": min(arguments.legs, _FLAT_LEGS)} if arguments.legs else {}
    for name, n_legs in scenes.items():
        log, objects = _flown(_scene(name, n_legs), arguments.out / name)
        missions.append((name, log, objects))
    missions += [(log.stem, log, ()) for log in arguments.logs]
    judged = [_judge_mission(name, log, truth, arguments.out) for name, log, truth in missions]
    print(columns(_HEADER, [_line(one) for one in judged]))
    return 0


def _scene(name: str, n_legs: int) -> Scene:
    scene = read_scene(name)
    plan = msgspec.structs.replace(scene.track.plan, n_legs=n_legs)
    return msgspec.structs.replace(scene, track=msgspec.structs.replace(scene.track, plan=plan))


def _flown(scene: Scene, folder: Path) -> tuple[Path, tuple[TruthObject, ...]]:
    if not (folder / "truth.json").exists():
        simulate(scene, folder)
    return folder / "mission.xtf", read_truth(folder / "truth.json").objects


def _judged(log: Path, truth: Sequence[TruthObject], results: Path, pictures: Path | None) -> NDArray[np.float64]:
    """Replay a log and judge it; returns heights measured and true, (n, 2)."""
    if read_summary(results) is None:
        replay([log], results, Config())
    (results / VERDICTS_FILE).unlink(missing_ok=True)
    mission = open_shown(results, [], None, "bench")
    mission.feed.join()
    heights_m = asyncio.run(_judge(mission, truth, pictures))
    mission.feed.close()
    return heights_m


def _renew_pictures(out: Path, pictures: Path) -> None:
    """Take every picture that the documentation shows of the page and of the report, instead of judging."""
    pictures.mkdir(parents=True, exist_ok=True)
    log, truth = _flown(read_scene(_PICTURED), out / _PICTURED)
    results = out / f"{_PICTURED}-results"
    _judged(log, truth, results, pictures)
    redraw_report(results)
    asyncio.run(_report_picture(results, pictures))
    asyncio.run(_live_picture(out, pictures))
    print(f"renewed in {pictures}")


def _judge_mission(name: str, log: Path, truth: Sequence[TruthObject], out: Path) -> JudgedMission:
    results, again = out / f"{name}-results", out / f"{name}-again"
    config = Config()
    heights_m = _judged(log, truth, results, None)
    summary = read_summary(results)
    assert summary is not None
    verdicts = read_verdicts(results)
    # Another detector finds other contacts under other numbers; the verdicts have to find them by place.
    if read_summary(again) is None:
        contrast = msgspec.structs.replace(config.detect, model="none")
        replay([log], again, msgspec.structs.replace(config, detect=contrast))
    found = ContactFile(again)
    found.refresh()
    matched = match_verdicts(verdicts, [overview(feature).place for feature in found.features.values()])
    newest = newest_verdicts(verdicts)
    return JudgedMission(
        name=name,
        minutes=float(summary["duration_s"]) / 60.0,
        n_contacts=int(summary["contacts"]),
        n_verdicts=len(newest),
        heights_m=heights_m,
        n_found_again=len(matched),
        n_marked=len(newest) - len(matched),
    )


async def _judge(mission: ShownMission, truth: Sequence[TruthObject], pictures: Path | None) -> NDArray[np.float64]:
    """Go through all contacts at the page; returns heights measured and true, (n, 2)."""
    async with mission_page(mission) as page:
        if pictures is not None and truth:
            await _overview_pictures(page, pictures)
        heights = await _judge_all(page, mission, truth, pictures)
        if page.complaints:
            raise RuntimeError(f"the page complains: {page.complaints[:3]}")
    return np.array(heights, dtype=np.float64).reshape(-1, 2)


async def _judge_all(
    page: BrowserPage, mission: ShownMission, truth: Sequence[TruthObject], pictures: Path | None
) -> list[tuple[float, float]]:
    heights: list[tuple[float, float]] = []
    targets = [one for one in truth if one.is_target]
    contacts = mission.contacts()
    near, measured = _nearest_target(contacts, targets), set[int]()
    await page.click_on("#table .head button:first-child")  # sorted by name: from start to end
    for _ in contacts["id"]:
        await page.press("j")
        name = str(await page.evaluate("bench.selected"))
        target = near.get(name)
        # A target that two contacts stand for is measured once.
        if target is not None and target.height_m is not None and id(target) not in measured:
            view, edges = clearest_shadow(mission.store, _views(mission, name))
            if edges:
                measured.add(id(target))
                await page.wait_for("document.querySelector('#card h3') !== null")
                buttons = "[...document.querySelectorAll('#card button')]"
                await page.evaluate(f"{buttons}.find((one) => one.textContent === 'view {view + 1}').click()")
                measured_m = await _measure_shadows(page, edges)
                if pictures is not None and len(heights) == 1:  # of the target that is seen judged below
                    await page.wait_for("!bench.busy")
                    await page.screenshot(pictures / "view-measure.webp", quality=30)
                heights.append((measured_m, target.height_m - target.burial_m))
        is_likely = (
            target is not None
            if truth
            else await page.evaluate(f"bench.contacts.find((one) => one.id === '{name}').likely")
        )
        await page.press("m" if is_likely else "n")
        await page.wait_for(f"bench.contacts.find((one) => one.id === '{name}').call")
        if pictures is not None and len(heights) == 2 and target is not None:
            await page.wait_for("!bench.busy && document.querySelector('#card img') !== null")
            await page.screenshot(pictures / "view-judge.webp", quality=30)
            pictures = None
    return heights


def _views(mission: ShownMission, name: str) -> list[WaterfallPoint]:
    """Find where each view of a contact lies in the waterfall; NaN for a view that is not in it."""
    card = mission.contact(name) or {}
    return [
        WaterfallPoint(
            math.nan if row is None else row,
            -view["ground_range_m"] if view["side"] == "port" else view["ground_range_m"],
        )
        for row, view in zip(card.get("view_rows", ()), card.get("views", ()), strict=True)
    ]


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


async def _measure_shadows(page: BrowserPage, shadows: Sequence[ShadowEdges]) -> float:
    """Measure each with two clicks; returns the height that the page takes from all of them, m."""
    await page.press("s")
    text = ""
    for number, edges in enumerate(shadows, 1):
        for row, across_m in edges[:2]:
            place = await page.evaluate(f"bench.screenOf({row}, {across_m})")
            await page.click(place["x"], place["y"])
        line = "document.querySelector('#sizes').textContent"
        awaited = "height" if number == 1 else f"median of {number},"
        text = str(await page.wait_for(f"{line}.includes('{awaited}') && {line}"))
    await page.press("Escape")
    return float(text.partition("height ")[2].partition(" m")[0])


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


_HEADER: Final = (
    "mission",
    "min",
    "contacts",
    "verdicts",
    "found again",
    "marked",
    "heights",
)


def _line(one: JudgedMission) -> list[str]:
    return [
        one.name,
        f"{one.minutes:.0f}",
        str(one.n_contacts),
        str(one.n_verdicts),
        str(one.n_found_again),
        str(one.n_marked),
        _agreement(one.heights_m),
    ]


def _agreement(heights_m: NDArray[np.float64]) -> str:
    """Say how many heights are true to 0.1 m, and by how much they are off. heights_m: (n, 2)."""
    if not len(heights_m):
        return "-"
    error_m = np.abs(heights_m[:, 0] - heights_m[:, 1])
    n_true = np.count_nonzero(error_m <= _HEIGHT_M)
    rms_m = float(np.sqrt(np.mean(error_m**2)))
    return f"{n_true} of {len(error_m)} within {_HEIGHT_M} m, median {np.median(error_m):.2f} m, rms {rms_m:.2f} m"
