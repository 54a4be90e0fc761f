"""Fit solids to a region: the best sphere, cylinder, truncated cone and wedge, and how well each explains it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Final, NamedTuple, TypeAlias

import msgspec
import numpy as np

from auv_mcm.classify.evidence import size_plausibility
from auv_mcm.classify.likelihood import beam_of, image_row_sums, parameter_cost
from auv_mcm.confirm.region import Region
from auv_mcm.kernels.shape import (
    FIELDS,
    FIRST_FIELD,
    FORBIDDEN,
    PENCIL,
    Beam,
    ImageRowSums,
    Solid,
    intervals,
    shape_costs,
    single_solid,
    top_m,
    up_to,
)
from auv_mcm.kernels.shape_walk import (
    ONE,
    RATIO,
    SUNK,
    Walk,
    WalkSpace,
    costs_at,
    hypotheses_at,
    refine_shapes,
    search_shapes,
)
from auv_mcm.solids.box_search import Array, Optima, SearchBox, apart, curvature_covariance
from auv_mcm.solids.shapes import Shape

SOLIDS: Final = tuple(FIELDS)

# nats by which a free contour explains more than every solid before refinement: no solid catches up
_CLUTTER: Final = 60.0
_HOPELESS: Final = 40.0  # nats behind the best solid before refinement: this one does not catch up
_ALTITUDE_SIGMA: Final = 0.06  # of the altitude measured, relative
_BURIAL_SIGMA: Final = 0.15  # share of radius or height: a buried solid and a smaller one look alike
_TEMPER: Final = 4.0  # factor by which costs overstate the evidence: highlights are not even, and floors not flat
_RESOLVED: Final = 0.15  # share of a resolution cell by which edges are uncertain
# of a size on the floor: without it 0.75 of lengths and 0.81 of widths were within 2 sigma, of 221 mines in 21 missions
_SIZE_SHARE: Final = 0.12
_ON_FLOOR: Final = frozenset({"radius_m", "length_m", "base_radius_m", "top_radius_m", "width_m"})
_TOLERANCE: Final = 0.3  # beyond the usual sizes, relative, at which a size is not plausible at all
_MIN_HIGHLIGHT: Final = 6.0  # independent samples below which a highlight is not evidence
WEDGE_M: Final = (1.02, 0.80, 0.385)  # at scale 1
_ALONG_M, _BEFORE_M, _BEHIND_M = 1.2, 0.5, 1.2  # how far from the highlight's centre an object's place may be
_PLACE_GRAIN_M: Final = 0.05  # m to which a place is refined


class Effort(NamedTuple):
    """Set how many hypotheses are tried.

    Starts per solid; how many walk, for how many steps of how many tries; the same with the beam. refines_all: with the
    beam also for solids that are far behind.
    """

    n_starts: int = 512
    n_walks: int = 10
    n_steps: int = 16
    n_tries: int = 6
    n_fine_walks: int = 3
    n_fine_steps: int = 20
    n_fine_tries: int = 8
    refines_all: bool = False


class Optimum(msgspec.Struct, frozen=True, kw_only=True):
    """Place a solid.

    row: fractional, edges of rows at whole numbers. ground_range_m: of its place, true for the altitude below. cost:
    nats against a floor without an object, parameters included; the lower, the better. altitude_ratio: the altitude
    that explains the height seen over the altitude measured.
    """

    shape: Shape
    row: float
    ground_range_m: float
    altitude_ratio: float
    cost: float


class Highlight(msgspec.Struct, frozen=True, kw_only=True):
    """Measure the mean extent in range, m, of a highlight: of the solid, and as measured about it without its ends.

    n_samples: independent ones in the solid's.
    """

    model_across_m: float
    observed_across_m: float
    n_samples: float


class ShapeFit(msgspec.Struct, frozen=True, kw_only=True):
    """Hold the best fit of one class.

    The fields after `refined` are known only for the best of all classes; for others they are empty, or 0.

    plausibility: 1 for usual sizes of the class, falling to 0 at 30 % beyond them.
    second: the best of those that differ from it by a tenth of the search space or more in some parameter, if any.
    sigma: standard deviations by name, of the shape's fields, row_m and ground_range_m: from the cost's curvature, the
    resolution, an altitude that is wrong by 6 %, and sizes on the floor by 12 %. Empty unless refined.
    ends: columns in each slice (n_rows) at which the solid's highlight starts and ends and its shadow ends, 0 where it
    has none.
    contrast: mean of highlight and of shadow over the floor's, echoes cut off at three times the floor.
    flags: at_bound (a parameter at the end of what is searched), altitude (solids do fit, but for another altitude),
    buried (by over a tenth of its height), cut_off (its shadow or its rows leave the region), weak_highlight (fewer
    than 6 independent samples).
    """

    solid: Solid
    best: Optimum
    plausibility: float
    refined: bool
    second: Optimum | None = None
    sigma: dict[str, float] = msgspec.field(default_factory=dict)
    ends: tuple[tuple[float, float, float], ...] = ()
    contrast: tuple[float, float] = (0.0, 0.0)
    highlight: Highlight = Highlight(model_across_m=0.0, observed_across_m=0.0, n_samples=0.0)
    flags: tuple[str, ...] = ()


class ShapeFits(msgspec.Struct, frozen=True, kw_only=True):
    """Hold all classes that explain the region at all, best first; a class that cannot be seen in it is missing.

    contour_cost: that of the free contour, as given. n_hypotheses: tried in the search. flags: no_data, clutter (the
    contour explains so much more that solids were not refined).
    """

    fits: tuple[ShapeFit, ...]
    contour_cost: float | None
    n_hypotheses: int
    flags: tuple[str, ...]


class _Parameter(NamedTuple):
    low: float
    high: float
    grain: float
    wraps: bool = False
    usual: tuple[float, float] | None = None


class ListedParameter(NamedTuple):
    """Name a parameter of a class by its place among USUAL_RANGES, with a value that is to be searched."""

    solid: Solid
    place: int
    value: float


def _size(low: float, high: float, grain: float) -> _Parameter:
    return _Parameter((1.0 - _TOLERANCE) * low, (1.0 + _TOLERANCE) * high, grain, usual=(low, high))


# Burial comes as a share of radius or height. Below 0 it stands for an altitude measured too high by that
# share: both change the height seen.
SearchRanges: TypeAlias = Mapping[Solid, tuple[_Parameter, ...]]
USUAL_RANGES: Final[SearchRanges] = {
    "sphere": (_size(0.3, 0.5, 0.03), _Parameter(-0.15, 0.6, 0.15)),
    "cylinder": (
        _size(0.2, 0.32, 0.03),
        _size(1.5, 2.6, 0.1),
        _Parameter(-0.5 * math.pi, 0.5 * math.pi, 0.08, wraps=True),
        _Parameter(0.0, 0.6, 0.15),
    ),
    "truncated_cone": (_size(0.4, 0.6, 0.03), _size(0.4, 0.7, 0.15), _size(0.38, 0.58, 0.06)),
    "wedge": (_size(0.8, 1.25, 0.06), _Parameter(-math.pi, math.pi, 0.08, wraps=True), _Parameter(-0.15, 0.5, 0.15)),
}


# Coefficient and two factors of each column of a hypothesis, by class; see kernels.shape_walk.
_ALONG, _ACROSS, _P2, _P3, _P4 = range(1, 6)
_PLACE: Final = ((1.0, _ALONG, ONE), (1.0, _ACROSS, ONE))
_RATIO: Final = (1.0, RATIO, ONE)
_NONE: Final = (0.0, ONE, ONE)
_TERMS: Final[dict[Solid, Array]] = {
    "sphere": np.array([*_PLACE, _RATIO, (1.0, _P2, ONE), (1.0, _P2, SUNK), _NONE, _NONE, _NONE]),
    "cylinder": np.array([*_PLACE, _RATIO, (1.0, _P2, ONE), (1.0, _P3, ONE), (1.0, _P4, ONE), (1.0, _P2, SUNK), _NONE]),
    "truncated_cone": np.array(
        [*_PLACE, (1.0, ONE, ONE), (1.0, _P2, ONE), (1.0, _P2, _P3), (2.0, _P2, _P4), _NONE, _NONE]
    ),
    "wedge": np.array(
        [*_PLACE, _RATIO, *((size_m, _P2, ONE) for size_m in WEDGE_M), (1.0, _P3, ONE), (WEDGE_M[2], _P2, SUNK)]
    ),
}


class _Class(NamedTuple):
    """Hold one class under search, and what was found."""

    chart: WalkSpace
    found: Optima
    refined: bool = False

    @property
    def solid(self) -> Solid:
        """Give the solid of the best optimum."""
        return self.chart.solid

    @property
    def box(self) -> SearchBox:
        return self.chart.box


def fit_shapes(
    region: Region, contour_cost: float | None, correlation_area: float, *, effort: Effort | None = None
) -> ShapeFits:
    """Find the best solid of every class in a region.

    Everything is the same in every run.

    Parameters
    ----------
    contour_cost
        Of the best free contour of highlight and shadow, None if there is none to compare with: labels_cost of what it
        encloses plus the code length of its nodes.
    correlation_area
        Pixels over which speckle is correlated, at least 1.

    Raises
    ------
    ValueError
        As image_row_sums does.
    """
    return fit_to(
        image_row_sums(region, correlation_area), region, contour_cost, Effort() if effort is None else effort
    )


def fit_to(
    image: ImageRowSums | None,
    region: Region,
    contour_cost: float | None,
    effort: Effort,
    ranges: SearchRanges = USUAL_RANGES,
) -> ShapeFits:
    """Find the best solid of every class in a region whose `likelihood.image_row_sums` are known; see `fit_shapes`."""
    if image is None:
        return ShapeFits(fits=(), contour_cost=contour_cost, n_hypotheses=0, flags=("no_data",))
    beam = beam_of(region)
    classes = [_look(solid, region, image, effort, ranges[solid]) for solid in SOLIDS]
    n_tried = len(classes) * (effort.n_starts + effort.n_walks * effort.n_steps * effort.n_tries)
    classes = [entry for entry in classes if entry.found.cost[0] < FORBIDDEN]
    lowest = min((entry.found.cost[0] for entry in classes), default=math.inf)
    clutter = contour_cost is not None and lowest > contour_cost + _CLUTTER
    found: list[_Class] = []
    for entry in classes:
        refined = effort.refines_all or (not clutter and bool(entry.found.cost[0] < lowest + _HOPELESS))
        final = _refine(entry, image, beam, effort) if refined else entry
        n_tried += effort.n_fine_walks * effort.n_fine_steps * effort.n_fine_tries if refined else 0
        if final.found.cost[0] < FORBIDDEN:
            found.append(final)
    found.sort(key=lambda entry: float(entry.found.cost[0]))
    fits = [_fit(entry, region, image, ranges) for entry in found]
    if fits:
        fits[0] = _look_closely(fits[0], found[0], region, image, beam)
    flags = ("clutter",) if clutter else ()
    return ShapeFits(fits=tuple(fits), contour_cost=contour_cost, n_hypotheses=n_tried, flags=flags)


def ranges_with(listed: Iterable[ListedParameter]) -> SearchRanges:
    """Widen the usual ranges as far as it takes for all values listed to be usual."""
    ranges = dict(USUAL_RANGES)
    for solid, place, value in listed:
        parameter = ranges[solid][place]
        if parameter.usual is None:
            raise ValueError(f"parameter {place} of a {solid} is no size")
        low, high = parameter.usual
        if not low <= value <= high:
            wider = _size(min(low, value), max(high, value), parameter.grain)
            ranges[solid] = (*ranges[solid][:place], wider, *ranges[solid][place + 1 :])
    return ranges


def plausibility(solid: Solid, sizes: Array, ranges: SearchRanges = USUAL_RANGES) -> float:
    """Rate sizes in the order of the class's parameters, 1 within the usual, 0 at 30 % beyond."""
    known = [
        (value, parameter.usual)
        for value, parameter in zip(sizes, ranges[solid], strict=True)
        if parameter.usual is not None
    ]
    values, usual = zip(*known, strict=True)
    return float(size_plausibility(values, *zip(*usual, strict=True)))


