"""Train the classical classifier on labelled tiles."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.errors import UsageError
from auv_mcm.settings.config import Config
from sim_replay.fitting.cascade.classical.chips import cut_chips, picture_of
from sim_replay.fitting.cascade.classical.classical_candidates import Candidates, find_candidates, label
from sim_replay.fitting.cascade.classical.classical_model import FORMAT_VERSION, ClassicalModel
from sim_replay.fitting.cascade.classical.discriminant import Discriminant, fit_calibrated
from sim_replay.fitting.cascade.classical.extractors import FAMILIES, Family, extract, feature_names, mean_chip
from sim_replay.fitting.cascade.tiles import LabelledTile

Array = NDArray[np.float64]

_OTHER: Final = "other"
_FAINT_FROM, _FAINT_KEPT = 48, 4  # of candidates after this many in a tile one in so many is kept, and counts as many
_JITTER: Final = (
    (0, 0),
    (-1, 0),
    (1, 0),
    (0, -2),
    (0, 2),
)  # rows and columns about a target, each a share of one sample
_RIDGE: Final = 10.0  # of the logistic regression, per feature of unit variance
_DIGITS: Final = 8  # significant, in the file


class ChipSamples(NamedTuple):
    """Hold contrast: (n, N_ROWS, N_COLUMNS) float32 of chips. kind: of the target, "" for anything else. weight:
    samples each stands for.
    """

    contrast: NDArray[np.float32]
    kind: tuple[str, ...]
    background: tuple[str, ...]
    weight: Array


def train_classical(
    tiles: Iterable[LabelledTile],
    config: Config,
    *,
    families: Sequence[Family] = FAMILIES,
    kinds: Collection[str] | None = None,
) -> ClassicalModel:
    """Train a model on the candidates that the prescreen, with `config`, finds in tiles.

    kinds: of targets to learn, all if None; others teach nothing. Backgrounds are kept apart where odds are calibrated.
    Raises UsageError if there are no targets, or nothing else, among the candidates.
    """
    samples = collect(tiles, config)
    return fit_classical_model(samples if kinds is None else of_kinds(samples, kinds), families)


def collect(tiles: Iterable[LabelledTile], config: Config) -> ChipSamples:
    """Collect targets and others among the candidates in tiles. Raises UsageError if there are no tiles."""
    return merged([samples_at(tile, find_candidates(tile, config)) for tile in tiles])


def merged(parts: Sequence[ChipSamples]) -> ChipSamples:
    """Merge samples of several sets. Raises UsageError if there are no sets."""
    if not parts:
        raise UsageError("no tiles to train on. Give some")
    return ChipSamples(
        np.concatenate([part.contrast for part in parts]),
        tuple(kind for part in parts for kind in part.kind),
        tuple(background for part in parts for background in part.background),
        np.concatenate([part.weight for part in parts]),
    )


def of_kinds(samples: ChipSamples, kinds: Collection[str]) -> ChipSamples:
    """Drop the targets of other kinds."""
    kept = [index for index, kind in enumerate(samples.kind) if kind in ("", *kinds)]
    return ChipSamples(
        samples.contrast[kept],
        tuple(samples.kind[index] for index in kept),
        tuple(samples.background[index] for index in kept),
        samples.weight[kept],
    )


def samples_at(tile: LabelledTile, found: Candidates, shadow_m: float | None = None) -> ChipSamples:
    """Collect targets and others among candidates in a tile. shadow_m: as in `cut_chips`."""
    labels = label(tile, found)
    rows, columns, kind, weight = [], [], [], []
    for index in np.flatnonzero(labels.object_index >= 0):
        for row_step, column_step in _JITTER:
            rows.append(found.rows[index] + row_step)
            columns.append(found.columns[index] + column_step)
            kind.append(tile.objects[labels.object_index[index]].kind)
            weight.append(1.0 / len(_JITTER))
    for index in np.flatnonzero(labels.is_other):
        if index < _FAINT_FROM or index % _FAINT_KEPT == 0:
            rows.append(found.rows[index])
            columns.append(found.columns[index])
            kind.append("")
            weight.append(1.0 if index < _FAINT_FROM else float(_FAINT_KEPT))
    inside_rows, inside_columns = (
        np.clip(np.array(at, dtype=np.int32), 0, n - 1) for at, n in zip((rows, columns), tile.codes.shape, strict=True)
    )
    chips = cut_chips(picture_of(tile), inside_rows, inside_columns, shadow_m)
    known = np.flatnonzero(chips.known)
    return ChipSamples(
        chips.contrast[known].astype(np.float32),
        tuple(kind[index] for index in known),
        (tile.background,) * len(known),
        np.array(weight)[known] if weight else np.zeros(0),
    )


def fit_classical_model(samples: ChipSamples, families: Sequence[Family] = FAMILIES) -> ClassicalModel:
    """Fit a model to samples. Raises UsageError if they are all targets, or none is."""
    is_target = np.array([kind != "" for kind in samples.kind], dtype=np.bool_)
    contrast = samples.contrast.astype(np.float64)
    templates = _templates(contrast, samples.kind) if "templates" in families else {}
    features = extract(contrast, families, templates)
    found = fit_calibrated(features, is_target, samples.weight, _RIDGE, samples.background)
    n_targets, n_others = samples.weight[is_target].sum(), samples.weight[~is_target].sum()
    return _model(
        found, families, templates, f"{n_targets:.0f} targets ({_count(samples.kind)}), {n_others:.0f} others"
    )


def _templates(contrast: Array, kinds: Sequence[str]) -> dict[str, Array]:
    """Return the mean chip of each kind of target and of all others, rounded as the model keeps it."""
    of_kind = np.array(kinds)
    return {kind or _OTHER: np.round(mean_chip(contrast[of_kind == kind]), 4) for kind in sorted(set(kinds))}


def _model(
    found: Discriminant, families: Sequence[Family], templates: dict[str, Array], trained_on: str
) -> ClassicalModel:
    names = feature_names(families, list(templates))
    return ClassicalModel(
        format_version=FORMAT_VERSION,
        trained_on=trained_on,
        families=tuple(families),
        templates={name: tuple(map(tuple, image.tolist())) for name, image in templates.items()},
        offset=_rounded(found.offset),
        slopes={name: _rounded(slope) for name, slope in zip(names, found.slopes.tolist(), strict=True)},
    )


def _count(kinds: Sequence[str]) -> str:
    found = sorted(set(kinds) - {""})
    return ", ".join(f"{kinds.count(kind) // len(_JITTER)} {kind}" for kind in found)


def _rounded(value: float) -> float:
    return float(f"{value:.{_DIGITS}g}")
