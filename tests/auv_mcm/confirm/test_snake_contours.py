"""Contours of drawn objects and of drawn sea floor, and the rules that separate them."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from auv_mcm.confirm import snake_rules
from auv_mcm.confirm.region import BACKGROUND, HIGHLIGHT, SHADOW, Region
from auv_mcm.confirm.snake import Contours, Start, converge, start_from_detection, start_from_labels
from auv_mcm.confirm.snake_rules import Findings, Spot, contour_mask
from sim_replay.scoring.overlap import overlap
from tests.make.drawn_contours import box, drawn_pair, plain_region, random_start

SHAPE = (128, 128)

N_STARTS = 20


def ripple_field(seed: int) -> Contours:
    """Ripples 0.3 to 1.5 m apart in any direction, with a detection on a crest."""
    random = np.random.default_rng(seed)
    rows, columns = np.meshgrid(np.arange(SHAPE[0]) * 0.1, np.arange(SHAPE[1]) * 0.06, indexing="ij")
    direction, wavelength = random.uniform(0.0, np.pi), random.uniform(0.3, 1.5)
    bend = 0.3 * np.sin(2.0 * np.pi * rows / random.uniform(4.0, 9.0))
    phase = 2.0 * np.pi * (rows * np.cos(direction) + (columns + bend) * np.sin(direction)) / wavelength
    mean = np.exp(1.2 * np.sin(phase))
    crest = np.argmax(np.where((np.abs(rows - 6.4) < 1.0) & (np.abs(columns - 3.0) < 1.0), mean, 0.0))
    row, column = np.unravel_index(crest, SHAPE)
    region = plain_region(mean * random.exponential(1.0, SHAPE), row=float(row), column=float(column))
    return converge(region, start_from_detection(region))


@pytest.fixture(scope="module")
def overlaps(n_runs: Callable[[int, int], int]) -> NDArray[np.float64]:
    """Shadow IoU, (image, start)."""
    found = np.empty((n_runs(6, 2), n_runs(N_STARTS, 4)))
    for seed in range(len(found)):
        drawn = drawn_pair(seed)
        for k in range(found.shape[1]):
            contours = converge(drawn.region, random_start(drawn, 100 * seed + k))
            assert not contours.rejected, (seed, k, contours.reasons)
            found[seed, k] = overlap(contour_mask(contours.shadow, SHAPE), drawn.shadow)
    return found


def test_shadow_is_found_from_any_of_many_starts(overlaps: NDArray[np.float64]) -> None:
    assert np.median(overlaps) >= 0.95
    assert np.quantile(overlaps, 0.05) >= 0.85


def test_starts_hardly_matter(overlaps: NDArray[np.float64]) -> None:
    assert np.median(overlaps.max(axis=1) - overlaps.min(axis=1)) < 0.05
    assert np.median(overlaps.std(axis=1)) < 0.02


@pytest.mark.parametrize("seed", range(6))
def test_shadow_is_found_from_a_corner_of_it(seed: int) -> None:
    """Fine moves alone stay there, or lose it: coarse ones go first."""
    drawn = drawn_pair(seed)
    rows, columns = np.nonzero(drawn.shadow)
    low, foot, far = int(rows.max()), int(columns.min()), int(columns.max())
    start = Start(box(low - 5, foot - 6, low, foot), box(low - 5, far - 10, low, far))
    contours = converge(drawn.region, start)
    assert overlap(contour_mask(contours.shadow, SHAPE), drawn.shadow) > 0.9


@pytest.mark.parametrize("seed", range(20, 26))
def test_object_is_confirmed_from_the_detection_alone(seed: int) -> None:
    drawn = drawn_pair(seed)
    start = start_from_detection(drawn.region)
    assert start.shadow[:, 1].min() >= drawn.region.column  # a shadow lies behind what casts it
    contours = converge(drawn.region, start)
    assert contours.reasons == ()
    assert overlap(contour_mask(contours.shadow, SHAPE), drawn.shadow) > 0.9
    assert overlap(contour_mask(contours.highlight, SHAPE), drawn.highlight) > 0.75
    assert contours.shadow_mean == pytest.approx(0.1, rel=0.25)
    assert contours.highlight_mean == pytest.approx(10.0**0.8, rel=0.25)
    assert contours.background_mean == pytest.approx(1.0, rel=0.05)
    pixel_m2 = drawn.region.row_spacing_m * drawn.region.column_spacing_m
    assert contours.highlight_area_m2 == pytest.approx(drawn.highlight.sum() * pixel_m2, rel=0.25)
    assert contours.gain > 100.0


@pytest.mark.parametrize("seed", [2, 20, 21])
@pytest.mark.parametrize(("before", "after"), [(2.5, 2.5), (4.0, 1.0), (1.0, 4.0)])
def test_a_shadow_beside_floor_far_brighter_than_the_regions_is_a_hole_in_it(
    seed: int, before: float, after: float
) -> None:
    drawn = drawn_pair(seed)
    rows, columns = np.nonzero(drawn.shadow)
    brighter = np.ones(SHAPE)
    brighter[rows.min() - 25 : rows.min(), columns.min() : columns.max() + 1] = before
    brighter[rows.max() + 1 : rows.max() + 26, columns.min() : columns.max() + 1] = after
    region = msgspec.structs.replace(drawn.region, intensity=brighter * drawn.region.intensity)
    assert "hole_in_bright" in converge(region, start_from_detection(region)).reasons


def test_height_is_that_of_the_ray_over_the_object() -> None:
    for seed in (0, 2, 4):  # parallelograms: every row the same length
        drawn = drawn_pair(seed)
        contours = converge(drawn.region, start_from_detection(drawn.region))
        columns = drawn.shadow.sum(axis=1)
        start = np.median(drawn.shadow.argmax(axis=1)[columns > 0])
        near_m = drawn.region.first_ground_range_m + start * drawn.region.column_spacing_m
        far_m = near_m + np.median(columns[columns > 0]) * drawn.region.column_spacing_m
        expected = 6.0 * (1.0 - math.hypot(near_m, 6.0) / math.hypot(far_m, 6.0))
        assert contours.height_m == pytest.approx(expected, abs=0.015)  # by ground ranges 0.03 more


def test_ripple_fields_are_rejected_with_reasons(n_runs: Callable[[int, int], int]) -> None:
    fields = [ripple_field(seed) for seed in range(n_runs(40, 8))]
    rejected = [field for field in fields if field.rejected]
    assert len(rejected) >= 0.9 * len(fields)
    assert all(not snake_rules.REJECTING.isdisjoint(field.reasons) for field in rejected)


def test_plain_speckle_is_rejected(n_runs: Callable[[int, int], int]) -> None:
    for seed in range(n_runs(10, 4)):
        region = plain_region(np.random.default_rng(seed).exponential(1.0, SHAPE), row=64.0, column=45.0)
        assert converge(region, start_from_detection(region)).rejected


def test_labels_with_holes_and_specks_are_start_enough() -> None:
    drawn = drawn_pair(4)
    labels = np.full(SHAPE, BACKGROUND, dtype=np.uint8)
    labels[drawn.shadow], labels[drawn.highlight] = SHADOW, HIGHLIGHT
    labels[np.random.default_rng(0).random(SHAPE) < 0.4] = BACKGROUND
    contours = converge(drawn.region, start_from_labels(drawn.region, labels))
    assert overlap(contour_mask(contours.shadow, SHAPE), drawn.shadow) > 0.95


def test_labels_of_another_shape_are_refused() -> None:
    with pytest.raises(ValueError, match="shape of the region"):
        start_from_labels(drawn_pair(0).region, np.zeros((3, 3), dtype=np.uint8))


def test_object_without_echo_keeps_its_shadow() -> None:
    drawn = drawn_pair(2)
    random = np.random.default_rng(1)
    flat = np.where(drawn.highlight, random.exponential(1.0, SHAPE), drawn.region.intensity)
    region = msgspec.structs.replace(drawn.region, intensity=flat)
    contours = converge(region, start_from_detection(region))
    assert contours.reasons == ("no_highlight",)
    assert len(contours.highlight) == 0
    assert math.isnan(contours.highlight_mean)
    assert overlap(contour_mask(contours.shadow, SHAPE), drawn.shadow) > 0.9


def band_of_shadow(seed: int, *, line_level: float, first_column: int = 0) -> Region:
    """A mast's shadow across the region from a column on, with a faint echo that crosses it, and a detection there."""
    random = np.random.Generator(np.random.PCG64(seed))
    mean = np.ones(SHAPE)
    mean[54:72, first_column:] = 0.01
    mean[50:72, 66:70] = line_level
    return plain_region(mean * random.exponential(1.0, SHAPE), row=63.0, column=68.0)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("line_level", [0.2, 0.5])
