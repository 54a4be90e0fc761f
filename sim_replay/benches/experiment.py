"""Run an experiment: missions times variants to columns, as a table, Markdown or JSON, beside an older run.

An experiment is a declaration: which scenes, how one mission is flown with every variant on the same pings, and what
each column says of the missions of one variant. Recorded lines with targets embedded can be missions as well.
"""

from __future__ import annotations

import argparse
import gc
import math
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, Generic, NamedTuple, TypeVar

import msgspec

from auv_mcm.errors import UsageError
from sim_replay.arguments import add_line_options, count, new_file
from sim_replay.augment.recorded_line import check_lines
from sim_replay.benches.run_time.bench import write_result
from sim_replay.benches.run_time.measure import BenchMachine, this_machine
from sim_replay.benches.run_time.results import read_bench_file
from sim_replay.fitting.cascade.farm import Farm, run_tasks
from sim_replay.flights import Flight, flight_along, flight_through
from sim_replay.scoring.intervals import Density, Proportion
from sim_replay.scoring.thresholds import resampled
from sim_replay.simulator.scene import Scene
from sim_replay.simulator.scene_file import named_scenes, read_scene
from sim_replay.text_tables import NOTHING, columns, density_cell, markdown, share_cell

_FORMAT_VERSION: Final = 1  # of the file; a change of its fields raises it
_PAIRED_SEED: Final = 1  # of missions drawn again, fixed so that reports repeat
_SAME: Final = 1e-9  # relative, and absolute: rounding is no change of a figure

Result = TypeVar("Result")


class Cell(msgspec.Struct, frozen=True):
    """Hold what a table shows, and the number behind it with its interval of 95 %, where there is one."""

    text: str
    value: float | None = None
    low: float | None = None
    high: float | None = None


class Task(NamedTuple):
    """Name one mission: a scene or the path of a recorded line, a seed, and the experiment's own options."""

    scene: str
    seed: int
    options: Mapping[str, Any] = {}


class Column(NamedTuple, Generic[Result]):
    """Define a column: what it says of the missions of one variant."""

    title: str
    of: Callable[[Sequence[Result]], Cell]


class PairedColumn(NamedTuple, Generic[Result]):
    """Define a column of a figure less that of the first variant, with the interval of missions drawn again in pairs.

    A mission alone, and the first variant itself, have none.
    """

    title: str
    of: Callable[[Sequence[Result]], float]