def hypotheses_of(solid: Solid, points: Array) -> Array:
    """Turn points (n, d) into hypotheses (n, 8) for the kernel.

    A point is the place along the slices and ground range (m), then the class's parameters.
    """
    return hypotheses_at(_TERMS[solid], points)


def _look(solid: Solid, region: Region, image: ImageRowSums, effort: Effort, own: tuple[_Parameter, ...]) -> _Class:
    along_m = region.row * image.row_spacing_m
    across_m = image.first_ground_range_m + region.column * image.column_spacing_m
    place = (
        _Parameter(along_m - _ALONG_M, along_m + _ALONG_M, _PLACE_GRAIN_M),
        _Parameter(across_m - _BEFORE_M, across_m + _BEHIND_M, _PLACE_GRAIN_M),
    )
    parameters = place + own
    box = SearchBox(*(np.array([parameter[k] for parameter in parameters]) for k in (0, 1, 3, 2)))
    burial_sigma = math.inf if solid == "truncated_cone" else _BURIAL_SIGMA
    chart = WalkSpace(
        solid, box, _TERMS[solid], (_ALTITUDE_SIGMA, burial_sigma), parameter_cost(len(parameters), image)
    )
    walk = Walk(effort.n_walks, effort.n_steps, effort.n_tries, first_stride=3.0)
    return _Class(chart, search_shapes(chart, image, PENCIL, effort.n_starts, walk))


