"""Draw the scenes that rates are taken on in one picture: port and starboard waterfall of a stretch of each.

python -m sim_replay.studies.contact_sheet --out FILE
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from auv_mcm.commands import Parser
from auv_mcm.errors import UsageError
from auv_mcm.records import Ping
from auv_mcm.shell.whole_files import write_file
from sim_replay.missions import SCENES
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.scene import Scene
from sim_replay.simulator.scene_file import read_scene

_COLUMNS: Final = 5
_WIDTH: Final = 480
_HEIGHT: Final = 560
_TITLE: Final = 26
_GAP: Final = 6
_GREY: Final = 110  # between pictures, where black would pass for water
_QUALITY: Final = 58
_GAMMA: Final = 0.6
_WHITE_SHARE: Final = 0.995  # of samples are darker than white
_BLACK_SHARE: Final = 0.02  # of logarithms are darker than black

Picture = NDArray[np.uint8]


def waterfall(scene: Scene, width: int, height: int) -> Picture:
    """Draw the scene's first pings, newest on top, port to the left, both axes to one scale: (height, width) uint8.

    Brightness is what was recorded, amplitudes raised to 0.6; nothing is levelled but by the recorder's own gain.
    """
    stretch_m = 2.0 * scene.sonar.range_m * height / width
    stop_s = scene.track.start_time_s + stretch_m / scene.track.speed_mps
    rows = []
    for event in Mission(scene).events():
        if event.time_s > stop_s:
            break
        if isinstance(event, Ping) and event.port is not None and event.starboard is not None:
            rows.append(np.concatenate([event.port.samples[::-1], event.starboard.samples]).astype(np.float32))
    picture = cv2.resize(np.stack(rows[::-1]), (width, height), interpolation=cv2.INTER_AREA)
    is_log = scene.sonar.recorder.samples.startswith("log")
    black, white = (
        float(np.quantile(picture, _BLACK_SHARE)) if is_log else 0.0,
        float(np.quantile(picture, _WHITE_SHARE)),
    )
    level = np.clip((picture - black) / max(white - black, 1e-6), 0.0, 1.0)
    shown: Picture = np.rint(255.0 * level ** (1.0 if is_log else _GAMMA)).astype(np.uint8)
    return shown


def contact_sheet(names: Sequence[str]) -> Picture:
    """Draw waterfalls of named scenes under their names, five in a row; (rows, columns) uint8."""
    panels = []
    for name in names:
        title = np.zeros((_TITLE, _WIDTH), dtype=np.uint8)
        cv2.putText(title, name, (4, _TITLE - 8), cv2.FONT_HERSHEY_SIMPLEX, 0.6, 255, 1, cv2.LINE_AA)
        panel = np.concatenate([title, waterfall(read_scene(name), _WIDTH, _HEIGHT)])
        panels.append(np.pad(panel, ((0, _GAP), (0, _GAP)), constant_values=_GREY))
    empty = np.zeros_like(panels[0])
    remaining, rows = iter(panels), []
    while row := list(islice(remaining, _COLUMNS)):
        rows.append(np.concatenate([*row, *[empty] * (_COLUMNS - len(row))], axis=1))
    return np.concatenate(rows)


def main(arguments: Sequence[str]) -> int:
    """Draw the sheet; returns the exit code."""
    parser = Parser(
        prog="python -m sim_replay.studies.contact_sheet",
        description="Draw waterfalls of the scenes that rates are taken on.",
    )
    parser.add_argument("--out", type=Path, required=True, help="where the JPEG goes")
    chosen = parser.parse_args(arguments)
    _, coded = cv2.imencode(".jpg", contact_sheet(SCENES), [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    try:
        write_file(chosen.out, coded.tobytes())
    except OSError as error:
        print(f"contact_sheet: --out {chosen.out} cannot be written: {error.strerror}", file=sys.stderr)
        return UsageError.exit_code
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
