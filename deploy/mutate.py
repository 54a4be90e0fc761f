"""Change one operator, number or condition of the code at a time, and count the changes that no test notices.

python -m deploy.mutate                                     a sample of what decides calls, clearance and plans
python -m deploy.mutate --mutants 20 auv_mcm/plan           of some files or folders
python -m deploy.mutate --line auv_mcm/confirm/snake.py:40  all changes of a line

A change is made in memory alone: a process per change loads the module changed and runs the tests that import from it,
nearest first, up to the first that fails; with --whole those of its package too. So a change that survives may still be
noticed elsewhere, such as by the golden answers.
"""

from __future__ import annotations

import argparse
import ast
import copy
import multiprocessing
import os
import random
import resource
import sys
import time
from collections.abc import Iterator, Sequence
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import CodeType
from typing import Final, NamedTuple

ROOT: Final = Path(__file__).resolve().parents[1]
PLACES: Final = (
    "auv_mcm/confirm",
    "auv_mcm/classify",
    "auv_mcm/contacts",
    "auv_mcm/clearance",
    "auv_mcm/plan",
    "drivers/vehicle/guard.py",
)
"""What decides what goes out and where the vehicle is led."""
LIMIT_S: Final = 120  # s of processor time for the tests of one change: one that runs longer never ends, and is noticed
_SEED: Final = 45  # of the sample, so that a run repeats
NONE: Final = -1  # number of no change
_SURVIVED, _FAILED, _NOT_COLLECTED = 0, 1, 2  # exit codes of pytest
_SWAPPED: Final[dict[type[ast.AST], type[ast.AST]]] = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.And: ast.Or,
    ast.Or: ast.And,
}


class Change(NamedTuple):
    """Name one change. number: among the changes of its file. before, after: the code of the node."""

    path: Path
    number: int
    line: int
    before: str
    after: str

    def __str__(self) -> str:
        return f"{self.path.relative_to(ROOT)}:{self.line}: {self.before} -> {self.after}"


def changed(node: ast.AST) -> ast.AST | None:
    """Return a changed copy of a node; None where there is no change for its kind."""
    new = copy.deepcopy(node)
    match new:
        case ast.Compare() if type(new.ops[0]) in _SWAPPED:
            new.ops[0] = _SWAPPED[type(new.ops[0])]()  # type: ignore[call-overload]
        case ast.BinOp() | ast.BoolOp() | ast.AugAssign() if type(new.op) in _SWAPPED:
            new.op = _SWAPPED[type(new.op)]()  # type: ignore[assignment]
        case ast.UnaryOp(op=ast.Not() | ast.USub()):
            return new.operand
        case ast.If() | ast.IfExp() | ast.While():
            new.test = ast.UnaryOp(op=ast.Not(), operand=new.test)
        case ast.Constant(value=bool()):
            new.value = not new.value
        case ast.Constant(value=int(value)):
            new.value = value + 1
        case ast.Constant(value=float(value)):
            new.value = 1.5 * value or 1.0
        case ast.Expr(value=ast.Call()):
            return ast.Pass()
        case _:
            return None
    return new


def sites(tree: ast.AST) -> Iterator[tuple[ast.AST, str, int | None, ast.AST]]:
    """Yield what can be changed: the node above, its field and index in it, and the node; no annotation is."""
    for name, value in ast.iter_fields(tree):
        if name in ("annotation", "returns", "decorator_list", "type_params") or isinstance(tree, ast.Raise):
            continue
        for index, child in enumerate(value) if isinstance(value, list) else [(None, value)]:
            if not isinstance(child, ast.AST) or _is_for_types(child):
                continue
            if changed(child) is not None:
                yield tree, name, index, child
            yield from sites(child)


