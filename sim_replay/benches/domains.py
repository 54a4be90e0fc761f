"""Judge p_mine on whole domains: every named scene, kind of recorder and recorded line, with what ships.

auv-mcm bench domains                             flies, judges and prints
auv-mcm bench domains --log LINE.xtf              a recorded line with embedded targets as a further domain
auv-mcm bench domains --plot FILE                 draws the reliability of every domain as well

The weights that ship were fitted on the named scenes but seagrass, with other seeds; no recorded line taught them, and
of the recorders only 16-bit amplitude of one look. Pd is at the threshold that gives the false alarms.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.contacts.background import BIN_NATS, LEVELS_NATS, shipped_background
from auv_mcm.detect.belief import probability
from auv_mcm.errors import UsageError
from sim_replay.augment.recorded_line import check_lines
from sim_replay.benches.mission_options import (
    add_line_options,
    add_scene_options,
    chosen_draws,
    chosen_scenes,
    chosen_seeds,
)
from sim_replay.benches.point import Judged, fly_augmented, judged
from sim_replay.benches.progress import counted
from sim_replay.fitting.cascade.farm import Farm, run_tasks
from sim_replay.fitting.fit_background import SortedContacts, flown_scene
from sim_replay.fitting.left_out import LIMITS_PER_KM2
from sim_replay.fitting.recorders import RECORDED_SCENES, RECORDERS, recorded_by
from sim_replay.missions import FIRST_SEED
from sim_replay.scoring.calibration import Calibration, calibration
from sim_replay.scoring.intervals import density, proportion
from sim_replay.scoring.thresholds import threshold_at
from sim_replay.simulator.scene_file import named_scenes, read_scene
from sim_replay.text_tables import columns, density_cell, markdown, share_cell

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FIXED_P_MINE: Final = 0.2  # what a fixed threshold reaches, which the operating point replaces


_HEADER: Final = (
    "domain",
    "targets",
    "km²",
    *(f"Pd at {limit:g} FA/km²" for limit in LIMITS_PER_KM2),
    f"Pd at p_mine {FIXED_P_MINE:g}",
    f"FA/km² at p_mine {FIXED_P_MINE:g}",
    "calibration error",
    "within the mission",
    "log loss",
    "within the mission",
)
_RELIABILITY_HEADER: Final = ("domains", "p_mine", "contacts", "mean p_mine", "on mines")
_RESOLUTION_DPI: Final = 120  # legible where the page is half as wide
_COLUMNS: Final = 4  # diagrams beside one another


class Domain(NamedTuple):
    """Name a mission of a domain.

    source: a named scene or the path of a recorded line. recorder: of RECORDERS, for scenes alone.
    """

    source: str
    seed: int
    recorder: str | None = None


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `auv-mcm bench domains`."""
    add_scene_options(parser, FIRST_SEED)
    parser.add_argument("--no-recorders", action="store_true", help="leave out the recorders")
    add_line_options(parser, 8)
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw reliability diagrams (.png, .svg, .pdf)")


def run(arguments: argparse.Namespace) -> int:
    """Fly, judge and print; returns the exit code.

    Raises UsageError for unknown scenes, BadInputError for an unreadable log.
    """
    names = chosen_scenes(arguments.scenes)
    seeds = chosen_seeds(arguments)
    recorders = [] if arguments.no_recorders else list(RECORDERS)
    tasks = [Domain(name, seed) for name in names for seed in seeds]
    tasks += [Domain(name, seed, recorder) for recorder in recorders for name in RECORDED_SCENES for seed in seeds]
    log_seeds = chosen_draws(arguments)
    check_lines(arguments.log, log_seeds)
    tasks += [Domain(str(log), seed) for log in arguments.log for seed in log_seeds]
    missions = list(run_tasks(fly_domain, tasks, Farm(arguments.workers), counted(len(tasks))))
    groups = grouped(missions)
    print(report(groups, in_markdown=arguments.markdown))
    if arguments.plot is not None:
        save_diagrams(groups, arguments.plot)
    return 0


def fly_domain(task: Domain) -> SortedContacts:
    """Fly one mission of a domain with what ships, and sort its contacts."""
    if task.source not in named_scenes():
        return fly_augmented(Path(task.source), task.seed)
    scene = msgspec.structs.replace(read_scene(task.source), seed=task.seed)
    if task.recorder is None:
        return flown_scene(task.source, scene, "cascade")
    return flown_scene(task.recorder, recorded_by(scene, RECORDERS[task.recorder]), "cascade")


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


def pd_at(missions: Sequence[SortedContacts], limit_per_km2: float) -> int:
    """Count the targets that the best threshold of p_mine finds with so many false alarms per km² or fewer."""
    n_allowed = limit_per_km2 * sum(one.truth_km2 for one in missions)
    above = threshold_at(np.concatenate([one.background for one in missions]), n_allowed)
    return sum(int(np.count_nonzero(one.mines > above)) for one in missions)


def reliability(missions: Sequence[SortedContacts]) -> Calibration:
    """Compare p_mine of all contacts with what they lie on."""
    log_odds = np.concatenate([part for one in missions for part in (one.background, one.mines)])
    is_mine = np.concatenate(
        [
            np.full(len(part), on_mine)
            for one in missions
            for part, on_mine in ((one.background, False), (one.mines, True))
        ]
    )
    return calibration([probability(value) for value in log_odds], is_mine)


