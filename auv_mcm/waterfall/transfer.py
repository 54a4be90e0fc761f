"""Convert recorded numbers, amplitude, intensity or a logarithm, to intensity.

Where it is not stated which of them they are, `law` weighs and `law_watch` decides.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from auv_mcm.records import Transfer

_MAX_AMPLITUDE: Final = np.float64(1e19)  # in double precision, so that half-precision samples compare too
_MAX_INTENSITY: Final = np.float64(1e38)


def to_intensity(samples: NDArray[Any], transfer: Transfer) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Convert recorded samples to linear intensity (n_samples,) float32 and its validity (n_samples,) bool.

    Non-finite samples, absurdly large ones, and negative ones unless logarithmic, are invalid and zero in the result.
    """
    if samples.dtype.kind == "f":
        # Numbers beyond what float32 holds, once squared if need be, were never measured.
        valid = np.abs(samples) <= (_MAX_AMPLITUDE if transfer.kind == "amplitude" else _MAX_INTENSITY)
    else:
        valid = np.ones(samples.shape, dtype=np.bool_)
    if samples.dtype.kind != "u" and transfer.kind != "log":
        valid &= samples >= 0
    counts = (samples if valid.all() else np.where(valid, samples, 0)).astype(np.float32)
    if transfer.kind == "amplitude":
        np.multiply(counts, counts, out=counts)
    elif transfer.kind == "log":
        # Referred to 100 dB, where 8-bit recorders have their sea floor, and bounded to what float32 holds.
        exponent = np.clip(counts * np.float32(transfer.db_per_count / 10.0) - np.float32(10.0), -30.0, 30.0)
        np.power(np.float32(10.0), exponent, out=counts)
        if not valid.all():
            counts[~valid] = 0.0
    return counts, valid
