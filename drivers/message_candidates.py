"""Find candidates of formats in which a regular expression can refuse most of them.

A wire can bring nothing but beginnings of messages, a million in a megabyte. Looking at each in Python costs a
microsecond; here they are passed over and counted by the expression engine, in a few tens of nanoseconds each.
"""

from __future__ import annotations

import re
from typing import Final

from drivers.framing import Refused


class MessageCandidates:
    """Find candidates that may be messages, and count the others by the reason of their refusal."""

    def __init__(self, syncs: tuple[bytes, ...], alive: bytes, dead: bytes, reasons: tuple[str, ...]) -> None:
        """syncs: with one of which every candidate begins.

        alive: pattern of a candidate that is a message or may become one when more bytes come. dead: pattern that
        matches at every candidate, with one group for each of `reasons`, of which the one that took part counts. Each
        byte in the first group is a candidate refused for the first reason, so that a run of beginnings is one match.
        """
        self._syncs: Final = syncs
        self._search_alive: Final = re.compile(alive, re.DOTALL).search
        self._dead: Final = re.compile(dead, re.DOTALL)
        self._reasons: Final = reasons

    def find(self, buffer: bytearray, start: int, refused: Refused) -> int:
        """Find the first candidate that may be a message; see `Grammar.find`."""
        match = self._search_alive(buffer, start)
        if match is None:
            self._count(buffer, start, len(buffer), refused)
            return -1
        at = match.start()
        if at > start:
            self._count(buffer, start, at, refused)
        return at

    def _count(self, buffer: bytearray, start: int, stop: int, refused: Refused) -> None:
        """Count the candidates that begin in buffer[start:stop]; none of them is alive."""
        for sync in self._syncs:
            if buffer.find(sync, start, stop) >= 0:
                break
        else:
            return
        counts = [0] * (len(self._reasons) + 1)
        for match in self._dead.finditer(buffer, start):
            if match.start() >= stop:
                break
            group = match.lastindex or 0
            counts[group] += match.end() - match.start() if group == 1 else 1
        for reason, count in zip(self._reasons, counts[1:], strict=True):
            if count:
                refused[reason] = refused.get(reason, 0) + count
