"""What a list of expected mines says about a view, against numerical integration, and its bounds."""

from __future__ import annotations

import math
from itertools import permutations

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from auv_mcm.classify.beliefs import FRAME, Array, belief, pignistic
from auv_mcm.classify.fit import SOLIDS, USUAL_RANGES, Optimum, ShapeFit, ShapeFits, plausibility
from auv_mcm.classify.fusion import fuse
from auv_mcm.classify.size_evidence import (
    NO_WEIGHT,
    SizeEvidence,
    is_usual,
    parse_size_model,
    search_ranges,
    shipped_size_model,
    size_evidence,
)
from auv_mcm.classify.targets import (
    NOT_LISTED,
    ExpectedCone,
    ExpectedCylinder,
    ExpectedMine,
    ExpectedSphere,
    ExpectedWedge,
    TargetLibrary,
    shipped_targets,
)
from auv_mcm.classify.verifier import MINE_KINDS, NO_OPINION, Opinion
from auv_mcm.confirmation import shape_mass
from auv_mcm.errors import BadInputError
from auv_mcm.kernels.shape import Solid
from auv_mcm.solids.shapes import Cylinder, Shape, Sphere, TruncatedCone, Wedge
from tests.auv_mcm.classify.test_fusion import looked_at

MODEL = shipped_size_model()
sizes_m = st.floats(0.2, 3.5)
maybe_m = st.none() | sizes_m
shares = st.floats(0.1, 10.0)
tolerances = st.floats(0.1, 100.0)
mines = st.one_of(
    st.builds(ExpectedCylinder, length_m=maybe_m, diameter_m=maybe_m, share=shares, tolerance_percent=tolerances),
    st.builds(ExpectedSphere, diameter_m=maybe_m, share=shares, tolerance_percent=tolerances),
    st.builds(ExpectedCone, base_diameter_m=maybe_m, height_m=maybe_m, share=shares, tolerance_percent=tolerances),
    st.builds(ExpectedWedge, length_m=maybe_m, share=shares, tolerance_percent=tolerances),
)
libraries = st.builds(
    TargetLibrary, mines=st.lists(mines, min_size=1, max_size=5).map(tuple), not_listed=st.floats(0.05, 1.0)
)


def fit(solid: Solid, size_m: float, cost: float) -> ShapeFit:
    """The best solid of one kind, all of whose sizes follow from one."""
    shapes: dict[Solid, Shape] = {
        "cylinder": Cylinder(radius_m=0.15 * size_m, length_m=size_m, azimuth_rad=0.1),
        "sphere": Sphere(radius_m=0.5 * size_m),
        "truncated_cone": TruncatedCone(base_radius_m=0.5 * size_m, top_radius_m=0.25 * size_m, height_m=0.5 * size_m),
        "wedge": Wedge(length_m=size_m, width_m=0.8 * size_m, height_m=0.4 * size_m),
    }
    best = Optimum(shape=shapes[solid], row=20.0, ground_range_m=18.0, altitude_ratio=1.0, cost=cost)
    return ShapeFit(solid=solid, best=best, plausibility=1.0, refined=True)


def fits_of(*fits: ShapeFit) -> ShapeFits:
    return ShapeFits(fits=fits, contour_cost=None, n_hypotheses=0, flags=())


views = st.lists(
    st.tuples(st.sampled_from(SOLIDS), sizes_m, st.floats(-300.0, 50.0)), max_size=4, unique_by=lambda row: row[0]
).map(lambda rows: fits_of(*(fit(*row) for row in sorted(rows, key=lambda row: row[2]))))


def sphere_factor_by_integration(diameter_m: float, tolerance_percent: float, measured_m: float, law_of: str) -> float:
    """p(size measured | the list) / p(size measured | usual) of a sphere, summed over true sizes, without astray."""
    kind = MODEL.kinds["sphere"]
    law = kind.clear if law_of == "clear" else kind.faint
    true = np.linspace(-4.0, 4.0, 160_001)

    def normal(x: Array | float, mean: Array | float, sd: float) -> Array:
        return np.asarray(np.exp(-0.5 * ((x - mean) / sd) ** 2))

    usual = normal(true, kind.mean[0], kind.sd[0])
    listed = usual * normal(true, math.log(diameter_m), math.log1p(0.01 * tolerance_percent) / math.sqrt(3.0))
    seen = normal(math.log(measured_m), law.offset[0] + law.slope[0] * true, math.sqrt(law.covariance[0][0]))
    ratio = float((listed * seen).sum() / listed.sum() / ((usual * seen).sum() / usual.sum()))
    return 4.0 * (law.astray + (1.0 - law.astray) * ratio)  # one kind of four is listed


