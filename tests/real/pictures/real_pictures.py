"""Recorded pictures: side-scan tiles with masks of an effigy's highlight, tiles without it, and snippets of bare sea
floor.

`sdvd_20240429` holds the tiles (Jaszcz et al. 2024), `sas` the synthetic-aperture snippets (NSWC PCD). All are 8-bit
pictures with marks of the program that drew them.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from auv_mcm.errors import BadInputError
from tests.real.pictures.picture_speckle import picture_speckle

Mask = NDArray[np.bool_]
Plane = NDArray[np.float64]
Counts = NDArray[np.uint8]

EFFIGY_M: Final = 1.8

_BRIGHTEST: Final = 255
_INVERTED_SKEWNESS: Final = -0.2
_INVERTED_SPREAD: Final = 0.2
_MIN_FILL_PX: Final = 600
_TICK_PX: Final = 8
_LABEL_PX: Final = (66, 10)  # rows above a tick's end, columns beside it


class Picture(NamedTuple):
    """Hold a recorded picture, range growing to the right.

    amplitude: (n_rows, n_columns) float64. measured: same shape bool, False under marks, fill and water column.
    clipped: bool. mask: of the object's highlight, None without an object. inverted: recorded with bright and dark
    exchanged.
    """

    name: str
    counts: Counts
    amplitude: Plane
    measured: Mask
    clipped: Mask
    mask: Mask | None
    inverted: bool

    @property
    def cut(self) -> bool:
        """Report whether the object leaves the picture."""
        assert self.mask is not None
        return bool(self.mask[[0, -1]].any() or self.mask[:, [0, -1]].any())


def effigies(folder: Path) -> list[Picture]:
    """Read the side-scan tiles with a mask, range growing to the right. Raises BadInputError if there are none."""
    images = folder / "sdvd_20240429" / "images"
    return [
        read_picture(path, mask_path=images.parent / "masks" / path.name, mirrored=path.name.startswith("left_"))
        for path in _listed(images, ("left_*", "right_*"))
    ]


def clutter(folder: Path) -> list[Picture]:
    """Read the side-scan tiles without the object, each as recorded and mirrored, since their side is unknown."""
    paths = _listed(folder / "sdvd_20240429" / "images", ("clutter_*",))
    return [read_picture(path, mirrored=mirrored) for path in paths for mirrored in (False, True)]


def snippets(folder: Path) -> list[Picture]:
    """Read the synthetic-aperture snippets."""
    return [read_picture(path) for path in _listed(folder / "sas", ("image_*",))]


def read_picture(path: Path, *, mask_path: Path | None = None, mirrored: bool = False) -> Picture:
    """Read an 8-bit picture; mirrored for one whose range grows to the left. Raises BadInputError naming the file."""
    counts, mask = _gray(path), None
    if mask_path is not None:
        mask = _gray(mask_path) > _BRIGHTEST // 2
        if mask.shape != counts.shape:
            raise BadInputError(
                f"{mask_path}: the mask is {mask.shape}, the picture {counts.shape}; they must be alike"
            )
    if mirrored:
        counts = np.ascontiguousarray(counts[:, ::-1])
        mask = None if mask is None else np.ascontiguousarray(mask[:, ::-1])
    measured = ~(_fill(counts) | _range_marks(counts))
    evidence = picture_speckle(counts)
    inverted = evidence.skewness < _INVERTED_SKEWNESS and evidence.relative_std < _INVERTED_SPREAD
    amplitude = (_BRIGHTEST - counts if inverted else counts).astype(np.float64)
    return Picture(path.stem, counts, amplitude, measured, amplitude >= _BRIGHTEST, mask, inverted)


def length_px(mask: Mask) -> float:
    """Return the maximum distance between two points of a mask."""
    hull = cv2.convexHull(np.argwhere(mask).astype(np.int32)).reshape(-1, 2).astype(np.float64)
    return float(np.linalg.norm(hull[:, None] - hull[None], axis=2).max()) + 1.0


def _listed(folder: Path, patterns: Sequence[str]) -> list[Path]:
    paths = sorted(path for pattern in patterns for path in folder.glob(pattern))
    if not paths:
        raise BadInputError(f"{folder} holds no {patterns[0]}: give the folder with sdvd_20240429 and sas as --data")
    return paths


def _gray(path: Path) -> Counts:
    picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) if path.is_file() else None
    if picture is None:
        raise BadInputError(
            f"{path}: no picture that can be read; give the folder with sdvd_20240429 and sas as --data"
        )
    return np.asarray(picture, dtype=np.uint8)


def _fill(counts: Counts) -> Mask:
    """Return large areas of zeros, where the tile goes beyond the recording."""
    _, parts, stats, _ = cv2.connectedComponentsWithStats((counts == 0).astype(np.uint8), connectivity=4)
    large = stats[:, cv2.CC_STAT_AREA] >= _MIN_FILL_PX
    large[0] = False
    return np.asarray(large[parts])


def _range_marks(counts: Counts) -> Mask:
    """Find ticks of the range scale, and the transmit pulse, which looks alike.

    Ticks are white between black, with the label above.
    """
    wide = np.pad(counts.astype(np.int64), ((0, 0), (2, 2)), mode="edge")
    tick = (wide[:, 2:-2] > 180) & (wide[:, :-4] < 70) & (wide[:, 4:] < 70)
    long = cv2.erode(
        tick.astype(np.uint8), np.ones((_TICK_PX, 1), np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=0
    )
    above, beside = _LABEL_PX
    marked = np.zeros(counts.shape, dtype=np.bool_)
    for row, column in np.argwhere(long).tolist():
        marked[max(row - above, 0) : row + _TICK_PX, max(column - beside, 0) : column + beside + 1] = True
    return marked
