"""Fit the network of grey levels that `auv-mcm bench all` compares the payload's sea floor with.

python -m sim_replay.benches.every_stage.fit_grey_levels FILE

It is fitted as the payload's own is, on the same missions, on the first two tiles of each. The payload's textures are
fitted on the same cells beside it, so that textures can be compared without regard to how many cells there were; both
are judged on missions of other seeds.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.seabed.seabed_model import INPUTS, standardised
from auv_mcm.seabed.texture import measure_texture
from sim_replay.benches.every_stage.grey_levels import GreyLevelModel, grey_level_inputs, grey_level_odds
from sim_replay.fitting.cascade.farm import Farm, run_tasks
from sim_replay.fitting.seabed.fit_seabed import FIT_SEEDS, fitted_to, seabed_fit_words
from sim_replay.fitting.seabed.samples import drawn_mission, tiles_of, true_shares

Array = NDArray[np.float64]

JUDGED_SEEDS: Final = range(91010, 91020)
"""A mission like each of the ten named scenes; none was fitted on."""
MIN_KNOWN: Final = 0.5  # of a cell's places, as where the payload's model is fitted
_N_TILES: Final = 2  # of a mission
_EVERY: Final = 6  # cells that one is kept of; bounds time


class CellInputs(NamedTuple):
    """Hold cells measured in both ways: grey_levels (n, n_inputs), textures (n, len(INPUTS)), shares (n, n_kinds)."""

    grey_levels: Array
    textures: Array
    shares: NDArray[np.float32]


def cell_inputs(seed: int, n_tiles: int = _N_TILES, every: int = _EVERY) -> CellInputs:
    """Fly the beginning of the mission of a seed and measure some of its cells."""
    mission, sonar = drawn_mission(seed)
    parts = []
    for tile in itertools.islice(tiles_of(mission, sonar), n_tiles):
        texture = measure_texture(tile)
        shares = true_shares(tile, texture, mission, sonar)
        known = shares.sum(axis=-1)
        cells = np.argwhere(np.isfinite(texture.features).all(axis=-1) & (known >= MIN_KNOWN))[::every]
        along, across = cells.T
        raw = standardised(
            texture.features[along, across], texture.cot_grazing[across], np.zeros(len(INPUTS)), np.ones(len(INPUTS))
        )
        share = (shares[along, across] / known[along, across, np.newaxis]).astype(np.float32)
        parts.append(CellInputs(grey_level_inputs(tile, cells, texture.cot_grazing), raw, share))
    return _pooled(parts)


def fitted_model(inputs: Array, shares: NDArray[np.float32], fitted_on: str) -> GreyLevelModel:
    """Fit a network to inputs (n, n_inputs)."""
    centre, scale = inputs.mean(axis=0), np.maximum(inputs.std(axis=0), 1e-6)
    empty = GreyLevelModel(fitted_on=fitted_on, centre=_rounded(centre), scale=_rounded(scale), layers=[])
    layers = fitted_to(grey_level_odds(inputs, empty), shares)
    return msgspec.structs.replace(
        empty, layers=[([_rounded(row) for row in layer.weights], _rounded(layer.constants)) for layer in layers]
    )


def share_wrong(found: NDArray[np.integer], shares: NDArray[np.floating]) -> float:
    """Measure the share of cells taken for another kind than most of them is, the mean over the kinds there are."""
    true = shares.argmax(axis=1)
    return float(np.mean([np.mean(found[true == kind] != kind) for kind in np.unique(true)]))


def _pooled(parts: Sequence[CellInputs]) -> CellInputs:
    return CellInputs(*(np.concatenate(part) for part in zip(*parts, strict=True)))


def _rounded(values: NDArray[np.floating]) -> list[float]:
    return [float(f"{value:.4g}") for value in values]


def main(out: Path) -> None:
    """Fly, fit, judge, and write the model of grey levels."""
    fit = _pooled(list(run_tasks(cell_inputs, list(FIT_SEEDS), Farm(2))))
    held_out = _pooled(list(run_tasks(cell_inputs, list(JUDGED_SEEDS), Farm(2))))
    words = seabed_fit_words(FIT_SEEDS, fit.shares)
    models = [fitted_model(inputs, fit.shares, words) for inputs in fit[:2]]
    print(words)
    for name, inputs, model in zip(("grey levels", "textures"), held_out[:2], models, strict=True):
        wrong = share_wrong(grey_level_odds(inputs, model).argmax(axis=1), held_out.shares)
        print(f"{name}: {wrong:.3f} wrong of {len(inputs)} cells of held-out missions, mean over kinds")
    out.write_bytes(msgspec.json.encode(models[0]) + b"\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