def _refine(entry: _Class, image: ImageRowSums, beam: Beam, effort: Effort) -> _Class:
    walk = Walk(effort.n_fine_walks, effort.n_fine_steps, effort.n_fine_tries, first_stride=1.2)
    return entry._replace(found=refine_shapes(entry.chart, image, beam, entry.found, walk), refined=True)


def _fit(entry: _Class, region: Region, image: ImageRowSums, ranges: SearchRanges) -> ShapeFit:
    point = entry.box.points(entry.found.unit[:1])
    return ShapeFit(
        solid=entry.solid,
        best=_optimum(entry.solid, hypotheses_of(entry.solid, point)[0], float(entry.found.cost[0]), region, image),
        plausibility=plausibility(entry.solid, point[0, 2:], ranges),
        refined=entry.refined,
    )


def _look_closely(fit: ShapeFit, entry: _Class, region: Region, image: ImageRowSums, beam: Beam) -> ShapeFit:
    """Add the details of the best of all classes."""
    found = apart(entry.found, entry.box, 2)
    points = entry.box.points(found.unit)
    hypotheses = hypotheses_of(entry.solid, points)
    second = None
    if len(found.cost) > 1 and found.cost[1] < FORBIDDEN:
        second = _optimum(entry.solid, hypotheses[1], float(found.cost[1]), region, image)
    mean = shape_costs(entry.solid, hypotheses[:1], image, beam if entry.refined else PENCIL).mean[0]
    ends = intervals(entry.solid, hypotheses[:1], image, PENCIL)[0, :, 0]
    highlight = _highlight(ends, mean, image)
    at_end = (np.abs(found.unit[0] - np.rint(found.unit[0])) < 0.01) & ~entry.box.wraps
    # Neither the place nor the absence of burial counts as a bound.
    at_end[:2] = False
    if entry.solid != "truncated_cone":
        at_end[-1] &= entry.solid != "cylinder" or found.unit[0, -1] > 0.5
    rows = np.flatnonzero(ends[:, 2] > 0.0)
    last = image.echoes.shape[1] - 1
    flags = {
        "at_bound": bool(at_end.any()),
        "altitude": abs(fit.best.altitude_ratio - 1.0) > _ALTITUDE_SIGMA,
        "buried": entry.solid != "truncated_cone"
        and points[0, -1] > (0.2 if entry.solid in ("sphere", "cylinder") else 0.1),
        "cut_off": rows.size == 0 or rows[0] == 0 or rows[-1] == len(ends) - 1 or bool(ends[:, 2].max() >= last),
        "weak_highlight": highlight.n_samples < _MIN_HIGHLIGHT,
    }
    return msgspec.structs.replace(
        fit,
        second=second,
        sigma=_sigma(entry, beam, region, image) if entry.refined else {},
        ends=tuple(map(tuple, ends.tolist())),
        contrast=(float(mean[0] / mean[2]), float(mean[1] / mean[2])),
        highlight=highlight,
        flags=tuple(name for name, raised in flags.items() if raised),
    )


