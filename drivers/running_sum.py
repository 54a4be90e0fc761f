"""Sum of any stretch of a stream's bytes at a cost that does not depend on its length."""

from __future__ import annotations

from array import array

import numpy as np


class RunningSum:
    """Sums, modulo 65536, of the bytes of a buffer of which bytes are dropped in front and added behind."""

    def __init__(self) -> None:
        self._values = array("H", (0,))

    def values(self, buffer: bytearray) -> array[int]:
        """The running sum before each byte of the buffer and behind the last; what it starts from is arbitrary."""
        done = len(self._values) - 1
        if done < len(buffer):
            added = np.frombuffer(buffer, np.uint8, offset=done).astype(np.uint16)
            added[:1] += self._values[-1]
            self._values.frombytes(np.add.accumulate(added, dtype=np.uint16).tobytes())
        return self._values

    def forget(self, n_bytes: int) -> None:
        """The buffer has lost its first bytes."""
        if n_bytes < len(self._values):
            del self._values[:n_bytes]
        else:
            self._values = array("H", (0,))
