"""Hard numbers through the classification by models: no floating-point flag, no NaN where a number is promised, the
same every time."""

from __future__ import annotations

import itertools
import math

import msgspec
import numpy as np
import pytest

from auv_mcm.classify.fit import SOLIDS, Effort, ShapeFits, fit_shapes
from auv_mcm.classify.likelihood import image_row_sums
from auv_mcm.confirm.region import Region
from auv_mcm.kernels.shape import FORBIDDEN, Beam, ImageRowSums, Solid, shape_costs, shape_costs_numpy
from auv_mcm.solids.shapes import Cylinder, Sphere, TruncatedCone
from tests.auv_mcm.classify.closed_forms import closed_form_region

SMALL = Effort(160, 4, 8, 6, 2, 8, 6)
BEAM = Beam(np.array([-0.005, 0.0, 0.005]), np.array([0.25, 0.5, 0.25]))


def speckled(seed: int = 1) -> Region:
    random = np.random.Generator(np.random.PCG64(seed))
    return closed_form_region(Sphere(radius_m=0.4), 18.0, random=random, beam_width_rad=0.007)


def sums_of(region: Region) -> ImageRowSums:
    image = image_row_sums(region, 1.5)
    assert image is not None
    return image


def fit(region: Region) -> ShapeFits:
    """With every floating-point flag an error."""
    with np.errstate(all="raise", under="ignore"):
        return fit_shapes(region, None, 1.5, effort=SMALL)


def all_finite(fits: ShapeFits) -> bool:
    values = [
        value for one in fits.fits for value in (one.best.cost, one.best.row, one.best.ground_range_m, one.plausibility)
    ]
    values += [value for best in fits.fits[:1] for value in (*best.contrast, *best.sigma.values())]
    return all(map(math.isfinite, values))


def test_a_shadow_without_any_echo_has_a_finite_cost() -> None:
    region = closed_form_region(Sphere(radius_m=0.4), 18.0, levels=(2.5, 0.0, 1.0))
    fits = fit(region)
    assert all_finite(fits)
    assert fits.fits[0].contrast[1] < 0.1


@pytest.mark.parametrize("altitude_m", [0.3, 0.5, 1.0, 30.0])
def test_no_cone_is_nearly_as_high_as_the_sonar(altitude_m: float) -> None:
    fits = fit(msgspec.structs.replace(speckled(), altitude_m=altitude_m))
    assert all_finite(fits)
    cones = [shape for one in fits.fits if isinstance(shape := one.best.shape, TruncatedCone)]
    assert all(altitude_m >= 1.2 * float(shape.height_m) for shape in cones)


@pytest.mark.parametrize("gain", [1e-310, 1e-300, 1e-6, 1e6, 1e300])
def test_gains_near_the_ends_of_the_numbers(gain: float) -> None:
    region = speckled()
    expected, got = fit(region), fit(msgspec.structs.replace(region, intensity=region.intensity * gain))
    assert all_finite(got)
    assert got.fits[0].solid == expected.fits[0].solid
    if gain > 1e-305:  # denormals have few digits left
        assert got.fits[0].best.cost == pytest.approx(expected.fits[0].best.cost, rel=0.02)


def test_a_million_pixels_do_not_underflow() -> None:
    region = speckled()
    tall = msgspec.structs.replace(
        region,
        intensity=np.tile(region.intensity, (100, 1)),
        valid=np.tile(region.valid, (100, 1)),
        row=region.row + 50 * 61,
    )
    image = sums_of(tall)
    hypothesis = np.array([[50 * 61 * 0.12 + 3.66, 18.0, 1.0, 0.4, 0.0, 0.0, 0.0, 0.0]])
    for costs in (shape_costs("sphere", hypothesis, image, BEAM), shape_costs_numpy("sphere", hypothesis, image, BEAM)):
        assert np.isfinite(costs.mean).all()
        assert costs.cost[0] == pytest.approx(
            shape_costs("sphere", hypothesis - [[366.0] + 7 * [0.0]], image, BEAM).cost[0], rel=1e-6
        )


