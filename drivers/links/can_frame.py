"""The one form in which frames of a CAN bus go round, whatever adapter they came by."""

from __future__ import annotations

from typing import NamedTuple


class CanFrame(NamedTuple):
    """A data frame. can_id: 29 bits if extended, else 11. data: up to 8 bytes, 64 on CAN FD."""

    can_id: int
    data: bytes
    extended: bool = True
