"""Generate smooth random motion: stationary second-order Gauss-Markov processes.

x'' + 2 z w x' + w^2 x = white noise, with w = 2 pi / period and damping z = 1/2 (A. Gelb, "Applied Optimal Estimation",
1974, Sec. 3.8): x and x' are Gaussian and independent at any one time, with standard deviations sigma and w sigma, and
x wanders within about a period.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

DAMPING: Final = 0.5  # of the oscillation: half of critical
_STEPS_PER_PERIOD: Final = 32  # steps of the process per period
_BLOCK: Final = 512  # random numbers drawn at once


class GaussMarkov:
    """Run one such process, from time 0 on.

    It is drawn every 1/32 of its period, by exact discretisation, and joined by cubics through values and rates, which
    takes less than 1e-4 of its variance and 3 % of its rate's. Twice the sigma gives twice the values, and the order in
    which times are asked for does not matter.
    """

    def __init__(self, sigma: float, period_s: float, random: np.random.Generator) -> None:
        self._sigma = sigma
        self._step_s = period_s / _STEPS_PER_PERIOD
        self._random = random
        omega = 2.0 * math.pi / _STEPS_PER_PERIOD  # time is counted in steps
        decay = math.exp(-DAMPING * omega)
        damped = omega * math.sqrt(1.0 - DAMPING**2)
        sine, cosine = math.sin(damped) / damped, math.cos(damped)
        slope = DAMPING * omega * sine
        transition = decay * np.array([[cosine + slope, sine], [-(omega**2) * sine, cosine - slope]])
        stationary = np.diag([1.0, omega**2])
        self._transition: list[float] = transition.ravel().tolist()
        self._spread = np.linalg.cholesky(stationary - transition @ stationary @ transition.T)
        first = random.standard_normal(2)
        self._values = [float(first[0])]
        self._rates = [omega * float(first[1])]

    def at(self, time_s: float) -> tuple[float, float]:
        """Return the value and its rate per second at a time of 0 or later."""
        if self._sigma == 0.0:
            return 0.0, 0.0
        place = time_s / self._step_s
        index = int(place)
        while index + 1 >= len(self._values):
            self._extend()
        part = place - index
        value, rate = self._values[index], self._rates[index]
        rise = self._values[index + 1] - value
        square = 3.0 * rise - 2.0 * rate - self._rates[index + 1]
        cube = rate + self._rates[index + 1] - 2.0 * rise
        return (
            self._sigma * (value + part * (rate + part * (square + part * cube))),
            self._sigma / self._step_s * (rate + part * (2.0 * square + 3.0 * part * cube)),
        )

    def _extend(self) -> None:
        value, rate = self._values[-1], self._rates[-1]
        a, b, c, d = self._transition
        kicks = self._random.standard_normal((_BLOCK, 2)) @ self._spread.T
        for push, jolt in kicks.tolist():
            value, rate = a * value + b * rate + push, c * value + d * rate + jolt
            self._values.append(value)
            self._rates.append(rate)
