"""Draw clearance and kinds of sea floor as one picture, north up."""

from __future__ import annotations

from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from auv_mcm.clearance.clearance_export import BANDS, band_of
from auv_mcm.clearance.clearance_map import Clearance
from auv_mcm.records import SEABED_TYPES, SeabedType

Bytes = NDArray[np.uint8]
Key = list[tuple[str, tuple[int, int, int]]]

# Blue, green, red. Probabilities: a ramp from red over yellow to green that also rises in lightness.
_BANDS: Final = ((52, 36, 150), (60, 90, 215), (80, 160, 245), (120, 215, 245), (110, 200, 150), (80, 150, 40))
KIND_COLOURS: Final[dict[SeabedType, tuple[int, int, int]]] = {
    "flat": (175, 205, 225),
    "ripple": (70, 150, 220),
    "rough": (110, 110, 120),
    "vegetation": (80, 150, 70),
    "unknown": (210, 160, 200),
}
_PAPER: Final = (255, 255, 255)
_UNSEEN: Final = (238, 238, 238)
_INK: Final = (60, 50, 40)
_LONGEST: Final = 640  # pixels of a map's longer side
_GAP: Final = 24
_KEY_HEIGHT: Final = 44
_MAX_PER_CELL: Final = 24


def clearance_picture(clearance: Clearance) -> Bytes:
    """Draw the (n, m, 3) blue-green-red picture: `p_detected` left, kinds of sea floor right, each above its key."""
    rows, columns = clearance.exponent.shape
    per_cell = max(1, min(_MAX_PER_CELL, _LONGEST // max(rows, columns)))
    step = max(1, -(-max(rows, columns) // _LONGEST))  # of cells, where there are more than pixels
    seen = clearance.seen[::step, ::step]
    maps = []
    for colours, chosen in (
        (np.array(_BANDS, dtype=np.uint8), band_of(clearance.p_detected)),
        (np.array([KIND_COLOURS[kind] for kind in SEABED_TYPES], dtype=np.uint8), clearance.seabed),
    ):
        drawn = np.where(seen[..., np.newaxis], colours[chosen[::step, ::step]], np.array(_UNSEEN, dtype=np.uint8))
        maps.append(np.repeat(np.repeat(drawn[::-1], per_cell, axis=0), per_cell, axis=1))
    keys: tuple[Key, Key] = (
        [(f"{low:g}-{high:g}", colour) for low, high, colour in zip(BANDS[:-1], BANDS[1:], _BANDS, strict=True)],
        [(kind, KIND_COLOURS[kind]) for kind in SEABED_TYPES],
    )
    width = max(maps[0].shape[1], max(_key_width(key) for key in keys))
    return np.hstack([_panel(drawn, key, width) for drawn, key in zip(maps, keys, strict=True)])


def clearance_png(clearance: Clearance) -> bytes:
    """Encode the picture of `clearance.png`."""
    encoded: NDArray[Any] = cv2.imencode(".png", clearance_picture(clearance), [cv2.IMWRITE_PNG_COMPRESSION, 9])[1]
    return encoded.tobytes()


def _panel(drawn: Bytes, key: Key, width: int) -> Bytes:
    panel = np.full((drawn.shape[0] + _KEY_HEIGHT + _GAP, width + _GAP, 3), _PAPER, dtype=np.uint8)
    panel[_GAP // 2 : _GAP // 2 + drawn.shape[0], _GAP // 2 : _GAP // 2 + drawn.shape[1]] = drawn
    right, down = _GAP // 2, drawn.shape[0] + _GAP
    for label, colour in key:
        cv2.rectangle(panel, (right, down), (right + 14, down + 14), colour, cv2.FILLED)
        cv2.putText(panel, label, (right + 20, down + 12), cv2.FONT_HERSHEY_SIMPLEX, 0.42, _INK, 1, cv2.LINE_AA)
        right += 20 + _text_width(label) + 14
    return panel


def _key_width(key: Key) -> int:
    return sum(34 + _text_width(label) for label, _ in key)


def _text_width(label: str) -> int:
    return int(cv2.getTextSize(label, cv2.FONT_HERSHEY_SIMPLEX, 0.42, 1)[0][0])
