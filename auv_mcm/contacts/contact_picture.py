"""Draw normalised sonar intensity as a picture for people, and the picture that goes with each contact.

Display only: detection works on linear intensity. The mapping is fixed, -15..+12 dB about the local seabed mean, so
that equal echoes look equal in every picture. A display byte holds two bits of condition and six of level; one table of
256 colours draws it.
"""

from __future__ import annotations

from typing import Any, Final, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from auv_mcm.records import Detection
from auv_mcm.snippet import unpack_snippet

Bytes: TypeAlias = NDArray[np.uint8]

FLOOR_DB: Final = -15.0  # dB over the sea floor shown as black; display only
CEILING_DB: Final = 12.0  # dB over the sea floor shown as white; display only
LEVELS: Final = 63  # 1..63; 0: no echo
SOFT: Final = 1  # condition of a pixel of low resolution
TURNED: Final = 2  # condition of a pixel in a turn


def snippet_picture(view: Detection) -> Bytes:
    """Draw a detection's surroundings, (n, m, 3) blue-green-red, with square pixels.

    As seen from above with the vehicle moving up.

    Later pings are above; range grows to the right on starboard and to the left on port.
    """
    image = unpack_snippet(view.snippet)
    if image.size == 0:
        return np.full((8, 8, 3), COLOURS[0], dtype=np.uint8)
    levels = display_levels(image).astype(np.float32)
    missing = ~(image > 0.0)
    levels[missing] = 0.0
    image_m = image.shape[0] * view.row_spacing_m, image.shape[1] * view.column_spacing_m
    pixel_m = min(view.row_spacing_m, view.column_spacing_m)
    size = max(1, round(image_m[1] / pixel_m)), max(1, round(image_m[0] / pixel_m))
    smooth = np.clip(cv2.resize(levels, size, interpolation=cv2.INTER_CUBIC).round(), 1, LEVELS).astype(np.uint8)
    hole = cv2.resize(missing.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST).astype(np.bool_)
    drawn = coloured_levels(np.where(hole, np.uint8(0), smooth))
    return np.ascontiguousarray(drawn[::-1, ::-1] if view.side == "port" else drawn[::-1])


def in_picture(view: Detection, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Convert places (n, 2) (row, column) of a detection's snippet to its picture.

    Returns (n, 2) right, down as shares of width and height.

    Pixel (r, k) of the snippet covers [r, r + 1) x [k, k + 1).
    """
    along, across = (points / np.maximum(view.snippet.shape, 1)).T
    return np.column_stack([1.0 - across if view.side == "port" else across, 1.0 - along])


def snippet_png(view: Detection) -> bytes:
    """Encode the picture of `snippets/<id>.png`, at the resolution of the waterfall."""
    return encoded(snippet_picture(view), ".png", [cv2.IMWRITE_PNG_COMPRESSION, 3])


def display_levels(intensity: NDArray[Any]) -> Bytes:
    """Convert linear intensity in units of the seabed mean to levels 1..63.

    Not finite and not positive values become 1.
    """
    level_db = 10.0 * np.log10(np.fmax(intensity, np.float32(1e-6)))
    scaled = (level_db - FLOOR_DB) * ((LEVELS - 1) / (CEILING_DB - FLOOR_DB)) + 1.5
    return np.asarray(np.clip(scaled, 1.0, LEVELS), dtype=np.uint8)


def coloured_levels(levels: Bytes) -> Bytes:
    """Colour levels (n, m): (n, m, 3) blue, green, red. Six times as fast as indexing COLOURS."""
    return np.asarray(cv2.applyColorMap(levels, COLOURS[:, np.newaxis]), dtype=np.uint8)


def encoded(picture: NDArray[np.uint8], kind: str, options: list[int]) -> bytes:
    """Encode a blue-green-red picture as an image file of `kind` (".png", ".jpg")."""
    done, data = cv2.imencode(kind, picture, options)
    if not done:
        raise RuntimeError(f"OpenCV could not encode a {picture.shape} picture as {kind}")
    return bytes(data)


def _colour_table() -> Bytes:
    """Make the table of 256 colours, blue-green-red.

    Copper for plain echoes, dimmed where resolution is low, violet in turns, blue-grey without echo.
    """
    stops = np.array([[10, 7, 6], [66, 32, 17], [150, 82, 33], [222, 152, 70], [255, 240, 208]], dtype=np.float64)
    where = np.linspace(0.0, 1.0, len(stops))
    copper = np.column_stack(
        [np.interp(np.linspace(0.0, 1.0, LEVELS), where, stops[:, channel]) for channel in range(3)]
    )
    empty, violet = np.array([30, 39, 50]), np.array([98, 70, 168])
    table = np.empty((4, 64, 3))
    table[:, 0] = empty
    table[TURNED:, 0] = 0.6 * empty + 0.4 * violet
    table[0, 1:] = copper
    table[SOFT, 1:] = 0.5 * copper + 0.5 * empty
    table[TURNED:, 1:] = 0.55 * copper + 0.45 * violet
    return np.ascontiguousarray(table.reshape(256, 3)[:, ::-1].round().astype(np.uint8))


COLOURS: Final = _colour_table()
