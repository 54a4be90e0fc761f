"""Features are finite numbers of moderate size, whatever was measured or was not."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.classify.details import detection_details
from auv_mcm.classify.features import (
    Features,
    compressed,
    contour_features,
    detector_features,
    outline_features,
    shape_features,
    with_shape,
)
from auv_mcm.classify.fit import Highlight, Optimum, ShapeFit
from auv_mcm.confirm.region import BACKGROUND, HIGHLIGHT, SHADOW
from auv_mcm.confirm.snake_rules import REJECTING
from auv_mcm.records import NAN
from auv_mcm.solids.shapes import Sphere
from tests.auv_mcm.classify.drawn_looks import bare_floor, detection, no_contours, no_fits

SQUARE = np.array([(0.0, 0.0), (0.0, 4.0), (4.0, 4.0), (4.0, 0.0)])
NO_LABELS = np.empty((0, 0), dtype=np.uint8)

anything = st.floats() | st.sampled_from([0.0, -0.0, 1e-320, 1e300, -1e300])


def fit_of(
    cost: float, plausibility: float = 1.0, altitude_ratio: float = 1.0, flags: tuple[str, ...] = ()
) -> ShapeFit:
    return ShapeFit(
        solid="sphere",
        best=Optimum(
            shape=Sphere(radius_m=0.4), row=5.0, ground_range_m=12.0, altitude_ratio=altitude_ratio, cost=cost
        ),
        second=None,
        sigma={},
        ends=((0.0, 0.0, 0.0),),
        plausibility=plausibility,
        contrast=(4.0, 0.2),
        highlight=Highlight(model_across_m=0.2, observed_across_m=0.2, n_samples=20.0),
        refined=True,
        flags=flags,
    )


def assert_moderate(features: Features) -> None:
    for name, value in features.items():
        assert isinstance(value, float), name
        assert math.isfinite(value), name
        assert abs(value) < 1000.0, name


# ---------------------------------------------------------------- compressed evidence


@given(st.floats(-1e300, 1e300))
def test_compressed_is_odd(nats: float) -> None:
    assert compressed(-nats) == -compressed(nats)
    assert compressed(nats) == pytest.approx(
        math.copysign(1.0, nats) * math.log(1.0 + abs(nats) / 5.0), abs=1e-15, rel=1e-12
    )


# ---------------------------------------------------------------- the detector


@given(anything, anything, st.floats(0.0, 1.0))
def test_any_levels_of_a_detection_are_described_by_finite_numbers(
    highlight_db: float, shadow_db: float, p_mine: float
) -> None:
    features = detector_features(detection(highlight_db=highlight_db, shadow_db=shadow_db, p_mine=p_mine))
    assert all(map(math.isfinite, features.values()))
    assert abs(features["detector_odds"]) <= 6.0


def test_a_detection_is_described_by_its_odds_its_levels_and_what_was_missing() -> None:
    reported = detector_features(
        detection(p_mine=0.8, highlight_db=9.0, shadow_db=NAN, reasons=("no_shadow", "in_turn"))
    )
    assert reported == {
        "detector_odds": pytest.approx(math.log(4.0)),
        "highlight_db": 9.0,
        "shadow_db": 0.0,
        "no_highlight": 0.0,
        "no_shadow": 1.0,
        "too_large": 0.0,
        "crowded": 0.0,
        "range": pytest.approx(math.log(12.0 / 5.0)),
        "range_squared": pytest.approx(math.log(12.0 / 5.0) ** 2),
        "detector_odds_by_range": pytest.approx(math.log(4.0) * math.log(12.0 / 5.0)),
        "highlight_db_by_range": pytest.approx(9.0 * math.log(12.0 / 5.0)),
    }


@given(anything, anything)
def test_any_place_of_a_detection_is_described_by_finite_numbers(ground_range_m: float, altitude_m: float) -> None:
    assert_moderate(detector_features(detection(ground_range_m=ground_range_m, altitude_m=altitude_m)))


# ---------------------------------------------------------------- contours


def test_no_contours_at_all_count_as_little_evidence() -> None:
    features = contour_features(no_contours())
    assert_moderate(features)
    assert features["contour_without_highlight"] == features["contour_without_shadow"] == 1.0
    assert features["contour_gain"] < contour_features(no_contours(gain=-20.0))["contour_gain"]
    assert features["contour_shadow"] == 1.0, "no shadow is as bright as the floor"


@given(st.fixed_dictionaries(dict.fromkeys(("gain", "shadow_mean", "background_mean", "repetition"), anything)))
def test_any_contours_are_described_by_finite_numbers(measured: dict[str, float]) -> None:
    features = contour_features(no_contours(highlight=SQUARE, shadow=SQUARE, height_m=0.4, **measured))
    assert all(map(math.isfinite, features.values()))


@given(anything)
def test_heights_that_are_no_number_count_as_none(height_m: float) -> None:
    assert contour_features(no_contours(height_m=height_m))["contour_height_m"] == (
        height_m if math.isfinite(height_m) else 0.0
    )


def test_contours_are_described_by_gain_repetition_darkness_and_rules() -> None:
    broken = sorted(REJECTING)
    measured: dict[str, Any] = {
        "highlight": SQUARE,
        "shadow": SQUARE,
        "gain": 45.0,
        "repetition": 0.5,
        "height_m": 0.4,
        "shadow_mean": 0.1,
        "background_mean": 0.8,
        "reasons": (broken[0], "weak_highlight"),
    }
    assert contour_features(no_contours(**measured)) == {
        "contour_gain": pytest.approx(math.log(10.0)),
        "contour_repetition": pytest.approx(math.log(1.5)),
        "contour_height_m": 0.4,
        "contour_shadow": pytest.approx(0.125),
        "contour_rules_broken": 1.0,
        "contour_without_highlight": 0.0,
        "contour_without_shadow": 0.0,
    }
    assert contour_features(no_contours(reasons=tuple(broken)))["contour_rules_broken"] == 3.0


# ---------------------------------------------------------------- outlines


def outline(near: Sequence[float], far: Sequence[float], top: int = 5) -> np.ndarray[Any, np.dtype[np.float64]]:
    """A contour with these columns as edges of each row: up the near side, down the far one."""
    rows = np.repeat(np.arange(top, top + len(near)), 2) + np.tile([0.0, 1.0], len(near))
    down = np.column_stack([rows, np.repeat(far, 2)])
    return np.concatenate([down, np.column_stack([rows, np.repeat(near, 2)])[::-1]])


def test_no_outlines_have_no_extent_and_do_not_bend() -> None:
    reported = outline_features(no_contours(), bare_floor())
    assert_moderate(reported)
    assert all(reported[name] == 0.0 for name in reported if name.endswith("_m"))


def test_outlines_are_described_by_extents_level_and_area() -> None:
    contours = no_contours(
        highlight=outline([10] * 8, [14] * 8),
        shadow=outline([14] * 6, [30] * 6),
        highlight_mean=4.0,
        background_mean=0.8,
        highlight_area_m2=0.16,
    )
    reported = outline_features(contours, bare_floor())
    assert reported["highlight_length_m"] == pytest.approx(0.8)
    assert reported["shadow_length_m"] == pytest.approx(0.6)
    assert reported["highlight_level"] == pytest.approx(math.log(5.0))
    assert reported["highlight_area"] == pytest.approx(math.log(0.17))


def test_bends_and_jumps_are_those_of_a_polynomial_fit() -> None:
    near = [10, 12, 13, 13, 14, 13, 13, 12, 10, 11]
    far = [20, 25, 28, 30, 31, 30, 29, 26, 24, 20]
    reported = outline_features(no_contours(shadow=outline(near, far), highlight=outline(near, far)), bare_floor())
    rows = np.arange(10.0)
    near_m, far_m = 0.05 * np.array(near), 0.05 * np.array(far)
    assert reported["highlight_front_bend_m"] == pytest.approx(abs(np.polyfit(rows, near_m, 2)[0]) * 100.0)
    assert reported["shadow_end_bend_m"] == pytest.approx(abs(np.polyfit(rows, far_m, 2)[0]) * 100.0)
    assert reported["shadow_front_roughness_m"] == pytest.approx(
        (near_m - np.polyval(np.polyfit(rows, near_m, 1), rows)).std()
    )


def test_two_or_three_rows_cannot_bend() -> None:
    reported = outline_features(no_contours(shadow=outline([10, 20, 10], [30, 40, 30])), bare_floor())
    assert reported["shadow_end_bend_m"] == reported["shadow_front_roughness_m"] == 0.0


# ---------------------------------------------------------------- solids


def test_no_solid_counts_as_less_than_a_poor_one() -> None:
    none, poor = shape_features(no_fits(), NO_LABELS), shape_features(no_fits(fits=(fit_of(0.0),)), NO_LABELS)
    assert_moderate(none)
    assert none["shape_evidence"] < poor["shape_evidence"]
    assert none["shape_evidence_of_usual_size"] < poor["shape_evidence_of_usual_size"]
    assert none["labelled_highlight"] == 0.0


@given(
    st.lists(st.tuples(anything, anything, anything), max_size=4),
    st.none() | anything,
    st.sampled_from([NO_LABELS, np.ones((2, 3), np.uint8)]),
)
def test_any_solids_are_described_by_finite_numbers(
    solids: list[tuple[float, float, float]], contour_cost: float | None, labels: np.ndarray[Any, np.dtype[np.uint8]]
) -> None:
    fits = no_fits(fits=tuple(fit_of(*solid) for solid in solids), contour_cost=contour_cost)
    assert all(map(math.isfinite, shape_features(fits, labels).values()))


def test_the_best_solid_and_the_best_of_usual_size_are_distinguished() -> None:
    """Costs -40 at an unusual size and -30 at a usual one: four nats per e-fold of plausibility turn the order."""
    fits = no_fits(fits=(fit_of(-40.0, 0.01, 1.1, ("at_bound",)), fit_of(-30.0)), contour_cost=-60.0)
    labels = np.array([[HIGHLIGHT, SHADOW, BACKGROUND, BACKGROUND]], dtype=np.uint8)
    assert shape_features(fits, labels) == {
        "shape_evidence": pytest.approx(math.log(9.0)),
        "shape_evidence_of_usual_size": pytest.approx(math.log(7.0)),
        "shape_plausibility": 0.01,
        "shape_over_contours": pytest.approx(-math.log(5.0)),
        "shape_altitude_off": pytest.approx(0.1),
        "at_bound": 1.0,
        "cut_off": 0.0,
        "labelled_highlight": 0.25,
        "highlight_deeper_m": 0.0,
        "burial_m": 0.0,
    }


def test_evidence_of_shape_is_described_by_range_as_well() -> None:
    before, shape = detector_features(detection()), shape_features(no_fits(fits=(fit_of(-40.0),)), NO_LABELS)
    reported = with_shape(before, shape)
    assert reported.keys() == {*before, *shape, "shape_evidence_by_range"}
    assert reported["shape_evidence_by_range"] == pytest.approx(math.log(9.0) * math.log(12.0 / 5.0))


@given(st.floats(-200.0, 50.0), st.floats(0.1, 50.0))
def test_a_solid_that_explains_more_counts_for_more(cost: float, better: float) -> None:
    worse, best = (shape_features(no_fits(fits=(fit_of(nats),)), NO_LABELS) for nats in (cost, cost - better))
    assert best["shape_evidence"] > worse["shape_evidence"]
    assert best["shape_evidence_of_usual_size"] > worse["shape_evidence_of_usual_size"]


@given(
    st.fixed_dictionaries(
        dict.fromkeys(("ground_range_m", "altitude_m", "length_m", "height_m", "shadow_length_m"), anything)
    )
)
def test_the_details_of_any_detection_are_finite(measured: dict[str, float]) -> None:
    assert all(map(math.isfinite, detection_details(detection(**measured)).values()))