@pytest.mark.parametrize(("cost", "law_of"), [(-80.0, "clear"), (-3.0, "faint")])
@pytest.mark.parametrize("tolerance_percent", [2.0, 30.0])
@pytest.mark.parametrize("measured_m", [0.5, 0.85, 1.3])
def test_the_factor_of_a_kind_is_that_of_numerical_integration(
    cost: float, law_of: str, tolerance_percent: float, measured_m: float
) -> None:
    library = TargetLibrary(
        mines=(ExpectedSphere(diameter_m=0.9, tolerance_percent=tolerance_percent),), not_listed=0.05
    )
    weight = SizeEvidence(library, MODEL).weigh(fits_of(fit("sphere", measured_m, cost)))
    expected = 0.05 + 0.95 * sphere_factor_by_integration(0.9, tolerance_percent, measured_m, law_of)
    assert weight.factors["sphere"] == pytest.approx(expected, rel=1e-6)
    assert weight.nats == pytest.approx(math.log(expected))  # it is the only kind that can be seen


@given(views)
def test_the_list_that_ships_changes_not_a_bit(view: ShapeFits) -> None:
    weight = size_evidence(shipped_targets()).weigh(view)
    assert weight.nats == 0.0
    assert set(weight.factors.values()) <= {1.0}
    assert shape_mass(view, False, weight).tobytes() == shape_mass(view, False, NO_WEIGHT).tobytes()
    assert search_ranges(shipped_targets()) == USUAL_RANGES


@given(libraries, views)
def test_no_list_takes_more_from_a_view_than_its_share_of_mines_not_listed_says(
    library: TargetLibrary, view: ShapeFits
) -> None:
    weight = SizeEvidence(library, MODEL).weigh(view)
    bound = -math.log(library.not_listed)
    assert -bound - 1e-12 <= weight.nats <= bound + 1e-12
    assert all(factor >= library.not_listed * (1.0 - 1e-12) for factor in weight.factors.values())


@settings(max_examples=30)
@given(st.lists(mines, min_size=2, max_size=3), views)
def test_the_order_of_the_list_changes_not_a_bit(listed: list[ExpectedMine], view: ShapeFits) -> None:
    weights = {
        str(SizeEvidence(TargetLibrary(mines=order), MODEL).weigh(view)) for order in permutations(tuple(listed))
    }
    assert len(weights) == 1


@settings(max_examples=30)
@given(sizes_m, sizes_m, views)
def test_widening_tolerances_leads_to_any_mine(first_m: float, second_m: float, view: ShapeFits) -> None:
    changes = []
    for tolerance_percent in (1e4, 1e8, 1e80):
        listed = (
            ExpectedCylinder(length_m=first_m, diameter_m=second_m, tolerance_percent=tolerance_percent),
            ExpectedSphere(diameter_m=first_m, tolerance_percent=tolerance_percent),
            ExpectedCone(base_diameter_m=first_m, height_m=second_m, tolerance_percent=tolerance_percent),
            ExpectedWedge(length_m=second_m, tolerance_percent=tolerance_percent),
        )
        changes.append(abs(SizeEvidence(TargetLibrary(mines=listed), MODEL).weigh(view).nats))
    assert changes[2] <= 0.01
    assert changes[2] <= changes[1] + 1e-12
    assert changes[1] <= changes[0] + 0.05  # at 10 000 % it may happen to be right


