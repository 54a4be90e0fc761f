"""Measure how fluid the page of a long mission is: ten hours of waterfall and 10,000 contacts in a real browser.

The waterfall is speckle, made straight into the page's own store, and the contacts are made up; the page, its server
and the browser are the real ones. Frames are counted by the browser while a script drags, zooms, scrolls and chooses
as a person would. Headless Chromium draws without a graphics card, so that a person's computer is quicker.
"""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.contacts.export import iso_time
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.records import SIDES, VALID, PoseTrack, Side, Tile
from sim_replay.benches.browser import BrowserPage, mission_page
from sim_replay.text_tables import columns
from sim_replay.view.mission import ShownMission
from sim_replay.view.mission_feed import MissionFeed
from sim_replay.view.waterfall_store import WaterfallStore

HOURS: Final = 10.0
"""h of mission, as long as an AUV's battery lasts."""
N_CONTACTS: Final = 10_000
"""Contacts: ten hours over crowded sea floor."""

_ROW_M, _COLUMN_M, _N_COLUMNS = 0.12, 0.06, 833  # pixels of a 50 m swath, as the chain makes them
_SPEED_MPS: Final = 2.0  # m/s, of an AUV on survey
_ALTITUDE_M, _DEPTH_M = 5.0, 15.0
_LEG_M, _LEG_APART_M = 1000.0, 90.0  # of the track
_TILE_ROWS: Final = 1024  # rows, made at once
_START_S: Final = 1_780_000_000.0  # UTC seconds since 1970
_MOVE_S: Final = 3.0  # s of each kind of movement
_STEP_S: Final = 0.016  # s between two moves of the pointer: that of a screen
_FRAMES: Final = """new Promise((done) => {
  const at = [];
  const frame = (now) => { at.push(now); if (now - at[0] < %d) requestAnimationFrame(frame); else done(at); };
  requestAnimationFrame(frame);
})"""


class Frames(NamedTuple):
    """Hold the frames while the page was moved. interval_ms: between two frames, (n,)."""

    movement: str
    interval_ms: NDArray[np.float64]


def long_mission(folder: Path, hours: float, n_contacts: int) -> ShownMission:
    """Make the page's mission: a waterfall of speckle along a lawnmower, and contacts all over it."""
    n_rows = round(hours * 3600.0 * _SPEED_MPS / _ROW_M)
    store = WaterfallStore(folder)
    speckle = np.random.Generator(np.random.PCG64(1)).exponential(1.0, (2, _TILE_ROWS, _N_COLUMNS)).astype(np.float32)
    home = LocalFrame(latitude_deg=54.1, longitude_deg=10.2)
    for first_row in range(0, n_rows, _TILE_ROWS):
        pose = _poses(home, first_row)
        for side, pixels in zip(SIDES, speckle, strict=True):
            store.add(_tile(side, first_row, pixels, pose))
    _write_contacts(folder, store, n_contacts)
    feed = MissionFeed(store, lambda stop: None)
    feed.start()
    feed.join()
    mission = ShownMission(folder, feed, by="bench", is_live=False)
    mission.refresh()
    return mission


async def frames(mission: ShownMission) -> list[Frames]:
    """Move the page in every way and count its frames."""
    async with mission_page(mission) as page:
        await asyncio.sleep(1.0)  # the map is drawn a moment later
        found = []
        for movement, move in _MOVEMENTS.items():
            await page.evaluate("bench.view.along = 3000, bench.view.across = 0, 0")
            found.append(Frames(movement, await _counted(page, move)))
        return found


def bench_frames(folder: Path, hours: float = HOURS, n_contacts: int = N_CONTACTS) -> None:
    """Print how long the frames of a long mission take."""
    began_s = time.process_time()
    mission = long_mission(folder, hours, n_contacts)
    made_s = time.process_time() - began_s
    print(
        f"{hours:g} h of waterfall, {mission.store.stop_row} rows of 2 x {_N_COLUMNS} columns, made in {made_s:.0f} s; "
        f"{n_contacts} contacts"
    )
    rows = []
    for one in asyncio.run(frames(mission)):
        median, most, worst = np.quantile(one.interval_ms, [0.5, 0.95, 1.0])
        rows.append([one.movement, str(len(one.interval_ms)), f"{median:.0f}", f"{most:.0f}", f"{worst:.0f}"])
    print(columns(("movement", "frames", "median ms", "95 % ms", "longest ms"), rows))
    mission.store.close()


async def _counted(page: BrowserPage, move: Callable[[BrowserPage], Awaitable[None]]) -> NDArray[np.float64]:
    """Count frames while the page is moved. The browser answers one command at a time, so it counts by itself."""
    await page.evaluate(f"void (window.counted = {_FRAMES % round(1e3 * _MOVE_S)})")
    began_s = time.monotonic()
    while time.monotonic() - began_s < _MOVE_S:
        await move(page)
        await asyncio.sleep(_STEP_S)
    at_ms = np.array(await page.evaluate("window.counted"), dtype=np.float64)
    await page.wait_for("!bench.busy")
    return np.diff(at_ms)