def within_mission(one: Judged) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Compute p_mine as it is, and as the mission's own mines and background would have it.

    Returns both, (n,) each, and what is a mine.
    """
    log_odds = np.concatenate([one.mission.background, one.mission.mines])
    reaching = np.exp(one.background.middle)
    background = np.maximum(reaching - np.append(reaching[1:], 0.0), 1e-300)
    off = (LEVELS_NATS + 0.5 * BIN_NATS - one.prior.mine_mean_nats) / one.prior.mine_sd_nats
    mines = (
        one.background.mines_per_km2
        * np.exp(-0.5 * off**2)
        / (np.sqrt(2.0 * np.pi) * one.prior.mine_sd_nats)
        * BIN_NATS
    )
    share = mines / (mines + background)
    number = np.clip(np.searchsorted(LEVELS_NATS, log_odds, side="right") - 1, 0, len(LEVELS_NATS) - 1)
    is_mine = np.arange(len(log_odds)) >= len(one.mission.background)
    return np.array([probability(value) for value in log_odds]), share[number], is_mine


def report(groups: Mapping[str, Sequence[SortedContacts]], *, in_markdown: bool = False) -> str:
    """Lay out a row per domain, and the reliability of the pooled ones."""
    laid_out = markdown if in_markdown else columns
    pooled = [name for name in groups if name.startswith("all ")] or list(groups)
    rows = [row for name in pooled for row in _reliability_rows(name, reliability(groups[name]))]
    domains = laid_out(_HEADER, [_row(name, missions) for name, missions in groups.items()])
    return domains + "\n\n" + laid_out(_RELIABILITY_HEADER, rows)


def save_diagrams(groups: Mapping[str, Sequence[SortedContacts]], path: Path) -> None:
    """Draw the share of contacts on mines over p_mine, a diagram per domain.

    The suffix chooses the format. Raises UsageError for one that is not a picture format or a file that cannot be
    written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    n_rows = -(-len(groups) // _COLUMNS)
    figure = Figure(figsize=(3.0 * _COLUMNS, 2.8 * n_rows), dpi=_RESOLUTION_DPI, layout="constrained")
    known = FigureCanvasAgg(figure).get_supported_filetypes()
    if path.suffix.lower().lstrip(".") not in known:
        raise UsageError(f"--plot {path}: '{path.suffix}' is not a picture format. Use a name that ends in .png")
    for number, (name, missions) in enumerate(groups.items(), 1):
        _draw(figure, n_rows, number, name, reliability(missions))
    try:
        figure.savefig(path)
    except OSError as error:
        raise UsageError(f"--plot {path} cannot be written: {error.strerror}") from error


def _draw(figure: Figure, n_rows: int, number: int, name: str, found: Calibration) -> None:
    axes = figure.add_subplot(n_rows, _COLUMNS, number)
    shares = [one.on_mines for one in found.bins]
    middle = np.array([one.mean_p_mine for one in found.bins])
    value, low, high = (
        np.array([getattr(share, part) or 0.0 for share in shares]) for part in ("value", "low", "high")
    )
    axes.plot([0.0, 1.0], [0.0, 1.0], color="0.6", linewidth=1.0)
    axes.errorbar(middle, value, yerr=np.abs([value - low, high - value]), fmt="o", markersize=3.0, color="#1f4e79")
    error = "" if found.error is None else f", error {found.error:.3f}"
    axes.set_title(f"{name}{error}", fontsize=9)
    axes.set_xlim(0.0, 1.0)
    axes.set_ylim(0.0, 1.0)
    axes.set_xlabel("p_mine", fontsize=8)
    axes.set_ylabel("share on mines", fontsize=8)


def _row(name: str, missions: Sequence[SortedContacts]) -> list[str]:
    n_targets = sum(one.n_targets for one in missions)
    area_km2 = sum(one.truth_km2 for one in missions)
    level = float(np.log(FIXED_P_MINE) - np.log1p(-FIXED_P_MINE))
    n_called, n_false_alarms = (
        sum(int(np.count_nonzero(part >= level)) for part in parts)
        for parts in ([one.mines for one in missions], [one.background for one in missions])
    )
    some = [judged(mission, shipped_background()) for mission in missions]
    plain, within, is_mine = (np.concatenate(parts) for parts in zip(*map(within_mission, some), strict=True))
    errors = [calibration(p, is_mine).error for p in (plain, within)]
    losses = [_log_loss(p, is_mine) if len(p) else None for p in (plain, within)]
    numbers = ["-" if value is None else f"{value:.3f}" for pair in zip(errors, losses, strict=True) for value in pair]
    return [
        name,
        str(n_targets),
        f"{area_km2:.4f}",
        *(share_cell(proportion(pd_at(missions, limit), n_targets)) for limit in LIMITS_PER_KM2),
        share_cell(proportion(n_called, n_targets)),
        density_cell(density(n_false_alarms, area_km2)),
        numbers[0],
        numbers[2],
        numbers[1],
        numbers[3],
    ]


def _reliability_rows(name: str, found: Calibration) -> list[list[str]]:
    return [
        [
            name,
            f"{one.low:g} to {one.high:g}",
            str(one.on_mines.of),
            f"{one.mean_p_mine:.3f}",
            share_cell(one.on_mines),
        ]
        for one in found.bins
    ]


def _log_loss(p: NDArray[np.float64], is_mine: NDArray[np.bool_]) -> float:
    bounded = np.clip(p, 1e-6, 1.0 - 1e-6)
    return float(-np.where(is_mine, np.log(bounded), np.log1p(-bounded)).mean())
