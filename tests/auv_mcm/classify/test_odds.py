"""Evidence in nats, its odds and its masses: against sums and Dempster's rule written out, and files that are no
weights."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any, get_args

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.classify import odds as odds_module
from auv_mcm.classify.beliefs import EVERYTHING, MINES, conjunctive, subset, vacuous
from auv_mcm.classify.details import detection_details
from auv_mcm.classify.features import contour_features, detector_features, outline_features, shape_features, with_shape
from auv_mcm.classify.odds import (
    MineOdds,
    Tree,
    Weights,
    mass_of_ratio,
    parse_odds,
    share_of_ratio,
    shipped_odds,
    with_ratio,
)
from auv_mcm.errors import BadInputError
from auv_mcm.records import NAN, Detector, MeasuredStep
from tests.auv_mcm.classify.drawn_looks import bare_floor, detection, no_contours, no_fits

CLUTTER = subset("clutter")
NOTHING = Weights(offset=0.0, weights={})
SHIPPED = Path(odds_module.__file__).with_name("mine_odds_contrast.json")
DETECTORS: tuple[Detector, ...] = get_args(Detector)

ratios = st.floats(-12.0, 12.0)
numbers = st.floats(-50.0, 50.0)


def weighing(weights: dict[str, float], offset: float = 0.0, prior: float = 0.0) -> MineOdds:
    return MineOdds(
        fitted_on="nothing",
        prior=prior,
        detector=Weights(offset=offset, weights=weights),
        contours=NOTHING,
        shape=NOTHING,
    )


# ---------------------------------------------------------------- features to nats


@given(st.dictionaries(st.text(max_size=3), st.tuples(numbers, numbers), max_size=5), numbers, st.floats(-20.0, 20.0))
def test_evidence_is_the_weighted_sum_without_the_prior_and_bounded(
    pairs: dict[str, tuple[float, float]], offset: float, prior: float
) -> None:
    odds = weighing({name: weight for name, (weight, _) in pairs.items()}, offset, prior)
    found = odds.log_ratio("detector", {name: value for name, (_, value) in pairs.items()})
    expected = offset - prior
    for weight, value in pairs.values():
        expected += weight * value
    assert found == pytest.approx(max(-12.0, min(12.0, expected)), abs=1e-9)


def test_every_step_has_weights_of_its_own() -> None:
    odds = MineOdds(
        fitted_on="nothing",
        prior=-1.0,
        detector=Weights(offset=0.5, weights={"a": 2.0}),
        contours=Weights(offset=0.25, weights={"a": 1.0, "b": -1.0}),
        shape=Weights(offset=0.0, weights={}),
    )
    assert odds.log_ratio("detector", {"a": 1.0}) == 3.5
    assert odds.log_ratio("contours", {"b": 2.0, "a": 1.0}) == 0.25
    assert odds.log_ratio("shape", {}) == 1.0


@pytest.mark.parametrize("features", [{}, {"a": 1.0}, {"a": 1.0, "B": 1.0}])
def test_features_that_are_missing_are_reported(features: dict[str, float]) -> None:
    with pytest.raises(
        ValueError,
        match=re.escape(f"detector: fitted with {'b' if features else 'a'!r}, called with {sorted(features)} alone"),
    ):
        weighing({"a": 1.0, "b": 1.0}).log_ratio("detector", features)


def test_features_beyond_those_it_was_fitted_with_change_nothing() -> None:
    odds = weighing({"a": 1.0})
    assert odds.log_ratio("detector", {"a": 2.0, "b": 5.0}) == odds.log_ratio("detector", {"a": 2.0})


@st.composite
def drawn_trees(draw: st.DrawFn) -> Tree:
    """A tree that grew by parting one leaf after the other."""
    asked: list[tuple[str, float]] = []
    leads: list[list[int | None]] = []
    open_places: list[tuple[int, int]] = []
    for question in range(draw(st.integers(0, 6))):
        if open_places:
            parent, answer = open_places.pop(draw(st.integers(0, len(open_places) - 1)))
            leads[parent][answer] = question
        asked.append((draw(st.sampled_from("abc")), draw(st.floats(-2.0, 2.0))))
        leads.append([None, None])
        open_places += [(question, 0), (question, 1)]
    leaves = iter(draw(st.permutations(range(len(asked) + 1))))
    ends = [[-1 - next(leaves) if lead is None else lead for lead in both] for both in leads]
    nats = draw(st.lists(st.floats(-1.0, 1.0), min_size=len(asked) + 1, max_size=len(asked) + 1))
    return Tree(ask=tuple((*asks, no, yes) for asks, (no, yes) in zip(asked, ends, strict=True)), nats=tuple(nats))


def leaf(tree: Tree, features: dict[str, float]) -> float:
    """What a tree adds, question after question."""
    place = 0 if tree.ask else -1
    while place >= 0:
        name, threshold, no, yes = tree.ask[place]
        place = yes if features[name] > threshold else no
    return tree.nats[-1 - place]


@given(
    st.lists(drawn_trees(), max_size=4),
    st.fixed_dictionaries(dict.fromkeys("abc", st.floats(-3.0, 3.0) | st.just(math.nan))),
)
def test_trees_add_what_their_leaves_say(trees: list[Tree], features: dict[str, float]) -> None:
    weighed = Weights(offset=0.25, weights={}, trees=tuple(trees))
    assert weighed.log_odds(features) == pytest.approx(0.25 + sum(leaf(tree, features) for tree in trees), abs=1e-12)


@given(
    st.lists(drawn_trees(), max_size=9),
    st.fixed_dictionaries(dict.fromkeys("abc", st.floats(-3.0, 3.0) | st.just(math.nan))),
)
def test_trees_are_added_one_after_the_other_to_the_last_bit(trees: list[Tree], features: dict[str, float]) -> None:
    expected = 0.1
    for tree in trees:
        expected += leaf(tree, features)
    assert Weights(offset=0.1, weights={}, trees=tuple(trees)).log_odds(features) == expected


def test_arrays_made_of_trees_are_no_part_of_the_weights() -> None:
    tree = Tree(ask=(("a", 0.0, -1, 1), ("a", 0.5, -2, -3)), nats=(0.0, 1.0, 7.0))
    weighed, again = (Weights(offset=0.0, weights={}, trees=(tree,)) for _ in range(2))
    assert weighed.log_odds({"a": 1.0}) == 7.0
    assert weighed == again
    assert msgspec.json.encode(weighed) == msgspec.json.encode(again)


@given(ratios, st.floats(-20.0, 20.0))
def test_p_mine_has_the_prior_in_it_again(log_ratio: float, prior: float) -> None:
    """By Bayes' rule on odds."""
    posterior = math.exp(log_ratio) * math.exp(prior)
    assert weighing({}, prior=prior).p_mine(log_ratio) == pytest.approx(posterior / (1.0 + posterior), rel=1e-9)


