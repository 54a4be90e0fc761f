"""Draw contact sheets of outlines and calls in real pictures; small overlays, never the recordings themselves."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from auv_mcm.shell.whole_files import write_file
from sim_replay.studies.real_calls import CALLED, Called, is_call
from sim_replay.studies.real_outlines import JudgedOutline
from sim_replay.studies.real_pictures import Mask

Canvas = NDArray[np.uint8]

# Blue, green, red.
_GREEN, _ORANGE, _CYAN, _RED, _WHITE = (80, 230, 60), (0, 150, 255), (255, 220, 0), (60, 60, 255), (255, 255, 255)
_CROP_PX: Final = 110
_ZOOM: Final = 2
_COLUMNS: Final = 5
_CUT_SHOWN: Final = 5
_SHARE: Final = 0.5  # of a snippet's size
_SNIPPET_COLUMNS: Final = 5
_STRIP_PX: Final = 18  # for the words below
_SHIFT: Final = 4  # binary digits below a pixel that lines are drawn to
_QUALITY: Final = 62


def write_sheets(folder: Path, judged: Sequence[JudgedOutline], called: Sequence[Called]) -> tuple[Path, Path]:
    """Write real-outlines.jpg and real-calls.jpg into the folder."""
    paths = folder / "real-outlines.jpg", folder / "real-calls.jpg"
    for path, sheet in zip(paths, (outlines_sheet(judged), calls_sheet(called)), strict=True):
        write_file(path, cv2.imencode(".jpg", sheet, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].tobytes())
    return paths


def outlines_sheet(judged: Sequence[JudgedOutline]) -> Canvas:
    """All whole objects from the best outline to the worst by the snake's overlap, then some cut off by the tile's
    edge, evenly spread from best to worst: mask green, highlight labels orange, contour blue.
    """
    ordered = sorted(judged, key=lambda j: -j.given.iou.best_start)
    whole, cut = ([j for j in ordered if j.picture.cut == is_cut] for is_cut in (False, True))
    spread = np.linspace(0, len(cut) - 1, min(_CUT_SHOWN, len(cut))).astype(int).tolist()
    return _grid([_outlined(one) for one in (*whole, *(cut[k] for k in spread))], _COLUMNS)


def calls_sheet(called: Sequence[Called]) -> Canvas:
    """Draw snippets with calls of the detector alone (thin) and after confirmation (thick), by threshold."""
    return _grid([_called(one) for one in called], _SNIPPET_COLUMNS)


def _outlined(one: JudgedOutline) -> Canvas:
    mask, placed = one.picture.mask, one.given.placed
    assert mask is not None
    rows, columns = np.nonzero(mask)
    corner = [
        min(max(int(places.mean()) - _CROP_PX // 2, 0), size - _CROP_PX)
        for places, size in zip((rows, columns), mask.shape, strict=True)
    ]
    part = tuple(slice(first, first + _CROP_PX) for first in corner)
    canvas = _enlarged(one.picture.amplitude[part], _ZOOM)
    whole = np.zeros(mask.shape, dtype=np.bool_)
    top, near = placed.corner[0], placed.corner[1] - one.geometry.n_columns_before
    n_rows, n_columns = one.given.labels.shape
    cut = max(-near, 0)
    whole[top : top + n_rows, near + cut : near + n_columns] = one.given.labels[:, cut:]
    for outlined, colour in ((whole[part], _ORANGE), (mask[part], _GREEN)):
        cv2.polylines(canvas, _borders(outlined), True, colour, 1)
    if len(one.given.contour):
        nodes = (one.given.contour + np.subtract((top, near), corner)) * _ZOOM
        cv2.polylines(canvas, [_fixed(nodes)], True, _CYAN, 1, cv2.LINE_AA, _SHIFT)
    iou = one.given.iou
    words = f"labels {iou.own_labels:.2f}  snake {iou.best_start:.2f}  {one.contrast_db:.0f} dB" + (
        "  cut" if one.picture.cut else ""
    )
    return _captioned(canvas, words)


def _called(one: Called) -> Canvas:
    canvas = _enlarged(one.picture.amplitude, _SHARE)
    offset = one.geometry.n_columns_before
    low, high = min(CALLED), max(CALLED)

    def mark(row: float, column: float, radius: int, colour: tuple[int, int, int], width: int) -> None:
        centre = round(_SHARE * (column - offset)), round(_SHARE * row)
        cv2.circle(canvas, centre, radius, (0, 0, 0), width + 2, cv2.LINE_AA)
        cv2.circle(canvas, centre, radius, colour, width, cv2.LINE_AA)

    for detection in one.detections:
        if detection.p_mine >= low:
            mark(detection.row, detection.column, 9, _RED if detection.p_mine >= high else _WHITE, 1)
    for detection in one.looked_at:
        if is_call(detection, low):
            mark(detection.row, detection.column, 14, _RED if is_call(detection, high) else _ORANGE, 3)
    words = (
        f"alone {one.n_detector(high)} ({one.n_detector(low)})  looked at {one.n_confirmed(high)} "
        f"({one.n_confirmed(low)})"
    )
    return _captioned(canvas, f"{one.picture.name.removesuffix('_orig')}: {words}")


def _enlarged(amplitude: NDArray[np.float64], zoom: float) -> Canvas:
    how = cv2.INTER_AREA if zoom < 1.0 else cv2.INTER_NEAREST
    gray = np.clip(amplitude * (110.0 / max(float(np.median(amplitude)), 1.0)), 0.0, 255.0).astype(np.uint8)
    return np.asarray(
        cv2.cvtColor(cv2.resize(gray, None, fx=zoom, fy=zoom, interpolation=how), cv2.COLOR_GRAY2BGR), dtype=np.uint8
    )


def _borders(mask: Mask) -> list[NDArray[np.int32]]:
    large = cv2.resize(mask.astype(np.uint8), None, fx=_ZOOM, fy=_ZOOM, interpolation=cv2.INTER_NEAREST)
    return [
        np.asarray(border, dtype=np.int32)
        for border in cv2.findContours(large, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
    ]


def _fixed(nodes: NDArray[np.float64]) -> NDArray[np.int32]:
    """Convert nodes (row, column) to points (n, 1, 2) across and down as OpenCV draws them."""
    return np.rint((nodes[:, None, ::-1] - 0.5) * (1 << _SHIFT)).astype(np.int32)


def _captioned(canvas: Canvas, words: str) -> Canvas:
    strip = np.zeros((_STRIP_PX, canvas.shape[1], 3), dtype=np.uint8)
    cv2.putText(strip, words, (3, _STRIP_PX - 6), cv2.FONT_HERSHEY_SIMPLEX, 0.36, _WHITE, 1, cv2.LINE_AA)
    return np.vstack((canvas, strip))


def _grid(parts: Sequence[Canvas], n_columns: int) -> Canvas:
    framed = [cv2.copyMakeBorder(part, 0, 4, 0, 4, cv2.BORDER_CONSTANT, value=_WHITE) for part in parts]
    blank = np.full_like(framed[0], 255)
    framed += [blank] * (-len(framed) % n_columns)
    return np.vstack([np.hstack(framed[k : k + n_columns]) for k in range(0, len(framed), n_columns)])
