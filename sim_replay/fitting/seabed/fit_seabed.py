"""Fit the model of sea floors to textures of cells."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from auv_mcm.errors import BadInputError
from auv_mcm.seabed.seabed_model import INPUTS, Layer, SeabedModel, as_stored, bounded, fitted_gaussian, standardised
from sim_replay.fitting.seabed.network import NetworkLayer, fitted_network
from sim_replay.fitting.seabed.samples import KINDS, SeabedSamples
from sim_replay.fitting.seabed.seabed_missions import FIRST_LIKE_SCENE

FIT_SEEDS: Final = (*range(3000, 3050), *range(FIRST_LIKE_SCENE, FIRST_LIKE_SCENE + 80))
"""Missions drawn freely, and missions like the named scenes; see `missions`."""

_HIDDEN: Final = (96, 48)  # units of the two hidden layers
_EPOCHS: Final = 14  # over all cells
_WEIGHT_DECAY: Final = 0.3  # per step, relative to the rate
_SEED: Final = 1  # of the training, fixed so that models repeat
_SHRINKAGE: Final = 0.05  # of the covariance toward its diagonal
_RIDGE: Final = 1e-3  # added to its diagonal
_KEPT: Final = (
    0.99  # of the textures learnt are not novel; recorded floors, which lie farther out, are so in 10 to 15 % of cells
)
_MIN_SHARE: Final = 0.01  # of all cells that each kind must be


def fit_seabed_model(samples: SeabedSamples, fitted_on: str) -> SeabedModel:
    """Fit the model to samples, in which all kinds weigh the same.

    Raises BadInputError if there are too few, or none of a kind.
    """
    of_kind = samples.shares.mean(axis=0, dtype=np.float64)
    if missing := [kind for kind, share in zip(KINDS, of_kind.tolist(), strict=True) if not share >= _MIN_SHARE]:
        raise BadInputError(f"{fitted_on}: too little of {', '.join(missing)}. Fly more missions, with --seeds")
    features, cot_grazing = samples.features.astype(np.float64), samples.cot_grazing.astype(np.float64)
    raw = standardised(features, cot_grazing, np.zeros(len(INPUTS)), np.ones(len(INPUTS)))
    centre, scale = as_stored(raw.mean(axis=0)), as_stored(np.maximum(raw.std(axis=0), 1e-6))
    x = standardised(features, cot_grazing, np.array(centre), np.array(scale))
    try:
        learnt = fitted_gaussian(x, _SHRINKAGE, _RIDGE, _KEPT)
    except ValueError as error:
        raise BadInputError(f"{fitted_on}: {error}") from error
    return SeabedModel(
        fitted_on=fitted_on,
        inputs=INPUTS,
        kinds=KINDS,
        centre=centre,
        scale=scale,
        layers=tuple(_stored(units) for units in fitted_to(bounded(x), samples.shares)),
        learnt=learnt,
    )


def fitted_to(x: NDArray[np.float64], shares: NDArray[np.float32]) -> list[NetworkLayer]:
    """Fit the network to comparable inputs (n, n_inputs) and shares (n, len(KINDS)); all kinds weigh the same."""
    of_kind = shares.mean(axis=0, dtype=np.float64)
    return fitted_network(
        x.astype(np.float32),
        shares,
        (shares @ (1.0 / (len(KINDS) * of_kind))).astype(np.float32),
        n_hidden=_HIDDEN,
        epochs=_EPOCHS,
        weight_decay=_WEIGHT_DECAY,
        seed=_SEED,
    )


def _stored(units: NetworkLayer) -> Layer:
    weights, constants = (part.astype(np.float64) for part in (units.weights.T, units.constants))
    return Layer(weights=tuple(map(as_stored, weights)), constants=as_stored(constants))


def seabed_fit_words(seeds: Sequence[int], shares: NDArray[np.float32]) -> str:
    """Describe the missions that a model was fitted on. shares: (n, len(KINDS)), of kinds in each cell."""
    counts = ", ".join(f"{share:.0%} {kind}" for kind, share in zip(KINDS, shares.mean(axis=0).tolist(), strict=True))
    return f"{len(seeds)} simulated missions of seeds {seeds[0]} to {seeds[-1]}, {len(shares)} cells: {counts}"
