"""From a tile to kinds of sea floor, with a model made for the purpose."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from auv_mcm.errors import BadInputError
from auv_mcm.records import SEABED_TYPES, SeabedType
from auv_mcm.seabed.seabed_cells import seabed_cells, smoothed
from auv_mcm.seabed.seabed_model import (
    INPUTS,
    Gaussian,
    Layer,
    SeabedModel,
    as_stored,
    fitted_gaussian,
    parse_seabed_model,
    seabed_odds,
    standardised,
)
from auv_mcm.seabed.texture import NAMES, measure_texture
from tests.auv_mcm.seabed.seabed_tiles import rippled, speckled, tile_of

Array = NDArray[np.float64]
SHAPE = (400, 500)


def textures(name: SeabedType, seed: int) -> Array:
    """(n, len(NAMES)) of the cells within one made-up tile."""
    rng = np.random.Generator(np.random.PCG64(seed))
    intensity = rippled(rng, SHAPE, 0.9, 0.3 * seed) if name == "ripple" else speckled(rng, SHAPE)
    if name == "rough":
        intensity = intensity * np.exp(np.kron(rng.normal(0.0, 0.9, (50, 50)), np.ones((8, 10))))
    inner = measure_texture(tile_of(intensity)).features[1:-2, 1:-1]
    return inner.reshape(-1, len(NAMES))


def cot_grazing(n: int) -> Array:
    """Of grazing angles of made-up cells; they change nothing in these floors."""
    return np.random.Generator(np.random.PCG64(9)).uniform(0.3, 12.0, n)


@pytest.fixture(scope="module")
def model() -> SeabedModel:
    """The nearest of three made-up floors, by a distance that is a sum of squares."""
    names: tuple[SeabedType, ...] = ("flat", "ripple", "rough")
    zero, one = (0.0,) * len(INPUTS), (1.0,) * len(INPUTS)
    floors = {name: np.concatenate([textures(name, seed) for seed in range(4)]) for name in names}
    floors = {name: standardised(z, cot_grazing(len(z)), np.array(zero), np.array(one)) for name, z in floors.items()}
    centre, scale = (f(np.concatenate(list(floors.values())), axis=0) for f in (np.mean, np.std))
    scale = np.maximum(scale, 1.0)
    floors = {name: (z - centre) / scale for name, z in floors.items()}
    variance = 0.05
    means = [np.clip(z.mean(axis=0), -2.0, 2.0) for z in floors.values()]
    layer = Layer(
        weights=tuple(as_stored(mean / variance) for mean in means),
        constants=as_stored(np.array([-0.5 * float(mean @ mean) / variance for mean in means])),
    )
    known = fitted_gaussian(np.concatenate(list(floors.values())), 0.1, 1e-2, 1.0)
    return SeabedModel(
        fitted_on="made-up floors",
        inputs=INPUTS,
        kinds=names,
        centre=as_stored(centre),
        scale=as_stored(scale),
        layers=(layer,),
        learnt=msgspec.structs.replace(known, novelty=2.0 * known.novelty),
    )


@pytest.mark.parametrize("name", ["flat", "ripple", "rough"])
def test_floors_are_distinguished(model: SeabedModel, name: SeabedType) -> None:
    rng = np.random.Generator(np.random.PCG64(77))
    intensity = rippled(rng, SHAPE, 0.9, 1.0) if name == "ripple" else speckled(rng, SHAPE)
    if name == "rough":
        intensity = intensity * np.exp(np.kron(rng.normal(0.0, 0.9, (50, 50)), np.ones((8, 10))))
    cells = seabed_cells(tile_of(intensity), model)
    inner = cells.kind[1:-2, 1:-1]
    assert (inner == SEABED_TYPES.index(name)).mean() > 0.95
    assert cells.confidence[1:-2, 1:-1].mean() > 0.8


@pytest.mark.parametrize(
    ("side", "heading_deg", "expected_deg"),
    [("starboard", 0.0, 30.0), ("port", 0.0, 150.0), ("starboard", 100.0, 130.0)],
)
def test_ripples_are_described_by_the_compass(
    model: SeabedModel, side: str, heading_deg: float, expected_deg: float
) -> None:
    rng = np.random.Generator(np.random.PCG64(5))
    tile = tile_of(
        rippled(rng, SHAPE, 0.9, math.radians(30.0)),
        side="port" if side == "port" else "starboard",
        core=(100, 400),
        heading_deg=np.where(np.arange(400) < 100, heading_deg + 90.0, heading_deg),
    )
    cells = seabed_cells(tile, model)
    off = np.angle(np.exp(2j * (cells.ripple_rad[1:-2, 1:-1] - math.radians(expected_deg)))) / 2.0
    assert np.rad2deg(np.abs(off)).max() < 9.0
    assert cells.wavelength_m[1:-2, 1:-1] == pytest.approx(0.9, rel=0.15)


def test_unevenness_is_the_deviation_of_mean_echoes_from_cell_to_cell(model: SeabedModel) -> None:
    """Counted one by one, over seven cells each way, in decibels, glints left out; next to none by speckle alone."""
    rng = np.random.Generator(np.random.PCG64(12))
    shape, cell = (480, 960), (16, 32)  # pixels of a tile, and of a cell of 1.92 m
    uneven = np.exp(np.kron(rng.normal(0.0, 0.8, (30, 30)), np.ones(cell))) * speckled(rng, shape)
    found = seabed_cells(tile_of(uneven), model).unevenness_db
    echo_db = 10.0 * np.log10(uneven.reshape(30, cell[0], 30, cell[1]).mean(axis=(1, 3)))
    for along, across in ((5, 7), (15, 15), (20, 24)):
        around = echo_db[along - 3 : along + 4, across - 3 : across + 4]
        assert found[along, across] == pytest.approx(around.std(), rel=0.01)
    assert seabed_cells(tile_of(speckled(rng, shape)), model).unevenness_db[3:-3, 3:-3].max() < 0.4


def test_what_is_like_nothing_known_is_unknown(model: SeabedModel) -> None:
    rng = np.random.Generator(np.random.PCG64(6))
    checkered = np.kron(np.indices((50, 50)).sum(axis=0) % 2 * 1.9 + 0.05, np.ones((8, 10))) * (
        0.9 + 0.2 * rng.uniform(size=SHAPE)
    )
    cells = seabed_cells(tile_of(checkered), model)
    assert set(cells.kind[1:-2, 1:-1].ravel().tolist()) == {SEABED_TYPES.index("unknown")}
    assert np.isnan(cells.ripple_rad).all()


def test_where_nothing_was_measured_nothing_is_claimed(model: SeabedModel) -> None:
    cells = seabed_cells(tile_of(np.ones(SHAPE), np.zeros(SHAPE, dtype=np.uint8)), model)
    assert set(cells.kind.ravel().tolist()) == {SEABED_TYPES.index("unknown")}
    assert not cells.confidence.any()
    assert np.isnan(cells.unevenness_db).all()


def test_neighbours_settle_what_a_cell_leaves_open_and_no_more() -> None:
    log_p = np.zeros((5, 5, 2))
    log_p[..., 0] = 2.0
    log_p[2, 2] = (0.0, 0.3)
    measured = np.ones((5, 5), dtype=np.bool_)
    assert smoothed(log_p, measured)[2, 2, 0] > 0.8
    log_p[2, 2] = (0.0, 12.0)  # more than eight neighbours and 2 nats can say
    assert smoothed(log_p, measured)[2, 2, 1] > 0.95
    alone = np.zeros((5, 5), dtype=np.bool_)
    alone[2, 2] = True
    log_p[2, 2] = (0.0, 0.3)
    assert smoothed(log_p, alone)[2, 2, 1] == pytest.approx(1.0 / (1.0 + math.exp(-0.3)))


def test_distances_are_those_of_a_gaussian() -> None:
    rng = np.random.Generator(np.random.PCG64(7))
    n = len(INPUTS)
    x = rng.normal(size=(20_000, n)) @ rng.normal(size=(n, n)).T + rng.normal(size=n)
    learnt = fitted_gaussian(x, 0.0, 0.0, 0.99)
    whitening = np.zeros((n, n))
    for row, values in enumerate(learnt.whitening):
        whitening[row, : row + 1] = values
    away = x[:50] - x.mean(axis=0)
    expected = np.einsum("ai,ij,aj->a", away, np.linalg.inv(np.cov(x.T)), away)
    assert np.sum((away @ whitening.T) ** 2, axis=1) == pytest.approx(expected, rel=0.05)
    assert (np.sum(((x - x.mean(axis=0)) @ whitening.T) ** 2, axis=1) < learnt.novelty).mean() > 0.99


def test_layers_are_weighed_one_after_the_other() -> None:
    n = len(INPUTS)
    rng = np.random.Generator(np.random.PCG64(8))
    first, second = rng.normal(0.0, 0.2, (5, n)), rng.normal(0.0, 1.0, (2, 5))
    model = SeabedModel(
        fitted_on="nothing",
        inputs=INPUTS,
        kinds=("flat", "rough"),
        centre=(0.0,) * n,
        scale=(1.0,) * n,
        layers=(
            Layer(weights=tuple(map(tuple, first.tolist())), constants=(0.1,) * 5),
            Layer(weights=tuple(map(tuple, second.tolist())), constants=(0.0, 0.5)),
        ),
        learnt=Gaussian(mean=(0.0,) * n, whitening=tuple((0.0,) * row + (1.0,) for row in range(n)), novelty=10.0),
    )
    features = rng.normal(0.0, 1.0, (4, n - 1))
    features[0, 0] = 50.0  # weighed as if it lay at three standard deviations, and far from all that was learnt
    odds = seabed_odds(features, np.ones(4), model)
    x = np.clip(np.column_stack([features, np.zeros(4)]), -3.0, 3.0)
    sums = np.tanh(x @ first.T + 0.1) @ second.T + (0.0, 0.5)
    assert odds.log_p == pytest.approx(sums - np.logaddexp.reduce(sums, axis=1, keepdims=True))
    assert odds.distance[0] > 2500.0
    assert odds.distance[1:] == pytest.approx((features[1:] ** 2).sum(axis=1))


def test_a_file_that_is_no_model_is_refused_by_what_is_wrong(model: SeabedModel) -> None:
    assert parse_seabed_model(msgspec.json.encode(model), "m.json") == model
    good = msgspec.to_builtins(model)
    changes: tuple[dict[str, object], ...] = (
        {"inputs": ["x"]},
        {"kinds": []},
        {"layers": []},
        {"centre": []},
        {"more": 1},
    )
    for change in changes:
        with pytest.raises(BadInputError, match=r"m\.json.*calibrate seabed"):
            parse_seabed_model(msgspec.json.encode({**good, **change}), "m.json")
    with pytest.raises(BadInputError, match=r"m\.json"):
        parse_seabed_model(b"", "m.json")
