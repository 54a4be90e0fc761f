"""Judge p_mine on whole domains: every named scene, kind of recorder and recorded line, with what ships.

auv-mcm bench domains                             flies, judges and prints
auv-mcm bench domains --log LINE.xtf              a recorded line with embedded targets as a further domain

The weights that ship were fitted on the named scenes but seagrass, with other seeds; no recorded line taught them, and
of the recorders only 16-bit amplitude of one look. Pd is at the threshold that gives the false alarms.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.detect.belief import probability
from sim_replay.benches.experiment import Cell, Column, Experiment, Task, density, number, share
from sim_replay.fitting.fit_background import SortedContacts, flown_along, flown_scene
from sim_replay.fitting.recorders import RECORDED_SCENES, RECORDERS, recorded_by
from sim_replay.missions import FIRST_SEED, SCENES
from sim_replay.scoring.calibration import Calibration, calibration
from sim_replay.scoring.intervals import density as area_density
from sim_replay.scoring.intervals import proportion
from sim_replay.scoring.thresholds import threshold_at
from sim_replay.simulator.scene_file import named_scenes, read_scene
from sim_replay.text_tables import NOTHING, columns, share_cell

LIMITS_PER_KM2: Final = (10.0, 100.0, 300.0)
"""False alarms per km² at which Pd is compared."""
FIXED_P_MINE: Final = 0.2  # what a fixed threshold reaches, which the operating point replaces


OWN: Final = "own"  # recorder of the scene or line
_RELIABILITY_HEADER: Final = ("domains", "p_mine", "contacts", "mean p_mine", "on mines")


def fly(task: Task) -> dict[str, SortedContacts]:
    """Fly one mission with what ships, and with further recorders, and sort its contacts."""
    if task.scene not in named_scenes():
        return {OWN: flown_along(Path(task.scene), task.seed)}
    scene = msgspec.structs.replace(read_scene(task.scene), seed=task.seed)
    asked = RECORDERS if task.scene in RECORDED_SCENES and not task.options["no_recorders"] else {}
    return {OWN: flown_scene(task.scene, scene, "cascade")} | {
        name: flown_scene(name, recorded_by(scene, recorder), "cascade") for name, recorder in asked.items()
    }


def grouped(missions: Sequence[SortedContacts]) -> dict[str, list[SortedContacts]]:
    """Group missions by domain, then pool all scenes, all recorders and all recorded lines where there are several."""
    groups = {
        name: [one for one in missions if one.scene == name] for name in dict.fromkeys(one.scene for one in missions)
    }
    kinds = {
        "all scenes": [name for name in groups if name in named_scenes()],
        "all recorders": [name for name in groups if name in RECORDERS],
        "all recorded lines": [name for name in groups if name not in named_scenes() and name not in RECORDERS],
    }
    pooled = {
        title: [one for name in names for one in groups[name]] for title, names in kinds.items() if len(names) > 1
    }
    return groups | pooled


def n_found_at(missions: Sequence[SortedContacts], limit_per_km2: float) -> int:
    """Count the targets that the best threshold of p_mine finds with so many false alarms per km² or fewer."""
    n_allowed = limit_per_km2 * sum(one.truth_km2 for one in missions)
    above = threshold_at(np.concatenate([one.background for one in missions]), n_allowed)
    return sum(int(np.count_nonzero(one.mines > above)) for one in missions)


def reliability(missions: Sequence[SortedContacts]) -> Calibration:
    """Compare p_mine of all contacts with what they lie on."""
    return calibration(*_sorted_out(missions))


def _sorted_out(missions: Sequence[SortedContacts]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Collect p_mine of all contacts, (n,), and what is a mine."""
    log_odds = np.concatenate([part for one in missions for part in (one.background, one.mines)])
    n_each = [len(part) for one in missions for part in (one.background, one.mines)]
    return np.array([probability(value) for value in log_odds]), np.repeat([False, True] * len(missions), n_each)


def _n_targets(missions: Sequence[SortedContacts]) -> int:
    return sum(one.n_targets for one in missions)


def _area_km2(missions: Sequence[SortedContacts]) -> float:
    return sum(one.truth_km2 for one in missions)


def _n_reaching(missions: Sequence[SortedContacts], part: str) -> int:
    """Count mines or background at the fixed threshold or above."""
    level = float(np.log(FIXED_P_MINE) - np.log1p(-FIXED_P_MINE))
    return sum(int(np.count_nonzero(getattr(one, part) >= level)) for one in missions)


def _pd(missions: Sequence[SortedContacts], limit_per_km2: float) -> Cell:
    return share(proportion(n_found_at(missions, limit_per_km2), _n_targets(missions)))


def _quality(missions: Sequence[SortedContacts], measure: Callable[..., float | None]) -> Cell:
    """Measure p_mine against what contacts lie on."""
    p_mine, is_mine = _sorted_out(missions)
    value = measure(p_mine, is_mine) if len(p_mine) else None
    return Cell(NOTHING) if value is None else number(value, 3)


def _error(p: NDArray[np.float64], is_mine: NDArray[np.bool_]) -> float | None:
    return calibration(p, is_mine).error


def _words(flown: Sequence[Mapping[str, SortedContacts]]) -> str:
    """Lay out the reliability of the pooled domains, or of each where there are no pools."""
    groups = grouped([one for each in flown for one in each.values()])
    pooled = [name for name in groups if name.startswith("all ")] or list(groups)
    rows = [row for name in pooled for row in _reliability_rows(name, reliability(groups[name]))]
    return columns(_RELIABILITY_HEADER, rows)


def _add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--no-recorders", action="store_true", help="leave out the recorders")


def _reliability_rows(name: str, found: Calibration) -> list[list[str]]:
    return [
        [name, f"{one.low:g} to {one.high:g}", str(one.on_mines.of), f"{one.mean_p_mine:.3f}", share_cell(one.on_mines)]
        for one in found.bins
    ]


def _log_loss(p: NDArray[np.float64], is_mine: NDArray[np.bool_]) -> float:
    bounded = np.clip(p, 1e-6, 1.0 - 1e-6)
    return float(-np.where(is_mine, np.log(bounded), np.log1p(-bounded)).mean())


EXPERIMENT: Final = Experiment(
    name="domains",
    scenes=SCENES,
    first_seed=FIRST_SEED,
    n_seeds=2,
    n_draws=8,
    variant_title="recorder",
    variants=(OWN, *RECORDERS),
    fly=fly,
    columns=(
        Column("targets", lambda missions: number(_n_targets(missions))),
        Column("km²", lambda missions: number(_area_km2(missions), 4)),
        *(Column(f"Pd at {limit:g} FA/km²", partial(_pd, limit_per_km2=limit)) for limit in LIMITS_PER_KM2),
        Column(
            f"Pd at p_mine {FIXED_P_MINE:g}",
            lambda missions: share(proportion(_n_reaching(missions, "mines"), _n_targets(missions))),
        ),
        Column(
            f"FA/km² at p_mine {FIXED_P_MINE:g}",
            lambda missions: density(area_density(_n_reaching(missions, "background"), _area_km2(missions))),
        ),
        Column("calibration error", partial(_quality, measure=_error)),
        Column("log loss", partial(_quality, measure=_log_loss)),
    ),
    add_options=_add_options,
    own_options=("no_recorders",),
    words=_words,
)
