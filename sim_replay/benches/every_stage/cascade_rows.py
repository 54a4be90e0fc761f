"""Run one cascade of stages here and in OpenCV, over the same windows of drawn tiles.

Tiles of 1024 by 1024 pixels of 0.12 by 0.05 m are seen from 6 m. OpenCV runs the same stumps on the same pixels, for
the one band of shadow lengths that a file of its own can hold. It visits every other row, every other column, and every
fourth where its first stage rejects: windows per second are those it really visits.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.detect.cascade.bands import N_BANDS, WINDOW, FeatureBox
from auv_mcm.detect.cascade.codes import CodePlane, codes_of, make_plane
from auv_mcm.detect.cascade.model import MAX_LEAF, MAX_STUMPS, Calibration, CascadeModel, Stump, check_model
from auv_mcm.detect.cascade.run import run_plane, tables_of
from auv_mcm.kernels.cascade import CODE_OF_MEAN, Opened, WindowField, open_windows
from sim_replay.benches.every_stage.rows import Other, Row
from sim_replay.fitting.cascade.opencv_xml import opencv_cascade

ROW_M: Final = 0.12  # m along the track, of the tiles that are timed
COLUMN_M: Final = 0.05  # m across
SHAPE: Final = (1024, 1024)  # rows and columns

_FIRST_RETURN_M: Final = 6.0  # m
_BAND: Final = 12  # of the model that OpenCV runs, one in the middle
_SIZES: Final = (3, 4, 6, 10, 15, 20, 30, 40, 50)  # stumps per group of the drawn model
_SHARE: Final = 0.4  # of windows that each group of the drawn model lets pass, maximum
_ANY_SCORE: Final = -MAX_STUMPS * MAX_LEAF
_CODES_PER_GREY: Final = 64  # codes per level of OpenCV's 8 bits

Image = NDArray[np.float32]


class BesideOpenCv(NamedTuple):
    """Hold what runs a cascade here and in OpenCV.

    n_windows, n_visited: that each decides on. n_different: windows that one passes and the other does not, of those
    that both visit.
    """

    ours: Callable[[], object]
    theirs: Callable[[], object]
    n_windows: int
    n_visited: int
    n_different: int


def cascade_rows(n: int) -> list[Row]:
    """Run one cascade here and in OpenCV, over the same windows; times are per million windows visited."""
    cv2.setNumThreads(1)
    model, rows = drawn_model(), []
    for name, image in drawn_tiles((192, SHAPE[1]) if n < 4 else SHAPE).items():
        found = beside_opencv(model, image)
        words = f"cv2.CascadeClassifier, of {found.n_visited} windows it visits"
        rows.append(
            Row(
                "cascade",
                f"{name} tile, a million windows",
                found.ours,
                partial(_given, float(found.n_different)),
                "windows decided otherwise",
                0.0,
                Other(words, found.theirs, partial(_given, 0.0), found.n_visited * 1e-6),
                found.n_windows * 1e-6,
            )
        )
    return rows


def _given(error: float, _: object) -> float:
    return error


def drawn_tiles(shape: tuple[int, int]) -> dict[str, Image]:
    """Draw single-look speckle on plain sea floor, on ripples of 1.2 m, and on a field of boulders.

    One boulder on every 2.5 square metres.
    """
    random = np.random.Generator(np.random.PCG64(21))
    speckle = random.exponential(size=shape)
    across_m, along_m = np.arange(shape[1]) * COLUMN_M, np.arange(shape[0])[:, np.newaxis] * ROW_M
    ripples = 1.0 + 0.8 * np.sin(2.0 * np.pi * (across_m + 0.3 * along_m) / 1.2)
    busy = np.ones(shape)
    for _ in range(round(shape[0] * shape[1] * ROW_M * COLUMN_M / 2.5)):
        row, column = int(random.integers(shape[0])), int(random.integers(shape[1]))
        shadow = round(max(0.4, 0.35 * column * COLUMN_M / (_FIRST_RETURN_M - 0.35)) / COLUMN_M)
        rows = slice(max(row - 3, 0), row + 4)
        busy[rows, column + 4 : column + 4 + shadow] = 0.15
        busy[rows, max(column - 4, 0) : column + 4] = 5.0
    return {
        "quiet": speckle.astype(np.float32),
        "rippled": (speckle * ripples).astype(np.float32),
        "busy": (speckle * busy).astype(np.float32),
    }


def code_plane_of(image: Image) -> CodePlane:
    """Make the code plane of a drawn tile, all of it valid."""
    everywhere = np.ones(image.shape, dtype=np.bool_)
    first_return_m = np.full(image.shape[0], _FIRST_RETURN_M)
    return make_plane(codes_of(image, everywhere), everywhere, everywhere, first_return_m, ROW_M, COLUMN_M)


def drawn_model() -> CascadeModel:
    """Draw comparisons of highlight, shadow and surroundings at random, in stages for the drawn tiles."""
    random = np.random.Generator(np.random.PCG64(22))
    groups = tuple(tuple(_drawn_stump(random) for _ in range(size)) for size in _SIZES)
    model = CascadeModel(
        kind="stages",
        trained_on="nothing: drawn at random",
        training_sha256="",
        row_spacing_m=(ROW_M, ROW_M),
        column_spacing_m=(COLUMN_M, COLUMN_M),
        calibration=Calibration(score=(-1, 1), log_odds=(-1.0, 1.0)),
        reject=(_ANY_SCORE,) * len(groups),
        groups=groups,
    )
    plane = code_plane_of(drawn_tiles((192, SHAPE[1]))["quiet"])
    reject: list[int] = []
    for group in range(len(groups)):
        part = msgspec.structs.replace(model, groups=groups[: group + 1], reject=(*reject, _ANY_SCORE))
        # Few stumps make few different scores: the lowest threshold above which no more than the share lies.
        values, times = np.unique(run_plane(plane, part, None).scores, return_counts=True)
        rejected = np.cumsum(times) >= (1.0 - _SHARE) * times.sum()
        reject.append(int(values[rejected][0]) + 1 if values.size else 0)
    model = msgspec.structs.replace(model, reject=tuple(reject))
    check_model(model, "drawn model")
    return model


def beside_opencv(model: CascadeModel, image: Image) -> BesideOpenCv:
    """Run a model of stages and OpenCV on an image in whole greys, all of it in one band."""
    greys = np.minimum(np.rint(image * (CODE_OF_MEAN / _CODES_PER_GREY)), 255.0).astype(np.uint8)
    exported = opencv_cascade(model, _BAND, ROW_M, COLUMN_M)
    size = (exported.n_columns, exported.n_rows)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "cascade.xml"
        path.write_text(exported.xml, encoding="ascii")
        classifier = cv2.CascadeClassifier(str(path))
    n_rows, n_columns = greys.shape[0] - exported.n_rows, greys.shape[1] - exported.n_columns
    inside = (
        slice(exported.centre_row, exported.centre_row + n_rows),
        slice(exported.centre_column, exported.centre_column + n_columns),
    )

    codes = greys.astype(np.uint16) * np.uint16(_CODES_PER_GREY)

    def ours(n_groups: int = len(model.groups)) -> tuple[CodePlane, Opened]:
        return _in_one_band(codes, inside, model, n_groups)

    def theirs() -> Sequence[Sequence[int]]:
        return classifier.detectMultiScale(greys, scaleFactor=2.0, minNeighbors=0, minSize=size, maxSize=size)

    found, begun = (_map_of(*ours(n_groups))[inside] for n_groups in (len(model.groups), 1))
    visited = visited_by_opencv(begun)
    found_by_opencv = np.zeros_like(found)
    for column, row, _, _ in theirs():
        found_by_opencv[row, column] = True
    return BesideOpenCv(
        ours=ours,
        theirs=theirs,
        n_windows=n_rows * n_columns,
        n_visited=int(visited.sum()),
        n_different=int((found_by_opencv != (found & visited)).sum()),
    )


def visited_by_opencv(begun: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Select the windows that OpenCV visits, given which pass the first stage.

    Every other one, and after one that does not pass the next but one.
    """
    visited = np.zeros_like(begun)
    for row in range(0, begun.shape[0], 2):
        column = 0
        while column < begun.shape[1]:
            visited[row, column] = True
            column += 2 if begun[row, column] else 4
    return visited


