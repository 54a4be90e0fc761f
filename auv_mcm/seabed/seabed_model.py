"""Weigh textures into probabilities of kinds of sea floor.

A small network (C. M. Bishop, "Pattern Recognition and Machine Learning", 2006, Ch. 5) weighs textures and the grazing
angle, which changes textures as well. Beside it stands the Gaussian of all textures that were learnt: what lies far
outside it is `unknown`.
"""

from __future__ import annotations

import functools
from importlib import resources
from typing import Annotated, Final, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from auv_mcm.errors import BadInputError
from auv_mcm.model_file import read_model
from auv_mcm.records import SEABED_TYPES, SeabedType
from auv_mcm.seabed.texture import NAMES
from auv_mcm.settings.config import Config

Array = NDArray[np.float64]

INPUTS: Final = (*NAMES, "log_cot_grazing")

_Number = Annotated[float, Meta(ge=-1e9, le=1e9)]
_Row = tuple[_Number, ...]
_STEEPEST: Final = 0.2  # cotangent; logarithms start here
_FARTHEST: Final = 3.0  # standard deviations; what lies farther out is weighed as if it lay there


class Layer(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Hold what each unit adds up: a row of weights per unit, one for each input, and a constant."""

    weights: tuple[_Row, ...]
    constants: _Row


class Gaussian(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Describe where the textures that were learnt lie.

    Mean of the inputs, and the lower triangular matrix L that makes them white, in rows of rising length: L (x - mean).
    novelty: the squared length of that beyond which a texture is unlike any that was learnt.
    """

    mean: _Row
    whitening: tuple[_Row, ...]
    novelty: Annotated[float, Meta(gt=0.0, le=1e6)]


class SeabedModel(msgspec.Struct, frozen=True, cache_hash=True, kw_only=True, forbid_unknown_fields=True):
    """Describe the textures of each kind of sea floor.

    fitted_on: the missions. inputs: names of what is weighed, in order: textures, and the natural logarithm of the
    cotangent of the grazing angle; centre and scale make them comparable. layers: units of all but the last are tanh of
    their sums; the last one has a sum per kind, the log-odds up to what is the same for all.
    """

    fitted_on: str
    inputs: tuple[str, ...]
    kinds: tuple[SeabedType, ...]
    centre: _Row
    scale: tuple[Annotated[float, Meta(gt=0.0, le=1e9)], ...]
    layers: tuple[Layer, ...]
    learnt: Gaussian

    def __post_init__(self) -> None:
        n = len(INPUTS)
        if self.inputs != INPUTS:
            raise ValueError(f"fitted on {', '.join(self.inputs)}, but these are measured: {', '.join(INPUTS)}")
        if len(self.centre) != n or len(self.scale) != n or not self.kinds:
            raise ValueError(f"needs a centre and a scale for each of {n} inputs, and at least one kind")
        n_units = [n, *(len(layer.constants) for layer in self.layers)]
        if len(n_units) < 2 or n_units[-1] != len(self.kinds):
            raise ValueError(f"layers: needs one or more, the last with a unit for each of {len(self.kinds)} kinds")
        for number, (layer, before, after) in enumerate(zip(self.layers, n_units[:-1], n_units[1:], strict=True)):
            if not after or len(layer.weights) != after or any(len(row) != before for row in layer.weights):
                raise ValueError(f"layers[{number}]: needs a row of {before} weights for each of its units")
        shaped = [len(row) for row in self.learnt.whitening] == list(range(1, n + 1))
        if len(self.learnt.mean) != n or not shaped or any(row[-1] <= 0.0 for row in self.learnt.whitening):
            raise ValueError(f"learnt: needs a mean of {n} and a lower triangular matrix with a positive diagonal")


class Odds(NamedTuple):
    """Hold the odds of kinds.

    log_p (..., n_kinds): logarithm of the probability of each kind, in the model's order, all equally likely
    beforehand; distance (...): squared, in standard deviations, from the middle of what was learnt. Undefined where a
    feature is NaN.
    """

    log_p: Array
    distance: Array


def seabed_odds(features: Array, cot_grazing: Array, model: SeabedModel) -> Odds:
    """Weigh features (..., len(NAMES)) seen at grazing angles of these cotangents (...)."""
    arrays = _arrays(model)
    x = standardised(features, cot_grazing, arrays.centre, arrays.scale)
    units = bounded(x)
    for weights, constants in arrays.layers[:-1]:
        units = np.tanh(units @ weights.T + constants)
    weights, constants = arrays.layers[-1]
    log_p = units @ weights.T + constants
    log_p -= log_p.max(axis=-1, keepdims=True)
    log_p -= np.log(np.exp(log_p).sum(axis=-1, keepdims=True))
    white = (x - arrays.mean) @ arrays.whitening.T
    return Odds(log_p, np.sum(white * white, axis=-1))


class _Arrays(NamedTuple):
    """Hold a model's numbers as float64 arrays: weights and constants of each layer, the others as in the model."""

    centre: Array
    scale: Array
    layers: tuple[tuple[Array, Array], ...]
    mean: Array
    whitening: Array


@functools.lru_cache(maxsize=8)
def _arrays(model: SeabedModel) -> _Arrays:
    return _Arrays(
        np.array(model.centre),
        np.array(model.scale),
        tuple((np.array(layer.weights), np.array(layer.constants)) for layer in model.layers),
        np.array(model.learnt.mean),
        _square(model.learnt.whitening),
    )


def standardised(features: Array, cot_grazing: Array, centre: Array, scale: Array) -> Array:
    """Centre and scale the inputs (..., len(INPUTS))."""
    logarithm = np.log(np.maximum(cot_grazing, _STEEPEST))
    return np.asarray((np.concatenate([features, logarithm[..., np.newaxis]], axis=-1) - centre) / scale)


def bounded(x: Array) -> Array:
    """Bound far inputs."""
    return np.clip(x, -_FARTHEST, _FARTHEST)


def fitted_gaussian(x: Array, shrinkage: float, ridge: float, kept: float) -> Gaussian:
    """Fit the Gaussian of standardised inputs (n_samples, len(INPUTS)).

    The covariance is drawn towards its own diagonal by `shrinkage` (0 to 1), and `ridge` times its mean variance is
    added. kept: share of the samples within the novelty. Raises ValueError for fewer samples than inputs.
    """
    if x.shape[0] <= x.shape[1]:
        raise ValueError(f"{x.shape[0]} samples for {x.shape[1]} inputs: give more missions")
    mean = x.mean(axis=0)
    covariance = np.cov(x.T)
    covariance = (1.0 - shrinkage) * covariance + shrinkage * np.diag(np.diag(covariance))
    covariance += ridge * np.trace(covariance) / len(mean) * np.eye(len(mean))
    whitening = np.linalg.inv(np.linalg.cholesky(covariance))
    white = (x - mean) @ whitening.T
    novelty = float(np.quantile(np.sum(white * white, axis=1), kept))
    return Gaussian(
        mean=as_stored(mean),
        whitening=tuple(as_stored(whitening[row, : row + 1]) for row in range(len(mean))),
        novelty=float(f"{novelty:.2g}"),
    )


def as_stored(values: Array) -> tuple[float, ...]:
    """Round to five digits, which is enough to distinguish floors."""
    return tuple(float(f"{value:.5g}") for value in values)


def parse_seabed_model(data: bytes, place: str) -> SeabedModel:
    """Read a model from JSON. Raises BadInputError naming `place` and what is wrong with it."""
    try:
        return msgspec.json.decode(data, type=SeabedModel)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise BadInputError(f"{place}: {error}. Write the file again with 'auv-mcm calibrate seabed'") from error


def configured_seabed_model(config: Config) -> SeabedModel:
    """Read the model that `detect.seabed_model` names.

    Raises BadInputError for a file that cannot be read or is not a model.
    """
    return read_model("detect.seabed_model", config.detect.seabed_model, parse_seabed_model, shipped_seabed_model)


def shipped_seabed_model() -> SeabedModel:
    """Read the model that ships with the package."""
    return parse_seabed_model(
        resources.files("auv_mcm.seabed").joinpath("model.json").read_bytes(), "seabed/model.json"
    )


def kind_indices(model: SeabedModel) -> NDArray[np.uint8]:
    """Look the model's kinds up in SEABED_TYPES, (n_kinds,)."""
    return np.array([SEABED_TYPES.index(kind) for kind in model.kinds], dtype=np.uint8)


def _square(rows: tuple[_Row, ...]) -> Array:
    matrix = np.zeros((len(rows), len(rows)))
    for row, values in enumerate(rows):
        matrix[row, : row + 1] = values
    return matrix
