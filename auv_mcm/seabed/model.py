"""Kinds of sea floor by the texture that each shows: one Gaussian per kind, with a covariance of its own.

Quadratic discriminant analysis with shrunk covariances (J. H. Friedman, "Regularized discriminant analysis", JASA 84, 1989). What range
does to a texture (wider beams, longer shadows) is taken off first, as it is on a flat floor. What is far from every kind is `unknown`.
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
from auv_mcm.seabed.features import NAMES

Array = NDArray[np.float64]

_Number = Annotated[float, Meta(ge=-1e9, le=1e9)]
_NEAREST_M: Final = 1.0  # logarithms of range start here


class Kind(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One kind: mean of its features, and the lower triangular matrix L that makes them white, rows of rising length: L (z - mean)."""

    name: SeabedType
    mean: tuple[_Number, ...]
    whitening: tuple[tuple[_Number, ...], ...]


class SeabedModel(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What each kind of sea floor looks like.

    fitted_on: the missions. features: their names, in order. range_coefficients: per feature of 1, x and x² with x the natural logarithm
    of the ground range in m, as on a flat floor. temper: by which log-likelihoods are divided, since windows overlap and features tell
    partly the same. novelty: squared distance in standard deviations from every kind, beyond which a texture is none of them.
    """

    fitted_on: str
    features: tuple[str, ...]
    range_coefficients: tuple[tuple[_Number, _Number, _Number], ...]
    kinds: tuple[Kind, ...]
    temper: Annotated[float, Meta(ge=0.1, le=100.0)]
    novelty: Annotated[float, Meta(gt=0.0, le=1e4)]

    def __post_init__(self) -> None:
        n = len(NAMES)
        if self.features != NAMES:
            raise ValueError(f"fitted on features {', '.join(self.features)}, but these are measured: {', '.join(NAMES)}")
        if len(self.range_coefficients) != n or not self.kinds:
            raise ValueError(f"needs three range coefficients for each of {n} features, and one kind at least")
        for kind in self.kinds:
            shaped = [len(row) for row in kind.whitening] == list(range(1, n + 1))
            if len(kind.mean) != n or not shaped or any(row[-1] <= 0.0 for row in kind.whitening):
                raise ValueError(f"kind '{kind.name}': needs a mean of {n} and a lower triangular matrix with a positive diagonal")


class Likelihood(NamedTuple):
    """log_p (..., n_kinds): tempered log-likelihood per kind, in the order of SeabedModel.kinds; nearest (...): squared distance in
    standard deviations from the nearest kind. NaN where a feature is."""

    log_p: Array
    nearest: Array


def at_no_range(features: Array, ground_range_m: Array, coefficients: Array) -> Array:
    """Features (..., n_across, n) less what range does to them; ground_range_m (n_across,), coefficients (n, 3)."""
    logarithm = np.log(np.maximum(ground_range_m, _NEAREST_M))
    powers = np.stack([np.ones_like(logarithm), logarithm, logarithm**2], axis=-1)
    return np.asarray(features - powers @ coefficients.T)


def likelihood(features: Array, ground_range_m: Array, model: SeabedModel) -> Likelihood:
    """How well each kind explains features (..., n_across, len(NAMES)) at ground ranges (n_across,)."""
    z = at_no_range(features, ground_range_m, np.array(model.range_coefficients))
    log_p, distances = [], []
    for kind in model.kinds:
        whitening = np.zeros((len(NAMES), len(NAMES)))
        for row, values in enumerate(kind.whitening):
            whitening[row, : row + 1] = values
        white = (z - np.array(kind.mean)) @ whitening.T
        distance = np.sum(white * white, axis=-1)
        distances.append(distance)
        log_p.append((float(np.sum(np.log(np.diag(whitening)))) - 0.5 * distance) / model.temper)
    return Likelihood(np.stack(log_p, axis=-1), np.min(distances, axis=0))


def fitted_kind(name: SeabedType, z: Array, shrinkage: float, ridge: float) -> Kind:
    """The Gaussian of samples (n_samples, len(NAMES)) of one kind.

    The covariance is drawn towards its own diagonal by `shrinkage` (0 to 1), and `ridge` times its mean variance is added. Raises
    ValueError for fewer samples than features.
    """
    if z.shape[0] <= z.shape[1]:
        raise ValueError(f"{z.shape[0]} samples of '{name}' for {z.shape[1]} features: give more missions with it")
    mean = z.mean(axis=0)
    covariance = np.cov(z.T)
    covariance = (1.0 - shrinkage) * covariance + shrinkage * np.diag(np.diag(covariance))
    covariance += ridge * np.trace(covariance) / len(mean) * np.eye(len(mean))
    whitening = np.linalg.inv(np.linalg.cholesky(covariance))
    rows = tuple(tuple(float(f"{value:.6g}") for value in whitening[row, : row + 1]) for row in range(len(mean)))
    return Kind(name=name, mean=tuple(float(f"{value:.6g}") for value in mean), whitening=rows)


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
    return np.array([SEABED_TYPES.index(kind.name) for kind in model.kinds], dtype=np.uint8)
