"""Choose thresholds by the false alarms or the Pd that they give, and say how sure a difference is.

Scores are of any kind that rises with what speaks for a mine: p_mine, log-odds, nats of evidence.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim_replay.scoring.intervals import CONFIDENCE, Proportion, proportion
from sim_replay.scoring.score import Score

N_RESAMPLES: Final = 2000  # of missions: bounds of 95 % move by less than 0.01 with more

Floats = NDArray[np.float64]


class Interval(NamedTuple):
    """Hold a value and the interval that holds 95 % of resampled missions."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.value:+.2f} ({self.low:+.2f} to {self.high:+.2f})"


def threshold_at(
    false_alarms: ArrayLike, n_allowed: float, *, n_tries: float = 0.0, nothing: float = -math.inf
) -> float:
    """Find the lowest threshold above which no more false alarms lie than allowed.

    Parameters
    ----------
    false_alarms
        Score of each, (n,).
    n_allowed
        Their number; the part of one that is left over counts only against `n_tries`.
    n_tries
        Hypotheses tried on bare floor, of which exp(-t) exceed t nats by chance and take their part of what is
        allowed; 0 where false alarms were all counted.
    nothing
        Score of what was not found, the lowest there is.
    """
    ordered = np.append(np.sort(np.asarray(false_alarms, dtype=np.float64))[::-1], nothing)
    if n_tries == 0.0:
        return float(ordered[min(math.floor(n_allowed), len(ordered) - 1)])
    found = math.inf
    for n_above in range(min(math.floor(n_allowed), len(ordered) - 1) + 1):
        rest = n_allowed - n_above
        by_chance = math.log(n_tries / rest) if rest > 0.0 else math.inf
        found = min(found, max(float(ordered[n_above]), by_chance))
    return found


def called_at(targets: ArrayLike, others: ArrayLike, share: float, nothing: float = -math.inf) -> Proportion | None:
    """Count the others that are called where this share of the targets is; None if fewer targets were found.

    Parameters
    ----------
    targets, others
        Best score on each, `nothing` for none, (n,) and (m,).
    share
        Of targets, above 0 up to 1.
    nothing
        Score of what was not found.
    """
    ordered = np.sort(np.asarray(targets, dtype=np.float64))[::-1]
    scores = np.asarray(others, dtype=np.float64)
    threshold = ordered[math.ceil(share * len(ordered)) - 1] if len(ordered) else nothing
    return None if threshold <= nothing else proportion(int(np.count_nonzero(scores >= threshold)), len(scores))


def resampled(
    statistic: Callable[[Sequence[int]], float], n_missions: int, *, seed: int, n_resamples: int = N_RESAMPLES
) -> Interval:
    """Bound a statistic of missions by drawing them again with replacement (B. Efron, Annals of Statistics 7, 1979).

    Parameters
    ----------
    statistic
        Of missions by their numbers; for a paired difference both ways of a mission go together.
    n_missions
        Their number, 1 or more.
    seed
        Of the draws, fixed so that reports repeat.
    n_resamples
        Number of draws.
    """
    random = np.random.Generator(np.random.PCG64(seed))
    drawn = random.integers(0, n_missions, (n_resamples, n_missions))
    tail = 0.5 * (1.0 - CONFIDENCE)
    low, high = np.quantile([statistic(row) for row in drawn.tolist()], (tail, 1.0 - tail)).tolist()
    return Interval(statistic(range(n_missions)), low, high)


def pd_at(score: Score, limit_per_km2: float, *, on_clutter: bool = True) -> Proportion:
    """Find the best Pd with at most so many false alarms per km².

    Parameters
    ----------
    score
        Of missions.
    limit_per_km2
        False alarms per km².
    on_clutter
        Whether those on known clutter count.
    """
    if score.area_km2 <= 0.0:
        return proportion(0, score.n_targets)
    allowed = [
        point.pd
        for point in score.froc
        if point.false_alarms.count - (0 if on_clutter else point.on_known_clutter) <= limit_per_km2 * score.area_km2
    ]
    return max(allowed, key=lambda pd: pd.count, default=proportion(0, score.n_targets))
