"""Store the classical classifier, and compute its odds for pixels of a tile."""

from __future__ import annotations

import math
from typing import Annotated, Final, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.errors import BadInputError
from sim_replay.fitting.cascade.classical.chips import N_COLUMNS, N_ROWS, ChipPicture, Pixels, cut_chips, picture_of
from sim_replay.fitting.cascade.classical.extractors import Family, extract, feature_names
from sim_replay.fitting.cascade.tiles import LabelledTile

Array = NDArray[np.float64]

FORMAT_VERSION: Final = 1  # of the file; a change of its fields raises it
_BOUND: Final = 30.0  # nats

_Bounded = Annotated[float, msgspec.Meta(ge=-1e9, le=1e9)]
_Row = Annotated[tuple[_Bounded, ...], msgspec.Meta(min_length=N_COLUMNS, max_length=N_COLUMNS)]
_Image = Annotated[tuple[_Row, ...], msgspec.Meta(min_length=N_ROWS, max_length=N_ROWS)]


class ClassicalModel(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Compute log-odds of a target = offset + sum of slope * feature.

    families: of features, in the order in which they are taken. templates: by name, mean contrast of chips N_ROWS by
    N_COLUMNS. slopes: by feature. trained_on: what samples it is made from.
    """

    format_version: Literal[1]
    trained_on: str
    families: Annotated[tuple[Family, ...], msgspec.Meta(min_length=1)]
    templates: dict[str, _Image]
    offset: _Bounded
    slopes: dict[str, _Bounded]


def parse_classical_model(data: bytes, place: str) -> ClassicalModel:
    """Parse a model from JSON. Raises BadInputError naming `place` and what is wrong with it."""
    remedy = "Train the model anew"
    try:
        model = msgspec.json.decode(data, type=ClassicalModel)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise BadInputError(f"{place}: {error}. {remedy}") from error
    if len(set(model.families)) < len(model.families):
        raise BadInputError(f"{place}: families {', '.join(model.families)} come more than once. {remedy}")
    if ("templates" in model.families) != bool(model.templates):
        raise BadInputError(f"{place}: templates are needed with the family 'templates', and with it alone. {remedy}")
    wanted = feature_names(model.families, list(model.templates))
    if set(wanted) != model.slopes.keys():
        differ = sorted(set(wanted) ^ model.slopes.keys())
        raise BadInputError(
            f"{place}: slopes do not fit the features, which differ in {', '.join(differ[:3])}. {remedy}"
        )
    return model


def format_model(model: ClassicalModel) -> bytes:
    """Format the model as JSON with an end of line, the same for the same model."""
    return msgspec.json.encode(model, order="deterministic") + b"\n"


def score_windows(model: ClassicalModel, tile: LabelledTile, rows: Pixels, columns: Pixels) -> Array:
    """Return (n,) float64 log-odds of a target centred on pixels (rows, columns), (n,) each.

    -inf where less than 0.6 of a chip is known.
    """
    return score_picture(model, picture_of(tile), rows, columns)


def score_picture(model: ClassicalModel, source: ChipPicture, rows: Pixels, columns: Pixels) -> Array:
    """Score a picture as score_windows does."""
    if len(rows) == 0:
        return np.zeros(0)
    chips = cut_chips(source, rows, columns)
    return np.where(chips.known, score_contrast(model, chips.contrast), -math.inf)


def score_contrast(model: ClassicalModel, contrast: Array) -> Array:
    """Return (n,) float64 log-odds of a target in chips (n, N_ROWS, N_COLUMNS), however much of them is known."""
    templates = {name: np.array(rows_of) for name, rows_of in model.templates.items()}
    features = extract(contrast, model.families, templates)
    slopes = np.array([model.slopes[name] for name in feature_names(model.families, list(templates))])
    return np.asarray(np.clip(model.offset + np.einsum("nk,k->n", features, slopes), -_BOUND, _BOUND))
