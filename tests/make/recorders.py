"""Recorders that store one mission's intensity in their own ways."""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray


class Store(NamedTuple):
    """How a recorder stores intensity: as counts, factor * intensity ** exponent, or as a logarithm.

    db_per_count is None unless it stores logarithms; factor then is the count of intensity 1.
    """

    name: str
    bits: int
    factor: float
    exponent: float = math.nan
    db_per_count: float | None = None


STORES: Final = (
    Store("amplitude, 16 bits", 16, 3000.0, 0.5),
    Store("amplitude, 8 bits", 8, 35.0, 0.5),
    Store("intensity", 16, 1000.0, 1.0),
    Store("amplitude^0.7", 16, 1000.0, 0.35),
    Store("log of 0.2 dB", 8, 150.0, db_per_count=0.2),
    Store("log of 0.35 dB", 8, 140.0, db_per_count=0.35),
    Store("log of 0.5 dB", 8, 120.0, db_per_count=0.5),
)


def stored(intensity: NDArray[np.float64], store: Store) -> NDArray[Any]:
    """Intensity (..., n_samples) as counts."""
    if store.db_per_count is None:
        counts = store.factor * intensity**store.exponent
    else:
        counts = store.factor + 10.0 * np.log10(np.maximum(intensity, 1e-30)) / store.db_per_count
    whole = np.rint(np.clip(counts, 0.0, float(2**store.bits - 1)))
    return np.asarray(whole, dtype=np.uint8 if store.bits == 8 else np.uint16)
