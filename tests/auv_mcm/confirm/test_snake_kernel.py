"""Moves of the polygon pair: sums, criterion, legality, and the C kernel against its twin."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from auv_mcm.confirm.snake import COARSE, FINE, snake_settings
from auv_mcm.confirm.snake_rules import contour_mask
from auv_mcm.kernels import snake, snake_criterion, snake_twin
from auv_mcm.kernels.snake_criterion import HIGHLIGHT, SHADOW, EdgeSums, Settings
from auv_mcm.kernels.snake_descent import Course, descend, descend_numpy, row_intervals
from auv_mcm.kernels.snake_elsewhere import elsewhere, elsewhere_numpy, evidence
from auv_mcm.kernels.snake_twin import Moved
from tests.make.drawn_contours import box, drawn_pair, plain_region

Floats = NDArray[np.float64]
NONE = np.empty((0, 2))
SHORT = np.array([(4, 2.0, 3), (6, 1.0, 2), (0, 0.0, 1), (0, 1.0, 1)])
SHAPE = (24, 30)


def window(seed: int, shape: tuple[int, int] = SHAPE) -> tuple[Floats, Settings]:
    """A small scene with a highlight in columns 6 to 10 and a shadow behind up to 20, rows 8 to 16."""
    random = np.random.default_rng(seed)
    mean = np.ones(shape)
    mean[8:16, 6:10] = 8.0
    mean[8:16, 10:20] = 0.1
    region = plain_region(mean * random.exponential(1.0, shape), row=12.0, column=8.0)
    table = snake.window_row_sums(region.intensity, region.valid).table
    return table, snake_settings(region, table, 1.0)


def inside_by_ray(nodes: Floats, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Even-odd rule at each pixel centre, one ray at a time."""
    inside = np.zeros(shape, dtype=np.bool_)
    for row, column in itertools.product(*map(range, shape)):
        r, c = row + 0.5, column + 0.5
        for (r0, c0), (r1, c1) in zip(nodes.tolist(), np.roll(nodes, -1, axis=0).tolist(), strict=True):
            if (r0 <= r) != (r1 <= r):
                (ra, ca), (rb, cb) = ((r0, c0), (r1, c1)) if r0 < r1 else ((r1, c1), (r0, c0))
                if ca + (r - ra) * ((cb - ca) / (rb - ra)) <= c:
                    inside[row, column] ^= True
    return inside


@st.composite
def polygons(draw: st.DrawFn) -> Floats:
    """Row-convex polygons: a far side and a near side over the same rows."""
    rows = sorted(draw(st.lists(st.integers(0, 4 * SHAPE[0]), min_size=2, max_size=6, unique=True)))
    near = [draw(st.integers(0, 50)) for _ in rows]
    far = [draw(st.integers(60, 4 * SHAPE[1])) for _ in rows]
    down = [(row / 4, column / 4) for row, column in zip(rows, far, strict=True)]
    up = [(row / 4, column / 4) for row, column in zip(rows, near, strict=True)]
    return np.array(down + up[::-1])


