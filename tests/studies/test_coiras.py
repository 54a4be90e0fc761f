"""The reference inversion: its gradient against finite differences, and what it finds of ripples."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from sim_replay.augment.forward import BeamPattern, SeafloorScene, ground_range_m, render_image
from sim_replay.studies.coiras import Expected, invert_multiresolution, misfit

Array = NDArray[np.float64]
COLUMN_M, ROW_M = 0.1, 0.2


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32), st.integers(1, 6), st.integers(1, 8), st.floats(0.0, 2.0))
def test_gradient_is_what_finite_differences_give(seed: int, n_pings: int, n_columns: int, prior: float) -> None:
    generator = np.random.Generator(np.random.PCG64(seed))
    elevation = 0.03 * generator.standard_normal((n_pings, n_columns))
    expected = Expected(
        cosine=generator.uniform(0.2, 1.0, elevation.shape),
        lit=generator.random(elevation.shape) < 0.8,
        altitude_m=generator.uniform(4.0, 6.0, n_pings),
        along_m=np.cumsum(generator.uniform(0.1, 0.3, n_pings)),
        column_spacing_m=0.3,
        prior=prior,
        screen_per_m2=0.3,
    )
    found = misfit(elevation, expected)
    numeric, step = np.empty_like(elevation), 1e-6
    for place in np.ndindex(*elevation.shape):
        up, down = elevation.copy(), elevation.copy()
        up[place] += step
        down[place] -= step
        numeric[place] = (misfit(up, expected).value - misfit(down, expected).value) / (2.0 * step)
    np.testing.assert_allclose(found.gradient, numeric, rtol=1e-4, atol=1e-4 * max(float(np.abs(numeric).max()), 1e-3))


def test_misfit_of_the_true_relief_is_its_prior_alone() -> None:
    elevation, altitude_m, along_m = np.zeros((4, 50)), np.full(4, 5.0), ROW_M * np.arange(4, dtype=np.float64)
    cosine = np.tile(5.0 / np.hypot(ground_range_m(50, COLUMN_M), 5.0), (4, 1))
    expected = Expected(cosine, np.ones((4, 50), dtype=np.bool_), altitude_m, along_m, COLUMN_M, 1.0, 0.3)
    assert misfit(elevation, expected).value < 1e-20
    assert not np.abs(misfit(elevation, expected).gradient).max() > 1e-9


@pytest.mark.parametrize(("looks", "min_correlation"), [(1, 0.45), (4, 0.65), (100, 0.85)])
def test_ripples_come_back(looks: int, min_correlation: float) -> None:
    n_pings, n_columns = 64, 160
    along_m = ROW_M * np.arange(n_pings, dtype=np.float64)
    elevation = 0.07 * np.sin(
        2.0 * math.pi * (0.5 * along_m[:, None] + 0.87 * ground_range_m(n_columns, COLUMN_M)) / 1.3
    )
    angles = np.radians(np.linspace(5.0, 85.0, 81))
    scene = SeafloorScene(
        elevation_m=elevation,
        reflectivity=np.ones_like(elevation),
        beam=BeamPattern(depression_rad=angles, gain=0.3 + np.sin(2.0 * angles) ** 2),
        altitude_m=np.full(n_pings, 5.0),
        along_m=along_m,
        column_spacing_m=COLUMN_M,
        valid=np.ones(elevation.shape, dtype=np.bool_),
    )
    speckle = np.random.Generator(np.random.PCG64(3)).gamma(looks, 1.0 / looks, elevation.shape)
    image = (render_image(scene).intensity + 1e-3) * speckle
    found = invert_multiresolution(image, scene.valid, scene.altitude_m, along_m, COLUMN_M)
    short, truth = (plane - gaussian_filter(plane, (5.0, 10.0)) for plane in (found.elevation_m, elevation))
    assert float(np.corrcoef(short[5:-5, 20:-10].ravel(), truth[5:-5, 20:-10].ravel())[0, 1]) > min_correlation


@pytest.mark.parametrize("shape", [(1, 40), (2, 6), (20, 3), (1, 1)])
def test_small_pictures_are_inverted_too(shape: tuple[int, int]) -> None:
    image = np.random.Generator(np.random.PCG64(1)).gamma(1.0, 1.0, shape)
    valid, along_m = np.ones(shape, dtype=np.bool_), 0.2 * np.arange(shape[0], dtype=np.float64)
    assert np.isfinite(
        render_image(invert_multiresolution(image, valid, np.full(shape[0], 5.0), along_m, 0.1)).intensity
    ).all()
