"""Find out what the samples of a log are where its header leaves it open: signed numbers, both sides in one trace."""

from __future__ import annotations

from typing import Any, Final, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from sim_replay.logs.port_order import DECISIVE, port_order_evidence

SampleType: TypeAlias = Literal["uint8", "uint16", "float32"]

_SIGNED_OF: Final = {"u1": np.int8, "u2": np.int16, "u4": np.int32}
_WIDER: Final = 2  # an 8-bit magnitude of -128 needs 9 bits, and so on
# Read as unsigned, numbers about zero lie at both ends of the range. Their spread as signed numbers is then a small
# part of that as unsigned ones, and about half of those that are not zero are negative. Chosen.
_SPREAD, _SPREAD_UNFLAGGED = 0.75, 0.35  # of the spread as unsigned numbers: where the header says signed, and not
_NEGATIVE, _NEGATIVE_UNFLAGGED = 0.2, 0.35  # share of negative numbers, minimum and 1 - maximum


def are_signed(samples: NDArray[Any], says_signed: bool) -> bool:
    """Check whether stored samples are signed numbers about zero.

    Parameters
    ----------
    samples
        Of some pings, any shape, as the header declares them.
    says_signed
        Whether the header says so; without it, the samples have to show it more clearly.
    """
    if not samples.size:
        return False
    kind = samples.dtype.str[1:]
    if samples.dtype.kind == "f":
        used = samples[np.isfinite(samples) & (samples != 0.0)]
        spread = 0.0
    elif kind in _SIGNED_OF:
        used = samples.view(samples.dtype.newbyteorder("=").str.replace("u", "i"))
        whole = float(np.std(samples, dtype=np.float64))
        spread = float(np.std(used, dtype=np.float64)) / whole if whole > 0.0 else 1.0
        used = used[used != 0]
    else:
        return False
    if not used.size or spread > (_SPREAD if says_signed else _SPREAD_UNFLAGGED):
        return False
    below, above = used[used < 0], used[used > 0]
    if below.size and np.mean(below == -1) > _MOST + (np.mean(above == 1) if above.size else 0.0):
        return False  # the highest number that is stored: saturated, not negative
    negative = float(np.mean(used < 0))
    margin = _NEGATIVE if says_signed else _NEGATIVE_UNFLAGGED
    return margin < negative < 1.0 - margin


def magnitude(samples: NDArray[Any]) -> NDArray[Any]:
    """Return the magnitude of signed samples, in the type that the header declares."""
    if samples.dtype.kind == "f":
        return np.asarray(np.abs(samples))
    width = samples.dtype.itemsize
    signed = samples.view(f"<i{width}" if width > 1 else "i1")
    wide = signed.astype(f"i{min(8, _WIDER * width)}")
    return np.asarray(np.abs(wide).astype(samples.dtype))


def halves(samples: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return both sides of a trace that holds port from far to near, then starboard from near to far.

    samples: (n,) or (n_pings, n). Of an odd number the middle one is left out.
    """
    n_side = samples.shape[-1] // 2
    return samples[..., :n_side], samples[..., -n_side:]


def hold_both_sides(samples: NDArray[Any], range_m: float, blank_m: float) -> bool:
    """Check whether traces hold both sides: water column and ring-down are in the middle, seen from either half.

    Parameters
    ----------
    samples
        (n_pings, n_samples) as stored.
    range_m
        Slant range of a side.
    blank_m
        Slant range of ring-down.
    """
    if samples.shape[1] < _MIN_SAMPLES:
        return False
    left, right = halves(np.nan_to_num(samples))
    spacing_m = range_m / left.shape[1]
    near_in_left = port_order_evidence(left, None, spacing_m, blank_m).total
    near_in_right = -port_order_evidence(right, None, spacing_m, blank_m).total
    at_an_end = abs(port_order_evidence(np.nan_to_num(samples), None, 0.5 * spacing_m, blank_m).total)
    return (
        min(near_in_left, near_in_right) >= DECISIVE and near_in_left + near_in_right - 2.0 * at_an_end >= _BOTH_SIDES
    )


_MOST: Final = 0.25  # more of the negative numbers that are -1 than of the positive ones that are 1 (chosen)
_MIN_SAMPLES: Final = 64  # of both sides together; fewer show no water column (chosen)
_BOTH_SIDES: Final = 3.0 * DECISIVE
"""Evidence of both halves over that of an end of the whole: 1.0 to 3.4 where three recordings, joined, show a water
column, 0.4 at most for their sides alone, over a reef."""
