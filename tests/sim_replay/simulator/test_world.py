from __future__ import annotations

import math
from typing import get_args

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from sim_replay.simulator import scene
from sim_replay.simulator.fields import generator
from sim_replay.simulator.scene import Ripples, Seabed, SeabedType
from sim_replay.simulator.seabeds import USUAL, cover_of
from sim_replay.simulator.stones import AZIMUTH, EAST, HEIGHT, LENGTH, NORTH, WIDTH, Stones
from sim_replay.simulator.world import NODES, PATCH, Patches, SimulatedFloor

TYPES: tuple[SeabedType, ...] = get_args(SeabedType)
BARE = Seabed(type="sand", relief_rms_m=0.0, texture_shape=0.0, stones_per_ha=0.0)
MOTLEY = scene.World(
    seabeds=tuple(
        Seabed(type=kind) for kind in ("gravel", "rippled_sand", "rock_outcrop", "boulder_field", "seagrass")
    ),
    patch_m=8.0,
    slope_deg=2.0,
    slope_towards_deg=60.0,
    sand_waves=Ripples(wavelength_m=9.0, height_m=0.3, direction_deg=110.0),
)


@pytest.fixture(scope="module")
def motley() -> SimulatedFloor:
    return SimulatedFloor(MOTLEY, 5)


def whole(n_rows: int, n_columns: int) -> NDArray[np.bool_]:
    return np.ones((n_rows, n_columns), dtype=np.bool_)


def joined(patches: Patches, layer: NDArray[np.generic]) -> NDArray[np.float64]:
    """A layer over all patches, which must all be there; without the nodes that belong to the next patch too."""
    return np.block([[layer[slot, :PATCH, :PATCH] for slot in row] for row in patches.slots]).astype(np.float64)


def one_kind(seabed: Seabed, size: int = 3, relief_rms_m: float = 0.0) -> Patches:
    return SimulatedFloor(scene.World(seabeds=(seabed,), relief_rms_m=relief_rms_m), 7).patches(whole(size, size), 0, 0)


@pytest.mark.parametrize("cell_m", [0.05, 0.02, 0.3])
def test_neighbours_agree_on_shared_nodes_to_the_last_bit(cell_m: float) -> None:
    size = 4
    world = SimulatedFloor(msgspec.structs.replace(MOTLEY, cell_m=cell_m), 3)
    patches = world.patches(whole(size, size), -2, -1)
    for layer in (patches.elevation, patches.texture, patches.seabed):
        for row, column in np.ndindex(size, size):
            patch = layer[patches.slots[row, column]]
            if column + 1 < size:
                np.testing.assert_array_equal(patch[:, -1], layer[patches.slots[row, column + 1]][:, 0])
            if row + 1 < size:
                np.testing.assert_array_equal(patch[-1], layer[patches.slots[row + 1, column]][0])
    assert len(np.unique(patches.seabed[patches.slots.ravel()])) >= 4


def test_patches_are_the_same_bytes_in_any_order_and_after_being_forgotten(motley: SimulatedFloor) -> None:
    size = 4
    at_once = motley.patches(whole(size, size), -2, 40)
    one_by_one = SimulatedFloor(MOTLEY, 5, max_patches=2)
    for place in generator(1, "order").permutation(size * size).tolist():
        row, column = divmod(place, size)
        single = one_by_one.patches(whole(1, 1), -2 + row, 40 + column)
        slot, other = int(single.slots[0, 0]), int(at_once.slots[row, column])
        assert single.elevation[slot].tobytes() == at_once.elevation[other].tobytes()
        assert single.texture[slot].tobytes() == at_once.texture[other].tobytes()
        assert single.seabed[slot].tobytes() == at_once.seabed[other].tobytes()


def test_another_seed_makes_another_floor() -> None:
    world = scene.World(seabeds=(Seabed(type="sand", texture_shape=2.0), Seabed(type="gravel")), patch_m=6.0)
    first, second = (SimulatedFloor(world, seed).patches(whole(1, 1), 0, 0) for seed in (1, 2))
    assert abs(np.corrcoef(first.elevation[0].ravel(), second.elevation[0].ravel())[0, 1]) < 0.7
    assert not np.array_equal(first.seabed[0], second.seabed[0])
    assert not np.allclose(first.texture[0], second.texture[0])


