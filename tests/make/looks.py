"""Make looks of which a test states what they find."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


class EvenLook:
    """A look that finds p of all mines, whatever it looks at, and what it has in common with the same and another."""

    def __init__(self, p: float = 0.85, same: float = 0.5, other: float = 0.1) -> None:
        self._p = p
        self.same_look_correlation = same
        self.other_look_correlation = other

    def p_look(self, seabed: NDArray[np.uint8], *conditions: Any, **named: Any) -> NDArray[np.float64]:
        return np.full(np.shape(seabed), self._p)
