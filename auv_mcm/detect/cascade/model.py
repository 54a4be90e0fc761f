"""Read and write a trained cascade: boosted stumps in groups, each with a threshold that drops windows.

Every stump compares means of boxes (P. Viola, M. Jones, Int. J. Computer Vision 57, 2004) with a threshold t, in
float32:

- "ratio": mean(a) < t mean(b), which no gain changes;
- "contrast": mean(a) - mean(b) < t mean(w), normalised by the mean rather than by the standard deviation since the one
  is in proportion to the other in speckle.

The window's score gains `below` where the comparison holds, else `above`. Scores are whole numbers in 1/1024 of the sum
that GentleBoost makes (J. Friedman, T. Hastie, R. Tibshirani, Annals of Statistics 28, 2000), half a log-odds.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from typing import Annotated, Final, Literal, TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.detect.cascade.bands import REFERENCE_HEIGHT_M, FeatureBox, box_fault
from auv_mcm.errors import BadInputError

FORMAT_VERSION: Final = 1  # of the model's file; a change of its fields or of the boxes' meaning raises it
SCORE_UNIT: Final = 1024
"""Score of one unit of GentleBoost's sum."""
MAX_STUMPS: Final = 4096  # keeps the sum of scores within its 32 bits
MAX_LEAF: Final = 64 * SCORE_UNIT

_REMEDY: Final = "Train the model anew or take the one that ships with the package"
_MAX_SCORE: Final = MAX_STUMPS * MAX_LEAF

_Leaf: TypeAlias = Annotated[int, msgspec.Meta(ge=-MAX_LEAF, le=MAX_LEAF)]
_Score: TypeAlias = Annotated[int, msgspec.Meta(ge=-_MAX_SCORE, le=_MAX_SCORE)]
_Share: TypeAlias = Annotated[float, msgspec.Meta(ge=0.0, le=1.0)]
_Metres: TypeAlias = Annotated[float, msgspec.Meta(ge=0.0, le=1000.0)]
_Spacing: TypeAlias = Annotated[float, msgspec.Meta(gt=0.0, le=10.0)]


