"""Decide before measuring which places of a tile can become contacts.

The score of the cascade, the contrast and the range are known of every place; measuring it and confirming what was
measured costs a thousand times as much. A linear forecast of the log-odds that confirmation ends with, and the margin
by which those of a contact have exceeded it, say which places cannot reach the lowest p_mine that is reported. They are
counted and go no further.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from importlib import resources
from typing import Annotated, Final, Literal, TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.errors import BadInputError
from auv_mcm.model_file import NONE, read_model

Values: TypeAlias = NDArray[np.float64]
Feature: TypeAlias = Literal[
    "cascade", "contrast", "range", "range_squared", "cascade_by_range", "contrast_by_range", "cascade_squared"
]

LOG_RANGE: Final = (-1.5, 3.5)
"""Bounds of ln(ground range / altitude), 0.2 to 33 altitudes: beyond them no gate, odds or verifier was fitted."""
_FILE: Final = "gate.json"

_Nats: TypeAlias = Annotated[float, msgspec.Meta(ge=-1e3, le=1e3)]


class Forecast(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Forecast the final log-odds of a mine: offset + sum of weight * feature, in nats.

    margin_nats: by which the log-odds of contacts exceeded it, but for one in two hundred.
    """

    offset: _Nats
    weights: dict[Feature, _Nats]
    margin_nats: _Nats

    def log_odds(self, features: Mapping[Feature, Values]) -> Values:
        """Forecast the log-odds for features (n,). Raises KeyError for a feature that is missing."""
        total = np.full(len(features["range"]), self.offset)
        for name, weight in self.weights.items():
            total += weight * features[name]
        return total

    def recalibrated(self, slope: float, offset_nats: float) -> Forecast:
        """Forecast log-odds that became offset + slope * log-odds."""
        return Forecast(
            offset=offset_nats + slope * self.offset,
            weights={name: slope * weight for name, weight in self.weights.items()},
            margin_nats=slope * self.margin_nats,
        )


class Gate(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Hold a forecast from the cascade's score and the contrast, and one for contrasts without a cascade."""

    fitted_on: str
    both: Forecast
    contrast: Forecast

    def recalibrated(self, slope: float, offset_nats: float) -> Gate:
        """Forecast log-odds that became offset + slope * log-odds."""
        both, contrast = (one.recalibrated(slope, offset_nats) for one in (self.both, self.contrast))
        return Gate(fitted_on=self.fitted_on, both=both, contrast=contrast)


def place_features(
    ground_range_m: Values, altitude_m: Values, *, cascade: Values | None = None, contrast: Values | None = None
) -> dict[Feature, Values]:
    """Compute what a forecast is made of, (n,) each, from what is known of n places.

    Parameters
    ----------
    cascade
        Scores in units of half a log-odds.
    contrast
        In standard deviations of the sea floor around.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        log_range = np.log(ground_range_m / altitude_m)
    log_range = np.clip(np.where(np.isfinite(log_range), log_range, 0.0), *LOG_RANGE)
    features: dict[Feature, Values] = {"range": log_range, "range_squared": log_range**2}
    if cascade is not None:
        features |= {"cascade": cascade, "cascade_squared": cascade**2, "cascade_by_range": cascade * log_range}
    if contrast is not None:
        features |= {"contrast": contrast, "contrast_by_range": contrast * log_range}
    return features


def may_reach(forecast: Forecast | None, min_p_mine: float, features: Mapping[Feature, Values]) -> NDArray[np.bool_]:
    """Decide which of n places may end with a p_mine of at least `min_p_mine`, (n,) bool.

    All may without a forecast or for a minimum of 0.
    """
    n_places = len(features["range"])
    if forecast is None or min_p_mine <= 0.0:
        return np.ones(n_places, dtype=np.bool_)
    if min_p_mine >= 1.0:
        return np.zeros(n_places, dtype=np.bool_)
    return np.asarray(forecast.log_odds(features) + forecast.margin_nats >= math.log(min_p_mine / (1.0 - min_p_mine)))


def configured_gate(name: str) -> Gate | None:
    """Read the gate that `detect.gate` names, None for `none`. Raises BadInputError if it cannot be read."""
    return None if name == NONE else read_model("detect.gate", name, parse_gate, shipped_gate, f", or '{NONE}'")


def shipped_gate() -> Gate:
    """Read the gate that ships with the package."""
    return parse_gate(resources.files("auv_mcm.detect").joinpath(_FILE).read_bytes(), _FILE)


def parse_gate(data: bytes, place: str) -> Gate:
    """Read a gate from JSON. Raises BadInputError naming `place` and what is wrong with it."""
    try:
        return msgspec.json.decode(data, type=Gate)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise BadInputError(f"{place}: {error}. Write the file again with 'auv-mcm calibrate gate'") from error
