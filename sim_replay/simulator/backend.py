"""Load the simulator's C library, or report why numpy does its work."""

from __future__ import annotations

import ctypes
import functools
from pathlib import Path
from typing import Any, Final

from auv_mcm.kernels import Loaded, load_library
from auv_mcm.kernels.signatures import call_in

_SIGNATURES: Final = {
    "render_lines": "i i i d d i i i i4 f4 f4 u1 f8 i f8 f8 f4 f4 a a a a? a?",
    "speckle_rows": "i i f8 u8 i f4 f4 i a",
}
VERSION: Final = 2  # of the C signatures; a library that reports another one is not called


@functools.cache
def simulator_library() -> Loaded:
    """Return the library, searched for once beside this file."""
    return load_library(Path(__file__).parent, "_simulator", VERSION)


def library() -> ctypes.CDLL | None:
    """Return the library, or None if numpy serves instead."""
    return simulator_library().library


def call(name: str, *arguments: Any) -> bool:
    """Call a C function; returns whether there is one: where there is none, numpy serves."""
    return call_in(library(), name, _SIGNATURES[name], *arguments)
