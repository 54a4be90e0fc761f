"""Many comparisons as a table per rival: means of both ways, and their difference mission by mission with a 95 % interval."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final, Literal, NamedTuple, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from sim_replay.adaptive.compare import Arm, Compared

Array = NDArray[np.float64]

Rival: TypeAlias = Literal["worst", "average"]
RIVALS: Final[tuple[Rival, ...]] = get_args(Rival)
"""Lawnmowers laid for the worst sea floor and for the average one."""
HEADER: Final = ("", "missions", "replanned", "lawnmower", "difference (95 %)")
_RESAMPLES: Final = 4000
_SEED: Final = 1
_CONFIDENCE: Final = 0.95


class Paired(NamedTuple):
    """Ratios of sums over missions, and the interval of their difference."""

    adaptive: float
    fixed: float
    low: float
    high: float

    @property
    def difference(self) -> float:
        return self.adaptive - self.fixed


def paired(adaptive: Array, fixed: Array, of: Array) -> Paired:
    """Sums of (n,) values of both ways over the sum of `of`; the interval from missions drawn anew with replacement, both ways of a mission
    together (B. Efron and R. Tibshirani, "An Introduction to the Bootstrap", 1993, percentile method)."""
    drawn = np.random.Generator(np.random.PCG64(_SEED)).integers(0, len(of), (_RESAMPLES, len(of)))
    differences = (adaptive - fixed)[drawn].sum(axis=1) / np.maximum(of[drawn].sum(axis=1), 1e-12)
    low, high = np.quantile(differences, [0.5 - 0.5 * _CONFIDENCE, 0.5 + 0.5 * _CONFIDENCE]).tolist()
    total = float(of.sum())
    return Paired(float(adaptive.sum()) / total, float(fixed.sum()) / total, low, high)


def rows(missions: Sequence[Compared], rival: Rival) -> list[list[str]]:
    """Lines of the table under HEADER, beside one of the lawnmowers."""

    def fixed_of(mission: Compared) -> Arm:
        return mission.worst if rival == "worst" else mission.average

    ones = np.ones(len(missions))
    area = np.array([mission.area_km2 for mission in missions])
    targets = np.array([float(mission.adaptive.n_targets) for mission in missions])
    both = [mission for mission in missions if mission.adaptive.reached_m is not None and fixed_of(mission).reached_m is not None]

    def row(title: str, value: Callable[[Arm], float], of: Array, form: str, some: Sequence[Compared] = missions) -> list[str]:
        if not some:
            return [title, "0", "-", "-", "-"]
        adaptive, fixed = (
            np.array([float(value(arm)) for arm in arms]) for arms in zip(*((m.adaptive, fixed_of(m)) for m in some), strict=True)
        )
        told = paired(adaptive, fixed, of)
        sign = form.replace(":", ":+")
        interval = f"{sign.format(told.difference)} ({sign.format(told.low)} to {sign.format(told.high)})"
        return [title, str(len(some)), form.format(told.adaptive), form.format(told.fixed), interval]

    return [
        row("track flown, m", lambda arm: arm.track_m, ones, "{:.0f}"),
        row("time, s", lambda arm: arm.duration_s, ones, "{:.0f}"),
        row("share that reached the order", lambda arm: arm.reached_m is not None, ones, "{:.2f}"),
        row("track until reached where both did, m", lambda arm: arm.reached_m or 0.0, np.ones(len(both)), "{:.0f}", both),
        row("Pd when reached, mine-like", lambda arm: arm.then.n_found, targets, "{:.3f}"),
        row("Pd when reached, p_mine 0.5", lambda arm: arm.then.n_found_half, targets, "{:.3f}"),
        row("FA/km² when reached, mine-like", lambda arm: arm.then.n_false, area, "{:.0f}"),
        row("FA/km² when reached, p_mine 0.5", lambda arm: arm.then.n_false_half, area, "{:.0f}"),
        row("clearance at the end, as believed", lambda arm: arm.believed, ones, "{:.3f}"),
        row("the same where mines lie", lambda arm: sum(target.p_detected for target in arm.targets), targets, "{:.3f}"),
        row("Pd at the end, mine-like", lambda arm: arm.at_end.n_found, targets, "{:.3f}"),
        row("Pd at the end, p_mine 0.5", lambda arm: arm.at_end.n_found_half, targets, "{:.3f}"),
        row("FA/km² at the end, mine-like", lambda arm: arm.at_end.n_false, area, "{:.0f}"),
        row("FA/km² at the end, p_mine 0.5", lambda arm: arm.at_end.n_false_half, area, "{:.0f}"),
    ]


def planned_words(missions: Sequence[Compared], rival: Rival) -> str:
    """What the lawnmowers of one kind were planned to be."""
    told = [(m.worst_planned_m, m.worst_expected) if rival == "worst" else (m.average_planned_m, m.average_expected) for m in missions]
    planned_m, expected = np.mean(told, axis=0).tolist()
    return f"beside the lawnmower laid for the {rival} sea floor: {planned_m:.0f} m planned, clearance expected there {expected:.3f}"
