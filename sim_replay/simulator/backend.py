"""Load the simulator's C library, or report why numpy does its work."""

from __future__ import annotations

import ctypes
import functools
from pathlib import Path
from typing import Final

from auv_mcm.kernels import Loaded, load_library

VERSION: Final = 2  # of the C signatures; a library that reports another one is not called


@functools.cache
def simulator_library() -> Loaded:
    """Return the library, searched for once beside this file."""
    return load_library(Path(__file__).parent, "_simulator", VERSION, _declare)


def library() -> ctypes.CDLL | None:
    """Return the library, or None if numpy serves instead."""
    return simulator_library().library


def _declare(library: ctypes.CDLL) -> None:
    pointer, integer, real = ctypes.c_void_p, ctypes.c_int64, ctypes.c_double
    library.auv_mcm_render_lines.argtypes = (
        [integer] * 3 + [real] * 2 + [integer] * 3 + [pointer] * 5 + [integer] + [pointer] * 9
    )
    library.auv_mcm_render_lines.restype = None
    library.auv_mcm_speckle_rows.argtypes = [
        integer,
        integer,
        pointer,
        pointer,
        integer,
        pointer,
        pointer,
        integer,
        pointer,
    ]
    library.auv_mcm_speckle_rows.restype = None
