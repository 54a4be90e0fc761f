"""Confirmation: a mine among bare floor, and what becomes of detections that nothing can be said about."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from auv_mcm.classify.beliefs import singleton_belief
from auv_mcm.classify.chips import chip_of, chips_beside
from auv_mcm.classify.odds import shipped_odds
from auv_mcm.classify.size_evidence import size_evidence
from auv_mcm.classify.targets import NOT_LISTED, parse_targets
from auv_mcm.classify.verifier import mean_scores, network_of, opinions_of
from auv_mcm.confirm.region import HIGHLIGHT, SHADOW, Region
from auv_mcm.confirm.snake import RegionContext, converge_on, survey
from auv_mcm.confirm.speckle import grain_area
from auv_mcm.confirmation import confirm_detection, examine, labels_near, opinions_on, region_of, without_confirmation
from auv_mcm.records import NAN, Confirmation, Detection, Surroundings
from auv_mcm.settings.config import ConfirmConfig
from auv_mcm.snippet import pack_snippet
from sim_replay.simulator.scene import SceneObject
from tests.auv_mcm.classify.drawn_looks import detection
from tests.make.rendered_solids import rendered_region

BEAM_RAD = math.radians(0.5)
EVERYTHING = ConfirmConfig(min_p_mine=0.0)
MARGIN_ROWS, MARGIN_COLUMNS = 4, 5  # of the snippet within the surroundings


def detection_in(region: Region, **values: Any) -> Detection:
    """The detection at a region's highlight, with the region around it."""
    codes = pack_snippet(np.where(region.valid, np.maximum(region.intensity, 1e-4), 0.0))
    ground_range_m = region.first_ground_range_m + region.column * region.column_spacing_m
    known: dict[str, Any] = {
        "row": 1000.0 + region.row,
        "column": ground_range_m / region.column_spacing_m,
        "ground_range_m": ground_range_m,
        "slant_range_m": math.hypot(ground_range_m, region.altitude_m),
        "altitude_m": region.altitude_m,
        "highlight_db": 10.0,
        "shadow_db": -9.0,
        "reasons": ("highlight_and_shadow",),
        "snippet": codes[MARGIN_ROWS:-MARGIN_ROWS, MARGIN_COLUMNS:-MARGIN_COLUMNS],
        "snippet_row": region.row - MARGIN_ROWS,
        "snippet_column": region.column - MARGIN_COLUMNS,
        "row_spacing_m": region.row_spacing_m,
        "column_spacing_m": region.column_spacing_m,
        "surroundings": Surroundings(
            codes=codes,
            row=region.row,
            column=region.column,
            first_ground_range_m=region.first_ground_range_m,
            first_return_m=region.altitude_m,
        ),
    }
    return detection(**{**known, **values})


def mine(kind: str, seed: int, **sizes: float) -> Region:
    return rendered_region(SceneObject(kind=kind, east_m=18.0, north_m=0.0, **sizes), seed)  # type: ignore[arg-type]  # a kind by its name


def bare_floor(seed: int) -> Region:
    region = mine("sphere", seed, width_m=0.8)
    speckle = np.random.Generator(np.random.PCG64(seed)).exponential(1.0, region.intensity.shape)
    return msgspec.structs.replace(region, intensity=speckle)


def close_look(detection: Detection, config: ConfirmConfig = EVERYTHING) -> Detection:
    return confirm_detection(detection, BEAM_RAD, shipped_odds("contrast"), config)


def confirmed(detection: Detection) -> Confirmation:
    found = close_look(detection).confirmation
    assert found is not None
    return found


@pytest.fixture(scope="module")
def cylinder() -> Detection:
    return detection_in(mine("cylinder", 3, width_m=0.52, length_m=2.0, azimuth_deg=20.0))


def test_a_cylinder_is_called_one_and_a_mine(cylinder: Detection) -> None:
    found = close_look(cylinder)
    assert found.confirmation is not None
    model = found.confirmation.model
    assert model is not None
    assert model.classification == "cylinder"
    assert abs(model.sizes["length_m"] - 2.0) < 4.0 * model.sigma["length_m"]
    belief = singleton_belief(found.confirmation.mass)
    assert max(belief, key=lambda name: belief[name]) == "cylinder"
    assert not found.confirmation.rejected
    assert found.p_mine > close_look(detection_in(bare_floor(3))).p_mine


