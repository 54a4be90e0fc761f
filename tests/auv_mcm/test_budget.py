"""One budget for a tile: more of it never finds less, it is never exceeded, and what is not done earns less
coverage."""

from __future__ import annotations

import itertools
import math
from functools import cache, partial

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from auv_mcm.budget import (
    CHEAPER_STAGE_WORTH,
    RESERVED_LOOKS,
    Allowance,
    covered_share,
    look_price_us,
    pay_looks,
    tile_allowance,
    tile_duration_s,
)
from auv_mcm.classify.odds import shipped_odds
from auv_mcm.confirmation import detector_p_mine
from auv_mcm.contacts.export import contacts_geojson
from auv_mcm.detect.cascade.choose import shipped_model
from auv_mcm.detect.detect_tile import TileDetections, detect_tile
from auv_mcm.detect.gate import shipped_gate
from auv_mcm.errors import UsageError
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import CoveragePatch, Detection, Notice, PipelineEvent, SourceEvent, Tile
from auv_mcm.settings.budget_settings import BudgetConfig
from auv_mcm.settings.config import Config, WaterfallConfig, config_yaml, parse_config
from sim_replay.benches.run_time.lines import crowded
from sim_replay.missions import config_for
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.scene import Lawnmower, Scene
from sim_replay.simulator.scene_file import read_scene

DUTIES = (1e-4, 0.02, 0.03, 0.04, 1.0)
"""From less than the cheapest pass to more than everything."""
_WINDOWS_FROM_US = RESERVED_LOOKS * look_price_us(BudgetConfig())
BUDGETS_US = (
    0.0,
    *np.geomspace(2e3, 3e6, 16).tolist(),
    *(_WINDOWS_FROM_US + np.linspace(1e3, 9e3, 9)).tolist(),
    math.inf,
)
"""Of a tile, beyond the cheapest pass; some of them pay for a part of the cascade."""
# Thrice the distance at which two places are one: windows are thinned, moved to the clearest pixel, and thinned again
REACH_M = 1.3
MIN_P_MINE = Config().confirm.min_p_mine


@cache
def scene() -> Scene:
    """A short leg over rough ground, where there is most to measure and to look at."""
    rough = crowded(read_scene("rough"), 0.4)
    assert isinstance(rough.track.plan, Lawnmower)
    plan = msgspec.structs.replace(rough.track.plan, n_legs=1, leg_m=40.0)
    return msgspec.structs.replace(rough, seed=42, track=msgspec.structs.replace(rough.track, plan=plan))


@cache
def mission() -> tuple[SourceEvent, ...]:
    return tuple(Mission(scene()).events())


def config(duty: float | None) -> Config:
    given = config_for(scene())
    return msgspec.structs.replace(
        given, waterfall=msgspec.structs.replace(given.waterfall, tile_rows=128), budget=BudgetConfig(duty=duty)
    )


@cache
def run(duty: float | None, threads: int = 1) -> tuple[Pipeline, tuple[PipelineEvent, ...]]:
    pipeline = Pipeline(config(duty), threads=threads)
    events = [found for event in mission() for found in pipeline.feed(event)]
    return pipeline, (*events, *pipeline.finish())


@cache
def tiles() -> tuple[Tile, ...]:
    return tuple(event for event in run(None)[1] if isinstance(event, Tile))[2:4]


@cache
def within(which: int, left_us: float) -> TileDetections:
    """What is found in a tile with so much beyond the cheapest pass."""
    allowance = Allowance(left_us, 0.0, BudgetConfig())
    found = detect_tile(
        tiles()[which], config(None), shipped_model(), shipped_gate(), max_evaluations=allowance.comparisons()
    )
    return pay_looks(found, allowance, partial(detector_p_mine, odds=shipped_odds("cascade")), MIN_P_MINE)


def looked_at(found: TileDetections) -> set[tuple[float, float]]:
    """Places worth an examination that get one."""
    odds = shipped_odds("cascade")
    return {
        (d.row, d.column)
        for d in found.detections
        if d.surroundings is not None and detector_p_mine(d, odds) >= MIN_P_MINE
    }


def confirmed(pipeline: Pipeline) -> dict[tuple[str, float, float], float]:
    """p_mine of every view that had an examination."""
    views: list[Detection] = [
        view for contact in pipeline.contacts for view in contact.views if view.confirmation is not None
    ]
    return {(view.side, view.row, view.column): view.p_mine for view in views}


def covered_m2(events: tuple[PipelineEvent, ...]) -> float:
    return sum(event.covered_m2 for event in events if isinstance(event, CoveragePatch))


budgets = st.sampled_from(BUDGETS_US)


