"""Weigh what a view shows of an object's kind and size by the list of the mines expected.

The odds of a mine were fitted on mines of many sizes, the usual ones. A list changes one probability alone: that of
the measurements m if there is a mine. By Bayes the evidence of the view changes by

    ln p(m | a mine of the list) / p(m | a usual mine) = ln sum over kinds k of P(k | m) f_k,
    f_k = share of kind k in the list / its usual share * p(sizes measured | k, the list) / p(sizes measured | k, usual)

with P(k | m), the kind if it is a usual mine, from the cost of the best solid of each kind. What p(m | clutter) is does
not change. Sizes measured are those of the best solid of kind k. Their law given the true ones is linear and normal in
logarithms, with a share of looks in which they say nothing; it was measured on simulated looks. A mine is on no line of
the list with probability `not_listed`: f_k becomes not_listed + (1 - not_listed) f_k, so that no view loses more than
-ln not_listed, and none gains more.

A list that names all kinds without sizes gives f_k = 1 to the last bit.
"""

from __future__ import annotations

import functools
import math
from importlib import resources
from typing import Annotated, Final, NamedTuple, TypeAlias

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from auv_mcm.classify.fit import USUAL_RANGES, WEDGE_M, ListedParameter, SearchRanges, ShapeFit, ShapeFits, ranges_with
from auv_mcm.classify.targets import (
    ExpectedCone,
    ExpectedCylinder,
    ExpectedMine,
    ExpectedSphere,
    ExpectedWedge,
    TargetLibrary,
)
from auv_mcm.errors import BadInputError
from auv_mcm.kernels.shape import FORBIDDEN, Solid

Array: TypeAlias = NDArray[np.float64]

_FILE: Final = "size_law.json"
_HIGHEST: Final = 20.0  # nats, far beyond what not_listed leaves of a gain; keeps the exponential finite
_LogSizes: TypeAlias = Annotated[tuple[float, ...], Meta(min_length=1, max_length=2)]


