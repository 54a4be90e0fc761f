"""Embedded objects against the closed forms of shadows, and against what hides them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from auv_mcm.records import SIDES, Side
from auv_mcm.solids.shapes import Box, Cylinder, Shape, Sphere, TruncatedCone, Wedge, view_shape
from sim_replay.augment.embed_render import REFERENCE_NORTH_M, Echoes, PingWindow, Relief, echoes
from sim_replay.augment.floor import BeamPattern
from sim_replay.augment.track import SIGN
from sim_replay.simulator.objects import USUAL, PlacedObject
from sim_replay.simulator.scene import ObjectKind

HEIGHT_M = 5.0
SPACING_M = 0.03
PIXEL_M = 0.06
FARTHEST_M = 30.0
ALONG_M = np.arange(-1.5, 1.51, 0.1)
EVEN = BeamPattern(depression_rad=np.array([0.0, 1.5]), gain=np.array([1.0, 1.0]))

Floats = NDArray[np.float64]


def view(side: Side = "starboard") -> PingWindow:
    return PingWindow(
        side=side,
        along_m=ALONG_M,
        turn_rad=np.zeros(len(ALONG_M)),
        height_m=np.full(len(ALONG_M), HEIGHT_M),
        first_edge_m=0.0,
        spacing_m=SPACING_M,
        n_samples=1000,
        beam_width_deg=0.02,
        beam=EVEN,
    )


def relief(elevation: Floats | None = None, column_spacing_m: float = 0.05) -> Relief:
    """A floor whose height over ground range is the same for all pings; level if left out."""
    profile = np.zeros(round(FARTHEST_M / column_spacing_m)) if elevation is None else elevation
    shape = (len(ALONG_M), len(profile))
    return Relief(np.broadcast_to(profile, shape).copy(), np.ones(shape), ALONG_M, 0, column_spacing_m)


def scene_object(
    kind: ObjectKind, ground_m: float, side: Side = "starboard", azimuth_rad: float = 0.0, burial_m: float = 0.0
) -> PlacedObject:
    usual = USUAL[kind]
    return PlacedObject(
        kind=kind,
        east_m=SIGN[side] * ground_m,
        north_m=REFERENCE_NORTH_M,
        azimuth_rad=azimuth_rad,
        tilt_rad=0.0,
        length_m=usual.length_m,
        width_m=usual.width_m,
        height_m=usual.height_m,
        top_m=usual.top_m,
        burial_m=burial_m,
        scour_m=0.0,
        above_m=0.0,
        n_members=1,
        strength_db=0.0,
        specular_db=0.0,
        is_target=True,
        seed=1,
    )


def shadow_ends_m(heard: Echoes) -> Floats:
    """Ground range on a flat floor at which each ping's shadow ends, NaN where it has none."""
    edges = np.arange(heard.bare.shape[1] + 1) * SPACING_M
    ends = np.full(len(heard.bare), np.nan)
    for row, (bare, floor) in enumerate(zip(heard.bare, heard.floor, strict=True)):
        lost = np.flatnonzero((bare > 0.0) & (floor < 0.999 * bare))
        if lost.size:
            last = lost[-1]
            slant_m = edges[last] + SPACING_M * (1.0 - floor[last] / bare[last])
            ends[row] = math.sqrt(slant_m**2 - HEIGHT_M**2)
    return ends


def solids(azimuth_rad: float, burial_m: float) -> list[tuple[ObjectKind, Shape]]:
    usual = USUAL
    cylinder, sphere, cone, wedge, box = (
        usual[kind] for kind in ("cylinder", "sphere", "truncated_cone", "wedge", "box")
    )
    pose = {"azimuth_rad": azimuth_rad, "burial_m": burial_m}
    return [
        ("cylinder", Cylinder(radius_m=0.5 * cylinder.width_m, length_m=cylinder.length_m, **pose)),
        ("sphere", Sphere(radius_m=0.5 * sphere.width_m, burial_m=burial_m)),
        (
            "truncated_cone",
            TruncatedCone(
                base_radius_m=0.5 * cone.width_m,
                top_radius_m=0.5 * cone.top_m,
                height_m=cone.height_m,
                burial_m=burial_m,
            ),
        ),
        ("wedge", Wedge(length_m=wedge.length_m, width_m=wedge.width_m, height_m=wedge.height_m, **pose)),
        ("box", Box(length_m=box.length_m, width_m=box.width_m, height_m=box.height_m, **pose)),
    ]


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize(
    ("azimuth_rad", "burial_m", "ground_m"), [(0.0, 0.0, 12.0), (0.7, 0.1, 18.0), (2.4, 0.05, 8.0)]
)
def test_shadow_ends_where_the_closed_form_says_on_a_plane(
    side: Side, azimuth_rad: float, burial_m: float, ground_m: float
) -> None:
    for kind, shape in solids(azimuth_rad * SIGN[side], burial_m):
        placed = scene_object(kind, ground_m, side, azimuth_rad, burial_m)
        found = shadow_ends_m(echoes(view(side), relief(), placed, relief(), FARTHEST_M))
        expected = view_shape(shape, ALONG_M, ground_m, HEIGHT_M).shadow_end_m
        inside = np.isfinite(expected) & np.isfinite(found)
        inside[1:-1] &= inside[:-2] & inside[2:]  # the outermost ping may graze the object
        assert np.count_nonzero(inside) >= 5
        assert np.abs(found - expected)[inside].max() < PIXEL_M, kind


