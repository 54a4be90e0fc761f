"""The bench of beliefs: what it draws, how it weighs a contour, and the figures in its tables."""

from __future__ import annotations

import math

import numpy as np
import pytest

from auv_mcm.classify.beliefs import EVERYTHING, FRAME, N_SUBSETS, Array, subset, vacuous
from auv_mcm.classify.evidence import ClassEvidence
from auv_mcm.cli import main
from auv_mcm.confirm.region import SHADOW, Region
from auv_mcm.confirm.snake import converge, snake_settings, start_from_detection
from auv_mcm.kernels import snake, snake_twin
from auv_mcm.records import ContactClass
from auv_mcm.solids.shapes import Sphere
from sim_replay.benches.every_stage.rendered_solids import CORRELATION_AREA
from sim_replay.studies.beliefs import (
    HELD_OUT_SEED,
    LikelihoodView,
    belief_rows,
    calibration_of,
    calibrations,
    clutter_without_sizes,
    code_length,
    contour_wins,
    decided,
    draw_labelled,
    free_contour,
    look,
    looks_at,
    mass_of_one,
    mass_of_two,
    paper_rows,
    reliability,
    shadow_evidence,
)
from tests.auv_mcm.classify.closed_forms import closed_form_region


def sphere_region() -> Region:
    random = np.random.Generator(np.random.PCG64(3))
    return closed_form_region(Sphere(radius_m=0.4), 20.0, random=random)


def certain(share: float, *names: ContactClass) -> Array:
    """Mass of `share` on the classes together, the rest on ignorance."""
    mass = (1.0 - share) * vacuous()
    mass[subset(*names)] += share
    return mass


def test_the_sums_of_the_printed_beliefs_leave_something_open() -> None:
    assert [round(row.total, 3) for row in paper_rows()] == [0.91, 0.916, 0.798, 0.88]


def test_a_rock_is_drawn_the_same_again_with_altitudes_wrong_either_way() -> None:
    rock, again = (draw_labelled("clutter", HELD_OUT_SEED) for _ in range(2))
    for view, view_again in zip(rock.views, again.views, strict=True):
        np.testing.assert_array_equal(view.intensity, view_again.intensity)
    assert rock.views[0].altitude_m + rock.views[1].altitude_m == pytest.approx(12.0)
    assert rock.views[0].altitude_m != rock.views[1].altitude_m


def test_a_contours_code_length_is_that_of_the_snakes_criterion() -> None:
    region = sphere_region()
    contours = converge(region, start_from_detection(region), correlation_px=CORRELATION_AREA)
    settings = snake_settings(region, snake.window_row_sums(region.intensity, region.valid).table, CORRELATION_AREA)
    sums = snake_twin.EdgeSums(total=0.2, measured=1.0, area=1.0, far=1.0, rows=1.0, gap=0.0, shared=0.0, overlap=0.0)
    for which, nodes in enumerate((contours.highlight, contours.shadow)):
        whole = snake_twin.polygon_cost(settings, which, nodes, sums) - snake_twin.likelihood(settings, which, 0.2, 1.0)
        assert code_length(nodes, region.intensity.size) == pytest.approx(whole, abs=1e-9)


def test_a_clear_sphere_is_one_by_either_route() -> None:
    region = sphere_region()
    free = free_contour(region)
    assert free.cost < 0.0
    seen = look(region)
    assert seen.half_turn_symmetric
    np.testing.assert_array_equal(seen.shadow, free.labels == SHADOW)
    assert seen.evidence["clutter"] == ClassEvidence(nll=free.cost)
    assert min(seen.evidence, key=lambda name: seen.evidence[name].nll) == "sphere"
    by_shadow = shadow_evidence(region, seen.shadow)
    assert set(by_shadow) == set(seen.evidence) == set(FRAME)
    assert min(by_shadow, key=lambda name: by_shadow[name].nll) == "sphere"
    assert by_shadow["sphere"].plausibility > 0.9


def test_without_a_shadow_every_solid_is_out_by_its_distance() -> None:
    region = sphere_region()
    evidence = shadow_evidence(region, np.zeros(region.intensity.shape, dtype=np.bool_))
    assert {name for name, item in evidence.items() if item.nll < math.inf} == {"clutter"}


