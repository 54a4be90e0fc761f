"""The imports of the product: who may import whom."""

from __future__ import annotations

import ast
import sys
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from auv_mcm.shell.check.packages import IMPORTED_AS, parse_requirements

ROOT = Path(__file__).resolve().parents[1]
TOPS = ("auv_mcm", "drivers", "sim_replay")
STAGES = (
    "intake",
    "waterfall",
    "detect",
    "seabed",
    "confirm",
    "classify",
    "confirmation",
    "contacts",
    "clearance",
    "plan",
)
"""The stages of the payload in the order of the data."""
UNDER_STAGES = {
    *("records", "errors", "clock", "source", "settings", "geometry", "kernels", "solids", "snippet"),
    *("clean_text", "safe_files", "model_file", "skips"),
}
"""What every stage may import."""


def names_of(path: Path) -> Iterator[str]:
    """Yield the dotted name of everything that a module imports, late imports among them."""
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def module_of(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@cache
def graph() -> dict[str, set[str]]:
    """Map every module of the product to the modules of it that it imports."""
    files = (path for top in TOPS for path in sorted((ROOT / top).rglob("*.py")))
    paths = [path for path in files if "docs" not in path.relative_to(ROOT).parts]  # examples use all parts
    modules = {module_of(path): path for path in paths}

    def nearest(name: str) -> str | None:
        while name and name not in modules:
            name = name.rpartition(".")[0]
        return name or None

    return {
        module: {found for name in names_of(path) if (found := nearest(name)) is not None and found != module}
        for module, path in modules.items()
    }


@cache
def all_edges() -> list[tuple[str, str]]:
    """List every import of one module of the product by another."""
    return sorted((module, imported) for module, all_imported in graph().items() for imported in all_imported)


def edges(importer: str, imported: str) -> list[tuple[str, str]]:
    """Find the imports from one package, or module, into another."""

    def inside(module: str, package: str) -> bool:
        return module == package or module.startswith(package + ".")

    return [(a, b) for a, b in all_edges() if inside(a, importer) and inside(b, imported) and not inside(a, imported)]


def part_of(module: str) -> str:
    """Name the part of its top-level package that a module is in."""
    return ".".join(module.split(".")[:2])


def test_the_graph_is_not_empty() -> None:
    assert len(graph()) > 300
    assert len(all_edges()) > 1000
    assert ("auv_mcm.pipeline", "auv_mcm.records") in all_edges()


@pytest.mark.parametrize("imported", ["drivers", "sim_replay"])
def test_the_payload_imports_neither_drivers_nor_bench(imported: str) -> None:
    assert edges("auv_mcm", imported) == []


def test_drivers_do_not_import_the_bench() -> None:
    assert edges("drivers", "sim_replay") == []


def test_nobody_imports_benches() -> None:
    assert [edge for top in TOPS for edge in edges(top, "sim_replay.benches")] == []


def test_payload_and_drivers_import_packages_of_the_base_alone() -> None:
    declared = parse_requirements(
        tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["dependencies"]
    )
    base = {IMPORTED_AS.get(package.name, package.name) for package in declared[""]}
    optional = {"rich"}  # a progress bar, where it is installed
    imported = {
        (str(path.relative_to(ROOT)), name.partition(".")[0])
        for top in ("auv_mcm", "drivers")
        for path in (ROOT / top).rglob("*.py")
        if "docs" not in path.relative_to(ROOT).parts
        for name in names_of(path)
    }
    assert base <= {name for _, name in imported}, "a package that nothing imports"
    known = {*sys.stdlib_module_names, *TOPS, *base, *optional}
    assert [(path, name) for path, name in sorted(imported) if name not in known] == []


def test_kernels_import_no_stage() -> None:
    allowed = {"auv_mcm", "auv_mcm.kernels", "auv_mcm.solids", "auv_mcm.errors", "auv_mcm.records"}
    assert [
        (a, b)
        for a, b in edges("auv_mcm.kernels", "auv_mcm") + [e for e in all_edges() if e[0].startswith("auv_mcm.kernels")]
        if part_of(b) not in allowed
    ] == []


@pytest.mark.parametrize("stage", STAGES)
def test_no_stage_imports_a_later_one(stage: str) -> None:
    later = {f"auv_mcm.{name}" for name in STAGES[STAGES.index(stage) + 1 :]} | {
        "auv_mcm.pipeline",
        "auv_mcm.shell",
        "auv_mcm.commands",
    }
    assert [(a, b) for a, b in all_edges() if part_of(a) == f"auv_mcm.{stage}" and part_of(b) in later] == []


@pytest.mark.parametrize("part", sorted(UNDER_STAGES))
def test_what_stages_share_imports_no_stage(part: str) -> None:
    allowed = {f"auv_mcm.{name}" for name in UNDER_STAGES} | {"auv_mcm"}
    assert [(a, b) for a, b in all_edges() if part_of(a) == f"auv_mcm.{part}" and part_of(b) not in allowed] == []


def test_modules_import_each_other_in_no_circle() -> None:
    assert circles(graph()) == []


@pytest.mark.parametrize("top", TOPS)
def test_packages_import_each_other_in_no_circle(top: str) -> None:
    parts: dict[str, set[str]] = {}
    for a, b in all_edges():
        if a.startswith(top + ".") and b.startswith(top + ".") and part_of(a) != part_of(b):
            parts.setdefault(part_of(a), set()).add(part_of(b))
    assert circles(parts) == []


def circles(links: dict[str, set[str]]) -> list[list[str]]:
    """List groups of nodes that reach each other (R. Tarjan, SIAM J. Computing 1, 1972)."""
    number: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(node: str) -> None:
        number[node] = low[node] = len(number)
        stack.append(node)
        for following in sorted(links.get(node, ())):
            if following not in number:
                visit(following)
                low[node] = min(low[node], low[following])
            elif following in stack:
                low[node] = min(low[node], number[following])
        if low[node] == number[node]:
            group = stack[stack.index(node) :]
            del stack[stack.index(node) :]
            if len(group) > 1:
                found.append(sorted(group))

    for node in sorted(links):
        if node not in number:
            visit(node)
    return found


def test_a_circle_is_found() -> None:
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"b"}}) == [["b", "c"]]
