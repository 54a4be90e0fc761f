"""Every numeric constant has a reason beside it: its unit with a source, an effect, or an honest choice."""

from __future__ import annotations

import ast
import io
import itertools
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import pytest

ROOT: Final = Path(__file__).parents[1]
# Constants without a reason in each part: none may come back.
LIMITS: Final = {"auv_mcm": 0, "drivers": 0, "sim_replay": 0}
CONSTANT_NAME: Final = re.compile(r"_*[A-Z][A-Z0-9_]*")


def is_number(value: ast.expr) -> bool:
    """Find whether an expression is made of numbers alone; one that names another constant is derived."""
    if isinstance(value, ast.Constant):
        return isinstance(value.value, int | float) and not isinstance(value.value, bool)
    if isinstance(value, ast.UnaryOp):
        return is_number(value.operand)
    if isinstance(value, ast.BinOp):
        return is_number(value.left) and is_number(value.right)
    return isinstance(value, ast.Tuple) and bool(value.elts) and all(is_number(each) for each in value.elts)


def name_and_value(statement: ast.stmt) -> tuple[str, ast.expr] | None:
    """Read a statement that binds one constant's name."""
    if isinstance(statement, ast.AnnAssign) and statement.value is not None:
        target: ast.expr = statement.target
    elif isinstance(statement, ast.Assign) and len(statement.targets) == 1:
        target = statement.targets[0]
    else:
        return None
    assert statement.value is not None
    if isinstance(target, ast.Name) and CONSTANT_NAME.fullmatch(target.id):
        return target.id, statement.value
    return None


def is_text(statement: ast.stmt | None) -> bool:
    """Find whether a statement is a string alone, as below an attribute that it documents."""
    return (
        isinstance(statement, ast.Expr)
        and isinstance(statement.value, ast.Constant)
        and isinstance(statement.value.value, str)
    )


def is_list_of_constants(node: ast.ClassDef) -> bool:
    """Find whether a class holds constants alone, such as the values of a field, under a docstring."""
    return ast.get_docstring(node) is not None and all(name_and_value(each) for each in node.body[1:])


def unexplained(source: str) -> Iterator[tuple[int, str]]:
    """Find the numeric constants of a module and its classes that nothing explains.

    A comment explains the constants on its line, or all that follow it until a blank line or another statement. The
    docstring of a class that holds constants alone explains them.
    """
    lines = source.splitlines()
    comments = {
        token.start[0]: lines[token.start[0] - 1].lstrip().startswith("#")
        for token in tokenize.generate_tokens(io.StringIO(source).readline)
        if token.type == tokenize.COMMENT
    }
    module = ast.parse(source)
    classes = (node for node in ast.walk(module) if isinstance(node, ast.ClassDef))
    for body in [module.body, *(each.body for each in classes if not is_list_of_constants(each))]:
        explained_to = -1  # the last line of a group whose comment stands above it
        for statement, below in itertools.zip_longest(body, body[1:]):
            first, last = statement.lineno, statement.end_lineno or statement.lineno
            constant = name_and_value(statement)
            grouped = comments.get(first - 1, False) or explained_to == first - 1
            explained_to = last if grouped and constant is not None else -1
            if constant is None or not is_number(constant[1]):
                continue
            if not grouped and not is_text(below) and not any(line in comments for line in range(first, last + 1)):
                yield first, constant[0]


@pytest.mark.parametrize("part", list(LIMITS))
def test_every_numeric_constant_has_a_reason(part: str) -> None:
    found = [
        f"{path.relative_to(ROOT)}:{line}: {name}"
        for path in sorted((ROOT / part).rglob("*.py"))
        for line, name in unexplained(path.read_text("utf-8"))
    ]
    assert len(found) <= LIMITS[part], "\n".join(found)
