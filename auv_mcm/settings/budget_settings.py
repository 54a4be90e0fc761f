"""Define the `budget:` section of the configuration: the share of one core that perception may take, and what its work
costs."""

from __future__ import annotations

from typing import Annotated, TypeAlias

import msgspec
from msgspec import Meta


def _price(unit: str) -> Meta:
    return Meta(
        gt=0.0, le=1e7, description=f"price of {unit}, microseconds; 'auv-mcm calibrate budget --write' measures it"
    )


_Duty: TypeAlias = Annotated[float, Meta(gt=0.0, le=1.0)]


class BudgetConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Set how much work a tile may cost. Prices were measured on one busy core of a server with C kernels."""

    duty: Annotated[
        _Duty | None,
        Meta(
            description="share of one core's time, by the prices below, that the work on tiles may take; the likeliest "
            "places come first, and what is not done earns less coverage; empty: everything is done"
        ),
    ] = None
    sample_us: Annotated[float, _price("a stored sample on its way into a tile")] = 0.24
    pixel_us: Annotated[float, _price("contrast, sea floor and coverage of a pixel in a tile's core")] = 0.17
    comparison_us: Annotated[float, _price("a comparison of the cascade")] = 0.001
    peak_us: Annotated[float, _price("measuring a peak")] = 1400.0
    contour_move_us: Annotated[float, _price("a move of a contour's node")] = 35.0
    opinion_us: Annotated[float, _price("the verifier's opinion on a detection")] = 1500.0
    field_us: Annotated[float, _price("the Markov field of an examination, and what else it needs")] = 6200.0
    hypothesis_us: Annotated[float, _price("a hypothesis on a solid")] = 1.3