@pytest.mark.parametrize("slope", [-0.06, 0.06, 0.12])
def test_shadow_follows_the_slope_that_it_falls_on(slope: float) -> None:
    floor = relief(np.asarray(slope * (np.arange(600) + 0.5) * 0.05, dtype=np.float64))
    heard = echoes(view(), floor, scene_object("box", 10.0), floor, FARTHEST_M)
    row = len(ALONG_M) // 2
    # Along the slope the box's upper far edge casts the end; the floor there is slope times the ground range.
    usual = USUAL["box"]
    base_m = slope * 10.0
    edge_m, top_m = 10.0 + 0.5 * usual.width_m, base_m + usual.height_m
    per_metre = (HEIGHT_M - top_m) / edge_m
    end_m = HEIGHT_M / (per_metre + slope)
    edges = np.arange(heard.bare.shape[1] + 1) * SPACING_M
    lost = np.flatnonzero((heard.bare[row] > 0.0) & (heard.floor[row] < 0.999 * heard.bare[row]))
    expected_slant_m = math.hypot(end_m, HEIGHT_M - slope * end_m)
    assert edges[lost[-1]] - SPACING_M <= expected_slant_m <= edges[lost[-1] + 1] + SPACING_M


def test_an_object_behind_a_ridge_is_not_seen() -> None:
    ground_m = (np.arange(600) + 0.5) * 0.05
    ridge = relief(1.5 * np.exp(-(((ground_m - 11.0) / 0.5) ** 2)))
    heard = echoes(view(), ridge, scene_object("truncated_cone", 13.0), ridge, FARTHEST_M)
    assert not heard.target.any()
    assert np.array_equal(heard.floor, heard.bare)
    assert heard.in_full_view.sum() > 0.0


def test_what_rises_above_the_line_of_sight_over_a_ridge_is_seen() -> None:
    ground_m = (np.arange(600) + 0.5) * 0.05
    ridge = relief(1.0 * np.exp(-(((ground_m - 11.0) / 0.5) ** 2)))
    heard = echoes(view(), ridge, scene_object("cylinder", 13.0)._replace(width_m=1.0, height_m=1.0), ridge, FARTHEST_M)
    assert 0.0 < heard.target.sum() < 0.95 * heard.in_full_view.sum()


def test_the_floor_hides_without_echoing_where_its_reflectivity_is_zero() -> None:
    dark = relief()
    dark.reflectivity[:, 200:260] = 0.0
    heard = echoes(view(), dark, scene_object("box", 20.0), dark, FARTHEST_M)
    slant = (np.arange(1000) + 0.5) * SPACING_M
    assert not heard.bare[:, (slant > math.hypot(10.2, HEIGHT_M)) & (slant < math.hypot(12.8, HEIGHT_M))].any()


def test_a_scour_moat_shades_the_floor_beyond_the_object() -> None:
    level = relief()
    plain = echoes(view(), level, scene_object("sphere", 12.0), level, FARTHEST_M)
    scoured = echoes(view(), level, scene_object("sphere", 12.0)._replace(scour_m=0.08), level, FARTHEST_M)
    near = slice(round(math.hypot(11.0, HEIGHT_M) / SPACING_M), round(math.hypot(11.4, HEIGHT_M) / SPACING_M))
    row = len(ALONG_M) // 2
    assert np.allclose(plain.floor[row, near], plain.bare[row, near])
    assert not np.allclose(scoured.floor[row, near], scoured.bare[row, near], rtol=0.05)