def test_what_lies_in_the_shadow_of_a_nearer_object_is_reported(seed: int, line_level: float) -> None:
    region = band_of_shadow(seed, line_level=line_level)
    assert "in_shadow" in converge(region, start_from_detection(region)).reasons


@pytest.mark.parametrize("seed", range(6))
def test_what_rises_out_of_a_shadow_with_a_bright_echo_is_not_lost_in_it(seed: int) -> None:
    drawn = drawn_pair(seed)
    first = np.argwhere(drawn.highlight)[:, 1].min()
    intensity = np.where(np.arange(SHAPE[1]) < first, 0.01 * drawn.region.intensity, drawn.region.intensity)
    contours = converge(msgspec.structs.replace(drawn.region, intensity=intensity), start_from_detection(drawn.region))
    assert len(contours.highlight)
    assert "in_shadow" not in contours.reasons


@pytest.mark.parametrize("seed", range(6))
def test_an_objects_own_shadow_is_not_that_of_something_nearer(seed: int) -> None:
    drawn = drawn_pair(seed)
    assert "in_shadow" not in converge(drawn.region, start_from_detection(drawn.region)).reasons
    lone = band_of_shadow(seed, line_level=5.0, first_column=66)
    assert "in_shadow" not in converge(lone, start_from_detection(lone)).reasons


