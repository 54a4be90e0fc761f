"""Fits the model of sea floors to textures of pure cells."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from auv_mcm.errors import BadInputError
from auv_mcm.seabed.seabed_model import INPUTS, Kind, SeabedModel, as_stored, fitted_cover, odds_of, standardised, terms
from sim_replay.fitting.seabed.samples import COVERS, Samples
from sim_replay.fitting.seabed.seabed_missions import KIND_OF

Array = NDArray[np.float64]

FIT_SEEDS: Final = range(750, 850)

_SHRINKAGE: Final = 0.05
_RIDGE: Final = 1e-3
WEIGHT_RIDGE: Final = 3e-5
_KEPT: Final = 0.999  # of the textures that it was fitted on are not novel
_ITERATIONS: Final = 500


def fit_model(samples: Samples, fitted_on: str) -> SeabedModel:
    """The model of samples, weighed by `alike`. Raises BadInputError if a cover, or enough of it, is missing."""
    raw = standardised(samples.features, samples.cot_grazing, np.zeros(len(INPUTS)), np.ones(len(INPUTS)))
    centre, scale = as_stored(raw.mean(axis=0)), as_stored(np.maximum(raw.std(axis=0), 1e-6))
    x = standardised(samples.features, samples.cot_grazing, np.array(centre), np.array(scale))
    covers = []
    for index, name in enumerate(COVERS):
        try:
            covers.append(fitted_cover(name, x[samples.cover == index], _SHRINKAGE, _RIDGE))
        except ValueError as error:
            raise BadInputError(str(error)) from error
    names = tuple(dict.fromkeys(KIND_OF.values()))
    kind = np.array([names.index(KIND_OF[cover]) for cover in COVERS])[samples.cover]
    weights = regression(terms(x), kind, alike(samples.cover, kind))
    model = SeabedModel(
        fitted_on=fitted_on,
        inputs=INPUTS,
        centre=centre,
        scale=scale,
        kinds=tuple(Kind(kind=name, weights=as_stored(weights[:, column])) for column, name in enumerate(names)),
        covers=tuple(covers),
        novelty=1e6,
    )
    nearest = odds_of(samples.features, samples.cot_grazing, model).nearest
    return msgspec.structs.replace(model, novelty=float(f"{np.quantile(nearest, _KEPT):.4g}"))


def alike(cover: NDArray[np.uint8], kind: NDArray[np.intp]) -> Array:
    """Weights under which all covers of a kind count the same, and a kind by the square root of how many covers it has, since it is the
    likelier to be met in one that nothing was learnt of; 1 on average."""
    weight = np.empty(len(cover))
    for index in np.unique(cover):
        chosen = cover == index
        of_kind = np.unique(cover[kind == kind[chosen][0]])
        weight[chosen] = 1.0 / (np.count_nonzero(chosen) * math.sqrt(len(of_kind)))
    return np.asarray(weight / weight.mean())


def regression(inputs: Array, kind: NDArray[np.intp], weight: Array) -> Array:
    """(n_terms, n_kinds) weights of the multinomial logistic regression with a small ridge on all but the constant."""
    n_kinds = int(kind.max()) + 1
    truth = np.eye(n_kinds)[kind] * weight[:, np.newaxis]
    ridge = np.full((inputs.shape[1], 1), WEIGHT_RIDGE)
    ridge[0] = 0.0

    def loss(flat: Array) -> tuple[float, Array]:
        weights = flat.reshape(inputs.shape[1], n_kinds)
        log_p = inputs @ weights
        log_p -= log_p.max(axis=1, keepdims=True)
        log_p -= np.log(np.exp(log_p).sum(axis=1, keepdims=True))
        gradient = inputs.T @ (weight[:, np.newaxis] * np.exp(log_p) - truth) / len(kind) + 2.0 * ridge * weights
        return float(-(truth * log_p).sum() / len(kind) + (ridge * weights * weights).sum()), gradient.ravel()

    start = np.zeros(inputs.shape[1] * n_kinds)
    found = minimize(loss, start, jac=True, method="L-BFGS-B", options={"maxiter": _ITERATIONS})
    return np.asarray(found.x.reshape(inputs.shape[1], n_kinds), dtype=np.float64)


def told_of(seeds: Sequence[int], samples: Samples) -> str:
    counts = ", ".join(f"{np.count_nonzero(samples.cover == index)} {name}" for index, name in enumerate(COVERS))
    return f"simulated missions of seeds {seeds[0]} to {seeds[-1]}: {counts} cells"
