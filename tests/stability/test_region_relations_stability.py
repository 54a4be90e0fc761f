"""What may be done to a region without an answer changing: gain, masked borders, anything where nothing was measured, a
mirror."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from auv_mcm import kernels
from auv_mcm.classify.fit import fit_shapes
from auv_mcm.classify.likelihood import beam_of, image_row_sums, labels_cost
from auv_mcm.confirm.mrf import segment
from auv_mcm.confirm.region import Region
from auv_mcm.confirm.snake import Start, converge
from auv_mcm.confirm.snake_rules import contour_mask
from auv_mcm.kernels.shape import Solid, shape_costs
from sim_replay.scoring.overlap import overlap
from tests.stability.region_doors import (
    DOORS,
    HYPOTHESIS,
    RANGE_M,
    SMALL,
    START,
    cone_region,
    labels_of,
    plain,
    through,
)

Plane = NDArray[np.float64]
EVERY_DOOR = pytest.mark.parametrize("door", DOORS)
HYPOTHESES: dict[Solid, Plane] = {
    "sphere": np.array([[2.4, RANGE_M, 1.0, 0.45, 0.05, 0.0, 0.0, 0.0]]),
    "cylinder": np.array([[2.3, RANGE_M, 0.95, 0.25, 1.2, 0.7, 0.0, 0.0]]),
    "truncated_cone": HYPOTHESIS,
    "wedge": np.array([[2.5, RANGE_M, 1.0, 1.02, 0.8, 0.385, 0.4, 0.02]]),
}


def costs_of(region: Region, hypotheses: dict[Solid, Plane]) -> list[float]:
    image = image_row_sums(region, 1.5)
    assert image is not None
    return [float(shape_costs(solid, rows, image, beam_of(region)).cost[0]) for solid, rows in hypotheses.items()]


@settings(max_examples=6 if kernels.backend() == "c" else 3)
@given(exponent=st.floats(-6.0, 6.0))
def test_gain_changes_no_label_no_contour_and_no_solid(exponent: float) -> None:
    region, gain = cone_region(), 10.0**exponent
    louder = msgspec.structs.replace(region, intensity=region.intensity * gain)
    np.testing.assert_array_equal(segment(louder).labels, segment(region).labels)
    contours, loud_contours = converge(region, START), converge(louder, START)
    np.testing.assert_array_equal(loud_contours.highlight, contours.highlight)
    np.testing.assert_array_equal(loud_contours.shadow, contours.shadow)
    assert loud_contours.reasons == contours.reasons
    fits, loud_fits = (fit_shapes(one, None, 1.5, effort=SMALL).fits for one in (region, louder))
    assert [fit.solid for fit in loud_fits] == [fit.solid for fit in fits]
    for fit, loud_fit in zip(fits, loud_fits, strict=True):
        assert loud_fit.best.cost == pytest.approx(fit.best.cost, rel=1e-5)
        for field, value in msgspec.structs.asdict(fit.best.shape).items():
            assert getattr(loud_fit.best.shape, field) == pytest.approx(value, rel=1e-5)
    assert through("labels_cost", louder) == pytest.approx(through("labels_cost", region), rel=1e-5)


@EVERY_DOOR
@pytest.mark.parametrize("power", [-900, -20, 20, 900])
def test_gain_of_a_power_of_two_changes_no_bit_but_the_means(door: str, power: int) -> None:
    region = cone_region(2)
    quiet, loud = (
        through(door, msgspec.structs.replace(region, intensity=region.intensity * gain)) for gain in (1.0, 2.0**power)
    )
    if isinstance(quiet, msgspec.Struct):
        names = [name for name in quiet.__struct_fields__ if name.endswith("_mean")]
        for name in names:
            assert getattr(loud, name) == getattr(quiet, name) * 2.0**power
        loud = msgspec.structs.replace(loud, **{name: getattr(quiet, name) for name in names})
    assert plain(loud) == plain(quiet)


@EVERY_DOOR
@pytest.mark.parametrize("share", [0.001, 0.1, 0.9])
def test_what_stands_where_nothing_was_measured_changes_no_bit(door: str, share: float) -> None:
    region = cone_region(3)
    random = np.random.Generator(np.random.PCG64(4))
    hole = random.random(region.intensity.shape) < share
    masked = msgspec.structs.replace(region, valid=~hole)
    expected = plain(through(door, masked))
    nonsense = random.choice([math.nan, math.inf, -math.inf, -3.0, 0.0, 1e300], region.intensity.shape)
    assert (
        plain(through(door, msgspec.structs.replace(masked, intensity=np.where(hole, nonsense, region.intensity))))
        == expected
    )
    for mark in (math.nan, math.inf, -1.0):  # the same said by the value alone
        assert (
            plain(through(door, msgspec.structs.replace(region, intensity=np.where(hole, mark, region.intensity))))
            == expected
        )


@EVERY_DOOR
def test_a_ping_that_is_not_a_number_is_a_ping_that_was_lost(door: str) -> None:
    region = cone_region(5)
    intensity, valid = region.intensity.copy(), region.valid.copy()
    intensity[21], valid[21] = math.nan, False
    by_value, by_mask = (
        through(door, one)
        for one in (msgspec.structs.replace(region, intensity=intensity), msgspec.structs.replace(region, valid=valid))
    )
    assert plain(by_value) == plain(by_mask)


def framed(region: Region, rows: int, columns: int) -> Region:
    """The region with that much masked border on every side."""
    around = ((rows, rows), (columns, columns))
    return msgspec.structs.replace(
        region,
        intensity=np.pad(region.intensity, around, constant_values=math.nan),
        valid=np.pad(region.valid, around),
        row=region.row + rows,
        column=region.column + columns,
        first_ground_range_m=region.first_ground_range_m - columns * region.column_spacing_m,
    )


@pytest.mark.parametrize(("rows", "columns"), [(1, 1), (6, 6), (3, 20)])
def test_a_masked_border_changes_hardly_a_label_and_no_cost(rows: int, columns: int) -> None:
    region = cone_region(6)
    wide = framed(region, rows, columns)
    inside = slice(rows, -rows), slice(columns, -columns)
    assert (segment(wide).labels[inside] != segment(region).labels).mean() < 0.01  # blocks start elsewhere
    shape = region.intensity.shape
    moved = Start(*(nodes + np.array([rows, columns]) for nodes in START))
    narrow_mask, wide_mask = (
        contour_mask(converge(region, START).shadow, shape),
        contour_mask(converge(wide, moved).shadow, wide.intensity.shape),
    )
    assert overlap(narrow_mask, wide_mask[inside]) > 0.9
    shifted = {solid: one + np.eye(1, 8) * rows * region.row_spacing_m for solid, one in HYPOTHESES.items()}
    np.testing.assert_allclose(costs_of(wide, shifted), costs_of(region, HYPOTHESES), rtol=1e-9)
    wide_labels = np.pad(labels_of(region), ((rows, rows), (columns, columns)))
    assert labels_cost(wide, wide_labels, 1.5) == pytest.approx(labels_cost(region, labels_of(region), 1.5), rel=1e-9)
    fits, wide_fits = (fit_shapes(one, None, 1.5, effort=SMALL).fits for one in (region, wide))
    assert wide_fits[0].solid == fits[0].solid
    assert wide_fits[0].best.ground_range_m == pytest.approx(fits[0].best.ground_range_m, abs=0.02)
    assert wide_fits[0].best.row - rows == pytest.approx(fits[0].best.row, abs=0.1)


def mirrored(region: Region) -> Region:
    height = region.intensity.shape[0]
    return msgspec.structs.replace(
        region, intensity=region.intensity[::-1].copy(), valid=region.valid[::-1].copy(), row=height - region.row
    )


@pytest.mark.parametrize("seed", range(3))
def test_a_mirror_along_the_track_mirrors_every_answer(seed: int) -> None:
    region = cone_region(seed)
    turned = mirrored(region)
    shape = region.intensity.shape
    # Raster order decides near ties along the border.
    assert (segment(turned).labels[::-1] != segment(region).labels).mean() < 0.01
    start = Start(*(np.abs(nodes - (shape[0], 0.0)) for nodes in START))
    there, back = converge(region, START), converge(turned, start)
    assert (
        overlap(contour_mask(there.shadow, shape), contour_mask(back.shadow, shape)[::-1]) > 0.85
    )  # nodes go in the other order
    assert there.rejected == back.rejected
    length_m = shape[0] * region.row_spacing_m
    opposite: dict[Solid, Plane] = {}
    for solid, one in HYPOTHESES.items():
        opposite[solid] = one.copy()
        opposite[solid][:, 0] = length_m - one[:, 0]
    opposite["cylinder"][:, 5] = -HYPOTHESES["cylinder"][:, 5]
    opposite["wedge"][:, 6] = math.pi - HYPOTHESES["wedge"][:, 6]
    np.testing.assert_allclose(costs_of(turned, opposite), costs_of(region, HYPOTHESES), rtol=1e-9)
    assert labels_cost(turned, labels_of(region)[::-1], 1.5) == pytest.approx(
        labels_cost(region, labels_of(region), 1.5), rel=1e-9
    )


@EVERY_DOOR
def test_no_door_writes_into_the_region(door: str) -> None:
    region = cone_region(7)
    assert not region.intensity.flags.writeable
    assert not region.valid.flags.writeable
    through(door, region)
