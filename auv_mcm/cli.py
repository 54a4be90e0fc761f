"""The auv-mcm command. Everything heavy is imported by the subcommand that needs it."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from auv_mcm import __version__
from auv_mcm.errors import AuvMcmError, HardwareError, UsageError

if TYPE_CHECKING:
    from auv_mcm.config import Config

_EXIT_CODES = "exit codes: 0 done, 2 bad usage or configuration, 3 bad input data, 4 hardware or link failed, 5 self-check failed"
_INTERRUPTED = 130  # what shells report for a program ended by Ctrl-C
_BENCHES = ("waterfall", "detect", "simulate", "scenes", "segmentation", "snakes", "shapes", "beliefs", "images")
_BENCH_EXTRA = {"pyxtf", "rich", "matplotlib", "jinja2"}


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    arguments = _parser().parse_args(argv)
    command: Callable[[argparse.Namespace], int] = arguments.command
    try:
        code = command(arguments)
        sys.stdout.flush()
        return code
    except AuvMcmError as error:
        return _fail(str(error), error.exit_code)
    except KeyboardInterrupt:
        return _fail("interrupted", _INTERRUPTED)
    except ModuleNotFoundError as error:
        if error.name not in _BENCH_EXTRA:
            raise
        return _fail(f"this command needs the package {error.name}: python -m pip install 'auv-mcm[bench]'", UsageError.exit_code)
    except BrokenPipeError:
        # Whoever read our output, such as head, has seen enough.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        return _fail(f"{error.filename or 'input or output'}: {error.strerror or error}", HardwareError.exit_code)


def _fail(text: str, code: int) -> int:
    print(f"auv-mcm: {text}", file=sys.stderr)
    return code


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="auv-mcm",
        description="Payload service of a mine-hunting AUV: side-scan pings and navigation in, contacts, coverage and way-points out.",
        epilog=f"'auv-mcm COMMAND --help' explains a command. {_EXIT_CODES}.",
    )
    parser.add_argument("--version", action="version", version=f"auv-mcm {__version__}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    _add_replay(commands)
    _add_run(commands)
    _add_simulate(commands)
    _add_score(commands)
    _add_check(commands)
    _add_config(commands)
    _add_bench(commands)
    return parser


def _command(
    commands: argparse._SubParsersAction[argparse.ArgumentParser], name: str, does: str, more: str, examples: Sequence[str]
) -> argparse.ArgumentParser:
    return commands.add_parser(
        name,
        help=does,
        description=f"{does[0].upper()}{does[1:]}.\n\n{more}",
        epilog="examples:\n" + "\n".join(f"  {example}" for example in examples) + f"\n\n{_EXIT_CODES}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )


def _add_replay(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = _command(
        commands,
        "replay",
        "replay recorded missions and write contacts, maps and a report",
        "Writes contacts.geojson, contacts.csv, contacts.kml, waypoints.geojson, coverage.geojson, summary.json,\n"
        "report.html (one file, for any browser) and snippets/ (a picture per contact). Results of an earlier replay\n"
        "in the same directory are replaced. Several logs are one mission, taken in order of time.",
        [
            "auv-mcm replay mission.xtf --out results",
            "auv-mcm replay leg1.xtf leg2.xtf --out results --config vehicle.yaml",
        ],
    )
    parser.add_argument("logs", metavar="LOG", nargs="+", type=Path, help="XTF file with side-scan pings")
    parser.add_argument("--out", metavar="DIR", type=Path, required=True, help="directory for the results, made if it is not there")
    _add_config_option(parser)
    parser.add_argument(
        "--exhaustive", action="store_true", help="skip nothing: every stage looks at everything (slower; same contacts, for checking)"
    )
    parser.add_argument(
        "--threads", metavar="N", type=_whole(1, 64), default=1, help="threads that share the work; the contacts are the same (default 1)"
    )
    parser.add_argument(
        "--speed", choices=("real", "max"), default="max", help="real: as fast as it was recorded; max: as fast as possible (default)"
    )
    parser.add_argument(
        "--chunk-bytes",
        metavar="N",
        type=_whole(1, 1 << 28),
        default=1 << 18,
        help="read buffer; the contacts are the same (default 262144)",
    )
    parser.set_defaults(command=_replay)


def _add_run(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = _command(
        commands,
        "run",
        "run the live service until its source ends or SIGINT or SIGTERM arrives",
        "The source is service.source of the configuration; replay:///path/to/mission.xtf?speed=1 plays a recorded\n"
        "mission (speed: times real time, or max). Contacts go to the console once they are on disk, in contacts.jsonl of\n"
        "a new session directory below service.output_directory; clutter stays off the console. Health lines go to\n"
        "standard error.\n"
        "A signal stops the source, works off what is queued and writes all results; a second one ends at once.",
        ["auv-mcm run --config vehicle.yaml"],
    )
    _add_config_option(parser)
    parser.set_defaults(command=_run)


def _add_simulate(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = _command(
        commands,
        "simulate",
        "fly a simulated mission and write its log and the truth",
        "Writes mission.xtf, for 'auv-mcm replay', and truth.json, for 'auv-mcm score'. SCENE is a YAML file or the name of a\n"
        "scene that ships with the package (--list). The same scene and seed give the same bytes.",
        [
            "auv-mcm simulate --list",
            "auv-mcm simulate ripple --out sim",
            "auv-mcm simulate my-scene.yaml --out sim --seed 7",
        ],
    )
    parser.add_argument("scene", metavar="SCENE", nargs="?", help="YAML file, or name of a scene that ships with the package")
    parser.add_argument("--out", metavar="DIR", type=Path, help="directory for the results, made if it is not there")
    parser.add_argument("--seed", metavar="N", type=_whole(0, 2**32 - 1), help="instead of the scene's own: another sea, other objects")
    parser.add_argument(
        "--threads", metavar="N", type=_whole(1, 64), default=1, help="threads that share the work; the bytes are the same (default 1)"
    )
    parser.add_argument("--list", action="store_true", help="list the scenes that ship with the package")
    parser.set_defaults(command=_simulate)


def _add_score(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = _command(
        commands,
        "score",
        "score contacts against the truth: detections, false alarms, errors",
        "Takes pairs of a contacts.geojson and a truth.json; several pairs are pooled. Prints Pd with Wilson and false alarms\n"
        "per km² with exact Poisson intervals (95 %) over thresholds of p_mine, and where they come from.",
        [
            "auv-mcm score results/contacts.geojson sim/truth.json",
            "auv-mcm score r1/contacts.geojson s1/truth.json r2/contacts.geojson s2/truth.json --json score.json --plot froc.png",
        ],
    )
    parser.add_argument("files", metavar="FILE", nargs="+", type=Path, help="CONTACTS TRUTH, as often as there are missions")
    parser.add_argument(
        "--gate-m", metavar="M", type=float, default=2.0, help="farther from an object a contact is no call of it (default 2)"
    )
    parser.add_argument("--threshold", metavar="P", type=float, default=0.5, help="p_mine from which a contact is a call (default 0.5)")
    parser.add_argument("--json", metavar="PATH", type=Path, help="write everything as JSON, too")
    parser.add_argument("--plot", metavar="PATH", type=Path, help="draw the curve of Pd over false alarms (.png, .svg, .pdf)")
    parser.set_defaults(command=_score)


def _add_check(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = _command(
        commands,
        "check",
        "check that this installation does what it should",
        "Looks at Python, packages, the C kernels against numpy, shared memory, the perception process, the output\n"
        "directory and the configuration. Changes nothing. Exit code 5 if something failed; a warning is no failure.",
        ["auv-mcm check", "auv-mcm check --config vehicle.yaml"],
    )
    _add_config_option(parser)
    parser.set_defaults(command=_check)


def _add_config(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = _command(
        commands,
        "config",
        "print or write the configuration with every key explained",
        "Every key may be left out of a configuration file; its default then holds.",
        [
            "auv-mcm config --write                  print all keys with meaning, range and default",
            "auv-mcm config --write vehicle.yaml     write them to a new file",
            "auv-mcm config --schema > schema.json   JSON Schema, for editors and scripts",
        ],
    )
    action = parser.add_mutually_exclusive_group(required=True)
    action.add_argument("--write", metavar="PATH", nargs="?", const="-", help="write YAML with comments to PATH, or print it")
    action.add_argument("--schema", action="store_true", help="print the JSON Schema")
    parser.set_defaults(command=_config)


def _add_bench(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = _command(
        commands,
        "bench",
        "measure speed, memory and what is found",
        "waterfall: the whole chain, cost per stage; detect: the detector's cost per tile; simulate: the simulator's cost;\n"
        "scenes: what is found in the named scenes; segmentation, snakes, shapes: parts of confirmation and classification,\n"
        "error beside time; beliefs: what views make one believe; images: outlines and calls on\n"
        "real pictures. Further arguments go to the bench.",
        ["auv-mcm bench waterfall mission.xtf", "auv-mcm bench scenes --help"],
    )
    parser.add_argument("bench", choices=_BENCHES, help="what to measure")
    parser.add_argument("arguments", metavar="...", nargs=argparse.REMAINDER, help="arguments of the bench")
    parser.set_defaults(command=_bench)


def _add_config_option(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--config", metavar="FILE", type=Path, help="configuration in YAML; see 'auv-mcm config --write'")


def _whole(low: int, high: int) -> Callable[[str], int]:
    def parse(text: str) -> int:
        try:
            number = int(text)
        except ValueError:
            number = low - 1
        if not low <= number <= high:
            raise argparse.ArgumentTypeError(f"'{text}' is no whole number from {low} to {high}")
        return number

    return parse


def _read_config(path: Path | None) -> Config:
    from auv_mcm.config import Config, parse_config

    if path is None:
        return Config()
    try:
        text = path.read_text("utf-8")
    except OSError as error:
        raise UsageError(f"configuration {path} cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise UsageError(f"configuration {path} is no UTF-8 text (byte {error.start})") from error
    return parse_config(text, str(path))


def _replay(arguments: argparse.Namespace) -> int:
    config = _read_config(arguments.config)

    from sim_replay.recorded import parse_speed
    from sim_replay.replay import replay

    with _Progress("replay") as progress:
        summary = replay(
            arguments.logs,
            arguments.out,
            config,
            exhaustive=arguments.exhaustive,
            threads=arguments.threads,
            chunk_bytes=arguments.chunk_bytes,
            speed=parse_speed(arguments.speed, "--speed"),
            progress=progress.show,
        )
    speed = f", {summary['times_real_time']:g} times real time" if summary["times_real_time"] else ""
    print(f"{summary['pings']} pings in {summary['duration_s']:.0f} s over {summary['distance_m']:.0f} m{speed}")
    print(f"{summary['contacts']} contacts, {summary['contacts_mine_like']} of them mine-like; {summary['covered_km2']:g} km² covered")
    for notice in summary["notices"]:
        print(f"notice: {notice['text']}" + (f" ({notice['place']})" if notice["place"] and notice["place"] not in notice["text"] else ""))
    print(f"report: {arguments.out / 'report.html'}")
    return 0


def _run(arguments: argparse.Namespace) -> int:
    import logging

    from auv_mcm.service import serve

    config = _read_config(arguments.config)
    logging.Formatter.converter = time.gmtime
    logging.basicConfig(
        stream=sys.stderr, level=logging.INFO, format="%(asctime)s.%(msecs)03dZ %(levelname)s %(message)s", datefmt="%Y-%m-%dT%H:%M:%S"
    )
    folder = serve(config)
    print(f"results: {folder}")
    return 0


def _simulate(arguments: argparse.Namespace) -> int:
    from msgspec.structs import replace

    from sim_replay.simulate import simulate
    from sim_replay.simulator.scene_file import named_scenes, read_scene

    if arguments.list:
        print("\n".join(named_scenes()))
        return 0
    if arguments.scene is None or arguments.out is None:
        raise UsageError("a SCENE and --out DIR are needed; 'auv-mcm simulate --help' explains")
    scene = read_scene(arguments.scene)
    if arguments.seed is not None:
        scene = replace(scene, seed=arguments.seed)
    start_s = time.perf_counter()
    with _Progress("simulate") as progress:
        done = simulate(scene, arguments.out, threads=arguments.threads, progress=progress.show)
    speed = done.duration_s / (time.perf_counter() - start_s)
    print(f"{done.n_pings} pings in {done.duration_s:.0f} s, {speed:.0f} times real time; {done.area_km2:g} km² swept")
    print(f"{done.n_objects} objects, {done.n_targets} of them targets")
    print(f"log: {done.log}\ntruth: {done.truth}")
    return 0


def _score(arguments: argparse.Namespace) -> int:
    from sim_replay.scoring import plot, score_files, table, to_json

    score = score_files(arguments.files, gate_m=arguments.gate_m, threshold=arguments.threshold)
    print(table(score))
    if arguments.json is not None:
        try:
            arguments.json.write_bytes(to_json(score))
        except OSError as error:
            raise UsageError(f"--json {arguments.json} cannot be written: {error.strerror}") from error
    if arguments.plot is not None:
        plot(score, arguments.plot)
    return 0


def _check(arguments: argparse.Namespace) -> int:
    from auv_mcm.check import run_checks

    return run_checks(lambda: _read_config(arguments.config), print)


def _config(arguments: argparse.Namespace) -> int:
    from auv_mcm.config import Config, config_schema, config_yaml

    text = config_schema() if arguments.schema else config_yaml(Config())
    if arguments.schema or arguments.write == "-":
        sys.stdout.write(text)
        return 0
    try:
        with open(arguments.write, "x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError as error:
        raise UsageError(f"{arguments.write} exists and is left alone: name a new file, or remove that one") from error
    except OSError as error:
        raise UsageError(f"{arguments.write} cannot be written: {error.strerror}") from error
    print(f"written: {arguments.write}")
    return 0


def _bench(arguments: argparse.Namespace) -> int:
    from sim_replay.benches.chain import main as bench

    return bench([arguments.bench, *arguments.arguments])


class _Progress:
    """A bar on a terminal, a plain line every tenth elsewhere; both on standard error."""

    def __init__(self, title: str) -> None:
        self._title = title
        self._tenths = 0
        self._update: Callable[[float], None] = self._print_tenths
        self._close: Callable[[], None] = lambda: None

    def __enter__(self) -> _Progress:
        if sys.stderr.isatty():
            try:
                from rich.console import Console
                from rich.progress import Progress
            except ImportError:
                return self
            bar = Progress(console=Console(stderr=True), transient=True)
            task = bar.add_task(self._title, total=1.0)
            bar.start()
            self._update = lambda fraction: bar.update(task, completed=fraction)
            self._close = bar.stop
        return self

    def __exit__(self, *_: object) -> None:
        self._close()

    def show(self, fraction: float) -> None:
        self._update(fraction)

    def _print_tenths(self, fraction: float) -> None:
        if int(fraction * 10.0) > self._tenths:
            self._tenths = int(fraction * 10.0)
            print(f"{self._title}: {10 * self._tenths} %", file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
