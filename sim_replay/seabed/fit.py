"""Fits the model of sea floors to textures of pure cells."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.errors import BadInputError
from auv_mcm.records import SEABED_TYPES
from auv_mcm.seabed.features import NAMES
from auv_mcm.seabed.model import SeabedModel, at_no_range, fitted_kind, kind_indices, likelihood
from sim_replay.seabed.samples import Samples

FIT_SEEDS: Final = range(800, 816)
VALIDATE_SEEDS: Final = range(816, 820)

_FLAT: Final = SEABED_TYPES.index("flat")
_UNKNOWN: Final = SEABED_TYPES.index("unknown")
_SHRINKAGE: Final = 0.05
_RIDGE: Final = 1e-3
_TEMPERS: Final = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0)
_KEPT: Final = 0.999  # of the textures that it was fitted on are not novel


def fit_model(fit: Samples, validate: Samples, fitted_on: str) -> SeabedModel:
    """The model of `fit`, with the temper under which `validate` is least surprised.

    Raises BadInputError if a kind, or enough of it, is missing.
    """
    coefficients = range_curves(fit)
    z = at_no_range(fit.features, fit.ground_range_m, coefficients)
    kinds = []
    for index, name in enumerate(SEABED_TYPES):
        if index == _UNKNOWN:
            continue
        try:
            kinds.append(fitted_kind(name, z[fit.kind == index], _SHRINKAGE, _RIDGE))
        except ValueError as error:
            raise BadInputError(str(error)) from error
    rough = SeabedModel(
        fitted_on=fitted_on,
        features=NAMES,
        range_coefficients=tuple((float(a), float(b), float(c)) for a, b, c in coefficients),
        kinds=tuple(kinds),
        temper=1.0,
        novelty=1e4,
    )
    nearest = likelihood(fit.features, fit.ground_range_m, rough).nearest
    novelty = float(f"{np.quantile(nearest, _KEPT):.4g}")
    tempered = [msgspec.structs.replace(rough, temper=temper, novelty=novelty) for temper in _TEMPERS]
    return min(tempered, key=lambda model: surprise(model, validate))


def range_curves(samples: Samples) -> NDArray[np.float64]:
    """(n, 3) coefficients per feature, by least squares on the flat samples; rounded as they are stored."""
    flat = samples.kind == _FLAT
    if np.count_nonzero(flat) < 100:
        raise BadInputError("fewer than 100 samples of flat floor: give more missions with it")
    logarithm = np.log(np.maximum(samples.ground_range_m[flat], 1.0))
    powers = np.stack([np.ones_like(logarithm), logarithm, logarithm**2], axis=-1)
    solved = np.linalg.lstsq(powers, samples.features[flat], rcond=None)[0].T
    return np.array([[float(f"{value:.6g}") for value in row] for row in solved])


def surprise(model: SeabedModel, samples: Samples) -> float:
    """Mean of -ln of the probability given to the truth, all kinds weighed alike."""
    log_p = likelihood(samples.features, samples.ground_range_m, model).log_p
    log_p = log_p - np.logaddexp.reduce(log_p, axis=-1, keepdims=True)
    indices = kind_indices(model)
    losses = [-log_p[samples.kind == index, column].mean() for column, index in enumerate(indices) if (samples.kind == index).any()]
    return float(np.mean(losses))


def told_of(seeds: Sequence[int], samples: Samples) -> str:
    counts = ", ".join(f"{np.count_nonzero(samples.kind == index)} {name}" for index, name in enumerate(SEABED_TYPES) if index != _UNKNOWN)
    return f"simulated missions of seeds {seeds[0]} to {seeds[-1]}: {counts} cells"
