"""Classes of one pixel or none, samples that are all alike, equations that say the same: flagged or bounded, never
NaN."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from auv_mcm.confirm.mrf import segment
from auv_mcm.confirm.region import Region
from auv_mcm.confirm.snake import converge
from auv_mcm.solids.box_search import SearchBox, curvature_covariance
from tests.stability.region_doors import DOORS, START, cone_region, plain, through

Plane = NDArray[np.float64]
SHAPE = cone_region().intensity.shape


@pytest.fixture(autouse=True)
def _no_floating_point_flag() -> Iterator[None]:
    with np.errstate(all="raise", under="ignore"):
        yield


def picture(plane: Plane) -> Region:
    return msgspec.structs.replace(cone_region(), intensity=np.ascontiguousarray(plane, dtype=np.float64))


def speckle(seed: int = 1) -> Plane:
    return np.random.Generator(np.random.PCG64(seed)).exponential(1.0, SHAPE)


def with_pixel(plane: Plane, level: float) -> Plane:
    plane = plane.copy()
    plane[30, 60] = level
    return plane


GRID = np.indices(SHAPE)
PICTURES: dict[str, Callable[[], Plane]] = {
    "constant": lambda: np.full(SHAPE, 3.0),
    "one bright pixel in silence": lambda: with_pixel(np.zeros(SHAPE), 1.0),
    "one dark pixel in a constant": lambda: with_pixel(np.ones(SHAPE), 0.0),
    "one bright pixel in a constant": lambda: with_pixel(np.ones(SHAPE), 50.0),
    "one dark pixel in speckle": lambda: with_pixel(speckle() + 0.5, 0.0),
    "two levels by one bit": lambda: (speckle() > 0.7).astype(np.float64),
    "every sample twice": lambda: np.repeat(
        np.repeat(speckle()[: -(-SHAPE[0] // 2), : -(-SHAPE[1] // 2)], 2, axis=0), 2, axis=1
    )[: SHAPE[0], : SHAPE[1]],
    "every row alike": lambda: np.tile(speckle()[:1], (SHAPE[0], 1)),
    "every column alike": lambda: np.tile(speckle()[:, :1], (1, SHAPE[1])),
    "checkerboard": lambda: np.asarray(GRID.sum(axis=0) % 2, dtype=np.float64),
    "half saturated": lambda: np.where(GRID[1] < SHAPE[1] // 2, 65535.0, speckle()),
    "ramp of 40 dB": lambda: speckle() * 10.0 ** (4.0 * GRID[0] / SHAPE[0]),
    "ramp of 120 dB": lambda: np.exp(np.linspace(-14.0, 14.0, SHAPE[0] * SHAPE[1])).reshape(SHAPE),
    "zeros": lambda: np.zeros(SHAPE),
    "three zeros in ten": lambda: np.where(np.random.Generator(np.random.PCG64(6)).random(SHAPE) < 0.3, 0.0, speckle()),
    "zeros but for one in twenty": lambda: np.where(
        np.random.Generator(np.random.PCG64(6)).random(SHAPE) < 0.95, 0.0, speckle()
    ),
    "one measured ping": lambda: np.where(GRID[0] == 30, speckle(), math.nan),
    "two measured pixels": lambda: np.where((GRID[0] == 30) & (GRID[1] // 2 == 30), speckle(), math.nan),
}


@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize("name", PICTURES)
def test_pictures_with_hardly_a_class_are_answered_with_numbers(door: str, name: str) -> None:
    answer = plain(through(door, picture(PICTURES[name]())))
    # NaN: no contour
    allowed = {"criterion", "gain", "height_m", "repetition", "highlight_mean", "shadow_mean", "background_mean"}
    if isinstance(answer, dict):
        answer = {key: value for key, value in answer.items() if key not in allowed}
    assert "nan" not in repr(answer)


def test_a_region_without_echo_or_speckle_is_flagged() -> None:
    silent, constant = picture(np.zeros(SHAPE)), picture(np.full(SHAPE, 3.0))
    assert through("segment", silent).flags == ("too_little_data",)
    assert through("fit_shapes", silent).flags == ("no_data",)
    assert through("segment", constant).flags == ("no_speckle",)
    assert through("fit_shapes", constant).fits == ()


@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize("shape", [(1, 1), (1, 90), (2, 3), (40, 1), (3, 40), (40, 3), (9, 9)])
def test_regions_of_hardly_any_row_or_column_are_answered(door: str, shape: tuple[int, int]) -> None:
    region = msgspec.structs.replace(
        cone_region(), intensity=speckle()[: shape[0], : shape[1]], valid=np.ones(shape, bool)
    )
    answer = through(door, region)
    assert door != "segment" or min(shape) >= 3 or answer.flags == ("too_little_data",)


@pytest.mark.parametrize("offset", [1e3, 1e6, 1e12])
def test_contrast_that_drowns_in_an_offset_makes_no_object(offset: float) -> None:
    """Sums of squares over a mean this far off would have lost all digits."""
    drowned = picture(cone_region().intensity + offset)
    assert "no_speckle" in segment(drowned).flags
    assert converge(drowned, START).rejected
    assert through("fit_shapes", drowned).fits == ()
    assert abs(through("labels_cost", drowned)) < 1e-3


def test_absent_classes_are_flagged_and_keep_means_on_their_side_of_the_floor() -> None:
    flat = np.random.Generator(np.random.PCG64(2)).gamma(4.0, 0.25, SHAPE)
    answer = segment(picture(flat))
    assert set(answer.flags) == {"no_shadow", "no_highlight"}
    assert 0.0 < answer.shadow_mean <= 0.5 * answer.background_mean
    assert 2.0 * answer.background_mean <= answer.highlight_mean < math.inf


@pytest.mark.parametrize("rank", [0, 1, 2])
@pytest.mark.parametrize("steepness", [1e-12, 1.0, 1e12, 1e100])
def test_uncertainty_of_what_the_cost_does_not_determine_is_wide_and_finite(rank: int, steepness: float) -> None:
    space = SearchBox(np.full(3, -1.0), np.full(3, 1.0), np.zeros(3, dtype=np.bool_), np.full(3, 0.1))
    ways = np.array([[0.6, 0.8, 0.0], [0.0, 0.6, 0.8]])[:rank]
    covariance = curvature_covariance(
        lambda points: steepness * np.square(points @ ways.T).sum(axis=1), space, np.zeros(3)
    )
    assert np.isfinite(covariance).all()
    np.testing.assert_allclose(covariance, covariance.T, rtol=0.0, atol=1e-9 * covariance.max())
    assert (np.linalg.eigvalsh(covariance) > 0.0).all()
    if steepness <= 1.0:
        blind = np.linalg.svd(np.vstack((ways, np.zeros((3 - rank, 3)))))[2][-1]
        assert blind @ covariance @ blind > 0.1  # several grains of 0.1
