"""Every public function, class and method is described, by a verb and its object, and tools can read its parameters."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Final, TypeAlias

import pytest

ROOT: Final = Path(__file__).parents[1]
PARTS: Final = ("auv_mcm", "drivers", "sim_replay")
VERB: Final = re.compile(r"[A-Z][a-z]+[,.;]?")
NO_VERB: Final = re.compile(
    r"(A|All|An|Any|As|At|Before|Both|By|Each|Every|For|From|How|If|In|It|Its|Most|No|Of|On|One|Our|Per|Same|Some\w*|"
    r"That|The|Their|These|This|Those|To|What|When|Where|Whether|Which|Who|Why|With)\b"
)

Described: TypeAlias = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef


def public(tree: ast.Module) -> Iterator[tuple[Described, bool]]:
    """Find the public functions, classes and methods of a module, and whether each is a method."""
    for node in tree.body:
        if isinstance(node, Described) and not node.name.startswith("_"):
            yield node, False
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            for each in node.body:
                if isinstance(each, Described) and not each.name.startswith("_"):
                    yield each, True


def found() -> dict[str, list[tuple[str, Described, bool]]]:
    """List what is public in each part, with its place."""
    return {
        part: [
            (f"{path.relative_to(ROOT)}:{node.lineno}: {node.name}", node, is_method)
            for path in sorted((ROOT / part).rglob("*.py"))
            for node, is_method in public(ast.parse(path.read_text("utf-8")))
        ]
        for part in PARTS
    }


@pytest.fixture(scope="module")
def described() -> dict[str, list[tuple[str, Described, bool]]]:
    return found()


@pytest.mark.parametrize("part", PARTS)
def test_all_that_is_public_is_described(part: str, described: dict[str, list[tuple[str, Described, bool]]]) -> None:
    """A method counts as described where another class, its interface, describes a method of its name."""
    interfaces = {
        node.name
        for items in described.values()
        for _, node, is_method in items
        if is_method and ast.get_docstring(node)
    }
    assert [
        place
        for place, node, is_method in described[part]
        if not ast.get_docstring(node) and not (is_method and node.name in interfaces)
    ] == []


@pytest.mark.parametrize("part", PARTS)
def test_a_docstring_begins_with_a_verb(part: str, described: dict[str, list[tuple[str, Described, bool]]]) -> None:
    texts = [(place, ast.get_docstring(node) or "") for place, node, _ in described[part]]
    first_words = [(place, text.split()[0]) for place, text in texts if text]
    assert [f"{place}: {word}" for place, word in first_words if not VERB.fullmatch(word) or NO_VERB.match(word)] == []


@pytest.mark.parametrize("part", PARTS)
def test_the_first_line_of_a_docstring_stands_alone(
    part: str, described: dict[str, list[tuple[str, Described, bool]]]
) -> None:
    texts = [(place, ast.get_docstring(node)) for place, node, _ in described[part]]
    assert [place for place, text in texts if text and not text.splitlines()[0].endswith((".", ":"))] == []


def parameters(node: Described) -> set[str]:
    """Name the parameters of a function, without its own object."""
    if isinstance(node, ast.ClassDef):
        return set()
    given = node.args
    every = [*given.posonlyargs, *given.args, *given.kwonlyargs, *filter(None, (given.vararg, given.kwarg))]
    return {each.arg for each in every} - {"self", "cls"}


def in_sections(text: str) -> set[str]:
    """Name the parameters that a numpydoc section explains."""
    section = re.search(r"^Parameters\n-+\n(.*?)(?=\n\n|\Z)", text, re.MULTILINE | re.DOTALL)
    lines = section[1].splitlines() if section else []
    return {name for line in lines if not line.startswith(" ") for name in line.split(", ")}


@pytest.mark.parametrize("part", PARTS)
def test_two_parameters_or_more_are_explained_in_a_section(
    part: str, described: dict[str, list[tuple[str, Described, bool]]]
) -> None:
    """The section names parameters that there are, and prose explains one at most."""
    wrong = []
    for place, node, _ in described[part]:
        text, names = ast.get_docstring(node) or "", parameters(node)
        in_prose = re.findall(rf"(?:^|[.;] )(?:{'|'.join(sorted(names))}): ", " ".join(text.split())) if names else []
        if not in_sections(text) <= names or (len(in_prose) > 1):
            wrong.append(place)
    assert wrong == []
