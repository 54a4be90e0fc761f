"""Disks that take nothing."""

from __future__ import annotations

from typing import NoReturn


def full(*_: object, **__: object) -> NoReturn:
    """Stand in for a call of the system on a disk that is full."""
    raise OSError(28, "No space left on device")
