"""Hold how densely non-mines lie that look as mine-like as a contact or more.

Contacts per bin of log-odds that are no mines are Poisson counts of area times density. The logarithm of the density is
linear between knots, with a normal prior over its values there: its mean and covariance are those of missions whose
truth is known. A mission's own density has Laplace's approximation (L. Tierney and J. Kadane, JASA 81, 1986) about its
mode, found by Fisher scoring.
"""

from __future__ import annotations

import math
from importlib import resources
from typing import Annotated, Final, TypeAlias

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

MIN_AREA_KM2: Final = 1e-4
"""Of a few pings, which contacts count as come from: they can be placed where nothing is covered, as in a turn."""

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


def counted_log_odds(log_odds: ArrayLike) -> Array:
    """Count log-odds per bin, (N_BINS,); those below the lowest level are left out."""
    values = np.asarray(log_odds, dtype=np.float64)
    numbers = np.minimum(np.floor((values[values >= LOWEST_NATS] - LOWEST_NATS) / BIN_NATS), N_BINS - 1)
    return np.bincount(numbers.astype(np.int64), minlength=N_BINS).astype(np.float64)


def known_background(
    counts: ArrayLike, area_km2: float, prior: BackgroundPrior, *, reported_from_nats: float = LOWEST_NATS
) -> tuple[Array, Array]:
    """Estimate the background of a mission from contacts that are known not to be mines.

    Returns log-densities at the knots, (n_knots,), and their covariance.

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
    mean, precision = np.array(prior.mean), np.linalg.inv(np.array(prior.covariance))
    per_density = observed_km2 * BIN_NATS

    def posterior(values: Array) -> tuple[float, Array]:
        log_density = np.minimum(_WEIGHTS @ values, _HIGHEST_LOG_DENSITY)
        expected = per_density * np.exp(log_density)
        off = values - mean
        return float(n @ log_density - expected.sum() - 0.5 * off @ precision @ off), expected

    values = mean
    reached, expected = posterior(values)
    for _ in range(_MAX_STEPS):
        information = _WEIGHTS.T @ (expected[:, np.newaxis] * _WEIGHTS) + precision
        step = np.linalg.solve(information, _WEIGHTS.T @ (n - expected) - precision @ (values - mean))
        for _ in range(_MAX_HALVINGS):
            if posterior(values + step)[0] >= reached - 1e-9:
                break
            step = 0.5 * step
        values = values + step
        reached, expected = posterior(values)
        if np.abs(step).max() < _SETTLED_NATS:
            break
    covariance = np.linalg.inv(_WEIGHTS.T @ (expected[:, np.newaxis] * _WEIGHTS) + precision)
    return values, np.asarray(covariance, dtype=np.float64)


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
    area_km2 = max(area_km2, n.any() * MIN_AREA_KM2)
    is_reported = reported_from_nats - 1e-9 <= LEVELS_NATS
    return np.where(is_reported, n, 0.0), np.where(is_reported, area_km2, 0.0)


def _log_survival(values: Array, covariance: Array) -> tuple[Array, Array]:
    """Compute the logarithm of the density that reaches each level, (N_BINS,).

    And its standard deviation to first order.
    """
    per_bin = BIN_NATS * np.exp(_WEIGHTS @ values)
    reaching = np.cumsum(per_bin[::-1])[::-1]
    slopes = np.cumsum((per_bin[:, np.newaxis] * _WEIGHTS)[::-1], axis=0)[::-1] / reaching[:, np.newaxis]
    return np.log(reaching), np.sqrt(np.einsum("ij,jk,ik->i", slopes, covariance, slopes))
