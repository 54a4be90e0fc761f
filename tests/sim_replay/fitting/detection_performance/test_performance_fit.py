"""The fit of performance against direct counts, the best of all one-humped sequences, and worlds whose answer is
known."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from auv_mcm.classify.beliefs import MINE_LIKE_P
from auv_mcm.clearance.detection_performance import FLOORS, CellView, parse_performance, shipped_performance
from auv_mcm.errors import BadInputError
from auv_mcm.records import SEABED_TYPES
from sim_replay.fitting.cascade.spec import SonarVariant
from sim_replay.fitting.detection_performance.calibrate_performance import (
    Flight,
    fly_scene,
    performance_fit_words,
    sweep_widths_m,
    tables,
)
from sim_replay.fitting.detection_performance.closed_form import p_found
from sim_replay.fitting.detection_performance.fit_performance import (
    EDGES_M,
    PRIOR_LOOKS,
    Outcomes,
    bands_of,
    correlation,
    counts,
    design_effect,
    fit_performance,
    one_hump,
    outcomes,
    pairs,
    predicted,
    smooth_bands,
)
from sim_replay.fitting.detection_performance.looks import CellPass
from sim_replay.fitting.theatre import Theatre
from sim_replay.text_tables import json_lines

Array = NDArray[np.float64]

KINDS = [name for name in SEABED_TYPES if name != "unknown"]


def look(
    mission: int,
    target: int,
    *,
    seabed: str = "flat",
    ground_m: float = 25.0,
    found: bool = True,
    look_deg: float = 0.0,
    time_s: float = 0.0,
    unevenness_db: float = 2.0,
) -> CellPass:
    return CellPass(
        mission=mission,
        target=target,
        floor="sand",
        seabed=[*SEABED_TYPES].index(seabed),  # type: ignore[arg-type]  # one of them
        ripple_rad=0.0 if seabed == "ripple" else None,
        ground_range_m=ground_m,
        altitude_m=6.5,
        look_rad=math.radians(look_deg),
        time_s=time_s,
        p_mine=MINE_LIKE_P if found else 0.0,
        unevenness_db=unevenness_db,
    )


def world(
    p_found_by_kind: dict[str, float], n_missions: int = 12, n_targets: int = 240, seed: int = 1
) -> list[CellPass]:
    """Targets everywhere at every range and aspect, each look found on its own."""
    rng = np.random.Generator(np.random.PCG64(seed))
    return [
        look(
            mission,
            target,
            seabed=KINDS[target % len(KINDS)],
            ground_m=float(rng.uniform(3.0, 74.0)),
            found=bool(rng.uniform() < p_found_by_kind[KINDS[target % len(KINDS)]]),
            look_deg=float(rng.uniform(0.0, 360.0)),
        )
        for mission in range(n_missions)
        for target in range(n_targets)
    ]


def test_counts_are_those_of_counting() -> None:
    seen = outcomes(world(dict.fromkeys(KINDS, 0.5), n_missions=2))
    band = bands_of(seen, 0.0)
    n, k = counts(seen.floor, band), counts(seen.floor, band, seen.found)
    for floor, number in itertools.product(range(len(FLOORS)), range(len(EDGES_M) - 1)):
        here = [
            i
            for i in range(len(seen.found))
            if seen.floor[i] == floor and EDGES_M[number] <= seen.ground_range_m[i] < EDGES_M[number + 1]
        ]
        assert n[floor, number] == len(here)
        assert k[floor, number] == sum(bool(seen.found[i]) for i in here)


def test_tables_show_what_is_found_where_floor_is_no_more_uneven_than_usual() -> None:
    """In a world where each decibel beyond takes 0.7 off the log-odds of 1.5; four in five looks are beyond."""
    rng = np.random.Generator(np.random.PCG64(3))
    looks = [
        look(
            mission,
            target,
            seabed=KINDS[target % len(KINDS)],
            ground_m=ground_m,
            found=found,
            look_deg=look_deg,
            unevenness_db=db,
        )
        for mission in range(12)
        for target in range(300)
        for ground_m, db, look_deg in rng.uniform((10.0, 1.0, 0.0), (70.0, 6.0, 360.0), (1, 3)).tolist()
        for found in [bool(rng.uniform() < 1.0 / (1.0 + math.exp(0.7 * max(db - 2.0, 0.0) - 1.5)))]
    ]
    fitted = fit_performance(looks, "a world")
    assert fitted.loss_per_db == pytest.approx(0.7, abs=0.08)
    assert fitted.floors["flat"][4].p == pytest.approx(1.0 / (1.0 + math.exp(-1.5)), abs=0.06)
    seen = outcomes(looks)
    far = seen.unevenness_db > 5.0
    assert predicted(fitted, seen)[far].mean() == pytest.approx(seen.found[far].mean(), abs=0.04)


def best_one_hump(value: Array, weight: Array) -> float:
    """Least weighted squares over all ways to cut a sequence into blocks whose means rise, then fall."""
    best = math.inf
    for cuts in itertools.product((False, True), repeat=len(value) - 1):
        block = np.concatenate([[0], np.cumsum(cuts)]).astype(int)
        mean = np.bincount(block, value * weight) / np.bincount(block, weight)
        top = int(np.argmax(mean))
        if (np.diff(mean[: top + 1]) >= 0.0).all() and (np.diff(mean[top:]) <= 0.0).all():
            best = min(best, float((weight * (value - mean[block]) ** 2).sum()))
    return best


@settings(max_examples=60)
@given(st.lists(st.tuples(st.floats(0.0, 1.0), st.floats(0.1, 100.0)), min_size=1, max_size=6))
def test_one_hump_is_the_best_of_all(drawn: list[tuple[float, float]]) -> None:
    value, weight = np.array(drawn).T
    block = one_hump(value, weight)
    mean = np.bincount(block, value * weight)[block] / np.bincount(block, weight)[block]
    top = int(np.argmax(mean))
    assert (np.diff(mean[: top + 1]) >= -1e-12).all()
    assert (np.diff(mean[top:]) <= 1e-12).all()
    assert float((weight * (value - mean) ** 2).sum()) <= best_one_hump(value, weight) + 1e-9


BANDS = st.lists(st.tuples(st.integers(0, 400), st.floats(0.0, 1.0), st.floats(0.0, 1.0)), min_size=1, max_size=8)


@settings(max_examples=60)
@given(BANDS, st.floats(1.0, 10.0))
def test_probabilities_lie_in_their_intervals_whatever_was_counted(
    bands: list[tuple[int, float, float]], effect: float
) -> None:
    n = np.array([float(looks) for looks, *_ in bands])
    k = np.array([math.floor(looks * share) for looks, share, _ in bands], dtype=np.float64)
    p, low, high = smooth_bands(k, n, np.array([prior for *_, prior in bands]), effect)
    assert (low >= 0.0).all()
    assert (low <= p).all()
    assert (p <= high).all()
    assert (high <= 1.0).all()


@settings(max_examples=60)
@given(st.integers(1, 500), st.integers(0, 499), st.floats(0.0, 1.0))
def test_more_found_is_more_likely(n: int, k: int, prior: float) -> None:
    k = min(k, n - 1)
    one, more = (
        smooth_bands(np.array([float(count)]), np.array([float(n)]), np.array([prior])).p[0] for count in (k, k + 1)
    )
    assert more > one
    assert one == pytest.approx((k + PRIOR_LOOKS * prior) / (n + PRIOR_LOOKS))


def test_no_look_at_all_leaves_the_prior_and_all_found_or_none_stays_inside() -> None:
    p, low, high = smooth_bands(np.zeros(1), np.zeros(1), np.array([0.3]))
    assert p[0] == pytest.approx(0.3)
    assert low[0] < 0.3 < high[0]
    for found, prior in ((0.0, 0.0), (1e6, 1.0)):
        p, low, high = smooth_bands(np.array([found]), np.array([1e6]), np.array([prior]))
        assert 0.0 <= low[0] <= p[0] <= high[0] <= 1.0
        assert high[0] - low[0] > 0.0


def test_missions_that_are_all_alike_count_every_look_and_others_do_not() -> None:
    alike = outcomes(world(dict.fromkeys(KINDS, 0.5), seed=3))
    assert design_effect(alike, bands_of(alike, 0.0)) < 1.2
    rng = np.random.Generator(np.random.PCG64(4))
    apart = alike._replace(found=rng.uniform(size=len(alike.found)) < np.where(alike.mission % 2 == 0, 0.1, 0.9))
    assert design_effect(apart, bands_of(apart, 0.0)) > 2.0


def test_the_fit_matches_the_world_and_can_be_written() -> None:
    truth = {"flat": 0.8, "ripple": 0.5, "rough": 0.3, "vegetation": 0.15}
    looks = world(truth)
    reported = fit_performance(looks, performance_fit_words(range(800, 802), 6, looks))
    assert parse_performance(json_lines(reported), "here") == reported
    assert reported.fitted_on == "2880 looks at 2880 targets in 12 simulated missions: seeds 800 to 801, 6 each"
    for kind, p in truth.items():
        for ground_m in (15.0, 25.0, 35.0, 45.0):
            assert reported.p_look(CellView(SEABED_TYPES.index(kind), ground_m, 6.5, 0.0, 0.0)) == pytest.approx(
                p, abs=0.15
            )
    assert sum(band.n_looks for bands in reported.floors.values() for band in bands) == len(looks)
    widths_m = dict(zip(FLOORS, sweep_widths_m(reported), strict=True))
    assert widths_m["vegetation"] < widths_m["rough"] < widths_m["flat"] < 75.0
    assert all(floor.split("_")[0] in tables(reported) for floor in FLOORS)


def test_a_fit_without_some_floor_or_with_one_mission_is_refused() -> None:
    with pytest.raises(BadInputError, match=r"^here: no look at ripple_across.*--seeds"):
        fit_performance([look(1, 1), look(2, 1)], "here")
    one = world(dict.fromkeys(KINDS, 0.5), n_missions=1)
    with pytest.raises(BadInputError, match=r"^here: one mission.*--seeds"):
        fit_performance(one, "here")


def test_pairs_are_looks_at_one_target_by_direction_in_order_of_time() -> None:
    looks = [
        look(1, 1, time_s=50.0, look_deg=5.0),
        look(1, 1, time_s=0.0, look_deg=355.0),
        look(1, 1, time_s=90.0, look_deg=180.0),
        look(1, 2, time_s=10.0),
        look(2, 1, time_s=20.0),
    ]
    same, other = pairs(outcomes(looks))
    assert list(zip(*(part.tolist() for part in same), strict=True)) == [(1, 0)]
    assert sorted(zip(*(part.tolist() for part in other), strict=True)) == [(0, 2), (1, 2)]


@settings(max_examples=30, deadline=None)
@given(st.floats(0.05, 0.95), st.floats(0.05, 0.95), st.floats(0.0, 1.0))
def test_correlation_comes_back_from_how_many_are_missed_twice(first: float, second: float, rho: float) -> None:
    n = 20_000
    missed = np.arange(n) < round(n * (1.0 - first) * (1.0 - second) ** (1.0 - rho))
    assert correlation(np.full(n, first), np.full(n, second), missed) == pytest.approx(
        rho, abs=0.05 if second > 0.2 else 0.2
    )


def test_correlation_stays_between_nothing_and_all() -> None:
    p, none = np.full(10, 0.5), np.zeros(0)
    assert correlation(p, p, np.ones(10, dtype=np.bool_)) == pytest.approx(1.0)
    assert correlation(p, p, np.zeros(10, dtype=np.bool_)) == pytest.approx(0.0)
    assert correlation(none, none, np.zeros(0, dtype=np.bool_)) == 0.0


@settings(max_examples=40)
@given(st.floats(0.1, 500.0), st.floats(0.5, 100.0), st.floats(0.01, 1e3))
def test_the_closed_form_is_a_probability_and_no_better_over_a_restless_floor(
    ground_m: float, altitude_m: float, texture: float
) -> None:
    restless, even = (float(p_found(np.array([ground_m]), altitude_m, shape)[0]) for shape in (texture, 2.0 * texture))
    assert 0.0 <= restless <= 1.0
    assert restless <= even + 0.02


def test_no_outcomes_are_no_outcomes() -> None:
    empty: Outcomes = outcomes([])
    assert all(len(column) == 0 for column in empty)


def test_tables_for_a_wide_beam_promise_what_it_finds() -> None:
    """Over a drawn world that no table was fitted on; the tables as they are promise 0.3 more."""
    width_deg = 1.3
    looks = outcomes(fly_scene(Flight(958, 1), Theatre(sonars=(SonarVariant(beam_width_deg=width_deg),))))
    narrow = shipped_performance()
    narrow_p, wide_p = (
        float(predicted(one, looks).mean()) for one in (narrow, narrow.for_beam(math.radians(width_deg)))
    )
    assert float(looks.found.mean()) == pytest.approx(wide_p, abs=0.1)
    assert narrow_p > wide_p + 0.2
