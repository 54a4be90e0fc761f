"""Estimate how densely non-mines lie that look as mine-like as a contact or more.

The log-odds of a mission's contacts are a mixture of two groups (B. Efron, "Large-scale simultaneous hypothesis
testing: the choice of a null hypothesis", JASA 99, 2004): a background, dense at low log-odds and thinning out upwards,
and mines. Contacts per bin of log-odds are Poisson counts of mean area * (background + mines). The logarithm of the
background's density is linear between knots, with a normal prior over its values there: its mean and covariance are
those of missions whose truth is known. So a short mission gets what training expects, and a long one what it shows by
itself. The density of mines is not known: a broad prior lets them be rare or many, so that mines among few contacts are
not taken for background. For each of a ladder of densities of mines the background has Laplace's approximation (L.
Tierney and J. Kadane, JASA 81, 1986) about its mode, found by Fisher scoring; the evidence of each weighs them.
"""

from __future__ import annotations

import math
from importlib import resources
from typing import Annotated, Final, NamedTuple, TypeAlias

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from auv_mcm.errors import BadInputError
from auv_mcm.model_file import NONE, read_model
from auv_mcm.records import Detector

Array: TypeAlias = NDArray[np.float64]

LOWEST_P_MINE: Final = 0.01
"""Where the model begins. A mission's own contacts count from `contacts.min_p_mine` on, where that is higher."""
LOWEST_NATS: Final = math.log(LOWEST_P_MINE / (1.0 - LOWEST_P_MINE))
BIN_NATS: Final = 0.25  # a tenth of what the density changes by e over, on the steepest of the named scenes
N_BINS: Final = 44  # of BIN_NATS: they end at p_mine 0.998
LEVELS_NATS: Final[Array] = LOWEST_NATS + BIN_NATS * np.arange(N_BINS, dtype=np.float64)
"""Lower edges of the bins, (N_BINS,): p_mine 0.01 to 0.998. The last bin has no upper edge."""
KNOTS_NATS: Final[Array] = np.array([LOWEST_NATS, -3.5, -2.25, -0.75, 1.0, 3.0])
"""Where the logarithm of the density bends: closer together where contacts are many."""

MINES_PER_KM2: Final = 30.0
"""Median of the prior of mines that lie in a mission's area."""
MINES_SPREAD: Final = 2.0
"""Standard deviation of the prior's logarithm: 0.5 to 1600 mines per km² with 95 %, as mines are rare at sea and many
on a test range.
"""
_MINES_STEPS: Final[Array] = np.linspace(-2.5, 2.5, 11, dtype=np.float64)  # standard deviations

_CONFIDENCE_SIGMAS: Final = 1.959964  # of the central 95 %
_MAX_STEPS: Final = 60  # of Newton's method; a guard, it settles in a few
_MAX_HALVINGS: Final = 30  # of one step: 1e-9 of it is left, below _SETTLED_NATS
_SETTLED_NATS: Final = 1e-7  # nats of the density's logarithm: far below its error
_HIGHEST_LOG_DENSITY: Final = 30.0  # keeps a step too far from overflowing
_FILE: Final = "background.json"
_MIN_VARIANCE: Final = 1e-3  # of a recalibrated prior along any axis: knots that fall between the same two go together

_Nats = Annotated[float, msgspec.Meta(ge=-100.0, le=100.0)]


