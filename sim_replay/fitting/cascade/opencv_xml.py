"""Write a cascade of one shadow band as OpenCV's own cascade file: independent code runs the same stumps, as a check on
ours.

OpenCV's Haar features are weighted sums over two or three rectangles, divided by the standard deviation of the window
and compared with a threshold. Both kinds of stumps can be written as a sum compared with 0, whatever it is divided by:

- ratio: sum(a) / A_a - t sum(b) / A_b < 0;
- contrast: sum(a) / A_a - sum(b) / A_b - t sum(w) / A_w < 0.

In float32 and in this order both sides round alike, so that decisions are the same bit for bit. What OpenCV cannot do:
bands (one file is one band), 16-bit images (ratios do not ask for the scale: give it codes cut down to 8 bits), scores
carried from stage to stage (a soft cascade repeats the stumps of the groups before in each stage), and windows with a
standard deviation below 10 of 255, which it passes over.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from auv_mcm.detect.cascade.bands import FeatureBox, areas, pixel_boxes
from auv_mcm.detect.cascade.model import CascadeModel, Stump


class OpenCvCascade(NamedTuple):
    """Hold xml for cv2.CascadeClassifier.

    A window has n_rows times n_columns pixels and is centred on (centre_row, centre_column) in it.
    """

    xml: str
    n_rows: int
    n_columns: int
    centre_row: int
    centre_column: int


def opencv_cascade(model: CascadeModel, band: int, row_spacing_m: float, column_spacing_m: float) -> OpenCvCascade:
    """Convert the model's decision about windows of one band, 0 to N_BANDS - 1, on pixels of the given size."""
    boxes = list(dict.fromkeys(box for group in model.groups for stump in group for box in _boxes(stump)))
    pixels = pixel_boxes(boxes, row_spacing_m, column_spacing_m)[band]
    top, left = (int(pixels[:, edge].min(initial=0)) for edge in (0, 2))
    bottom, right = (int(pixels[:, edge].max(initial=1)) for edge in (1, 3))
    rectangles = dict(zip(boxes, pixels - np.array([top, top, left, left], dtype=np.int32), strict=True))
    stumps = [stump for group in model.groups for stump in group]
    last = np.cumsum([len(group) for group in model.groups])
    first = np.zeros_like(last) if model.kind == "soft" else np.concatenate(([0], last[:-1]))
    stages = "".join(
        f"<_><maxWeakCount>{stop - start}</maxWeakCount><stageThreshold>{reject}.</stageThreshold><weakClassifiers>"
        + "".join(_weak(index, stumps[index]) for index in range(start, stop))
        + "</weakClassifiers></_>\n"
        for start, stop, reject in zip(first.tolist(), last.tolist(), model.reject, strict=True)
    )
    features = "".join(_feature(stump, rectangles) for stump in stumps)
    xml = (
        '<?xml version="1.0"?>\n<opencv_storage>\n<cascade '
        'type_id="opencv-cascade-classifier"><stageType>BOOST</stageType>'
        f"<featureType>HAAR</featureType><height>{bottom - top}</height><width>{right - left}</width>\n"
        f"<stageParams><boostType>GAB</boostType><maxDepth>1</maxDepth><maxWeakCount>{len(stumps)}</maxWeakCount></stageParams>\n"
        "<featureParams><maxCatCount>0</maxCatCount><featSize>1</featSize><mode>BASIC</mode></featureParams>\n"
        f"<stageNum>{len(model.groups)}</stageNum>\n<stages>\n{stages}</stages>\n<features>\n{features}</features>\n"
        "</cascade>\n</opencv_storage>\n"
    )
    return OpenCvCascade(xml, bottom - top, right - left, -top, -left)


def _boxes(stump: Stump) -> tuple[FeatureBox, ...]:
    return (stump.a, stump.b) if stump.w is None else (stump.a, stump.b, stump.w)


def _weak(index: int, stump: Stump) -> str:
    return (
        f"<_><internalNodes>0 -1 {index} 0.</internalNodes><leafValues>{stump.below}. {stump.above}.</leafValues></_>"
    )


def _feature(stump: Stump, rectangles: dict[FeatureBox, np.ndarray]) -> str:
    factors = (1.0, -stump.threshold) if stump.w is None else (1.0, -1.0, -stump.threshold)
    rects = []
    for box, factor in zip(_boxes(stump), factors, strict=True):
        top, bottom, left, right = rectangles[box].tolist()
        weight = np.float32(1.0 / areas(rectangles[box]) * factor)
        rects.append(f"<_>{left} {top} {right - left} {bottom - top} {weight:.9g}</_>")
    return f"<_><rects>{''.join(rects)}</rects><tilted>0</tilted></_>\n"