def test_slices_that_graze_a_solid() -> None:
    """Offsets of exactly the radius, tops at exactly the sonar's clearance, solids sunk to nothing."""
    image = sums_of(speckled())
    radius = 0.42  # three and a half rows: slices touch the rim
    sphere = np.array(
        [
            [3.66 + shift, 18.0, 1.0, radius, burial, 0.0, 0.0, 0.0]
            for shift in (0.0, 0.06)
            for burial in (0.0, radius, 0.84)
        ]
    )
    cone = np.array(
        [[3.66 + shift, 18.0, 1.0, radius, top, 0.5, 0.0, 0.0] for shift in (0.0, 0.06) for top in (0.0, radius)]
    )
    high = np.array([[3.66, 18.0, 1.0, 2.5 + shift, 0.0, 0.0, 0.0, 0.0] for shift in (-1e-12, 0.0, 1e-12)])
    solid: Solid
    for solid, hypotheses in (("sphere", sphere), ("truncated_cone", cone), ("sphere", high)):
        with np.errstate(all="raise", under="ignore"):
            fast, slow = shape_costs(solid, hypotheses, image, BEAM), shape_costs_numpy(solid, hypotheses, image, BEAM)
        assert not np.isnan(fast.cost).any()
        np.testing.assert_allclose(fast.cost, slow.cost, atol=1e-6)


def test_cylinders_across_the_track_have_no_gap_between_their_azimuths() -> None:
    region = closed_form_region(Cylinder(radius_m=0.265, length_m=1.6, azimuth_rad=0.5 * math.pi), 18.0)
    azimuth = np.radians(np.linspace(89.9, 90.1, 41))
    azimuth = np.concatenate(
        (azimuth, 0.5 * math.pi + np.array([-1e-15, -1e-12, -1e-9, 0.0, 1e-9, 1e-12, 1e-15]), -azimuth)
    )
    hypotheses = np.tile([3.66, 18.0, 1.0, 0.265, 1.6, 0.0, 0.0, 0.0], (azimuth.size, 1))
    hypotheses[:, 5] = azimuth
    image = sums_of(region)
    for costs in (
        shape_costs("cylinder", hypotheses, image).cost,
        shape_costs_numpy("cylinder", hypotheses, image).cost,
    ):
        assert (costs < FORBIDDEN).all()
        sweep = costs[:41]
        assert np.abs(np.diff(sweep)).max() < 2.0
        assert np.ptp(costs[41:48]) < 0.01
        np.testing.assert_allclose(costs[48:], sweep, atol=1.0)  # backwards: the same solid but for the ends' order


@pytest.mark.parametrize("first_m", [0.0, 0.2, 1.0])
def test_objects_at_the_track(first_m: float) -> None:
    region = msgspec.structs.replace(speckled(), first_ground_range_m=first_m, column=8.0)
    assert all_finite(fit(region))
    image = sums_of(region)
    hypotheses = np.array(
        [[3.66, y, 1.0, 0.4, 0.0, 0.0, 0.0, 0.0] for y in (-1.0, 0.0, 0.4, math.nextafter(0.4, 1.0), 0.5)]
    )
    for costs in (shape_costs("sphere", hypotheses, image), shape_costs_numpy("sphere", hypotheses, image)):
        assert (costs.cost[:3] == FORBIDDEN).all()
        assert not np.isnan(costs.cost).any()


def test_every_corner_of_the_search_has_a_cost() -> None:
    image = sums_of(speckled())
    sizes: dict[Solid, list[tuple[float, ...]]] = {
        "sphere": [(1e-6, 3.0), (0.0, 1e-9)],
        "cylinder": [(1e-6, 0.5), (0.0, 1e-9, 5.0), (0.0, 0.5 * math.pi, math.pi), (0.0, 0.3)],
        "truncated_cone": [(1e-6, 1.0), (0.0, 1e-6), (1e-6, 1.0), (0.0, 0.9)],
        "wedge": [(1e-6, 2.0), (1e-6, 2.0), (1e-6, 1.0), (0.0, 0.5 * math.pi, math.pi), (0.0, 0.9)],
    }
    for solid in SOLIDS:
        corners = np.array(list(itertools.product(*sizes[solid])))
        hypotheses = np.zeros((len(corners), 8))
        hypotheses[:, :3] = 3.66, 18.0, 1.0
        hypotheses[:, 3 : 3 + corners.shape[1]] = corners
        fast, slow = (
            shape_costs(solid, hypotheses, image, BEAM).cost,
            shape_costs_numpy(solid, hypotheses, image, BEAM).cost,
        )
        assert not np.isnan(fast).any()
        np.testing.assert_allclose(fast, slow, atol=1e-5, err_msg=solid)
