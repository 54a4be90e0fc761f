"""Tests of the missions that the verifier is trained on, and of what is kept of them."""

from pathlib import Path

import numpy as np
import pytest

from auv_mcm.classify.verifier import CLASSES
from auv_mcm.errors import BadInputError
from auv_mcm.geometry.geodesy import LocalFrame
from sim_replay.fitting.verifier.mill import (
    BESIDE,
    DENSE,
    FIRST_PATCHES,
    FIRST_SEED,
    FIRST_SHELLY,
    FIRST_SLABS,
    FLOOR,
    GEOMETRY,
    MINE,
    OTHER,
    Catch,
    drawn_scene,
    labels_of,
    read_catch,
)
from sim_replay.fitting.verifier.weigh import chips_of, regions_of
from sim_replay.fitting.wide_world import wide_scene
from sim_replay.simulator.objects import place_objects
from tests.sim_replay.report_samples import detection

FRAME = LocalFrame(latitude_deg=43.0, longitude_deg=5.9)


def at(east_m: float, north_m: float) -> dict[str, float]:
    latitude, longitude, _ = FRAME.to_geodetic([east_m, north_m, 0.0])
    return {"lat": float(latitude), "lon": float(longitude)}


def caught(n: int = 5) -> Catch:
    random = np.random.default_rng(4)
    shapes = np.array([(67, 150 + k) for k in range(n)], dtype=np.int32)
    geometry = np.array([(0.12, 0.06, 10.0 + k, 5.0, 33.5, 50.5, 0.007, 0.0) for k in range(n)])
    return Catch(
        codes=random.integers(0, 256, size=int(shapes.prod(axis=1).sum())).astype(np.uint8),
        shapes=shapes,
        geometry=geometry,
        label=np.array([MINE, OTHER, FLOOR, BESIDE, FLOOR], dtype=np.int8)[:n],
        kind=np.array(["sphere", "rock", "", "rock", ""])[:n],
        nearest=np.arange(n, dtype=np.int32),
        passage=np.zeros(n, dtype=np.int64),
        distance_m=np.zeros(n, dtype=np.float32),
        names=np.array(["range"]),
        features=np.zeros((n, 1)),
        n_targets=np.array(1),
        area_km2=np.array(0.01),
        law=np.array("amplitude_uint16"),
    )


def written(folder: Path) -> Path:
    place = folder / "one.npz"
    np.savez(place, **caught()._asdict())
    return place


def test_a_dense_mission_has_more_mines_and_stones_and_is_the_same_again() -> None:
    scene = drawn_scene(FIRST_SEED, DENSE)
    usual, dense = (place_objects(one) for one in (wide_scene(FIRST_SEED), scene))
    assert sum(one.is_target for one in dense) > 3 * sum(one.is_target for one in usual)
    assert drawn_scene(FIRST_SEED, DENSE) == scene
    assert drawn_scene(FIRST_SEED, 1).scatter == wide_scene(FIRST_SEED).scatter


def test_every_second_later_mission_has_beds_of_shells() -> None:
    shelly = [any(each.kind == "point" for each in drawn_scene(FIRST_SHELLY + k, 1).scatter) for k in range(40)]
    assert 10 <= sum(shelly) <= 30


def test_the_latest_missions_have_slabs_and_more_clutter() -> None:
    kinds = [{one.kind for one in drawn_scene(first, 1).scatter} for first in (FIRST_SLABS - 1, FIRST_SLABS)]
    assert "slab" not in kinds[0]
    assert {"slab", "rock"} <= kinds[1]
    usual, more = (
        sum(one.count for one in scene.scatter if one.kind in ("debris", "tyre", "pipe", "boulder_cluster"))
        for scene in (wide_scene(FIRST_SLABS), drawn_scene(FIRST_SLABS, 1))
    )
    assert more == 4 * usual > 0


def test_missions_with_patches_have_them_once_and_crowd_mines_all_the_same() -> None:
    patches = [
        [one for one in place_objects(drawn_scene(FIRST_PATCHES + 3, times)) if 0.0 < one.height_m < 0.03]
        for times in (1, DENSE)
    ]
    assert [len(each) for each in patches] == [100, 100]
    assert sum(one.is_target for one in place_objects(drawn_scene(FIRST_PATCHES + 3, DENSE))) > 100


def test_detections_are_what_lies_under_them() -> None:
    objects = [
        {**at(0.0, 0.0), "length_m": 2.0, "width_m": 0.5, "is_target": True},
        {**at(10.0, 0.0), "length_m": 1.0, "width_m": 1.0, "is_target": False},
    ]
    places = {(1.9, 0.0): MINE, (2.1, 0.0): BESIDE, (10.0, 1.4): OTHER, (10.0, 3.2): BESIDE, (0.0, 30.0): FLOOR}
    found = []
    for place in places:
        where = at(*place)
        found.append(detection(latitude_deg=where["lat"], longitude_deg=where["lon"]))
    label, nearest, distance_m = labels_of(found, objects)
    assert label.tolist() == list(places.values())
    assert nearest.tolist() == [0, 0, 1, 1, 0]
    np.testing.assert_allclose(distance_m, [1.9, 2.1, 1.4, 3.2, 30.0], atol=1e-3)
    assert labels_of(found, [])[0].tolist() == [FLOOR] * len(places)
    assert len(labels_of([], objects)[0]) == 0


def test_the_sea_floor_comes_back_as_it_was_seen(tmp_path: Path) -> None:
    kept = read_catch(written(tmp_path))
    regions = regions_of(kept)
    assert [list(region.intensity.shape) for region in regions] == kept.shapes.tolist()
    for region, values in zip(regions, kept.geometry.tolist(), strict=True):
        known = dict(zip(GEOMETRY, values, strict=True))
        assert region.altitude_m == known["first_return_m"]
        assert (region.row, region.column) == (known["row"], known["column"])
    first = kept.codes[: 67 * 150].reshape(67, 150)
    assert np.array_equal(regions[0].valid, first > 0)


def test_looks_beside_objects_and_every_second_of_the_floor_are_not_learnt_from(tmp_path: Path) -> None:
    classes = [CLASSES[k] for k in chips_of([written(tmp_path)]).label]
    assert classes == ["sphere", "other object", "floor"]


@pytest.mark.parametrize("damage", ["cut", "empty", "text"])
def test_a_damaged_mission_is_refused(tmp_path: Path, damage: str) -> None:
    place = written(tmp_path)
    data = place.read_bytes()
    place.write_bytes({"cut": data[: len(data) // 2], "empty": b"", "text": b"no archive"}[damage])
    with pytest.raises(BadInputError, match=r"one\.npz holds no catch"):
        read_catch(place)