def test_floor_not_measured_before_an_object_is_not_taken_for_shadow() -> None:
    drawn = drawn_pair(0)
    valid = np.arange(SHAPE[1]) >= np.argwhere(drawn.highlight)[:, 1].min() - 2
    region = msgspec.structs.replace(drawn.region, valid=np.broadcast_to(valid, SHAPE).copy())
    assert "in_shadow" not in converge(region, start_from_detection(region)).reasons


def test_way_round_of_the_start_does_not_matter() -> None:
    drawn = drawn_pair(3)
    start = random_start(drawn, 5)
    turned = Start(start.highlight[::-1], start.shadow[::-1])
    one, other = converge(drawn.region, start), converge(drawn.region, turned)
    assert overlap(contour_mask(one.shadow, SHAPE), contour_mask(other.shadow, SHAPE)) > 0.95
    assert "start_replaced" not in other.reasons


def test_correlated_speckle_counts_less() -> None:
    drawn = drawn_pair(0)
    start = start_from_detection(drawn.region)
    gains = [converge(drawn.region, start, correlation_px=area).gain for area in (1.0, 2.0, 4.0)]
    assert gains[0] > gains[1] > gains[2] > 0.0


@pytest.mark.parametrize("area", [0.5, 0.0, math.nan, math.inf])
def test_impossible_correlation_is_refused(area: float) -> None:
    drawn = drawn_pair(0)
    with pytest.raises(ValueError, match="correlation_px"):
        converge(drawn.region, start_from_detection(drawn.region), correlation_px=area)


GOOD = Findings(
    gain=150.0,
    highlight_mean=5.0,
    shadow_mean=0.1,
    background_mean=1.0,
    border=0.0,
    length_m=1.5,
    highlight_m2=0.5,
    highlight_depth_m=0.3,
    shadow_m2=3.0,
    largest_shadow_m2=6.0,
    height_m=0.4,
    peak_height_m=0.5,
    flank=1.0,
    front=1.0,
    repetition=0.1,
    common=0.05,
    spot=Spot(common=0.02, shadow_repetition=0.1, shadow_contrast=0.1),
)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"border": 0.5}, "touches_border"),
        ({"length_m": 0.2}, "too_short"),
        ({"length_m": 6.0}, "too_long"),
        ({"highlight_m2": 3.0}, "highlight_too_large"),
        ({"highlight_depth_m": 1.4}, "highlight_too_large"),
        ({"shadow_m2": 30.0}, "shadow_too_large"),
        ({"height_m": 0.05}, "too_low"),
        ({"peak_height_m": 0.11}, "too_low"),
        ({"height_m": 1.5}, "too_high"),
        ({"shadow_mean": 0.6}, "shadow_not_dark"),
        ({"flank": 0.2}, "shadow_goes_on"),
        ({"flank": 2.5}, "hole_in_bright"),
        ({"front": 0.05, "highlight_mean": math.nan}, "in_shadow"),
        ({"front": 0.05, "highlight_mean": 1.5}, "in_shadow"),
        ({"gain": -30.0}, "little_evidence"),
        ({"gain": math.nan}, "little_evidence"),
        ({"repetition": 0.9}, "repeats"),
        ({"common": 0.5}, "repeats"),
    ],
)
def test_each_rule_speaks_alone(change: dict[str, Any], reason: str) -> None:
    assert snake_rules.broken(GOOD) == ()
    assert snake_rules.broken(GOOD._replace(**change)) == (reason,)
    assert reason in snake_rules.REJECTING


