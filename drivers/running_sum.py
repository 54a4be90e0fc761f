"""Sum any stretch of a stream's bytes at a cost that does not depend on its length."""

from __future__ import annotations

from array import array

import numpy as np


class RunningSum:
    """Keep sums, modulo 65536, of the bytes of a buffer that drops bytes in front and takes bytes behind."""

    def __init__(self) -> None:
        self._values = array("H", (0,))

    def values(self, buffer: bytearray) -> array[int]:
        """Return the running sum before each byte of the buffer and behind the last; its start value is arbitrary."""
        done = len(self._values) - 1
        if done < len(buffer):
            added = np.frombuffer(buffer, np.uint8, offset=done).astype(np.uint16)
            added[:1] += self._values[-1]
            self._values.frombytes(np.add.accumulate(added, dtype=np.uint16).tobytes())
        return self._values

    def forget(self, n_bytes: int) -> None:
        """Drop the first bytes, as the buffer did."""
        if n_bytes < len(self._values):
            del self._values[:n_bytes]
        else:
            self._values = array("H", (0,))
