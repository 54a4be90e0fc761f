"""Represent frames of a CAN bus in one form, whatever adapter they came by."""

from __future__ import annotations

from typing import NamedTuple


class CanFrame(NamedTuple):
    """Hold a data frame. can_id: 29 bits if extended, else 11. data: up to 8 bytes, 64 on CAN FD."""

    can_id: int
    data: bytes
    extended: bool = True
