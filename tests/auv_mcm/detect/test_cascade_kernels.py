"""The cascade's kernels: C and numpy to the bit, integral images against plain sums."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from auv_mcm import kernels
from auv_mcm.detect.cascade.bands import band_edges
from auv_mcm.detect.cascade.run import tables_of
from auv_mcm.kernels.cascade import (
    Opened,
    Tables,
    WindowField,
    Windows,
    encode,
    encode_numpy,
    integral,
    integral_numpy,
    open_windows,
    open_windows_numpy,
    rank,
    rank_numpy,
    run_groups,
    run_groups_numpy,
)
from tests.auv_mcm.detect.drawn_cascades import COLUMN_M, ROW_M, draw_ground, draw_model

needs_c = pytest.mark.skipif(kernels.backend() != "c", reason=f"no C kernels: {kernels.loaded().reason}")
seeds = st.integers(0, 2**32 - 1)


def assert_same(one: Windows, other: Windows) -> None:
    for a, b in zip(one, other, strict=True):
        np.testing.assert_array_equal(a, b, strict=True)


def draw_field(seed: int, shape: tuple[int, int] = (14, 40), kind: str = "soft") -> tuple[WindowField, Tables]:
    plane, model = draw_ground(seed, *shape).plane(), draw_model(seed, kind=kind)
    tables = tables_of(model, ROW_M, COLUMN_M, plane.sums.shape[1])
    corner = plane.margin_rows * plane.sums.shape[1] + plane.margin_near
    edges = band_edges(plane.first_return_m, plane.n_columns, COLUMN_M)
    return WindowField(plane.sums, plane.counts, corner, plane.usable, edges), tables


def opened_both_ways(
    seed: int, n_groups: int, shape: tuple[int, int] = (14, 40), kind: str = "soft"
) -> tuple[Opened, Opened]:
    field, tables = draw_field(seed, shape, kind)
    one, other = open_windows(field, tables, n_groups), open_windows_numpy(field, tables, n_groups)
    for first in range(n_groups, 5):
        ran = (f(field.sums, tables, one.windows, first, 5) for f in (run_groups, run_groups_numpy))
        (left, n_left), (right, n_right) = ran
        assert_same(left, right)
        np.testing.assert_array_equal(n_left, n_right, strict=True)
    return one, other


@needs_c
@given(seed=seeds, n_groups=st.integers(0, 5), kind=st.sampled_from(["soft", "stages"]))
@settings(deadline=None, max_examples=60)
def test_c_and_numpy_agree_to_the_bit(seed: int, n_groups: int, kind: str) -> None:
    one, other = opened_both_ways(seed, n_groups, kind=kind)
    assert_same(one.windows, other.windows)
    assert one.n_windows == other.n_windows
    np.testing.assert_array_equal(one.n_alive, other.n_alive, strict=True)


@needs_c
@pytest.mark.parametrize("shape", [(9, 3000), (400, 60)])
def test_c_and_numpy_agree_on_tiles_of_many_blocks(shape: tuple[int, int]) -> None:
    one, other = opened_both_ways(2, 3, shape)
    assert_same(one.windows, other.windows)
    assert one.n_windows == other.n_windows > 1000


def test_windows_out_of_order_are_refused_before_the_kernel_sees_them() -> None:
    field, tables = draw_field(2, (20, 60))
    tables = tables._replace(
        groups=np.stack((tables.groups[:, 0], np.full_like(tables.groups[:, 1], -(2**31))), axis=1)
    )
    windows = open_windows(field, tables, 1).windows
    first, second = windows.band_stop[windows.band_stop > 0][:2]
    assert 1 < first < second
    # A later band begins again where it likes, on nearer rows too.
    assert windows.place[first] < windows.place[first - 1]
    assert_same(run_groups(field.sums, tables, windows, 1, 1)[0], windows)
    twice = windows.place.copy()
    twice[1] = twice[0]
    for place in (windows.place[::-1].copy(), np.roll(windows.place, 1), twice):
        with pytest.raises(ValueError, match="must rise within each band; the one of window"):
            run_groups(field.sums, tables, windows._replace(place=place), 1, 2)
    for stops in (windows.band_stop - 1, windows.band_stop + 1, windows.band_stop[::-1].copy()):
        with pytest.raises(ValueError, match="do not hold"):
            run_groups(field.sums, tables, windows._replace(band_stop=stops), 1, 2)


@needs_c
@given(intensity=hnp.arrays(np.float32, 40, elements=st.floats(width=32) | st.floats(0.0, 17.0, width=32)), seed=seeds)
@settings(deadline=None)
def test_codes_of_c_and_numpy_agree(intensity: NDArray[np.float32], seed: int) -> None:
    mask = np.random.Generator(np.random.PCG64(seed)).integers(0, 16, 40, dtype=np.uint8)
    for a, b in zip(encode(intensity, mask), encode_numpy(intensity, mask), strict=True):
        np.testing.assert_array_equal(a, b, strict=True)


def test_codes_round_to_the_nearest_halves_to_even_between_nothing_and_sixteen_times_the_mean() -> None:
    intensity = np.array(
        [0.0, 0.5, 1.5 / 1024, 2.5 / 1024, 1.0, 15.9999, 16.0, 99.0, np.inf, -1.0, np.nan, 3.0], dtype=np.float32
    )
    mask = np.array([1] * 11 + [2], dtype=np.uint8)
    codes, valid = encode(intensity, mask)
    assert codes.tolist() == [0, 512, 2, 2, 1024, 16384, 16384, 16384, 16384, 0, 1024, 1024]
    assert valid.tolist() == [True] * 10 + [False] * 2


@given(
    shape=st.tuples(st.integers(0, 9), st.integers(0, 14)),
    margins=st.tuples(*[st.integers(0, 5)] * 3),
    beyond=st.sampled_from([0, 1024]),
    seed=seeds,
    flags=st.booleans(),
)
@settings(deadline=None)
def test_integral_images_hold_plain_sums(
    shape: tuple[int, int], margins: tuple[int, int, int], beyond: int, seed: int, flags: bool
) -> None:
    random = np.random.Generator(np.random.PCG64(seed))
    values = random.random(shape) < 0.5 if flags else random.integers(0, 2**16, shape, dtype=np.uint16)
    padded = np.pad(values.astype(np.int64), ((margins[0],) * 2, margins[1:]), constant_values=beyond)
    expected = [
        [int(padded[:i, :j].sum()) % 2**32 for j in range(padded.shape[1] + 1)] for i in range(padded.shape[0] + 1)
    ]
    for made in (integral, integral_numpy):
        found = made(values, margins, beyond)
        np.testing.assert_array_equal(found, np.array(expected, dtype=np.uint32), strict=True)


def test_planes_of_other_types_and_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match="uint16 or bool"):
        integral(np.ones((3, 4), dtype=np.float32), (0, 0, 0), 0)
    with pytest.raises(ValueError, match="mask must hold a byte"):
        encode(np.ones((2, 2), dtype=np.float32), np.ones((2, 3), dtype=np.uint8))


@given(
    score=hnp.arrays(np.int32, st.integers(0, 60), elements=st.integers(-(2**31), 2**31 - 1) | st.integers(-3, 3)),
    n_first=st.integers(0, 70),
)
@settings(deadline=None)
def test_ranks_are_from_the_highest_down_the_first_of_equals_first(score: NDArray[np.int32], n_first: int) -> None:
    expected = sorted(range(score.size), key=lambda k: (-int(score[k]), k))
    least = min((int(score[k]) for k in expected[: max(n_first, 1)]), default=0)
    expected = [k for k in expected if score[k] >= least]
    assert rank(score, n_first).tolist() == rank_numpy(score, n_first).tolist() == expected
