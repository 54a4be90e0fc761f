"""Make looks of which a test states what they find."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from auv_mcm.clearance.detection_performance import CellView


class EvenLook:
    """A look that finds p of all mines, whatever it looks at, and what it has in common with the same and another."""

    def __init__(self, p: float = 0.85, same: float = 0.5, other: float = 0.1) -> None:
        self._p = p
        self.same_look_correlation = same
        self.other_look_correlation = other

    def p_look(self, view: CellView) -> NDArray[np.float64]:
        return np.full(np.broadcast_shapes(*(np.shape(part) for part in view)), self._p)