def _optimum(solid: Solid, hypothesis: Array, cost: float, region: Region, image: ImageRowSums) -> Optimum:
    """Convert from slices to image and track: a slice squinted ahead meets greater ranges in later rows."""
    squint = region.squint_rad
    across_m = float(hypothesis[1]) * math.cos(squint)
    middle_m = region.first_ground_range_m + region.column * region.column_spacing_m
    ahead_m = (across_m - middle_m) * math.tan(squint)
    fields = hypothesis[FIRST_FIELD:].copy()
    if squint != 0.0 and "azimuth_rad" in FIELDS[solid]:
        index = FIELDS[solid].index("azimuth_rad")
        turn = math.pi if solid == "cylinder" else 2.0 * math.pi
        fields[index] = (fields[index] - squint + 0.5 * turn) % turn - 0.5 * turn
    return Optimum(
        shape=single_solid(solid, fields),
        row=float(hypothesis[0]) / image.row_spacing_m + ahead_m / region.row_spacing_m,
        ground_range_m=across_m,
        altitude_ratio=float(hypothesis[2]),
        cost=cost,
    )


def _sigma(entry: _Class, beam: Beam, region: Region, image: ImageRowSums) -> dict[str, float]:
    """Estimate the uncertainty of place and fields.

    It adds what speckle leaves open, doubled for what the model leaves out, the effects of resolution and altitude, and
    what sizes on the floor were wrong by on missions with known truth.
    """
    point = entry.box.points(entry.found.unit[:1])[0]
    hypothesis = hypotheses_of(entry.solid, point[np.newaxis])[0]
    covariance = curvature_covariance(lambda points: costs_at(entry.chart, points, image, beam), entry.box, point)
    there = point.copy()
    if entry.solid != "truncated_cone":
        there[-1] = max(there[-1], 1e-3)  # possible burial of a solid that fits as not buried
    step = 1e-4 * entry.box.grain
    derivative = (
        hypotheses_of(entry.solid, there + np.diag(step)) - hypotheses_of(entry.solid, there - np.diag(step))
    ).T / (2.0 * step)
    variance = _TEMPER * np.delete(np.einsum("ij,jk,ik->i", derivative, covariance, derivative), 2)
    altitude_m, across_m = image.altitude_m, float(hypothesis[1])
    along_m = _RESOLVED * math.hypot(region.row_spacing_m, region.beam_width_rad * math.hypot(across_m, altitude_m))
    upwards_m = _ALTITUDE_SIGMA * float(top_m(entry.solid, hypothesis[np.newaxis])[0])
    across_sigma_m = math.hypot(_ALTITUDE_SIGMA * altitude_m**2 / across_m, _RESOLVED * region.column_spacing_m)
    systematic = {
        "ground_range_m": across_sigma_m,
        "length_m": 2.0 * along_m,
        "height_m": upwards_m,
        "burial_m": upwards_m,
        "azimuth_rad": 0.0,
    }
    names = ("row_m", "ground_range_m", *FIELDS[entry.solid])
    sigma = {name: math.hypot(math.sqrt(variance[k]), systematic.get(name, along_m)) for k, name in enumerate(names)}
    for name, size in zip(FIELDS[entry.solid], hypothesis[FIRST_FIELD:].tolist(), strict=False):
        if name in _ON_FLOOR:
            sigma[name] = math.hypot(sigma[name], _SIZE_SHARE * size)
    if entry.solid == "truncated_cone":
        del sigma["burial_m"]  # a buried cone is a smaller cone
    return sigma