def criterion_by_pixels(table: Floats, known: Settings, highlight: Floats, shadow: Floats) -> float:
    """J from the definition: masks, means and rows, nothing cumulative."""
    shape = table.shape[0], table.shape[1] - 1
    image, count = np.diff(table, axis=1)[..., 0], np.diff(table, axis=1)[..., 1]
    masks = [
        inside_by_ray(nodes, shape) if len(nodes) else np.zeros(shape, dtype=np.bool_) for nodes in (highlight, shadow)
    ]
    total = 0.0
    for side, mask in enumerate([*masks, ~(masks[0] | masks[1])]):
        n = float(count[mask].sum())
        if n == 0.0:
            continue
        mean = float(image[mask].sum()) / n
        level = max(mean, known.faintest)
        if side == HIGHLIGHT:
            level = max(level, known.dimmest_highlight)
        if side == SHADOW:
            level = min(level, known.brightest_shadow)
        total += (n * math.log(level) + float(image[mask].sum()) / level - n) / known.correlation_px
        total += max(0.5 * math.log(n / known.correlation_px), 0.0)
    for nodes in (highlight, shadow):
        if len(nodes):
            n = len(nodes)
            rows, columns = np.abs(np.diff(nodes, axis=0, append=nodes[:1])).mean(axis=0)
            total += math.log(math.prod(shape) / known.correlation_px) + 2.0 * math.log(n)
            total += n * (2.0 * math.log(2.0 * math.e) + math.log(max(rows * columns / known.correlation_px, 0.25)))
    if len(shadow):
        edges = [np.flatnonzero(row)[[0, -1]] + [0, 1] for row in masks[1] if row.any()]
        near_m, far_m = known.first_ground_range_m + np.mean(edges, axis=0) * known.column_spacing_m
        height = known.altitude_m * (1.0 - math.hypot(near_m, known.altitude_m) / math.hypot(far_m, known.altitude_m))
        total += 0.5 * (max(0.0, height - known.height_limit_m) / known.height_sigma_m) ** 2
        total += known.forbidden * max(0.0, height - known.height_bound_m)
    if len(highlight) and len(shadow):
        for end in (np.min, np.max):
            apart_m = abs(end(highlight[:, 0]) - end(shadow[:, 0])) * known.row_spacing_m
            total += 0.5 * (max(0.0, apart_m - known.extent_tolerance_m) / known.extent_sigma_m) ** 2
        gaps = [
            int(np.flatnonzero(s)[0]) - int(np.flatnonzero(h)[-1]) - 1
            for h, s in zip(*masks, strict=True)
            if h.any() and s.any()
        ]
        gap_m = float(np.mean(np.maximum(gaps, 0))) * known.column_spacing_m
        total += 0.5 * (max(0.0, gap_m - known.gap_tolerance_m) / known.gap_sigma_m) ** 2
        total += known.forbidden * float(np.maximum(-np.array(gaps), 0).sum())
        total += known.forbidden * max(0.0, float(highlight[:, 1].min() - shadow[:, 1].min()))
    return total


@settings(max_examples=40, deadline=None)
@given(nodes=polygons())
def test_sums_over_a_polygon_are_those_of_its_pixels(nodes: Floats) -> None:
    table, _ = window(3)
    inside = inside_by_ray(nodes, SHAPE)
    edges = snake_criterion.sums_of(table, np.full(SHAPE[0], -1.0), HIGHLIGHT, nodes)
    total = EdgeSums(*np.sum(edges, axis=0))
    assert total.total == np.diff(table, axis=1)[..., 0][inside].sum()  # exact, in any order
    assert total.measured == total.area == inside.sum()
    assert total.rows == inside.any(axis=1).sum()


@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 1000), corners=st.tuples(*[st.integers(-1, 3)] * 7))
def test_c_and_twin_take_the_same_moves_to_the_last_bit(seed: int, corners: tuple[int, ...]) -> None:
    table, known = window(seed)
    highlight = box(9 + corners[0], 4 + corners[1], 15 + corners[2], 9 + corners[1])
    shadow = box(9 + corners[3], 11 + corners[4], 15 + corners[5], 20 + corners[6])
    fast, slow = (
        snake.move_pair(table, known, SHORT, highlight, shadow),
        snake_twin.move_pair(table, known, SHORT, highlight, shadow),
    )
    assert_same(fast, slow)


def test_c_and_twin_agree_on_a_whole_run() -> None:
    drawn = drawn_pair(0)
    part = drawn.region.intensity[34:94, 24:104]
    region = plain_region(part, row=30.0, column=15.0)
    table = snake.window_row_sums(part, region.valid).table
    known = snake_settings(region, table, 2.5)
    start = box(22, 10, 36, 20), box(22, 20, 36, 40)
    schedule = np.array(COARSE + FINE)
    assert_same(snake.move_pair(table, known, schedule, *start), snake_twin.move_pair(table, known, schedule, *start))


@pytest.mark.parametrize("alone", [HIGHLIGHT, SHADOW])
def test_c_and_twin_agree_on_one_polygon_alone(alone: int) -> None:
    table, known = window(5)
    start = [NONE, NONE]
    start[alone] = (box(9, 5, 14, 9), box(9, 11, 14, 18))[alone]
    fast = snake.move_pair(table, known, SHORT, *start)
    assert_same(fast, snake_twin.move_pair(table, known, SHORT, *start))
    assert len((fast.highlight, fast.shadow)[1 - alone]) == 0


def assert_same(one: Moved, other: Moved) -> None:
    assert np.array_equal(one.highlight, other.highlight)
    assert np.array_equal(one.shadow, other.shadow)
    assert one[2:] == other[2:]


