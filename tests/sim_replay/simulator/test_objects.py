"""Objects of a scene: where they come to lie and what bodies stand for them."""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from auv_mcm.errors import UsageError
from sim_replay.simulator.bodies import body_tops, pack
from sim_replay.simulator.objects import USUAL, PlacedObject, bodies_of, hull_planes, place_objects, points_of, rise_m
from sim_replay.simulator.plan import planned_legs
from sim_replay.simulator.scene import Lawnmower, ObjectKind, Scatter, Scene, SceneObject, Track

TRACK = Track(plan=Lawnmower(heading_deg=20.0, n_legs=2, leg_m=200.0, spacing_m=60.0))
KINDS: list[ObjectKind] = list(USUAL)


def named(**keys: object) -> PlacedObject:
    scene_object = SceneObject(east_m=30.0, north_m=40.0, **keys)  # type: ignore[arg-type]  # keys of one test each
    return place_objects(Scene(track=TRACK, objects=(scene_object,)))[0]


def highest_m(scene_object: PlacedObject) -> float:
    """Of its bodies over a fine grid around it."""
    bodies = pack(bodies_of(scene_object, lambda east, north: 0.0, 0))
    reach = scene_object.reach_m + 1.0
    grid = np.linspace(-reach, reach, 401)
    top = 0.0
    for row in bodies.table:
        east, north = (
            axis.ravel()
            for axis in np.meshgrid(scene_object.east_m + grid - row[1], scene_object.north_m + grid - row[2])
        )
        u, v = east * row[4] + north * row[5], east * row[5] - north * row[4]
        heights, _, _, covered = body_tops(row, bodies.planes, u, v)
        top = max(top, float(heights[covered].max(initial=0.0)) + float(row[6]))
    return top


@pytest.mark.parametrize(
    "kind", ["cylinder", "sphere", "truncated_cone", "wedge", "box", "rock", "slab", "tyre", "pipe"]
)
@pytest.mark.parametrize("burial_m", [0.0, 0.1])
def test_an_object_has_its_given_height_less_its_burial(kind: ObjectKind, burial_m: float) -> None:
    scene_object = named(kind=kind, burial_m=burial_m)
    assert highest_m(scene_object) == pytest.approx(scene_object.height_m - burial_m, abs=0.02)


def test_a_tilted_cylinder_rests_on_its_lower_end() -> None:
    scene_object = named(kind="cylinder", tilt_deg=30.0)
    raised = 2.0 * math.sin(math.radians(30.0)) + 0.53 * math.cos(math.radians(30.0))
    assert highest_m(scene_object) == pytest.approx(raised, abs=0.03)
    assert highest_m(named(kind="cylinder", tilt_deg=-30.0)) == pytest.approx(raised, abs=0.03)


@pytest.mark.parametrize("tilt_deg", [-20.0, 0.0, 12.0])
@pytest.mark.parametrize("kind", ["cylinder", "truncated_cone", "wedge", "box", "rock", "slab", "pipe"])
def test_an_object_rises_as_far_as_stated_however_it_is_tilted(kind: ObjectKind, tilt_deg: float) -> None:
    scene_object = named(kind=kind, tilt_deg=tilt_deg, burial_m=0.05)
    assert highest_m(scene_object) == pytest.approx(rise_m(scene_object), abs=0.03)


def test_a_tilted_cone_raises_the_end_towards_its_azimuth() -> None:
    (body,) = bodies_of(named(kind="truncated_cone", tilt_deg=10.0), lambda east, north: 0.0, 0)
    packed, tilt = pack([body]), math.radians(10.0)
    aft, fore = body_tops(packed.table[0], packed.planes, np.array([-0.15, 0.15]), np.zeros(2))[0]
    assert fore - aft == pytest.approx(0.3 * math.tan(tilt), rel=1e-6)
    assert 0.5 * (fore + aft) == pytest.approx(0.49 * math.sin(tilt) + 0.47 / math.cos(tilt), rel=0.01)


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_echoes_by_bodies_or_by_points(kind: ObjectKind) -> None:
    scene_object = named(kind=kind)
    bodies, points = (
        bodies_of(scene_object, lambda east, north: 0.0, 3),
        points_of(scene_object, lambda east, north: 0.0),
    )
    assert bool(bodies) != bool(points)
    assert all(body.material == 3 for body in bodies)
    assert all(
        math.hypot(body.east_m - 30.0, body.north_m - 40.0)
        <= 0.5 * math.hypot(scene_object.length_m, scene_object.width_m)
        for body in bodies
    )


