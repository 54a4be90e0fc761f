"""Damage messages as on a bad wire, drawn from a seed."""

from __future__ import annotations

from collections import Counter
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

Probability = Annotated[float, Meta(ge=0.0, le=1.0)]


class FaultRates(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Set probabilities.

    Per byte: flip (one bit), drop, repeat. Per message: lose, double, truncate, delay (to delay_s).
    """

    flip_byte: Probability = 0.0
    drop_byte: Probability = 0.0
    repeat_byte: Probability = 0.0
    lose: Probability = 0.0
    double: Probability = 0.0
    truncate: Probability = 0.0
    delay: Probability = 0.0
    delay_s: Annotated[float, Meta(ge=0.0)] = 0.0


class Faults:
    """Damage one message after the other. Same rates, seed and messages: same damage.

    counters: fault.flipped, .dropped, .repeated (bytes), .lost, .doubled, .truncated, .delayed (messages).
    """

    def __init__(self, rates: FaultRates, seed: int) -> None:
        self.counters: Counter[str] = Counter()
        self._rates = rates
        self._random = np.random.Generator(np.random.PCG64(seed))

    def passed(self, message: bytes) -> list[tuple[float, bytes]]:
        """Return the surviving copies of a message.

        None, one or two, each with its delay in seconds and its own damage.
        """
        if self._happens(self._rates.lose, "lost"):
            return []
        n_copies = 2 if self._happens(self._rates.double, "doubled") else 1
        return [(self._delay_s(), self._damaged(message)) for _ in range(n_copies)]

    def _happens(self, probability: float, name: str) -> bool:
        happens = bool(self._random.random() < probability)
        self.counters[f"fault.{name}"] += happens
        return happens

    def _delay_s(self) -> float:
        return (
            float(self._random.uniform(0.0, self._rates.delay_s))
            if self._happens(self._rates.delay, "delayed")
            else 0.0
        )

    def _damaged(self, message: bytes) -> bytes:
        rates = self._rates
        if message and self._happens(rates.truncate, "truncated"):
            message = message[: int(self._random.integers(len(message)))]
        data = np.frombuffer(message, dtype=np.uint8)
        flipped = self._random.random(data.size) < rates.flip_byte
        bits = np.left_shift(1, self._random.integers(8, size=data.size)).astype(np.uint8)
        copies = np.where(self._random.random(data.size) < rates.repeat_byte, 2, 1)
        copies[self._random.random(data.size) < rates.drop_byte] = 0
        self.counters["fault.flipped"] += int(np.count_nonzero(flipped))
        self.counters["fault.dropped"] += int(np.count_nonzero(copies == 0))
        self.counters["fault.repeated"] += int(np.count_nonzero(copies == 2))
        return np.repeat(np.where(flipped, data ^ bits, data), copies).tobytes()