@given(which=st.integers(0, 1), one=budgets, other=budgets)
@settings(deadline=None, max_examples=60)
def test_more_budget_looks_at_no_place_less_and_earns_no_less_coverage(which: int, one: float, other: float) -> None:
    less, more = within(which, min(one, other)), within(which, max(one, other))
    assert less.n_cut >= more.n_cut
    assert less.covered_share <= more.covered_share
    assert looked_at(less) <= looked_at(more)


@given(which=st.integers(0, 1), one=budgets, other=budgets)
@settings(deadline=None, max_examples=60)
def test_with_more_budget_each_place_is_found_or_a_stronger_one_beside_it(which: int, one: float, other: float) -> None:
    less, more = within(which, min(one, other)), within(which, max(one, other))
    tile = tiles()[which]
    places = [(d.row, d.column, d.strength) for d in more.detections] + list(
        zip(*(values.tolist() for values in more.faint), strict=True)
    )
    rows, columns, strength = np.array(places).reshape(-1, 3).T
    for d in less.detections:
        near = (np.abs(rows - d.row) * tile.row_spacing_m <= REACH_M) & (
            np.abs(columns - d.column) * tile.column_spacing_m <= REACH_M
        )
        assert (strength[near] >= d.strength).any()


@given(which=st.integers(0, 1), left_us=budgets)
@settings(deadline=None, max_examples=30)
def test_no_more_work_is_planned_than_is_paid(which: int, left_us: float) -> None:
    prices, found = BudgetConfig(), within(which, left_us)
    n_looks, peaks_us = len(looked_at(found)), len(found.detections) * prices.peak_us
    planned_us = found.n_evaluations * prices.comparison_us + n_looks * look_price_us(prices)
    # Measuring is always done, and so are the reserved looks with the whole cascade.
    assert found.n_cut == found.n_windows or planned_us <= left_us
    assert n_looks <= RESERVED_LOOKS or planned_us + peaks_us <= left_us


@given(which=st.integers(0, 1), left_us=budgets)
@settings(deadline=None, max_examples=30)
def test_the_whole_cascade_never_goes_without_close_looks(which: int, left_us: float) -> None:
    found = within(which, left_us)
    assert found.n_cut or len(looked_at(found)) >= min(RESERVED_LOOKS, len(looked_at(within(which, math.inf))))


def test_the_budgets_of_these_tests_go_from_the_cheapest_pass_to_everything() -> None:
    none, whole = within(0, 0.0), within(0, math.inf)
    assert none.n_cut == none.n_windows
    assert not looked_at(none)
    assert none.detections
    assert none.covered_share == CHEAPER_STAGE_WORTH**2
    assert (whole.n_cut, whole.covered_share) == (0, 1.0)
    assert any(0 < within(0, left_us).n_cut < whole.n_windows for left_us in BUDGETS_US)
    assert len(looked_at(whole)) >= 3
    assert len(looked_at(within(1, math.inf))) > 3
    assert any(0 < len(looked_at(within(0, left_us))) < len(looked_at(whole)) for left_us in BUDGETS_US)


def test_over_a_mission_more_duty_confirms_no_contact_less_and_covers_no_less() -> None:
    runs = [run(duty) for duty in DUTIES]
    for (less, before), (more, after) in itertools.pairwise(runs):
        assert less.counters["detect.windows_cut"] >= more.counters["detect.windows_cut"]
        assert covered_m2(before) <= covered_m2(after)
        assert confirmed(less).keys() <= confirmed(more).keys()
    assert not confirmed(runs[0][0])
    assert 0 < len(confirmed(runs[2][0])) < len(confirmed(runs[-1][0]))


def test_a_budget_that_is_never_reached_changes_no_byte() -> None:
    assert contacts_geojson(run(1.0)[0].contacts) == contacts_geojson(run(None)[0].contacts)
    assert not {name for name in run(None)[0].counters if name.startswith("budget.")}


def test_the_same_log_and_budget_give_the_same_bytes_whatever_the_threads() -> None:
    assert contacts_geojson(run(0.03, 3)[0].contacts) == contacts_geojson(run(0.03)[0].contacts)


def test_what_a_budget_leaves_out_is_counted_reported_once_and_said_of_the_contact() -> None:
    pipeline, events = run(0.03)
    assert pipeline.counters["confirm.beyond_budget"] > 0
    assert pipeline.counters["budget.tile_limited"] > 0
    notices = [event for event in events if isinstance(event, Notice) and event.code == "budget.tile_limited"]
    assert [("budget.duty" in notice.text, "examinations" in notice.text) for notice in notices] == [(True, True)]
    assert sum("over_budget" in contact.reasons for contact in pipeline.contacts) > 0
    patches = [event for event in events if isinstance(event, CoveragePatch)]
    assert any(patch.lost_m2["over_budget"] > 0.0 and patch.covered_m2 > 0.0 for patch in patches)


