"""Learning kinds of sea floor, from made-up textures and from a short simulated mission."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from auv_mcm.errors import BadInputError
from auv_mcm.records import SEABED_TYPES, VALID
from auv_mcm.seabed.seabed_model import kind_indices, odds_of, parse_seabed_model
from auv_mcm.seabed.texture import NAMES, measure_texture
from sim_replay.fitting.seabed import samples as sampled
from sim_replay.fitting.seabed.fit_seabed import WEIGHT_RIDGE, alike, fit_model, regression, told_of
from sim_replay.fitting.seabed.haralick import haralick_features
from sim_replay.fitting.seabed.samples import COVERS, Samples, kind_of_covers, pooled, samples_of
from sim_replay.fitting.seabed.seabed_missions import KIND_OF, mission_scene
from sim_replay.simulator.scene import Lawnmower, Scene, Seabed

Array = NDArray[np.float64]


def made_up(n: int, seed: int) -> Samples:
    """Every cover somewhere else, some more often than others."""
    rng = np.random.Generator(np.random.PCG64(seed))
    middle = np.random.Generator(np.random.PCG64(0)).normal(0.0, 3.0, (len(COVERS), len(NAMES)))
    cover = rng.choice(len(COVERS), n, p=np.arange(1, len(COVERS) + 1) / sum(range(1, len(COVERS) + 1))).astype(np.uint8)
    return Samples(middle[cover] + rng.normal(size=(n, len(NAMES))), rng.uniform(0.5, 15.0, n), cover)


def test_kinds_that_differ_are_told_apart() -> None:
    model = fit_model(made_up(3000, 1), "made up")
    held_out = made_up(1000, 2)
    odds = odds_of(held_out.features, held_out.cot_grazing, model)
    assert (kind_indices(model)[np.argmax(odds.log_p, axis=-1)] == kind_of_covers()[held_out.cover]).mean() > 0.97
    assert (odds.nearest > model.novelty).mean() < 0.02
    far = odds_of(held_out.features + 100.0, held_out.cot_grazing, model)
    assert (far.nearest > model.novelty).all()


def test_a_model_survives_its_file_and_the_same_samples_make_the_same_bytes() -> None:
    first, again = (msgspec.json.encode(fit_model(made_up(1500, 3), "made up")) for _ in range(2))
    assert first == again
    assert msgspec.json.encode(parse_seabed_model(first, "m.json")) == first


def test_a_cover_that_is_missing_is_told() -> None:
    some = made_up(1500, 4)
    kept = some.cover != COVERS.index("gravel")
    with pytest.raises(BadInputError, match="gravel"):
        fit_model(Samples(*(part[kept] for part in some)), "made up")


def test_rare_kinds_weigh_as_much_as_others_but_for_how_many_covers_they_have() -> None:
    cover = np.array([0] * 90 + [1] * 5 + [2] * 5, dtype=np.uint8)
    kind = np.array([0, 0, 1])[cover]
    weight = alike(cover, kind)
    assert weight[kind == 0].sum() == pytest.approx(math.sqrt(2.0) * weight[kind == 1].sum())
    assert weight[cover == 0].sum() == pytest.approx(weight[cover == 1].sum())
    assert weight.mean() == pytest.approx(1.0)


def test_the_regression_is_where_its_slope_is_nothing() -> None:
    rng = np.random.Generator(np.random.PCG64(5))
    inputs = np.column_stack([np.ones(400), rng.normal(size=(400, 2))])
    kind = (inputs[:, 1] + 0.5 * rng.normal(size=400) > 0.0).astype(np.intp)
    weights = regression(inputs, kind, np.ones(400))
    p = 1.0 / (1.0 + np.exp(-(inputs @ (weights[:, 1] - weights[:, 0]))))
    assert inputs.T @ (p - kind) / 400 + 2.0 * WEIGHT_RIDGE * np.array([0.0, 1.0, 1.0]) * weights[:, 1] == pytest.approx(
        np.zeros(3), abs=1e-4
    )


def test_scenes_differ_by_seed_and_hold_every_kind() -> None:
    assert mission_scene(1) == mission_scene(1)
    assert mission_scene(1) != mission_scene(2)
    counts = [mission_scene(seed).sonar.recorder.seabed_counts or 0.0 for seed in range(40)]
    assert set(counts[::2]) == {3000.0}  # every second recorder is as usual, and the rest clip less
    assert 150.0 <= min(counts[1::2]) < 400.0 < 1500.0 < max(counts[1::2]) < 3000.0
    assert {KIND_OF[seabed.type] for seabed in mission_scene(7).world.seabeds} == set(SEABED_TYPES) - {"unknown"}


def small_scene(seed: int) -> Scene:
    """Sand alone, seen for half a minute."""
    scene = mission_scene(seed)
    world = msgspec.structs.replace(scene.world, seabeds=(Seabed(type="sand"),))
    track = msgspec.structs.replace(scene.track, plan=Lawnmower(n_legs=1, leg_m=45.0, spacing_m=50.0))
    sonar = msgspec.structs.replace(scene.sonar, range_m=25.0, n_samples=500, ping_rate_hz=8.0)
    return msgspec.structs.replace(scene, world=world, track=track, sonar=sonar, scatter=())


def test_cells_of_a_mission_are_what_the_simulator_put_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sampled, "mission_scene", small_scene)
    told = samples_of(11)
    assert len(told.cover) > 20
    assert set(told.cover.tolist()) == {COVERS.index("sand")}
    assert np.isfinite(told.features).all()
    assert told_of([11], pooled([told])).startswith("simulated missions of seeds 11 to 11: 0 mud, ")


def test_haralicks_features_are_of_the_same_cells(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sampled, "mission_scene", small_scene)
    tile = sampled.true_tiles(11)[0].tile
    features, texture = haralick_features(tile), measure_texture(tile)
    assert features.shape[:2] == texture.features.shape[:2]
    both = np.isfinite(features).all(axis=-1) == np.isfinite(texture.features).all(axis=-1)
    assert both.mean() > 0.95


def test_haralicks_features_of_a_constant_floor(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sampled, "mission_scene", small_scene)
    tile = sampled.true_tiles(11)[0].tile
    level = msgspec.structs.replace(tile, intensity=np.ones_like(tile.intensity), mask=np.full_like(tile.mask, VALID))
    inner = haralick_features(level)[1:-1, 1:-1].reshape(-1, 4)
    assert inner == pytest.approx(np.tile([0.0, 0.0, 0.0, 1.0], (len(inner), 1)))