def test_patches_not_asked_for_have_no_slot() -> None:
    needed = np.array([[True, False, True], [False, True, False]])
    patches = SimulatedFloor(scene.World(), 1).patches(needed, -1, 4)
    np.testing.assert_array_equal(patches.slots >= 0, needed)
    assert len(set(patches.slots[needed].tolist())) == 3
    assert (patches.first_patch_row, patches.first_patch_column) == (-1, 4)


def test_pool_forgets_what_was_used_longest_ago_and_stays_as_small_as_asked() -> None:
    world = SimulatedFloor(scene.World(seabeds=(BARE,)), 1, max_patches=3)
    for column in (0, 1, 2):
        world.patches(whole(1, 1), 0, column)
    kept = world.patches(whole(1, 1), 0, 0).slots[0, 0]
    taken = world.patches(whole(1, 1), 0, 3).slots[0, 0]
    assert taken != kept
    assert world.patches(whole(1, 1), 0, 0).slots[0, 0] == kept
    assert world.patches(whole(1, 3), 5, 5).elevation.shape == (3, NODES, NODES)


def test_request_larger_than_the_pool_makes_it_grow() -> None:
    small, large = (SimulatedFloor(scene.World(), 2, max_patches=n) for n in (2, 6))
    small.patches(whole(1, 2), 0, 0)
    patches, expected = small.patches(whole(2, 3), 0, 0), large.patches(whole(2, 3), 0, 0)
    np.testing.assert_array_equal(joined(patches, patches.elevation), joined(expected, expected.elevation))


def test_full_pool_takes_less_than_300_mb(motley: SimulatedFloor) -> None:
    patches = motley.patches(whole(1, 1), 0, 0)
    assert patches.elevation.nbytes + patches.texture.nbytes + patches.seabed.nbytes < 300e6


@settings(max_examples=15, deadline=None)
@given(st.floats(0.0, 10.0), st.floats(-180.0, 360.0), st.integers(-100, 100), st.integers(-100, 100))
def test_slope_is_exact(slope_deg: float, towards_deg: float, patch_row: int, patch_column: int) -> None:
    world = SimulatedFloor(
        scene.World(seabeds=(BARE,), relief_rms_m=0.0, slope_deg=slope_deg, slope_towards_deg=towards_deg),
        1,
        max_patches=1,
    )
    north = (patch_row * PATCH + np.arange(NODES))[:, None] * 0.05
    east = (patch_column * PATCH + np.arange(NODES)) * 0.05
    towards = math.radians(towards_deg)
    expected = math.tan(math.radians(slope_deg)) * (north * math.cos(towards) + east * math.sin(towards))
    np.testing.assert_allclose(world.patches(whole(1, 1), patch_row, patch_column).elevation[0], expected, atol=1e-4)


def test_forms_have_the_relief_asked() -> None:
    patches = SimulatedFloor(scene.World(seabeds=(BARE,), relief_rms_m=0.2, cell_m=0.2), 7).patches(whole(4, 4), 0, 0)
    assert np.sqrt(np.mean(joined(patches, patches.elevation) ** 2)) == pytest.approx(0.2, rel=0.2)


def test_relief_of_a_kind_is_what_is_asked() -> None:
    for rms_m in (0.005, 0.03):
        patches = one_kind(Seabed(type="gravel", relief_rms_m=rms_m, stones_per_ha=0.0))
        assert joined(patches, patches.elevation).std() == pytest.approx(rms_m, rel=0.1)


def test_bare_floor_is_a_plane_of_even_brightness() -> None:
    patches = one_kind(BARE, size=1)
    assert not patches.elevation[0].any()
    assert np.all(patches.texture[0] == 1.0)


@pytest.mark.parametrize(("shape", "length_m"), [(1.2, 0.3), (4.0, 0.8), (20.0, 0.1)])
def test_texture_is_gamma_distributed_about_1(shape: float, length_m: float) -> None:
    patches = one_kind(Seabed(type="sand", texture_shape=shape, texture_m=length_m, stones_per_ha=0.0), size=4)
    texture = joined(patches, patches.texture)
    assert texture.mean() == pytest.approx(1.0, rel=0.03)
    assert texture.var() == pytest.approx(1.0 / shape, rel=0.12)


