"""What is recovered of floors whose relief, reflectivity and beam pattern are known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from sim_replay.augment.floor import Floor, recover_floor
from sim_replay.benches.every_stage.stages import lambert_image

Array = NDArray[np.float64]
COLUMN_M, ROW_M = 0.1, 0.2
N_PINGS, N_COLUMNS = 96, 240
ALONG_M = ROW_M * np.arange(N_PINGS, dtype=np.float64)
GROUND_M = (np.arange(N_COLUMNS) + 0.5) * COLUMN_M
ALTITUDE_M = 5.0 + 0.3 * np.sin(ALONG_M / 7.0)
REFLECTIVITY = np.exp(0.4 * np.sin(ALONG_M / 5.0))[:, None] * np.ones(N_COLUMNS)
RIPPLES = 0.07 * np.sin(2.0 * math.pi * (0.5 * ALONG_M[:, None] + 0.87 * GROUND_M) / 1.3)
LEVEL = np.zeros((N_PINGS, N_COLUMNS))
ALL = np.ones(LEVEL.shape, dtype=np.bool_)
INNER = (slice(5, -5), slice(20, -10))


def beam_gain(depression_rad: Array) -> Array:
    return np.asarray(0.3 + np.sin(2.0 * depression_rad) ** 2)


def image_of(relief: Array, looks: int, seed: int = 3) -> Array:
    mean = lambert_image(relief, REFLECTIVITY, ALTITUDE_M, ROW_M, COLUMN_M) + 1e-3
    depression = np.arctan2(ALTITUDE_M[:, None] - relief, GROUND_M)
    speckle = np.random.Generator(np.random.PCG64(seed)).gamma(looks, 1.0 / looks, relief.shape)
    return np.asarray(mean * beam_gain(depression) * speckle)


def recovered(image: Array, valid: NDArray[np.bool_] = ALL) -> Floor:
    return recover_floor(image, valid, ALTITUDE_M, ALONG_M, COLUMN_M)


def short_waves(relief: Array) -> Array:
    """Without what is longer than some 6 m, which no image separates from reflectivity, and without the edges."""
    return np.asarray((relief - gaussian_filter(relief, (1.0 / ROW_M, 1.0 / COLUMN_M), mode="nearest"))[INNER])


def correlation(one: Array, other: Array) -> float:
    return float(np.corrcoef(one.ravel(), other.ravel())[0, 1])


@pytest.mark.parametrize(("looks", "min_correlation"), [(1, 0.6), (4, 0.8), (50, 0.92)])
def test_ripples_come_back_with_their_height(looks: int, min_correlation: float) -> None:
    found, truth = short_waves(recovered(image_of(RIPPLES, looks)).elevation_m), short_waves(RIPPLES)
    assert correlation(found, truth) > min_correlation
    assert 0.4 < float((found * truth).sum() / (truth**2).sum()) < 1.2


def test_level_floor_comes_back_level_with_its_reflectivity_and_beam() -> None:
    found = recovered(image_of(LEVEL, 10))
    assert float(short_waves(found.elevation_m).std()) < 0.02
    assert float(found.elevation_m.std()) < 0.04
    assert found.reflectivity.mean() == pytest.approx(1.0)
    assert correlation(np.log(found.reflectivity)[INNER], np.log(REFLECTIVITY)[INNER]) > 0.95
    angles = np.radians([15.0, 25.0, 40.0, 60.0])
    ratio = np.interp(angles, found.beam.depression_rad, found.beam.gain) / beam_gain(angles)
    assert np.abs(10.0 * np.log10(ratio / ratio.mean())).max() < 0.5


def test_what_is_not_valid_does_not_count() -> None:
    valid = ALL.copy()
    valid[30:40, 60:120] = valid[:, 230:] = False
    image = image_of(RIPPLES, 4)
    one, other = (recovered(np.where(valid, image, junk), valid) for junk in (0.0, np.nan))
    np.testing.assert_array_equal(one.elevation_m, other.elevation_m)
    assert correlation(short_waves(one.elevation_m), short_waves(RIPPLES)) > 0.7


def test_a_shadow_falls_as_the_line_of_sight_does() -> None:
    wall = LEVEL.copy()
    wall[30:60, 120:124] = 0.5
    found = recovered(image_of(wall, 10)).elevation_m[40:50]
    fall_m = found[:, 125] - found[:, 132]
    assert 0.5 < float(np.median(fall_m)) / (0.7 * 5.0 / 13.0) < 1.2


@pytest.mark.parametrize(("image", "valid"), [(LEVEL, ALL), (image_of(RIPPLES, 4), ~ALL)], ids=["dark", "not valid"])
def test_pictures_without_echoes_give_level_floor(image: Array, valid: NDArray[np.bool_]) -> None:
    found = recovered(image, valid)
    assert all(np.isfinite(plane).all() for plane in (found.elevation_m, found.reflectivity, found.beam.gain))
    if not valid.any():
        assert not found.elevation_m.any()


@pytest.mark.parametrize("shape", [(1, 40), (2, 6), (20, 3), (1, 1)])
def test_small_pictures_are_recovered_too(shape: tuple[int, int]) -> None:
    image = np.random.Generator(np.random.PCG64(1)).gamma(1.0, 1.0, shape)
    along_m = 0.2 * np.arange(shape[0], dtype=np.float64)
    found = recover_floor(image, np.ones(shape, dtype=np.bool_), np.full(shape[0], 5.0), along_m, 0.1)
    assert all(np.isfinite(plane).all() for plane in (found.elevation_m, found.reflectivity, found.beam.gain))
