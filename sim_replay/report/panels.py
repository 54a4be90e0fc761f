"""Draw pictures of one view for the page.

Plain, with every pixel classified, and with contours and the outlines of the best model.

What is drawn over the sonar picture are shapes, sharp at any size and on paper; the picture itself is in the page once.
"""

from __future__ import annotations

import base64
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.confirm.region import HIGHLIGHT, SHADOW
from auv_mcm.contacts.contact_picture import in_picture
from auv_mcm.contacts.contact_words import plain_kind
from auv_mcm.records import Confirmation, Detection
from sim_replay.report.chart import svg_path
from sim_replay.report.pictures import snippet_jpeg

_UNITS_PER_M: Final = 100.0  # of the drawing
_BARS_M: Final = (10.0, 5.0, 2.0, 1.0, 0.5, 0.2)  # m: lengths of the scale bar


class Stroke(NamedTuple):
    """Hold a line of a picture. style: class of the page's style. path: SVG path data. text: what it is."""

    style: str
    path: str
    text: str


class Panel(NamedTuple):
    """Hold the sonar picture with strokes over it."""

    title: str
    strokes: tuple[Stroke, ...]


class ViewPicture(NamedTuple):
    """Hold one view, oriented as in the strips. width, height: drawing units, a hundred per metre.

    left, top: of the centroid, per cent. bar: length of the scale bar, per cent of the width.
    """

    uri: str
    width: float
    height: float
    panels: tuple[Panel, ...]
    left: float
    top: float
    bar_m: str
    bar: float
    port: bool

    @property
    def n_bytes(self) -> int:
        """Count the bytes of text; contours are drawn twice, the first time as the dark line under them."""
        strokes = [stroke for panel in self.panels for stroke in panel.strokes]
        return len(self.uri) + sum(len(stroke.path) * (2 if stroke.style.startswith("o-") else 1) for stroke in strokes)


def view_picture(view: Detection, *, panels: bool, kind: str = "") -> ViewPicture:
    """Draw one view as it was seen; beside it contours and model if there are any.

    Parameters
    ----------
    view
        The view.
    panels
        Draw a panel of the classified pixels as well.
    kind
        The kind of mine that is named, "" for none: a model of another kind is drawn without a name.
    """
    height_m, width_m = view.snippet.shape[0] * view.row_spacing_m, view.snippet.shape[1] * view.column_spacing_m
    centroid = in_picture(view, np.array([[view.snippet_row, view.snippet_column]]))[0]
    bar_m = next((step for step in _BARS_M if step <= 0.4 * width_m), 0.1)
    found = outlines(view, view.confirmation, kind) if view.confirmation else ()
    labels = labelled_panel(view, view.confirmation.labels) if view.confirmation else ()
    plain, classified, contoured = (
        Panel("As seen", ()),
        Panel("Pixels classified", labels),
        Panel(_contour_title(found), found),
    )
    drawn = (plain, classified, contoured) if panels else (plain, contoured)
    return ViewPicture(
        uri=f"data:image/jpeg;base64,{base64.b64encode(snippet_jpeg(view)).decode('ascii')}",
        width=max(width_m * _UNITS_PER_M, 1.0),
        height=max(height_m * _UNITS_PER_M, 1.0),
        panels=(plain, *(panel for panel in drawn[1:] if panel.strokes)),
        left=100.0 * float(centroid[0]),
        top=100.0 * float(centroid[1]),
        bar_m=f"{bar_m:g} m",
        bar=100.0 * bar_m / width_m if width_m > 0.0 else 0.0,
        port=view.side == "port",
    )


def outlines(view: Detection, found: Confirmation, kind: str = "") -> tuple[Stroke, ...]:
    """Draw the contours of echo and shadow, and the outlines of the best model, named if it is of `kind`."""
    strokes = [
        Stroke("o-echo", _closed(view, found.highlight), "echo"),
        Stroke("o-shadow", _closed(view, found.shadow), "shadow"),
    ]
    if found.model is not None:
        path = _closed(view, found.model.highlight) + _closed(view, found.model.shadow)
        is_named = found.model.classification == kind
        strokes.append(Stroke("o-model", path, f"best {plain_kind(kind)}" if is_named else "closest model"))
    return tuple(stroke for stroke in strokes if stroke.path)


def labelled_panel(view: Detection, labels: NDArray[np.uint8]) -> tuple[Stroke, ...]:
    """Draw the pixels of echo and of shadow as areas."""
    strokes = (
        Stroke("l-echo", _runs(view, labels == HIGHLIGHT), "echo"),
        Stroke("l-shadow", _runs(view, labels == SHADOW), "shadow"),
    )
    return tuple(stroke for stroke in strokes if stroke.path)


def _contour_title(strokes: tuple[Stroke, ...]) -> str:
    return "Contours and closest model" if any(stroke.style == "o-model" for stroke in strokes) else "Contours"


def _drawn(view: Detection, points: NDArray[np.float64]) -> NDArray[np.float64]:
    size_m = np.array([view.snippet.shape[1] * view.column_spacing_m, view.snippet.shape[0] * view.row_spacing_m])
    return np.asarray(in_picture(view, points) * size_m * _UNITS_PER_M)


def _closed(view: Detection, contour: NDArray[np.float64]) -> str:
    return svg_path(_drawn(view, contour)) + "Z" if len(contour) else ""


def _runs(view: Detection, chosen: NDArray[np.bool_]) -> str:
    """Draw a rectangle per run of chosen pixels in a row; equal runs of adjacent rows are one."""
    edges = np.diff(np.pad(chosen.astype(np.int8), ((0, 1), (1, 1))), axis=1)
    begun: dict[tuple[int, int], int] = {}
    corners: list[tuple[int, int]] = []
    for row, edge in enumerate(edges):
        runs = list(zip(np.flatnonzero(edge == 1).tolist(), np.flatnonzero(edge == -1).tolist(), strict=True))
        for near, far in begun.keys() - runs:
            corners += [(begun[near, far], near), (row, far)]
        begun = {run: begun.get(run, row) for run in runs}
    places = _drawn(
        view, np.array(sorted(zip(corners[::2], corners[1::2], strict=True)), dtype=np.float64).reshape(-1, 2)
    )
    rectangles = places.reshape(-1, 4).tolist()
    return "".join(
        f"M{left:.5g} {top:.5g}H{right:.5g}V{bottom:.5g}H{left:.5g}Z" for left, top, right, bottom in rectangles
    )