def test_a_view_that_adds_nothing_stays_at_the_rate_of_mines() -> None:
    odds = weighing({"a": 0.0}, offset=math.log(3.0 / 97.0), prior=math.log(3.0 / 97.0))
    assert odds.p_mine(odds.log_ratio("detector", {"a": 7.0})) == pytest.approx(0.03)


# ---------------------------------------------------------------- nats to masses and back


@given(ratios)
def test_mass_lies_on_mines_clutter_and_a_little_on_everything(log_ratio: float) -> None:
    mass = mass_of_ratio(log_ratio)
    assert set(np.flatnonzero(mass)) == {MINES, CLUTTER, EVERYTHING}
    assert mass.sum() == pytest.approx(1.0, abs=1e-12)
    assert mass[EVERYTHING] == pytest.approx(0.001)
    assert math.log(mass[MINES] / mass[CLUTTER]) == pytest.approx(0.5 * log_ratio, abs=1e-9)


@given(ratios, ratios)
def test_more_evidence_is_a_greater_share_and_against_mirrors_for(first: float, second: float) -> None:
    low, high = sorted((first, second))
    assert share_of_ratio(low) <= share_of_ratio(high)
    assert share_of_ratio(-first) == pytest.approx(1.0 - share_of_ratio(first), abs=1e-12)