def test_where_not_even_the_cheapest_pass_is_paid_it_is_done_and_said_once() -> None:
    pipeline, events = run(DUTIES[0])
    assert (
        len([event for event in events if isinstance(event, Notice) and event.code == "budget.cheapest_pass_over"]) == 1
    )
    assert pipeline.counters["budget.cheapest_pass_over"] == sum(isinstance(event, Tile) for event in events)
    assert pipeline.contacts


def test_a_service_that_is_behind_leaves_work_out_without_a_notice_of_the_configuration() -> None:
    pipeline = Pipeline(config(None))
    pipeline.leave_room(0.0)
    events = [found for event in mission() for found in pipeline.feed(event)]
    assert pipeline.counters["budget.tile_limited"] == sum(isinstance(event, Tile) for event in events)
    assert not [event for event in events if isinstance(event, Notice) and event.code.startswith("budget.")]
    pipeline.leave_room(1.0)
    n_limited = pipeline.counters["budget.tile_limited"]
    pipeline.finish()
    assert pipeline.counters["budget.tile_limited"] == n_limited


def test_a_tiles_budget_is_the_time_that_passes_over_its_core() -> None:
    tile = tiles()[0]
    speed_mps = scene().track.speed_mps
    assert tile_duration_s(tile) == pytest.approx(128 * tile.row_spacing_m / speed_mps, rel=0.1)
    given = tile_allowance(tile, 1000.0, 2, BudgetConfig(duty=0.1))
    assert given.total_us == pytest.approx(0.1 * tile_duration_s(tile) * 1e6 / 2)
    n_pixels = 128 * tile.mask.shape[1]
    assert given.cheapest_us == pytest.approx(1000.0 * BudgetConfig().sample_us + n_pixels * BudgetConfig().pixel_us)
    assert tile_allowance(tile, 1000.0, 2, BudgetConfig(duty=0.1), 0.5).total_us == pytest.approx(0.5 * given.total_us)
    assert tile_allowance(tile, 1000.0, 2, BudgetConfig()).comparisons() is None


def test_without_a_verifier_a_look_is_priced_as_an_examination() -> None:
    """As with a detector of contrasts alone, whose looks end later: at this duty they are more than is paid."""
    usual = config(0.04)
    pipeline = Pipeline(msgspec.structs.replace(usual, detect=msgspec.structs.replace(usual.detect, model="none")))
    for event in mission():
        pipeline.feed(event)
    pipeline.finish()
    assert pipeline.counters["confirm.beyond_budget"] > 0
    examination_us = look_price_us(BudgetConfig(), has_verifier=False)
    assert Allowance(1e6, 0.0, BudgetConfig(), has_verifier=False).n_looks(0, 0) == math.floor(1e6 / examination_us)
    assert look_price_us(BudgetConfig()) < 0.5 * examination_us


def test_a_tile_whose_times_are_unknown_has_no_time() -> None:
    tile = tiles()[0]
    timeless = msgspec.structs.replace(
        tile, pose=msgspec.structs.replace(tile.pose, time_s=np.full(len(tile.pose), math.nan))
    )
    assert tile_allowance(timeless, 0.0, 2, BudgetConfig(duty=1.0)).left_us == 0.0


@given(
    n=st.integers(1, 1000),
    cuts=st.tuples(st.integers(0, 1000), st.integers(0, 1000)),
    looks=st.tuples(st.floats(0, 1), st.floats(0, 1)),
)
def test_more_windows_and_more_looks_never_earn_less(n: int, cuts: tuple[int, int], looks: tuple[float, float]) -> None:
    some, fewer = (min(cut, n) for cut in (max(cuts), min(cuts)))
    assert 0.0 < covered_share(n, some, min(looks)) <= covered_share(n, fewer, max(looks)) <= 1.0
    assert covered_share(n, 0, 1.0) == 1.0


def test_the_budget_survives_its_file_and_the_former_key_is_refused_with_the_new_one() -> None:
    changed = Config(budget=BudgetConfig(duty=0.25, peak_us=900.0), waterfall=WaterfallConfig())
    assert parse_config(config_yaml(changed), "vehicle.yaml") == changed
    with pytest.raises(UsageError, match=r"vehicle\.yaml: detect\.max_evaluations_per_tile is gone: budget\.duty"):
        parse_config("detect:\n  max_evaluations_per_tile: 40000000\n", "vehicle.yaml")
    with pytest.raises(UsageError, match=r"budget\.duty"):
        parse_config("budget:\n  duty: 1.5\n", "vehicle.yaml")
