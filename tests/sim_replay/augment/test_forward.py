"""The forward model of augmented images against a slow one, pixel by pixel, and against closed forms on planes."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from sim_replay.augment.forward import BeamPattern, Rendering, SeafloorScene, render_image

BEAM = BeamPattern(depression_rad=np.radians([2.0, 10.0, 40.0, 80.0]), gain=np.array([0.2, 1.0, 2.0, 0.5]))


def scene_of(
    elevation_m: NDArray[np.float64], altitude_m: float = 5.0, column_spacing_m: float = 0.1, step_m: float = 0.15
) -> SeafloorScene:
    n_pings = elevation_m.shape[0]
    return SeafloorScene(
        elevation_m=elevation_m,
        reflectivity=np.ones_like(elevation_m),
        beam=BEAM,
        altitude_m=np.full(n_pings, altitude_m),
        along_m=step_m * np.arange(n_pings, dtype=np.float64),
        column_spacing_m=column_spacing_m,
        valid=np.ones(elevation_m.shape, dtype=np.bool_),
    )


def slow_render(scene: SeafloorScene) -> Rendering:
    """Every pixel on its own: a line of sight tried against all nearer pixels, and vectors for the angles."""
    z, along, dy = scene.elevation_m, scene.along_m, scene.column_spacing_m
    n_pings, n_columns = z.shape
    intensity, shadow = np.zeros(z.shape), np.zeros(z.shape, dtype=np.bool_)
    for i in range(n_pings):
        for j in range(n_columns):
            y, depth = (j + 0.5) * dy, scene.altitude_m[i] - z[i, j]
            for k in range(j):
                sight_m = scene.altitude_m[i] - depth * (k + 0.5) / (j + 0.5)
                if z[i, k] > sight_m + 1e-12:
                    shadow[i, j] = True
            j1 = max(j, 1)
            across = (z[i, j1] - z[i, j1 - 1]) / dy if n_columns > 1 else 0.0
            first, last = max(i - 1, 0), min(i + 1, n_pings - 1)
            slope = (z[last, j] - z[first, j]) / (along[last] - along[first]) if last > first else 0.0
            normal = np.array([-slope, -across, 1.0]) / math.sqrt(1.0 + slope**2 + across**2)
            to_sonar = np.array([0.0, -y, depth]) / math.hypot(y, depth)
            cosine = max(float(normal @ to_sonar), 0.0)
            gain = np.interp(math.atan2(depth, y), scene.beam.depression_rad, scene.beam.gain)
            intensity[i, j] = 0.0 if shadow[i, j] else gain * scene.reflectivity[i, j] * cosine
    return Rendering(intensity, shadow)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32), st.integers(1, 5), st.integers(1, 30), st.floats(0.0, 1.0), st.floats(0.0, 1.5))
def test_render_is_what_every_pixel_on_its_own_gives(
    seed: int, n_pings: int, n_columns: int, relief_m: float, tilt: float
) -> None:
    generator = np.random.Generator(np.random.PCG64(seed))
    elevation = relief_m * generator.standard_normal((n_pings, n_columns)) + tilt * np.linspace(0.0, 1.0, n_columns)
    scene = msgspec.structs.replace(
        scene_of(elevation),
        reflectivity=generator.uniform(0.2, 3.0, elevation.shape),
        altitude_m=generator.uniform(4.0, 7.0, n_pings),
        along_m=np.cumsum(generator.uniform(0.05, 0.3, n_pings)),
    )
    fast, slow = render_image(scene), slow_render(scene)
    np.testing.assert_array_equal(fast.shadow, slow.shadow)
    np.testing.assert_allclose(fast.intensity, slow.intensity, rtol=1e-9, atol=1e-12)


def test_plain_floor_has_no_shadow_and_lamberts_cosine() -> None:
    rendering = render_image(scene_of(np.zeros((3, 200))))
    ground_m = (np.arange(200) + 0.5) * 0.1
    sine = 5.0 / np.hypot(ground_m, 5.0)
    assert not rendering.shadow.any()
    np.testing.assert_allclose(
        rendering.intensity[1], sine * np.interp(np.arcsin(sine), BEAM.depression_rad, BEAM.gain), rtol=1e-12
    )


@pytest.mark.parametrize("slope", [-0.1, 0.0, 0.15])
@pytest.mark.parametrize("height_m", [0.2, 0.5])
def test_shadow_ends_where_the_line_over_the_top_meets_the_plane(slope: float, height_m: float) -> None:
    spacing_m, at = 0.05, 240
    ground_m = (np.arange(800) + 0.5) * spacing_m
    elevation = np.tile(slope * (ground_m - 12.0), (1, 1))
    elevation[0, at] += height_m
    shadow = render_image(scene_of(elevation, column_spacing_m=spacing_m)).shadow[0]
    top_m, altitude_m = elevation[0, at], 5.0
    # Sight line from (0, H) over the top against the plane: H - (H - top) y / y_top = slope (y - 12).
    end_m = (altitude_m + 12.0 * slope) / (slope + (altitude_m - top_m) / ground_m[at])
    columns = np.flatnonzero(shadow)
    assert columns[0] == at + 1
    assert abs(ground_m[columns[-1]] - end_m) <= spacing_m
    assert len(columns) == columns[-1] - at


def test_beam_follows_the_elevation_of_the_pixel() -> None:
    raised = render_image(scene_of(np.full((1, 100), 1.0), altitude_m=6.0))
    flat = render_image(scene_of(np.zeros((1, 100)), altitude_m=5.0))
    np.testing.assert_allclose(raised.intensity, flat.intensity, rtol=1e-12)


def test_shapes_that_disagree_are_refused() -> None:
    with pytest.raises(ValueError, match="do not fit"):
        msgspec.structs.replace(scene_of(np.zeros((3, 4))), altitude_m=np.zeros(4))