@pytest.mark.parametrize(("wavelength_m", "direction_deg"), [(0.4, 35.0), (0.8, -60.0), (1.3, 90.0)])
def test_ripples_have_wavelength_and_direction(wavelength_m: float, direction_deg: float) -> None:
    ripples = Ripples(wavelength_m=wavelength_m, height_m=0.1 * wavelength_m, direction_deg=direction_deg)
    patches = one_kind(Seabed(type="rippled_sand", ripples=ripples, relief_rms_m=0.0, stones_per_ha=0.0))
    power = np.abs(np.fft.rfft2(joined(patches, patches.elevation))) ** 2
    north, east = np.fft.fftfreq(3 * PATCH, 0.05)[:, None], np.fft.rfftfreq(3 * PATCH, 0.05)[None, :]
    # A real wave has two mirrored peaks; the half plane shows one of them.
    bearing = np.degrees(np.arctan2(east, north))
    turned = np.abs((bearing - direction_deg + 90.0) % 180.0 - 90.0)
    near = power * (np.hypot(north, east) > 0.5 / wavelength_m) * (np.hypot(north, east) < 1.5 / wavelength_m)
    assert np.sum(near * np.hypot(north, east)) / np.sum(near) == pytest.approx(1.0 / wavelength_m, rel=0.06)
    assert np.sum(near * turned) / np.sum(near) < 10.0
    assert np.sum(near) > 0.7 * np.sum(power)


def test_ripples_without_defects_have_straight_crests_of_the_height_asked_and_a_steep_lee() -> None:
    ripples = Ripples(wavelength_m=0.8, height_m=0.1, direction_deg=0.0, defects=0.0, skew=0.8)
    patches = one_kind(Seabed(type="rippled_sand", ripples=ripples, relief_rms_m=0.0, stones_per_ha=0.0), size=1)
    height = patches.elevation[0].astype(np.float64)
    assert np.ptp(height) == pytest.approx(0.1, rel=0.01)
    assert np.ptp(height, axis=1).max() < 1e-6
    slope = np.diff(height[:, 0])
    assert -slope.min() > 1.5 * slope.max()


def test_defects_break_crests() -> None:
    def coherence(defects: float) -> float:
        """Of crests with themselves two and a half wavelengths along them."""
        ripples = Ripples(wavelength_m=0.8, height_m=0.1, direction_deg=0.0, defects=defects)
        patches = one_kind(Seabed(type="rippled_sand", ripples=ripples, relief_rms_m=0.0, stones_per_ha=0.0))
        height = joined(patches, patches.elevation)
        return float(np.corrcoef(height[:, :-40].ravel(), height[:, 40:].ravel())[0, 1])

    assert coherence(0.0) > 0.999
    assert coherence(0.0) > coherence(0.3) + 0.1
    assert coherence(0.3) > coherence(1.0) + 0.2


def test_sand_waves_are_under_all_kinds() -> None:
    waves = Ripples(wavelength_m=6.4, height_m=0.5, direction_deg=0.0, defects=0.0, skew=0.0)
    world = scene.World(seabeds=(BARE, BARE), relief_rms_m=0.0, sand_waves=waves)
    north = np.arange(0.0, 12.0, 0.05)
    np.testing.assert_allclose(
        SimulatedFloor(world, 1).elevation_m(3.0, north), -0.25 * np.sin(2.0 * np.pi * north / 6.4), atol=1e-4
    )


def test_kinds_take_the_shares_asked_of_a_large_area() -> None:
    shares = (0.6, 0.3, 0.1)
    seabeds = tuple(
        Seabed(type="sand", share=share, relief_rms_m=0.0, texture_shape=0.0, stones_per_ha=0.0) for share in shares
    )
    world = SimulatedFloor(scene.World(seabeds=seabeds, patch_m=5.0, relief_rms_m=0.0, cell_m=0.2), 2, max_patches=64)
    patches = world.patches(whole(8, 8), -4, -4)
    found = np.bincount(patches.seabed[patches.slots.ravel()].ravel(), minlength=3) / (64 * NODES**2)
    np.testing.assert_allclose(found, shares, atol=0.05)


