"""Compare a convolutional verifier with the odds of what a close look measures, on domains left out.

auv-mcm bench verifier --looks FOLDER              flies, trains, judges and prints; needs the extra `verifier`
auv-mcm bench verifier --looks FOLDER --log LINE   recorded lines with embedded targets, judged and never fitted on

The network sees chips of the waterfall, normalised for geometry, and nothing that was measured; the trees see what was
measured and no chip. Both are fitted on the same missions and judged on domains that neither knows. The sum of both
weighs them by a logistic regression on the domains that are not judged, by scores that were left out there too.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim_replay.arguments import count
from sim_replay.augment.recorded_line import check_lines
from sim_replay.fitting.cascade.farm import Farm, run_tasks
from sim_replay.fitting.fit_odds import offset_of
from sim_replay.fitting.left_out import (
    COMPARED_PER_KM2,
    FIRST_SEED,
    LIMITS_PER_KM2,
    RECIPES,
    Scored,
    dealt,
    difference,
    error_of,
    fitted_on,
    groups_of,
    is_judged,
    is_of,
    left_out_scores,
    left_out_tasks,
    pd_at,
)
from sim_replay.fitting.looks import MissionLooks, all_looks
from sim_replay.fitting.recorders import RECORDERS
from sim_replay.fitting.verifier.flown_chips import Chips, all_chips
from sim_replay.fitting.verifier.network import N_EPOCHS, log_odds_of_chips, read_network, train
from sim_replay.missions import SCENES
from sim_replay.scoring.intervals import proportion
from sim_replay.text_tables import columns, markdown, share_cell

TREES: Final = "trees"
NETWORK: Final = "network"
BOTH: Final = "both"
_RECIPE: Final = RECIPES["scenes and drawn"]
_N_TIMED: Final = 300  # chips scored one by one: their mean time is then known to some percent


class FoldTask(NamedTuple):
    """Hold what a network is trained on, (n, ...) each, and the chips that it then scores, mission by mission."""

    chips: Chips
    is_target: NDArray[np.bool_]
    weight: NDArray[np.float64]
    judged: tuple[Chips, ...]
    n_epochs: int


class FoldScores(NamedTuple):
    """Hold a trained network as ONNX, and the log-odds (n,) that it gives each mission to be judged."""

    onnx: bytes
    log_odds: tuple[NDArray[np.float64], ...]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `auv-mcm bench verifier`."""
    parser.add_argument(
        "--looks", type=Path, metavar="FOLDER", required=True, help="folder that keeps what looks measured, and chips"
    )
    parser.add_argument("--crowded", type=count, default=3, help="crowded missions per scene (default 3)")
    parser.add_argument("--drawn", type=count, default=48, help="drawn missions (default 48)")
    parser.add_argument(
        "--log", type=Path, action="append", default=[], metavar="FILE", help="a recorded line, XTF; repeatable"
    )
    parser.add_argument("--log-seeds", type=count, default=7, help="draws of targets per recorded line (default 7)")
    parser.add_argument("--folds", type=count, default=3, metavar="N", help="parts of the domains (default 3)")
    parser.add_argument("--epochs", type=count, default=N_EPOCHS, help=f"passes over the chips (default {N_EPOCHS})")
    parser.add_argument("--workers", type=count, default=2, help="missions flown at once (default 2)")
    parser.add_argument("--markdown", action="store_true", help="print the table in Markdown")


def run(arguments: argparse.Namespace) -> int:
    """Fly, train, judge and print; returns the exit code.

    Raises UsageError without PyTorch, for a folder that cannot be made and a line without room for a seed's objects,
    BadInputError for an unreadable log.
    """
    check_lines(arguments.log, range(FIRST_SEED, FIRST_SEED + arguments.log_seeds))
    tasks = left_out_tasks(
        SCENES,
        n_seeds=1,
        n_crowded=arguments.crowded,
        n_drawn=arguments.drawn,
        recorders=list(RECORDERS),
        logs=arguments.log,
        n_log_seeds=arguments.log_seeds,
    )
    farm = Farm(arguments.workers)
    missions = all_looks(tasks, arguments.looks, farm, _show)
    chips = all_chips(missions, arguments.looks, farm, _show)
    lines = frozenset(log.stem for log in arguments.log)
    folds = dealt(missions, arguments.folds)
    print(compared(missions, chips, lines, folds, arguments.epochs, farm, in_markdown=arguments.markdown))
    return 0


def compared(
    missions: Sequence[MissionLooks],
    chips: Sequence[Chips],
    lines: frozenset[str],
    folds: Sequence[frozenset[str]],
    n_epochs: int,
    farm: Farm,
    *,
    in_markdown: bool = False,
) -> str:
    """Lay out a row per domain and method, then the network's cost. lines: domains that are never fitted on."""
    by_method = {TREES: left_out_scores(missions, _RECIPE, lines, folds)}
    by_method[NETWORK], onnx = network_scores(missions, chips, lines, folds, n_epochs, farm)
    by_method[BOTH] = summed_scores(by_method[TREES], by_method[NETWORK], folds)
    header = ["domain", "method", "looks at targets", "km²"]
    header += [f"Pd at {limit:g} FA/km²" for limit in LIMITS_PER_KM2]
    header += ["calibration error", f"Pd at {COMPARED_PER_KM2:g} less that of the trees"]
    rows = [
        _row(group, method, some, by_method[TREES], of)
        for group, of in groups_of(missions).items()
        for method, some in by_method.items()
    ]
    n_targets = sum(int(one.looks.is_target.sum()) for one in missions if one.task.domain not in lines)
    table = (markdown if in_markdown else columns)(header, rows)
    return f"{table}\n\n{n_targets} looks at targets to train on and judge, lines besides\n{_cost(onnx, chips)}"