def test_no_evidence_is_an_even_share() -> None:
    assert share_of_ratio(0.0) == 0.5


@given(st.lists(st.floats(0.0, 1.0), min_size=32, max_size=32).filter(lambda shares: sum(shares[1:]) > 0.1), ratios)
def test_a_mass_with_evidence_is_dempsters_rule_pair_by_pair(shares: list[float], log_ratio: float) -> None:
    mass = np.array([0.0, *shares[1:]]) / sum(shares[1:])
    evidence = mass_of_ratio(log_ratio)
    expected = np.zeros(32)
    for a in range(32):
        for b in (MINES, CLUTTER, EVERYTHING):
            if a & b:
                expected[a & b] += mass[a] * evidence[b]
    np.testing.assert_allclose(with_ratio(mass, log_ratio), expected / expected.sum(), atol=1e-12)


def test_evidence_for_a_mine_names_no_kind_and_leaves_what_the_shape_says() -> None:
    np.testing.assert_allclose(with_ratio(vacuous(), 3.0), mass_of_ratio(3.0), atol=1e-15)
    shape = conjunctive(vacuous(), vacuous())[0]
    shape[EVERYTHING], shape[subset("wedge", "clutter")] = 0.2, 0.8
    reported = with_ratio(shape, 8.0)
    assert reported[subset("wedge")] == pytest.approx(0.8 * 0.98, abs=0.01)
    assert reported[0] == 0.0


# ---------------------------------------------------------------- files


def written(**changes: Any) -> dict[str, Any]:
    step = {"offset": 0.5, "weights": {"a": 1.0}}
    return {"fitted_on": "a test", "prior": -2.0, "detector": step, "contours": step, "shape": step, **changes}


def data_of(**changes: Any) -> bytes:
    return json.dumps(written(**changes)).encode()


def test_weights_written_are_read_back() -> None:
    odds = parse_odds(data_of(), "here.json")
    assert odds.prior == -2.0
    assert odds.log_ratio("shape", {"a": 1.0}) == 3.5
    assert parse_odds(msgspec.json.encode(odds), "again.json") == odds


STEP = {"offset": 0.0, "weights": {}}
BAD = {
    "empty": b"",
    "not JSON": b"weights: 1",
    "not text": b"\xff\xfe\x00",
    "text that is not UTF-8": data_of().replace(b"a test", b"\xff\xfe"),
    "a list": b"[]",
    "no object": b"null",
    "more after the end": data_of() + b"{}",
    "NaN": data_of().replace(b"-2.0", b"NaN"),
    "infinite": data_of().replace(b"-2.0", b"1e999"),
    "a prior beyond belief": data_of(prior=-1e6),
    "a weight beyond sense": data_of(shape={"offset": 0.0, "weights": {"a": 1e300}}),
    "an offset beyond sense": data_of(shape={"offset": -1e300, "weights": {}}),
    "text for a number": data_of(prior="0"),
    "nothing for a number": data_of(prior=None),
    "a step missing": json.dumps({key: value for key, value in written().items() if key != "shape"}).encode(),
    "an unknown step": data_of(echo=STEP),
    "an unknown key in a step": data_of(shape={**STEP, "slope": 1.0}),
    "a tree without leaves": data_of(shape={**STEP, "trees": [{"ask": [["a", 0.5, -1, -2]], "nats": []}]}),
    "a tree with a question too few": data_of(
        shape={**STEP, "trees": [{"ask": [["a", 0.5, -1, -2]], "nats": [0.0] * 3}]}
    ),
    "a tree that asks for ever": data_of(shape={**STEP, "trees": [{"ask": [["a", 0.5, -1, 0]], "nats": [0.0] * 2}]}),
    "a leaf that nothing leads to": data_of(
        shape={**STEP, "trees": [{"ask": [["a", 0.5, -1, -1]], "nats": [0.0] * 2}]}
    ),
    "a question without a threshold": data_of(shape={**STEP, "trees": [{"ask": [["a", -1, -2]], "nats": [0.0] * 2}]}),
    "weights that are a list": data_of(shape={"offset": 0.0, "weights": [1.0]}),
}


