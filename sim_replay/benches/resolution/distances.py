"""Bound what any observer can distinguish in two pictures of known mean, whatever it does.

A pixel of L looks with mean m follows a Gamma distribution of shape L. Between two such pictures, with independent
pixels of means m and n, the Bhattacharyya distance is

    B = sum of L ln((m + n) / (2 sqrt(m n))),

and the likelihood ratio, which no other statistic beats, mistakes one for the other in at most exp(-B) / 2 of the cases
if both are as likely beforehand (T. Kailath, IEEE Trans. Commun. Tech. 15, 1967). Against something that is tried at
many places, of which only a share exp(-t) may pass by chance, at most exp(t / 2 - B) are missed (Chernoff's bound at
one half). So a distance is a guarantee, and distances of further pictures add up.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

ERRORS: Final = 0.05
"""Share of cases in which objects that are distinguished may be confused."""
DISTINCT_NATS: Final = math.log(0.5 / ERRORS)
"""Distance from which two objects are distinguished, nats."""
CHANCE_NATS: Final = math.log(6e9 / 100.0)
"""Threshold of a likelihood ratio, nats, for 100 false alarms per km² among 6 billion places, kinds and directions
tried, as `bench limit` has them."""
FOUND_NATS: Final = 0.5 * CHANCE_NATS + math.log(1.0 / ERRORS)
"""Distance from bare floor from which an object is found, nats."""


def distance_nats(means: ArrayLike, others: ArrayLike, looks: float = 1.0) -> Floats:
    """Compute the Bhattacharyya distance of pictures, (..., rows, columns) of mean intensity above 0, (...) nats."""
    one, other = np.asarray(means, dtype=np.float64), np.asarray(others, dtype=np.float64)
    terms = np.log(0.5 * (one + other)) - 0.5 * (np.log(one) + np.log(other))
    return looks * np.asarray(terms.sum(axis=(-2, -1)))


def coarser(means: ArrayLike, n: int) -> Floats:
    """Average pictures, (..., rows, columns), over squares of n by n pixels; what is left over at the end is cut off.

    The mean intensity of a resolution cell is that of what lies in it.
    """
    fine = np.asarray(means, dtype=np.float64)
    rows, columns = fine.shape[-2] // n, fine.shape[-1] // n
    cut = fine[..., : rows * n, : columns * n]
    return np.asarray(cut.reshape(*fine.shape[:-2], rows, n, columns, n).mean(axis=(-3, -1)))