@pytest.mark.parametrize("correlation_px", [1.0, 4.0])
@pytest.mark.parametrize("seed", range(6))
def test_criterion_is_what_its_definition_says(seed: int, correlation_px: float) -> None:
    table, known = window(seed)
    known = known._replace(correlation_px=correlation_px, log_window=math.log(math.prod(SHAPE) / correlation_px))
    pairs = [
        (box(8, 6, 16, 10), box(8, 10, 16, 20)),
        (box(2, 1, 7, 9), box(5, 8, 20, 29)),  # overlap, extents and height out of range
        (NONE, box(6, 9, 18, 22)),
        (box(6, 9, 18, 22), NONE),
    ]
    for pair in pairs:
        moved = snake.move_pair(table, known, np.empty((0, 3)), *pair)
        overlapping = moved.highlight_sums.overlap + moved.shadow_sums.overlap > 0.0
        if overlapping:  # pixels of the overlap count twice until it is gone
            assert moved.criterion > known.forbidden
        else:
            assert moved.criterion == pytest.approx(criterion_by_pixels(table, known, *pair), rel=1e-12, abs=1e-9)


@pytest.mark.parametrize("seed", range(8))
def test_final_criterion_is_that_of_the_final_polygons(seed: int) -> None:
    table, known = window(seed)
    moved = snake.move_pair(table, known, SHORT, box(9, 5, 14, 9), box(9, 10, 14, 18))
    again = snake.move_pair(table, known, np.empty((0, 3)), moved.highlight, moved.shadow)
    assert again.criterion == moved.criterion
    assert moved.criterion == pytest.approx(criterion_by_pixels(table, known, moved.highlight, moved.shadow), rel=1e-12)


@pytest.mark.parametrize("seed", range(8))
def test_no_move_and_no_pruning_raises_the_criterion(seed: int) -> None:
    table, known = window(seed)
    highlight, shadow = box(9, 5, 14, 9), box(9, 10, 14, 18)
    nodes = [4, 4, 4, 4, 4]
    before = snake.move_pair(table, known, np.empty((0, 3)), highlight, shadow).criterion
    for n, length in zip(nodes, (3.0, 2.0, 1.0, 1.0, 0.0), strict=True):
        moved = snake.move_pair(table, known, np.array([(n, length, 1)]), highlight, shadow)
        assert moved.criterion <= before
        assert (moved.criterion < before) == (moved.n_moves > 0)
        highlight, shadow, before = moved.highlight, moved.shadow, moved.criterion


@pytest.mark.parametrize("seed", range(8))
def test_polygons_stay_simple_and_two_sided(seed: int) -> None:
    table, known = window(seed)
    moved = snake.move_pair(table, known, np.array(COARSE + FINE), box(9, 5, 14, 9), box(9, 10, 14, 18))
    for nodes in (moved.highlight, moved.shadow):
        assert snake_twin.is_sound(nodes)
        inside = inside_by_ray(nodes, SHAPE)
        assert (np.abs(np.diff(inside.astype(int), axis=1, prepend=0, append=0)).sum(axis=1) <= 2).all()
        sides = list(zip(nodes, np.roll(nodes, -1, axis=0), strict=True))
        for (i, one), (j, other) in itertools.combinations(enumerate(sides), 2):
            if j - i not in (1, len(sides) - 1):
                assert not properly_cross(one, other)


def properly_cross(one: tuple[Floats, Floats], other: tuple[Floats, Floats]) -> bool:
    """Solve for the crossing of the two lines."""
    way, across = one[1] - one[0], other[1] - other[0]
    system = np.array([way, -across]).T
    if abs(np.linalg.det(system)) < 1e-12:
        return False
    where = np.linalg.solve(system, other[0] - one[0])
    return bool(((where >= 0.0) & (where <= 1.0)).all())


def test_no_rectangle_pair_of_a_tiny_image_is_better_than_the_best_start_finds() -> None:
    shape = (12, 18)
    for seed in range(3):
        random = np.random.default_rng(seed)
        mean = np.ones(shape)
        mean[4:8, 3:6] = 10.0
        mean[4:8, 6:13] = 0.05
        region = plain_region(mean * random.exponential(1.0, shape), row=6.0, column=4.0)
        table = snake.window_row_sums(region.intensity, region.valid).table
        known = snake_settings(region, table, 1.0)._replace(min_area_px=4.0)
        schedule = np.array([(4, 2.0, 20), (4, 1.0, 20)])
        found = min(
            snake.move_pair(
                table, known, schedule, box(top, 1, top + 5, foot), box(top, foot, top + 5, foot + length)
            ).criterion
            for top, foot, length in itertools.product((2, 3, 4), (5, 6, 7), (4, 7))
        )
        rows = [(top, bottom) for top in range(2, 6) for bottom in range(top + 2, 11)]
        best = min(
            snake.move_pair(
                table, known, np.empty((0, 3)), box(top, near, bottom, foot), box(top, foot, bottom, far)
            ).criterion
            for top, bottom in rows
            for near, foot, far in itertools.product(range(1, 4), range(5, 8), range(10, 17))
        )
        assert found <= best


