"""A cascade over a plane: the same as window by window, whatever the numbers' origin, the threads or the budget."""

from __future__ import annotations

import itertools
import math
from concurrent.futures import ThreadPoolExecutor

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from auv_mcm.detect.cascade.bands import REFERENCE_HEIGHT_M
from auv_mcm.detect.cascade.run import CascadeResult, core_plane, opening_groups, run_plane
from auv_mcm.errors import UsageError
from auv_mcm.records import LOW_RESOLUTION, NAN, VALID, Tile
from tests.auv_mcm.detect.drawn_cascades import COLUMN_M, ROW_M, Ground, brute_force, draw_ground, draw_model, n_windows
from tests.make.records import pose_of, tile_with

seeds = st.integers(0, 2**32 - 1)
kinds = st.sampled_from(["soft", "stages"])


def found(result: CascadeResult) -> dict[tuple[int, int], int]:
    rows, columns, scores = (values.tolist() for values in result[:3])
    return dict(zip(zip(rows, columns, strict=True), scores, strict=True))


def same(one: CascadeResult, other: CascadeResult) -> bool:
    return found(one) == found(other) and one[3:] == other[3:]


def make_tile(intensity: np.ndarray, mask: np.ndarray, first_return_m: np.ndarray, core: slice | None = None) -> Tile:
    n_rows = intensity.shape[0]
    core = core or slice(0, n_rows)
    place = {"core_start": core.start, "core_stop": core.stop, "row_spacing_m": ROW_M, "column_spacing_m": COLUMN_M}
    return tile_with(intensity, mask.astype(np.uint8), pose=pose_of(n_rows), first_return_m=first_return_m, **place)


@given(seed=seeds, kind=kinds)
@settings(deadline=None, max_examples=30)
def test_finds_what_one_window_after_the_other_finds(seed: int, kind: str) -> None:
    ground, model = draw_ground(seed), draw_model(seed, kind=kind)
    result = run_plane(ground.plane(), model, None)
    assert found(result) == brute_force(ground, model)
    assert list(found(result)) == sorted(found(result))
    assert result.n_windows == n_windows(ground, REFERENCE_HEIGHT_M)
    assert result.n_cut == 0
    assert result.evaluated_fraction == 1.0
    entered = (result.n_windows, *result.n_alive[:-1])
    assert result.n_evaluations == sum(n * len(group) for n, group in zip(entered, model.groups, strict=True))


@given(seed=seeds, share=st.floats(0.0, 1.2))
@settings(deadline=None, max_examples=40)
def test_a_larger_budget_loses_no_window(seed: int, share: float) -> None:
    plane, model = draw_ground(seed).plane(), draw_model(seed)
    whole = run_plane(plane, model, None)
    budgets = sorted(
        {math.floor(share * whole.n_evaluations), *(math.floor(k * whole.n_evaluations / 4) for k in range(6))}
    )
    results = [run_plane(plane, model, budget) for budget in budgets]
    for budget, result in zip(budgets, results, strict=True):
        assert result.n_evaluations <= budget
        assert found(result).items() <= found(whole).items()
        assert result.evaluated_fraction == pytest.approx(1.0 - result.n_cut / max(whole.n_windows, 1))
        assert result.n_cut > 0 or same(result, whole)
    for less, more in itertools.pairwise(results):
        assert found(less).items() <= found(more).items()
        assert less.n_cut >= more.n_cut


@pytest.mark.parametrize("sizes", [(16, 8), (4, 4), (2, 3, 9, 7, 12), (8,)])
def test_no_window_that_the_budget_cuts_counts_as_rejected_or_as_seen_by_the_last_group(sizes: tuple[int, ...]) -> None:
    plane, model = draw_ground(29, 40, 60).plane(), draw_model(29, sizes=sizes)
    whole = run_plane(plane, model, None)
    entered = (whole.n_windows, *whole.n_alive)
    assert whole.n_rejected == whole.n_windows - entered[-2]
    for share in np.linspace(0.0, 1.0, 12):
        less = run_plane(plane, model, int(share * whole.n_evaluations))
        assert 0 <= less.n_rejected <= min(whole.n_rejected, less.n_windows - less.n_cut)


