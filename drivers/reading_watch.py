"""Watch whether a port's bytes can be read at all.

It reads no clock: recorded bytes raise the same notices as live ones.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from auv_mcm.records import Notice

_CHECK_NS: Final = 2_000_000_000  # ns of bytes without a message, after which a port counts as unreadable
_CHECK_BYTES: Final = 256  # fewer may be one message and its remains
_MAX_NOTICES: Final = 20  # per port; a loose contact has no end of them


class ReadingWatch:
    """Raise a notice when bytes give no message, as at a wrong rate, and when messages return.

    Between two checks are at least 2 s and 256 bytes. Garbage between messages, however much, and damage that lets one
    message through raise nothing.
    """

    def __init__(self, port: str, device: str, place: str, baud: int | None) -> None:
        """place, baud: of the link, for messages; baud None where there is none."""
        self._port, self._device, self._place, self._baud = port, device, place, baud
        self._began_ns: int | None = None
        self._n_bytes = 0
        self._n_messages = 0
        self._is_readable = True
        self._n_notices = 0

    def heard(self, n_bytes: int, mono_ns: int, count_messages: Callable[[], int]) -> Notice | None:
        """Check after a chunk was decoded.

        Parameters
        ----------
        mono_ns
            When it was read.
        count_messages
            Messages so far; not called each time.
        """
        if self._began_ns is None:
            self._began_ns = mono_ns
        self._n_bytes += n_bytes
        elapsed_ns = mono_ns - self._began_ns
        if self._is_readable and (elapsed_ns < _CHECK_NS or self._n_bytes < _CHECK_BYTES):
            return None
        before, self._n_messages = self._n_messages, count_messages()
        heard_bytes, was_readable = self._n_bytes, self._is_readable
        self._is_readable = self._n_messages > before
        self._began_ns, self._n_bytes = None, 0
        if self._is_readable == was_readable or self._n_notices >= _MAX_NOTICES:
            return None
        self._n_notices += 1
        last = " Further changes of this port are not reported." if self._n_notices == _MAX_NOTICES else ""
        if self._is_readable:
            return Notice(
                code="port_readable",
                text=f"port '{self._port}' can be read again: messages arrive.{last}",
                place=self._port,
            )
        rate = "" if self._baud is None else f"that both ends are set to the same rate, here {self._baud} baud, "
        text = (
            f"port '{self._port}' cannot be read: {heard_bytes} bytes in {elapsed_ns * 1e-9:.1f} s held no message "
            f"of '{self._device}'. Check {rate}that such a device is at {self._place}, and its cable.{last}"
        )
        return Notice(code="port_unreadable", text=text, place=self._port)