def test_highlight_stays_before_the_shadow_and_beside_it() -> None:
    drawn = drawn_pair(1)
    table = snake.window_row_sums(drawn.region.intensity, drawn.region.valid).table
    known = snake_settings(drawn.region, table, 1.0)
    # overlapping at first
    moved = snake.move_pair(table, known, np.array(COARSE + FINE), box(56, 30, 70, 50), box(56, 40, 70, 60))
    assert moved.shadow_sums.overlap == 0.0
    assert moved.criterion < 0.0
    gap_m = moved.shadow_sums.gap / moved.shadow_sums.shared * known.column_spacing_m
    assert gap_m < 0.5
    assert np.abs(moved.highlight[:, 0].min() - moved.shadow[:, 0].min()) * known.row_spacing_m < 0.5


@pytest.mark.parametrize(
    ("highlight", "shadow", "reason"),
    [
        (NONE, NONE, "neither"),
        (NONE, np.zeros((2, 2)), "3 to 64 nodes"),
        (NONE, box(-1, 2, 5, 9), "outside the window"),
        (NONE, box(2, 2, 5, np.nan), "outside the window"),
        (NONE, box(2, 2, 3, 4), "fewer than 9 pixels"),
        (NONE, box(2, 2, 9, 9)[::-1], "runs up its far side"),
        (np.array([(2.0, 2.0), (9.0, 12.0), (2.0, 12.0), (12.0, 2.0)]), NONE, "crosses itself"),
        (np.array([(2.0, 9.0), (9.0, 9.0), (9.0, 9.0), (9.0, 2.0), (2.0, 2.0)]), NONE, "coinciding"),
    ],
)
def test_polygons_that_cannot_move_are_refused(highlight: Floats, shadow: Floats, reason: str) -> None:
    table, known = window(0)
    with pytest.raises(ValueError, match=reason):
        snake.move_pair(table, known, SHORT, highlight, shadow)


@pytest.mark.parametrize("schedule", [[(4, 0.3, 2)], [(65, 1.0, 2)], [(4, -1.0, 2)], [(4, 1.0)]])
def test_schedules_that_mean_nothing_are_refused(schedule: list[tuple[float, ...]]) -> None:
    table, known = window(0)
    with pytest.raises(ValueError, match="schedule"):
        snake.move_pair(table, known, np.array(schedule), NONE, box(9, 10, 14, 18))


def test_row_sums_leave_out_what_was_not_measured() -> None:
    intensity = np.array([[1.0, np.nan, 3.0], [np.inf, 2.0, -1.0]])
    valid = np.array([[True, True, False], [True, True, True]])
    sums = snake.window_row_sums(intensity, valid)
    assert sums.mean == 1.5
    assert sums.table[:, -1, 1].tolist() == [1.0, 1.0]
    assert sums.table[:, -1, 0].tolist() == pytest.approx([1.0 / 1.5, 2.0 / 1.5], abs=snake.QUANTUM)


@given(nodes=polygons(), as_drawn=st.booleans())
@settings(max_examples=60, deadline=None)
def test_row_intervals_are_those_of_edges_taken_one_by_one(nodes: Floats, as_drawn: bool) -> None:
    nodes = nodes if as_drawn else nodes[::-1]
    sides = snake.sides_numpy(nodes, *SHAPE)
    np.testing.assert_array_equal(snake.sides(nodes, *SHAPE), sides)
    wanted = np.flatnonzero((sides[0] >= 0) & (sides[1] > sides[0]))
    rows, near, far = row_intervals(nodes, SHAPE)
    np.testing.assert_array_equal(rows, wanted)
    np.testing.assert_array_equal([near, far], sides[:, wanted])
    painted = np.zeros(SHAPE, dtype=np.bool_)
    for row, start, stop in zip(rows, near, far, strict=True):
        painted[row, start:stop] = True
    np.testing.assert_array_equal(contour_mask(nodes, SHAPE), painted)


