"""Range resampling against the integral of the piecewise constant trace, taken piece by piece."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from auv_mcm.waterfall.ground import Traces, ground_edges_m, make_traces, mean_between

N_PINGS = 3


class Case:
    """A few short pings with masks, and edges to average between."""

    def __init__(
        self,
        intensity: NDArray[np.float32],
        valid: NDArray[np.bool_],
        saturated: NDArray[np.bool_],
        first_range_m: float,
        spacing_m: float,
        edges_m: NDArray[np.float64],
    ) -> None:
        self.intensity = np.where(valid, intensity, np.float32(0.0))
        self.valid, self.saturated = valid, saturated & valid
        self.first_range_m, self.spacing_m, self.edges_m = first_range_m, spacing_m, edges_m

    @property
    def traces(self) -> Traces:
        return make_traces(self.intensity, self.valid, self.saturated, self.first_range_m, self.spacing_m)

    def integrals(self, ping: int, start_m: float, stop_m: float) -> tuple[float, float, float]:
        """Length of valid samples within the interval, integral of intensity over it, length of saturated samples;
        metres."""
        length = energy = clipped = 0.0
        for sample in range(self.intensity.shape[1]):
            near = self.first_range_m + (sample - 0.5) * self.spacing_m
            shared = min(near + self.spacing_m, stop_m) - max(near, start_m)
            if shared > 0.0 and self.valid[ping, sample]:
                length += shared
                energy += shared * float(self.intensity[ping, sample])
                clipped += shared * bool(self.saturated[ping, sample])
        return length, energy, clipped


@st.composite
def cases(draw: st.DrawFn) -> Case:
    shape = (N_PINGS, draw(st.integers(1, 12)))
    masks = hnp.arrays(np.bool_, shape)
    all_valid = draw(st.booleans())
    steps = draw(
        hnp.arrays(
            np.float64, (draw(st.sampled_from([1, N_PINGS])), draw(st.integers(1, 8))), elements=st.floats(0.001, 3.0)
        )
    )
    start = draw(st.floats(-2.0, 4.0))
    return Case(
        draw(hnp.arrays(np.float32, shape, elements=st.floats(0.0, 1e6, width=32))),
        np.ones(shape, dtype=np.bool_) if all_valid else draw(masks),
        draw(masks),
        draw(st.floats(0.0, 2.0)),
        draw(st.floats(0.05, 1.0)),
        start + np.cumsum(np.pad(steps, ((0, 0), (1, 0))), axis=1),
    )


@given(case=cases())
def test_means_are_integrals_of_the_piecewise_constant_trace(case: Case) -> None:
    means = mean_between(case.traces, case.edges_m)
    n_columns = case.edges_m.shape[1] - 1
    assert means.intensity.shape == means.valid.shape == means.saturated.shape == (N_PINGS, n_columns)
    for ping in range(N_PINGS):
        edges = case.edges_m[min(ping, case.edges_m.shape[0] - 1)]
        for column in range(n_columns):
            width = edges[column + 1] - edges[column]
            length, energy, clipped = case.integrals(ping, edges[column], edges[column + 1])
            if abs(length - 0.5 * width) > 1e-9:
                assert means.valid[ping, column] == (length > 0.5 * width)
            if means.valid[ping, column]:
                assert means.intensity[ping, column] == pytest.approx(energy / length, rel=1e-9, abs=1e-6)
                if abs(clipped - 0.25 * length) > 1e-9:
                    assert means.saturated[ping, column] == (clipped > 0.25 * length)
            else:
                assert means.intensity[ping, column] == 0.0
                assert not means.saturated[ping, column]


@given(case=cases())
def test_one_row_of_edges_serves_all_pings(case: Case) -> None:
    one = case.edges_m[:1]
    shared = mean_between(case.traces, one)
    repeated = mean_between(case.traces, np.repeat(one, N_PINGS, axis=0))
    np.testing.assert_allclose(shared.intensity, repeated.intensity, rtol=1e-12)
    np.testing.assert_array_equal(shared.valid, repeated.valid)
    np.testing.assert_array_equal(shared.saturated, repeated.saturated)


def test_edges_are_not_changed() -> None:
    case = Case(
        np.ones((2, 5), np.float32),
        np.ones((2, 5), bool),
        np.zeros((2, 5), bool),
        0.5,
        1.0,
        np.array([[0.0, 1.0], [1.5, 9.0]]),
    )
    before = case.edges_m.copy()
    mean_between(case.traces, case.edges_m)
    np.testing.assert_array_equal(case.edges_m, before)


def test_energy_is_conserved_over_any_partition() -> None:
    random = np.random.default_rng(0)
    intensity = random.exponential(size=(4, 2000)).astype(np.float32)
    traces = make_traces(
        intensity, np.ones_like(intensity, dtype=bool), np.zeros_like(intensity, dtype=bool), 0.0125, 0.025
    )
    cuts = np.sort(random.uniform(0.0, 50.0, (4, 300)), axis=1)
    edges = np.concatenate([np.zeros((4, 1)), cuts, np.full((4, 1), 50.0)], axis=1)
    means = mean_between(traces, edges)
    assert means.valid.all()
    np.testing.assert_allclose(
        (means.intensity * np.diff(edges, axis=1)).sum(axis=1), 0.025 * intensity.sum(axis=1, dtype=float), rtol=1e-9
    )


def test_a_constant_trace_stays_constant_to_the_finest_pixel_below_the_keel() -> None:
    """Near nadir a pixel is a hundredth of a sample wide or less."""
    intensity = np.full((2, 4000), 7.25, dtype=np.float32)
    intensity[:, :60] = 1e9  # ring-down
    traces = make_traces(
        intensity, np.ones_like(intensity, dtype=bool), np.zeros_like(intensity, dtype=bool), 0.0125, 0.025
    )
    means = mean_between(traces, ground_edges_m(np.array([2.0, 30.0]), 1500, 0.06))
    inside = np.hypot(1500 * 0.06, [2.0, 30.0]) < 100.0
    assert inside.tolist() == [True, True]
    assert means.valid.all()
    np.testing.assert_allclose(means.intensity, 7.25, rtol=1e-3)


def test_beyond_the_trace_nothing_is_valid() -> None:
    intensity = np.ones((1, 100), dtype=np.float32)
    traces = make_traces(intensity, np.ones((1, 100), dtype=bool), np.zeros((1, 100), dtype=bool), 2.05, 0.1)
    means = mean_between(traces, np.arange(0.0, 20.01, 0.5)[None, :])  # the trace covers 2 to 12 m
    expected = np.zeros(40, dtype=bool)
    expected[4:24] = True
    np.testing.assert_array_equal(means.valid[0], expected)
    np.testing.assert_allclose(means.intensity[0], expected, rtol=0.0, atol=1e-12)


def test_ring_down_takes_no_digits_from_the_sea_floor() -> None:
    floor = np.random.default_rng(3).exponential(size=(2, 400)).astype(np.float32)
    ringing = floor.copy()
    ringing[:, :10] = 1e12
    every, nothing = np.ones(floor.shape, dtype=bool), np.zeros(floor.shape, dtype=bool)
    edges = np.arange(5.0, 40.0, 0.13)[None, :]
    quiet, loud = (
        mean_between(make_traces(values, every, nothing, 0.05, 0.1), edges).intensity for values in (floor, ringing)
    )
    np.testing.assert_array_equal(loud, quiet)


@given(first_return_m=st.floats(0.05, 200.0), n_columns=st.integers(1, 50), spacing_m=st.floats(0.005, 2.0))
def test_ground_edges_invert_the_factored_geometry(first_return_m: float, n_columns: int, spacing_m: float) -> None:
    """y = sqrt((r - h)(r + h)): what a slant range means on a flat bottom below a sonar whose first return is h."""
    edges = ground_edges_m(np.array([first_return_m]), n_columns, spacing_m)
    assert edges.shape == (1, n_columns + 1)
    assert edges[0, 0] == first_return_m
    for column, r in enumerate(edges[0].tolist()):
        y = math.sqrt(max((r - first_return_m) * (r + first_return_m), 0.0))
        # r itself is rounded to eps * r, which moves y by eps * r * r / y.
        assert y == pytest.approx(
            column * spacing_m, abs=1e-12 + 4e-16 * r * r / max(column * spacing_m, 1e-300) if column else 1e-12
        )


def test_pixels_shrink_towards_nadir_as_the_stretch_factor_says() -> None:
    edges = ground_edges_m(np.array([5.0]), 1000, 0.06)[0]
    y = (np.arange(1000) + 0.5) * 0.06
    np.testing.assert_allclose(np.diff(edges), 0.06 * y / np.hypot(y, 5.0), rtol=1e-3)