def test_a_list_takes_from_a_kind_that_it_does_not_hold_no_more_than_its_bound(cylinder: Detection) -> None:
    before = confirmed(cylinder)
    for text, is_listed in (
        ("mines: [{kind: cylinder, length_m: 2.0, diameter_m: 0.52}]", True),
        ("mines: [{kind: sphere, diameter_m: 0.6}]", False),
    ):
        sizes = size_evidence(parse_targets(text, "a list"))
        found = confirm_detection(cylinder, BEAM_RAD, shipped_odds("contrast"), EVERYTHING, sizes=sizes).confirmation
        assert found is not None
        change = found.log_ratio - before.log_ratio
        assert (change > 0.0) is is_listed
        assert abs(change) <= -math.log(NOT_LISTED) + 1e-9
        assert ("not_listed" in found.reasons) is (change <= -0.5)


def test_contours_move_again_from_the_labels_where_that_explains_more() -> None:
    region = mine("sphere", 0, width_m=0.8)
    ground = survey(region, grain_area(region.intensity, region.valid))
    assert isinstance(ground, RegionContext)
    first = converge_on(ground, ground.boxes)
    assert examine(detection_in(region), region, None, 0.0).contours.criterion < first.criterion - 5.0


def test_what_is_drawn_lies_on_the_object_in_the_snippet(cylinder: Detection) -> None:
    found = confirmed(cylinder)
    assert found.labels.shape == cylinder.snippet.shape
    assert found.model is not None
    shadow = np.argwhere(found.labels == SHADOW) + 0.5
    highlight = np.argwhere(found.labels == HIGHLIGHT) + 0.5
    for contour, labels in ((found.shadow, shadow), (found.highlight, highlight), (found.model.shadow, shadow)):
        middle = 0.5 * (contour.min(axis=0) + contour.max(axis=0))
        assert np.abs(middle - labels.mean(axis=0)) * (
            cylinder.row_spacing_m,
            cylinder.column_spacing_m,
        ) == pytest.approx(0.0, abs=0.4)


def test_in_the_shadow_of_something_nearer_there_is_no_evidence_for_a_mine(cylinder: Detection) -> None:
    region = mine("cylinder", 3, width_m=0.52, length_m=2.0, azimuth_deg=20.0)
    shadowed = region.intensity.copy()
    shadowed[:, : int(region.column + 0.6 / region.column_spacing_m)] *= 0.01  # its echo as well
    found = close_look(detection_in(msgspec.structs.replace(region, intensity=shadowed)))
    assert found.confirmation is not None
    assert "in_shadow" in found.confirmation.reasons
    assert "in_shadow" not in confirmed(cylinder).reasons
    assert found.confirmation.log_ratio <= 0.0 < confirmed(cylinder).log_ratio
    prior = shipped_odds("contrast").p_mine(0.0)
    assert max(found.p_by_step["contours"], found.p_by_step["shape"]) <= prior


def test_p_mine_is_that_of_the_last_step_taken(cylinder: Detection) -> None:
    found = close_look(cylinder)
    assert list(found.p_by_step) == ["detector", "contours", "shape"]
    assert found.p_mine == found.p_by_step["shape"]
    assert found.surroundings is None


def test_no_step_follows_one_that_leaves_the_odds_too_low(cylinder: Detection) -> None:
    full = close_look(cylinder)
    for least, steps in (
        (1.0, ["detector"]),
        (0.999 * min(full.p_by_step.values()), ["detector", "contours", "shape"]),
    ):
        found = close_look(cylinder, ConfirmConfig(min_p_mine=least))
        assert list(found.p_by_step) == steps
        assert ("not_looked_at" in found.reasons) == (found.confirmation is None)
        assert found.p_mine == full.p_by_step[found_last(found)]


def found_last(detection: Detection) -> Any:
    *_, last = detection.p_by_step
    return last


def test_detections_passed_over_keep_the_detectors_odds_and_say_why(cylinder: Detection) -> None:
    p_mine = close_look(cylinder).p_by_step["detector"]
    found = without_confirmation(cylinder, p_mine, "over_budget")
    assert found.reasons[-1] == "over_budget"
    assert found.confirmation is None
    assert found.surroundings is None
    assert found.p_mine == p_mine