def test_object_without_shadow_or_highlight_breaks_no_rule_about_them() -> None:
    unknown: dict[str, Any] = dict.fromkeys(
        ("shadow_mean", "height_m", "peak_height_m", "flank", "front", "highlight_mean", "highlight_depth_m"), math.nan
    )
    assert snake_rules.broken(GOOD._replace(**unknown)) == ()


def test_broken_rule_alone_rejects_nothing_and_grave_doubt_needs_one() -> None:
    long = GOOD._replace(length_m=6.0)
    assert snake_rules.doubt(GOOD) == 0.0
    assert not snake_rules.is_rejected(snake_rules.broken(long), long)
    grave = GOOD._replace(highlight_mean=2.0, height_m=0.05, repetition=0.5, spot=Spot(0.2, 2.5, 0.9))
    assert snake_rules.is_rejected(snake_rules.broken(grave), grave)
    assert not snake_rules.is_rejected(("no_shadow",), grave)


def test_contours_that_repeat_reject_where_what_they_started_from_repeats_too() -> None:
    repeated = GOOD._replace(repetition=0.9)
    assert not snake_rules.is_rejected(snake_rules.broken(repeated), repeated)
    everywhere = repeated._replace(spot=GOOD.spot._replace(common=0.5))
    assert snake_rules.is_rejected(snake_rules.broken(everywhere), everywhere)


@pytest.mark.parametrize("gain", [math.nan, -math.inf, -30.0])
def test_contours_that_explain_nothing_are_rejected_whatever_else_they_are_like(gain: float) -> None:
    assert snake_rules.is_rejected(("little_evidence",), GOOD._replace(gain=gain))


@pytest.mark.parametrize(
    "findings",
    [
        [GOOD._replace(length_m=length_m) for length_m in (1.5, 3.0, 4.0, 7.0)],
        [GOOD._replace(highlight_m2=area_m2) for area_m2 in (0.5, 1.0, 2.0, 3.0)],
        [GOOD._replace(height_m=height_m) for height_m in (0.5, 0.2, 0.1, 0.01)],
        [GOOD._replace(flank=flank) for flank in (1.0, 0.5, 0.4, 0.0)],
        [GOOD._replace(repetition=repetition) for repetition in (0.0, 0.2, 0.5, math.inf)],
        [GOOD._replace(gain=gain) for gain in (50.0, -7.0, -10.0, -40.0)],
        [GOOD._replace(spot=Spot(*spot, 0.1)) for spot in ((0.0, 0.0), (0.05, 0.4), (0.2, 1.0), (math.inf, math.inf))],
    ],
    ids=["long", "large echo", "low", "goes on", "repeats", "little evidence", "common"],
)
def test_doubt_grows_with_what_speaks_against_an_object(findings: list[Findings]) -> None:
    doubts = [snake_rules.doubt(found) for found in findings]
    assert doubts == sorted(set(doubts))
    assert all(math.isfinite(doubt) for doubt in doubts)


def test_floor_measured_in_one_row_only_holds_no_object() -> None:
    drawn = drawn_pair(2)
    valid = np.zeros(SHAPE, dtype=np.bool_)
    valid[int(drawn.region.row)] = True
    region = msgspec.structs.replace(drawn.region, valid=valid)
    contours = converge(region, start_from_detection(region))
    assert contours.rejected
    assert "not_measured" in contours.reasons


@pytest.mark.parametrize(
    "change",
    [
        {"row": math.nan},
        {"column": math.nan},
        {"altitude_m": math.nan},
        {"row_spacing_m": 0.0},
        {"first_ground_range_m": math.inf},
    ],
)
def test_start_needs_known_geometry(change: dict[str, float]) -> None:
    region = msgspec.structs.replace(drawn_pair(0).region, **change)
    with pytest.raises(ValueError, match=next(iter(change))):
        start_from_detection(region)
    assert converge(region, random_start(drawn_pair(0), 0)).reasons == ("geometry_unknown",)
