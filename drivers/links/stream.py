"""Read and write bytes on a file descriptor: a serial port or a TCP connection."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable
from typing import Final

from auv_mcm.errors import HardwareError
from drivers.links.gather import PLENTY_BYTES

READ_BYTES: Final = 1 << 16  # bytes per read: the buffer of a pseudo-terminal or pipe; bounds how long one read takes
MAX_QUEUED_BYTES: Final = 1 << 16  # bytes not yet written to a stalled port; bounds memory and the age of what is sent


class StreamPort:
    """Carry bytes on a non-blocking descriptor.

    close: called once. lost: makes the message for a failed read or write, given the error, None when the other end
    hung up. on_silence: see Port. gather_s: how long bytes may gather before they are read. counters: link.bytes_in,
    link.bytes_out.
    """

    def __init__(
        self,
        descriptor: int,
        close: Callable[[], None],
        lost: Callable[[OSError | None], str],
        on_silence: Callable[[], str],
        gather_s: float,
        counters: Counter[str],
    ) -> None:
        self.note = ""
        self.pause_s = gather_s
        self.close = close
        self.on_silence = on_silence
        self._descriptor = descriptor
        self._lost = lost
        self._gather_s = gather_s
        self._counters = counters
        self._unsent = bytearray()

    @property
    def has_unsent(self) -> bool:
        return bool(self._unsent)

    def fileno(self) -> int:
        return self._descriptor

    def read(self) -> list[bytes]:
        try:
            data = os.read(self._descriptor, READ_BYTES)
        except BlockingIOError:
            return []
        except OSError as error:
            raise HardwareError(self._lost(error)) from error
        if not data:
            raise HardwareError(self._lost(None))
        self._counters["link.bytes_in"] += len(data)
        self.pause_s = self._gather_s if len(data) < PLENTY_BYTES else 0.0
        return [data]

    def write(self, item: bytes) -> bool:
        if len(self._unsent) + len(item) > MAX_QUEUED_BYTES:
            return False
        self._unsent += item
        self.flush()
        return True

    def flush(self) -> None:
        while self._unsent:
            try:
                n_sent = os.write(self._descriptor, self._unsent)
            except BlockingIOError:
                return
            except OSError as error:
                raise HardwareError(self._lost(error)) from error
            self._counters["link.bytes_out"] += n_sent
            del self._unsent[:n_sent]
