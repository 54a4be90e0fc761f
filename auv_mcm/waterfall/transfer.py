"""Convert recorded numbers, a power of the echo or a logarithm of it, to intensity.

Where it is not stated which of them they are, `sample_law` decides and `law_watch` keeps checking.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from auv_mcm.records import Transfer

_MAX_INTENSITY: Final = 1e38  # the decade below the end of float32


def to_intensity(samples: NDArray[Any], transfer: Transfer) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Convert recorded samples to linear intensity (n_samples,) float32 and its validity (n_samples,) bool.

    Non-finite samples, absurdly large ones, and negative ones unless logarithmic, are invalid and zero in the result.
    """
    if samples.dtype.kind == "f":
        # Numbers beyond what float32 holds, once raised to their power, were never measured.
        power = 1.0 if transfer.kind == "log" else transfer.intensity_power
        # In double precision, so that half-precision samples compare too.
        valid = np.abs(samples) <= np.float64(_MAX_INTENSITY ** min(1.0 / power, 1.0))
    else:
        valid = np.ones(samples.shape, dtype=np.bool_)
    if samples.dtype.kind != "u" and transfer.kind != "log":
        valid &= samples >= 0
    counts = (samples if valid.all() else np.where(valid, samples, 0)).astype(np.float32)
    if transfer.kind == "log":
        # Referred to 100 dB, where 8-bit recorders have their sea floor, and bounded to what float32 holds.
        exponent = np.clip(counts * np.float32(transfer.db_per_count / 10.0) - np.float32(10.0), -30.0, 30.0)
        np.power(np.float32(10.0), exponent, out=counts)
        if not valid.all():
            counts[~valid] = 0.0
    elif transfer.intensity_power == 2.0:
        np.multiply(counts, counts, out=counts)
    elif transfer.intensity_power != 1.0:
        np.power(counts, np.float32(transfer.intensity_power), out=counts)
    return counts, valid
