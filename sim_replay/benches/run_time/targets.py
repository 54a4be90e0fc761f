"""Compare what the chain costs with its targets, and say which stages take the time where one is missed."""

from __future__ import annotations

import statistics
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Final, NamedTuple

import msgspec

from sim_replay.benches.run_time.apart import Apart
from sim_replay.benches.run_time.lines import BenchMission, MissionKind
from sim_replay.benches.run_time.measure import MissionCost, SettingResult, times_real_time

FLAT: Final = "flat"
ROUGH: Final = "rough"
_STAGES_SHOWN: Final = 6  # of a profile, the costliest


class CostTarget(msgspec.Struct, frozen=True, kw_only=True):
    """Hold a figure beside its target.

    before: on 2026-11-25; aim: what would be better still; at_most: the lower the better.

    measured: None where the missions for it were not flown. where: the mission that decided. profile: share of
    processor time per stage, of what missed the target.
    """

    name: str
    before: float
    target: float
    aim: float
    at_most: bool
    measured: float | None
    where: str
    profile: str

    @property
    def met(self) -> bool | None:
        """Find whether the target is met; None where nothing was measured."""
        if self.measured is None:
            return None
        return self.measured <= self.target if self.at_most else self.measured >= self.target


def cost_targets(
    chain: SettingResult, plain: SettingResult, lines: Sequence[BenchMission], apart: Apart
) -> list[CostTarget]:
    """Compute every figure from the default operating point and the plain script over the same missions."""
    runs = chain.runs

    def named(kind: MissionKind, *groups: str) -> list[str]:
        return [line.name for line in lines if line.kind == kind and (not groups or line.group in groups)]

    flat, empty, rough = named("scene", FLAT), named("empty", FLAT), named("scene", ROUGH)
    scenes, recorded = named("scene"), named("recorded")

    def speed(name: str) -> float:
        return times_real_time(runs[name])

    swept_km2 = sum(line.truth.area_km2 for line in lines if line.name in flat)
    script = _median_ratio(chain.process_s(flat), plain.process_s(flat)) if flat else None
    contacts = sum(runs[name].contacts for name in flat) / swept_km2 if flat else None
    look_ms = apart.look_ms or (None, None)
    figures: tuple[_Figure, ...] = (
        _Figure("chain over plain script, flat, whole process", 3.8, 1.8, 1.0, True, script, flat),
        _Figure("times real time, flat", 81.0, 200.0, 400.0, False, _median(map(speed, flat)), flat),
        _Figure("times real time, rough", 61.0, 120.0, 250.0, False, _median(map(speed, rough)), rough),
        _Figure("times real time, recorded line", 23.0, 100.0, 200.0, False, *_slowest(speed, recorded, "no --log")),
        _Figure("times real time, worst named scene", 14.0, 60.0, 100.0, False, *_slowest(speed, scenes, "")),
        _Figure(
            *("empty floor over busy floor: flat without objects over flat", 0.73, 0.35, 0.15, True),
            *(_cost_ratio(runs, empty, flat, lambda run: run.pings), empty, "per ping"),
        ),
        _Figure("one examination, flat, median, ms", 11.0, 3.0, 3.0, True, look_ms[0], []),
        _Figure("one examination, flat, 99 %, ms", 18.0, 12.0, 12.0, True, look_ms[1], []),
        _Figure("worst drawn tile, s of a core for 30 s of track", 5.9, 1.5, 0.5, True, apart.worst_tile_s, []),
        _Figure("peak memory, replay of 40 minutes, MB", 329.0, 200.0, 150.0, True, apart.replay_mb, []),
        _Figure("times real time, flat, without a compiler", 5.0, 8.0, 15.0, False, apart.numpy_speed, []),
        _Figure("announced within 20 m or 10 s", 0.83, 0.95, 1.0, False, apart.announced, []),
        _Figure("contacts per km², flat", 65000.0, 8000.0, 3000.0, True, contacts, []),
    )
    return [_with_profile(one, runs) for one in figures]


class _Figure(NamedTuple):
    """Hold a figure as measured. of: missions whose profile says why, where its target is missed."""

    name: str
    before: float
    target: float
    aim: float
    at_most: bool
    measured: float | None
    of: Sequence[str]
    where: str = ""


def _with_profile(one: _Figure, runs: Mapping[str, MissionCost]) -> CostTarget:
    values = one._asdict() | {"profile": ""}
    of = values.pop("of")
    made = CostTarget(**values)
    if made.met is not False or not of:
        return made
    return msgspec.structs.replace(made, profile=profile_words([runs[name] for name in of]))


def _median(values: Iterable[float]) -> float | None:
    found = list(values)
    return statistics.median(found) if found else None


def _slowest(speed: Callable[[str], float], names: Sequence[str], without: str) -> tuple[float | None, list[str], str]:
    """Find the speed of the slowest mission and name it."""
    slowest = min(names, key=speed, default=None)
    return (None, [], without) if slowest is None else (speed(slowest), [slowest], slowest)


def profile_words(runs: Sequence[MissionCost]) -> str:
    """Share of the chain's processor time per stage, the largest first, over some runs."""
    total: dict[str, float] = defaultdict(float)
    for run in runs:
        for stage, cost_s in run.stages_s.items():
            total[stage] += cost_s
        total["other"] += statistics.median(run.chain_s) - sum(run.stages_s.values())
    whole_s = sum(total.values())
    return ", ".join(
        f"{stage} {cost_s / whole_s:.0%}"
        for stage, cost_s in sorted(total.items(), key=lambda item: -item[1])[:_STAGES_SHOWN]
    )


def target_rows(found: Sequence[CostTarget]) -> list[list[str]]:
    """Write a row of text per target."""
    return [
        [
            one.name,
            f"{one.before:g}",
            f"{'<=' if one.at_most else '>='} {one.target:g}",
            f"{one.aim:g}",
            "-" if one.measured is None else f"{one.measured:.3g}" if one.measured < 1000.0 else f"{one.measured:.0f}",
            {True: "met", False: "missed", None: "not measured"}[one.met],
            one.where,
        ]
        for one in found
    ]


TARGET_HEADER: Final = ("figure", "before", "target", "aim", "measured", "", "on")


def _cost_ratio(
    runs: dict[str, MissionCost], some: Sequence[str], others: Sequence[str], unit: Callable[[MissionCost], int]
) -> float | None:
    """Divide the processor time of the chain alone per unit, of some missions over others."""
    if not some or not others:
        return None

    def each_s(names: Sequence[str]) -> list[float]:
        n_units = sum(unit(runs[name]) for name in names)
        return [sum(parts) / n_units for parts in zip(*(runs[name].chain_s for name in names), strict=True)]

    return _median_ratio(each_s(some), each_s(others))


def _median_ratio(some_s: Sequence[float], others_s: Sequence[float]) -> float:
    return statistics.median(a / b for a, b in zip(some_s, others_s, strict=True))
