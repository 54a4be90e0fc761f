"""From a tile to kinds of sea floor, with a model made for the purpose."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray
from seabed_tiles import rippled, speckled, tile_of

from auv_mcm.errors import BadInputError
from auv_mcm.records import SEABED_TYPES, SeabedType
from auv_mcm.seabed.features import NAMES, measure_texture
from auv_mcm.seabed.model import SeabedModel, fitted_kind, likelihood, parse_seabed_model
from auv_mcm.seabed.stage import seabed_cells, smoothed

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


@pytest.fixture(scope="module")
def model() -> SeabedModel:
    names: tuple[SeabedType, ...] = ("flat", "ripple", "rough")
    kinds = tuple(fitted_kind(name, np.concatenate([textures(name, seed) for seed in range(4)]), 0.1, 1e-2) for name in names)
    zero = (0.0, 0.0, 0.0)
    return SeabedModel(
        fitted_on="made-up floors", features=NAMES, range_coefficients=(zero,) * len(NAMES), kinds=kinds, temper=2.0, novelty=200.0
    )


@pytest.mark.parametrize("name", ["flat", "ripple", "rough"])
def test_floors_are_told_apart(model: SeabedModel, name: SeabedType) -> None:
    rng = np.random.Generator(np.random.PCG64(77))
    intensity = rippled(rng, SHAPE, 0.9, 1.0) if name == "ripple" else speckled(rng, SHAPE)
    if name == "rough":
        intensity = intensity * np.exp(np.kron(rng.normal(0.0, 0.9, (50, 50)), np.ones((8, 10))))
    cells = seabed_cells(tile_of(intensity), model)
    inner = cells.kind[1:-2, 1:-1]
    assert (inner == SEABED_TYPES.index(name)).mean() > 0.95
    assert cells.confidence[1:-2, 1:-1].mean() > 0.8


@pytest.mark.parametrize(
    ("side", "heading_deg", "expected_deg"), [("starboard", 0.0, 30.0), ("port", 0.0, 150.0), ("starboard", 100.0, 130.0)]
)
def test_ripples_are_told_by_the_compass(model: SeabedModel, side: str, heading_deg: float, expected_deg: float) -> None:
    rng = np.random.Generator(np.random.PCG64(5))
    tile = tile_of(rippled(rng, SHAPE, 0.9, math.radians(30.0)), side="port" if side == "port" else "starboard", heading_deg=heading_deg)
    cells = seabed_cells(tile, model)
    off = np.angle(np.exp(2j * (cells.ripple_rad[1:-2, 1:-1] - math.radians(expected_deg)))) / 2.0
    assert np.rad2deg(np.abs(off)).max() < 9.0
    assert cells.wavelength_m[1:-2, 1:-1] == pytest.approx(0.9, rel=0.15)


def test_what_is_like_nothing_known_is_unknown(model: SeabedModel) -> None:
    rng = np.random.Generator(np.random.PCG64(6))
    checkered = np.kron(np.indices((50, 50)).sum(axis=0) % 2 * 1.9 + 0.05, np.ones((8, 10))) * (0.9 + 0.2 * rng.uniform(size=SHAPE))
    cells = seabed_cells(tile_of(checkered), model)
    assert set(cells.kind[1:-2, 1:-1].ravel().tolist()) == {SEABED_TYPES.index("unknown")}
    assert np.isnan(cells.ripple_rad).all()


def test_where_nothing_was_measured_nothing_is_claimed(model: SeabedModel) -> None:
    cells = seabed_cells(tile_of(np.ones(SHAPE), np.zeros(SHAPE, dtype=np.uint8)), model)
    assert set(cells.kind.ravel().tolist()) == {SEABED_TYPES.index("unknown")}
    assert not cells.confidence.any()


def test_neighbours_settle_what_a_cell_leaves_open_and_no_more() -> None:
    log_p = np.zeros((5, 5, 2))
    log_p[..., 0] = 2.0
    log_p[2, 2] = (0.0, 0.3)
    measured = np.ones((5, 5), dtype=np.bool_)
    assert smoothed(log_p, measured)[2, 2, 0] > 0.8
    log_p[2, 2] = (0.0, 9.0)
    assert smoothed(log_p, measured)[2, 2, 1] > 0.95
    alone = np.zeros((5, 5), dtype=np.bool_)
    alone[2, 2] = True
    log_p[2, 2] = (0.0, 0.3)
    assert smoothed(log_p, alone)[2, 2, 1] == pytest.approx(1.0 / (1.0 + math.exp(-0.3)))


def test_likelihoods_are_those_of_gaussians() -> None:
    rng = np.random.Generator(np.random.PCG64(7))
    mixing = rng.normal(size=(len(NAMES), len(NAMES)))
    samples = rng.normal(size=(50_000, len(NAMES))) @ mixing.T + rng.normal(size=len(NAMES))
    kind = fitted_kind("flat", samples, 0.0, 0.0)
    model = SeabedModel(
        fitted_on="", features=NAMES, range_coefficients=((0.0, 0.0, 0.0),) * len(NAMES), kinds=(kind,), temper=1.0, novelty=100.0
    )
    some = samples[:50].reshape(5, 10, -1)
    told = likelihood(some, np.full(10, 20.0), model)
    covariance, mean = np.cov(samples.T), samples.mean(axis=0)
    away = some - mean
    distance = np.einsum("abi,ij,abj->ab", away, np.linalg.inv(covariance), away)
    assert told.nearest == pytest.approx(distance, rel=1e-3)
    assert told.log_p[..., 0] == pytest.approx(-0.5 * (distance + np.linalg.slogdet(covariance)[1]), rel=1e-3, abs=1e-2)


def test_a_file_that_is_no_model_is_refused_by_what_is_wrong(model: SeabedModel) -> None:
    assert parse_seabed_model(msgspec.json.encode(model), "m.json") == model
    good = msgspec.to_builtins(model)
    changes: tuple[dict[str, object], ...] = ({"features": ["x"]}, {"temper": 0.0}, {"kinds": []}, {"range_coefficients": []}, {"more": 1})
    for change in changes:
        with pytest.raises(BadInputError, match=r"m\.json.*calibrate seabed"):
            parse_seabed_model(msgspec.json.encode({**good, **change}), "m.json")
    with pytest.raises(BadInputError, match=r"m\.json"):
        parse_seabed_model(b"", "m.json")
