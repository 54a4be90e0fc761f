"""Kinds of sea floor by the texture that each shows.

Odds of the kinds are a logistic regression on textures, their products, and the grazing angle, which changes textures as well (D. R. Cox,
J. Royal Statistical Society B 20, 1958; with all products it has the borders of Gaussians with covariances of their own, without asking for
Gaussians). Beside it each cover that was learnt has its mean and covariance: what is far from all of them is `unknown`.
"""

from __future__ import annotations

from importlib import resources
from typing import Annotated, Final, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from auv_mcm.errors import BadInputError
from auv_mcm.records import SEABED_TYPES, SeabedType
from auv_mcm.seabed.texture import NAMES

Array = NDArray[np.float64]

INPUTS: Final = (*NAMES, "log_cot_grazing")
N_TERMS: Final = 1 + len(INPUTS) + len(INPUTS) * (len(INPUTS) + 1) // 2

_Number = Annotated[float, Meta(ge=-1e9, le=1e9)]
_STEEPEST: Final = 0.2  # cotangent; logarithms start here
_FARTHEST: Final = 2.0  # standard deviations; beyond, products would outweigh all else


class Kind(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The log-odds of one kind, up to what is the same for all: a weight for each of `terms`."""

    kind: SeabedType
    weights: tuple[_Number, ...]


class Cover(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What one cover of the sea floor, such as gravel, shows: mean of its inputs, and the lower triangular matrix L that makes them white,
    rows of rising length: L (x - mean)."""

    name: str
    mean: tuple[_Number, ...]
    whitening: tuple[tuple[_Number, ...], ...]


class SeabedModel(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What each kind of sea floor looks like.

    fitted_on: the missions. inputs: names of what is weighed, in order: textures, and the natural logarithm of the cotangent of the grazing
    angle; centre and scale make them comparable. novelty: squared distance in standard deviations from every cover, beyond which a texture
    is none of them.
    """

    fitted_on: str
    inputs: tuple[str, ...]
    centre: tuple[_Number, ...]
    scale: tuple[Annotated[float, Meta(gt=0.0, le=1e9)], ...]
    kinds: tuple[Kind, ...]
    covers: tuple[Cover, ...]
    novelty: Annotated[float, Meta(gt=0.0, le=1e6)]

    def __post_init__(self) -> None:
        n = len(INPUTS)
        if self.inputs != INPUTS:
            raise ValueError(f"fitted on {', '.join(self.inputs)}, but these are measured: {', '.join(INPUTS)}")
        if len(self.centre) != n or len(self.scale) != n or not self.kinds or not self.covers:
            raise ValueError(f"needs a centre and a scale for each of {n} inputs, and one kind and one cover at least")
        for kind in self.kinds:
            if len(kind.weights) != N_TERMS:
                raise ValueError(f"kind '{kind.kind}': needs {N_TERMS} weights")
        for cover in self.covers:
            shaped = [len(row) for row in cover.whitening] == list(range(1, n + 1))
            if len(cover.mean) != n or not shaped or any(row[-1] <= 0.0 for row in cover.whitening):
                raise ValueError(f"cover '{cover.name}': needs a mean of {n} and a lower triangular matrix with a positive diagonal")


class Odds(NamedTuple):
    """log_p (..., n_kinds): logarithm of the probability of each kind, in the model's order, all as likely beforehand; nearest (...):
    squared distance in standard deviations from the nearest cover. Without meaning where a feature is NaN."""

    log_p: Array
    nearest: Array


def odds_of(features: Array, cot_grazing: Array, model: SeabedModel) -> Odds:
    """What each kind has for it; features (..., len(NAMES)), cot_grazing of the same shape without the last axis."""
    x = standardised(features, cot_grazing, np.array(model.centre), np.array(model.scale))
    distances = [np.sum(((x - np.array(cover.mean)) @ _square(cover.whitening).T) ** 2, axis=-1) for cover in model.covers]
    log_p = terms(x) @ np.array([kind.weights for kind in model.kinds]).T
    log_p -= log_p.max(axis=-1, keepdims=True)
    log_p -= np.log(np.exp(log_p).sum(axis=-1, keepdims=True))
    return Odds(log_p, np.min(distances, axis=0))


def standardised(features: Array, cot_grazing: Array, centre: Array, scale: Array) -> Array:
    """(..., len(INPUTS)) inputs, centred and scaled."""
    logarithm = np.log(np.maximum(cot_grazing, _STEEPEST))
    return np.asarray((np.concatenate([features, logarithm[..., np.newaxis]], axis=-1) - centre) / scale)


def terms(x: Array) -> Array:
    """(..., N_TERMS) of inputs (..., len(INPUTS)): 1, the inputs, and all products of two of them; far inputs are drawn in."""
    near = np.clip(x, -_FARTHEST, _FARTHEST)
    first, second = np.triu_indices(len(INPUTS))
    return np.concatenate([np.ones((*near.shape[:-1], 1)), near, near[..., first] * near[..., second]], axis=-1)


def fitted_cover(name: str, x: Array, shrinkage: float, ridge: float) -> Cover:
    """The Gaussian of standardised inputs (n_samples, len(INPUTS)) of one cover.

    The covariance is drawn towards its own diagonal by `shrinkage` (0 to 1), and `ridge` times its mean variance is added. Raises
    ValueError for fewer samples than inputs.
    """
    if x.shape[0] <= x.shape[1]:
        raise ValueError(f"{x.shape[0]} samples of '{name}' for {x.shape[1]} inputs: give more missions with it")
    mean = x.mean(axis=0)
    covariance = np.cov(x.T)
    covariance = (1.0 - shrinkage) * covariance + shrinkage * np.diag(np.diag(covariance))
    covariance += ridge * np.trace(covariance) / len(mean) * np.eye(len(mean))
    whitening = np.linalg.inv(np.linalg.cholesky(covariance))
    return Cover(name=name, mean=as_stored(mean), whitening=tuple(as_stored(whitening[row, : row + 1]) for row in range(len(mean))))


def as_stored(values: Array) -> tuple[float, ...]:
    """Six digits: what a file for people needs and floors differ by."""
    return tuple(float(f"{value:.6g}") for value in values)


def parse_seabed_model(data: bytes, place: str) -> SeabedModel:
    """A model from JSON. Raises BadInputError naming `place` and what is wrong with it."""
    try:
        return msgspec.json.decode(data, type=SeabedModel)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise BadInputError(f"{place}: {error}. Make the file anew with 'auv-mcm calibrate seabed'") from error


def shipped_seabed_model() -> SeabedModel:
    """The model that ships with the package."""
    return parse_seabed_model(resources.files("auv_mcm.seabed").joinpath("model.json").read_bytes(), "seabed/model.json")


def kind_indices(model: SeabedModel) -> NDArray[np.uint8]:
    """(n_kinds,) index into SEABED_TYPES of each kind."""
    return np.array([SEABED_TYPES.index(kind.kind) for kind in model.kinds], dtype=np.uint8)


def _square(rows: tuple[tuple[float, ...], ...]) -> Array:
    matrix = np.zeros((len(rows), len(rows)))
    for row, values in enumerate(rows):
        matrix[row, : row + 1] = values
    return matrix