class Experiment(NamedTuple, Generic[Result]):
    """Declare an experiment.

    scenes: by default. variants: their names, in the order of the table; the first is what others are compared with.
    variant_title: heads them. fly: flies one mission with every variant, of a module's top level, so that processes can
    share the work. n_draws: of targets per recorded line; 0 if it takes none. by_scene: whether each scene has rows of
    its own, before those of all. add_options: adds the experiment's own options, of which `own_options` names those
    that `fly` needs. words: says below the table what fits in no column.
    A mission may lack variants, but for the first where figures are paired.
    """

    name: str
    scenes: tuple[str, ...]
    first_seed: int
    variant_title: str
    variants: tuple[str, ...]
    fly: Callable[[Task], Mapping[str, Result]]
    columns: tuple[Column[Result] | PairedColumn[Result], ...]
    n_seeds: int = 1
    n_draws: int = 0
    by_scene: bool = True
    add_options: Callable[[argparse.ArgumentParser], None] = lambda parser: None
    own_options: tuple[str, ...] = ()
    words: Callable[[Sequence[Mapping[str, Result]]], str] = lambda flown: ""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Add the options that every experiment has, and its own."""
        first = self.first_seed
        parser.add_argument(
            "--seeds", type=count, default=self.n_seeds, help=f"missions per scene (default {self.n_seeds})"
        )
        parser.add_argument(
            "--first-seed", type=count, default=first, help=f"seed of each scene's first mission (default {first})"
        )
        parser.add_argument("--scenes", help=f"by name, with commas between (default {','.join(self.scenes)})")
        parser.add_argument("--scene", action="append", metavar="NAME", help="one of them, repeatable")
        if self.n_draws:
            add_line_options(parser, self.n_draws)
        self.add_options(parser)
        parser.add_argument("--workers", type=count, default=2, help="missions flown at once (default 2)")
        parser.add_argument("--markdown", action="store_true", help="print the table in Markdown")
        parser.add_argument("--json", type=new_file, metavar="FILE", help="write every figure to FILE")
        parser.add_argument("--compare", type=Path, metavar="OLD", help="say what moved since a run that --json wrote")

    def run(self, arguments: argparse.Namespace) -> int:
        """Fly, print and write; returns the exit code.

        Raises UsageError for scenes or files that are not there, BadInputError for a recorded line that cannot be used.
        """
        scenes = _scenes_of(self, arguments)
        old = None if arguments.compare is None else read_experiment(arguments.compare, self.name)
        options = {name: getattr(arguments, name) for name in self.own_options}
        first = arguments.first_seed
        tasks = [Task(scene, seed, options) for scene in scenes for seed in range(first, first + arguments.seeds)]
        if self.n_draws and arguments.log:
            draws = range(first, first + arguments.log_seeds)
            check_lines(arguments.log, draws)
            tasks += [Task(str(log), seed, options) for log in arguments.log for seed in draws]
        load = os.getloadavg()[0]
        flown = list(run_tasks(self.fly, tasks, Farm(arguments.workers), counted(len(tasks))))
        rows = experiment_rows(self, [Path(task.scene).stem for task in tasks], flown)
        print((markdown if arguments.markdown else columns)(*table_of(self, rows)))
        if words := self.words(flown):
            print(f"\n{words}")
        results = ExperimentResults(
            experiment=self.name,
            machine=this_machine(load),
            scenes=scenes,
            first_seed=arguments.first_seed,
            n_seeds=arguments.seeds,
            rows=tuple(rows),
        )
        if old is not None:
            print("\nmoved:\n" + ("\n".join(moved_figures(old, results)) or "nothing"))
        write_result("--json", arguments.json, msgspec.json.format(msgspec.json.encode(results), indent=1))
        return 0


class ExperimentRow(msgspec.Struct, frozen=True):
    """Hold one row: which missions, which variant, and a cell per column by its title."""

    missions: str
    variant: str
    cells: dict[str, Cell]


class ExperimentResults(msgspec.Struct, frozen=True, kw_only=True):
    """Hold one run of an experiment."""

    format_version: int = _FORMAT_VERSION
    experiment: str
    machine: BenchMachine
    scenes: tuple[str, ...]
    first_seed: int
    n_seeds: int
    rows: tuple[ExperimentRow, ...]


def share(found: Proportion) -> Cell:
    """Show a share with its interval."""
    return Cell(share_cell(found), found.value, found.low, found.high)


def density(found: Density) -> Cell:
    """Show a number per km² with its interval."""
    return Cell(density_cell(found), found.per_km2, found.low, found.high)


def number(value: float, digits: int = 0) -> Cell:
    """Show a number without an interval."""
    return Cell(f"{value:.{digits}f}", value)


def counted(total: int) -> Callable[[int], None]:
    """Return what shows on standard error how many of a total are flown, and ends the line with the last."""

    def show(done: int) -> None:
        print(f"\r{done} of {total} missions flown", end="" if done < total else "\n", file=sys.stderr, flush=True)

    return show


def _scenes_of(experiment: Experiment[Any], arguments: argparse.Namespace) -> tuple[str, ...]:
    """Choose scenes. Raises UsageError for one that is not there or is named twice, and for both options at once."""
    if arguments.scene and arguments.scenes is not None:
        raise UsageError("--scene and --scenes both choose scenes: give one of them")
    text = ",".join(arguments.scene or experiment.scenes) if arguments.scenes is None else arguments.scenes
    names = tuple(text.split(","))
    if unknown := [repr(name) for name in names if name not in named_scenes()]:
        raise UsageError(f"--scenes: there is no {', '.join(unknown)}. Choose from {', '.join(named_scenes())}")
    if len(set(names)) < len(names):
        raise UsageError(f"--scenes {text}: a scene is named twice. Name each once")
    return names


@contextmanager
def mission_source(task: Task, change: Callable[[Scene], Scene] = lambda scene: scene) -> Iterator[Flight]:
    """Prepare a task's mission; files that it needs go when it is left. change: of a named scene, after its seed."""
    gc.collect()  # a mission refers to itself: the sea floor of the one before, 300 MB, would stay for long
    if task.scene in named_scenes():
        yield flight_through(change(msgspec.structs.replace(read_scene(task.scene), seed=task.seed)))
        return
    with flight_along(Path(task.scene), task.seed) as flight:
        yield flight