class BackgroundPrior(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Hold what missions with known truth show of the background and of mines.

    mean, covariance: of the logarithm of the density, contacts per km² and nat, at KNOTS_NATS, from mission to mission.
    mine_mean_nats, mine_sd_nats: of the log-odds of contacts on mines.
    """

    mean: tuple[_Nats, ...]
    covariance: tuple[tuple[_Nats, ...], ...]
    mine_mean_nats: _Nats
    mine_sd_nats: Annotated[float, msgspec.Meta(ge=0.1, le=100.0)]

    def __post_init__(self) -> None:
        n_knots = len(KNOTS_NATS)
        if len(self.mean) != n_knots or [len(row) for row in self.covariance] != [n_knots] * n_knots:
            raise ValueError(f"a mean and a covariance at {n_knots} log-odds are needed")
        covariance = np.array(self.covariance)
        if not np.allclose(covariance, covariance.T) or not (np.linalg.eigvalsh(covariance) > 0.0).all():
            raise ValueError("the covariance is not symmetric and positive")

    def recalibrated(self, slope: float, offset_nats: float, background_nats: float) -> BackgroundPrior:
        """Compute the prior of log-odds that became offset + slope * log-odds, of a density exp(background) as great.

        Between knots the logarithm of the density stays linear, so that what moves past a knot is rounded there.
        """
        weights = interpolation((KNOTS_NATS - offset_nats) / slope)
        mean = weights @ np.array(self.mean) - math.log(slope) + background_nats
        values, axes = np.linalg.eigh(weights @ np.array(self.covariance) @ weights.T)
        covariance = (axes * np.maximum(values, _MIN_VARIANCE)) @ axes.T
        return BackgroundPrior(
            mean=tuple(mean.tolist()),
            covariance=tuple(map(tuple, (0.5 * (covariance + covariance.T)).tolist())),
            mine_mean_nats=offset_nats + slope * self.mine_mean_nats,
            mine_sd_nats=slope * self.mine_sd_nats,
        )


class ReachedPoint(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Compare the false alarms requested with those reached on missions with known truth.

    n_asked: false alarms that asked_per_km2 makes on the area; n_reached: those there were. n_called: targets called,
    of n_targets.
    """

    asked_per_km2: float
    n_asked: float
    n_reached: int
    n_called: int
    n_targets: int


class LeftOutScene(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Hold the prior that the other scenes give, and what it reaches on this one."""

    scene: str
    prior: BackgroundPrior
    reached: tuple[ReachedPoint, ...]


class BackgroundModel(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Hold a prior for the odds of either detector, and what the priors were fitted on.

    And what the cascade's reaches on scenes left out.
    """

    fitted_on: str
    cascade: BackgroundPrior
    contrast: BackgroundPrior
    left_out: tuple[LeftOutScene, ...] = ()

    def prior(self, detector: Detector) -> BackgroundPrior:
        """Choose the prior for the odds of a detector."""
        return self.cascade if detector == "cascade" else self.contrast


class FalseAlarms(NamedTuple):
    """State a density, per km², with its 95 % interval."""

    per_km2: float
    low: float
    high: float


class Background(NamedTuple):
    """Hold how densely non-mines lie that reach each of LEVELS_NATS, as logarithms of contacts per km², (N_BINS,) each.

    middle: the middle of the estimate; low, high: its 95 % interval. All fall from level to level. mines_per_km2:
    middle of what is believed of mines.
    """

    middle: Array
    low: Array
    high: Array
    mines_per_km2: float

    def false_alarms(self, log_odds: float) -> FalseAlarms:
        """Read the density of non-mines with these log-odds of a mine or more.

        Below the lowest level it is that of the lowest.
        """
        middle, low, high = (
            math.exp(float(np.interp(log_odds, LEVELS_NATS, part))) for part in (self.middle, self.low, self.high)
        )
        return FalseAlarms(middle, low, high)

    def level_nats(self, per_km2: float) -> float:
        """Find the lowest log-odds that no more than so many non-mines reach.

        -inf where all do, inf where more reach every level.
        """
        asked = math.log(per_km2)
        if asked >= self.middle[0]:
            return -math.inf
        if asked < self.middle[-1]:
            return math.inf
        return float(np.interp(-asked, -self.middle, LEVELS_NATS))


def counted_log_odds(log_odds: ArrayLike) -> Array:
    """Count log-odds per bin, (N_BINS,); those below the lowest level are left out."""
    values = np.asarray(log_odds, dtype=np.float64)
    numbers = np.minimum(np.floor((values[values >= LOWEST_NATS] - LOWEST_NATS) / BIN_NATS), N_BINS - 1)
    return np.bincount(numbers.astype(np.int64), minlength=N_BINS).astype(np.float64)


def estimate_background(
    counts: ArrayLike, area_km2: float, prior: BackgroundPrior, *, reported_from_nats: float = LOWEST_NATS
) -> Background:
    """Estimate the background of a mission from its contacts, mines among them.

    Parameters
    ----------
    counts
        (N_BINS,) contacts per bin of log-odds, as `counted_log_odds` gives them.
    area_km2
        Searched for them, overlap counted once.
    reported_from_nats
        The lowest log-odds reported; lower bins carry no information.

    Raises
    ------
    ValueError
        For counts or an area that cannot be.
    """
    n, observed_km2 = _observed(counts, area_km2, reported_from_nats)
    log_mines = math.log(MINES_PER_KM2) + MINES_SPREAD * _MINES_STEPS
    mines = np.exp(log_mines)[:, np.newaxis] * _mine_shares(prior)
    values, covariance, evidence = _modes(n, observed_km2, mines, prior)
    log_weight = evidence - 0.5 * _MINES_STEPS**2
    weight = np.exp(log_weight - log_weight.max())
    weight /= weight.sum()
    middles, spreads = zip(*(_log_survival(*mode) for mode in zip(values, covariance, strict=True)), strict=True)
    middle = weight @ np.array(middles)
    spread = np.sqrt(weight @ (np.array(spreads) ** 2 + (np.array(middles) - middle) ** 2))
    # As what reaches a level reaches all lower ones, a bound there is one here.
    low = np.maximum.accumulate((middle - _CONFIDENCE_SIGMAS * spread)[::-1])[::-1]
    high = np.minimum.accumulate(middle + _CONFIDENCE_SIGMAS * spread)
    return Background(middle, low, high, math.exp(float(weight @ log_mines)))


def known_background(
    counts: ArrayLike, area_km2: float, prior: BackgroundPrior, *, reported_from_nats: float = LOWEST_NATS
) -> tuple[Array, Array]:
    """Estimate the background from contacts that are known not to be mines.

    (n_knots,) log-densities and their covariance. reported_from_nats: as in `estimate_background`.
    """
    n, observed_km2 = _observed(counts, area_km2, reported_from_nats)
    values, covariance, _ = _modes(n, observed_km2, np.zeros((1, N_BINS)), prior)
    return values[0], covariance[0]


def expected_background(prior: BackgroundPrior) -> tuple[Array, Array]:
    """Compute what training expects.

    The logarithm of the density that reaches each level, and its standard deviation, (N_BINS,).
    """
    return _log_survival(np.array(prior.mean), np.array(prior.covariance))


def configured_background(name: str, detector: Detector) -> BackgroundPrior | None:
    """Read the prior that `contacts.background` names, None for `none`. Raises BadInputError if it cannot be read."""
    if name == NONE:
        return None
    return read_model("contacts.background", name, parse_background, shipped_background, f", or '{NONE}'").prior(
        detector
    )


def shipped_background() -> BackgroundModel:
    """Read the model that ships with the package."""
    return parse_background(resources.files("auv_mcm.contacts").joinpath(_FILE).read_bytes(), _FILE)


def parse_background(data: bytes, place: str) -> BackgroundModel:
    """Read a model from JSON. Raises BadInputError naming `place` and what is wrong with it."""
    try:
        return msgspec.json.decode(data, type=BackgroundModel)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise BadInputError(f"{place}: {error}. Write the file again with 'auv-mcm calibrate background'") from error


def interpolation(log_odds: Array) -> Array:
    """Weigh the knots, (n, n_knots), so that weights @ values is linear between the knots.

    It goes on so beyond the last one.
    """
    last = np.clip(np.searchsorted(KNOTS_NATS, log_odds, side="right") - 1, 0, len(KNOTS_NATS) - 2)
    share = (log_odds - KNOTS_NATS[last]) / (KNOTS_NATS[last + 1] - KNOTS_NATS[last])
    weights = np.zeros((len(log_odds), len(KNOTS_NATS)))
    rows = np.arange(len(log_odds))
    weights[rows, last] = 1.0 - share
    weights[rows, last + 1] = share
    return weights


_WEIGHTS: Final[Array] = interpolation(LEVELS_NATS + 0.5 * BIN_NATS)


def _observed(counts: ArrayLike, area_km2: float, reported_from_nats: float) -> tuple[Array, Array]:
    """Check counts and area; return both per bin, zero where nothing is reported."""
    n = np.asarray(counts, dtype=np.float64)
    if n.shape != (N_BINS,) or not (np.isfinite(n).all() and (n >= 0.0).all()):
        raise ValueError(f"counts must be {N_BINS} numbers of contacts, got shape {n.shape}")
    if not (math.isfinite(area_km2) and area_km2 >= 0.0):
        raise ValueError(f"the area searched must be finite and not negative, got {area_km2} km²")
    # Contacts can be placed where nothing counts as covered, as in a turn: they need some area to have come from.
    area_km2 = max(area_km2, n.any() * _MIN_AREA_KM2)
    is_reported = reported_from_nats - 1e-9 <= LEVELS_NATS
    return np.where(is_reported, n, 0.0), np.where(is_reported, area_km2, 0.0)


_MIN_AREA_KM2: Final = 1e-4  # a hundredth of a hectare: a few pings


def _mine_shares(prior: BackgroundPrior) -> Array:
    """Compute the share of mines' contacts in each bin; what falls below the lowest level is in none."""
    # The standard library's error function: scipy is no package of the payload.
    deviates = (LEVELS_NATS - prior.mine_mean_nats) / (prior.mine_sd_nats * math.sqrt(2.0))
    reached = np.array([0.5 * math.erfc(deviate) for deviate in deviates.tolist()])
    return np.asarray(reached - np.append(reached[1:], 0.0))


def _modes(n: Array, area_km2: Array, mines_per_km2: Array, prior: BackgroundPrior) -> tuple[Array, Array, Array]:
    """Find the background's most probable values at the knots.

    For each of n_modes densities of mines, (n_modes, N_BINS). Returns values (n_modes, n_knots), their covariance
    (n_modes, n_knots, n_knots) and the logarithm of the evidence (n_modes,), but for a constant.
    """
    mean, precision = np.array(prior.mean), np.linalg.inv(np.array(prior.covariance))
    mines = area_km2 * mines_per_km2
    per_density = area_km2 * BIN_NATS

    def posterior(values: Array) -> tuple[Array, Array, Array]:
        background = per_density * np.exp(np.minimum(values @ _WEIGHTS.T, _HIGHEST_LOG_DENSITY))
        total = np.maximum(background + mines, 1e-300)
        off = values - mean
        return (
            (n * np.log(total) - total).sum(axis=1) - 0.5 * np.einsum("ij,jk,ik->i", off, precision, off),
            background,
            total,
        )

    def information(background: Array, total: Array) -> Array:
        return np.asarray(_WEIGHTS.T @ ((background**2 / total)[:, :, np.newaxis] * _WEIGHTS) + precision)

    values = np.repeat(mean[np.newaxis], len(mines_per_km2), axis=0)
    reached, background, total = posterior(values)
    for _ in range(_MAX_STEPS):
        gradient = (background * (n / total - 1.0)) @ _WEIGHTS - (values - mean) @ precision
        step = np.linalg.solve(information(background, total), gradient[:, :, np.newaxis])[:, :, 0]
        for _ in range(_MAX_HALVINGS):
            tried = posterior(values + step)
            worse = tried[0] < reached - 1e-9
            if not worse.any():
                break
            step[worse] *= 0.5
        else:
            tried = posterior(values + step)
        values = values + step
        reached, background, total = tried
        if np.abs(step).max() < _SETTLED_NATS:
            break
    covariance = np.asarray(np.linalg.inv(information(background, total)), dtype=np.float64)
    return values, covariance, np.asarray(reached + 0.5 * np.linalg.slogdet(covariance)[1], dtype=np.float64)


def _log_survival(values: Array, covariance: Array) -> tuple[Array, Array]:
    """Compute the logarithm of the density that reaches each level, (N_BINS,).

    And its standard deviation to first order.
    """
    per_bin = BIN_NATS * np.exp(_WEIGHTS @ values)
    reaching = np.cumsum(per_bin[::-1])[::-1]
    slopes = np.cumsum((per_bin[:, np.newaxis] * _WEIGHTS)[::-1], axis=0)[::-1] / reaching[:, np.newaxis]
    return np.log(reaching), np.sqrt(np.einsum("ij,jk,ik->i", slopes, covariance, slopes))
