"""Search the parameters of a class of solids for the lowest costs, as `auv_mcm.solids.box_search` does over any cost.

A point holds a place along the slices, a ground range (m) and the class's own parameters. Each of the eight columns of
the hypothesis it stands for is a product: a coefficient and two factors, out of 1, the point's values, and what its
last value is above and below 0. Above 0 that is a burial; below it is taken off the altitude's share of 1, as both
change the height seen.

C and numpy take the same steps as long as their costs rank alike, which those of `shape_costs` do to 1e-9 of the number
of pixels.
"""

from __future__ import annotations

import functools
from typing import Final, NamedTuple

import numpy as np

from auv_mcm.kernels.shape import SCORING_STEPS, Array, Beam, ImageRowSums, Solid, kind_of, shape_costs
from auv_mcm.kernels.signatures import call
from auv_mcm.solids.box_search import (
    APART,
    GROWTH,
    MIN_STRIDE,
    SHRINKAGE,
    Optima,
    SearchBox,
    apart,
    directions,
    look_around,
    spread,
)
from auv_mcm.solids.box_search import walk as walk_down

ONE: Final = 0  # numbers of the factors; value k of a point is factor k + 1
SUNK: Final = 7  # column of the factors: how deep the solid is sunk
RATIO: Final = 8  # column of the factors: brightness against the class's usual one

_N_FACTORS: Final = 9  # columns of the factors; equal in C
_UNKNOWN, _OF_ONE_SLICE, _KNOWN = range(3)  # states of the costs of starts, passed to C


class WalkSpace(NamedTuple):
    """Hold points of a box and what they stand for.

    terms: (8, 3) float64, coefficient and the numbers of two factors of each column. sigma: of the altitude's share and
    of what the last value is above 0, infinite where that is no burial. fixed_cost: nats, of every point.
    """

    solid: Solid
    box: SearchBox
    terms: Array
    sigma: tuple[float, float]
    fixed_cost: float


def hypotheses_at(terms: Array, points: Array) -> Array:
    """Turn points (n, d) into hypotheses (n, 8) for `shape_costs`; terms: of a WalkSpace."""
    factors = np.ones((len(points), _N_FACTORS))
    factors[:, 1 : points.shape[1] + 1] = points
    factors[:, SUNK] = np.maximum(points[:, -1], 0.0)
    factors[:, RATIO] += np.minimum(points[:, -1], 0.0)
    first, second = terms[:, 1:].T.astype(np.intp)
    return np.asarray(terms[:, 0] * factors[:, first] * factors[:, second], dtype=np.float64)


def costs_at(chart: WalkSpace, points: Array, image: ImageRowSums, beam: Beam) -> Array:
    """Compute costs (n,) of points (n, d), with those of a wrong altitude and a burial.

    The latter are half their squares in sigmas.
    """
    hypotheses = hypotheses_at(chart.terms, points)
    altitude = (hypotheses[:, 2] - 1.0) / chart.sigma[0]
    burial = np.maximum(points[:, -1], 0.0) / chart.sigma[1]
    return (
        shape_costs(chart.solid, hypotheses, image, beam).cost
        + 0.5 * (altitude * altitude + burial * burial)
        + chart.fixed_cost
    )


class Walk(NamedTuple):
    """Set how far a search goes: places that walk, steps of each, tries per step, and the first stride in grains."""

    n_walks: int
    n_steps: int
    n_tries: int
    first_stride: float


def search_shapes(chart: WalkSpace, image: ImageRowSums, beam: Beam, n_starts: int, walk: Walk) -> Optima:
    """Find the lowest costs from n_starts places spread over the box: the best of those that lie apart walk downhill.

    The box must hold only points that stand for possible solids.
    """
    starts = spread(n_starts, chart.box.low.size)
    found = _searched(chart, image, beam, Optima(starts, np.empty(n_starts)), _UNKNOWN, walk)
    return search_shapes_numpy(chart, image, beam, n_starts, walk) if found is None else found


def search_shapes_numpy(chart: WalkSpace, image: ImageRowSums, beam: Beam, n_starts: int, walk: Walk) -> Optima:
    """Do as search_shapes, in numpy, but for the costs."""
    starts = look_around(lambda points: costs_at(chart, points, image, beam), chart.box, n_starts, walk.n_walks)
    return _walked(chart, image, beam, starts, walk)


def refine_shapes(chart: WalkSpace, image: ImageRowSums, beam: Beam, found: Optima, walk: Walk) -> Optima:
    """Walk on with the costs of this beam from the best of those found that lie apart.

    Those were weighed for a single slice.
    """
    known = _OF_ONE_SLICE if beam.share.size > 1 else _KNOWN
    refined = _searched(chart, image, beam, found, known, walk)
    return refine_shapes_numpy(chart, image, beam, found, walk) if refined is None else refined


def refine_shapes_numpy(chart: WalkSpace, image: ImageRowSums, beam: Beam, found: Optima, walk: Walk) -> Optima:
    """Do as refine_shapes, in numpy, but for the costs."""
    starts = apart(found, chart.box, walk.n_walks)
    if beam.share.size > 1:
        starts = Optima(starts.unit, costs_at(chart, chart.box.points(starts.unit), image, beam))
    return _walked(chart, image, beam, starts, walk)


def _walked(chart: WalkSpace, image: ImageRowSums, beam: Beam, starts: Optima, walk: Walk) -> Optima:
    return walk_down(
        lambda points: costs_at(chart, points, image, beam),
        chart.box,
        starts,
        walk.n_steps,
        walk.n_tries,
        first_stride=walk.first_stride,
    )


def _searched(
    chart: WalkSpace, image: ImageRowSums, beam: Beam, starts: Optima, known: int, walk: Walk
) -> Optima | None:
    """Search in C; None where there is none."""
    box = chart.box
    n, d = starts.unit.shape
    span = box.high - box.low
    sides = np.array([box.low, span, box.wraps, box.grain / span])
    scalars = np.array([*image[2:], *chart.sigma, chart.fixed_cost])
    strides = np.array([walk.first_stride, GROWTH, SHRINKAGE, MIN_STRIDE, APART])
    ways = _directions(walk.n_steps, walk.n_tries, d)
    n_kept = min(n, walk.n_walks)
    unit, best, n_found = np.empty((n_kept, d)), np.empty(n_kept), np.empty(1, dtype=np.int64)
    (n_rows, n_edges), n_taps = image.echoes.shape, beam.share.size
    space = kind_of(chart.solid), n, d, sides, chart.terms
    seen = n_rows, n_edges - 1, scalars, image.echoes, image.counts, n_taps, *beam, SCORING_STEPS
    asked = starts.unit, starts.cost, known, n_kept, strides, walk.n_steps, walk.n_tries, ways
    if not call("shape_search", *space, *seen, *asked, unit, best, n_found):
        return None
    found = int(n_found[0])
    return Optima(unit[:found], best[:found])


@functools.lru_cache(maxsize=32)
def _directions(n_steps: int, n_tries: int, n_dimensions: int) -> Array:
    ways = directions(n_steps, n_tries, n_dimensions)
    ways.flags.writeable = False
    return ways
