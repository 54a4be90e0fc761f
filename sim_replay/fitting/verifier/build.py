"""Fly, train, weigh and judge: everything behind the verifier that ships, `auv-mcm calibrate verifier`."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Final, NamedTuple

import msgspec
import numpy as np

from auv_mcm import __version__
from auv_mcm.classify.odds import MineOdds, Verification, shipped_odds
from auv_mcm.classify.verifier import CLASSES, FILE, MINE_KINDS, parse_network, rest_ratio
from auv_mcm.errors import UsageError
from sim_replay.fitting.cascade.farm import Farm
from sim_replay.fitting.fit_odds import written
from sim_replay.fitting.looks import DRAWN, LookTask
from sim_replay.fitting.recorders import RECORDED_SCENES, RECORDERS
from sim_replay.fitting.verifier.mill import DENSE, FIRST_PATCHES, FIRST_SEED, FIRST_SHELLY, FIRST_SLABS, MINE, fly_all
from sim_replay.fitting.verifier.train import ChipTable, needs_packages, train, written_as_onnx
from sim_replay.fitting.verifier.weigh import (
    LIMITS_PER_KM2,
    Array,
    Looks,
    auc_of,
    chips_of,
    log_odds_of,
    looks_of,
    pd_at,
    weighed,
)
from sim_replay.missions import SCENES
from sim_replay.text_tables import columns

N_JUDGED: Final = 36
"""Dense drawn missions, the first, that the network is never trained on."""
N_MISSIONS: Final = 745
"""Dense drawn missions that the shipped network was trained on."""
_N_LATER: Final = (12, 10)  # missions with slabs, and with patches, that the network is never trained on
_LEARNT: Final = (
    *range(FIRST_SEED + N_JUDGED, FIRST_SEED + 256),
    *range(FIRST_SHELLY, FIRST_SHELLY + 277),
    *range(FIRST_SLABS + _N_LATER[0], FIRST_SLABS + 170),
    *range(FIRST_PATCHES + _N_LATER[1], FIRST_PATCHES + 10_000),
)
SCENE_SEEDS: Final = (1200,)
"""Seeds of missions of named scenes, which weights are fitted on."""
USUAL_SEEDS: Final = range(FIRST_SEED + 10_000, FIRST_SEED + 10_040)
"""Seeds of drawn missions with as many mines as the wide world has, which weights are fitted on as well."""
USUAL: Final = ("scenes", "drawn")
"""Groups of missions as dense as missions are."""
_DENSE: Final = "drawn, dense"
_LATER: Final = ("slabs", "slabs, patches")
_RECORDED: Final = "recorders"
_BINS: Final = (0.0, 0.02, 0.1, 0.3, 0.5, 0.7, 0.9, 0.97, 1.0)  # of p_mine


class Built(NamedTuple):
    """Hold the network's file, the odds with its weights, and tables of how both do on missions left out."""

    onnx: bytes
    odds: MineOdds
    tables: str


def build(
    folder: Path, n_missions: int, farm: Farm, show: Callable[[int, int], None], say: Callable[[str], None]
) -> Built:
    """Fly what is not in the folder, train the network, fit its weights, and judge both.

    Parameters
    ----------
    folder
        Of missions: those already there are not flown again.
    n_missions
        Drawn missions to train on.
    show
        Takes the missions flown and how many there are.
    say
        Takes lines about the training.

    Raises
    ------
    UsageError
        Without PyTorch, and for a folder that cannot be written to.
    BadInputError
        For a damaged file in it.
    """
    needs_packages()
    learnt, judged = missions(n_missions)
    places = fly_all(learnt, folder, farm, show)
    judged_places = fly_all([task for _, task in judged], folder, farm, show)
    chips = chips_of(places)
    by_class = np.bincount(chips.label, minlength=len(CLASSES))
    counts = [int(by_class[: len(MINE_KINDS)].sum()), *by_class[len(MINE_KINDS) :].tolist()]
    digest = digest_of(chips)
    say(f"{len(places)} missions, looks at mines, other objects, floor: {counts}")
    network = train(chips, show=lambda epoch, loss, _: say(f"pass {epoch}: log-loss {loss:.4f}"))
    onnx = written_as_onnx(network)
    return weigh_and_judge(
        onnx,
        [group for group, _ in judged],
        judged_places,
        f"{counts[0]} looks at mines, {counts[1]} at other objects, {counts[2]} at floor of {len(places)} drawn "
        f"missions, seeds {runs_of([task.seed for task in learnt])}; chips' SHA-256 {digest}",
    )


def write_built(built: Built, folder: Path) -> None:
    """Write verifier.onnx and the odds into a new folder. Raises UsageError if it cannot be written."""
    try:
        folder.mkdir(parents=True)
        (folder / FILE).write_bytes(built.onnx)
        (folder / "mine_odds_cascade.json").write_bytes(written(built.odds))
    except OSError as error:
        raise UsageError(f"{folder} cannot be written: {error.strerror}") from error


