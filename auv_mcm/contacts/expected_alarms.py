"""Expect false alarms by the contacts' own odds, and find the p_mine from which a mission's contacts are called.

A contact of a calibrated p_mine is no mine with probability 1 - p_mine, wherever it lies. So the expected false alarms
among contacts that reach a level are the sum of 1 - p_mine over them. A floor rich in mines, a test range or a harbour,
does not make them look like background, and a short line needs no background of its own. What is expected is known as
a Poisson count of that size is: doubt serves the mine, and a contact is called while the lower end of the interval
stays within what the operator accepts.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from auv_mcm.classify.beliefs import MINE_LIKE_P
from auv_mcm.contacts.background import LOWEST_NATS, MIN_AREA_KM2
from auv_mcm.contacts.geojson import PROBABILITY_DIGITS
from auv_mcm.detect.belief import odds_of

# nats: the lowest log-odds of a p_mine that files write as 0.2
MINE_LIKE_NATS: Final = odds_of(MINE_LIKE_P - 0.5 * 10.0**-PROBABILITY_DIGITS)
_SIGMAS_95: Final = 1.959964  # standard deviations of the ends of the central 95 %
_ON_BARE_FLOOR: Final = 0.5  # of the false alarms called: 139 of 307 per km² on ten named scenes


class FalseAlarms(NamedTuple):
    """State a density, per km², with its 95 % interval."""

    per_km2: float
    low: float
    high: float


class ExpectedAlarms(NamedTuple):
    """Hold the false alarms that a mission's contacts make expect.

    nats: log-odds of the contacts counted, rising, (n,). expected: false alarms among the likeliest 0 to n, (n + 1,).
    """

    nats: NDArray[np.float64]
    expected: NDArray[np.float64]
    area_km2: float

    def reaching(self, log_odds: float) -> FalseAlarms:
        """Expect the density of non-mines among the contacts that have these log-odds or more."""
        n = len(self.nats) - int(np.searchsorted(self.nats, log_odds))
        ends = (poisson_end(self.expected[n], sigmas) for sigmas in (-_SIGMAS_95, _SIGMAS_95))
        return FalseAlarms(*(float(count) / self.area_km2 for count in (self.expected[n], *ends)))


def expected_alarms(log_odds: ArrayLike, area_km2: float) -> ExpectedAlarms:
    """Expect false alarms on an area from contacts of these log-odds (n,)."""
    nats = np.sort(_counted(log_odds))
    expected = np.append(0.0, np.cumsum(_no_mine(nats[::-1])))
    return ExpectedAlarms(nats, expected, max(area_km2, MIN_AREA_KM2))


def called_from_nats(log_odds: ArrayLike, area_km2: float, asked_per_km2: float) -> float:
    """Find the lowest log-odds called.

    Contacts are taken from the likeliest down, as long as the lower end of the 95 % interval of the false alarms
    expected among them on bare floor stays within asked_per_km2 on area_km2. Where the area is too small for the rate
    asked, one false alarm is allowed, and p_mine has to reach 0.2.
    """
    nats = np.sort(_counted(log_odds))[::-1]
    lower_end = _ON_BARE_FLOOR * poisson_end(np.cumsum(_no_mine(nats)), -_SIGMAS_95)
    n_called = int(np.count_nonzero(lower_end <= max(asked_per_km2 * area_km2, 1.0)))
    # Half way to the first that is not called, so that nothing hangs on the last bit of either.
    level = LOWEST_NATS if n_called == len(nats) else float(0.5 * (nats[n_called - 1] + nats[n_called]))
    return max(level, MINE_LIKE_NATS) if is_short(area_km2, asked_per_km2) else level


def poisson_end(expected: ArrayLike, sigmas: float) -> NDArray[np.float64]:
    """Bound a Poisson count by its expectation, (n,): the lower end for negative sigmas.

    The quantile of a Gamma distribution of that shape, by E. B. Wilson and M. M. Hilferty, "The distribution of
    chi-square", PNAS 17, 1931; for upper ends of one count more (F. Garwood, Biometrika 28, 1936).
    """
    shape = np.asarray(expected, dtype=np.float64) + (1.0 if sigmas > 0.0 else 0.0)
    shape = np.maximum(shape, 1e-9)
    root = np.maximum(1.0 - 1.0 / (9.0 * shape) + sigmas / (3.0 * np.sqrt(shape)), 0.0)
    return np.asarray(shape * root**3)


def _counted(log_odds: ArrayLike) -> NDArray[np.float64]:
    values = np.asarray(log_odds, dtype=np.float64)
    return values[values >= LOWEST_NATS]


def _no_mine(nats: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute 1 - p_mine."""
    return 1.0 / (1.0 + np.exp(nats))


def is_short(area_km2: float, asked_per_km2: float) -> bool:
    """Check whether an area is too small for the rate asked: it allows fewer than one false alarm."""
    return asked_per_km2 * area_km2 < 1.0