def test_kinds_change_over_about_the_patch_size() -> None:
    def patch_m(asked_m: float) -> float:
        """Mean length of a straight way through one kind, islets left out."""
        world = SimulatedFloor(scene.World(seabeds=(BARE, BARE), patch_m=asked_m, relief_rms_m=0.0, cell_m=0.5), 2)
        patches = world.patches(whole(4, 4), 0, 0)
        kind = joined(patches, patches.seabed)
        way = kind[:, ::4]
        return float(kind.shape[0] * 0.5 * way.shape[1] / (np.abs(np.diff(way, axis=0)).sum() + way.shape[1]))

    small, large = patch_m(20.0), patch_m(80.0)
    assert 0.3 * 20.0 < small < 20.0
    assert 2.5 * small < large < 80.0


def test_heights_blend_where_kinds_meet() -> None:
    seabeds = BARE, Seabed(type="seagrass", texture_shape=0.0)
    patches = SimulatedFloor(scene.World(seabeds=seabeds, patch_m=10.0, relief_rms_m=0.0), 4).patches(whole(3, 3), 0, 0)
    height, kind = joined(patches, patches.elevation), joined(patches, patches.seabed)
    slope = np.abs(np.diff(height, axis=0)) / 0.05
    across = np.diff(kind, axis=0) != 0.0
    assert 0.0 < slope[across].max() < 1.5
    assert height[kind == 1].mean() > height[kind == 0].mean() + 0.1


def test_single_kind_beside_others_looks_as_it_does_alone() -> None:
    seabeds = Seabed(type="rock_outcrop"), Seabed(type="sand")
    mixed = SimulatedFloor(scene.World(seabeds=seabeds, patch_m=60.0), 1)
    alone = SimulatedFloor(scene.World(seabeds=seabeds[:1]), 1)
    places = np.argwhere(np.ones((12, 12), dtype=np.bool_)).tolist()
    for row, column in places:
        patches = mixed.patches(whole(1, 1), row, column)
        slot = patches.slots[0, 0]
        if not patches.seabed[slot].any() and np.array_equal(
            patches.elevation[slot], (other := alone.patches(whole(1, 1), row, column)).elevation[other.slots[0, 0]]
        ):
            return
    pytest.fail("no patch of rock alone")


def test_elevation_at_places_is_bilinear_between_nodes(motley: SimulatedFloor) -> None:
    patches = motley.patches(whole(2, 2), -1, -1)
    height = joined(patches, patches.elevation)
    random = generator(1, "places")
    row, column = random.uniform(0.0, 2 * PATCH - 1.0, (2, 5, 40))
    i, j = np.floor(row).astype(int), np.floor(column).astype(int)
    down, right = row - i, column - j
    expected = (
        (1 - down) * (1 - right) * height[i, j]
        + (1 - down) * right * height[i, j + 1]
        + down * (1 - right) * height[i + 1, j]
        + down * right * height[i + 1, j + 1]
    )
    found = motley.elevation_m((column - PATCH) * 0.05, (row - PATCH) * 0.05)
    np.testing.assert_allclose(found, expected, atol=1e-6)
    assert found.dtype == np.float64


def test_kind_at_places_is_that_of_the_nearest_node(motley: SimulatedFloor) -> None:
    patches = motley.patches(whole(2, 2), -1, -1)
    kind = joined(patches, patches.seabed)
    row, column = generator(2, "places").uniform(0.0, 2 * PATCH - 1.6, (2, 300))
    found = motley.seabed_at((column - PATCH) * 0.05, (row - PATCH) * 0.05)
    np.testing.assert_array_equal(found, kind[np.rint(row).astype(int), np.rint(column).astype(int)])
    assert found.dtype == np.uint8


def test_single_places_give_single_values() -> None:
    assert SimulatedFloor(scene.World(), 1).elevation_m(-1234.5, 17.0).shape == ()


def stones_within(seabed: Seabed, seed: int, area_m: tuple[float, float, float, float]) -> NDArray[np.float64]:
    """Of a floor of one kind. area_m: from east to east, from north to north."""
    return Stones([cover_of(seabed)], seed).within(*area_m, lambda east, _: np.zeros(east.shape, dtype=np.uint8))