def test_the_best_of_the_opening_go_on_when_the_budget_does_not_last_for_all() -> None:
    plane = draw_ground(3, 40, 60).plane()
    model = draw_model(3, reject=-(10**6))
    first = opening_groups(model)
    opening = msgspec.structs.replace(model, groups=model.groups[:first], reject=model.reject[:first])
    ranked = sorted(found(run_plane(plane, opening, None)).values(), reverse=True)
    opening_cost = len(ranked) * opening.n_stumps
    budget = opening_cost + 100 * (model.n_stumps - opening.n_stumps)
    result = run_plane(plane, model, budget)
    scores = found(run_plane(plane, opening, None))
    assert 95 <= len(result.rows) <= 100
    assert result.n_evaluations > 0.9 * budget
    assert sorted((scores[place] for place in found(result)), reverse=True) == ranked[: len(result.rows)]


@given(seed=seeds)
@settings(deadline=None, max_examples=20)
def test_no_budget_finds_nothing_and_says_so(seed: int) -> None:
    result = run_plane(draw_ground(seed).plane(), draw_model(seed), 0)
    assert len(result.rows) == 0
    assert result.n_evaluations == 0
    assert result.n_cut == result.n_windows
    assert result.evaluated_fraction == (0.0 if result.n_windows else 1.0)


@given(
    seed=seeds,
    budget=st.none() | st.integers(0, 20_000),
    offset=st.integers(0, 2**32 - 1),
    n_offset=st.integers(0, 2**32 - 1),
)
@settings(deadline=None, max_examples=30)
def test_a_constant_added_to_the_integral_images_changes_nothing(
    seed: int, budget: int | None, offset: int, n_offset: int
) -> None:
    plane, model = draw_ground(seed).plane(), draw_model(seed)
    moved = plane._replace(sums=plane.sums + np.uint32(offset), counts=plane.counts + np.uint32(n_offset))
    assert same(run_plane(moved, model, budget), run_plane(plane, model, budget))


@given(seed=seeds, before=st.integers(0, 9), behind=st.integers(0, 9))
@settings(deadline=None, max_examples=30)
def test_where_a_tile_is_cut_along_the_track_changes_no_window_well_inside(seed: int, before: int, behind: int) -> None:
    whole, model = draw_ground(seed, 40), draw_model(seed)
    part = slice(before, 40 - behind)
    cut = Ground(whole.codes[part], whole.valid[part], whole.usable[part], whole.first_return_m[part])
    reach = math.ceil(1.0 / ROW_M) + 1
    inside = range(part.start + reach, part.stop - reach)
    expected = {
        place: score for place, score in found(run_plane(whole.plane(), model, None)).items() if place[0] in inside
    }
    shifted = {
        (row + before, column): score for (row, column), score in found(run_plane(cut.plane(), model, None)).items()
    }
    assert {place: score for place, score in shifted.items() if place[0] in inside} == expected


def test_threads_do_not_disturb_each_other() -> None:
    planes, model = [draw_ground(seed, 60, 80).plane() for seed in range(4)], draw_model(7)
    budgets = (None, 20_000)
    expected = [run_plane(plane, model, budget) for plane in planes for budget in budgets]
    with ThreadPoolExecutor(8) as pool:
        again = list(pool.map(lambda job: run_plane(*job), [(p, model, b) for p in planes for b in budgets] * 4))
    assert all(same(one, other) for one, other in zip(again, expected * 4, strict=True))