def test_rows_are_medians_per_class_and_shares_of_right_decisions() -> None:
    masses = np.array(
        [
            certain(0.2, "sphere"),
            certain(0.6, "sphere"),
            certain(0.9, "wedge"),
            certain(0.8, "sphere", "truncated_cone"),
        ]
    )
    sphere, cone = belief_rows(masses, ["sphere", "sphere", "sphere", "truncated_cone"])
    assert (sphere.name, cone.name) == ("sphere", "truncated_cone")
    np.testing.assert_allclose(sphere.beliefs, [0.0, 0.2, 0.0, 0.0, 0.0])
    assert sphere.total == pytest.approx(0.6)
    assert sphere.ignorance == pytest.approx(0.4)
    assert sphere.probability == pytest.approx(0.2 + 0.8 / 5)
    assert sphere.correct == pytest.approx(2 / 3)
    assert cone.pair == pytest.approx(0.8)
    assert cone.correct == 0.0  # a mass on both decides for neither
    np.testing.assert_array_equal(decided(np.array([[0.2] * 5, [0.1, 0.1, 0.5, 0.2, 0.1]])), [-1, 2])


def test_calibration_counts_what_is_promised_to_the_true_and_to_the_winning_class() -> None:
    printed = calibration_of(np.array([certain(0.5, "sphere"), certain(0.5, "wedge")]), ["sphere", "clutter"], 4.0)
    assert printed.log_loss == pytest.approx(-0.5 * (math.log(0.6) + math.log(0.1)))
    assert printed.error == pytest.approx(0.1)  # 0.6 promised, 0.5 kept


def test_promises_are_set_beside_outcomes_where_there_are_any() -> None:
    masses = np.array([certain(0.5, "sphere"), certain(0.6, "wedge"), certain(0.95, "wedge")])
    low, high = reliability(masses, ["sphere", "clutter", "wedge"])
    assert tuple(low) == pytest.approx((2, 0.64, 0.5))
    assert tuple(high) == pytest.approx((1, 0.96, 1.0))


def test_a_rock_of_implausible_size_is_recognised_by_its_size_alone() -> None:
    def rock(plausible: float, contour: float) -> LikelihoodView:
        evidence = {
            name: ClassEvidence(nll=-100.0 if name == "wedge" else 0.0, plausibility=plausible) for name in FRAME
        }
        evidence["clutter"] = ClassEvidence(nll=contour)
        return LikelihoodView(evidence, False, np.zeros((1, 1), dtype=np.bool_))

    assert belief_rows(mass_of_one(rock(0.0, -60.0))[np.newaxis], ["clutter"])[0].correct == 1.0
    assert not contour_wins(rock(0.0, -60.0))
    assert not clutter_without_sizes(rock(0.0, -60.0))
    assert contour_wins(rock(1.0, -150.0))
    assert clutter_without_sizes(rock(1.0, -150.0))


def test_two_views_that_agree_give_more_certainty_and_calibrations_report_both() -> None:
    seen = LikelihoodView(
        {name: ClassEvidence(nll=0.0 if name == "wedge" else 20.0) for name in FRAME},
        False,
        np.zeros((1, 1), dtype=np.bool_),
    )
    one, two = mass_of_one(seen), mass_of_two((seen, seen))
    assert one.shape == two.shape == (N_SUBSETS,)
    assert two[subset("wedge")] > one[subset("wedge")] > 0.5
    assert two[EVERYTHING] < one[EVERYTHING]
    single, pair = calibrations([("wedge", (seen, seen))], 4.0)
    assert pair.log_loss < single.log_loss
    assert single == calibration_of(np.array([one, one]), ["wedge", "wedge"], 4.0)


def test_a_drawn_mine_is_seen_from_both_sides() -> None:
    first, second = looks_at(draw_labelled("cylinder", HELD_OUT_SEED))
    assert first.evidence["cylinder"].nll < first.evidence["sphere"].nll
    assert second.evidence["cylinder"].nll < second.evidence["sphere"].nll


def test_the_bench_prints_the_papers_rows_beside_ours(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "beliefs", "--objects", "1"]) == 0
    printed = capsys.readouterr().out
    assert all(
        title in printed
        for title in ("printed in the source paper", "derived anew", "ours, one view", "ours, two views", "calibration")
    )
    assert "cylinder            0.710    0.000    0.000        -    0.200    0.910" in printed