def test_no_nodes_reach_no_rows() -> None:
    assert all(len(part) == 0 for part in row_intervals(NONE, SHAPE))
    with pytest.raises(ValueError, match="nodes must have shape"):
        snake.sides(np.zeros((4, 3)), *SHAPE)
    assert not contour_mask(NONE, SHAPE).any()


@given(nodes=polygons(), clockwise=st.booleans())
@settings(max_examples=60, deadline=None)
def test_c_finds_the_fault_that_the_twin_finds(nodes: Floats, clockwise: bool) -> None:
    table, known = window(2)
    nodes = nodes[::-1] if clockwise else nodes
    assert snake.fault_of(table, known, nodes) == snake_twin.fault_of(table, known, nodes)


@given(polygons(), polygons(), st.sampled_from(["both", "highlight", "shadow"]))
@settings(max_examples=60, deadline=None)
def test_c_finds_elsewhere_what_the_twin_finds(highlight: Floats, shadow: Floats, given_parts: str) -> None:
    table, _ = window(3)
    none = np.empty((0, 2))
    pair = (
        (HIGHLIGHT, none if given_parts == "shadow" else highlight),
        (SHADOW, none if given_parts == "highlight" else shadow),
    )
    np.testing.assert_allclose(elsewhere(table, pair), elsewhere_numpy(table, pair), rtol=1e-12)


def test_evidence_elsewhere_is_that_of_the_shifted_pixels() -> None:
    table, _ = window(3)
    pixels = np.diff(table, axis=1)
    n_rows, n_columns = pixels.shape[:2]
    nodes = box(8, 6, 12, 10)
    there = []
    for row in range(-8, n_rows - 12 + 1, 2):
        for column in range(-6, n_columns - 10 + 1, 4):
            if abs(row) >= 4 or abs(column) >= 4:
                there.append(pixels[8 + row : 12 + row, 6 + column : 10 + column].sum(axis=(0, 1)))
    found = [evidence(HIGHLIGHT, *sums.tolist()) for sums in there]
    here = evidence(HIGHLIGHT, *pixels[8:12, 6:10].sum(axis=(0, 1)).tolist())
    assert here > 0.0
    expected = max(found) / here, float(np.quantile(found, 0.95)) / here
    assert elsewhere(table, ((HIGHLIGHT, nodes),)) == pytest.approx(expected, rel=1e-12)


def test_polygons_beyond_the_window_are_not_looked_for_elsewhere() -> None:
    table, _ = window(3)
    assert elsewhere(table, ((SHADOW, box(0, 0, *SHAPE)),))[1] in (0.0, math.inf)
    with pytest.raises(ValueError, match="outside the window of 24 rows and 30 columns"):
        elsewhere(table, ((SHADOW, box(4, 4, 25, 12)),))


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("parts", ["both", "highlight", "shadow"])
def test_c_descends_as_move_after_move_does(seed: int, parts: str) -> None:
    table, known = window(seed)
    highlight, shadow = box(7, 5, 15, 9 + seed % 3), box(9, 11, 15, 16 + seed)
    start = (NONE if parts == "shadow" else highlight), (NONE if parts == "highlight" else shadow)
    one, n_moves = descend(table, known, Course(COARSE, FINE, FINE[-2:]), *start, 4.0 + seed)
    other, n_others = descend_numpy(table, known, Course(COARSE, FINE, FINE[-2:]), *start, 4.0 + seed)
    assert_same(one, other)
    assert n_moves == n_others


def test_a_start_that_cannot_move_is_refused_on_the_way_down() -> None:
    table, known = window(1)
    for function in (descend, descend_numpy):
        with pytest.raises(ValueError, match="shadow covers fewer than 9 pixels"):
            function(table, known, Course(COARSE, FINE, ()), NONE, box(9, 11, 11, 13), 4.0)


@pytest.mark.parametrize("seed", range(3))
def test_settled_nodes_would_not_have_moved(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    table, known = window(seed)
    start = box(7, 5, 15, 9), box(9, 11, 15, 16 + seed)
    schedule = np.array([(4, 2.0, 20), (6, 1.0, 20)])
    with_skips = snake_twin.move_pair(table, known, schedule, *start)

    class Unsettled(set[tuple[int, int]]):
        def add(self, item: tuple[int, int]) -> None:
            """Keep every node in doubt."""

    monkeypatch.setattr(snake_twin, "set", Unsettled, raising=False)
    without = snake_twin.move_pair(table, known, schedule, *start)
    assert without.n_proposed > with_skips.n_proposed
    assert_same(without._replace(n_proposed=with_skips.n_proposed), with_skips)
