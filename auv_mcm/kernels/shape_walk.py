"""Walks downhill over the parameters of a class of solids, as `auv_mcm.solids.box_search.walk` does over any cost.

A point holds a place along the slices, a ground range (m) and the class's own parameters. Each of the eight columns of the hypothesis it
stands for is a product: a coefficient and two factors, out of 1, the point's values, and what its last value is above and below 0.
Above 0 that is a burial; below it is taken off the altitude's share of 1, as both change the height seen.

C and numpy take the same steps as long as their costs rank alike, which those of `shape_costs` do to 1e-9 of the number of pixels.
"""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from auv_mcm import kernels
from auv_mcm.kernels.shape import SCORING_STEPS, Array, Beam, RowSums, Solid, kind_of, shape_costs
from auv_mcm.solids.box_search import GROWTH, LEAST_STRIDE, SHRINKAGE, Optima, SearchBox, best_first, directions, walk

ONE: Final = 0  # numbers of the factors; value k of a point is factor k + 1
SUNK: Final = 7
RATIO: Final = 8

_N_FACTORS: Final = 9
_P, _I = ctypes.c_void_p, ctypes.c_int64


class WalkSpace(NamedTuple):
    """Points of a box and what they stand for.

    terms: (8, 3) float64, coefficient and the numbers of two factors of each column. sigma: of the altitude's share and of what the last
    value is above 0, infinite where that is no burial. fixed_cost: nats, of every point.
    """

    solid: Solid
    box: SearchBox
    terms: Array
    sigma: tuple[float, float]
    fixed_cost: float


def hypotheses_at(terms: Array, points: Array) -> Array:
    """Hypotheses (n, 8) for `shape_costs` from points (n, d); terms: of a Chart."""
    factors = np.ones((len(points), _N_FACTORS))
    factors[:, 1 : points.shape[1] + 1] = points
    factors[:, SUNK] = np.maximum(points[:, -1], 0.0)
    factors[:, RATIO] += np.minimum(points[:, -1], 0.0)
    first, second = terms[:, 1:].T.astype(np.intp)
    return np.asarray(terms[:, 0] * factors[:, first] * factors[:, second], dtype=np.float64)


def costs_at(chart: WalkSpace, points: Array, image: RowSums, beam: Beam) -> Array:
    """Costs (n,) of points (n, d) with what an altitude that is wrong and a burial cost, half their squares in sigmas."""
    hypotheses = hypotheses_at(chart.terms, points)
    altitude = (hypotheses[:, 2] - 1.0) / chart.sigma[0]
    burial = np.maximum(points[:, -1], 0.0) / chart.sigma[1]
    return shape_costs(chart.solid, hypotheses, image, beam).cost + 0.5 * (altitude * altitude + burial * burial) + chart.fixed_cost


def walk_shapes(chart: WalkSpace, image: RowSums, beam: Beam, optima: Optima, n_steps: int, n_tries: int, *, first_stride: float) -> Optima:
    """`search.walk` over costs_at. The box must hold only points that stand for solids that can be."""
    function = _function()
    if function is None:
        return walk_shapes_numpy(chart, image, beam, optima, n_steps, n_tries, first_stride=first_stride)
    box = chart.box
    n, d = optima.unit.shape
    span = box.high - box.low
    sides = np.array([box.low, span, box.wraps, box.grain / span])
    scalars = np.array([*image[2:], *chart.sigma, chart.fixed_cost])
    strides = np.array([first_stride, GROWTH, SHRINKAGE, LEAST_STRIDE])
    ways = directions(n_steps, n_tries, d)
    unit, best = np.array(optima.unit, order="C"), optima.cost.copy()
    terms = np.ascontiguousarray(chart.terms)
    echoes, counts = np.ascontiguousarray(image.echoes), np.ascontiguousarray(image.counts)
    bearing, share = np.ascontiguousarray(beam.bearing_rad), np.ascontiguousarray(beam.share)
    n_rows, n_edges = echoes.shape
    image_at = (n_rows, n_edges - 1, scalars.ctypes.data, echoes.ctypes.data, counts.ctypes.data)
    beam_at = (share.size, bearing.ctypes.data, share.ctypes.data, SCORING_STEPS)
    ways_at = (strides.ctypes.data, n_steps, n_tries, ways.ctypes.data)
    function(
        kind_of(chart.solid), n, d, sides.ctypes.data, terms.ctypes.data, *image_at, *beam_at, *ways_at, unit.ctypes.data, best.ctypes.data
    )
    return best_first(box, unit, best)


def walk_shapes_numpy(
    chart: WalkSpace, image: RowSums, beam: Beam, optima: Optima, n_steps: int, n_tries: int, *, first_stride: float
) -> Optima:
    """walk_shapes in numpy, but for the costs."""
    return walk(lambda points: costs_at(chart, points, image, beam), chart.box, optima, n_steps, n_tries, first_stride=first_stride)


@functools.cache
def _function() -> Callable[..., None] | None:
    return kernels.c_function("shape_walk", _I, _I, _I, _P, _P, _I, _I, _P, _P, _P, _I, _P, _P, _I, _P, _I, _I, _P, _P, _P)
