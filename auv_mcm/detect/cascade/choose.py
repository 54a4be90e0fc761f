"""Which trained cascade serves for a configuration: the one that ships with the package, one from a file, or none."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Final

from auv_mcm.detect.cascade.model import CascadeModel, fits_sonar, parse_model
from auv_mcm.errors import BadInputError
from auv_mcm.records import Notice
from auv_mcm.settings.config import Config

SHIPPED: Final = "shipped"
NONE: Final = "none"
_FILE: Final = "model.json"


def configured_model(config: Config) -> CascadeModel | None:
    """The model that `detect.model` names, None for `none`. Raises BadInputError for a file that cannot be read or is no model."""
    name = config.detect.model
    if name == NONE:
        return None
    if name == SHIPPED:
        return shipped_model()
    try:
        data = Path(name).read_bytes()
    except OSError as error:
        raise BadInputError(
            f"detect.model {name}: {error.strerror}. Name a model file, or '{SHIPPED}' for the one of the package, or '{NONE}'"
        ) from error
    return parse_model(data, name)


def shipped_model() -> CascadeModel:
    """The model that ships with the package."""
    return parse_model(resources.files("auv_mcm.detect.cascade").joinpath(_FILE).read_bytes(), _FILE)


def fitting(model: CascadeModel | None, config: Config) -> tuple[CascadeModel | None, Notice]:
    """The model if it fits the pixels configured, and a notice of which detector serves and why."""
    row_m, column_m = config.waterfall.row_spacing_m, config.waterfall.column_spacing_m
    if model is None:
        return None, Notice(code="detect.contrast", text="detect.model is none: contrasts alone serve as detector", place="")
    if not fits_sonar(model, row_m, column_m):
        text = (
            f"pixels of {row_m:g} x {column_m:g} m are none that the model was trained for ({_span(model.row_spacing_m)} x "
            f"{_span(model.column_spacing_m)} m): contrasts alone serve as detector. Choose pixels within, or train a model for these"
        )
        return None, Notice(code="detect.model_does_not_fit", text=text, place=config.detect.model)
    return model, Notice(
        code="detect.cascade", text=f"a cascade trained on {model.trained_on} serves as detector", place=config.detect.model
    )


def _span(limits_m: tuple[float, float]) -> str:
    return f"{limits_m[0]:g} to {limits_m[1]:g}"
