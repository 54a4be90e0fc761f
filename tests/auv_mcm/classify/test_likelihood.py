"""Costs of solids against pixels counted one by one, C against numpy, and what must not change a cost."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from auv_mcm.classify.likelihood import beam_of, image_row_sums, labels_cost, parameter_cost
from auv_mcm.confirm.region import BACKGROUND, HIGHLIGHT, SHADOW, Region
from auv_mcm.kernels.shape import (
    FIELDS,
    FORBIDDEN,
    MIN_MEAN,
    PENCIL,
    Beam,
    ImageRowSums,
    Solid,
    shape_costs,
    shape_costs_numpy,
    solid_of,
)
from auv_mcm.solids.shapes import Cylinder, Sphere, TruncatedCone, Wedge, flat_ground_range_m, view_shape
from tests.auv_mcm.classify.closed_forms import closed_form_region
from tests.make.random_numbers import generator

Array = NDArray[np.float64]
N_ROWS, N_COLUMNS = 40, 110
ROW_M, COLUMN_M, FIRST_M, ALTITUDE_M = 0.12, 0.06, 14.0, 6.0
SOLIDS: list[Solid] = list(FIELDS)
BEAM = Beam(np.radians([-0.3, 0.0, 0.3]), np.array([0.25, 0.5, 0.25]))


def picture(seed: int, *, masked: float = 0.0) -> Region:
    """Speckle with a bright and a dark patch about where the hypotheses below have theirs."""
    random = generator(seed)
    intensity = random.exponential(size=(N_ROWS, N_COLUMNS))
    intensity[15:26, 12:30] *= 6.0
    intensity[15:26, 30:60] *= 0.1
    return Region(
        intensity=intensity,
        valid=random.uniform(size=intensity.shape) >= masked,
        row_spacing_m=ROW_M,
        column_spacing_m=COLUMN_M,
        first_ground_range_m=FIRST_M,
        altitude_m=ALTITUDE_M,
        row=20.5,
        column=20.0,
        beam_width_rad=0.0,
    )


def sums_of(region: Region, correlation_area: float = 1.0) -> ImageRowSums:
    image = image_row_sums(region, correlation_area)
    assert image is not None
    return image


def some(solid: Solid, n: int, seed: int, *, buried: bool = True) -> Array:
    """Hypotheses about the middle of the picture."""
    random = generator(seed)
    low, high = {
        "sphere": ([0.25, 0.0], [0.6, 0.3]),
        "cylinder": ([0.15, 0.3, -1.6, 0.0], [0.4, 2.5, 1.6, 0.2]),
        "truncated_cone": ([0.3, 0.0, 0.3, 0.0], [0.7, 0.3, 0.7, 0.2]),
        "wedge": ([0.5, 0.4, 0.3, -3.2, 0.0], [1.4, 1.2, 0.6, 3.2, 0.25]),
    }[solid]
    hypotheses = np.zeros((n, 8))
    hypotheses[:, 0] = random.uniform(2.2, 2.7, n)
    hypotheses[:, 1] = random.uniform(15.2, 15.8, n)
    hypotheses[:, 2] = random.uniform(0.9, 1.1, n)
    hypotheses[:, 3 : 3 + len(low)] = random.uniform(low, high, (n, len(low)))
    if not buried:
        hypotheses[:, 2 + len(low)] = 0.0
    return hypotheses


def foot_of_wedge(hypothesis: Array, offset_m: float) -> float:
    """Least ground range of a wedge's footprint in a slice, from its place, by walking along the slice."""
    length, _, height, azimuth, burial = hypothesis[3:8].tolist()
    y = np.linspace(-1.5, 1.5, 300_001)
    along, across = (
        offset_m * math.cos(azimuth) + y * math.sin(azimuth),
        y * math.cos(azimuth) - offset_m * math.sin(azimuth),
    )
    inside = (
        (np.abs(across) <= 0.5 * hypothesis[4]) & (along <= 0.5 * length) & (along >= (burial / height - 0.5) * length)
    )
    return float(y[inside].min()) if inside.any() else math.nan