def _is_for_types(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"


def changes_of(path: Path) -> list[Change]:
    """List the changes of a file."""
    found = []
    for index, (_, _, _, node) in enumerate(sites(ast.parse(path.read_text("utf-8")))):
        new = changed(node)
        assert new is not None
        before, after = (ast.unparse(some).split("\n")[0] for some in (node, new))
        found.append(Change(path, index, getattr(node, "lineno", 0), before, after))
    return found


def compiled(change: Change) -> CodeType:
    """Compile the module with the change."""
    tree = ast.parse(change.path.read_text("utf-8"))
    if change.number != NONE:
        parent, name, index, node = list(sites(tree))[change.number]
        new = changed(node)
        assert new is not None
        if index is None:
            setattr(parent, name, new)
        else:
            getattr(parent, name)[index] = new
    return compile(ast.fix_missing_locations(tree), str(change.path), "exec")


def files_for(path: Path, whole: bool) -> list[str]:
    """List the tests that import from a module, nearest first, and those of its package: all, or where none does."""
    module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
    folder = ROOT / "tests" / path.parent.relative_to(ROOT)
    everywhere = sorted((ROOT / "tests" / path.relative_to(ROOT).parts[0]).rglob("test_*.py"))
    naming = [test for test in everywhere if f"{module} import" in test.read_text("utf-8")]
    naming.sort(key=lambda test: (path.stem not in test.stem, test.parent != folder))
    beside = sorted(folder.glob("test_*.py")) if whole or not naming else []
    return list(dict.fromkeys(str(test) for test in (*naming, *beside)))


def _tested(change: Change, whole: bool) -> None:
    """Run the tests with the change; the exit code is that of pytest."""
    import pytest

    resource.setrlimit(resource.RLIMIT_CPU, (LIMIT_S, LIMIT_S))
    code = compiled(change)
    original = SourceFileLoader.get_code

    def get_code(loader: SourceFileLoader, name: str) -> CodeType | None:
        return code if loader.path == str(change.path) else original(loader, name)

    SourceFileLoader.get_code = get_code  # type: ignore[method-assign, assignment]
    with open(os.devnull, "w", encoding="utf-8") as nowhere:
        os.dup2(nowhere.fileno(), 1)
        os.dup2(nowhere.fileno(), 2)
    sys.exit(int(pytest.main(["-q", "-x", "-p", "no:cacheprovider", "-n0", *files_for(change.path, whole)])))


def survives(change: Change, whole: bool) -> bool:
    """Find whether no test notices a change. Raises RuntimeError where the tests could not be run."""
    process = multiprocessing.get_context("fork").Process(target=_tested, args=(change, whole))
    process.start()
    process.join()
    code = process.exitcode or 0
    if code > 0 and code not in (_FAILED, _NOT_COLLECTED):
        raise RuntimeError(f"pytest ended with {code} for {change}")
    return code == _SURVIVED


def sample(places: Sequence[str], n_changes: int, seed: int) -> list[Change]:
    """Draw changes, as many from each place, whatever its size, and take turns."""
    drawn = random.Random(seed)
    found: list[tuple[int, Change]] = []
    for k, place in enumerate(places):
        at = ROOT / place
        paths = sorted(at.glob("*.py")) if at.is_dir() else [at]
        every = [change for path in paths for change in changes_of(path)]
        n_here = n_changes * (k + 1) // len(places) - n_changes * k // len(places)
        found += enumerate(drawn.sample(every, min(n_here, len(every))))
    return [change for _, change in sorted(found, key=lambda one: one[0])]


def main() -> int:
    """Change, test and print; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("places", nargs="*", default=PLACES, help="files and folders below the root")
    parser.add_argument("--mutants", type=int, default=120, help="how many changes, as many from each place")
    parser.add_argument("--seed", type=int, default=_SEED, help=f"of the sample (default {_SEED})")
    parser.add_argument("--line", action="append", metavar="FILE:LINE", help="all changes of a line instead")
    parser.add_argument("--whole", action="store_true", help="run all tests of a module's package")
    arguments = parser.parse_args()
    os.chdir(ROOT)
    if arguments.line:
        parted = [one.rpartition(":") for one in arguments.line]
        if not all(line.isdecimal() and (ROOT / name).is_file() for name, _, line in parted):
            parser.error("--line names a file below the root and a line in it, as auv_mcm/confirm/snake.py:40")
        asked = [(ROOT / name, int(line)) for name, _, line in parted]
        changes = [change for path, line in asked for change in changes_of(path) if change.line == line]
    else:
        if missing := [place for place in arguments.places if not (ROOT / place).exists()]:
            parser.error(f"there is no {missing[0]} below {ROOT}. Name files and folders of the source")
        changes = sample(arguments.places, arguments.mutants, arguments.seed)
    if changes and not survives(changes[0]._replace(number=NONE), arguments.whole):
        raise SystemExit(f"the tests of {changes[0].path.relative_to(ROOT)} fail without a change")
    n_noticed: dict[str, list[bool]] = {}
    start_s = time.monotonic()
    for change in changes:
        is_left = survives(change, arguments.whole)
        n_noticed.setdefault(str(change.path.parent.relative_to(ROOT)), []).append(not is_left)
        if is_left:
            print(f"survives: {change}", flush=True)
    for name, noticed in n_noticed.items():
        print(f"{name}: {sum(noticed)} of {len(noticed)} noticed")
    every = [one for noticed in n_noticed.values() for one in noticed]
    print(f"all: {sum(every)} of {len(every)} noticed, {time.monotonic() - start_s:.0f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