def weigh_and_judge(onnx: bytes, groups: Sequence[str], places: Sequence[Path], trained_on: str) -> Built:
    """Fit the weights of a network beside the detector's odds, and judge both."""
    network = parse_network(onnx, "the network")
    odds = shipped_odds("cascade")
    looks = [looks_of(place, group, network, odds) for group, place in zip(groups, places, strict=True)]
    looks = [one for one in looks if len(one.label)]
    usual = [one for one in looks if one.group in USUAL]
    found = weighed(usual, network.digest)
    n_mines = sum(int(np.count_nonzero(one.label[one.first] == MINE)) for one in usual)
    found = msgspec.structs.replace(
        found,
        made_by=f"auv-mcm {__version__}: calibrate verifier",
        trained_on=trained_on,
        calibrated_on=f"{n_mines} passes of mines that were looked at, in {len(usual)} missions of named scenes and "
        "of the wide world",
    )
    return Built(onnx, msgspec.structs.replace(odds, verifier=found), judged_tables(looks, found))


def missions(n_missions: int) -> tuple[list[LookTask], list[tuple[str, LookTask]]]:
    """List the missions to train on, and those to weigh and judge on with their group."""
    learnt = [LookTask(DRAWN, seed, DENSE) for seed in _LEARNT[:n_missions]]
    judged = [(_DENSE, LookTask(DRAWN, seed, DENSE)) for seed in range(FIRST_SEED, FIRST_SEED + N_JUDGED)]
    for group, first, n in zip(_LATER, (FIRST_SLABS, FIRST_PATCHES), _N_LATER, strict=True):
        judged += [(group, LookTask(DRAWN, seed, DENSE)) for seed in range(first, first + n)]
    judged += [(USUAL[0], LookTask(name, seed)) for name in SCENES for seed in SCENE_SEEDS]
    judged += [(USUAL[1], LookTask(DRAWN, seed)) for seed in USUAL_SEEDS]
    judged += [
        (_RECORDED, LookTask(name, SCENE_SEEDS[0], 1, recorder)) for recorder in RECORDERS for name in RECORDED_SCENES
    ]
    return learnt, judged


def runs_of(seeds: Sequence[int]) -> str:
    """Write rising seeds as runs: 1-3 and 7-9."""
    ends = [k for k in range(1, len(seeds)) if seeds[k] != seeds[k - 1] + 1]
    return " and ".join(f"{seeds[a]}-{seeds[b - 1]}" for a, b in pairwise([0, *ends, len(seeds)]))


def digest_of(chips: ChipTable) -> str:
    """Compute the SHA-256 of what a network is trained on."""
    digest = hashlib.sha256()
    for part in chips:
        digest.update(np.ascontiguousarray(part).tobytes())
    return digest.hexdigest()


def judged_tables(looks: Sequence[Looks], found: Verification) -> str:
    """Lay out how detector, network and both do, as means over missions of a group, and how well p_mine is known."""
    ways: dict[str, Callable[[Looks], Array]] = {
        "detector": lambda one: one.detector,
        "network": lambda one: rest_ratio(one.scores, found.other_nats),
        "both": lambda one: log_odds_of(one, found),
    }
    header = ["missions", "by", *(f"Pd at {limit:g}" for limit in LIMITS_PER_KM2), "others counted, at 100", "AUC"]
    rows: list[list[str]] = []
    for group in dict.fromkeys(one.group for one in looks):
        own = [one for one in looks if one.group == group]
        for way, odds_of in ways.items():
            odds = [odds_of(one) for one in own]
            pairs = list(zip(own, odds, strict=True))
            pd = [np.mean([pd_at(*pair, limit, others=False) for pair in pairs]) for limit in LIMITS_PER_KM2]
            counted = np.mean([pd_at(*pair, 100.0, others=True) for pair in pairs])
            auc = np.nanmean([auc_of(*pair) for pair in pairs])
            rows.append([group, way, *(f"{one:.3f}" for one in (*pd, counted, auc))])
    usual = [one for one in looks if one.group in USUAL]
    return f"{columns(header, rows)}\n\n{_calibration(usual, found.digest)}"


def _calibration(looks: Sequence[Looks], digest: str) -> str:
    """Compare p_mine with the share of mines, each mission weighed by what the others give."""
    odds = []
    for number, one in enumerate(looks):
        others = weighed([*looks[:number], *looks[number + 1 :]], digest)
        odds.append(log_odds_of(one, others)[one.first])
    p_mine = 1.0 / (1.0 + np.exp(-np.concatenate(odds)))
    is_mine = np.concatenate([(one.label == MINE)[one.first] for one in looks])
    rows: list[list[str]] = []
    for low, high in pairwise(_BINS):
        chosen = (p_mine >= low) & (p_mine < high)
        if chosen.any():
            values = (p_mine[chosen].mean(), is_mine[chosen].mean())
            rows.append([f"{low:g}", f"{high:g}", str(int(chosen.sum())), *(f"{one:.3f}" for one in values)])
    return columns(["p_mine from", "to", "looks", "mean p_mine", "share of mines"], rows)