def labelled(solid: Solid, hypothesis: Array, image: ImageRowSums, bearing_rad: float) -> Array:
    """Share of each pixel in highlight and in shadow, (n_rows, n_columns, 2), worked out pixel by pixel for one slice
    of the beam."""
    share = np.zeros((N_ROWS, N_COLUMNS, 2))
    along, across, altitude = float(hypothesis[0]), float(hypothesis[1]), float(hypothesis[2]) * ALTITUDE_M
    shape = solid_of(solid, hypothesis[np.newaxis, 3:])
    for row in range(N_ROWS):
        offset = (row + 0.5) * ROW_M - along + bearing_rad * math.hypot(across, altitude)
        view = view_shape(shape, [[offset]], across, altitude)
        slant = [
            view.front_slant_range_m.item(),
            view.tangent_slant_range_m.item(),
            math.hypot(view.shadow_end_m.item(), altitude),
        ]
        if math.isnan(slant[0]):
            continue
        if solid == "wedge":
            slant[1] = max(slant[1], math.hypot(across + foot_of_wedge(hypothesis, offset), altitude))
        front, tangent, end = flat_ground_range_m(slant, ALTITUDE_M).tolist()
        front, tangent = front - image.smear_m, tangent + image.smear_m
        for column in range(N_COLUMNS):
            near, far = FIRST_M + column * COLUMN_M, FIRST_M + (column + 1) * COLUMN_M
            share[row, column, 0] = max(0.0, min(far, tangent) - max(near, front)) / COLUMN_M
            share[row, column, 1] = max(0.0, min(far, max(end, tangent)) - max(near, tangent)) / COLUMN_M
    return share


def cost_by_pixels(solid: Solid, hypothesis: Array, image: ImageRowSums) -> float:
    """The definition: every pixel's share of its echo belongs to highlight, shadow or floor, each with the mean it
    has."""
    echoes, counts = np.diff(image.echoes, axis=1), np.diff(image.counts, axis=1)
    share = labelled(solid, hypothesis, image, 0.0)
    share = np.dstack((share, 1.0 - share.sum(axis=2)))
    cost = 0.0
    means = []
    for k in range(3):
        n, total = float((counts * share[..., k]).sum()), float((echoes * share[..., k]).sum())
        means.append(max(total / n, MIN_MEAN))
        cost += n * math.log(means[k]) + total / means[k] - n
    assert means[0] >= 1.3 * means[2]
    assert means[1] <= 0.6 * means[2]
    return image.samples_per_pixel * cost


@pytest.mark.parametrize("solid", SOLIDS)
def test_cost_is_that_of_counting_pixels_one_by_one(solid: Solid) -> None:
    image = sums_of(picture(3, masked=0.1), correlation_area=1.7)
    hypotheses = some(solid, 40, 1)
    costs = shape_costs(solid, hypotheses, image).cost
    allowed = np.flatnonzero(costs < FORBIDDEN)
    assert allowed.size >= 4
    for k in allowed[:4]:
        assert costs[k] == pytest.approx(
            cost_by_pixels(solid, hypotheses[k], image), abs=1e-2 if solid == "wedge" else 1e-7
        )


@pytest.mark.parametrize("solid", SOLIDS)
def test_a_beam_mixes_the_means_of_its_slices(solid: Solid) -> None:
    """By pixels: w_k mu_k add up in every pixel. Within a pixel the kernel cuts where a stretch ends, so noise-free
    pixels only."""
    hypothesis = some(solid, 1, 2, buried=False)
    hypothesis[0, :2] = 2.43, 15.5
    region = picture(0)
    share = sum(
        w * labelled(solid, hypothesis[0], sums_of(region), b)
        for b, w in zip(BEAM.bearing_rad, BEAM.share, strict=True)
    )
    level = 1.0 + share[..., 0] * 1.9 - share[..., 1] * 0.9
    image = sums_of(msgspec.structs.replace(region, intensity=level))
    blurred, sharp = (shape_costs(solid, hypothesis, image, beam) for beam in (BEAM, PENCIL))
    assert blurred.cost[0] < sharp.cost[0]
    for costs, tolerance in ((blurred, 0.35), (sharp, 2.0)):
        np.testing.assert_allclose(costs.mean[0] / costs.mean[0, 2], [2.9, 0.1, 1.0], rtol=tolerance)
    assert blurred.mean[0, 1] < sharp.mean[0, 1]


@given(
    solid=st.sampled_from(SOLIDS),
    seed=st.integers(0, 10**6),
    with_beam=st.booleans(),
    masked=st.sampled_from([0.0, 0.3]),
    buried=st.booleans(),
    squint_rad=st.sampled_from([0.0, -0.2]),
)
@settings(max_examples=60, deadline=None)
def test_c_and_numpy_agree(
    solid: Solid, seed: int, with_beam: bool, masked: float, buried: bool, squint_rad: float
) -> None:
    region = msgspec.structs.replace(picture(seed, masked=masked), squint_rad=squint_rad)
    image, beam = sums_of(region), BEAM if with_beam else PENCIL
    hypotheses = some(solid, 6, seed, buried=buried)
    fast, slow = shape_costs(solid, hypotheses, image, beam), shape_costs_numpy(solid, hypotheses, image, beam)
    np.testing.assert_allclose(fast.cost, slow.cost, atol=1e-9 * N_ROWS * N_COLUMNS)
    np.testing.assert_allclose(fast.mean, slow.mean, rtol=1e-9)


