"""Draw a mission's waterfall with marks of what lies and what was called where."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from auv_mcm.contacts.contact_picture import encoded
from auv_mcm.errors import UsageError
from auv_mcm.shell.whole_files import write_file
from sim_replay.report.pictures import PictureCollector

_WIDTH: Final = 960  # pixels of the picture: 12 cm each for a swath of 120 m
_REACH_M: Final = 2.0  # m from the middle of a mark to its edge: objects of a mine's size stay free
_LEGEND_PX: Final = 30  # below the picture
_WHITE: Final = (255, 255, 255)
_OPTIONS: Final = {  # by format; speckle takes most of the bytes and loses nothing that can be seen
    ".jpg": [cv2.IMWRITE_JPEG_QUALITY, 55],
    ".webp": [cv2.IMWRITE_WEBP_QUALITY, 35],
    ".png": [],
}
_STYLES: Final = {  # blue, green, red
    "cone, called": ((80, 230, 60), False),
    "cone, reported but not called": ((0, 220, 255), False),
    "cone, not reported": ((255, 255, 255), False),
    "false alarm": ((60, 60, 255), True),
}


class Mark(NamedTuple):
    """Place a mark: metres from the mission's first grid row, metres to starboard, and one of the styles' names."""

    along_m: float
    across_m: float
    style: str


def save_waterfall(pictures: PictureCollector, marks: Sequence[Mark], path: Path) -> None:
    """Write the waterfall, later pings above, port to the left, with marks and a legend; the suffix is the format.

    Raises UsageError for another suffix than .jpg, .webp and .png or a file that cannot be written.
    """
    suffix = path.suffix.lower()
    if suffix not in _OPTIONS:
        raise UsageError(f"--picture {path}: '{path.suffix}' is not one of {', '.join(_OPTIONS)}. Choose one of them")
    try:
        write_file(path, encoded(waterfall(pictures, marks), suffix, _OPTIONS[suffix]))
    except OSError as error:
        raise UsageError(f"--picture {path} cannot be written: {error.strerror}") from error


def waterfall(pictures: PictureCollector, marks: Sequence[Mark]) -> NDArray[np.uint8]:
    """Draw the waterfall to one scale along and across, (rows, columns, 3) blue-green-red."""
    strips = pictures.strips()
    drawn = [_decoded(strip.jpeg) for strip in reversed(strips)]
    stop_m, half_m = strips[-1].stop_m, strips[0].half_width_m
    per_m = _WIDTH / (2.0 * half_m)
    height = round((stop_m - strips[0].start_m) * per_m)
    resized = cv2.resize(np.vstack(drawn), (_WIDTH, height), interpolation=cv2.INTER_AREA)
    canvas = np.asarray(resized, dtype=np.uint8)
    for mark in marks:
        middle = round((mark.across_m + half_m) * per_m), round((stop_m - mark.along_m) * per_m)
        _mark(canvas, middle, round(_REACH_M * per_m), mark.style)
    return np.asarray(np.vstack([canvas, _legend(marks)]), dtype=np.uint8)


def _decoded(jpeg: bytes) -> NDArray[np.uint8]:
    return np.asarray(cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR), dtype=np.uint8)


def _mark(canvas: NDArray[np.uint8], middle: tuple[int, int], reach: int, style: str) -> None:
    colour, square = _STYLES[style]
    for line, width in (((0, 0, 0), 4), (colour, 2)):
        if square:
            low, high = (tuple(part + sign * reach for part in middle) for sign in (-1, 1))
            cv2.rectangle(canvas, low, high, line, width, cv2.LINE_AA)
        else:
            cv2.circle(canvas, middle, reach, line, width, cv2.LINE_AA)


def _legend(marks: Sequence[Mark]) -> NDArray[np.uint8]:
    strip = np.zeros((_LEGEND_PX, _WIDTH, 3), dtype=np.uint8)
    for number, style in enumerate(_STYLES):
        left = number * _WIDTH // len(_STYLES)
        _mark(strip, (left + 14, _LEGEND_PX // 2), 8, style)
        words = f"{style}: {sum(mark.style == style for mark in marks)}"
        cv2.putText(strip, words, (left + 30, _LEGEND_PX - 10), cv2.FONT_HERSHEY_SIMPLEX, 0.42, _WHITE, 1, cv2.LINE_AA)
    return strip
