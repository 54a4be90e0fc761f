"""Declare the C functions, a line each, and call them with numbers and arrays.

A number is `i` int64, `w` int32, `u` uint32, `f` float32 or `d` float64. An array that is read is named by its type, as
numpy writes it, and converted and laid out row by row where it is not yet. With `?` it may be None. `a` is an array of
any type, contiguous, that C may write to.
"""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from auv_mcm import kernels

SIGNATURES: Final = {
    "cascade_counts": "i i i i i u b1 a",
    "cascade_encode": "i f4 u1 a a",
    "cascade_open": "i i i i u4 u4 b1 i i4 i4 i4 i a i a i a a a a a",
    "cascade_rank": "i i4 i a a a",
    "cascade_run": "u4 i i a i i a i a a a a",
    "cascade_sums": "i i i i i u u2 a",
    "cell_sums": "i i f8 b1 i i8 f8 i i8 f8 a a a",
    "contrast_background": "i i f4 u1 w w f i4 i4 d d i i a a a a a a",
    "contrast_before": "i i i i i4 f4 i a",
    "contrast_bright": "i i i i f8 i4 f4 b1 i i4 f8 i i i i a a a a a",
    "contrast_dark": "i i i i f8 i4 f4 i i8 f8 f8 f d d d f8 i i i i a a a a a a",
    "contrast_extremes": "i i f4 i i a a a a",
    "contrast_means": "i i f8 i4 i i4 i4 a a",
    "contrast_peaks": "i i i i f4 i i a a",
    "contrast_ratios": "i i f8 i4 f4 i i4 f i a a a",
    "contrast_sums": "i i f4 u1 w f a a",
    "contrast_variances": "i i i i f4 b1 i i f d a a a",
    "field_means": "i i i i f8 f8 f8 f8 i8 i f8 f8 a a a a",
    "icm": "i i i f8 f8 a a",
    "interference": "i i f8 d d a a a",
    "mean_field": "i i f8 f8 i a a a",
    "pair_costs": "i i u1 i8 i f8 a a a a",
    "ping_windows": "i i i i8 i8 i i8 d a a a a a a a a a a",
    "shape_costs": "i i f8 i i f8 f8 f8 i f8 f8 i a a",
    "shape_intervals": "i i f8 i i f8 i f8 a",
    "shape_search": "i i i f8 f8 i i f8 f8 f8 i f8 f8 i f8 a i i f8 i i f8 a a a",
    "smear": "i i f8 i f8 i f8 a a a",
    "snake": "i i f8 f8 i f8 a a a a a a",
    "snake_descend": "i i f8 f8 i8 f8 d a a a a a a a",
    "snake_elsewhere": "i i f8 i i8 i8 f8 i8 a a a a a",
    "snake_sides": "i i i f8 a",
    "soft_edges": "i i i i i d f8 f8 a f8 f8 f8 a a a a",
    "speckle_lags": "i f8 b1 i i8 i i8 a a",
    "texture_blocks": "i i i i i i i i i f f4 u1 a a a",
    "texture_cells": "i i i f4 f4 f4 a a a",
    "trws": "i i i d f8 f8 a a a a a",
    "viterbi_forward": "i i i d f8 a a a",
    "waterfall_angle_sums": "i i i f8 i8 f8 b1 f8? d a a a",
    "waterfall_curve": "i f8 i i8 f8 f8 a a",
    "waterfall_floor": "i i b1 d d a a",
    "waterfall_glints": "i i i i f4 b1 d d d a a a a i a a a",
    "waterfall_level": "i i i i d f4 b1 a a a a a i f4? u1? a? a? i i8? a? a?",
    "waterfall_masks": "i i f8 f8 b1 f8 u1 i8 b1 b1 d a",
    "waterfall_means": "i i i f8 f8? f8? i d d f8 i8 a a a a a a",
    "waterfall_medians": "i i f8 b1? i a a",
    "waterfall_pull": "i i f8 d d d d a",
    "waterfall_rows": "i i i i8 f8 f4 u1 d a a a a",
    "waterfall_scale": "i i f8 f8 i8 a",
    "waterfall_steps": "i i f8 b1 i i d d a a a",
    "waterfall_sums": "i i f4 a",
    "waterfall_sums_of_bytes": "i i u1 f4 a",
    "waterfall_sums_of_words": "i i u2 f4 a",
    "waterfall_usable": "i f4 u1 f f a a a",
    "waterfall_votes": "i i f8 d d d a",
}
"""By name, without auv_mcm_."""

_NUMBERS: Final = {
    "i": ctypes.c_int64,
    "w": ctypes.c_int32,
    "u": ctypes.c_uint32,
    "f": ctypes.c_float,
    "d": ctypes.c_double,
}
_memory_of: Final = (ctypes.c_char * 0).from_buffer
"""Gives what C takes for the address of an array it may write to, in a quarter of the time of `ctypes.data`."""


def call(name: str, *arguments: Any) -> bool:
    """Call the C function auv_mcm_<name>; returns whether there is one: where there is none, numpy serves.

    Raises ValueError for an array to write to that is not contiguous.
    """
    return call_in(kernels.loaded().library, name, SIGNATURES[name], *arguments)


def call_in(library: ctypes.CDLL | None, name: str, signature: str, *arguments: Any) -> bool:
    """Call a C function of a library as `call` does those of the kernels.

    Parameters
    ----------
    library
        None where numpy serves.
    name
        Without auv_mcm_.
    signature
        Of the function, as in SIGNATURES.
    """
    if library is None:
        return False
    function, n_arguments, arrays = _declared(library, name, signature)
    if len(arguments) != n_arguments:
        raise ValueError(f"{name} takes {n_arguments} arguments, not {len(arguments)}")
    values = list(arguments)
    for place, dtype in arrays:
        array = values[place]
        if array is None:
            continue
        if not array.flags.carray or (dtype is not None and array.dtype != dtype):  # may be written, row by row
            array = _laid_out(name, array, dtype)
        values[place] = _memory_of(array) if array.flags.writeable else array.ctypes.data_as(ctypes.c_void_p)
    function(*values)
    return True


def _laid_out(name: str, array: NDArray[Any], dtype: np.dtype[Any] | None) -> NDArray[Any]:
    """Give an array row by row and in a type, as it is if it has both."""
    if dtype is not None:
        return np.ascontiguousarray(array, dtype=dtype)
    if not array.flags.c_contiguous:
        raise ValueError(f"{name} writes to arrays that are contiguous, not one of shape {array.shape}")
    return array


@functools.cache
def _declared(
    library: ctypes.CDLL, name: str, signature: str
) -> tuple[Callable[..., None], int, list[tuple[int, np.dtype[Any] | None]]]:
    """Give a C function, the number of its arguments, and the places of arrays among them with their types.

    The type is None for any, in which C may write.
    """
    function: Callable[..., None] = getattr(library, f"auv_mcm_{name}")
    words = signature.split()
    function.argtypes = [_NUMBERS.get(word, ctypes.c_void_p) for word in words]  # type: ignore[attr-defined]
    function.restype = None  # type: ignore[attr-defined]
    return (
        function,
        len(words),
        [
            (place, None if word[0] == "a" else np.dtype(word.rstrip("?")))
            for place, word in enumerate(words)
            if word not in _NUMBERS
        ],
    )