def test_stones_have_the_density_and_the_size_law_asked() -> None:
    seabed = Seabed(type="boulder_field", stones_per_ha=2000.0, stone_m=0.3)
    stones = stones_within(seabed, 3, (-100.0, 100.0, -50.0, 100.0))
    assert len(stones) == pytest.approx(6000, rel=0.05)
    for longer_m in (0.45, 0.6, 1.0):
        expected = (longer_m / 0.3) ** -2.5
        assert np.mean(stones[:, LENGTH] > longer_m) == pytest.approx(expected, abs=0.012)
    assert stones[:, LENGTH].min() >= 0.3
    assert np.all(stones[:, WIDTH] < stones[:, LENGTH])
    assert np.all((stones[:, HEIGHT] > 0.2 * stones[:, WIDTH]) & (stones[:, HEIGHT] < stones[:, WIDTH]))
    assert np.all((stones[:, AZIMUTH] >= 0.0) & (stones[:, AZIMUTH] < 2.0 * np.pi))


def test_stones_of_an_area_are_those_of_its_parts() -> None:
    seabed = Seabed(type="gravel")
    whole_area = stones_within(seabed, 5, (-30.0, 30.0, -17.0, 30.0))
    parts = [
        stones_within(seabed, 5, (east, east + 15.0, north, north + 23.5))
        for north in (-17.0, 6.5)
        for east in (-30.0, -15.0, 0.0, 15.0)
    ]
    assert len(whole_area) > 20
    np.testing.assert_array_equal(np.unique(whole_area, axis=0), np.unique(np.concatenate(parts), axis=0))
    assert np.all((whole_area[:, EAST] >= -30.0) & (whole_area[:, EAST] < 30.0) & (whole_area[:, NORTH] < 30.0))


def test_stones_lie_on_kinds_that_have_them() -> None:
    stony = Seabed(type="boulder_field", relief_rms_m=0.0, stones_per_ha=3000.0)
    world = SimulatedFloor(scene.World(seabeds=(BARE, stony), patch_m=10.0, relief_rms_m=0.0), 3)
    patches = world.patches(whole(3, 3), 0, 0)
    height, kind = joined(patches, patches.elevation), joined(patches, patches.seabed)
    assert 0.3 < np.mean(kind) < 0.7
    assert np.count_nonzero(height) > 1000
    assert np.mean(kind[height > 0.0]) > 0.9


def test_stones_rise_from_the_floor_and_echo_more() -> None:
    seabed = Seabed(type="sand", relief_rms_m=0.0, texture_shape=0.0, stones_per_ha=60.0, stone_m=0.8)
    world = SimulatedFloor(scene.World(seabeds=(seabed,), relief_rms_m=0.0), 11)
    stones = stones_within(seabed, 11, (1.0, 49.0, 1.0, 49.0))
    patches = world.patches(whole(4, 4), 0, 0)
    height, texture = joined(patches, patches.elevation), joined(patches, patches.texture)
    assert len(stones) > 5
    for stone in stones:
        top = height[round(stone[NORTH] / 0.05), round(stone[EAST] / 0.05)]
        assert top >= 0.95 * stone[HEIGHT]
    assert np.all(texture[height > 0.0] > 2.0)
    assert np.all(texture[height == 0.0] == 1.0)
    # Half-ellipsoids' footprints, but where they overlap: pi / 4 * length * width each.
    footprint = np.sum(math.pi / 4.0 * stones[:, LENGTH] * stones[:, WIDTH])
    assert np.sum(height[20:980, 20:980] > 0.0) * 0.05**2 == pytest.approx(footprint, rel=0.2)


@pytest.mark.parametrize("kind", TYPES)
def test_every_type_has_a_usual_cover_that_a_scene_may_override(kind: SeabedType) -> None:
    assert cover_of(Seabed(type=kind)) == USUAL[kind]
    changed = cover_of(Seabed(type=kind, texture_shape=0.0, stones_per_ha=5.0, level_db=-3.0))
    assert (changed.texture_shape, changed.stones_per_ha, changed.level_db) == (0.0, 5.0, -3.0)
    assert changed.sediment == USUAL[kind].sediment


def test_the_height_of_one_place_is_that_of_many() -> None:
    world = SimulatedFloor(scene.World(relief_rms_m=0.3, slope_deg=2.0), 4)
    places = np.random.default_rng(1).uniform(-40.0, 40.0, (2, 200))
    assert [world.floor_m(east, north) for east, north in places.T] == pytest.approx(
        world.elevation_m(*places), abs=1e-9
    )