@pytest.mark.parametrize("data", BAD.values(), ids=BAD.keys())
def test_files_that_are_no_weights_are_refused_by_name(data: bytes) -> None:
    with pytest.raises(BadInputError, match=r"^/data/mine_odds\.json: .*auv-mcm calibrate odds"):
        parse_odds(data, "/data/mine_odds.json")


@pytest.mark.parametrize("changes", [{"contours": None}, {"shape": {**STEP, "trees": [{"ask": [], "nats": [1.0]}]}}])
def test_without_a_verifier_every_step_is_a_sum(changes: dict[str, Any]) -> None:
    with pytest.raises(BadInputError, match=r"without a verifier .* sums of weights\. Write .*auv-mcm calibrate odds"):
        parse_odds(data_of(**changes), "old.json")
    odds = msgspec.structs.replace(parse_odds(data_of(), "f"), verifier=shipped_odds("cascade").verifier, shape=None)
    assert parse_odds(msgspec.json.encode(odds), "new.json") == odds
    with pytest.raises(ValueError, match="decided by the verifier"):
        odds.log_ratio("shape", {})


def test_what_is_wrong_inside_a_file_is_reported_with_its_place() -> None:
    with pytest.raises(BadInputError, match=r"Expected `float`, got `str` - at `\$\.shape\.offset`"):
        parse_odds(data_of(shape={"offset": "1", "weights": {}}), "f.json")
    with pytest.raises(BadInputError, match=r"unknown field `slope` - at `\$\.shape`"):
        parse_odds(data_of(shape={**STEP, "slope": 1.0}), "f.json")


@given(st.integers(0, 10_000))
def test_a_file_cut_off_anywhere_is_refused(length: int) -> None:
    data = SHIPPED.read_bytes().rstrip()
    with pytest.raises(BadInputError, match=r"^f\.json: "):
        parse_odds(data[: length % len(data)], "f.json")


@given(st.binary(max_size=60))
def test_any_bytes_are_weights_or_refused(data: bytes) -> None:
    with pytest.raises(BadInputError, match=r"^f\.json: "):
        parse_odds(data, "f.json")


@pytest.mark.parametrize("detector", DETECTORS)
def test_the_shipped_weights_are_for_the_features_there_are(detector: Detector) -> None:
    odds = shipped_odds(detector)
    seen = detection(cascade_score=2.0 if detector == "cascade" else NAN)
    region, labels = bare_floor(), np.zeros((2, 2), dtype=np.uint8)
    first = detector_features(seen)
    second = first | contour_features(no_contours()) | outline_features(no_contours(), region)
    last = with_shape(second, shape_features(no_fits(), labels))
    details = detection_details(seen)
    assert len(first | details) == len(first) + len(details), "names are unique"
    assert (odds.verifier is None) == (detector == "contrast")
    for step, features in ((odds.detector, first), (odds.contours, second), (odds.shape, last)):
        if step is None:
            assert odds.verifier is not None
            continue
        assert step.trees or step.weights.keys() == features.keys()
        assert {name for tree in step.trees for name, *_ in tree.ask} <= (features | details).keys()
    assert odds.prior < math.log(0.5), "most detections are no mines"


@pytest.mark.parametrize("detector", DETECTORS)
@given(st.integers(0, 1000))
def test_the_shipped_weights_give_probabilities_for_any_features(detector: Detector, seed: int) -> None:
    random = np.random.Generator(np.random.PCG64(seed))
    odds = shipped_odds(detector)
    steps: dict[MeasuredStep, Weights | None] = {
        "detector": odds.detector,
        "contours": odds.contours,
        "shape": odds.shape,
    }
    for name, step in steps.items():
        if step is not None:
            requested = {name for tree in step.trees for name, *_ in tree.ask}
            features = {name: float(random.normal(0.0, 10.0)) for name in sorted(step.weights.keys() | requested)}
            assert 0.0 < odds.p_mine(odds.log_ratio(name, features)) < 1.0
