"""Fit everything for a theatre, step by step, and judge it beside what ships: `auv-mcm train SPEC --all`."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, redirect_stdout
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Final, NamedTuple

import msgspec

from auv_mcm.classify.verifier import FILE, parse_network
from auv_mcm.errors import UsageError
from auv_mcm.pipeline import Pipeline
from auv_mcm.safe_files import read_regular
from auv_mcm.settings.config import Config, config_yaml
from auv_mcm.shell.whole_files import write_file
from sim_replay.fitting.calibrate_odds import Missions, fit_from_missions
from sim_replay.fitting.cascade.farm import Farm, run_tasks
from sim_replay.fitting.cascade.spec import AugmentedLine, on_grid
from sim_replay.fitting.cascade.training_images import check_once
from sim_replay.fitting.detection_performance import calibrate_performance as performance
from sim_replay.fitting.detection_performance.fit_performance import fit_performance
from sim_replay.fitting.fit_background import FIRST_SEED as BACKGROUND_SEED
from sim_replay.fitting.fit_background import calibrate_background
from sim_replay.fitting.fit_gate import FIRST_SEED as GATE_SEED
from sim_replay.fitting.fit_gate import calibrate_gate
from sim_replay.fitting.fit_odds import FIRST_SEED as ODDS_SEED
from sim_replay.fitting.looks import LookTask, flight_of
from sim_replay.fitting.theatre import Theatre, with_files
from sim_replay.fitting.verifier.own import can_train, own_network
from sim_replay.flights import fly_through
from sim_replay.scoring.inputs import ScoredMission, as_reported, parse_truth
from sim_replay.scoring.thresholds import BestScores, banded_at, best_scores
from sim_replay.text_tables import columns, json_lines

CONFIG: Final = "vehicle.yaml"
"""Name of the configuration that names all other files."""
_SPEC: Final = "theatre.yaml"
_NETWORK_ALONE: Final = b"\n# detector and performance as they ship\n"  # kept with the spec
_DETECTOR: Final = "model.json"
_PERFORMANCE: Final = "performance.json"
LIMITS_PER_KM2: Final = (10.0, 30.0, 100.0)
"""False alarms per km² that own and shipped are compared at."""
_MISSIONS: Final = {"odds": (ODDS_SEED, 18), "gate": (GATE_SEED, 9), "background": (BACKGROUND_SEED, 27)}
"""First seed, and missions or a few more, as of what ships."""

Show = Callable[[int, int], None]
Watched = Callable[[str], AbstractContextManager[Show]]


class Step(NamedTuple):
    """Name a fitted file, and what it is in the configuration, None for the network, which the odds name.

    fit: writes it, for a theatre with all files before.
    """

    key: str | None
    file: str
    fit: Callable[[Theatre, Path, Show], None]


def fit_theatre(
    theatre: Theatre,
    config: Config,
    spec: bytes,
    folder: Path,
    train: Callable[[Path], None],
    farm: Farm,
    watched: Watched,
    *,
    network_alone: bool = False,
) -> str:
    """Fit detector, odds, gate, background and detection performance, and write a configuration that names them.

    With PyTorch a network is trained for the theatre, too; without, the one that ships is weighed. A file that the
    folder holds is not made again, so that an interrupted run goes on. Returns tables of how all this does beside what
    ships.

    Parameters
    ----------
    config
        Of the vehicle, which is written with the files and the grid of the first sonar.
    spec
        Text of the training set that the theatre was read from.
    train
        Writes the detector's cascade to a file.
    watched
        Gives, by a step's name, what takes the missions flown and how many it has.
    network_alone
        Fit the network, and odds, gate and background that go with it; detector and performance stay as they are.

    Raises
    ------
    UsageError
        For a folder that cannot be written to or has files of another spec, for a spec that judges on what is fitted
        on, without PyTorch for the network alone, and as the fits do.
    """
    _refuse_fitted(theatre)
    _begin(folder, spec + _flown_with(theatre), network_alone=network_alone)
    shipped, files = theatre, dict[str, str]()
    for step in _steps(train, farm):
        if network_alone and step.file in (_DETECTOR, _PERFORMANCE):
            continue
        place = folder.absolute() / step.file
        if not place.exists():
            with watched(step.key or "network") as show:
                step.fit(theatre, place, show)
        if step.key is not None:
            files[step.key] = str(place)
        theatre = shipped.with_files(**files)
    write_file(folder / CONFIG, config_yaml(with_files(on_grid(config, theatre.sonars[0]), **files)).encode())
    with watched("judging") as show:
        return judged({"shipped": shipped, "own": theatre}, farm, show)


def _flown_with(theatre: Theatre) -> bytes:
    """Digest what the spec's text leaves open: the configuration, and what scenes and lines hold."""
    flown_with = sha256(config_yaml(theatre.config).encode() + theatre.digest().encode())
    return f"\n# flown with {flown_with.hexdigest()}\n".encode()


