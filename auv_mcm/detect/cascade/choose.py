"""Choose the trained cascade for a configuration: the one that ships with the package, one from a file, or none."""

from __future__ import annotations

from importlib import resources
from typing import Final

from auv_mcm.detect.cascade.model import CascadeModel, fits_sonar, parse_model
from auv_mcm.model_file import NONE, SHIPPED, read_model
from auv_mcm.records import Notice
from auv_mcm.settings.config import Config

_FILE: Final = "model.json"


def configured_model(config: Config) -> CascadeModel | None:
    """Read the model that `detect.model` names; None for `none`.

    Raises BadInputError for a file that cannot be read or does not hold a model.
    """
    name = config.detect.model
    if name == NONE:
        return None
    return read_model("detect.model", name, parse_model, shipped_model, f", or '{NONE}'")


def shipped_model() -> CascadeModel:
    """Read the model that ships with the package."""
    return parse_model(resources.files("auv_mcm.detect.cascade").joinpath(_FILE).read_bytes(), _FILE)


def fitting(model: CascadeModel | None, config: Config) -> tuple[CascadeModel | None, Notice]:
    """Return the model if it fits the pixels configured, else None, with a notice of which detector serves and why."""
    row_m, column_m = config.waterfall.row_spacing_m, config.waterfall.column_spacing_m
    if model is None:
        return None, Notice(
            code="detect.contrast", text="detect.model is none: contrasts alone detect", for_the_record=True
        )
    if not fits_sonar(model, row_m, column_m):
        text = (
            f"pixels of {row_m:g} x {column_m:g} m are not among those that the model was trained for "
            f"({_span(model.row_spacing_m)} x {_span(model.column_spacing_m)} m): contrasts alone detect. Choose "
            "pixels within that range, or train a model for these"
        )
        return None, Notice(code="detect.model_does_not_fit", text=text, place=config.detect.model)
    text = f"the detector is a cascade trained on {model.trained_on}"
    has_shipped_odds = config.confirm.enabled and config.confirm.odds == SHIPPED
    if config.detect.model != SHIPPED and has_shipped_odds and model != shipped_model():
        text += (
            ", but confirm.odds weighs scores of the one that ships: p_mine and calls may be wrong. Fit odds, and the "
            "gate, with 'auv-mcm calibrate', or set detect.model to shipped"
        )
        return model, Notice(code="detect.odds_of_another", text=text, place=config.detect.model)
    return model, Notice(code="detect.cascade", text=text, place=config.detect.model, for_the_record=True)


def _span(limits_m: tuple[float, float]) -> str:
    return f"{limits_m[0]:g} to {limits_m[1]:g}"
