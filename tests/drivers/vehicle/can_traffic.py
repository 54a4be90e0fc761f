"""Messages between payload and vehicle, of any content that they can have."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

from auv_mcm.clock import Stamp
from auv_mcm.records import NAN
from drivers.vehicle.can_messages import MESSAGES, CanMessage, Record
from drivers.vehicle.can_signals import Signal


def at(seconds: float) -> Stamp:
    return Stamp(round(1e9 * seconds), 1_700_000_000_000_000_000 + round(1e9 * seconds))


def bounds(signal: Signal) -> tuple[int, int]:
    """Return the minimum and maximum number on the wire."""
    scale = 1.0 if signal.scale is None else signal.scale
    return round(signal.low / scale), round(signal.high / scale)


def value_of(signal: Signal, raw: int) -> float:
    return raw if signal.scale is None else raw * signal.scale


@st.composite
def records(draw: st.DrawFn, messages: tuple[CanMessage, ...] = MESSAGES) -> Record:
    message = draw(st.sampled_from(messages))
    values = []
    for placed in message.placed:
        absent = placed.signal.scale is not None and draw(st.integers(0, 4)) == 0
        values.append(NAN if absent else value_of(placed.signal, draw(st.integers(*bounds(placed.signal)))))
    made: Record = message.make(*values)
    return made


def random_record(message: CanMessage, random: np.random.Generator) -> Record:
    ranges = [(placed.signal, *bounds(placed.signal)) for placed in message.placed]
    return message.make(*[value_of(signal, low + int(random.random() * (high - low))) for signal, low, high in ranges])
