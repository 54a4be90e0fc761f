"""Film the page of `auv-mcm view` while contacts are judged by keys, for the first page of the documentation."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Final

import msgspec
from PIL import Image  # extra dev

from auv_mcm.errors import UsageError
from auv_mcm.settings.config import Config
from sim_replay.benches.browser import BrowserPage, mission_page
from sim_replay.replay import replay
from sim_replay.simulate import simulate
from sim_replay.simulator.scene_file import read_scene
from sim_replay.verdicts import VERDICTS_FILE
from sim_replay.view.mission_files import read_summary
from sim_replay.view.show import open_shown

_SCENE: Final = "demo"
_N_JUDGED: Final = 6  # contacts, the likeliest mines first: a quarter of a minute
_SIZE: Final = (960, 600)  # pixels, of a window of 1440 x 900: text stays readable in a README
_LOOK_MS, _JUDGE_MS, _FIRST_MS = 1100, 700, 1800  # how long a frame stands; chosen
_QUALITY: Final = 40  # of WebP; speckle takes most of the bytes
_MAX_BYTES: Final = 1_500_000  # a README that loads at once on a slow line


async def film_view(folder: Path, path: Path) -> int:
    """Simulate and replay the scene `demo` into a folder, judge its likeliest contacts, and write animated WebP.

    Returns the number of frames. Raises UsageError where the file would be larger than a README bears.
    """
    log, results = folder / _SCENE / "mission.xtf", folder / f"{_SCENE}-results"
    if not log.exists():
        simulate(read_scene(_SCENE), log.parent)
    if read_summary(results) is None:
        replay([log], results, msgspec.structs.replace(Config(), mission=_SCENE))
    (results / VERDICTS_FILE).unlink(missing_ok=True)
    mission = open_shown(results, [], None, "kim")
    mission.feed.join()
    frames: list[tuple[Image.Image, int]] = []
    async with mission_page(mission) as page:
        await page.wait_for("bench.tiles.size > 4 && !bench.busy")
        frames.append((await _frame(page), _FIRST_MS))
        for _ in range(_N_JUDGED):
            await page.press("j")
            await page.wait_for("!bench.busy && document.querySelector('#card img') !== null")
            frames.append((await _frame(page), _LOOK_MS))
            name = await page.evaluate("bench.selected")
            likely = await page.evaluate(f"bench.contacts.find((one) => one.id === '{name}').likely")
            await page.press("m" if likely else "n")
            await page.wait_for(f"bench.contacts.find((one) => one.id === '{name}').call")
            frames.append((await _frame(page), _JUDGE_MS))
        if page.complaints:
            raise RuntimeError(f"the page complains: {page.complaints[:3]}")
    mission.feed.close()
    first, *others = (picture for picture, _ in frames)
    made = io.BytesIO()
    durations_ms = [shown_ms for _, shown_ms in frames]
    options = {"save_all": True, "append_images": others, "duration": durations_ms, "loop": 0}
    first.save(made, "WEBP", quality=_QUALITY, method=6, **options)
    data = made.getvalue()
    if len(data) > _MAX_BYTES:
        raise UsageError(f"{path} would have {len(data)} bytes, more than {_MAX_BYTES}: film fewer contacts")
    path.write_bytes(data)
    return len(frames)


async def _frame(page: BrowserPage) -> Image.Image:
    """Take a picture of the window, once what was asked for is drawn."""
    await page.evaluate("new Promise((done) => setTimeout(() => requestAnimationFrame(done), 200))")
    picture = Image.open(io.BytesIO(await page.captured("png"))).convert("RGB")
    return picture.resize(_SIZE, Image.Resampling.LANCZOS)