@given(solid=st.sampled_from(SOLIDS), seed=st.integers(0, 10**6))
@settings(max_examples=20, deadline=None)
def test_cost_is_continuous(solid: Solid, seed: int) -> None:
    hypotheses = np.repeat(some(solid, 1, seed), 2, axis=0)
    hypotheses[1, 1] += 1e-7
    near, far = shape_costs(solid, hypotheses, sums_of(picture(seed)), BEAM).cost
    assert near >= FORBIDDEN or far >= FORBIDDEN or abs(near - far) < 0.01


def test_the_object_that_made_a_picture_costs_less_than_its_neighbours() -> None:
    for solid, shape, fields in (
        ("sphere", Sphere(radius_m=0.4), (0.4, 0.0)),
        ("cylinder", Cylinder(radius_m=0.27, length_m=2.0, azimuth_rad=0.5), (0.27, 2.0, 0.5, 0.0)),
        (
            "truncated_cone",
            TruncatedCone(base_radius_m=0.49, top_radius_m=0.25, height_m=0.47),
            (0.49, 0.25, 0.47, 0.0),
        ),
        ("wedge", Wedge(length_m=1.02, width_m=0.8, height_m=0.385, azimuth_rad=1.2), (1.02, 0.8, 0.385, 1.2, 0.0)),
    ):
        image = sums_of(closed_form_region(shape, 20.0, levels=(2.9, 0.1, 1.0)))
        hypotheses = np.zeros((1 + 2 * (2 + len(fields)), 8))
        hypotheses[:, :3] = 3.66, 20.0, 1.0
        hypotheses[:, 3 : 3 + len(fields)] = fields
        columns = [0, 1, *range(3, 3 + len(fields))]
        for k, column in enumerate(columns):
            hypotheses[1 + 2 * k : 3 + 2 * k, column] += 0.06, -0.06
        hypotheses[-1, columns[-1]] = 0.08  # burial is never negative
        costs = shape_costs(solid, hypotheses, image).cost  # type: ignore[arg-type]  # a literal of the tuple above
        assert costs.argmin() == 0, solid


def test_a_floor_without_an_object_has_no_explanation_by_one() -> None:
    region = msgspec.structs.replace(picture(0), intensity=np.ones((N_ROWS, N_COLUMNS)))
    for solid in SOLIDS:
        assert (shape_costs(solid, some(solid, 20, 0), sums_of(region)).cost == FORBIDDEN).all()


def test_solids_at_the_track_or_as_high_as_the_sonar_are_forbidden() -> None:
    image = sums_of(msgspec.structs.replace(picture(0), first_ground_range_m=0.0))
    at_track, high = np.zeros((1, 8)), np.zeros((1, 8))
    at_track[0, :4] = 2.4, 0.39, 1.0, 0.4
    high[0, :4] = 2.4, 8.0, 0.4 / ALTITUDE_M, 0.4
    for hypotheses in (at_track, high):
        for costs in (shape_costs("sphere", hypotheses, image), shape_costs_numpy("sphere", hypotheses, image)):
            assert costs.cost[0] == FORBIDDEN
            assert np.isnan(costs.mean).all()


def test_a_solid_that_leaves_no_floor_in_the_image_is_forbidden() -> None:
    """The object and its shadow fill it all: what is left of it for a floor is rounding."""
    random = generator(3)
    region = msgspec.structs.replace(
        picture(8),
        intensity=random.exponential(size=(11, 33)) * np.where(np.arange(33) < 13, 6.0, 0.1),
        valid=np.ones((11, 33), dtype=np.bool_),
        first_ground_range_m=8.0,
        altitude_m=3.2,
    )
    hypotheses = np.tile([0.66, 8.2, 1.0, 1.0, 1.2, 0.5 * math.pi, 0.0, 0.0], (400, 1))
    hypotheses[:, :2] += random.uniform((-0.1, 0.0), (0.1, 0.3), (400, 2))
    for costs in (shape_costs, shape_costs_numpy):
        assert (costs("cylinder", hypotheses, sums_of(region)).cost == FORBIDDEN).all()


