"""Extreme regions through the segmentation: no floating-point flag, no NaN, the same result every time, whatever the
gain."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from auv_mcm.confirm.mrf import Segmentation, segment
from auv_mcm.confirm.region import Region
from sim_replay.benches.every_stage.drawn_regions import Drawing, draw_region

Plane = NDArray[np.float64]


def drawn(seed: int = 1) -> Region:
    return draw_region(Drawing(n_rows=72, n_columns=96, object_rows=24, shadow_columns=36, seed=seed))[0]


def region_of(intensity: Plane, valid: NDArray[np.bool_] | None = None) -> Region:
    everywhere = np.ones(intensity.shape, dtype=np.bool_)
    return msgspec.structs.replace(drawn(), intensity=intensity, valid=everywhere if valid is None else valid)


def checked(region: Region) -> Segmentation:
    with np.errstate(divide="raise", over="raise", invalid="raise"):
        result = segment(region)
    assert result.labels.shape == region.intensity.shape
    assert result.labels.max(initial=0) <= 2
    numbers = [
        result.energy,
        result.lower_bound,
        result.smoothness,
        result.background_mean,
        result.shadow_mean,
        result.highlight_mean,
        *result.correlation,
        result.law.looks,
    ]
    assert np.isfinite(numbers).all()
    assert result.lower_bound <= result.energy + 1e-9 * abs(result.energy)
    return result


@pytest.mark.parametrize("share", [0.01, 0.3, 0.6, 0.95, 1.0])
def test_zeros_in_any_share_of_the_region(share: float) -> None:
    zero = np.random.Generator(np.random.PCG64(1)).random((72, 96)) < share
    result = checked(region_of(np.where(zero, 0.0, drawn().intensity)))
    assert share < 1.0 or result.flags == ("too_little_data",)


@pytest.mark.parametrize("gain", [1e-300, 1e-6, 1e6, 1e290])
def test_gain_changes_no_label(gain: float) -> None:
    region = drawn()
    plain, scaled = checked(region), checked(msgspec.structs.replace(region, intensity=region.intensity * gain))
    assert (plain.labels != scaled.labels).mean() <= 5e-4
    assert scaled.background_mean == pytest.approx(plain.background_mean * gain, rel=1e-6)
    assert scaled.energy == pytest.approx(plain.energy, rel=1e-5)


def test_denormals_are_a_region_like_any() -> None:
    checked(region_of(drawn().intensity * 1e-310))


@pytest.mark.parametrize(
    "plane",
    [
        lambda shape: np.full(shape, 3.0),
        lambda shape: np.where(np.indices(shape).sum(axis=0) % 2, 1.0, 2.0),
        lambda shape: np.where(np.indices(shape)[1] < shape[1] // 2, 1.0, 65535.0),
        lambda shape: np.where(np.indices(shape).sum(axis=0) == 40, 1e12, 1.0),
        lambda shape: np.exp(np.linspace(-14.0, 14.0, shape[0] * shape[1])).reshape(shape),
    ],
    ids=["constant", "checkerboard", "saturated half", "impulses", "ramp of 120 dB"],
)
def test_pictures_without_speckle(plane: Callable[[tuple[int, int]], Plane]) -> None:
    checked(region_of(plane((72, 96)).astype(np.float64)))


def test_constant_region_is_flagged() -> None:
    assert checked(region_of(np.full((40, 50), 3.0))).flags == ("no_speckle",)


@pytest.mark.parametrize("shape", [(1, 96), (2, 300), (72, 1), (3, 40), (40, 3), (9, 9), (0, 5)])
def test_regions_of_hardly_any_row_or_column(shape: tuple[int, int]) -> None:
    intensity = np.random.Generator(np.random.PCG64(2)).exponential(1.0, shape)
    result = checked(region_of(intensity))
    assert min(shape) >= 3 or result.flags == ("too_little_data",)


def test_one_look_at_most_of_the_range_of_numbers() -> None:
    random = np.random.Generator(np.random.PCG64(3))
    checked(region_of(np.exp(random.uniform(-600.0, 600.0, (72, 96)))))


@pytest.mark.parametrize("share", [0.001, 0.2, 0.7, 0.9, 1.0])
def test_holes_and_not_a_number(share: float) -> None:
    region = drawn()
    hole = np.random.Generator(np.random.PCG64(4)).random(region.intensity.shape) < share
    by_mask = checked(msgspec.structs.replace(region, valid=~hole))
    for mark in (np.nan, np.inf, -1.0):
        by_value = checked(msgspec.structs.replace(region, intensity=np.where(hole, mark, region.intensity)))
        np.testing.assert_array_equal(by_mask.labels, by_value.labels)
    assert share < 0.8 or by_mask.flags == ("too_little_data",)
