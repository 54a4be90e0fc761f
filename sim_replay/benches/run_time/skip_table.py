"""Measure what each skip of the chain saves and how far the answer differs without it, scene by scene."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Final, TypeAlias

import msgspec

from auv_mcm.skips import ALL_SKIPS, SKIPS
from sim_replay.benches.run_time.lines import BenchMission
from sim_replay.benches.run_time.measure import LIMITS_PER_KM2, SettingResult, measure_settings, median_ratio
from sim_replay.benches.run_time.points import ChainSetting, default_point
from sim_replay.scoring.score import GATE_M

Place: TypeAlias = tuple[float, float]

ALL: Final = "all of them"
SKIP_HEADER: Final = (
    *("mission", "without", "left out", "time without it", "contacts", "called", "lost or new among called"),
    *(f"targets at {limit:g} FA/km²" for limit in LIMITS_PER_KM2[1:]),
    "same bytes",
)
REGISTER_HEADER: Final = ("skip", "leaves out", "because", "counter", "proof")
_DEGREE_M: Final = 111_320.0  # m per degree of latitude
_PROOFS: Final = {
    "bytes": "same bytes, by test",
    "bytes while 0": "same bytes while the counter is 0, by test",
    "bound": "a bound, measured below",
}


class SkipEffect(msgspec.Struct, frozen=True, kw_only=True):
    """Compare the default on one mission with itself without one skip.

    count: of what was left out, None for all skips together.
    """

    mission: str
    skip: str
    count: int | None
    with_skip: SettingResult
    without: SettingResult


def measure_skips(
    lines: Sequence[BenchMission], repeat: int, folder: Path, progress: Callable[[str], None]
) -> list[SkipEffect]:
    """Run the default and the chain without each skip, and without any, in turn on every mission."""
    effects = []
    for line in lines:
        ours, *others = measure_settings(list(_points()), [line], repeat, folder, progress)
        counters = ours.runs[line.name].counters
        counts = [*(counters.get(skip.counter, 0) for skip in SKIPS), None]
        effects += [
            SkipEffect(mission=line.name, skip=other.value, count=count, with_skip=ours, without=other)
            for other, count in zip(others, counts, strict=True)
        ]
    return effects


def _points() -> Iterator[ChainSetting]:
    yield default_point()
    for skip in SKIPS:
        yield default_point()._replace(
            name=f"without {skip.name}", knob="skips", value=skip.name, without_skips=frozenset({skip.name})
        )
    yield default_point()._replace(name="without any skip", knob="skips", value=ALL, without_skips=ALL_SKIPS)


def skip_rows(effects: Sequence[SkipEffect]) -> list[list[str]]:
    """Write a row of text per mission and skip that left something out there, and one for all skips together."""
    rows = []
    for effect in effects:
        if effect.count == 0:
            continue
        ours, other = (point.runs[effect.mission] for point in (effect.with_skip, effect.without))
        median, low, high = median_ratio(effect.without, effect.with_skip)
        rows.append(
            [
                effect.mission,
                effect.skip,
                "" if effect.count is None else str(effect.count),
                f"{median:.2f} ({low:.2f}-{high:.2f})",
                f"{ours.contacts} -> {other.contacts}",
                f"{len(ours.called)} -> {len(other.called)}",
                (
                    f"{_without_counterpart(ours.called, other.called)} and "
                    f"{_without_counterpart(other.called, ours.called)}"
                ),
                *(
                    f"{a.count} -> {b.count} of {a.of}"
                    for a, b in zip(effect.with_skip.pd[1:], effect.without.pd[1:], strict=True)
                ),
                "yes" if ours.contacts_sha256 == other.contacts_sha256 else "no",
            ]
        )
    return rows


def _without_counterpart(some: Sequence[Place], others: Sequence[Place]) -> int:
    """Count the places that have none of the others within the gate of scoring."""

    def distance_m(a: Place, b: Place) -> float:
        return _DEGREE_M * math.hypot(a[0] - b[0], (a[1] - b[1]) * math.cos(math.radians(a[0])))

    return sum(all(distance_m(place, other) > GATE_M for other in others) for place in some)


def register_rows() -> list[list[str]]:
    """Write a row of text per registered skip."""
    return [[skip.name, skip.leaves_out, skip.because, f"`{skip.counter}`", _PROOFS[skip.proof]] for skip in SKIPS]
