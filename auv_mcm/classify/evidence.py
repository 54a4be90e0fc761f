"""Turn the match of shape models with one view into belief masses.

Appriou ("Probabilités et incertitude en fusion de données multi-senseurs", 1991) derives two families of masses from
likelihoods, one statement per class, combined over the classes.

The first, which the source paper uses, states of class i: m({i}) = a R/(1 + R), m(not i) = a/(1 + R), with R its
likelihood over the mean of all. Of two classes that match alike each gets half the belief and next to nothing goes to
"one of these two": ambiguity looks like two sure half truths. And because a weighs evidence against a class as well as
for it, a poor match of implausible size keeps its class possible, and the best match of an impossible size wins by the
evidence against all others.

The second states only m(not i) = a (1 - mu), with mu the likelihood over the best of all. Classes that match alike keep
their mass together, as {sphere, truncated_cone}, which is what was seen. `view_mass` takes it, with plausible size
inside mu.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import msgspec
import numpy as np
from numpy.typing import ArrayLike

from auv_mcm.classify.beliefs import FRAME, MAX_RELIABILITY, N_CLASSES, Array, subset
from auv_mcm.records import NAN, ContactClass

TEMPERATURE: Final = 4.0  # divisor of log-likelihoods: pixels are correlated and models not exact
# relative excess over a class's sizes at which plausibility has fallen to 0; chosen, not measured
_SIZE_MARGIN: Final = 0.3
_CLUTTER: Final = FRAME.index("clutter")


class ClassEvidence(msgspec.Struct, frozen=True, kw_only=True):
    """Hold how one class explains one view, with its best parameters.

    nll: negative log-likelihood in nats, +inf if it cannot explain the view at all. plausibility: of the parameters'
    sizes, in [0, 1], NaN where not known.

    Raises ValueError for numbers outside these ranges.
    """

    nll: float
    plausibility: float = NAN

    def __post_init__(self) -> None:
        if not self.nll > -math.inf:
            raise ValueError(f"nll must be a number or +inf, got {self.nll}; leave out classes that were not tried")
        if not (math.isnan(self.plausibility) or 0.0 <= self.plausibility <= 1.0):
            raise ValueError(f"plausibility must lie in [0, 1] or be NaN, got {self.plausibility}")


def size_plausibility(sizes_m: ArrayLike, min_m: ArrayLike, max_m: ArrayLike) -> Array:
    """Rate sizes (..., n) by a product of trapezoids, (...).

    Each is 1 from min_m to max_m (..., n), falling to 0 at 30 % below or above.

    A size that is NaN was not measured and counts as plausible. Raises ValueError unless 0 < min_m <= max_m.
    """
    size, minimum, maximum = (np.asarray(value, dtype=np.float64) for value in (sizes_m, min_m, max_m))
    if not ((minimum > 0.0) & (minimum <= maximum)).all():
        raise ValueError(f"known sizes must have 0 < min_m <= max_m, got {minimum} and {maximum}")
    beyond = np.maximum(1.0 - size / minimum, size / maximum - 1.0)
    each = np.clip(1.0 - beyond / _SIZE_MARGIN, 0.0, 1.0)
    return np.asarray(np.where(np.isnan(size), 1.0, each).prod(axis=-1))


def view_mass(
    evidence: Mapping[ContactClass, ClassEvidence], quality: float, temperature: float = TEMPERATURE
) -> Array:
    """Compute the (32,) mass of one view from the evidence for the classes tried; a class left out stays possible.

    The match of class i in log units is -nll / temperature + ln plausibility, mu_i its exp over that of the best.
    Clutter is every object except mines: whatever matches a mine's shape of implausible size matches clutter by as much
    as the size is implausible. Then m(not i) = a (1 - mu_i), a = min(quality, 0.95), combined over the classes, which
    contradict each other in nothing: m(A) is the product of 1 - a (1 - mu_i) in A and of a (1 - mu_i) out of it.

    Raises ValueError if quality is not in [0, 1], temperature not positive, or a class not in FRAME.
    """
    reliability = min(_checked_quality(quality), MAX_RELIABILITY)
    excluded = reliability * (1.0 - _memberships(evidence, temperature))
    mass = np.ones(1)
    for share in excluded.tolist():
        mass = np.concatenate((share * mass, (1.0 - share) * mass))
    return mass


def _checked_quality(quality: float) -> float:
    if not 0.0 <= quality <= 1.0:
        raise ValueError(f"quality of a view must lie in [0, 1], got {quality}")
    return quality


def _known(share: float) -> float:
    return 1.0 if math.isnan(share) else share


def _tried(evidence: Mapping[ContactClass, ClassEvidence]) -> list[int]:
    subset(*evidence)
    return [i for i, name in enumerate(FRAME) if name in evidence]


def _log_likelihoods(evidence: Mapping[ContactClass, ClassEvidence], temperature: float) -> Array:
    """Temper log-likelihoods, (5,); 0 for classes not tried.

    The lowest finite number stands for -inf, so that differences are finite.
    """
    if not 0.0 < temperature < math.inf:
        raise ValueError(f"temperature must be positive, got {temperature}")
    worst = float(np.finfo(np.float64).max) / 4.0
    return np.array([-min(max(evidence[n].nll / temperature, -worst), worst) if n in evidence else 0.0 for n in FRAME])


def _memberships(evidence: Mapping[ContactClass, ClassEvidence], temperature: float) -> Array:
    """Compute mu, (5,): 1 for the best of the classes tried and for those not tried."""
    tried = _tried(evidence)
    likelihood = _log_likelihoods(evidence, temperature)
    plausible = np.array([_known(evidence[n].plausibility) if n in evidence else 1.0 for n in FRAME])
    match = likelihood + _log(plausible)
    match[_CLUTTER] = max(match[_CLUTTER], (likelihood + _log(1.0 - plausible))[tried].max(initial=-math.inf))
    best = match[tried].max(initial=-math.inf)
    mu = np.ones(N_CLASSES)
    mu[tried] = np.exp(match[tried] - best) if best > -math.inf else 0.0
    return mu


def _log(share: Array) -> Array:
    return np.log(share, out=np.full_like(share, -np.inf), where=share > 0.0)
