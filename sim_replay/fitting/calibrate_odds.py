"""Make the odds of a mine from missions, for `auv-mcm calibrate odds`: fly and fit.

Missions of the named scenes, with seeds that nothing is scored on, give detections whose truth is known. Each detector
has weights of its own, those of the trained cascade without the scenes that are held out from its training. Crowded
missions are flown over other floors with more mines and stones, since these are hardest to separate; missions of the
wide world are drawn at random. Missions with as many objects as usual give the rarity of mines.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec

from auv_mcm import __version__
from auv_mcm.classify.odds import MineOdds, shipped_odds
from auv_mcm.classify.verifier import FILE, Network, network_of
from auv_mcm.errors import UsageError
from auv_mcm.records import Detector
from auv_mcm.shell.whole_files import make_directory, write_file
from sim_replay.arguments import check_new
from sim_replay.fitting.cascade.farm import Farm
from sim_replay.fitting.fit_odds import CROWD, CROWD_SEEDS, DRAWN_SEEDS, N_TREES, fit_table, written
from sim_replay.fitting.fit_odds import FIRST_SEED as FITTED_SEED
from sim_replay.fitting.looks import DRAWN, LookTask, MissionLooks, all_looks, pooled
from sim_replay.fitting.theatre import USUAL, Theatre
from sim_replay.fitting.verifier.mill import fly_all
from sim_replay.fitting.verifier.weigh import looks_of, weighed
from sim_replay.missions import SCENES


class Missions(NamedTuple):
    """Say what weights are fitted on.

    detector: whose detections to weigh. n_seeds: missions per scene, from `first_seed` on. n_crowded: further ones with
    CROWD times as many mines and rocks. n_drawn: missions of the wide world. theatre: what is flown and fitted on.
    """

    detector: Detector = "cascade"
    n_seeds: int = 2
    n_crowded: int = 0
    n_drawn: int = 0
    first_seed: int = FITTED_SEED
    theatre: Theatre = USUAL

    @property
    def command(self) -> str:
        """Return the command that makes the same weights, but for its --out."""
        words = ["auv-mcm calibrate odds", f"--detector {self.detector}", f"--seeds {self.n_seeds}"]
        options = {"crowded": self.n_crowded, "drawn": self.n_drawn}
        words += [f"--{name} {n}" for name, n in options.items() if n]
        return " ".join([*words, f"--first-seed {self.first_seed}", self.theatre.options]).strip()

    @property
    def scenes(self) -> list[str]:
        """Name the scenes that weights are fitted on."""
        return [*(SCENES if self.detector == "contrast" and not self.theatre.scenes else self.theatre.flown)]

    @property
    def seeds(self) -> range:
        """Return the seeds of missions with as many objects as usual."""
        return range(self.first_seed, self.first_seed + self.n_seeds)

    @property
    def crowds(self) -> range:
        """Return the seeds of crowded missions: other floors."""
        first = self.first_seed + max(CROWD_SEEDS, self.n_seeds)
        return range(first, first + self.n_crowded)

    def fitted_tasks(self) -> list[LookTask]:
        """List the missions that are fitted on."""
        tasks = [LookTask(name, seed) for seed in self.seeds for name in self.scenes]
        tasks += [LookTask(name, seed, CROWD) for seed in self.crowds for name in self.scenes]
        first = self.first_seed + DRAWN_SEEDS
        tasks += [LookTask(DRAWN, seed) for seed in range(first, first + self.n_drawn)]
        tasks += [LookTask(folder, 0) for folder in self.theatre.lines_of("validate")]
        return [task._replace(detector=self.detector, theatre=self.theatre) for task in tasks]


def fit_from_missions(
    out: Path,
    missions: Missions,
    looks: Path | None = None,
    n_workers: int = 1,
    show: Callable[[int, int], None] = lambda done, of: None,
    network: Network | None = None,
) -> None:
    """Fly missions, fit the weights to what became of their detections, and write them to `out`, JSON.

    Parameters
    ----------
    looks
        Folder that keeps what looks measured; missions there are not flown again.
    n_workers
        Missions flown at once.
    show
        Takes the missions flown so far, and how many there are to fly.
    network
        To weigh in place of the one that ships: verifier.onnx, beside `out`.

    Raises
    ------
    UsageError
        For an `out` that is there or cannot be written, before any work, and without targets among the detections.
    """
    check_new(out)
    make_directory(out.parent)
    fitted = missions.fitted_tasks()
    with tempfile.TemporaryDirectory() as folder:
        farm = Farm(n_workers)
        flown = all_looks(fitted, looks or Path(folder), farm, show)
        odds = fitted_odds(missions, flown)
        if missions.detector == "cascade":
            odds = beside_network(odds, missions, flown, (looks or Path(folder)) / "verifier", farm, show, network)
    try:
        write_file(out, written(odds))
    except OSError as error:
        raise UsageError(f"--out {out} cannot be written: {error.strerror}") from error
    print(odds.fitted_on)


def fitted_odds(missions: Missions, flown: Sequence[MissionLooks]) -> MineOdds:
    """Fit weights to the missions of `fitted_tasks`. Raises UsageError without targets or anything else among them."""
    training = pooled(flown)
    scenes, seeds, crowds = ", ".join(missions.scenes), missions.seeds, missions.crowds
    words = f"{len(training.weight)} detections of simulated missions: {scenes}; seeds {seeds[0]} to {seeds[-1]}"
    if crowds:
        words += f", and {crowds[0]} to {crowds[-1]} with {CROWD} times as many mines and rocks"
    if missions.n_drawn:
        words += f"; {missions.n_drawn} drawn from the wide world"
    odds = fit_table(training, words, n_trees_of(missions.detector))
    made_by = f"version {__version__}, {missions.command}"
    return msgspec.structs.replace(odds, made_by=made_by, fitted_for=missions.detector)


def beside_network(
    odds: MineOdds,
    missions: Missions,
    flown: Sequence[MissionLooks],
    folder: Path,
    farm: Farm,
    show: Callable[[int, int], None],
    own: Network | None = None,
) -> MineOdds:
    """Weigh an own network, or the one that ships, beside these odds, on missions with as many mines as usual.

    Where there are several seeds, missions of each are seen by odds fitted to the others: trees know their own too well
    and would weigh too much.
    """
    tasks = [one.task for one in flown]
    usual = [task for task in tasks if task.times == 1 and task.source != DRAWN and not task.is_line]
    verifier = shipped_odds("cascade").verifier
    assert verifier is not None
    network = own or network_of(verifier.digest)
    seeds = {task.seed for task in usual}
    without = {
        seed: fitted_odds(missions, [one for one in flown if one.task.seed != seed]) if len(seeds) > 1 else odds
        for seed in seeds
    }
    places = fly_all(usual, folder, farm, show)
    seen = [looks_of(place, "scenes", network, without[task.seed]) for place, task in zip(places, usual, strict=True)]
    found = weighed(seen, network.digest)
    if own:
        found = msgspec.structs.replace(found, file=FILE, made_by=f"auv-mcm {__version__}: train")
    return msgspec.structs.replace(odds, verifier=found)


def n_trees_of(detector: Detector) -> int:
    """Return the trees that weigh what the detector measured.

    Contrasts serve sonars unlike those simulated, where trees that have learnt simulated ones do worse than sums.
    """
    return N_TREES if detector == "cascade" else 0