@pytest.mark.parametrize("shape", [(1, 40), (14, 1), (14, 3), (1, 1), (3, 2)])
def test_tiles_smaller_than_a_window_are_run_as_any_other(shape: tuple[int, int]) -> None:
    ground, model = draw_ground(5, *shape), draw_model(5)
    assert found(run_plane(ground.plane(), model, None)) == brute_force(ground, model)


@pytest.mark.parametrize("shape", [(0, 40), (14, 0)])
def test_a_tile_without_pixels_holds_nothing(shape: tuple[int, int]) -> None:
    codes, valid = np.zeros(shape, dtype=np.uint16), np.zeros(shape, dtype=np.bool_)
    result = run_plane(Ground(codes, valid, valid, np.full(shape[0], 5.0)).plane(), draw_model(1), None)
    assert (len(result.rows), result.n_windows, result.n_evaluations) == (0, 0, 0)


def test_a_tile_without_echoes_costs_nothing() -> None:
    shape = (20, 40)
    result = run_plane(core_plane(make_tile(np.zeros(shape), np.zeros(shape), np.full(20, NAN))), draw_model(1), None)
    assert (len(result.rows), result.n_windows, result.n_evaluations, result.evaluated_fraction) == (0, 0, 0, 1.0)


def test_strange_intensities_neither_warn_nor_stay() -> None:
    random = np.random.Generator(np.random.PCG64(4))
    intensity = random.exponential(size=(30, 50)).astype(np.float32)
    strange = (np.nan, np.inf, -np.inf, 1e-42, -1e-42, 3e38, -1.0, -0.0)
    places = random.choice(intensity.size, 64, replace=False).reshape(8, 8)
    for value, where in zip(strange, places, strict=True):
        intensity.ravel()[where] = value
    meant = np.nan_to_num(np.clip(intensity, 0.0, 16.0), nan=1.0)
    mask = np.full(intensity.shape, VALID)
    model = draw_model(4)
    result = run_plane(core_plane(make_tile(intensity, mask, np.full(30, 5.0))), model, None)
    known = run_plane(
        core_plane(make_tile(meant, np.where(np.isnan(intensity), 0, mask), np.full(30, 5.0))), model, None
    )
    assert same(result, known)
    assert not np.isnan(intensity[result.rows, result.columns]).any()


def test_windows_stand_in_the_core_and_a_metre_around_it_where_resolution_is_good() -> None:
    shape = (40, 60)
    mask = np.full(shape, VALID)
    mask[:, :12] |= LOW_RESOLUTION
    mask[:, 30] = 0
    tile = make_tile(np.ones(shape), mask, np.full(40, 6.0), slice(15, 25))
    result = run_plane(core_plane(tile), draw_model(1, reject=-(10**6)), None)
    margin = round(1.0 / ROW_M) + 1
    assert set(result.rows.tolist()) == set(range(15 - margin, 25 + margin))
    assert result.columns.min() == 12
    assert 30 not in result.columns


def test_sums_are_exact_far_beyond_what_the_numbers_hold() -> None:
    codes = np.full((1200, 400), 16384, dtype=np.uint16)  # 7.9e9 in all
    codes[1150:1160, 300:305] = 100
    everywhere = np.ones(codes.shape, dtype=np.bool_)
    usable = np.zeros_like(everywhere)
    usable[1120:1190, 250:350] = True
    far = Ground(codes, everywhere, usable, np.full(1200, 30.0))
    near = Ground(codes[1100:], everywhere[1100:], usable[1100:], np.full(100, 30.0))
    model = draw_model(11)
    shifted = {(row + 1100, column): score for (row, column), score in brute_force(near, model).items()}
    assert found(run_plane(far.plane(), model, None)) == shifted


def test_pixels_too_fine_for_exact_sums_are_refused() -> None:
    ground = draw_ground(1, 2, 2)._replace(row_m=0.01, column_m=0.01)
    with pytest.raises(UsageError, match="use coarser pixels"):
        run_plane(ground.plane(), draw_model(1), None)
