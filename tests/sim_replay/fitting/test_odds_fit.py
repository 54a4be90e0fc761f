"""Weights fitted on made-up detections: against Newton's method written out, and what the command refuses."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import msgspec
import numpy as np
import pytest

from auv_mcm.classify.details import detection_details
from auv_mcm.classify.odds import MineOdds, Weights, parse_odds, shipped_odds
from auv_mcm.errors import UsageError
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.records import Detection, Detector, NavSample, Surroundings
from auv_mcm.settings.config import Config
from sim_replay.fitting import fit_odds as calibrate
from sim_replay.fitting.fit_odds import (
    CROWD,
    Example,
    StepTable,
    crowded,
    examples_along,
    fit_table,
    log_odds_of,
    look_table,
)
from sim_replay.missions import HELD_OUT, SCENES
from sim_replay.simulator.objects import place_objects
from sim_replay.simulator.scene_file import read_scene
from tests.auv_mcm.classify import drawn_looks

WEIGHTS = {"a": 1.5, "b": -0.7, "c": 0.0}
OFFSET = -1.0
MINES_AND_ROCKS = {"cylinder", "sphere", "truncated_cone", "wedge", "box", "rock"}


def example(features: dict[str, float], is_target: bool, weight: float = 1.0, usual: bool = True) -> Example:
    """All steps measured the same."""
    return Example(usual, is_target, weight, features, features, features, {})


def fit(examples: Sequence[Example], fitted_on: str) -> MineOdds:
    """Sums alone, of which it is known what they must be."""
    return fit_table(look_table(examples), fitted_on)


def shape_of(odds: MineOdds) -> Weights:
    assert odds.shape is not None
    return odds.shape


def drawn(n: int, seed: int, weights: Sequence[float] = (1.0,)) -> list[Example]:
    """n examples of the logistic model above, features standing apart in level and scale."""
    random = np.random.Generator(np.random.PCG64(seed))
    values = random.normal(0.0, 1.0, (n, len(WEIGHTS))) * [1.0, 2.0, 0.5] + [0.0, 1.0, -3.0]
    p = 1.0 / (1.0 + np.exp(-(OFFSET + values @ list(WEIGHTS.values()))))
    is_target = random.random(n) < p
    chosen = random.choice(list(weights), n)
    return [
        example(dict(zip(WEIGHTS, row, strict=True)), bool(target), float(weight))
        for row, target, weight in zip(values.tolist(), is_target.tolist(), chosen.tolist(), strict=True)
    ]


def newton(examples: Sequence[Example], ridge: float = 2.0) -> tuple[float, dict[str, float]]:
    """Offset and weights of ridge regression on standardised features, every example repeated as often as it counts."""
    rows = [item for item in examples for _ in range(int(item.weight))]
    names = list(WEIGHTS)
    values = np.array([[item.shape[name] for name in names] for item in rows])
    target = np.array([float(item.is_target) for item in rows])
    mean, scale = values.mean(axis=0), values.std(axis=0)
    columns = np.column_stack([(values - mean) / scale, np.ones(len(rows))])
    penalty = np.diag([*([ridge] * len(names)), 0.0])
    found = np.zeros(len(names) + 1)
    for _ in range(30):
        p = 1.0 / (1.0 + np.exp(-(columns @ found)))
        gradient = columns.T @ (p - target) + penalty @ found
        found -= np.linalg.solve((columns.T * (p * (1.0 - p))) @ columns + penalty, gradient)
    slopes = found[:-1] / scale
    return float(found[-1] - slopes @ mean), dict(zip(names, slopes.tolist(), strict=True))


# ---------------------------------------------------------------- the fit


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("weights", [(1.0,), (1.0, 4.0)])
def test_weights_are_those_of_newtons_method_on_every_repetition(seed: int, weights: tuple[float, ...]) -> None:
    examples = drawn(400, seed, weights)
    offset, slopes = newton(examples)
    odds = fit(examples, "drawn")
    for step in (odds.detector, odds.contours, odds.shape):
        assert step is not None
        assert step.offset == pytest.approx(offset, abs=1e-4)
        assert {name: step.weights[name] for name in WEIGHTS} == pytest.approx(slopes, abs=1e-4)


def test_a_known_logistic_model_is_recovered() -> None:
    """To four standard deviations of the estimate, from the curvature of the likelihood."""
    examples = drawn(5000, 7)
    values = np.array([[item.shape[name] for name in WEIGHTS] for item in examples])
    columns = np.column_stack([values, np.ones(len(values))])
    p = 1.0 / (1.0 + np.exp(-(OFFSET + values @ list(WEIGHTS.values()))))
    sigma = np.sqrt(np.diag(np.linalg.inv((columns.T * (p * (1.0 - p))) @ columns)))
    found = shape_of(fit(examples, "drawn"))
    for name, truth, error in zip((*WEIGHTS, "offset"), (*WEIGHTS.values(), OFFSET), sigma.tolist(), strict=True):
        value = found.offset if name == "offset" else found.weights[name]
        assert abs(value - truth) < 4.0 * error, name


@pytest.mark.parametrize("value", [0.0, 0.1, 1e-9, -1234.567])
def test_a_feature_that_never_varies_weighs_nothing(value: float) -> None:
    examples = drawn(300, 4, (1.0, 4.0))
    with_constant = [item._replace(shape={**item.shape, "constant": value}) for item in examples]
    found, plain = shape_of(fit(with_constant, "drawn")), shape_of(fit(examples, "drawn"))
    assert found.weights["constant"] == 0.0
    assert found.offset == pytest.approx(plain.offset, abs=1e-4)
    assert {name: found.weights[name] for name in plain.weights} == pytest.approx(plain.weights, abs=1e-4)


def test_units_of_a_feature_change_its_weight_and_nothing_else() -> None:
    examples = drawn(300, 5)
    in_cm = [item._replace(shape={**item.shape, "b": 100.0 * item.shape["b"] + 7.0}) for item in examples]
    found, plain = shape_of(fit(in_cm, "drawn")), shape_of(fit(examples, "drawn"))
    assert 100.0 * found.weights["b"] == pytest.approx(plain.weights["b"], abs=1e-3)
    assert found.weights["a"] == pytest.approx(plain.weights["a"], abs=1e-4)


def test_redundant_features_share_their_weight() -> None:
    examples = drawn(300, 6)
    twice = [item._replace(shape={**item.shape, "again": item.shape["a"]}) for item in examples]
    found = shape_of(fit(twice, "drawn")).weights
    assert found["again"] == pytest.approx(found["a"], abs=1e-4)
    assert found["a"] + found["again"] == pytest.approx(shape_of(fit(examples, "drawn")).weights["a"], rel=0.1)


def test_the_prior_is_the_log_odds_of_targets_among_what_the_examples_stand_for() -> None:
    examples = [example({"a": 0.0, "b": 0.0, "c": 0.0}, True)] * 3 + [
        example({"a": 1.0, "b": 0.0, "c": 0.0}, False, 4.0)
    ] * 15
    assert fit(examples, "counted").prior == pytest.approx(math.log(3.0 / 60.0), abs=1e-5)


def test_p_mine_summed_over_the_examples_is_the_number_of_targets() -> None:
    examples = drawn(400, 8, (1.0, 4.0))
    odds = fit(examples, "drawn")
    expected = sum(item.weight * odds.p_mine(odds.log_ratio("shape", item.shape)) for item in examples)
    assert expected == pytest.approx(sum(item.weight for item in examples if item.is_target), rel=1e-3)


def test_crowded_examples_teach_the_features_of_mines_but_not_their_rarity() -> None:
    """Ten times as many targets in the crowd, drawn from the same model but for its offset."""
    usual = drawn(4000, 12)
    crowd = [item._replace(usual=False) for item in drawn(4000, 13)]
    kept = [item for number, item in enumerate(crowd) if item.is_target or number % 10 == 0]
    alone, odds = fit(usual, "usual"), fit([*usual, *kept], "both")
    assert odds.prior == alone.prior
    assert shape_of(odds).weights["a"] == pytest.approx(shape_of(alone).weights["a"], abs=0.2)
    expected = sum(odds.p_mine(odds.log_ratio("shape", item.shape)) for item in usual)
    assert expected == pytest.approx(sum(item.is_target for item in usual), rel=1e-3)


def test_separable_examples_give_finite_weights() -> None:
    examples = [example({"a": float(number), "b": 0.0, "c": 0.0}, number >= 10) for number in range(20)]
    weight = shape_of(fit(examples, "separable")).weights["a"]
    assert 0.0 < weight < 5.0


def test_trees_weigh_what_a_sum_misses_and_details_as_well() -> None:
    """A target where `a` is middling and the detail `d` is high."""
    random = np.random.Generator(np.random.PCG64(11))
    values = random.normal(0.0, 1.0, (1500, 2))
    is_target = (np.abs(values[:, 0]) < 0.7) & (values[:, 1] > 0.0)
    examples = [
        example({"a": a}, bool(target))._replace(details={"d": d})
        for (a, d), target in zip(values.tolist(), is_target.tolist(), strict=True)
    ]
    odds = fit_table(look_table(examples), "a bump", 80)
    assert (len(odds.detector.trees), odds.contours, odds.shape) == (80, None, None)
    right = [(odds.detector.log_odds(item.detector | item.details) > odds.prior) == item.is_target for item in examples]
    assert np.mean(right) > 0.95
    whole = msgspec.structs.replace(odds, verifier=shipped_odds("cascade").verifier)
    assert parse_odds(calibrate.written(whole), "written.json") == whole


def test_log_odds_of_many_are_those_of_each() -> None:
    weights = shipped_odds("cascade").detector
    random = np.random.Generator(np.random.PCG64(5))
    names = sorted({*weights.weights, *(name for tree in weights.trees for name, *_ in tree.ask)})
    table = StepTable(tuple(names), 0, random.normal(0.0, 3.0, (50, len(names))))
    features = [dict(zip(names, row, strict=True)) for row in table.values.tolist()]
    assert log_odds_of(weights, table).tolist() == [weights.log_odds(known) for known in features]


@pytest.mark.parametrize("targets", [[], [False] * 4, [True] * 4])
def test_without_targets_or_without_others_nothing_is_fitted(targets: list[bool]) -> None:
    examples = [example({"a": 1.0}, is_target) for is_target in targets]
    with pytest.raises(
        UsageError,
        match=rf"seeds 1 to 2: {sum(targets)} targets in {len(targets)} detections\. Fly more missions, with --seeds",
    ):
        fit(examples, "seeds 1 to 2")


# ---------------------------------------------------------------- which detection is what

HOME = LocalFrame(latitude_deg=43.7, longitude_deg=10.3)
AROUND = Surroundings(
    codes=np.full((4, 4), 100, dtype=np.uint8), row=2.0, column=2.0, first_ground_range_m=10.0, first_return_m=5.0
)


class Truth(NamedTuple):
    east_m: float
    is_target: bool


def seen_at(east_m: float, p_mine: float = 0.5, **values: Any) -> Detection:
    latitude, longitude, _ = HOME.to_geodetic(np.array([east_m, 0.0, 0.0]))
    known: dict[str, Any] = {
        "time_s": 1000.0,
        "latitude_deg": float(latitude),
        "longitude_deg": float(longitude),
        "covariance_m2": 0.01 * np.eye(2),
        "highlight_db": east_m,
        "surroundings": AROUND,
        "p_mine": p_mine,
    }
    return drawn_looks.detection(**{**known, **values})


Fly = Callable[..., list[Example]]


@pytest.fixture
def fly(monkeypatch: pytest.MonkeyPatch) -> Fly:
    """Examples of a mission over the given objects, in which the detections given become final; every look measures the
    same."""

    def flown(
        detections: Iterable[Detection], scene_objects: Iterable[Truth], detector: Detector = "contrast"
    ) -> list[Example]:
        objects = []
        for scene_object in scene_objects:
            latitude, longitude, _ = HOME.to_geodetic(np.array([scene_object.east_m, 0.0, 0.0]))
            sizes = {"length_m": 1.0, "width_m": 0.5}
            objects.append(
                {"lat": float(latitude), "lon": float(longitude), "is_target": scene_object.is_target, **sizes}
            )

        class FakePipeline:
            def __init__(self, config: object, look: Callable[[Detection], Detection]) -> None:
                self.look = look

            def feed(self, event: NavSample) -> None:
                for detection in detections:
                    assert self.look(detection) is detection

            def finish(self) -> None:
                pass

        class Looked(NamedTuple):
            contour_features: dict[str, float]
            features: dict[str, float]

        odds = shipped_odds("contrast")
        measured = Looked(
            *(dict.fromkeys(step.weights, 0.5) for step in (odds.contours, odds.shape) if step is not None)
        )
        monkeypatch.setattr(calibrate, "Pipeline", FakePipeline)
        monkeypatch.setattr(calibrate, "examine", lambda *_: measured)
        return examples_along(Config(), [NavSample(time_s=0.0)], lambda: objects, usual=True, detector=detector)

    return flown


def labels(examples: list[Example]) -> list[tuple[float, bool]]:
    """Where each example lies, which its highlight encodes, and whether it is a target."""
    return [(round(item.detector["highlight_db"], 3), item.is_target) for item in examples]


def test_a_detection_at_a_target_is_one_and_all_else_is_not(fly: Fly) -> None:
    detections = [seen_at(0.3), seen_at(1.9), seen_at(20.0), seen_at(31.0)]
    scene_objects = [Truth(0.0, True), Truth(21.0, False)]
    assert labels(fly(detections[:1] + detections[2:], scene_objects)) == [(0.3, True), (20.0, False), (31.0, False)]
    assert labels(fly(detections[1:], scene_objects)) == [(1.9, True), (20.0, False), (31.0, False)]


def test_of_several_detections_of_a_target_the_most_mine_like_stands_for_it(fly: Fly) -> None:
    detections = [seen_at(0.1, 0.4), seen_at(0.5, 0.9), seen_at(-0.5, 0.6), seen_at(2.6, 0.95)]
    assert labels(fly(detections, [Truth(0.0, True)])) == [(0.5, True)]


def test_each_side_and_each_passage_has_its_own(fly: Fly) -> None:
    detections = [
        seen_at(0.1),
        seen_at(0.2, side="port"),
        seen_at(0.3, time_s=2000.0),
        seen_at(0.4, 0.1, time_s=2001.0),
    ]
    assert labels(fly(detections, [Truth(0.0, True)])) == [(0.1, True), (0.2, True), (0.3, True)]
    early, late = seen_at(0.1, time_s=1049.0), seen_at(0.4, 0.9, time_s=1051.0)  # either side of half a minute
    assert labels(fly([early, late], [Truth(0.0, True)])) == [(0.4, True)]


def test_other_objects_are_clutter_and_count_once_too(fly: Fly) -> None:
    assert labels(fly([seen_at(0.1, 0.4), seen_at(0.5, 0.3)], [Truth(0.0, False)])) == [(0.1, False)]


def test_a_detection_known_to_a_metre_only_may_lie_farther_off(fly: Fly) -> None:
    assert labels(fly([seen_at(2.9, covariance_m2=np.eye(2))], [Truth(0.0, True)])) == [(2.9, True)]
    assert labels(fly([seen_at(3.0)], [Truth(0.0, True)])) == [], "neither at it nor clear of it"


def test_faint_detections_are_thinned_and_those_kept_stand_for_the_others(fly: Fly) -> None:
    faint = [seen_at(100.0 + 10.0 * number, 0.01, ping_number=number) for number in range(24)]
    found = fly([*faint, seen_at(0.0, 0.5)], [])
    assert [(item.weight, item.detector["highlight_db"]) for item in found] == [
        (12.0, 100.0),
        (12.0, 220.0),
        (1.0, 0.0),
    ]


def test_a_faint_detection_on_an_object_is_kept(fly: Fly) -> None:
    (found,) = fly([seen_at(0.0, 0.01, ping_number=1)], [Truth(0.0, True)])
    assert (found.is_target, found.weight) == (True, 1.0)


def test_a_target_that_only_passed_over_detections_stand_for_is_left_out(fly: Fly) -> None:
    detections = [seen_at(0.1, 0.4), seen_at(0.3, 0.6, surroundings=None), seen_at(50.0)]
    assert labels(fly(detections, [Truth(0.0, True)])) == [(50.0, False)]


def test_every_step_has_its_features(fly: Fly) -> None:
    (found,) = fly([seen_at(0.0)], [])
    odds = shipped_odds("contrast")
    assert (found.detector.keys(), found.contours.keys(), found.shape.keys()) == (
        *(step.weights.keys() for step in (odds.detector, odds.contours, odds.shape) if step is not None),
    )
    assert found.details == detection_details(seen_at(0.0))
    (before_verifier,) = fly([seen_at(0.0)], [], "cascade")
    assert before_verifier == found._replace(contours={}, shape={})


def test_a_mission_that_finds_nothing_has_no_examples(fly: Fly) -> None:
    assert fly([], [Truth(0.0, True)]) == []


@pytest.mark.parametrize("name", [name for name in SCENES if name not in HELD_OUT])
def test_a_crowded_scene_has_more_mines_and_rocks_on_the_same_floor(name: str) -> None:
    scene = read_scene(name)
    crowd = crowded(scene, CROWD)
    usual, more = ({each.kind: each.count for each in one.scatter} for one in (scene, crowd))
    assert more == {kind: number if kind not in MINES_AND_ROCKS else CROWD * number for kind, number in usual.items()}
    assert min(each.apart_m for each in crowd.scatter if each.kind in MINES_AND_ROCKS) > 8.0, (
        "neighbours within which count as a crowd"
    )
    assert (crowd.world, crowd.sonar, crowd.track) == (scene.world, scene.sonar, scene.track)
    assert len(place_objects(crowd)) > 2.0 * len(place_objects(scene))
    assert crowded(scene, 1) == scene
