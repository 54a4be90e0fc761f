"""What inversion finds of scenes whose relief, reflectivity and beam pattern are known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from sim_replay.augment.direct import invert, multi_look
from sim_replay.augment.forward import BeamPattern, SeafloorScene, ground_range_m, render_image

Array = NDArray[np.float64]
COLUMN_M, ROW_M = 0.1, 0.2
N_PINGS, N_COLUMNS = 96, 240
ANGLES = np.radians(np.linspace(5.0, 85.0, 81))
BEAM = BeamPattern(depression_rad=ANGLES, gain=0.3 + np.sin(2.0 * ANGLES) ** 2)
ALL = np.ones((N_PINGS, N_COLUMNS), dtype=np.bool_)


def ripples() -> Array:
    """Crests 1.3 m apart and 14 cm high, across the track but for 30 degrees."""
    along, across = np.arange(N_PINGS)[:, None] * ROW_M, ground_range_m(N_COLUMNS, COLUMN_M)
    return np.asarray(0.07 * np.sin(2.0 * math.pi * (0.5 * along + 0.87 * across) / 1.3))


def scene_of(elevation: Array) -> SeafloorScene:
    along_m = ROW_M * np.arange(N_PINGS, dtype=np.float64)
    return SeafloorScene(
        elevation_m=elevation,
        reflectivity=np.exp(0.4 * np.sin(along_m / 5.0))[:, None] * np.ones(N_COLUMNS),
        beam=BEAM,
        altitude_m=5.0 + 0.3 * np.sin(along_m / 7.0),
        along_m=along_m,
        column_spacing_m=COLUMN_M,
        valid=ALL,
    )


def image_of(scene: SeafloorScene, looks: int, seed: int = 3) -> Array:
    generator = np.random.Generator(np.random.PCG64(seed))
    return np.asarray(
        (render_image(scene).intensity + 1e-3) * generator.gamma(looks, 1.0 / looks, scene.elevation_m.shape)
    )


def inverted(image: Array, scene: SeafloorScene, valid: NDArray[np.bool_] = ALL) -> SeafloorScene:
    return invert(image, valid, scene.altitude_m, scene.along_m, COLUMN_M)


def short_waves(relief: Array) -> Array:
    """Without what is longer than some 6 m, which no image separates from reflectivity, and without the edges."""
    return np.asarray((relief - gaussian_filter(relief, (1.0 / ROW_M, 1.0 / COLUMN_M), mode="nearest"))[5:-5, 20:-10])


def correlation(one: Array, other: Array) -> float:
    return float(np.corrcoef(one.ravel(), other.ravel())[0, 1])


@pytest.mark.parametrize(("looks", "min_correlation"), [(1, 0.75), (4, 0.85), (50, 0.93)])
def test_ripples_come_back_with_their_height(looks: int, min_correlation: float) -> None:
    scene = scene_of(ripples())
    found, truth = short_waves(inverted(image_of(scene, looks), scene).elevation_m), short_waves(scene.elevation_m)
    assert correlation(found, truth) > min_correlation
    assert 0.4 < float((found * truth).sum() / (truth**2).sum()) < 1.2


def test_level_floor_comes_back_level_with_its_reflectivity_and_beam() -> None:
    scene = scene_of(np.zeros((N_PINGS, N_COLUMNS)))
    found = inverted(image_of(scene, 10), scene)
    assert float(short_waves(found.elevation_m).std()) < 0.02
    assert float(found.elevation_m.std()) < 0.04
    assert correlation(np.log(found.reflectivity)[5:-5, 20:-10], np.log(scene.reflectivity)[5:-5, 20:-10]) > 0.95
    level = np.interp(np.radians([15.0, 25.0, 40.0, 60.0]), found.beam.depression_rad, found.beam.gain)
    truth = np.interp(np.radians([15.0, 25.0, 40.0, 60.0]), BEAM.depression_rad, BEAM.gain)
    assert np.abs(10.0 * np.log10(level / truth / (level / truth).mean())).max() < 0.5


@pytest.mark.parametrize("relief", [0.0, 1.0])
def test_render_of_what_was_found_is_the_image_without_speckle(relief: float) -> None:
    scene = scene_of(relief * ripples())
    wanted = render_image(scene).intensity[5:-5, 20:-10]
    found = render_image(inverted(image_of(scene, 4), scene)).intensity[5:-5, 20:-10]
    assert float(np.sqrt(((found - wanted) ** 2).sum() / (wanted**2).sum())) < 0.25
    assert abs(10.0 * math.log10(found.mean() / wanted.mean())) < 0.2


def test_what_is_not_valid_does_not_count() -> None:
    scene = scene_of(ripples())
    valid = ALL.copy()
    valid[30:40, 60:120] = valid[:, 230:] = False
    image = image_of(scene, 4)
    zeros, junk = np.where(valid, image, 0.0), np.where(valid, image, np.nan)
    one, other = inverted(zeros, scene, valid), inverted(junk, scene, valid)
    np.testing.assert_array_equal(one.elevation_m, other.elevation_m)
    assert correlation(short_waves(one.elevation_m), short_waves(scene.elevation_m)) > 0.7


def test_wall_casts_its_shadow_again() -> None:
    elevation = np.zeros((N_PINGS, N_COLUMNS))
    elevation[30:60, 120:124] = 0.5
    scene = scene_of(elevation)
    truth, found = render_image(scene), render_image(inverted(image_of(scene, 10), scene))
    floor = float(np.median(truth.intensity))
    behind = truth.shadow & (truth.intensity < 0.05 * floor)
    assert float(np.median(found.intensity[behind])) < 0.3 * floor


def test_picture_without_echoes_gives_finite_planes_that_render_to_nothing() -> None:
    scene = scene_of(ripples())
    for image, valid in ((np.zeros(ALL.shape), ALL), (image_of(scene, 4), ~ALL)):
        found = inverted(image, scene, valid)
        assert all(np.isfinite(plane).all() for plane in (found.elevation_m, found.reflectivity, found.beam.gain))
        assert not render_image(found).intensity[valid].any()


@pytest.mark.parametrize("shape", [(1, 40), (2, 6), (20, 3), (1, 1)])
def test_small_pictures_are_inverted_too(shape: tuple[int, int]) -> None:
    image = np.random.Generator(np.random.PCG64(1)).gamma(1.0, 1.0, shape)
    found = invert(
        image, np.ones(shape, dtype=np.bool_), np.full(shape[0], 5.0), 0.2 * np.arange(shape[0], dtype=np.float64), 0.1
    )
    assert np.isfinite(render_image(found).intensity).all()


@pytest.mark.parametrize("looks", [1, 4])
def test_picture_is_smoothed_to_four_looks_and_its_looks_returned(looks: int) -> None:
    generator = np.random.Generator(np.random.PCG64(5))
    smoothed = multi_look(generator.gamma(looks, 1.0 / looks, (200, 300)), np.ones((200, 300), dtype=np.bool_))
    measured = 1.0 / float(smoothed.intensity.var())
    assert 0.8 < smoothed.looks / measured < 1.8
    assert measured > 4.0
