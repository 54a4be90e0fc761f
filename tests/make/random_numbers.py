"""Random numbers that repeat."""

from __future__ import annotations

import numpy as np


def generator(seed: int = 0) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(seed))
