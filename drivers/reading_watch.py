"""Whether what comes from a port can be read at all. It reads no clock: recorded bytes are told of as live ones were."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from auv_mcm.records import Notice

_LOOK_NS: Final = 2_000_000_000
_LOOK_BYTES: Final = 256  # fewer may be one message and its remains
_MAX_NOTICES: Final = 20


class ReadingWatch:
    """Tells when bytes come for a while and make not one message, as at a wrong rate or with another device, and when messages come again.

    Between two looks are 2 s and 256 bytes at least. Garbage between messages, however much, and damage that lets one message through
    are none of its business.
    """

    def __init__(self, port: str, device: str, place: str, baud: int | None) -> None:
        """place, baud: of the link, for messages; baud None where there is none."""
        self._port, self._device, self._place, self._baud = port, device, place, baud
        self._began_ns: int | None = None
        self._n_bytes = 0
        self._n_messages = 0
        self._is_readable = True
        self._n_told = 0

    def heard(self, n_bytes: int, mono_ns: int, count_messages: Callable[[], int]) -> Notice | None:
        """After a chunk was decoded; mono_ns: when it was read. count_messages: how many were found so far; not asked for each chunk."""
        if self._began_ns is None:
            self._began_ns = mono_ns
        self._n_bytes += n_bytes
        elapsed_ns = mono_ns - self._began_ns
        if self._is_readable and (elapsed_ns < _LOOK_NS or self._n_bytes < _LOOK_BYTES):
            return None
        before, self._n_messages = self._n_messages, count_messages()
        heard_bytes, was_readable = self._n_bytes, self._is_readable
        self._is_readable = self._n_messages > before
        self._began_ns, self._n_bytes = None, 0
        if self._is_readable == was_readable or self._n_told >= _MAX_NOTICES:
            return None
        self._n_told += 1
        last = " More changes of this port are not told." if self._n_told == _MAX_NOTICES else ""
        if self._is_readable:
            return Notice(code="port_readable", text=f"port '{self._port}' is read again: messages come.{last}", place=self._port)
        rate = "" if self._baud is None else f"that both ends are set to the same rate, here {self._baud} baud, "
        text = (
            f"port '{self._port}' cannot be read: {heard_bytes} bytes in {elapsed_ns * 1e-9:.1f} s made not one message of "
            f"'{self._device}'. Check {rate}that such a device is at {self._place}, and its cable.{last}"
        )
        return Notice(code="port_unreadable", text=text, place=self._port)
