"""Name the program that runs, more exactly than its version number: builds of one version differ, as checkouts do."""

from __future__ import annotations

import functools
import hashlib
from pathlib import Path
from typing import Final

from auv_mcm import __version__, kernels

_ROOT: Final = Path(__file__).parents[1]
_PACKAGES: Final = ("auv_mcm", "drivers", "sim_replay")
_DECIDES: Final = frozenset({".py", ".c", ".h", ".json", ".onnx", ".yaml"})  # code, and the models that ship
_N_DIGITS: Final = 16  # of 64: two builds of a user's are never alike by chance


@functools.cache
def program() -> str:
    """Digest what is installed and decides, once in a process; the same on every computer."""
    digest = hashlib.sha256()
    for path in sorted(path for package in _PACKAGES for path in (_ROOT / package).rglob("*")):
        name = path.relative_to(_ROOT)
        if path.suffix in _DECIDES and name.parts[1] != "docs":
            digest.update(f"{name}\n".encode() + hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()[:_N_DIGITS]


def made_with() -> dict[str, str]:
    """Name, in a summary, what made the results."""
    return {"version": __version__, "program": program(), "kernels": kernels.backend()}