def _begin(folder: Path, spec: bytes, *, network_alone: bool) -> None:
    """Make the folder, and keep the spec in it that its files are fitted for."""
    if network_alone and not can_train():
        raise UsageError("--network needs PyTorch: python -m pip install 'auv-mcm[verifier]'")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"--out {folder} cannot be made: {error.strerror}. Name a new folder") from error
    kept = folder / _SPEC
    spec += _NETWORK_ALONE if network_alone else b""
    if kept.exists() and read_regular(kept) != spec:
        raise UsageError(
            f"--out {folder} has files that were fitted otherwise, with other options, another configuration or for "
            f"another spec, {kept}: name a new one"
        )
    write_file(kept, spec)


def _steps(train: Callable[[Path], None], farm: Farm) -> Iterator[Step]:
    def network(theatre: Theatre, out: Path, show: Show) -> None:
        own_network(theatre.before_odds(), out, farm, show)

    def odds(theatre: Theatre, out: Path, show: Show) -> None:
        place = out.with_name(FILE)
        own = parse_network(read_regular(place), str(place)) if place.exists() else None
        with redirect_stdout(sys.stderr):
            missions = Missions(n_seeds=len(_seeds("odds", theatre)), theatre=theatre.before_odds())
            fit_from_missions(out, missions, out.with_name("looks"), farm.workers, show, own)

    def gate(theatre: Theatre, out: Path, show: Show) -> None:
        write_file(out, json_lines(calibrate_gate(_seeds("gate", theatre), farm, show, theatre)))

    def background(theatre: Theatre, out: Path, show: Show) -> None:
        write_file(out, json_lines(calibrate_background(_seeds("background", theatre), farm, show, theatre)))

    def tables(theatre: Theatre, out: Path, show: Show) -> None:
        seeds, flights = performance.FIT_SEEDS, performance.FLIGHTS
        looks = [look for one in performance.fly_all(seeds, flights, farm, show, theatre) for look in one]
        words = performance.performance_fit_words(seeds, flights, looks)
        write_file(out, json_lines(fit_performance(looks, words, theatre.beam_width_deg), "deterministic"))

    yield Step("model", _DETECTOR, lambda theatre, out, show: train(out))
    if can_train():
        yield Step(None, FILE, network)
    yield Step("odds", "odds.json", odds)
    yield Step("gate", "gate.json", gate)
    yield Step("background", "background.json", background)
    yield Step("performance", _PERFORMANCE, tables)


def _seeds(step: str, theatre: Theatre) -> range:
    first, n_missions = _MISSIONS[step]
    return range(first, first + math.ceil(n_missions / len(theatre.flown)))


def _refuse_fitted(theatre: Theatre) -> None:
    """Refuse to judge on sea floor that is fitted on. Raises UsageError, BadInputError for a line that is not there."""
    for step in _MISSIONS:
        if shared := sorted({*_seeds(step, theatre)}.intersection(theatre.test_seeds)):
            raise UsageError(
                f"`seeds.test` holds {shared[0]}, a mission that {step} would be fitted on: it would be judged too "
                "well. Leave out 500 to 517 and 1500 to 1526"
            )
    check_once(AugmentedLine(Path(folder), theatre.config, split) for split, folder in theatre.lines)


def judged(theatres: dict[str, Theatre], farm: Farm, show: Show) -> str:
    """Fly what nothing was fitted on, the split `test`, with each configuration, and compare them in a table."""
    theatre = next(iter(theatres.values()))
    places = [(name, seed) for name in theatre.scenes for seed in theatre.test_seeds]
    tasks = [LookTask(*place) for place in (*places, *((folder, 0) for folder in theatre.lines_of("test")))]
    if not tasks:
        return "nothing was judged: give the spec `seeds: {test: ...}`, or an augmented folder with `split: test`"
    rows = []
    for number, (name, one) in enumerate(theatres.items()):

        def shown(done: int, before: int = number * len(tasks)) -> None:
            show(before + done, len(theatres) * len(tasks))

        fly = partial(_scores_of, config=one.config)
        own = [task._replace(theatre=theatre) for task in tasks]
        missions = list(run_tasks(fly, own, farm, shown))
        bands = [banded_at(missions, limit) for limit in LIMITS_PER_KM2]
        rows.append([name, *(f"{band.value:.2f} ({band.low:.2f} to {band.high:.2f})" for band in bands)])
    header = ["models", *(f"Pd at {limit:g} FA/km²" for limit in LIMITS_PER_KM2)]
    n_targets, area_km2 = sum(len(one.targets) for one in missions), sum(one.area_km2 for one in missions)
    return f"{columns(header, rows)}\n{len(tasks)} missions left out, {n_targets} targets, {area_km2:.3f} km²"


def _scores_of(task: LookTask, config: Config) -> BestScores:
    with flight_of(task) as flight:
        sections = {name: getattr(config, name) for name in ("detect", "confirm", "contacts")}
        pipeline = Pipeline(msgspec.structs.replace(flight.config, **sections))
        fly_through(flight.events, {task.domain: pipeline})
        truth = parse_truth(flight.truth(), task.domain)
    return best_scores(ScoredMission(as_reported(pipeline.contacts, task.domain), truth, task.domain))
