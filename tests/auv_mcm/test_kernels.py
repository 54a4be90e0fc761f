"""The C kernels, their numpy twins and, on tiny grids, the plain definition."""

from __future__ import annotations

import itertools
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from auv_mcm import kernels
from auv_mcm.kernels.cell_sums import cell_sums, cell_sums_numpy
from auv_mcm.kernels.signatures import SIGNATURES, call
from auv_mcm.kernels.viterbi import backtrack, viterbi_forward, viterbi_forward_numpy, viterbi_path

needs_c = pytest.mark.skipif(kernels.backend() != "c", reason=f"no C kernels: {kernels.loaded().reason}")

# Whole numbers: every order of summation gives the same sum, and ties are frequent.
whole = st.integers(-4, 4).map(float) | st.just(-np.inf)
real = st.floats(-1e9, 1e9) | st.just(-np.inf)


def grids(elements: st.SearchStrategy[float], pings: int, bins: int) -> st.SearchStrategy[NDArray[np.float64]]:
    return hnp.arrays(np.float64, st.tuples(st.integers(1, pings), st.integers(1, bins)), elements=elements)


def worth(path: tuple[int, ...], score: NDArray[np.float64], step_cost: float) -> float:
    return sum(float(score[p, k]) for p, k in enumerate(path)) - step_cost * sum(
        abs(b - a) for a, b in itertools.pairwise(path)
    )


@given(score=grids(whole, 4, 4), max_step=st.integers(0, 4), step_cost=st.sampled_from([0.0, 1.0, 2.0]))
@settings(deadline=None)
def test_path_is_the_best_of_all_paths(score: NDArray[np.float64], max_step: int, step_cost: float) -> None:
    n_pings, n_bins = score.shape
    allowed = [
        path
        for path in itertools.product(range(n_bins), repeat=n_pings)
        if all(abs(b - a) <= max_step for a, b in itertools.pairwise(path))
    ]
    best = max(worth(path, score, step_cost) for path in allowed)

    path = tuple(int(k) for k in viterbi_path(score, max_step, step_cost))

    assert path in allowed
    assert best == -np.inf or worth(path, score, step_cost) == best


@needs_c
@given(
    seed=st.integers(0, 2**32 - 1),
    shape=st.tuples(st.integers(1, 9), st.integers(1, 9)),
    rows=hnp.arrays(np.float64, st.integers(2, 6), elements=st.floats(-3.0, 12.0)),
    columns=hnp.arrays(np.float64, st.integers(2, 6), elements=st.floats(-3.0, 12.0)),
)
@settings(deadline=None)
def test_sums_over_cells_are_those_of_the_twin_and_of_areas_in_common(
    seed: int, shape: tuple[int, int], rows: NDArray[np.float64], columns: NDArray[np.float64]
) -> None:
    random = np.random.default_rng(seed)
    values, valid = random.exponential(size=shape), random.random(shape) < 0.8
    found = cell_sums(values, valid, rows, columns)
    np.testing.assert_array_equal(found, cell_sums_numpy(values, valid, rows, columns))
    down, across = (
        np.array([[min(max(edge - pixel, 0.0), 1.0) for pixel in range(n)] for edge in edges])
        for edges, n in ((rows, shape[0]), (columns, shape[1]))
    )
    for one, plane in zip(found, (np.where(valid, values, 0.0), valid.astype(np.float64)), strict=True):
        expected = np.diff(down, axis=0) @ plane @ np.diff(across, axis=0).T
        np.testing.assert_allclose(one, expected, atol=1e-12)


@needs_c
@given(score=grids(real | whole, 8, 12), max_step=st.integers(0, 20), step_cost=st.floats(0, 1e6))
@settings(deadline=None)
def test_c_and_numpy_agree_to_the_bit(score: NDArray[np.float64], max_step: int, step_cost: float) -> None:
    start = np.zeros(score.shape[1])
    cost, back = viterbi_forward(start, score, max_step, step_cost)
    cost_numpy, back_numpy = viterbi_forward_numpy(start, score, max_step, step_cost)
    np.testing.assert_array_equal(cost, cost_numpy, strict=True)
    np.testing.assert_array_equal(back, back_numpy, strict=True)
    path_numpy = backtrack(int(cost_numpy.argmax()), back_numpy)
    np.testing.assert_array_equal(viterbi_path(score, max_step, step_cost), path_numpy, strict=True)


@given(score=grids(whole, 9, 6), max_step=st.integers(0, 3), cut=st.integers(0, 9))
@settings(deadline=None)
def test_blocks_give_the_same_search_as_the_whole(score: NDArray[np.float64], max_step: int, cut: int) -> None:
    start = np.zeros(score.shape[1])
    cost, back = viterbi_forward(start, score, max_step, 1.0)
    first_cost, first_back = viterbi_forward(start, score[:cut], max_step, 1.0)
    last_cost, last_back = viterbi_forward(first_cost, score[cut:], max_step, 1.0)
    np.testing.assert_array_equal(last_cost, cost)
    np.testing.assert_array_equal(np.concatenate([first_back, last_back]), back)
    np.testing.assert_array_equal(backtrack(int(cost.argmax()), back), viterbi_path(score, max_step, 1.0))


