"""Measure how the sizes of mines look, for the list of mines expected: `auv-mcm calibrate sizes`.

Missions of the wide world are flown, whose mines have all sizes, and the solids of each look at a mine are compared
with its true kind and sizes. Sizes measured are linear in the true ones, in logarithms, or say nothing about them: a
mixture of two normal laws, fitted by expectation maximization (A. P. Dempster, N. M. Laird and D. B. Rubin, J. Royal
Statistical Society B 39, 1977), apart for solids that explain much and for others. The kind follows from the costs of
the solids by logistic regression with one slope.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.classify.fit import WEDGE_M
from auv_mcm.classify.odds import shipped_odds
from auv_mcm.classify.size_evidence import KindSizes, SizeLaw, SizeModel, log_sizes
from auv_mcm.confirm.region import require_sound
from auv_mcm.confirmation import examine, is_worth_confirming, region_of
from auv_mcm.errors import UsageError
from auv_mcm.kernels.shape import Solid
from sim_replay.fitting.cascade.farm import Farm, run_tasks
from sim_replay.fitting.fit_odds import drawn_scene, looks_at_targets
from sim_replay.missions import config_for
from sim_replay.simulator.mission import Mission

Array = NDArray[np.float64]

CLEAR_NATS: Final = (
    -20.0
)  # cost up to which a solid is clear: half of the looks at mines, with half the error of others
_KINDS: Final[tuple[Solid, ...]] = ("cylinder", "sphere", "truncated_cone", "wedge")
_MIN_LOOKS: Final = 20  # per kind and clearness: fewer do not give a law with three numbers per size
_STEPS: Final = 60  # of expectation maximization and of the regression; both settle in fewer
_MIN_PIXELS: Final = 8  # along either axis, as in confirmation
_ASTRAY, _BEGIN_SD = 0.2, 0.15  # share that goes astray, and error of the others, to begin with
_RIDGE: Final = 1e-4  # of variances, as logarithms: 1 % of a size
_DIGITS: Final = 4  # decimals in the file


class SizedLook(NamedTuple):
    """Hold one look at a mine.

    true: logarithms of its sizes, as log_sizes orders them. measured: of the best solid of each kind, with its cost.
    """

    kind: Solid
    true: tuple[float, ...]
    measured: dict[Solid, tuple[float, ...]]
    cost: dict[Solid, float]


def true_log_sizes(kind: Solid, length_m: float, width_m: float, height_m: float) -> tuple[float, ...]:
    """Give the logarithms of true sizes as solids of the kind have them.

    A wedge of other proportions counts with the length of one of the proportions tried that is as large.
    """
    match kind:
        case "cylinder":
            return math.log(length_m), math.log(width_m)
        case "sphere":
            return (math.log(width_m),)
        case "truncated_cone":
            return math.log(width_m), math.log(height_m)
        case "wedge":
            volume = length_m * width_m * height_m / math.prod(WEDGE_M)
            return (math.log(volume) / 3.0 + math.log(WEDGE_M[0]),)


def fly_sizes(seed: int) -> list[SizedLook]:
    """Fly one mission of the wide world and take the looks at its mines that go as far as solids."""
    scene = drawn_scene(seed)
    mission, config, odds = Mission(scene), config_for(scene), shipped_odds("cascade")
    looks = []
    for detection, known in looks_at_targets(config, mission.events(), lambda: mission.truth()["objects"]):
        kind: Solid = known["kind"]
        if kind not in _KINDS or not is_worth_confirming(detection, odds, config.confirm):
            continue
        if detection.surroundings is None:
            continue
        region = region_of(detection, detection.surroundings, config.sonar.beam_width_rad)
        if min(region.intensity.shape) < _MIN_PIXELS:
            continue
        try:
            require_sound(region)
        except ValueError:  # as in confirmation: nothing can be measured there
            continue
        fits = examine(detection, region, odds, config.confirm.min_p_mine).fits
        if fits is not None and fits.fits:
            looks.append(
                SizedLook(
                    kind,
                    true_log_sizes(kind, known["length_m"], known["width_m"], known["height_m"]),
                    {fit.solid: log_sizes(fit) for fit in fits.fits},
                    {fit.solid: fit.best.cost for fit in fits.fits},
                )
            )
    return looks


def calibrate_sizes(
    seeds: Sequence[int], n_workers: int, made_by: str, show: Callable[[int, int], None] = lambda done, of: None
) -> SizeModel:
    """Fly missions with these seeds and fit the model.

    Raises UsageError for too few looks.
    """
    flown = run_tasks(fly_sizes, seeds, Farm(n_workers), lambda done: show(done, len(seeds)))
    looks = [look for mission in flown for look in mission]
    return fit_sizes(looks, f"{len(looks)} looks at mines, wide world, seeds {seeds[0]} to {seeds[-1]}", made_by)


def fit_sizes(looks: Sequence[SizedLook], fitted_on: str, made_by: str) -> SizeModel:
    """Fit the model to looks. Raises UsageError for too few."""
    temper, offset_nats = _kind_law(looks)
    kinds: dict[Solid, KindSizes] = {}
    for kind in _KINDS:
        own = [look for look in looks if look.kind == kind and kind in look.cost]
        laws = []
        for is_clear in (True, False):
            some = [look for look in own if (look.cost[kind] <= CLEAR_NATS) is is_clear]
            if len(some) < _MIN_LOOKS:
                raise UsageError(f"{len(some)} looks at a {kind} are too few to fit on. Fly more, with --seeds")
            laws.append(_size_law(np.array([look.true for look in some]), np.array([k.measured[kind] for k in some])))
        true = np.array([look.true for look in own])
        kinds[kind] = KindSizes(
            mean=_rounded(true.mean(axis=0)),
            sd=_rounded(true.std(axis=0)),
            clear=laws[0],
            faint=laws[1],
            offset_nats=round(offset_nats[kind], _DIGITS),
        )
    return SizeModel(
        fitted_on=fitted_on, made_by=made_by, clear_nats=CLEAR_NATS, temper=round(temper, _DIGITS), kinds=kinds
    )


def _size_law(true: Array, measured: Array) -> SizeLaw:
    """Fit the law of sizes measured, (n, d), given true ones, (n, d), and the share that goes astray."""
    n, d = true.shape
    anywhere = _log_normal(measured - measured.mean(axis=0), _covariance(measured, np.ones(n)))
    # To begin with, what lies near the true sizes is measured and the rest is astray.
    measures = np.log1p(-_ASTRAY) + _log_normal(measured - true, _BEGIN_SD**2 * np.eye(d))
    weight, astray = 1.0 / (1.0 + np.exp(np.log(_ASTRAY) + anywhere - measures)), _ASTRAY
    for _ in range(_STEPS):
        slope, offset = np.empty(d), np.empty(d)
        for k in range(d):
            middle, seen = np.average(true[:, k], weights=weight), np.average(measured[:, k], weights=weight)
            both = np.average((true[:, k] - middle) * (measured[:, k] - seen), weights=weight)
            spread = np.average((true[:, k] - middle) ** 2, weights=weight)
            slope[k] = min(max(both / (spread + _RIDGE), 0.0), 1.0)
            offset[k] = seen - slope[k] * middle
        off = measured - offset - slope * true
        covariance = _covariance(off, weight)
        measures = np.log1p(-astray) + _log_normal(off, covariance)
        weight = 1.0 / (1.0 + np.exp(np.log(astray) + anywhere - measures))
        astray = float(np.clip(1.0 - weight.mean(), 0.01, 0.99))
    return SizeLaw(
        offset=_rounded(offset),
        slope=_rounded(slope),
        covariance=tuple(_rounded(row) for row in covariance),
        astray=round(astray, _DIGITS),
    )


def _covariance(off: Array, weight: Array) -> Array:
    """Compute the covariance of deviations (n, d) with weights (n,)."""
    return np.asarray((weight[:, np.newaxis] * off).T @ off / weight.sum() + _RIDGE * np.eye(off.shape[1]))


def _log_normal(off: Array, covariance: Array) -> Array:
    """Compute the logarithm of a normal density at deviations (n, d), (n,)."""
    log_height = -0.5 * np.linalg.slogdet(2.0 * np.pi * covariance)[1]
    return np.asarray(log_height - 0.5 * np.einsum("ij,jk,ik->i", off, np.linalg.inv(covariance), off))


def _kind_law(looks: Sequence[SizedLook]) -> tuple[float, dict[Solid, float]]:
    """Fit temper and offsets of the kinds' probabilities, softmax(offset - cost / temper), by likelihood.

    Kinds weigh the same, however many looks each has.
    """
    from scipy.optimize import minimize

    # A solid that cannot be seen there at all is far behind: exp(-100) of the best.
    cost = np.array([[look.cost.get(kind, min(look.cost.values()) + 1000.0) for kind in _KINDS] for look in looks])
    kind = np.array([_KINDS.index(look.kind) for look in looks])
    weight = 1.0 / np.bincount(kind, minlength=len(_KINDS))[kind]

    def loss(parameters: Array) -> float:
        level = np.append(parameters[1:], 0.0) - cost * math.exp(-parameters[0])
        highest = level.max(axis=1)
        total = highest + np.log(np.exp(level - highest[:, np.newaxis]).sum(axis=1))
        # A look in a hundred is anybody's guess, so that one misled solid does not set the law.
        p = 0.99 * np.exp(level[np.arange(len(kind)), kind] - total) + 0.01 / len(_KINDS)
        return -float((weight * np.log(p)).sum())

    found: Any = minimize(loss, np.append(math.log(8.0), np.zeros(len(_KINDS) - 1)), method="Nelder-Mead")
    offsets = np.append(found.x[1:], 0.0)
    return math.exp(found.x[0]), dict(zip(_KINDS, offsets.tolist(), strict=True))


def _rounded(values: Array) -> tuple[float, ...]:
    return tuple(round(float(value), _DIGITS) for value in values)