def test_squinted_rows_are_slices_again() -> None:
    shape = Cylinder(radius_m=0.27, length_m=1.8, azimuth_rad=0.3)
    squint = 0.12
    region = closed_form_region(shape, 20.0, squint_rad=squint, levels=(2.9, 0.1, 1.0))
    image = sums_of(region)
    hypotheses = np.zeros((2, 8))
    middle_m = region.first_ground_range_m + region.column * COLUMN_M
    hypotheses[:, 0] = (3.66 - (20.0 - middle_m) * math.tan(squint)) * math.cos(squint)
    hypotheses[:, 1] = 20.0 / math.cos(squint)
    hypotheses[:, 2:5] = 1.0, 0.27, 1.8
    hypotheses[:, 5] = 0.3 + squint, 0.3
    right, as_if_broadside = shape_costs("cylinder", hypotheses, image).cost
    assert right < as_if_broadside
    parts = [region.intensity > 2.0, region.intensity < 0.5]
    labels = np.select(parts, [HIGHLIGHT, SHADOW], BACKGROUND).astype(np.uint8)
    drawn = labels_cost(msgspec.structs.replace(region, squint_rad=0.0), labels, 1.0)
    assert labels_cost(region, labels, 1.0) == pytest.approx(drawn, rel=0.05)
    hypotheses[1, :2], broadside = (3.66, 20.0), closed_form_region(shape, 20.0, levels=(2.9, 0.1, 1.0))
    assert right < 0.85 * shape_costs("cylinder", hypotheses[1:], sums_of(broadside)).cost[0]


def test_labels_cost_what_their_pixels_explain() -> None:
    region = picture(1)
    labels = np.full(region.valid.shape, BACKGROUND, dtype=np.uint8)
    assert labels_cost(region, labels, 1.0) == pytest.approx(0.0, abs=1e-9)
    labels[15:26, 12:30], labels[15:26, 30:60] = HIGHLIGHT, SHADOW
    echoes = np.diff(sums_of(region).echoes, axis=1)
    parts = [echoes[labels == label] for label in (BACKGROUND, SHADOW, HIGHLIGHT)]
    assert labels_cost(region, labels, 2.0) == pytest.approx(
        0.5 * sum(part.size * math.log(part.mean()) for part in parts), rel=1e-9
    )
    with pytest.raises(ValueError, match="labels must have the region's shape"):
        labels_cost(region, labels[1:], 1.0)


def test_a_parameter_costs_half_the_logarithm_of_the_samples() -> None:
    image = sums_of(picture(1), correlation_area=2.0)
    assert parameter_cost(3, image) == pytest.approx(1.5 * math.log(0.5 * N_ROWS * N_COLUMNS))


def test_beams_narrower_than_the_rows_are_pencils() -> None:
    region = picture(1)
    assert beam_of(region) is PENCIL
    beam = beam_of(msgspec.structs.replace(region, beam_width_rad=0.01))
    sigma = 0.01 / math.sqrt(8.0 * math.log(2.0))
    assert beam.share.sum() == pytest.approx(1.0)
    assert (beam.share * beam.bearing_rad**2).sum() == pytest.approx(sigma**2)
    assert (beam.share * beam.bearing_rad**4).sum() == pytest.approx(3.0 * sigma**4)


def test_regions_without_echoes_have_no_sums() -> None:
    region = picture(1)
    assert image_row_sums(msgspec.structs.replace(region, valid=np.zeros_like(region.valid)), 1.0) is None
    assert image_row_sums(msgspec.structs.replace(region, intensity=np.zeros_like(region.intensity)), 1.0) is None


@pytest.mark.parametrize(
    ("change", "area", "message"),
    [
        ({"altitude_m": 0.0}, 1.0, "must be positive"),
        ({"row_spacing_m": math.nan}, 1.0, "must be positive"),
        ({"valid": np.ones((2, 2), dtype=np.bool_)}, 1.0, "planes of one shape"),
        ({}, 0.5, "correlation_area must be at least 1"),
    ],
)
def test_regions_that_cannot_be_are_refused(change: dict[str, object], area: float, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        image_row_sums(msgspec.structs.replace(picture(1), **change), area)


@pytest.mark.parametrize(
    ("column", "value", "message"),
    [(3, 0.0, "radius_m of a Sphere must be positive"), (4, -0.1, "burial_m"), (1, math.nan, "finite")],
)
def test_hypotheses_that_cannot_be_are_refused(column: int, value: float, message: str) -> None:
    hypotheses = some("sphere", 2, 0)
    hypotheses[1, column] = value
    with pytest.raises(ValueError, match=message):
        shape_costs("sphere", hypotheses, sums_of(picture(1)))


def test_planes_of_wrong_shape_and_even_beams_are_refused() -> None:
    image = sums_of(picture(1))
    with pytest.raises(ValueError, match="shape"):
        shape_costs("sphere", np.zeros((2, 7)), image)
    with pytest.raises(ValueError, match="odd number of slices"):
        shape_costs("sphere", some("sphere", 1, 0), image, Beam(np.zeros(2), np.full(2, 0.5)))
