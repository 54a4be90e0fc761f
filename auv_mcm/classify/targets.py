"""Read the list of the mines expected, a target library: kinds, sizes with tolerances, shares.

The list is what a navy knows before the mission. It is never taken for complete: `not_listed` is the probability that a
mine which lies there is on no line of it, and bounds what the list may do to any object.
"""

from __future__ import annotations

import functools
import math
from importlib import resources
from pathlib import Path
from typing import Annotated, Final, TypeAlias

import msgspec
from msgspec import Meta

from auv_mcm.clean_text import clean
from auv_mcm.errors import UsageError
from auv_mcm.model_file import SHIPPED
from auv_mcm.settings.strict_yaml import explain_validation_error, load_mapping, read_text

MIN_NOT_LISTED: Final = 0.05
"""Lowest share of mines on no line of a list: no list takes more than 3 nats from what one view shows."""
NOT_LISTED: Final = 0.3
"""Share where a list gives none: on 8 simulated missions a right list gained as much as with 0.1, and lists of wrong
sizes or without a type cost less (flat, ripple, mixed and rough, seeds 91001 and 91002)."""
_FILE: Final = "targets.yaml"
_KEY: Final = "confirm.targets"
_HELP: Final = "'List the mines expected' in the documentation shows one"
_EVEN_SD: Final = 1.0 / math.sqrt(3.0)  # standard deviation of an even spread, as part of half its width

Size: TypeAlias = Annotated[float, Meta(ge=0.2, le=3.5, description="m")]
"""A mine's size: from what a picture resolves to detect.max_object_m."""


class _ExpectedMine(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind"):
    """Describe one type of mine. A size left out may be any.

    tolerance_percent: true sizes lie within a factor of 1 + this / 100 of those given, evenly in their logarithm.
    share: of the mines listed, in proportion to the other shares.
    """

    name: Annotated[str, Meta(max_length=80)] = ""
    tolerance_percent: Annotated[float, Meta(gt=0.0, le=1000.0)] = 5.0
    share: Annotated[float, Meta(gt=0.0, le=1000.0)] = 1.0

    @property
    def spread_nats(self) -> float:
        """Return the standard deviation of the logarithm of its sizes."""
        return math.log1p(0.01 * self.tolerance_percent) * _EVEN_SD


class ExpectedCylinder(_ExpectedMine, frozen=True, kw_only=True, tag="cylinder"):
    """Describe a cylinder."""

    length_m: Size | None = None
    diameter_m: Size | None = None


class ExpectedSphere(_ExpectedMine, frozen=True, kw_only=True, tag="sphere"):
    """Describe a sphere."""

    diameter_m: Size | None = None


class ExpectedCone(_ExpectedMine, frozen=True, kw_only=True, tag="truncated_cone"):
    """Describe a truncated cone. base_diameter_m: at the floor."""

    base_diameter_m: Size | None = None
    height_m: Size | None = None


class ExpectedWedge(_ExpectedMine, frozen=True, kw_only=True, tag="wedge"):
    """Describe a wedge; solids are tried in the proportions 1.02 to 0.80 to 0.385 alone, so that its length counts."""

    length_m: Size | None = None


ExpectedMine: TypeAlias = ExpectedCylinder | ExpectedSphere | ExpectedCone | ExpectedWedge


class TargetLibrary(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """List the mines expected.

    not_listed: probability that a mine which lies there is on no line of the list.
    """

    mines: Annotated[tuple[ExpectedMine, ...], Meta(min_length=1, max_length=100)]
    not_listed: Annotated[float, Meta(ge=MIN_NOT_LISTED, le=1.0)] = NOT_LISTED


@functools.cache
def shipped_targets() -> TargetLibrary:
    """Read the list that ships with the package, once in a process: any mine of the four kinds."""
    return parse_targets(resources.files("auv_mcm.classify").joinpath(_FILE).read_text("utf-8"), _FILE)


def configured_targets(name: str) -> TargetLibrary:
    """Read the list that `confirm.targets` names.

    Raises UsageError naming file and key, for one that cannot be read or is wrong.
    """
    if name == SHIPPED:
        return shipped_targets()
    return parse_targets(read_text(Path(name), f"{_KEY}: the list"), f"{_KEY} {name}")


def parse_targets(text: str, place: str) -> TargetLibrary:
    """Parse a list from YAML; `place` names it in messages. Raises UsageError with the key's path and the remedy."""
    data = load_mapping(text, place, f"expected 'mines:' and a list of them. {_HELP}")
    try:
        return msgspec.convert(data, TargetLibrary)
    except msgspec.ValidationError as error:
        raise UsageError(f"{place}: {explain_validation_error(error, TargetLibrary, data)}. {_HELP}") from error


def mine_words(mine: ExpectedMine) -> str:
    """Name an expected mine with its sizes."""
    fields = msgspec.structs.asdict(mine)
    kind = str(mine.__struct_config__.tag).replace("_", " ")
    sizes = [
        f"{name.removesuffix('_m').replace('_', ' ')} {value:g} m"
        for name, value in fields.items()
        if name.endswith("_m") and value is not None
    ]
    named = f"{clean(mine.name)} ({kind})" if mine.name else kind
    return f"{named}: {', '.join(sizes)}, within {mine.tolerance_percent:g} %" if sizes else f"{named} of any size"
