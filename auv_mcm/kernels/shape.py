"""Compute how badly a solid explains an image: minus the log likelihood of highlight, shadow and floor.

Every ping of an image that a solid crosses has three stretches of flat-floor ground range: highlight from its front to
its tangent point, shadow from there to where the shadow ends, floor elsewhere. Echoes are Gamma distributed about the
mean of their stretch, of which there are three in all, taken where the likelihood is highest. Relative to a floor
without an object the cost is

    (L / A_c) [N_h ln mu_h + N_s ln mu_s + N_b ln mu_b],   mu = sum of echoes / N, floor without an object mu = 1

with L looks and speckle correlated over A_c pixels. Counts and sums come from cumulative sums along rows, linear within
a pixel, so that the cost is continuous in the solid's parameters (C. Chesnaud, P. Refregier, V. Boulet, IEEE PAMI 21,
1999, for the criterion).

A beam of finite width sees several slices at once: then a row is cut wherever the stretch of one of them ends, and the
mean of a piece is mu = sum of w_k mu_k over the shares w_k that slices of highlight, shadow and floor have in it.
Fields of independent scatterers add in power, so echoes of a piece are Gamma distributed still. The means are improved
by Fisher scoring of their logarithms.

C and numpy agree to 1e-9 of the number of pixels; numpy takes the slices from auv_mcm.solids.shapes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from auv_mcm.kernels.signatures import call
from auv_mcm.solids.shapes import Cylinder, Shape, Sphere, TruncatedCone, Wedge, flat_ground_range_m, view_shape

Array: TypeAlias = NDArray[np.float64]
Solid: TypeAlias = Literal["sphere", "cylinder", "truncated_cone", "wedge"]

FORBIDDEN: Final = 1e12  # nats: cost of a solid that does not explain the image
MIN_MEAN: Final = 1e-6  # relative to the image's mean, so that a shadow without any echo has a logarithm
FIELDS: Final[dict[Solid, tuple[str, ...]]] = {
    "sphere": ("radius_m", "burial_m"),
    "cylinder": ("radius_m", "length_m", "azimuth_rad", "burial_m"),
    "truncated_cone": ("base_radius_m", "top_radius_m", "height_m", "burial_m"),
    "wedge": ("length_m", "width_m", "height_m", "azimuth_rad", "burial_m"),
}
FIRST_FIELD: Final = 3  # of a hypothesis, after its place and the share of the altitude
N_COLUMNS: Final = 8  # numbers of a hypothesis; equal in C

_KINDS: Final = list(FIELDS)
_CLASSES: Final[dict[Solid, Callable[..., Shape]]] = {
    "sphere": Sphere,
    "cylinder": Cylinder,
    "truncated_cone": TruncatedCone,
    "wedge": Wedge,
}
_NO_BOUND, _POSITIVE = -np.inf, float(np.finfo(np.float64).tiny)
_MIN: Final[dict[Solid, Array]] = {
    "sphere": np.array([_POSITIVE, 0.0]),
    "cylinder": np.array([_POSITIVE, 0.0, _NO_BOUND, 0.0]),
    "truncated_cone": np.array([_POSITIVE, 0.0, _POSITIVE, 0.0]),
    "wedge": np.array([_POSITIVE, _POSITIVE, _POSITIVE, _NO_BOUND, 0.0]),
}
_MAX_TAPS: Final = 3  # slices of a beam: its middle and one on either side; equal in C
SCORING_STEPS: Final = 2  # of Fisher's; they leave 0.02 nats at the median, 0.5 at the 95th percentile
_MIN_HIGHLIGHT, _MIN_SHADOW, _MIN_FLOOR = 4.0, 8.0, 1.0  # pixels
_DARKEST_HIGHLIGHT, _BRIGHTEST_SHADOW = 1.3, 0.6  # relative to the floor
_AT_ONCE: Final = 256  # hypotheses that numpy weighs together: bounds memory, and more are no faster
_MIXTURES: Final = 3**_MAX_TAPS
_CLEARANCE: Final = 1.2  # minimum altitude over the height of a solid


class ImageRowSums(NamedTuple):
    """Hold an image as cumulative sums along its rows; row i was seen from (i + 1/2) row_spacing_m along the track.

    echoes: (n_rows, n_columns + 1) float64, of intensity where valid, relative to its mean. counts: likewise of valid
    pixels. samples_per_pixel: looks over correlation area. smear_m: by which highlights are drawn out at both ends.
    shear: tangent of the angle by which rows look ahead of abeam: so much nearer is an object to the track per metre
    that a row is later.
    """

    echoes: Array
    counts: Array
    row_spacing_m: float
    column_spacing_m: float
    first_ground_range_m: float
    altitude_m: float
    samples_per_pixel: float
    smear_m: float
    shear: float


class Beam(NamedTuple):
    """Describe slices seen at once, one or three, symmetric.

    (n_taps,) float64 bearings from the middle and shares that sum to 1.
    """

    bearing_rad: Array
    share: Array


PENCIL: Final = Beam(np.zeros(1), np.ones(1))


class Costs(NamedTuple):
    """Hold costs of solids.

    cost: (n,) float64, nats against a floor without an object, negative if the solid explains more; FORBIDDEN if the
    solid reaches the track, is nearly as high as the sonar, leaves no pixel of floor, or has no visible highlight (4
    pixels, 1.3 times the floor) or shadow (8 pixels, 0.6 times).

    mean: (n, 3) float64 of highlight, shadow and floor, relative to the image's mean; NaN where the cost is FORBIDDEN.
    """

    cost: Array
    mean: Array


def shape_costs(solid: Solid, hypotheses: Array, image: ImageRowSums, beam: Beam = PENCIL) -> Costs:
    """Compute costs of solids of one kind.

    hypotheses: (n, 8) float64: place along the track (m, from the near edge of row 0), ground range (m), altitude over
    that of the image, which was measured and may be wrong, then FIELDS of the solid. With another altitude the ground
    range is true, not the image's. Raises ValueError for other shapes, sizes that are not positive, or a cone wider at
    its top than at its base.
    """
    hypotheses = np.ascontiguousarray(hypotheses, dtype=np.float64)
    _check(solid, hypotheses, image, beam)
    n, (n_rows, n_edges), n_taps = len(hypotheses), image.echoes.shape, beam.share.size
    scalars = np.array(image[2:], dtype=np.float64)
    costs = Costs(np.empty(n), np.empty((n, 3)))
    seen = n_rows, n_edges - 1, scalars, image.echoes, image.counts, n_taps, *beam
    if not call("shape_costs", kind_of(solid), n, hypotheses, *seen, SCORING_STEPS, *costs):
        return shape_costs_numpy(solid, hypotheses, image, beam)
    return costs


def kind_of(solid: Solid) -> int:
    """Give the number of a solid in C."""
    return _KINDS.index(solid)


def solid_of(solid: Solid, fields: Array) -> Shape:
    """Make the solid with these values of FIELDS along the last axis, as arrays (..., 1) to broadcast against pings."""
    return _CLASSES[solid](**{name: fields[..., k, np.newaxis] for k, name in enumerate(FIELDS[solid])})


def single_solid(solid: Solid, fields: Array) -> Shape:
    """Make the solid with these values of FIELDS, (5,) or the first of more."""
    return _CLASSES[solid](**dict(zip(FIELDS[solid], fields.tolist(), strict=False)))


def intervals(solid: Solid, hypotheses: Array, image: ImageRowSums, beam: Beam = PENCIL) -> Array:
    """Find where highlights begin, shadows begin and shadows end, (n, n_rows, n_taps, 3) float64 columns.

    Edges are at whole numbers; columns are cut at the image's edges; three times 0 where a slice misses the solid.

    A wedge may turn its vertical face to the sonar. The face's foot, whose echo comes after that of the edge above it,
    ends the highlight. Raises ValueError as shape_costs does; hypotheses must be none that it forbids.
    """
    hypotheses = np.ascontiguousarray(hypotheses, dtype=np.float64)
    _check(solid, hypotheses, image, beam)
    n_rows, n_edges = image.echoes.shape
    scalars, bearing = np.array(image[2:], dtype=np.float64), beam.bearing_rad
    ends = np.empty((len(hypotheses), n_rows, bearing.size, 3))
    seen = n_rows, n_edges - 1, scalars, bearing.size, bearing
    if not call("shape_intervals", kind_of(solid), len(hypotheses), hypotheses, *seen, ends):
        return intervals_numpy(solid, hypotheses, image, beam)
    return ends


def intervals_numpy(solid: Solid, hypotheses: Array, image: ImageRowSums, beam: Beam = PENCIL) -> Array:
    """Do as intervals, in numpy alone."""
    n, n_rows = len(hypotheses), image.echoes.shape[0]
    every = np.repeat(np.arange(n), n_rows), np.tile(np.arange(n_rows), n)
    return _ends(solid, hypotheses, *every, image, beam).reshape(n, n_rows, beam.share.size, 3)


def _ends(
    solid: Solid, hypotheses: Array, which: NDArray[np.intp], row: NDArray[np.intp], image: ImageRowSums, beam: Beam
) -> Array:
    """Find the columns of `intervals` for m pairs of a hypothesis and a row, (m, n_taps, 3)."""
    each = hypotheses[which]
    along, across, altitude = (each[:, k, np.newaxis] for k in range(FIRST_FIELD))
    altitude = altitude * image.altitude_m
    turned = beam.bearing_rad * np.hypot(across, altitude)
    offset = ((row + 0.5) * image.row_spacing_m)[:, np.newaxis] - along + turned
    across = across - offset * image.shear
    view = view_shape(solid_of(solid, each[:, FIRST_FIELD:]), offset, across, altitude)
    tangent = view.tangent_slant_range_m
    if solid == "wedge":
        tangent = np.fmax(tangent, np.hypot(across + _wedge_foot(each[:, FIRST_FIELD:], offset), altitude))
    slant = np.stack((view.front_slant_range_m, tangent, np.hypot(view.shadow_end_m, altitude)), axis=-1)
    ranges = flat_ground_range_m(slant, image.altitude_m)
    ranges = ranges + np.array([-image.smear_m, image.smear_m, 0.0])
    ends = np.clip((ranges - image.first_ground_range_m) / image.column_spacing_m, 0.0, image.echoes.shape[1] - 1.0)
    return np.maximum.accumulate(np.where(np.isnan(ends), 0.0, ends), axis=-1)


def shape_costs_numpy(solid: Solid, hypotheses: Array, image: ImageRowSums, beam: Beam = PENCIL) -> Costs:
    """Do as shape_costs, in numpy alone."""
    costs = Costs(np.full(len(hypotheses), FORBIDDEN), np.full((len(hypotheses), 3), np.nan))
    reach = reach_m(solid, hypotheses)
    clear = hypotheses[:, 1] > reach * (1.0 + abs(image.shear))
    top = top_m(solid, hypotheses)
    clear &= (image.altitude_m * hypotheses[:, 2] >= _CLEARANCE * top) & (top > 0.0)
    chosen = np.flatnonzero(clear)
    for first in range(0, chosen.size, _AT_ONCE):
        some = chosen[first : first + _AT_ONCE]
        which, row = _rows_reached(hypotheses[some], reach[some], image, beam)
        ends = _ends(solid, hypotheses[some], which, row, image, beam)
        costs.cost[some], costs.mean[some] = _costs(ends, which, row, len(some), image, beam)
    return costs


def _rows_reached(
    hypotheses: Array, reach: Array, image: ImageRowSums, beam: Beam
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Pair each hypothesis (n, 8) with the rows that may see it: indices of both, (m,) each, rows rising."""
    slant = np.hypot(hypotheses[:, 1], hypotheses[:, 2] * image.altitude_m)
    far = reach + np.abs(beam.bearing_rad).max() * slant
    first, stop = (
        np.clip((hypotheses[:, 0] + side * far) / image.row_spacing_m + side, 0.0, len(image.echoes)).astype(np.intp)
        for side in (-1.0, 1.0)
    )
    n_each = np.maximum(stop - first, 0)
    which = np.repeat(np.arange(len(hypotheses)), n_each)
    return which, np.arange(len(which)) - np.repeat(np.cumsum(n_each) - n_each - first, n_each)


