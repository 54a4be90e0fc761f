"""Run the cascade that ships over drawn tiles, beside the same in numpy.

Tiles of 1024 by 1024 pixels of 0.12 by 0.05 m are seen from 6 m.
"""

from __future__ import annotations

from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from auv_mcm.detect.cascade.bands import band_edges
from auv_mcm.detect.cascade.choose import shipped_model
from auv_mcm.detect.cascade.codes import CodePlane, codes_of, make_plane
from auv_mcm.detect.cascade.run import tables_of
from auv_mcm.kernels.cascade import Opened, WindowField, Windows, open_windows, open_windows_numpy
from sim_replay.benches.every_stage.rows import Other, Row

ROW_M: Final = 0.12  # m along the track, of the tiles that are timed
COLUMN_M: Final = 0.05  # m across
SHAPE: Final = (1024, 1024)  # rows and columns

_FIRST_RETURN_M: Final = 6.0  # m

Image = NDArray[np.float32]


def cascade_rows(n: int) -> list[Row]:
    """Run all groups on all windows of a tile; times are per million windows."""
    model, rows = shipped_model(), []
    for name, image in drawn_tiles((192, SHAPE[1]) if n < 4 else SHAPE).items():
        plane = code_plane_of(image)
        stride = plane.sums.shape[1]
        edges = band_edges(plane.first_return_m, plane.n_columns, COLUMN_M, model.reference_height_m)
        corner = plane.margin_rows * stride + plane.margin_near
        field = WindowField(plane.sums, plane.counts, corner, plane.usable, edges)
        arguments = field, tables_of(model, ROW_M, COLUMN_M, stride), len(model.groups)
        by_numpy = open_windows_numpy(*arguments)
        per = 1e-6 * by_numpy.n_windows
        rows.append(
            Row(
                "cascade",
                f"{name} tile, a million windows",
                partial(open_windows, *arguments),
                partial(_n_otherwise, by_numpy.windows),
                "windows decided otherwise",
                0.0,
                Other("numpy", partial(open_windows_numpy, *arguments), per=per),
                per,
            )
        )
    return rows


def _n_otherwise(wanted: Windows, found: Opened) -> float:
    """Count the windows that pass in one alone, or with another score."""
    ours, theirs = (set(zip(some.place.tolist(), some.score.tolist(), strict=True)) for some in (found.windows, wanted))
    return float(len(ours ^ theirs))


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
