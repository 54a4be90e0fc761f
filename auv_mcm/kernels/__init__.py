"""Run hot loops, each implemented twice: plain C where a compiler was at hand at installation, numpy everywhere.

Both give the same answer bit for bit unless a kernel states otherwise. `AUV_MCM_KERNELS=numpy` in the environment
leaves the C library alone; it is read once, at the first call of any kernel.
"""

from __future__ import annotations

import ctypes
import functools
import os
from pathlib import Path
from typing import Final, Literal, NamedTuple

VERSION: Final = 21  # of the C signatures; a library that reports another one is not called


class Loaded(NamedTuple):
    """Hold the C library, or None and the reason why numpy serves instead."""

    library: ctypes.CDLL | None
    reason: str


def backend() -> Literal["c", "numpy"]:
    """Name the implementation that the kernels run on in this process."""
    return "numpy" if loaded().library is None else "c"


@functools.cache
def loaded() -> Loaded:
    """Load the C library once, from beside this file."""
    return load_library(Path(__file__).parent, "_kernels", VERSION)


def load_library(folder: Path, name: str, version: int) -> Loaded:
    """Load the library `name` in `folder`, if it reports `version` by its function auv_mcm<name>_version."""
    if os.environ.get("AUV_MCM_KERNELS", "") == "numpy":
        return Loaded(None, "AUV_MCM_KERNELS=numpy is set")
    path = folder / f"{name}.abi3.so"
    if not path.is_file():
        return Loaded(None, "not built: install a C compiler and reinstall the package")
    try:
        library = ctypes.CDLL(str(path))
        ask = getattr(library, f"auv_mcm{name}_version")
        ask.argtypes = []
        ask.restype = ctypes.c_int32
        reported = ask()
        if reported != version:
            return Loaded(
                None,
                f"{path.name} is of another version of this package ({reported}, not {version}): reinstall the package",
            )
    except (OSError, AttributeError) as error:
        return Loaded(None, f"{path.name} cannot be loaded ({error}): reinstall the package")
    return Loaded(library, path.name)