def reach_m(solid: Solid, hypotheses: Array) -> Array:
    """Compute the horizontal radius about the place within which all of the solid lies, (n,) m."""
    match solid:
        case "sphere" | "truncated_cone":
            return hypotheses[:, 3]
        case "cylinder":
            return np.hypot(hypotheses[:, 3], 0.5 * hypotheses[:, 4])
        case "wedge":
            return 0.5 * np.hypot(hypotheses[:, 3], hypotheses[:, 4])


def top_m(solid: Solid, hypotheses: Array) -> Array:
    """Compute the height of the solid over the floor, (n,) m."""
    match solid:
        case "sphere":
            return 2.0 * hypotheses[:, 3] - hypotheses[:, 4]
        case "cylinder":
            return 2.0 * hypotheses[:, 3] - hypotheses[:, 6]
        case "truncated_cone":
            return hypotheses[:, 5] - hypotheses[:, 6]
        case "wedge":
            return hypotheses[:, 5] - hypotheses[:, 7]


def up_to(sums: Array, column: Array, row: NDArray[np.intp] | None = None) -> Array:
    """Interpolate cumulative sums (n_rows, n_columns + 1) linearly at fractional columns (..., m, k) of m rows.

    row: (m,) indices, every row by default.
    """
    left = np.minimum(column.astype(np.intp), sums.shape[1] - 2)
    at = left + sums.shape[1] * (np.arange(sums.shape[0]) if row is None else row)[:, np.newaxis]
    low, high = np.take(sums, at), np.take(sums, at + 1)
    return np.asarray(low + (high - low) * (column - left), dtype=np.float64)


