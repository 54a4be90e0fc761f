"""Extreme regions and starts through the snakes: flagged results, no floating-point flag, the same every time."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from auv_mcm import kernels
from auv_mcm.confirm.region import Region
from auv_mcm.confirm.snake import Contours, Start, converge, snake_settings, start_from_detection
from auv_mcm.kernels import snake
from tests.make.drawn_contours import box, plain_region
from tests.stability.region_doors import assert_sound, plain

SHAPE = (64, 80)
NONE = np.empty((0, 2))


def scene(seed: int = 0) -> Region:
    random = np.random.default_rng(seed)
    mean = np.ones(SHAPE)
    mean[25:38, 20:27] = 8.0
    mean[25:38, 27:55] = 0.1
    return plain_region(mean * random.exponential(1.0, SHAPE), row=31.0, column=23.0)


def looked_at(region: Region, start: Start | None = None, correlation_px: float = 1.0) -> Contours:
    """Contours, with every floating-point flag but underflow an error."""
    with np.errstate(all="raise", under="ignore"):
        contours = converge(
            region, start_from_detection(region) if start is None else start, correlation_px=correlation_px
        )
    assert_sound(contours, region)
    return contours


def same(one: Contours, other: Contours) -> bool:
    return bool(plain(one) == plain(other))


@pytest.mark.parametrize(
    "nodes",
    [
        np.full((4, 2), 30.0),
        np.array([(10.0, 10.0), (20.0, 20.0), (30.0, 30.0)]),
        np.array([(20.0, 20.0), (40.0, 50.0), (20.0, 50.0), (40.0, 20.0)]),
        np.array([(20.0, 20.0), (20.0, 20.1), (20.1, 20.1)]),
        np.array([(5.0, 5.0), (9.0, 9.0)]),
        box(-50, -50, -20, -20),
        box(500, 500, 600, 600),
        box(-10, -10, 200, 200),
        np.full((4, 2), np.nan),
        np.array([(np.inf, 0.0), (1.0, np.inf), (5.0, 5.0)]),
        np.full((4, 2), 1e300),
        np.random.default_rng(0).uniform(0.0, 60.0, (200, 2)),
    ],
    ids=[
        "equal",
        "collinear",
        "crossing",
        "tiny",
        "two",
        "outside",
        "far outside",
        "around",
        "nan",
        "inf",
        "huge",
        "too many",
    ],
)
def test_start_that_is_no_polygon_is_replaced_and_reported(nodes: NDArray[np.float64]) -> None:
    region = scene()
    for start in (
        Start(nodes, box(25, 28, 38, 50)),
        Start(box(25, 18, 38, 27), nodes),
        Start(nodes, nodes),
        Start(NONE, nodes),
    ):
        contours = looked_at(region, start)
        assert "start_replaced" in contours.reasons


def test_no_start_at_all_begins_at_the_detection() -> None:
    contours = looked_at(scene(), Start(NONE, NONE))
    assert "start_replaced" in contours.reasons
    assert same(msgspec.structs.replace(contours, reasons=()), msgspec.structs.replace(looked_at(scene()), reasons=()))


@pytest.mark.parametrize(
    ("intensity", "reason"),
    [
        (np.zeros(SHAPE), "no_echo"),
        (np.full(SHAPE, np.nan), "no_echo"),
        (np.full(SHAPE, -1.0), "no_echo"),
        (np.ones(SHAPE), "little_evidence"),
        (np.full(SHAPE, 1e300), "little_evidence"),
        (np.full(SHAPE, 1e-310), "little_evidence"),
        (np.indices(SHAPE).sum(axis=0) % 2 * 2.0, "little_evidence"),
    ],
    ids=["zeros", "nan", "negative", "constant", "huge", "denormal", "checkerboard"],
)
def test_region_without_anything_is_rejected_with_the_reason(intensity: NDArray[np.float64], reason: str) -> None:
    contours = looked_at(plain_region(intensity, row=31.0, column=23.0))
    assert contours.rejected
    assert reason in contours.reasons


def test_start_where_nothing_was_measured_is_rejected() -> None:
    valid = np.ones(SHAPE, dtype=np.bool_)
    valid[20:45, 10:60] = False
    contours = looked_at(msgspec.structs.replace(scene(), valid=valid), Start(box(25, 15, 35, 25), box(25, 25, 35, 50)))
    assert contours.rejected
    assert "not_measured" in contours.reasons


@settings(max_examples=25 if kernels.backend() == "c" else 8, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    level=st.floats(-300.0, 300.0),
    spikes=st.floats(0.0, 0.3),
    area=st.sampled_from([1.0, 4.0, 1e6]),
)
def test_any_region_gives_a_result(seed: int, level: float, spikes: float, area: float) -> None:
    random = np.random.default_rng(seed)
    shape = tuple(random.integers(8, 40, 2).tolist())
    image = random.exponential(1.0, shape) * np.where(random.random(shape) < spikes, 1e6, 1.0)
    region = plain_region(
        image * 10.0 ** (level / 2.0), row=random.uniform(0.0, shape[0]), column=random.uniform(0.0, shape[1])
    )
    region = msgspec.structs.replace(region, valid=random.random(shape) < 0.9)
    looked_at(region, Start(random.uniform(-5.0, 40.0, (4, 2)), random.uniform(-5.0, 40.0, (5, 2))), area)


def test_contours_may_be_moved_on_as_they_are(n_runs: Callable[[int, int], int]) -> None:
    """Halved edges have finer coordinates than the start; a second run must begin exactly where the first ended."""
    for seed in range(n_runs(10, 3)):
        region = scene(seed)
        table = snake.window_row_sums(region.intensity, region.valid).table
        known = snake_settings(region, table, 1.0)
        start = start_from_detection(region)
        moved = snake.move_pair(table, known, np.array([(16, 1.0, 3), (40, 1.0, 2)]), start.highlight, start.shadow)
        again = snake.move_pair(table, known, np.empty((0, 3)), moved.highlight, moved.shadow)
        assert again.criterion == moved.criterion
        assert np.array_equal(again.shadow, moved.shadow)