def _in_one_band(
    codes: NDArray[np.uint16], inside: tuple[slice, slice], model: CascadeModel, n_groups: int
) -> tuple[CodePlane, Opened]:
    """Run the first groups on windows centred `inside`, as if all of the tile were in one band.

    Windows count however much of them is valid.
    """
    everywhere, usable = np.ones(codes.shape, dtype=np.bool_), np.zeros(codes.shape, dtype=np.bool_)
    usable[inside] = True
    plane = make_plane(codes, everywhere, usable, np.full(len(codes), _FIRST_RETURN_M), ROW_M, COLUMN_M)
    edges = np.zeros((len(codes), N_BANDS + 1), dtype=np.int32)
    edges[:, _BAND + 1 :] = codes.shape[1]
    stride = plane.sums.shape[1]
    tables = tables_of(model, ROW_M, COLUMN_M, stride)._replace(least=np.zeros(N_BANDS, dtype=np.int32))
    corner = plane.margin_rows * stride + plane.margin_near
    return plane, open_windows(WindowField(plane.sums, plane.counts, corner, usable, edges), tables, n_groups)


def _map_of(plane: CodePlane, opened: Opened) -> NDArray[np.bool_]:
    rows, columns = np.divmod(opened.windows.place, plane.sums.shape[1])
    passed = np.zeros(plane.usable.shape, dtype=np.bool_)
    passed[rows - plane.margin_rows, columns - plane.margin_near] = True
    return passed


def _drawn_stump(random: np.random.Generator) -> Stump:
    """Draw a comparison of highlight or shadow in an object's place with a box beside it.

    Most of those drawn separate objects.
    """
    low, high = sorted(random.uniform(-0.45, 0.45, 2).tolist())
    beside = (
        WINDOW
        if random.random() < 0.5
        else FeatureBox(*((0.5, 1.0) if random.random() < 0.5 else (-1.0, -0.5)), -0.8, 0.0, 0.8, 0.8)
    )
    sure = int(random.integers(100, 500))
    if random.random() < 0.5:
        inner = FeatureBox(low, high + 0.1, -0.3, 0.0, float(random.uniform(-0.1, 0.3)), 0.0)
        threshold, below, above = float(random.uniform(1.1, 1.8)), -sure, sure
    else:
        inner = FeatureBox(low, high + 0.1, 0.2, 0.0, float(random.uniform(0.3, 0.6)), float(random.uniform(0.3, 0.9)))
        threshold, below, above = float(random.uniform(0.5, 0.9)), sure, -sure
    if random.random() < 0.7:
        return Stump(kind="ratio", a=inner, b=beside, threshold=threshold, below=below, above=above)
    return Stump(kind="contrast", a=inner, b=beside, w=WINDOW, threshold=threshold - 1.0, below=below, above=above)