def test_a_slab_reaches_its_sizes_with_four_or_five_sides_and_a_plane_top() -> None:
    n_sides = set()
    for seed in range(20):
        slab = named(kind="slab", length_m=1.6, width_m=0.9, height_m=0.3)._replace(seed=seed)
        (body,) = bodies_of(slab, lambda east, north: 0.0, 0)
        n_sides.add(body.n_sides)
        u, v = (part.ravel() for part in np.meshgrid(np.linspace(-0.9, 0.9, 181), np.linspace(-0.6, 0.6, 121)))
        packed = pack([body])
        top, _, _, covered = body_tops(packed.table[0], packed.planes, u, v)
        assert np.abs(u[covered]).max() == pytest.approx(0.8, abs=0.02)
        assert np.abs(v[covered]).max() == pytest.approx(0.45, abs=0.02)
        assert top[covered].max() == pytest.approx(0.3, abs=0.01)
    assert n_sides == {4, 5}


def test_only_mine_shapes_are_targets_by_default() -> None:
    targets = {kind for kind in KINDS if named(kind=kind).is_target}
    assert targets == {"cylinder", "sphere", "truncated_cone", "wedge", "box"}
    assert named(kind="rock", is_target=True).is_target
    assert not named(kind="sphere", is_target=False).is_target


def test_sizes_that_a_kind_does_not_have_apart_follow_the_others() -> None:
    assert named(kind="sphere", width_m=0.6).height_m == 0.6
    assert named(kind="cylinder", width_m=0.4).height_m == 0.4
    assert named(kind="truncated_cone", width_m=1.2).length_m == 1.2
    assert named(kind="truncated_cone", width_m=0.49).top_m == pytest.approx(0.25)


@given(st.integers(0, 10_000))
def test_hull_planes_bound_exactly_the_hull(seed: int) -> None:
    random = np.random.default_rng(seed)
    corners = random.normal(size=(12, 3))
    planes, n_sides = hull_planes(corners)
    sides, tops = np.array(planes[:n_sides]), np.array(planes[n_sides:])
    hull = ConvexHull(corners)
    for u, v in random.normal(size=(40, 2)):
        below = (sides[:, 0] * u + sides[:, 1] * v <= sides[:, 2]).all()
        top = (tops[:, 0] * u + tops[:, 1] * v + tops[:, 2]).min()
        # The hull above (u, v): the highest z that satisfies all of its inequalities, if any does.
        a, b, c, d = hull.equations.T
        rest = -(a * u + b * v + d)
        upper, lower = (rest[c > 1e-9] / c[c > 1e-9]).min(), (rest[c < -1e-9] / c[c < -1e-9]).max()
        inside = upper >= lower
        assert inside == below or abs(upper - lower) < 1e-6
        if inside and below:
            assert top == pytest.approx(upper, abs=1e-9)


def scattered(*groups: Scatter, seed: int = 1) -> tuple[PlacedObject, ...]:
    return place_objects(Scene(track=TRACK, seed=seed, scatter=groups))


def test_scattered_objects_lie_apart_and_within_the_ranges_asked_for() -> None:
    group = Scatter(
        kind="rock", count=40, ground_range_m=(12.0, 35.0), apart_m=5.0, height_m=(0.3, 0.6), burial_m=(0.0, 0.1)
    )
    scene_objects = scattered(group, Scatter(kind="cylinder", count=10))
    assert [scene_object.kind for scene_object in scene_objects] == ["rock"] * 40 + ["cylinder"] * 10
    legs = planned_legs(TRACK.plan)
    for scene_object in scene_objects[:40]:
        nearest = min(abs(leg.along_across(scene_object.east_m, scene_object.north_m)[1]) for leg in legs)
        assert 12.0 <= nearest <= 35.0
        assert 0.3 <= scene_object.height_m <= 0.6
        assert 0.0 <= scene_object.burial_m <= 0.1
    for a, b in combinations(scene_objects, 2):
        assert math.hypot(a.east_m - b.east_m, a.north_m - b.north_m) >= 5.0 + 0.5 * math.hypot(a.length_m, a.width_m)


def test_the_same_seed_scatters_the_same_objects_and_another_seed_others() -> None:
    group = Scatter(kind="rock", count=5)
    assert scattered(group, seed=4) == scattered(group, seed=4)
    assert scattered(group, seed=4) != scattered(group, seed=5)
    shapes = {one.seed for seed in (4, 5) for one in scattered(group, group, seed=seed)}
    assert len(shapes) == 20


def test_natural_sizes_follow_the_power_law() -> None:
    group = Scatter(kind="rock", count=400, apart_m=0.0, length_m=(0.4, 4.0), natural_sizes=True)
    lengths = np.array([scene_object.length_m for scene_object in scattered(group)])
    assert lengths.min() >= 0.4
    assert lengths.max() <= 4.0
    # Of all stones longer than 0.4 m the share longer than d is (0.4 / d)^2.5, all but a 0.3 % above 4 m.
    for size in (0.6, 0.8, 1.2):
        share = (0.4 / size) ** 2.5
        assert np.mean(lengths > size) == pytest.approx(share, abs=4.0 * math.sqrt(share / 400))


def test_missing_room_is_reported_as_an_error() -> None:
    with pytest.raises(UsageError, match=r"scatter\[0\].*no room for number .* of 5000"):
        scattered(Scatter(kind="rock", count=5000, apart_m=20.0))