@settings(max_examples=50)
@given(libraries, st.lists(st.tuples(views, st.floats(-12.0, 12.0), st.floats(0.0, 359.0)), min_size=1, max_size=3))
def test_p_mine_stays_within_what_is_believed_and_what_is_plausible(
    library: TargetLibrary, rows: list[tuple[ShapeFits, float, float]]
) -> None:
    evidence = SizeEvidence(library, MODEL)
    prior = math.log(0.1 / 0.9)
    seen = []
    for number, (view, log_ratio, aspect_deg) in enumerate(rows):
        weight = evidence.weigh(view)
        mass = shape_mass(view, False, weight)
        assert belief(mass)[-1] == pytest.approx(1.0)
        seen.append(looked_at(log_ratio + weight.nats, aspect_deg, float(number), prior, mass))
    found = fuse(seen, prior)
    of_mines = 1.0 - found.belief["clutter"] - found.belief["unknown"]
    assert of_mines <= found.p_mine + 1e-9
    assert found.belief["clutter"] <= 1.0 - found.p_mine + 1e-9
    assert fuse(seen[::-1], prior) == found or math.isnan(found.conflict)


def test_a_clear_sphere_of_the_size_listed_gains_more_than_one_of_another_size() -> None:
    evidence = SizeEvidence(TargetLibrary(mines=(ExpectedSphere(diameter_m=0.9),)), MODEL)
    listed, other = (evidence.weigh(fits_of(fit("sphere", size_m, -80.0))).nats for size_m in (0.85, 0.5))
    assert listed > 1.0
    assert other < listed - 1.0


def test_a_kind_on_no_line_of_the_list_is_less_believed() -> None:
    view = fits_of(fit("sphere", 0.85, -80.0), fit("truncated_cone", 0.98, -78.0))
    weight = SizeEvidence(TargetLibrary(mines=(ExpectedCone(base_diameter_m=0.98),)), MODEL).weigh(view)
    assert weight.factors["sphere"] == pytest.approx(NOT_LISTED)
    before, after = (pignistic(shape_mass(view, False, each)) for each in (NO_WEIGHT, weight))
    cone, sphere = FRAME.index("truncated_cone"), FRAME.index("sphere")
    assert before[sphere] > before[cone]
    assert after[sphere] < after[cone]


@given(views, st.lists(st.floats(-6.0, 0.0), min_size=len(MINE_KINDS), max_size=len(MINE_KINDS)))
def test_the_network_s_kind_is_believed_more_than_without_it_whatever_boxes_are(
    view: ShapeFits, kind_nats: list[float]
) -> None:
    opinion = Opinion(0.0, tuple(kind_nats))
    before, after = (pignistic(shape_mass(view, True, NO_WEIGHT, each)) for each in (NO_OPINION, opinion))
    likeliest = max(FRAME[:-1], key=lambda kind: kind_nats[MINE_KINDS.index(kind)])
    kind = FRAME.index(likeliest)
    assert after[kind] >= before[kind] - 1e-9
    other_boxes = Opinion(0.0, (*kind_nats[:-1], -3.0))
    assert (
        shape_mass(view, True, NO_WEIGHT, other_boxes).tobytes() == shape_mass(view, True, NO_WEIGHT, opinion).tobytes()
    )


def test_what_is_searched_reaches_every_size_listed() -> None:
    listed = (ExpectedSphere(diameter_m=1.6), ExpectedCone(base_diameter_m=1.4, height_m=0.4))
    ranges = search_ranges(TargetLibrary(mines=listed))
    assert plausibility("sphere", np.array([0.8, 0.0]), ranges) == 1.0
    assert plausibility("truncated_cone", np.array([0.7, 0.5, 0.4 / 1.4]), ranges) == 1.0
    assert plausibility("truncated_cone", np.array([1.15 * 0.7, 0.5, 0.4 / 1.4]), ranges) == pytest.approx(0.5)
    assert ranges["cylinder"] == USUAL_RANGES["cylinder"]
    assert not is_usual(listed[0])
    assert is_usual(ExpectedWedge(length_m=1.02))


def test_a_damaged_model_is_refused_with_the_command_that_makes_it() -> None:
    damaged = msgspec.json.encode(MODEL)[:-20]
    with pytest.raises(BadInputError, match="auv-mcm calibrate sizes"):
        parse_size_model(damaged, "size_law.json")
