"""Navigation that is missing or impossible: refused in words, or flagged; never a number made of it."""

from __future__ import annotations

import math

import msgspec
import pytest

from auv_mcm.confirm.snake import converge
from tests.stability.region_doors import DOORS, START, cone_region, through

NOT_POSITIVE = [0.0, -1.0, 1e-300, math.nan, math.inf, -math.inf]
NO_PLACE = [math.nan, math.inf, -math.inf, 1e200]
IMPOSSIBLE: dict[str, list[float]] = {
    "row_spacing_m": NOT_POSITIVE,
    "column_spacing_m": NOT_POSITIVE,
    "altitude_m": NOT_POSITIVE,
    "first_ground_range_m": NO_PLACE,
    "row": NO_PLACE,
    "column": NO_PLACE,
    "squint_rad": [math.nan, math.inf, -math.inf, 0.5 * math.pi, -0.25 * math.pi, 3.0],
    "beam_width_rad": [math.nan, math.inf, -0.1, math.pi],
}
RANGES_M = (-2.0, 0.0, 16.0, 1e6)
REFUSING = [door for door in DOORS if door != "converge"]


@pytest.mark.parametrize(
    ("field", "value"), [(field, value) for field, values in IMPOSSIBLE.items() for value in values]
)
def test_a_number_that_no_sonar_has_is_refused_by_its_name(field: str, value: float) -> None:
    region = msgspec.structs.replace(cone_region(), **{field: value})
    for door in REFUSING:
        with pytest.raises(ValueError, match=field):
            through(door, region)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        *((field, value) for field in list(IMPOSSIBLE)[:6] for value in (math.nan, math.inf)),
        ("altitude_m", 0.0),
        ("row_spacing_m", 0.0),
    ],
)
def test_contours_of_a_region_without_geometry_are_rejected(field: str, value: float) -> None:
    contours = converge(msgspec.structs.replace(cone_region(), **{field: value}), START)
    assert contours.rejected
    assert contours.reasons == ("geometry_unknown",)


@pytest.mark.parametrize("door", REFUSING)
def test_planes_that_do_not_fit_each_other_are_refused(door: str) -> None:
    region = cone_region()
    for valid in (region.valid[:1], region.valid[:, :1], region.valid[0]):
        with pytest.raises(ValueError, match="planes of one shape"):
            through(door, msgspec.structs.replace(region, valid=valid))


ODD = (
    *(
        {"altitude_m": high_m, "first_ground_range_m": near_m}
        for high_m in (0.3, 1.0, 30.0, 1e6)
        for near_m in RANGES_M
    ),
    *({"row": -500.0}, {"column": 9e8}, {"squint_rad": 0.78}, {"squint_rad": -0.4}, {"beam_width_rad": 3.1}),
)


@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize("change", ODD)
def test_odd_places_and_views_are_answered(door: str, change: dict[str, float]) -> None:
    through(door, msgspec.structs.replace(cone_region(), **change))
