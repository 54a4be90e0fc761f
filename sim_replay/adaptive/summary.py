"""Tabulate many comparisons: means of both ways, and their difference mission by mission with a 95 % interval."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim_replay.adaptive.compare import Arm, Compared
from sim_replay.scoring.thresholds import resampled

Array = NDArray[np.float64]

HEADER: Final = ("", "missions", "replanned", "lawnmower", "difference (95 %)")
_RESAMPLES: Final = 4000  # of the bootstrap
_SEED: Final = 1  # of the bootstrap, fixed so that reports repeat


class Paired(NamedTuple):
    """Hold ratios of sums over missions, and the interval of their difference."""

    adaptive: float
    fixed: float
    low: float
    high: float

    @property
    def difference(self) -> float:
        """Compute adaptive less fixed."""
        return self.adaptive - self.fixed


def paired(adaptive: Array, fixed: Array, of: Array) -> Paired:
    """Compare sums of (n,) values of both ways over the sum of `of`.

    The interval from missions drawn anew with replacement, both ways of a mission together (B. Efron and R. Tibshirani,
    "An Introduction to the Bootstrap", 1993, percentile method).
    """
    more, total = adaptive - fixed, float(of.sum())
    found = resampled(
        lambda some: float(more[some].sum() / max(of[some].sum(), 1e-12)), len(of), seed=_SEED, n_resamples=_RESAMPLES
    )
    return Paired(float(adaptive.sum()) / total, float(fixed.sum()) / total, found.low, found.high)


def rows(missions: Sequence[Compared]) -> list[list[str]]:
    """Return lines of the table under HEADER."""
    ones = np.ones(len(missions))
    area = np.array([mission.area_km2 for mission in missions])
    targets = np.array([float(mission.adaptive.n_targets) for mission in missions])
    both = [mission for mission in missions if None not in (mission.adaptive.reached_m, mission.fixed.reached_m)]

    def row(
        title: str, value: Callable[[Arm], float], of: Array, form: str, some: Sequence[Compared] = missions
    ) -> list[str]:
        if not some:
            return [title, "0", "-", "-", "-"]
        adaptive, fixed = (
            np.array([float(value(arm)) for arm in arms])
            for arms in zip(*((m.adaptive, m.fixed) for m in some), strict=True)
        )
        reported = paired(adaptive, fixed, of)
        sign = form.replace(":", ":+")
        interval = f"{sign.format(reported.difference)} ({sign.format(reported.low)} to {sign.format(reported.high)})"
        return [title, str(len(some)), form.format(reported.adaptive), form.format(reported.fixed), interval]

    return [
        row("track flown, m", lambda arm: arm.track_m, ones, "{:.0f}"),
        row("time, s", lambda arm: arm.duration_s, ones, "{:.0f}"),
        row("share that reached the order", lambda arm: arm.reached_m is not None, ones, "{:.2f}"),
        row(
            "track until reached where both did, m",
            lambda arm: arm.reached_m or 0.0,
            np.ones(len(both)),
            "{:.0f}",
            both,
        ),
        row("clearance at the end, as believed", lambda arm: arm.believed, ones, "{:.3f}"),
        row(
            "the same where mines lie", lambda arm: sum(target.p_detected for target in arm.targets), targets, "{:.3f}"
        ),
        row("Pd at the end, mine-like", lambda arm: arm.at_end.n_found, targets, "{:.3f}"),
        row("Pd at the end, p_mine 0.5", lambda arm: arm.at_end.n_found_half, targets, "{:.3f}"),
        row("FA/km² at the end, mine-like", lambda arm: arm.at_end.n_false, area, "{:.0f}"),
        row("FA/km² at the end, p_mine 0.5", lambda arm: arm.at_end.n_false_half, area, "{:.0f}"),
    ]


def planned_words(missions: Sequence[Compared]) -> str:
    """Describe the plans of the lawnmowers."""
    planned_m, expected = np.mean([(mission.planned_m, mission.expected) for mission in missions], axis=0).tolist()
    return (
        f"beside the lawnmower laid for the worst sea floor: {planned_m:.0f} m planned, clearance expected there "
        f"{expected:.3f}"
    )