def network_scores(
    missions: Sequence[MissionLooks],
    chips: Sequence[Chips],
    lines: frozenset[str],
    folds: Sequence[frozenset[str]],
    n_epochs: int,
    farm: Farm,
) -> tuple[list[Scored], bytes]:
    """Judge every mission of each fold by a network trained without the fold's domains; returns the last one too."""
    of_mission = {one.task: own for one, own in zip(missions, chips, strict=True)}
    tasks, judged, usual = [], [], []
    for out in folds:
        training = fitted_on(missions, _RECIPE, out, lines)
        judged.append([one for one in missions if is_of(one, out)])
        usual.append([one for one in fitted_on(missions, RECIPES["scenes"], out, lines) if is_judged(one)])
        tasks.append(
            FoldTask(
                np.concatenate([of_mission[one.task] for one in training]),
                np.concatenate([one.looks.is_target for one in training]),
                np.concatenate([one.looks.weight for one in training]),
                tuple(of_mission[one.task] for one in (*judged[-1], *usual[-1])),
                n_epochs,
            )
        )
    scores, onnx = [], b""
    for found, own, others in zip(run_tasks(_trained, tasks, farm), judged, usual, strict=True):
        onnx = found.onnx
        shift = offset_of(
            np.concatenate(found.log_odds[len(own) :]),
            np.concatenate([one.looks.is_target for one in others]),
            np.concatenate([one.looks.weight for one in others]),
        )
        for one, log_odds in zip(own, found.log_odds, strict=False):
            looks = one.looks
            scores.append(
                Scored(one.task.domain, log_odds + shift, looks.is_target, looks.weight, one.n_targets, one.area_km2)
            )
    return scores, onnx


def summed_scores(one: Sequence[Scored], other: Sequence[Scored], folds: Sequence[frozenset[str]]) -> list[Scored]:
    """Add two log-odds of the same looks, weighed by what the other folds show; missions in the same order."""
    from scipy.optimize import minimize

    found = []
    for out in folds:
        known = [(a, b) for a, b in zip(one, other, strict=True) if a.domain not in out]
        both = np.column_stack([np.concatenate([pair[side].log_odds for pair in known]) for side in (0, 1)])
        columns_ = np.column_stack([both, np.ones(len(both))])
        target = np.concatenate([a.is_target for a, _ in known]).astype(np.float64)
        weight = np.concatenate([a.weight for a, _ in known])

        def loss(
            at: NDArray[np.float64],
            columns_: NDArray[np.float64] = columns_,
            target: NDArray[np.float64] = target,
            weight: NDArray[np.float64] = weight,
        ) -> float:
            log_odds = columns_ @ at
            return float(weight @ (np.logaddexp(0.0, log_odds) - target * log_odds))

        first, second, offset = minimize(loss, np.array([0.5, 0.5, 0.0]), method="BFGS").x.tolist()
        found += [
            a._replace(log_odds=first * a.log_odds + second * b.log_odds + offset)
            for a, b in zip(one, other, strict=True)
            if a.domain in out
        ]
    return found


def _trained(task: FoldTask) -> FoldScores:
    onnx = train(task.chips, task.is_target, task.weight, task.n_epochs)
    network = read_network(onnx)
    return FoldScores(onnx, tuple(log_odds_of_chips(network, chips) for chips in task.judged))


def _row(group: str, method: str, some: Sequence[Scored], trees: Sequence[Scored], of: frozenset[str]) -> list[str]:
    own = [one for one in some if one.domain in of]
    n_targets = sum(one.n_targets for one in own)
    error = error_of(own)
    gain = "-"
    if group.startswith("all ") and method != TREES:
        value, low, high = difference(own, [one for one in trees if one.domain in of])
        gain = f"{value:+.3f} ({low:+.3f} to {high:+.3f})"
    pds = [proportion(round(pd_at(own, limit) * n_targets), n_targets) for limit in LIMITS_PER_KM2]
    return [
        group,
        method,
        str(n_targets),
        f"{sum(one.area_km2 for one in own):.3f}",
        *map(share_cell, pds),
        "-" if error is None else f"{error:.3f}",
        gain,
    ]


def _cost(onnx: bytes, chips: Sequence[Chips]) -> str:
    """Measure what scoring costs, one chip at a time and many together, in processor time."""
    some = np.concatenate([own for own in chips if len(own)])[:_N_TIMED]
    network = read_network(onnx)
    log_odds_of_chips(network, some[:1])  # the first lays out its memory
    started_s = time.process_time()
    for chip in some:
        log_odds_of_chips(network, chip[None])
    one_s = (time.process_time() - started_s) / len(some)
    started_s = time.process_time()
    log_odds_of_chips(network, some)
    together_s = (time.process_time() - started_s) / len(some)
    return (
        f"the network: {len(onnx) / 1000.0:.0f} kB; {1e3 * one_s:.2f} ms of processor time a chip alone, "
        f"{1e3 * together_s:.2f} ms among {len(some)}"
    )


def _show(done: int, of: int) -> None:
    print(f"\r{done} of {of} missions flown", end="" if done < of else "\n", file=sys.stderr, flush=True)