def test_among_equals_the_smaller_step_wins_then_the_smaller_bin() -> None:
    flat = np.zeros((3, 5))
    np.testing.assert_array_equal(viterbi_path(flat, 2, 0.0), [0, 0, 0])
    # Into bin 2, which only bins 1 and 3 can reach at equal cost.
    score = np.array([[-np.inf, 0.0, -np.inf, 0.0, -np.inf], [-np.inf, -np.inf, 0.0, -np.inf, -np.inf]])
    np.testing.assert_array_equal(viterbi_path(score, 1, 1.0), [1, 2])


def test_after_a_ping_that_forbids_every_bin_the_next_ones_are_searched_by_themselves() -> None:
    score = np.array([[0.0, 3.0, 0.0], [-np.inf] * 3, [0.0, 0.0, 5.0]])
    assert viterbi_path(score, 1, 1.0).tolist() == [1, 2, 2]
    np.testing.assert_array_equal(viterbi_forward_numpy(np.zeros(3), score, 1, 1.0)[0], [-5.0, -5.0, 0.0])


def test_cost_stays_bounded_however_long_the_mission() -> None:
    score = np.full((5000, 4), 1e6)
    cost, _ = viterbi_forward(np.zeros(4), score, 1, 1.0)
    assert cost.max() == 0.0
    assert cost.min() >= -1e6


def test_inputs_are_left_alone() -> None:
    start, score = np.zeros(3), np.arange(6.0).reshape(2, 3)
    viterbi_forward(start, score, 1, 1.0)
    np.testing.assert_array_equal(start, np.zeros(3))
    np.testing.assert_array_equal(score, np.arange(6.0).reshape(2, 3))


@pytest.mark.parametrize(
    ("score", "max_step", "step_cost", "message"),
    [
        (np.zeros(3), 1, 1.0, "shape"),
        (np.zeros((2, 0)), 1, 1.0, "at least one bin"),
        (np.array([[0.0, np.nan]]), 1, 1.0, "NaN"),
        (np.array([[0.0, np.inf]]), 1, 1.0, r"\+inf"),
        (np.zeros((2, 2)), -1, 1.0, "not negative"),
        (np.zeros((2, 2)), 1, -1.0, "not negative"),
        (np.zeros((2, 2)), 1, np.nan, "finite"),
    ],
)
def test_senseless_input_is_refused(score: NDArray[np.float64], max_step: int, step_cost: float, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        viterbi_path(score, max_step, step_cost)


def test_no_pings_give_an_empty_path() -> None:
    assert viterbi_path(np.zeros((0, 3)), 1, 1.0).shape == (0,)


def test_environment_forces_numpy() -> None:
    code = "from auv_mcm import kernels; print(kernels.backend())"
    environment = {**os.environ, "AUV_MCM_KERNELS": "numpy"}
    assert (
        subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True).stdout
        == "numpy\n"
    )


NUMBERS = {"int64_t": "i", "int32_t": "w", "uint32_t": "u", "float": "f", "double": "d"}
READ = {"float": "f4", "double": "f8", "uint8_t": "u1", "uint16_t": "u2", "int32_t": "i4", "uint32_t": "u4"}


def declared_in_c(arguments: str) -> str:
    words = []
    for argument in arguments.replace("restrict", " ").split(","):
        kind = re.sub(r"const|struct|\*", " ", argument).split()[0]
        read = (READ | {"int64_t": "i8"}).get(kind, "a") if "const" in argument else "a"
        words.append(read if "*" in argument else NUMBERS[kind])
    return " ".join(words)


def test_signatures_are_those_of_the_c_sources() -> None:
    text = "".join(path.read_text("utf-8") for path in Path(kernels.__file__).parent.glob("*.c"))
    sources = dict(re.findall(r"\bvoid auv_mcm_(\w+)\(([^)]*)\)\s*\{", text))
    made_by_macro = {"cascade_counts", "cascade_sums", "waterfall_sums_of_bytes", "waterfall_sums_of_words"}
    assert set(SIGNATURES) == set(sources) | made_by_macro
    for name, arguments in sources.items():
        assert SIGNATURES[name].replace("?", "").replace("b1", "u1") == declared_in_c(arguments), name


@needs_c
def test_what_c_reads_may_lie_anyhow_and_what_it_writes_to_may_not() -> None:
    values = np.arange(12, dtype=np.float64).reshape(3, 4).T
    sums = np.empty((4, 4))
    assert call("waterfall_sums", 4, 3, values, sums)
    np.testing.assert_array_equal(sums[:, 0], -values.sum(axis=1))
    with pytest.raises(ValueError, match="contiguous"):
        call("waterfall_sums", 4, 3, values, sums.T)
