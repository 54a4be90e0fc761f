"""Embed simulated mines in recorded synthetic-aperture pictures of the sea floor, with the truth of every pixel.

Recorded floor outside the object's highlight and shadow is kept. In the shadow it is the recorded echo times what the
simulation leaves of the floor's, plus noise as in the darkest places of all pictures. The object's own echo is
simulated, with single-look speckle, over the recorded floor's mean. Scale, altitude and range are assumed: the pictures
state none. Pictures: SASSED, courtesy of NSWC PCD, approved for public release.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from auv_mcm.confirm.region import BACKGROUND, HIGHLIGHT
from auv_mcm.errors import BadInputError
from auv_mcm.kernels.shape import Array, Solid
from sim_replay.studies.real_pictures import read_picture
from sim_replay.studies.sas_objects import Drawn, drawn_from, over_ground, render, speckled

PIXELS_M: Final = (0.025, 0.05)
"""Pixel sizes assumed, m: the pictures state none."""
_KHZ: Final = 300.0  # as of the simulated floors beside them
_PIXELS_PER_RESOLUTION: Final = 1.2  # as simulated floors have it
_BLOCK_PX: Final = 16  # on a side: the spread of 256 pixels of single-look speckle is known to a tenth
_FLATTEST: Final = 0.25  # quantile of blocks taken to be speckle alone
_FLAT_SPREAD: Final = 0.90  # variance over squared mean at that quantile in simulated speckle of this grain
_TONES: Final = np.geomspace(1.0, 200.0, 400)  # parameters of the tone map tried, 1.3 % apart
_NOISE_PX: Final = 5  # on a side of the blocks in which the darkest place is looked for
_NOISE_QUANTILE: Final = 1e-3  # of all pictures' blocks: the floor of the deepest shadows
_EDGE_PX: Final = 5  # around highlight and shadow that the simulation changes too: blur of their edges


class Floor(NamedTuple):
    """Hold a recorded picture. intensity: (n_rows, n_columns), of mean 1; range grows to the right."""

    name: str
    intensity: Array


def recorded_floors(data: Path) -> list[Floor]:
    """Read all snippets below a folder, as intensities. Raises BadInputError if there are none."""
    paths = sorted([*(data / "sas").glob("image_*.png"), *(data / "floors" / "sassed").glob("image_*.png")])
    if not paths:
        raise BadInputError(f"{data} holds no sas/image_*.png: give the folder with the snippets as --pictures")
    floors = []
    for path in paths:
        counts = read_picture(path).counts
        intensity = magnitude(counts, tone_of(counts)) ** 2
        floors.append(Floor(f"{path.parent.name}/{path.stem}", intensity / intensity.mean()))
    return floors


def magnitude(counts: NDArray[np.uint8], tone: float) -> Array:
    """Undo Schlick's tone map of 8-bit counts: v / (tone - (tone - 1) v), v the share of 255."""
    share = counts / 255.0
    return np.asarray(share / (tone - (tone - 1.0) * share))


def tone_of(counts: NDArray[np.uint8]) -> float:
    """Fit the tone map's parameter: in the flattest blocks single-look intensity is exponentially distributed."""
    spread = [_flat_spread(magnitude(counts, tone) ** 2) for tone in _TONES.tolist()]
    return float(_TONES[int(np.argmin(np.abs(np.array(spread) - _FLAT_SPREAD)))])


def noise_of(floors: Sequence[Floor]) -> float:
    """Measure the noise, of the mean floor: the darkest blocks of all pictures."""
    blocks = [cv2.blur(floor.intensity, (_NOISE_PX, _NOISE_PX)).ravel() for floor in floors]
    return float(np.quantile(np.concatenate(blocks), _NOISE_QUANTILE))


def embed(solid: Solid, pixel_m: float, floor: Floor, noise: float, seed: int) -> Drawn:
    """Embed an object of usual size; seed alone decides on size, place, direction, and where the picture is cut.

    Parameters
    ----------
    pixel_m
        Pixel size assumed, m.
    noise
        Intensity where nothing is heard, of the mean floor.

    Raises
    ------
    BadInputError
        For a picture smaller than the object and its shadow.
    """
    random = np.random.Generator(np.random.PCG64(seed))
    rendered = render(solid, _PIXELS_PER_RESOLUTION * pixel_m, _KHZ, seed, random)
    bins = rendered.floor > 0.0
    ratio = np.divide(rendered.mean, rendered.floor, out=np.ones_like(rendered.mean), where=bins)
    n_rows, n_columns = rendered.region.intensity.shape
    spare = floor.intensity.shape[0] - n_rows, floor.intensity.shape[1] - n_columns
    if min(spare) < 0:
        raise BadInputError(f"{floor.name} is smaller than {n_rows} x {n_columns} pixels, which an object here needs")
    top, left = (int(random.integers(0, most + 1)) for most in spare)
    recorded = floor.intensity[top : top + n_rows, left : left + n_columns]
    energy = over_ground(rendered, ratio)
    truth = drawn_from(rendered, recorded, energy + noise).truth
    changed = cv2.dilate((truth != BACKGROUND).astype(np.uint8), np.ones((_EDGE_PX, _EDGE_PX), np.uint8)).astype(bool)
    level = float(recorded[~changed].mean())
    is_object = changed & (energy > 1.0) | (truth == HIGHLIGHT)
    echo = over_ground(rendered, speckled(np.maximum(ratio, noise), random))
    hidden = noise * over_ground(rendered, speckled(np.ones_like(ratio), random))
    heard = np.where(
        is_object, level * echo, np.minimum(energy, 1.0) * recorded + np.maximum(1.0 - energy, 0.0) * hidden
    )
    return drawn_from(rendered, np.where(changed, heard, recorded) / level, energy + noise)


def _flat_spread(intensity: Array) -> float:
    rows, columns = (n // _BLOCK_PX * _BLOCK_PX for n in intensity.shape)
    blocks = intensity[:rows, :columns].reshape(rows // _BLOCK_PX, _BLOCK_PX, columns // _BLOCK_PX, _BLOCK_PX)
    mean = blocks.mean(axis=(1, 3))
    return float(np.quantile(blocks.var(axis=(1, 3)) / np.maximum(mean, 1e-12) ** 2, _FLATTEST))
