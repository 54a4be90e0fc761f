"""Measure what knowing the scene's priors is worth: a network trained on the very scenes, beside the odds that ship.

auv-mcm bench priors --looks FOLDER               flies, trains, judges and prints

The network knows what objects and sea floor its scenes hold and how often, but of a look neither pose nor kind nor
floor: an honest bound for any odds on these looks. Missions have five times as many mines and stones as the scenes.
Needs PyTorch, the extra `verifier`.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from auv_mcm.classify.odds import shipped_odds
from auv_mcm.classify.verifier import network_of, parse_network, rest_ratio
from auv_mcm.errors import UsageError
from sim_replay.arguments import count
from sim_replay.benches.experiment import counted
from sim_replay.fitting.cascade.farm import Farm
from sim_replay.fitting.looks import LookTask
from sim_replay.fitting.verifier.mill import OTHER, fly_all
from sim_replay.fitting.verifier.own import TIMES, can_train, shipped_network
from sim_replay.fitting.verifier.train import started_from, train, written_as_onnx
from sim_replay.fitting.verifier.weigh import Array, Looks, auc_of, chips_of, log_odds_of, looks_of, pd_at
from sim_replay.missions import SCENES
from sim_replay.text_tables import columns

FIRST_SEED: Final = 62_000  # of missions that nothing else is fitted or judged on
_FOUND: Final = 0.9  # of the mines with a detection, at which other objects that score as high are counted
_COLUMNS: Final[dict[str, Callable[[Looks, Array], float]]] = {
    "Pd at 30 FA/km²": lambda one, odds: pd_at(one, odds, 30.0, others=False),
    "at 100": lambda one, odds: pd_at(one, odds, 100.0, others=False),
    "other objects counted, at 30": lambda one, odds: pd_at(one, odds, 30.0, others=True),
    "at 100 ": lambda one, odds: pd_at(one, odds, 100.0, others=True),
    "AUC": auc_of,
    f"other objects above {_FOUND:g} of mines": lambda one, odds: others_above(one, odds, _FOUND),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the bench."""
    parser.add_argument(
        "--scenes", default="flat,ripple,mixed", metavar="NAMES", help="named scenes (default flat,ripple,mixed)"
    )
    parser.add_argument("--looks", type=Path, required=True, metavar="DIR", help="folder of missions flown, kept")
    parser.add_argument("--missions", type=count, default=26, help="to train on, of each scene (default 26)")
    parser.add_argument("--judged", type=count, default=12, help="left out, of each scene (default 12)")
    parser.add_argument("--passes", type=count, default=20, help="over the chips (default 20)")
    parser.add_argument("--further", action="store_true", help="train the network that ships further, as 'train' does")
    parser.add_argument("--workers", type=count, default=2, help="missions at once (default 2)")


def run(arguments: argparse.Namespace) -> int:
    """Fly what is missing, train, judge and print."""
    names = arguments.scenes.split(",")
    if unknown := sorted(set(names) - set(SCENES)):
        raise UsageError(f"--scenes: there is no scene {', '.join(unknown)}. Known: {', '.join(SCENES)}")
    if not can_train():
        raise UsageError("bench priors needs PyTorch: python -m pip install 'auv-mcm[verifier]'")
    seeds = range(FIRST_SEED, FIRST_SEED + arguments.judged + arguments.missions)
    tasks = [LookTask(name, seed, TIMES) for seed in seeds for name in names]
    show = counted(len(tasks))
    places = fly_all(tasks, arguments.looks, Farm(arguments.workers), lambda done, of: show(done))
    n_judged = arguments.judged * len(names)
    chips = chips_of(places[n_judged:])
    start = started_from(shipped_network()) if arguments.further else None
    own = parse_network(written_as_onnx(train(chips, arguments.passes, start=start)), "the network")
    odds = shipped_odds("cascade")
    assert odds.verifier is not None
    shipped = network_of(odds.verifier.digest)
    groups = [task.source for task in tasks[:n_judged]]
    found: dict[str, list[tuple[Looks, Array]]] = {"what ships": [], "network of these scenes alone": []}
    for place, group in zip(places[:n_judged], groups, strict=True):
        one = looks_of(place, group, shipped, odds)
        found["what ships"].append((one, log_odds_of(one, odds.verifier)))
        one = looks_of(place, group, own, odds)
        found["network of these scenes alone"].append((one, rest_ratio(one.scores, 0.0)))
    print(f"{len(chips.label)} chips of {len(places) - n_judged} missions\n")
    print(table(found))
    return 0


def table(found: dict[str, list[tuple[Looks, Array]]]) -> str:
    """Lay out means over missions with their 95 % intervals, for each scene and all."""
    missions = next(iter(found.values()))
    groups = list(dict.fromkeys(one.group for one, _ in missions))
    rows = []
    for group in (*groups, "all"):
        for by, pairs in found.items():
            own = [pair for pair in pairs if group in ("all", pair[0].group)]
            rows.append([group, by, *(_mean([figure(*pair) for pair in own]) for figure in _COLUMNS.values())])
    return columns(["missions", "by", *_COLUMNS], rows)


def others_above(one: Looks, odds: Array, found: float) -> float:
    """Compute the share of other objects at least as high as a share of the mines; NaN without either."""
    mines, others = (odds[one.first & is_kind] for is_kind in (one.label < OTHER, one.label == OTHER))
    if not len(mines) or not len(others):
        return float("nan")
    return float(np.mean(others >= np.quantile(mines, 1.0 - found)))


def _mean(values: Sequence[float]) -> str:
    """Write a mean over missions with its 95 % interval, of their scatter."""
    known = np.array([value for value in values if np.isfinite(value)])
    if len(known) < 2:
        return f"{known[0]:.2f}" if len(known) else "-"
    low, high = np.clip(known.mean() + np.array([-1.96, 1.96]) * known.std(ddof=1) / np.sqrt(len(known)), 0.0, 1.0)
    return f"{known.mean():.2f} ({low:.2f}-{high:.2f})"