class Stump(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """Hold one comparison of box means.

    w: the third box of a contrast, None for a ratio. threshold: t, for a ratio a linear ratio above 0.
    """

    kind: Literal["ratio", "contrast"]
    a: FeatureBox
    b: FeatureBox
    w: FeatureBox | None = None
    threshold: Annotated[float, msgspec.Meta(ge=-1e4, le=1e4)]
    below: _Leaf
    above: _Leaf


class Calibration(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Hold log-odds of a target at some final scores, nats, linear in between, constant beyond.

    score rises, log_odds does not fall.
    """

    score: tuple[_Score, ...]
    log_odds: tuple[Annotated[float, msgspec.Meta(ge=-50.0, le=50.0)], ...]

    def log_odds_of(self, scores: NDArray[np.integer]) -> NDArray[np.float64]:
        """Interpolate the log-odds of a target, nats, for final scores (n,), float64."""
        return np.asarray(np.interp(scores, self.score, self.log_odds), dtype=np.float64)


class ExpectedPd(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Share of held-out targets found on one kind of sea floor between two ground ranges."""

    seabed: str
    near_m: _Metres
    far_m: _Metres
    n_targets: Annotated[int, msgspec.Meta(ge=0)]
    pd: _Share


class CascadeModel(msgspec.Struct, frozen=True, cache_hash=True, kw_only=True, forbid_unknown_fields=True):
    """Hold a trained cascade.

    kind: "soft" adds scores up over all groups, "stages" starts at 0 in each. groups: stumps; after group g windows
    that score less than reject[g] are dropped. row_spacing_m, column_spacing_m: from and to of pixel sizes it was
    trained for. reference_height_m: of the object whose shadow is the unit of boxes. trained_on: what, in words.
    training_sha256: of the training data.
    """

    format_version: Literal[1] = 1
    kind: Literal["soft", "stages"]
    trained_on: str
    training_sha256: str
    row_spacing_m: tuple[_Spacing, _Spacing]
    column_spacing_m: tuple[_Spacing, _Spacing]
    reference_height_m: Annotated[float, msgspec.Meta(ge=0.05, le=2.0)] = REFERENCE_HEIGHT_M
    calibration: Calibration
    expected_pd: tuple[ExpectedPd, ...] = ()
    reject: tuple[_Score, ...]
    groups: tuple[tuple[Stump, ...], ...]

    @property
    def n_stumps(self) -> int:
        """Count the stumps of all groups."""
        return sum(len(group) for group in self.groups)


def rejecting_last(model: CascadeModel) -> CascadeModel:
    """Return the model without thresholds on the way, judged by the last threshold alone.

    Windows go through all groups. Stages each start at a score of 0, so that each of their thresholds is a decision:
    such a model is returned as it is.
    """
    if model.kind != "soft":
        return model
    return msgspec.structs.replace(model, reject=(*(-_MAX_SCORE for _ in model.reject[:-1]), model.reject[-1]))


def parse_model(data: bytes, place: str) -> CascadeModel:
    """Read a model from JSON. Raises BadInputError naming `place`, what is wrong with it and where."""
    try:
        version = msgspec.json.decode(data, type=_Versioned).format_version
        if version != FORMAT_VERSION:
            raise BadInputError(
                f"{place}: format_version {version}, but this program reads {FORMAT_VERSION}. {_REMEDY}"
            )
        model = msgspec.json.decode(data, type=CascadeModel)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise BadInputError(f"{place}: {error}. {_REMEDY}") from error
    check_model(model, place)
    return model


def encode_model(model: CascadeModel) -> bytes:
    """Write the JSON that parse_model reads back as the same model, a line per field and per stump."""
    encode = msgspec.json.encode
    groups = b",\n".join(
        b"  [\n   " + b",\n   ".join(encode(stump) for stump in group) + b"\n  ]" for group in model.groups
    )
    fields = {name: encode(getattr(model, name)) for name in model.__struct_fields__}
    fields["groups"] = b"[\n" + groups + b"\n ]"
    return b"{\n" + b",\n".join(b' "%s": %s' % (name.encode(), value) for name, value in fields.items()) + b"\n}\n"


def check_model(model: CascadeModel, place: str) -> None:
    """Check that a model made in memory can be run. Raises BadInputError naming `place`."""
    fault = next(_faults(model), None)
    if fault is not None:
        raise BadInputError(f"{place}: {fault}. {_REMEDY}")


def fits_sonar(model: CascadeModel, row_spacing_m: float, column_spacing_m: float) -> bool:
    """Check whether a model was trained for pixels of this size."""
    (min_row_m, max_row_m), (min_column_m, max_column_m) = model.row_spacing_m, model.column_spacing_m
    return min_row_m <= row_spacing_m <= max_row_m and min_column_m <= column_spacing_m <= max_column_m


class _Versioned(msgspec.Struct):
    format_version: int


def _faults(model: CascadeModel) -> Iterator[str]:
    if not model.groups or not all(model.groups):
        yield "a cascade needs one group or more, and every group one stump or more"
    if model.n_stumps > MAX_STUMPS:
        yield f"{model.n_stumps} stumps are more than the maximum of {MAX_STUMPS} that keeps the score within its range"
    if len(model.reject) != len(model.groups):
        yield f"reject has {len(model.reject)} thresholds for {len(model.groups)} groups; each group needs one"
    for name in ("row_spacing_m", "column_spacing_m"):
        lowest, highest = getattr(model, name)
        if not lowest <= highest:
            yield f"{name} goes from {lowest} to {highest}; write the smaller number first"
    yield from _calibration_faults(model.calibration)
    for index, expected in enumerate(model.expected_pd):
        if not expected.near_m < expected.far_m:
            yield f"expected_pd[{index}]: near_m {expected.near_m} must be less than far_m {expected.far_m}"
    for group, stumps in enumerate(model.groups):
        for index, stump in enumerate(stumps):
            for fault in _stump_faults(stump):
                yield f"groups[{group}][{index}]: {fault}"


def _calibration_faults(calibration: Calibration) -> Iterator[str]:
    score, log_odds = calibration.score, calibration.log_odds
    if len(score) < 2 or len(score) != len(log_odds):
        yield f"calibration has {len(score)} scores and {len(log_odds)} log_odds; it needs at least two pairs"
    elif any(a >= b for a, b in itertools.pairwise(score)):
        yield "calibration.score must rise"
    elif any(a > b for a, b in itertools.pairwise(log_odds)):
        yield "calibration.log_odds must not fall: a better score cannot be less likely a target"


def _stump_faults(stump: Stump) -> Iterator[str]:
    if not math.isfinite(stump.threshold) or (stump.kind == "ratio" and stump.threshold < 1e-4):
        yield f"threshold {stump.threshold} of a {stump.kind}; it must be finite, that of a ratio at least 0.0001"
    if (stump.w is None) != (stump.kind == "ratio"):
        yield f"a {stump.kind} {'must not have' if stump.kind == 'ratio' else 'needs'} a third box w"
    for name, box in (("a", stump.a), ("b", stump.b), ("w", stump.w)):
        fault = None if box is None else box_fault(box)
        if fault is not None:
            yield f"box {name}: {fault}"
