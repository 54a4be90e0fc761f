"""Check in a minute, on two small missions, that the chain errs no more and works no more than it should; no time is
judged."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import msgspec

from sim_replay.benches.run_time.lines import FIRST_SEED, BenchMission, crowded, fly_scene, with_short_legs
from sim_replay.benches.run_time.measure import MissionCost, SettingResult, measure_settings
from sim_replay.benches.run_time.one_run import DEFAULT
from sim_replay.benches.run_time.points import DUTIES, PLAIN, chain_settings
from sim_replay.simulator.scene import Lawnmower, Scene
from sim_replay.simulator.scene_file import read_scene

_BUDGETED: Final = f"budget.duty {DUTIES[0]}"
_LEG_M: Final = 60.0  # m: a mission of seconds
_OBJECTS: Final = 0.4  # of those of the scene
_EVALUATIONS_PER_WINDOW: Final = 60.0  # the cascade makes 31 on quiet and 54 on busy tiles
_MEASURED_PER_KM2: Final = 40_000  # four times what flat sand with 1300 objects per km² needs


class WorkCheck(NamedTuple):
    """Hold something that must hold, and what was found."""

    name: str
    holds: bool
    found: str


def quick_checks(folder: Path, progress: Callable[[str], None]) -> list[WorkCheck]:
    """Fly two small missions, run the chain on them and judge its errors and counts of work."""
    lines = [fly_scene(_small(read_scene(name)), name, name, folder) for name in ("flat", "boulders")]
    wanted = (DEFAULT, PLAIN, _BUDGETED)
    results = {
        result.name: result
        for result in measure_settings([p for p in chain_settings() if p.name in wanted], lines, 1, folder, progress)
    }
    again = measure_settings([chain_settings()[0]], lines[:1], 1, folder, progress)[0]
    return list(_checks(results[DEFAULT], results[PLAIN], results[_BUDGETED], again, lines))


def _small(scene: Scene) -> Scene:
    """Shorten a scene to one leg, with some of its objects."""
    scene = crowded(with_short_legs(scene, FIRST_SEED), _OBJECTS)
    assert isinstance(scene.track.plan, Lawnmower)
    plan = msgspec.structs.replace(scene.track.plan, n_legs=1, leg_m=_LEG_M)
    return msgspec.structs.replace(scene, track=msgspec.structs.replace(scene.track, plan=plan))


def _checks(
    default: SettingResult,
    plain: SettingResult,
    budgeted: SettingResult,
    again: SettingResult,
    lines: Sequence[BenchMission],
) -> Iterator[WorkCheck]:
    found, of_plain = default.pd[2], plain.pd[2]
    yield WorkCheck(
        "Pd at 300 FA/km² is no less than the plain script's",
        found.count >= of_plain.count,
        f"{found.count} and {of_plain.count}",
    )
    per_km2 = default.contacts.per_km2 or 0.0
    yield WorkCheck("at most 8000 contacts per km²", per_km2 <= 8000.0, f"{per_km2:.0f}")
    for line in lines:
        counters = default.runs[line.name].counters
        n_windows, n_evaluations = (
            _count(default.runs[line.name], "detect.windows"),
            _count(default.runs[line.name], "detect.evaluations"),
        )
        yield WorkCheck(
            f"{line.name}: at most {_EVALUATIONS_PER_WINDOW:g} comparisons per window",
            0 < n_evaluations <= _EVALUATIONS_PER_WINDOW * n_windows,
            f"{n_evaluations} for {n_windows} windows",
        )
        n_measured, n_looks = counters.get("detect.candidate", 0), counters.get("confirm.looked_at", 0)
        yield WorkCheck(
            f"{line.name}: at most {_MEASURED_PER_KM2} places measured per km²",
            n_measured <= _MEASURED_PER_KM2 * line.truth.area_km2,
            f"{n_measured} on {line.truth.area_km2:.4f} km²",
        )
        yield WorkCheck(
            f"{line.name}: not all of them are looked at closely",
            0 < n_looks < n_measured,
            f"{n_looks} of {n_measured}",
        )
        yield WorkCheck(
            f"{line.name}: no place is left out by a budget",
            not _count(default.runs[line.name], "detect.windows_cut"),
            "",
        )
        less = budgeted.runs[line.name]
        yield WorkCheck(
            f"{line.name}: a duty of {DUTIES[0]:g} leaves the cascade and close looks out, and covers less but not "
            "nothing",
            _count(less, "detect.evaluations") < n_evaluations
            and not _count(less, "confirm.looked_at")
            and 0.0 < less.covered_km2 < default.runs[line.name].covered_km2,
            f"{_count(less, 'detect.evaluations')} comparisons, {less.covered_km2:.4f} km²",
        )
    first = lines[0].name
    same = again.runs[first].contacts_sha256 == default.runs[first].contacts_sha256
    yield WorkCheck("a second run gives the same contacts", same, again.runs[first].contacts_sha256[:12])


def _count(run: MissionCost, name: str) -> int:
    return run.counters.get(name, 0)
