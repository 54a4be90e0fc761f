"""Measure what is not chosen: a detector's budget for this computer, and the models and tables that missions give."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, NamedTuple, TypeAlias

from auv_mcm.commands import CONFIG, Commands, Progress, command, read_config, whole, write_new
from sim_replay.arguments import check_new, count
from sim_replay.commands.calibrate_budget import add_budget, add_budget_options, run_budget_or_ask

if TYPE_CHECKING:
    from sim_replay.fitting.cascade.farm import Farm
    from sim_replay.fitting.theatre import Theatre

Show = Callable[[int, int], None]
"""Takes how many missions are flown, and of how many."""
Run = Callable[[argparse.Namespace, Show], int]
Option: TypeAlias = tuple[str, dict[str, Any]]
"""An option, and how it is added."""

_LAST_SEED: Final = 2**32 - 1  # largest of 32 bits


class Fit(NamedTuple):
    """Declare what missions give. about: what is learnt; does: the same as a command; more: in full."""

    name: str
    about: str
    does: str
    more: str
    examples: tuple[str, ...]
    options: tuple[Option, ...]
    run: Run


def add(commands: Commands) -> None:
    """Add `auv-mcm calibrate` to the command line."""
    budget = "what the chain's work costs on this computer; also without the word, with --speed"
    abouts = dict(sorted([("budget", budget), *((fit.name, fit.about) for fit in FITS)]))
    parser = command(
        commands,
        "calibrate",
        "measure this computer, or the payload's own performance",
        "\n".join(f"{name + ':':14}{about}" for name, about in abouts.items())
        + "\n\nThe detector's cascade has a command of its own, 'auv-mcm train'.",
        [
            "auv-mcm calibrate --speed 2.0 --duty 0.25",
            "auv-mcm calibrate budget --config vehicle.yaml --speed 2.0 --duty 0.25 --write calibrated.yaml",
            *(fit.examples[0] for fit in FITS),
        ],
    )
    # Scripts give --speed without a subcommand.
    add_budget_options(parser, required=False)
    parser.set_defaults(command=partial(run_budget_or_ask, parser))
    kinds = parser.add_subparsers(title="what to calibrate", metavar="WHAT")
    add_budget(kinds)
    for fit in FITS:
        parser = command(kinds, fit.name, fit.does, fit.more, fit.examples)
        for name, how in fit.options:
            parser.add_argument(name, **how)
        parser.set_defaults(command=partial(_with_progress, fit.run))


def _farm_of(arguments: argparse.Namespace) -> Farm:
    from sim_replay.fitting.cascade.farm import Farm

    return Farm(arguments.workers, arguments.scheduler)


def _theatre_of(arguments: argparse.Namespace) -> Theatre:
    from sim_replay.fitting.theatre import USUAL, read_theatre

    given = {"--config": arguments.config, "--theatre": arguments.theatre}
    options = " ".join(f"{name} {path}" for name, path in given.items() if path is not None)
    return read_theatre(arguments.theatre, read_config(arguments.config), options) if options else USUAL


def _write(arguments: argparse.Namespace, fitted: Any, order: Literal["deterministic"] | None = None) -> int:
    from sim_replay.text_tables import json_lines

    write_new(arguments.out, json_lines(fitted, order).decode())
    return 0


def _run_background(arguments: argparse.Namespace, show: Show) -> int:
    from sim_replay.fitting.fit_background import calibrate_background

    check_new(arguments.out)
    return _write(arguments, calibrate_background(arguments.seeds, _farm_of(arguments), show, _theatre_of(arguments)))


def _run_verifier(arguments: argparse.Namespace, show: Show) -> int:
    from sim_replay.fitting.cascade.farm import Farm
    from sim_replay.fitting.verifier.build import N_MISSIONS, build, write_built

    check_new(arguments.out)
    built = build(arguments.looks, arguments.missions or N_MISSIONS, Farm(arguments.workers), show, print)
    write_built(built, arguments.out)
    print(built.tables)
    return 0


def _run_gate(arguments: argparse.Namespace, show: Show) -> int:
    from sim_replay.fitting.fit_gate import calibrate_gate

    check_new(arguments.out)
    return _write(arguments, calibrate_gate(arguments.seeds, _farm_of(arguments), show, _theatre_of(arguments)))


def _run_sizes(arguments: argparse.Namespace, show: Show) -> int:
    from auv_mcm import __version__
    from sim_replay.fitting.fit_sizes import calibrate_sizes

    check_new(arguments.out)
    seeds = arguments.seeds
    made_by = f"version {__version__}, auv-mcm calibrate sizes --seeds {seeds[0]}-{seeds[-1]}"
    return _write(arguments, calibrate_sizes(seeds, arguments.workers, made_by, show))


def _run_odds(arguments: argparse.Namespace, show: Show) -> int:
    if arguments.verdicts:
        return _run_verdicts(arguments)
    from sim_replay.fitting.calibrate_odds import Missions, fit_from_missions

    missions = Missions(
        detector=arguments.detector,
        n_seeds=arguments.seeds,
        n_crowded=arguments.crowded or 0,
        n_drawn=arguments.drawn or 0,
        first_seed=arguments.first_seed,
        theatre=_theatre_of(arguments).before_odds(),
    )
    fit_from_missions(arguments.out, missions, arguments.looks, arguments.workers, show)
    return 0


def _run_verdicts(arguments: argparse.Namespace) -> int:
    from auv_mcm import __version__
    from auv_mcm.classify.odds import shipped_odds
    from auv_mcm.contacts.background import shipped_background
    from auv_mcm.errors import BadInputError
    from sim_replay.fitting.fit_odds import written
    from sim_replay.fitting.judged_missions import read_judged_missions
    from sim_replay.fitting.recalibrate import recalibrated, refit, refit_words

    check_new(arguments.out)
    missions = read_judged_missions(arguments.verdicts)
    detector = missions[0].detector
    found = refit(missions, shipped_background().prior(detector))
    print("\n".join(refit_words(found)))
    if found.refusal:
        raise BadInputError(found.refusal)
    names = " ".join(mission.name for mission in missions)
    made_by = f"version {__version__}, auv-mcm calibrate odds --verdicts {names}"
    write_new(arguments.out, written(recalibrated(shipped_odds(detector), found, made_by)).decode())
    print("name it as confirm.odds in the configuration")
    return 0


def _run_performance(arguments: argparse.Namespace, show: Show) -> int:
    from auv_mcm.clearance.detection_performance import USUAL_UNEVENNESS_DB
    from sim_replay.fitting.detection_performance.calibrate_performance import (
        FIT_SEEDS,
        FLIGHTS,
        fly_all,
        performance_fit_words,
        tables,
    )
    from sim_replay.fitting.detection_performance.fit_performance import fit_performance

    check_new(arguments.out)
    seeds, flights = arguments.seeds or FIT_SEEDS, arguments.flights or FLIGHTS
    theatre = _theatre_of(arguments)
    missions = fly_all(seeds, flights, _farm_of(arguments), show, theatre)
    looks = [look for mission in missions for look in mission]
    performance = fit_performance(looks, performance_fit_words(seeds, flights, looks), theatre.beam_width_deg)
    print(performance.fitted_on)
    print("probability that one look finds a mine, its 95 % interval, and looks fitted on\n")
    print(tables(performance))
    print(f"\nranges count in the height flown to the power {performance.altitude_exponent:g}")
    print(f"each decibel of unevenness above {USUAL_UNEVENNESS_DB:g} costs {performance.loss_per_db:.2f} of log-odds")
    print(f"of a further look, {performance.same_look_correlation:.2f} is known from one in the same direction")
    print(f"and {performance.other_look_correlation:.2f} from one in another")
    if arguments.out is not None:
        _write(arguments, performance, "deterministic")
    return 0


def _run_seabed(arguments: argparse.Namespace, show: Show) -> int:
    from sim_replay.fitting.cascade.farm import run_tasks
    from sim_replay.fitting.seabed.fit_seabed import FIT_SEEDS, fit_seabed_model, seabed_fit_words
    from sim_replay.fitting.seabed.samples import pooled, samples_of

    check_new(arguments.out)
    seeds = arguments.seeds or FIT_SEEDS
    farm = _farm_of(arguments)
    collect = partial(samples_of, theatre=_theatre_of(arguments))
    samples = pooled(list(run_tasks(collect, list(seeds), farm, lambda done: show(done, len(seeds)))))
    model = fit_seabed_model(samples, seabed_fit_words(seeds, samples.shares))
    print(model.fitted_on)
    if arguments.out is not None:
        _write(arguments, model)
    return 0


def _with_progress(run: Callable[[argparse.Namespace, Show], int], arguments: argparse.Namespace) -> int:
    """Run what flies missions, and show how many are flown and the time left."""
    with Progress("missions") as progress:
        return run(arguments, lambda done, of: progress.show(done / max(of, 1)))


def _seeds(text: str) -> range:
    first, dash, last = text.partition("-")
    if dash and first.isdecimal() and last.isdecimal() and len(text) < 24 and int(first) <= int(last) <= _LAST_SEED:
        return range(int(first), int(last) + 1)
    raise argparse.ArgumentTypeError(f"'{text}' is not a range of seeds. Write the first and the last, as in 800-815")


def _option(name: str, **how: Any) -> Option:
    return name, how


def _out(what: str, metavar: str = "FILE") -> Option:
    return _option("--out", metavar=metavar, type=Path, required=True, help=f"new {what}")


def _missions(first: int, last: int) -> Option:
    shown = f"{first}-{last}" if last > first else f"{first}"
    words = f"seeds of the missions (default {shown})"
    return _option("--seeds", metavar="FIRST-LAST", type=_seeds, default=range(first, last + 1), help=words)


def _number(name: str, words: str, default: int | None = None) -> Option:
    shown = f"{words} (default {'none' if default is None else default})"
    return name, {"metavar": "N", "type": count, "default": default, "help": shown}


_THEATRE: Final = (
    CONFIG,
    _option(
        "--theatre",
        metavar="SPEC",
        type=Path,
        help="YAML file of 'auv-mcm train': its scenes are flown, with its sonars, in place of what ships",
    ),
)


_FARM: Final = (
    _option("--workers", metavar="N", type=whole(1, 1000), default=2, help="missions flown at once here (default 2)"),
    _option("--scheduler", metavar="ADDRESS", help="fly on a dask cluster, tcp://HOST:PORT"),
    *_THEATRE,
)


def _on_farm(seeds: str) -> tuple[Option, ...]:
    shown = f"seeds of the missions (default {seeds})"
    return (
        _option("--out", metavar="FILE", type=Path, help="new file for the result, JSON"),
        _option("--seeds", metavar="FIRST-LAST", type=_seeds, help=shown),
        *_FARM[:-1],
        _option(
            "--theatre",
            metavar="SPEC",
            type=Path,
            help="YAML file of 'auv-mcm train': its sonars are carried, over sea floor drawn as without it",
        ),
    )


_WORKERS: Final = _number("--workers", "missions flown at once", 2)
_SAME: Final = "The same seeds make the same"
_AFTER_ODDS: Final = f"Fit it again after new odds. {_SAME}"

FITS: Final = (
    Fit(
        "background",
        "how the background of non-mines scores, from simulated missions; the file that ships was fitted so",
        "learn how the background of non-mines scores",
        "Flies simulated missions through the named scenes, with both detectors, and fits how densely contacts on no "
        f"mine reach each log-odds, and how that differs from mission to mission. {_AFTER_ODDS} model.",
        (
            "auv-mcm calibrate background --out background.json",
            "auv-mcm calibrate background --seeds 1500-1501 --out background.json",
        ),
        (_missions(1500, 1502), _out("file for the model, JSON"), *_FARM),
        _run_background,
    ),
    Fit(
        "gate",
        "which places of a tile can become contacts and are worth measuring, from simulated missions; the file that "
        "ships was fitted so",
        "learn which places of a tile can become contacts",
        "Flies simulated missions through the named scenes with every place measured, and fits how the odds of a mine "
        f"in the end follow from the score, contrast and range of a place. {_AFTER_ODDS} gate.",
        ("auv-mcm calibrate gate --out gate.json", "auv-mcm calibrate gate --seeds 500-501 --out gate.json"),
        (_missions(500, 500), _out("file for the gate, JSON"), *_FARM),
        _run_gate,
    ),
    Fit(
        "odds",
        "what each measurement of a detection says about the odds of a mine, from simulated missions; the weights "
        "that ship were fitted so",
        "learn the odds of a mine from what confirmation measures",
        "Flies simulated missions, and fits the weights that turn measurements into p_mine; beside those of the "
        "cascade it weighs the verifier that ships. The same options make the same weights. --verdicts recalibrates "
        "those that ship instead, and refuses where missions left out gain nothing.",
        (
            "auv-mcm calibrate odds --out odds.json",
            "auv-mcm calibrate odds --detector contrast --seeds 8 --crowded 5 --out odds.json",
            "auv-mcm calibrate odds --crowded 4 --drawn 60 --looks looks --out odds.json",
            "auv-mcm calibrate odds --verdicts monday tuesday wednesday --out recalibrated.json",
        ),
        (
            _option(
                "--verdicts",
                metavar="DIR",
                nargs="+",
                type=Path,
                help="fly nothing: change the odds that ship by what people judged of these missions, folders "
                "of results or sessions; 'confirm.odds' of the configuration loads the file. Other options but "
                "--out have no part in it",
            ),
            _option(
                "--detector",
                choices=("cascade", "contrast"),
                default="cascade",
                help="detector whose odds to fit (default cascade)",
            ),
            _number("--seeds", "missions per scene", 2),
            _number("--crowded", "further missions per scene with 3 times as many mines and rocks"),
            _number(
                "--drawn",
                "further missions with sonar, recorder, sea floor and objects drawn at random, twice as many mines "
                "where there is room",
            ),
            _number("--first-seed", "seed of each scene's first mission", 500),
            _option(
                "--looks",
                type=Path,
                metavar="FOLDER",
                help="folder that keeps what looks measured; a second run only fits",
            ),
            _WORKERS,
            _out("file for the weights, JSON"),
            *_THEATRE,
        ),
        _run_odds,
    ),
    Fit(
        "performance",
        "how likely one view finds a mine, by sea floor, range and direction, from simulated missions; "
        "'detect.performance' of the configuration loads the file",
        "fit the probability that one look finds a mine",
        "Flies simulated missions full of targets over all seabed types, and fits the probability that one look finds "
        f"a mine to the outcome of each look. {_SAME} tables, here or on a dask cluster.",
        (
            "auv-mcm calibrate performance --out performance.json",
            "auv-mcm calibrate performance --seeds 800-803 --flights 1",
            "auv-mcm calibrate performance --out performance.json --scheduler tcp://10.0.0.1:8786",
        ),
        (
            *_on_farm("800-815"),
            _option("--flights", metavar="N", type=whole(1, 1000), help="missions of each seed (default 3)"),
        ),
        _run_performance,
    ),
    Fit(
        "seabed",
        "how seabed types look, from simulated missions; 'detect.seabed_model' loads the file",
        "fit the look of seabed types",
        "Flies simulated missions over all kinds of sea floor, and fits the odds of each kind to what its texture is. "
        f"Seeds from 4000 on fly missions like the named scenes, lower ones know nothing of them. {_SAME} model.",
        ("auv-mcm calibrate seabed --out model.json", "auv-mcm calibrate seabed --seeds 3000-3049 --out free.json"),
        _on_farm("3000-3049 and 4000-4079"),
        _run_seabed,
    ),
    Fit(
        "sizes",
        "how sizes of mines are measured, for lists of mines expected; the file that ships was fitted so",
        "measure how sizes of mines look",
        "Flies simulated missions with mines of all sizes, and fits how the sizes of the solids in each look follow "
        "from the true ones, and the kind from what each solid explains. 'confirm.targets' goes by it. "
        f"{_SAME} file.",
        ("auv-mcm calibrate sizes --out size_law.json", "auv-mcm calibrate sizes --seeds 13000-13009 --out law.json"),
        (_missions(13_000, 13_035), _WORKERS, _out("file for the law, JSON")),
        _run_sizes,
    ),
    Fit(
        "verifier",
        "the network that separates mines from other objects and floor, from simulated missions; the files that ship "
        "were made so",
        "train the network that separates mines from other objects and floor",
        "Flies drawn missions with dense mines and stones, keeps the sea floor around every detection, trains the "
        "network on it, weighs it beside the detector's odds on missions left out, and prints how both do there. "
        "Missions already in --looks are not flown again. Needs the extra 'verifier' (PyTorch). The same seeds give "
        "the same missions; weights repeat on one computer. Refit gate and background afterwards.",
        ("auv-mcm calibrate verifier --looks looks --out made",),
        (
            _option(
                "--missions",
                metavar="N",
                type=count,
                help="to train on (default: as many as what ships was trained on)",
            ),
            _option("--looks", metavar="FOLDER", type=Path, required=True, help="of the missions flown"),
            _WORKERS,
            _out("folder for the network and the odds", "FOLDER"),
        ),
        _run_verifier,
    ),
)
"""What missions give, in the order of the help."""