def experiment_rows(
    experiment: Experiment[Result], scenes: Sequence[str], flown: Sequence[Mapping[str, Result]]
) -> list[ExperimentRow]:
    """Make the rows of a run: of each scene or recorded line, and of all missions together.

    Parameters
    ----------
    experiment
        What was run.
    scenes
        The scene or recorded line of each mission.
    flown
        What each variant made of each mission.
    """
    groups = {name: [one for one, scene in zip(flown, scenes, strict=True) if scene == name] for name in scenes}
    simulated = [one for one, scene in zip(flown, scenes, strict=True) if scene in named_scenes()]
    pooled = {"all": list(flown)}
    if 0 < len(simulated) < len(flown):
        recorded = [one for one, scene in zip(flown, scenes, strict=True) if scene not in named_scenes()]
        pooled = {"all simulated": simulated, "all recorded": recorded}
    if not experiment.by_scene:
        groups = pooled
    elif len(groups) > 1:
        groups |= pooled
    return [
        ExperimentRow(
            title, variant, {column.title: _cell(experiment, column, variant, some) for column in experiment.columns}
        )
        for title, some in groups.items()
        for variant in experiment.variants
        if any(variant in one for one in some)
    ]


def table_of(experiment: Experiment[Any], rows: Sequence[ExperimentRow]) -> tuple[list[str], list[list[str]]]:
    """Lay rows out: the header and the text of every cell."""
    first = ["missions"] if experiment.by_scene else []
    header = [*first, experiment.variant_title, *(column.title for column in experiment.columns)]
    return header, [
        [*([row.missions] if first else []), row.variant, *(cell.text for cell in row.cells.values())] for row in rows
    ]


def moved_figures(old: ExperimentResults, new: ExperimentResults) -> list[str]:
    """Say which figures moved, a line each, and which of them left the old interval."""
    asked = [(run.scenes, run.first_seed, run.n_seeds) for run in (old, new)]
    lines = [] if asked[0] == asked[1] else ["other missions: scenes or seeds differ"]
    before = {(row.missions, row.variant): row.cells for row in old.rows}
    for row in new.rows:
        cells = before.pop((row.missions, row.variant), None)
        name = f"{row.missions}, {row.variant}"
        if cells is None:
            lines.append(f"{name}: new")
            continue
        for title, cell in row.cells.items():
            was = cells.get(title)
            if was is None:
                lines.append(f"{name}, {title}: new")
            elif not _same(was, cell):
                lines.append(f"{name}, {title}: {was.text} -> {cell.text}{_beyond(was, cell)}")
    return lines + [f"{missions}, {variant}: no longer measured" for missions, variant in before]


def read_experiment(path: Path, name: str) -> ExperimentResults:
    """Read an older run of the experiment of that name.

    Raises UsageError for a file that cannot be read or is of another experiment, BadInputError for one that is no such
    run.
    """
    made_by = f"auv-mcm bench {name} --json FILE"
    found = read_bench_file(path, ExperimentResults, _FORMAT_VERSION, made_by)
    if found.experiment != name:
        raise UsageError(f"--compare {path} is of '{found.experiment}': give a file that '{made_by}' wrote")
    return found


def _cell(
    experiment: Experiment[Result],
    column: Column[Result] | PairedColumn[Result],
    variant: str,
    flown: Sequence[Mapping[str, Result]],
) -> Cell:
    flown = [one for one in flown if variant in one]
    own = [one[variant] for one in flown]
    if isinstance(column, Column):
        return column.of(own)
    base = [one[experiment.variants[0]] for one in flown]
    if variant == experiment.variants[0] or len(flown) < 2:
        return Cell(NOTHING)
    found = resampled(
        lambda some: column.of([own[k] for k in some]) - column.of([base[k] for k in some]),
        len(flown),
        seed=_PAIRED_SEED,
    )
    return Cell(str(found), *found)


def _same(was: Cell, now: Cell) -> bool:
    if was.value is None or now.value is None:
        return was.text == now.text
    return math.isclose(was.value, now.value, rel_tol=_SAME, abs_tol=_SAME)


def _beyond(was: Cell, now: Cell) -> str:
    if None in (was.low, was.high, now.value):
        return ""
    assert was.low is not None
    assert was.high is not None
    assert now.value is not None
    return "" if was.low <= now.value <= was.high else " (beyond its interval)"