def test_the_network_is_asked_again_where_a_mine_is_not_improbable(cylinder: Detection) -> None:
    odds = msgspec.structs.replace(shipped_odds("contrast"), verifier=shipped_odds("cascade").verifier)
    assert odds.verifier is not None
    network, other_nats = network_of(odds.verifier.digest), odds.verifier.other_nats
    looks = [cylinder, detection_in(bare_floor(7))]
    seen, bare = (region_of(look, look.surroundings, BEAM_RAD) for look in looks if look.surroundings)
    once = network.scores([chip_of(seen), chip_of(bare)])
    four = mean_scores(once[:1], network.scores(chips_beside(seen, chip_of(seen))))
    expected = opinions_of(np.concatenate([four, once[1:]]), other_nats)
    assert opinions_on(looks, BEAM_RAD, odds) == expected
    assert expected[0] != opinions_of(once, other_nats)[0]


def test_a_look_is_the_same_every_time(cylinder: Detection) -> None:
    encoded = [msgspec.json.encode(close_look(cylinder), enc_hook=lambda array: array.tolist()) for _ in range(2)]
    assert encoded[0] == encoded[1]


def test_a_region_holds_what_the_surroundings_held() -> None:
    region = mine("sphere", 1, width_m=0.8)
    detection = detection_in(
        msgspec.structs.replace(
            region, valid=np.broadcast_to(np.arange(region.intensity.shape[1]) % 7 > 0, region.intensity.shape)
        )
    )
    assert detection.surroundings is not None
    again = region_of(detection, detection.surroundings, BEAM_RAD)
    assert np.array_equal(again.valid, detection.surroundings.codes > 0)
    clipped = np.clip(region.intensity, 1e-4, 10.0**2.35)
    assert np.abs(10.0 * np.log10(again.intensity[again.valid] / clipped[again.valid])).max() < 0.126
    assert (again.row, again.column, again.altitude_m) == (region.row, region.column, region.altitude_m)


@pytest.mark.parametrize("first_return_m", [NAN, 0.0, -1.0, math.inf])
def test_a_detection_without_geometry_is_reported_and_not_confirmed(cylinder: Detection, first_return_m: float) -> None:
    around = cylinder.surroundings
    assert around is not None
    found = close_look(
        msgspec.structs.replace(cylinder, surroundings=msgspec.structs.replace(around, first_return_m=first_return_m))
    )
    assert found.reasons[-1] == "geometry_unknown"
    assert found.confirmation is None


@settings(max_examples=20, deadline=None)
@given(
    n_rows=st.integers(1, 40),
    n_columns=st.integers(1, 60),
    level=st.sampled_from(["nothing", "constant", "speckle", "extremes"]),
    seed=st.integers(0, 99),
)
def test_whatever_surrounds_a_detection_it_comes_out_with_a_probability(
    n_rows: int, n_columns: int, level: str, seed: int
) -> None:
    random = np.random.Generator(np.random.PCG64(seed))
    codes = {
        "nothing": np.zeros((n_rows, n_columns)),
        "constant": np.full((n_rows, n_columns), 161),
        "speckle": random.integers(100, 190, (n_rows, n_columns)),
        "extremes": random.choice([0, 1, 255], (n_rows, n_columns)),
    }[level].astype(np.uint8)
    region = mine_template()
    around = Surroundings(
        codes=codes, row=0.4 * n_rows, column=0.4 * n_columns, first_ground_range_m=10.0, first_return_m=5.0
    )
    detection = detection_in(
        region, surroundings=around, snippet=codes, snippet_row=0.4 * n_rows, snippet_column=0.4 * n_columns
    )
    found = close_look(detection)
    assert 0.0 <= found.p_mine <= 1.0
    assert found.confirmation is None or found.confirmation.mass.sum() == pytest.approx(1.0)


def mine_template() -> Region:
    plane = np.ones((20, 20))
    return Region(
        intensity=plane,
        valid=plane > 0.0,
        row_spacing_m=0.12,
        column_spacing_m=0.06,
        first_ground_range_m=10.0,
        altitude_m=5.0,
        row=10.0,
        column=8.0,
        beam_width_rad=BEAM_RAD,
    )


def test_the_labels_of_a_detection_are_the_connected_ones_that_reach_it() -> None:
    region = mine_template()
    labels = np.zeros((20, 20), dtype=np.uint8)
    labels[9:12, 7:9], labels[9:12, 9:14] = HIGHLIGHT, SHADOW
    own = labels.copy()
    labels[0:3, 16:20] = SHADOW
    near = labels_near(labels, region)
    assert near is not None
    assert np.array_equal(near, own)
    assert (
        labels_near(np.where(own, 0, labels).astype(np.uint8), msgspec.structs.replace(region, row=18.0, column=1.0))
        is None
    )