async def _drag_waterfall(page: BrowserPage) -> None:
    await _drag(page, "#waterfall-view")


async def _drag_map(page: BrowserPage) -> None:
    await _drag(page, "#map-view")


async def _drag(page: BrowserPage, selector: str) -> None:
    """Press, move by some steps, release."""
    x, y = await _middle(page, selector)
    await page.command("Input.dispatchMouseEvent", type="mousePressed", x=x, y=y, button="left", buttons=1)
    for step in range(1, 9):
        await page.command("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y + 12 * step, buttons=1)
        await asyncio.sleep(_STEP_S)
    await page.command("Input.dispatchMouseEvent", type="mouseReleased", x=x, y=y + 96, button="left")


async def _zoom_waterfall(page: BrowserPage) -> None:
    # Out for a second, in for the next: from single pixels to the whole mission.
    await page.wheel(*await _middle(page, "#waterfall-view"), 120.0 if time.monotonic() % 2.0 < 1.0 else -120.0)


async def _scroll_table(page: BrowserPage) -> None:
    await page.wheel(*await _middle(page, "#table"), 240.0)


async def _step_contacts(page: BrowserPage) -> None:
    await page.press("j")


_MOVEMENTS: Final[dict[str, Callable[[BrowserPage], Awaitable[None]]]] = {
    "waterfall dragged": _drag_waterfall,
    "waterfall zoomed": _zoom_waterfall,
    "map dragged": _drag_map,
    "table scrolled": _scroll_table,
    "contact after contact": _step_contacts,
}


async def _middle(page: BrowserPage, selector: str) -> tuple[float, float]:
    box = await page.evaluate(
        f"(() => {{const box = document.querySelector({json.dumps(selector)}).getBoundingClientRect();"
        "return [box.left + box.width / 2, box.top + box.height / 2]})()"
    )
    return float(box[0]), float(box[1])


def _poses(home: LocalFrame, first_row: int) -> PoseTrack:
    """Give the poses of a lawnmower's rows, without the way of its turns."""
    way_m = (first_row + np.arange(_TILE_ROWS) + 0.5) * _ROW_M
    leg = np.floor(way_m / _LEG_M)
    along_m = way_m - leg * _LEG_M
    is_back = leg % 2.0 == 1.0
    north_m = np.where(is_back, _LEG_M - along_m, along_m)
    latitude, longitude, _ = home.to_geodetic(np.column_stack([leg * _LEG_APART_M, north_m, np.zeros(_TILE_ROWS)]))
    level = np.zeros(_TILE_ROWS)
    return PoseTrack(
        time_s=np.asarray(_START_S + way_m / _SPEED_MPS, dtype=np.float64),
        latitude_deg=latitude,
        longitude_deg=longitude,
        depth_m=level + (_DEPTH_M - _ALTITUDE_M),
        heading_rad=np.where(is_back, np.pi, 0.0),
        pitch_rad=level,
        roll_rad=level,
        speed_mps=level + _SPEED_MPS,
        altitude_m=level + _ALTITUDE_M,
        stale=np.zeros(_TILE_ROWS, dtype=np.bool_),
    )


def _tile(side: Side, first_row: int, pixels: NDArray[np.float32], pose: PoseTrack) -> Tile:
    return Tile(
        side=side,
        index=first_row // _TILE_ROWS,
        first_row=first_row,
        core_start=0,
        core_stop=_TILE_ROWS,
        row_spacing_m=_ROW_M,
        column_spacing_m=_COLUMN_M,
        intensity=pixels,
        mask=np.full(pixels.shape, VALID, dtype=np.uint8),
        pose=pose,
        first_return_m=np.full(_TILE_ROWS, _ALTITUDE_M),
        first_return_sigma_m=np.full(_TILE_ROWS, 0.05),
        ping_number=np.arange(first_row, first_row + _TILE_ROWS),
    )


def _write_contacts(folder: Path, store: WaterfallStore, n_contacts: int) -> None:
    random = np.random.Generator(np.random.PCG64(2))
    rows = np.sort(random.integers(0, store.stop_row, n_contacts))
    pose, _ = store.poses(rows)
    features: list[dict[str, Any]] = []
    for number, p_mine in enumerate(random.beta(0.3, 3.0, n_contacts).tolist()):
        time_text = iso_time(float(pose.time_s[number]))
        side = SIDES[number % 2]
        view = {"time": time_text, "side": side, "ground_range_m": 20.0, "p_mine": p_mine, "reasons": []}
        properties = {
            "id": f"C{number + 1:05d}",
            "time": time_text,
            "p_mine": p_mine,
            "class": "unknown",
            "belief": {},
            "length_m": None,
            "sigma_m": 1.0,
            "side": side,
            "ground_range_m": 20.0,
            "called": p_mine > 0.5,
            "n_views": 1,
            "aspects_deg": [],
            "reasons": [],
            "false_alarms_per_km2": None,
            "views": [view],
        }
        place = [float(pose.longitude_deg[number]), float(pose.latitude_deg[number])]
        features.append(
            {"type": "Feature", "geometry": {"type": "Point", "coordinates": place}, "properties": properties}
        )
    (folder / "contacts.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": features}))