def _highlight(ends: Array, mean: Array, image: ImageRowSums) -> Highlight:
    """Measure the highlight.

    ends: (n_rows, 3) columns of the solid; mean: of highlight, shadow and floor.
    """
    rows = np.flatnonzero(ends[:, 1] > ends[:, 0])
    if rows.size == 0:
        return Highlight(model_across_m=0.0, observed_across_m=0.0, n_samples=0.0)
    bright = math.sqrt(mean[0] * mean[2])
    reach = np.arange(-20, 61)
    edges = np.clip(ends[rows, :1] + 0.5 * reach, 0.0, image.echoes.shape[1] - 1.0)
    count, total = (np.diff(up_to(sums[rows], edges), axis=1).sum(axis=0) for sums in (image.counts, image.echoes))
    width = ends[rows, 1] - ends[rows, 0]
    middle = 20 + int(np.mean(width))  # in half columns: the middle of a highlight of mean width
    across = _run(total > bright * np.maximum(count, 1e-9), min(middle, count.size - 1))
    seen = np.diff(up_to(image.counts[rows], ends[rows, :2]), axis=1).sum()
    return Highlight(
        model_across_m=float(width.mean()) * image.column_spacing_m,
        observed_across_m=0.5 * across * image.column_spacing_m,
        n_samples=float(seen) * image.samples_per_pixel,
    )


def _run(bright: np.ndarray[tuple[int, ...], np.dtype[np.bool_]], start: int) -> int:
    """Measure the run of bright cells about a start, 0 if that is dark."""
    if not bright[start]:
        return 0
    dark = np.flatnonzero(~bright)
    before, after = dark[dark < start], dark[dark > start]
    return int((after[0] if after.size else bright.size) - (before[-1] if before.size else -1) - 1)
