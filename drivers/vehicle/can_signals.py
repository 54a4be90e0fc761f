"""Describe the numbers in messages on a CAN bus, and write and read them."""

from __future__ import annotations

import math
from typing import NamedTuple


class Signal(NamedTuple):
    """Describe one number.

    scale: of a quantity; None: whole. low, high: what it may be. names: of a code's values from 0 on.
    """

    name: str
    n_bytes: int
    low: float
    high: float
    comment: str
    scale: float | None = None
    unit: str = ""
    signed: bool = False
    names: tuple[str, ...] = ()

    @property
    def unavailable(self) -> int:
        """Return the number that stands for an unknown quantity."""
        return (1 << 8 * self.n_bytes - self.signed) - 1


def packed(signal: Signal, value: float) -> bytes:
    """Write a number, NaN for an unknown quantity. Raises ValueError for one out of its range.

    Parameters
    ----------
    signal
        What it is.
    value
        In the signal's unit.
    """
    if signal.scale is None:
        is_within = signal.low <= value <= signal.high
        raw = int(value) if is_within else 0
    elif math.isnan(value):
        is_within, raw = True, signal.unavailable
    else:
        raw = round(value / signal.scale) if math.isfinite(value) else signal.unavailable
        is_within = round(signal.low / signal.scale) <= raw <= round(signal.high / signal.scale)
    if not is_within:
        raise ValueError(f"{signal.name}: {value} is not within {signal.low} to {signal.high}")
    return raw.to_bytes(signal.n_bytes, "little", signed=signal.signed)


def unpacked(signal: Signal, data: bytes) -> float:
    """Read a number, NaN for an unknown quantity. Raises ValueError for one out of its range.

    Parameters
    ----------
    signal
        What it is.
    data
        Its bytes.
    """
    raw = int.from_bytes(data, "little", signed=signal.signed)
    if signal.scale is None:
        low, high = signal.low, signal.high
    elif raw == signal.unavailable:
        return math.nan
    else:
        low, high = round(signal.low / signal.scale), round(signal.high / signal.scale)
    if not low <= raw <= high:
        raise ValueError(f"{signal.name}: {raw} is not within {low} to {high}")
    return raw if signal.scale is None else raw * signal.scale


def code(name: str, names: tuple[str, ...], comment: str) -> Signal:
    """Describe a code, a value for each of its names.

    Parameters
    ----------
    name
        In the table.
    names
        Of the values from 0 on.
    comment
        For people.
    """
    return Signal(name, 1, 0, len(names) - 1, comment, names=names)


def number(name: str, n_bytes: int, comment: str) -> Signal:
    """Describe a whole number of some bytes.

    Parameters
    ----------
    name
        In the table.
    n_bytes
        On the wire.
    comment
        For people.
    """
    return Signal(name, n_bytes, 0, (1 << 8 * n_bytes) - 1, comment)


def share(name: str, comment: str) -> Signal:
    """Describe a share of one.

    Parameters
    ----------
    name
        In the table.
    comment
        For people.
    """
    return Signal(name, 2, 0.0, 1.0, comment, 2e-5)


def length(name: str, comment: str, high: float = 65.53) -> Signal:
    """Describe a length, m.

    Parameters
    ----------
    name
        In the table.
    comment
        For people.
    high
        The most that it may be.
    """
    return Signal(name, 2, 0.0, high, comment, 1e-3, "m")