class SizeLaw(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """State how sizes are measured: logarithm = offset + slope * logarithm of the true one + error.

    covariance: of the errors. astray: share of looks in which the sizes measured say nothing about the true ones.
    """

    offset: _LogSizes
    slope: _LogSizes
    covariance: tuple[_LogSizes, ...]
    astray: Annotated[float, Meta(ge=0.0, le=1.0)]


class KindSizes(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Hold the sizes of one kind, in the order of `log_sizes`.

    mean, sd: of the logarithms of true sizes, m, of the mines that odds are fitted on. clear, faint: by how much the
    solid explains. offset_nats: by which the kind is likelier than its cost says.
    """

    mean: _LogSizes
    sd: _LogSizes
    clear: SizeLaw
    faint: SizeLaw
    offset_nats: float


class SizeModel(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Hold what sizes look like.

    clear_nats: cost of a solid up to which it is clear. temper: nats of cost that make a kind e times less likely.
    """

    fitted_on: str
    made_by: str
    clear_nats: float
    temper: Annotated[float, Meta(gt=0.0)]
    kinds: dict[Solid, KindSizes]


class SizeWeight(NamedTuple):
    """Hold what a list says about one view.

    nats: by which the evidence for a mine changes. factors: by which each kind is more probable than without a list.
    """

    nats: float
    factors: dict[Solid, float]


NO_WEIGHT: Final = SizeWeight(0.0, {})


@functools.cache
def shipped_size_model() -> SizeModel:
    """Read the model that ships with the package, once in a process."""
    return parse_size_model(resources.files("auv_mcm.classify").joinpath(_FILE).read_bytes(), _FILE)


def parse_size_model(data: bytes, place: str) -> SizeModel:
    """Parse a model from JSON. Raises BadInputError naming `place` and what is wrong with it."""
    try:
        return msgspec.json.decode(data, type=SizeModel)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise BadInputError(f"{place}: {error}. Write the file again with 'auv-mcm calibrate sizes'") from error


def log_sizes(fit: ShapeFit) -> tuple[float, ...]:
    """Give the logarithms of the sizes, m, that identify a solid of its kind.

    Cylinder: length, diameter. Sphere: diameter. Truncated cone: diameter of the base, height. Wedge: length.
    """
    shape = fit.best.shape
    sizes = {name: float(getattr(shape, name)) for name in shape.__struct_fields__}
    match fit.solid:
        case "cylinder":
            return math.log(sizes["length_m"]), math.log(2.0 * sizes["radius_m"])
        case "sphere":
            return (math.log(2.0 * sizes["radius_m"]),)
        case "truncated_cone":
            return math.log(2.0 * sizes["base_radius_m"]), math.log(sizes["height_m"])
        case "wedge":
            return (math.log(sizes["length_m"]),)


def listed_sizes(mine: ExpectedMine) -> tuple[Solid, tuple[float | None, ...]]:
    """Give the kind of an expected mine and its sizes, m, in the order of `log_sizes`; None for any."""
    match mine:
        case ExpectedCylinder():
            return "cylinder", (mine.length_m, mine.diameter_m)
        case ExpectedSphere():
            return "sphere", (mine.diameter_m,)
        case ExpectedCone():
            return "truncated_cone", (mine.base_diameter_m, mine.height_m)
        case ExpectedWedge():
            return "wedge", (mine.length_m,)


def search_ranges(library: TargetLibrary) -> SearchRanges:
    """Widen what is searched for solids so that every mine of a list with its sizes lies in it."""
    return ranges_with(parameter for mine in library.mines for parameter in _parameters(mine))


def is_usual(mine: ExpectedMine) -> bool:
    """Check whether a mine has sizes that are searched without a list, and that odds were fitted on."""
    return ranges_with(_parameters(mine)) == USUAL_RANGES


def _parameters(mine: ExpectedMine) -> list[ListedParameter]:
    """Give the sizes of an expected mine as the parameters that are searched."""
    solid, sizes_m = listed_sizes(mine)
    match solid, sizes_m:
        case "cylinder", (length_m, diameter_m):
            wanted = [(0, _half(diameter_m)), (1, length_m)]
        case "truncated_cone", (base_m, height_m):
            ratio = None if base_m is None or height_m is None else height_m / base_m
            wanted = [(0, _half(base_m)), (2, ratio)]
        case "wedge", (length_m,):
            wanted = [(0, None if length_m is None else length_m / WEDGE_M[0])]
        case _, (diameter_m,):
            wanted = [(0, _half(diameter_m))]
    return [ListedParameter(solid, place, value) for place, value in wanted if value is not None]


def _half(size_m: float | None) -> float | None:
    return None if size_m is None else 0.5 * size_m


class _Normal(NamedTuple):
    """Hold a normal density: mean (d,), inverse covariance (d, d), logarithm of its height."""

    mean: Array
    precision: Array
    log_height: float

    @classmethod
    def of(cls, mean: Array, sd: Array, law: SizeLaw) -> _Normal:
        """Compute the law of sizes measured of mines whose true ones have this mean and standard deviation."""
        slope = np.array(law.slope)
        covariance = np.diag((slope * sd) ** 2) + np.array(law.covariance)
        log_height = -0.5 * float(np.linalg.slogdet(2.0 * np.pi * covariance)[1])
        return cls(np.array(law.offset) + slope * mean, np.linalg.inv(covariance), log_height)

    def log_density(self, at: Array) -> float:
        off = at - self.mean
        return self.log_height - 0.5 * float(off @ self.precision @ off)


class _Listed(NamedTuple):
    """Hold the densities of one kind for clear or faint solids.

    weights: share of each expected mine in the list over the usual share of its kind.
    """

    usual: _Normal
    weights: tuple[float, ...]
    expected: tuple[_Normal, ...]
    astray: float

    def factor(self, measured: Array) -> float:
        usual = self.usual.log_density(measured)
        # Summed without rounding, so that the order of the list does not matter.
        return math.fsum(
            weight * (1.0 + (1.0 - self.astray) * math.expm1(min(one.log_density(measured) - usual, _HIGHEST)))
            for weight, one in zip(self.weights, self.expected, strict=True)
        )


class SizeEvidence:
    """Weigh views by a list of expected mines."""

    def __init__(self, library: TargetLibrary, model: SizeModel) -> None:
        self.ranges: Final = search_ranges(library)
        """Of parameters that are searched."""
        self._not_listed = library.not_listed
        self._model = model
        total = math.fsum(mine.share for mine in library.mines)
        self._listed: dict[tuple[Solid, bool], _Listed] = {}
        for solid, kind in model.kinds.items():
            own = [mine for mine in library.mines if listed_sizes(mine)[0] == solid]
            weights = tuple(len(model.kinds) * mine.share / total for mine in own)
            for is_clear, law in ((True, kind.clear), (False, kind.faint)):
                usual = _Normal.of(np.array(kind.mean), np.array(kind.sd), law)
                expected = tuple(_Normal.of(*_true_sizes(mine, kind), law) for mine in own)
                self._listed[solid, is_clear] = _Listed(usual, weights, expected, law.astray)

    def weigh(self, fits: ShapeFits) -> SizeWeight:
        """Weigh the solids that explain one view. Without any, the list says nothing."""
        share = self._kind_shares(fits)
        factors: dict[Solid, float] = {}
        change = 0.0
        for fit in fits.fits:
            is_clear = fit.best.cost <= self._model.clear_nats
            listed = self._listed[fit.solid, is_clear].factor(np.array(log_sizes(fit)))
            factors[fit.solid] = 1.0 + (1.0 - self._not_listed) * (listed - 1.0)
            change += share[fit.solid] * (factors[fit.solid] - 1.0)
        bound = -math.log(self._not_listed)
        # Of a kind that is missing no solid can be seen there at all: the others share its probability.
        return SizeWeight(min(max(math.log1p(max(change, self._not_listed - 1.0)), -bound), bound), factors)

    def _kind_shares(self, fits: ShapeFits) -> dict[Solid, float]:
        """Compute the probability of each kind if it is a usual mine."""
        costs = {fit.solid: fit.best.cost for fit in fits.fits if fit.best.cost < FORBIDDEN}
        if not costs:
            return {fit.solid: 0.0 for fit in fits.fits}
        level = {
            solid: self._model.kinds[solid].offset_nats - cost / self._model.temper for solid, cost in costs.items()
        }
        highest = max(level.values())
        share = {solid: math.exp(one - highest) for solid, one in level.items()}
        total = sum(share.values())
        return {fit.solid: share.get(fit.solid, 0.0) / total for fit in fits.fits}


def _true_sizes(mine: ExpectedMine, kind: KindSizes) -> tuple[Array, Array]:
    """Compute mean and standard deviation of the logarithms of the true sizes of an expected mine.

    Those of the kind, as far as its sizes with their tolerances leave room.
    """
    mean, sd = np.array(kind.mean), np.array(kind.sd)
    for place, size_m in enumerate(listed_sizes(mine)[1]):
        if size_m is not None:
            kept = sd[place] ** 2 / (sd[place] ** 2 + mine.spread_nats**2)
            mean[place] += kept * (math.log(size_m) - mean[place])
            sd[place] *= math.sqrt(1.0 - kept)
    return mean, sd


@functools.cache
def size_evidence(library: TargetLibrary) -> SizeEvidence:
    """Prepare a list with the model that ships, once in a process."""
    return SizeEvidence(library, shipped_size_model())