def _wedge_foot(fields: Array, offset: Array) -> Array:
    """Compute the minimum ground range, from its place, of the floor that a wedge covers.

    In slices (n, m); NaN where they miss it.
    """
    length, width, height, azimuth, burial = (fields[:, k, np.newaxis] for k in range(5))
    sides = (
        (np.cos(azimuth), np.sin(azimuth), (burial / height - 0.5) * length, 0.5 * length),
        (-np.sin(azimuth), np.cos(azimuth), -0.5 * width, 0.5 * width),
    )
    near, far = np.full(offset.shape, -np.inf), np.full(offset.shape, np.inf)
    for along, across, low, high in sides:
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = np.sort([(low - along * offset) / across, (high - along * offset) / across], axis=0)
        near, far = np.fmax(near, ends[0]), np.fmin(far, ends[1])
    return np.asarray(np.where(near <= far, near, np.nan), dtype=np.float64)


def _costs(
    ends: Array, which: NDArray[np.intp], row: NDArray[np.intp], n: int, image: ImageRowSums, beam: Beam
) -> Costs:
    """Compute costs of n hypotheses. ends: (m, n_taps, 3) columns of pairs of a hypothesis and a row, (m,) each."""
    whole = np.array([image.counts[:, -1].sum(), image.echoes[:, -1].sum()])
    middle = ends[:, beam.share.size // 2]
    parts = [np.diff(up_to(sums, middle, row), axis=1) for sums in (image.counts, image.echoes)]
    parts = [np.column_stack([np.bincount(which, of, minlength=n) for of in part.T]) for part in parts]
    count, total = (
        np.column_stack((part, of_all - part.sum(axis=1))) for part, of_all in zip(parts, whole, strict=True)
    )
    mean = np.maximum(np.divide(total, count, out=np.zeros(count.shape), where=count > 0.0), MIN_MEAN)
    visible = (count[:, 0] >= _MIN_HIGHLIGHT) & (count[:, 1] >= _MIN_SHADOW) & (count[:, 2] >= _MIN_FLOOR)
    share = np.eye(3)
    if beam.share.size > 1:
        count, total = _mixtures(ends, which, row, n, image, whole)
        share = _mixture_shares(beam.share)
    count, total, mean = count[visible], total[visible], mean[visible]
    for _ in range(SCORING_STEPS if beam.share.size > 1 else 0):
        mean = _improved(count, total, share, mean)
    expected = mean @ share.T
    found = image.samples_per_pixel * (count * np.log(expected) + total / expected - count).sum(axis=1)
    contrasting = (mean[:, 1] <= _BRIGHTEST_SHADOW * mean[:, 2]) & (mean[:, 0] >= _DARKEST_HIGHLIGHT * mean[:, 2])
    costs = Costs(np.full(n, FORBIDDEN), np.full((n, 3), np.nan))
    costs.cost[visible] = np.where(contrasting, found, FORBIDDEN)
    costs.mean[visible] = np.where(contrasting[:, np.newaxis], mean, np.nan)
    return costs


def _mixtures(
    ends: Array, which: NDArray[np.intp], row: NDArray[np.intp], n: int, image: ImageRowSums, whole: Array
) -> tuple[Array, Array]:
    """Give counts and sums (n, 27) of all that is of one mixture.

    A mixture's number has a digit of base 3 for each tap: 0 floor, 1 highlight, 2 shadow.
    """
    n_taps = ends.shape[1]
    columns = ends.reshape(len(ends), 3 * n_taps)
    order = np.argsort(columns, axis=1, kind="stable")
    columns = np.take_along_axis(columns, order, axis=1)
    step = np.outer(3 ** np.arange(n_taps), (1, 1, -2)).ravel()
    place = _MIXTURES * which[:, np.newaxis] + np.cumsum(step[order], axis=1)[:, :-1]
    found = []
    for sums, of_all in zip((image.counts, image.echoes), whole, strict=True):
        pieces = np.diff(up_to(sums, columns, row), axis=1)
        part: Array = np.bincount(place.ravel(), pieces.ravel(), minlength=n * _MIXTURES).astype(np.float64)
        part = part.reshape(n, _MIXTURES)
        part[:, 0] = of_all - part[:, 1:].sum(axis=1)
        found.append(part)
    return found[0], found[1]


def _mixture_shares(share: Array) -> Array:
    """Give the shares of highlight, shadow and floor in each mixture, (27, 3)."""
    digit = np.arange(_MIXTURES)[:, np.newaxis] // 3 ** np.arange(share.size) % 3
    highlight, shadow = (np.where(digit == code, share, 0.0).sum(axis=1) for code in (1, 2))
    return np.column_stack((highlight, shadow, 1.0 - highlight - shadow))


def _improved(count: Array, total: Array, share: Array, mean: Array) -> Array:
    """Improve means (n, 3) by one step of Fisher scoring. share: (m, 3) of m mixtures with count and total (n, m)."""
    part = share * mean[:, np.newaxis]
    expected = part.sum(axis=2)
    part = part / expected[:, :, np.newaxis]
    information = (part * count[:, :, np.newaxis]).swapaxes(1, 2) @ part
    information += (1e-9 * information.trace(axis1=1, axis2=2) + 1e-12)[:, np.newaxis, np.newaxis] * np.eye(3)
    excess = part.swapaxes(1, 2) @ (total / expected - count)[:, :, np.newaxis]
    step = np.linalg.solve(information, excess)[:, :, 0]
    return np.asarray(np.maximum(mean * np.exp(np.clip(step, -1.0, 1.0)), MIN_MEAN), dtype=np.float64)


def _check(solid: Solid, hypotheses: Array, image: ImageRowSums, beam: Beam) -> None:
    if hypotheses.ndim != 2 or hypotheses.shape[1] != N_COLUMNS:
        raise ValueError(f"hypotheses must have shape (n, {N_COLUMNS}), not {hypotheses.shape}")
    n_fields = len(FIELDS[solid])
    if not np.isfinite(hypotheses).all():
        raise ValueError("hypotheses must be finite")
    if image.echoes.ndim != 2 or image.echoes.shape != image.counts.shape or image.echoes.shape[1] < 2:
        raise ValueError(
            f"echoes and counts must have one shape (n_rows, n_columns + 1), not {image.echoes.shape}, "
            f"{image.counts.shape}"
        )
    if beam.share.size % 2 == 0 or beam.share.size > _MAX_TAPS or beam.bearing_rad.shape != beam.share.shape:
        raise ValueError(f"a beam must have an odd number of slices up to {_MAX_TAPS}, not {beam.share.size}")
    fields = hypotheses[:, FIRST_FIELD : FIRST_FIELD + n_fields]
    if not (fields >= _MIN[solid]).all() or (solid == "truncated_cone" and (fields[:, 1] > fields[:, 0]).any()):
        solid_of(solid, hypotheses[:, FIRST_FIELD:])  # raises an error that names the size
