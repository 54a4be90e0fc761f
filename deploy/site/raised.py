"""Find the notices that the sources raise and the counters that they count, by reading the sources.

A text is what stands in the source, with names in italics where values go, such as *port*.
"""

from __future__ import annotations

import ast
import importlib
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from functools import cache, cached_property
from pathlib import Path
from types import ModuleType
from typing import Final, NamedTuple, TypeAlias, get_args

ROOT: Final = Path(__file__).resolve().parents[2]
_PACKAGES: Final = ("auv_mcm", "drivers", "sim_replay")
_LEFT_OUT: Final = ("sim_replay/benches", "sim_replay/fakes")
_OR: Final = " / "  # between what a text says in one case and in the other
_NO_NAME: Final = "…"  # where a value goes whose expression has no name for a reader
# Dictionaries that end in the counters of summary.json, by their names in the sources.
_COUNTERS: Final = frozenset({"counters", "_counters", "_own", "_refused", "_counts"})

_Function: TypeAlias = ast.FunctionDef | ast.AsyncFunctionDef


class RaisedNotice(NamedTuple):
    """Describe a place that raises a notice. text: names where values go; for_the_record: None if that depends."""

    code: str
    text: str
    for_the_record: bool | None
    module: str
    line: int


class CountedName(NamedTuple):
    """Describe a place that counts. name: names in angle brackets where values go."""

    name: str
    module: str


def raised_notices(root: Path = ROOT) -> list[RaisedNotice]:
    """Find every notice, by code. Raises ValueError for one whose code cannot be read from the source."""
    found = [notice for module in _modules(root) for notice in module.notices()]
    return sorted(found, key=lambda notice: (notice.code, notice.module, notice.line))


def notices_by_code(notices: Sequence[RaisedNotice]) -> dict[str, list[RaisedNotice]]:
    """Group notices by code, each text once."""
    grouped: dict[str, list[RaisedNotice]] = {}
    for notice in notices:
        group = grouped.setdefault(notice.code, [])
        if all(notice.text != other.text for other in group):
            group.append(notice)
    return grouped


def counted_names(root: Path = ROOT) -> list[CountedName]:
    """Find every counter, by name."""
    return sorted({counted for module in _modules(root) for counted in module.counted()})


@cache
def _modules(root: Path) -> list[_Module]:
    """Parse the modules that raise notices or count. Benches and fakes raise and count for themselves alone."""
    modules = []
    for package in _PACKAGES:
        for path in sorted((root / package).rglob("*.py")):
            name, text = path.relative_to(root).as_posix(), path.read_text("utf-8")
            if not name.startswith(_LEFT_OUT) and re.search(r"\bNotice\(|Counter\b|\breport\.", text):
                modules.append(_Module(name, ast.parse(text), root))
    return modules


class _Module:
    def __init__(self, name: str, tree: ast.Module, root: Path) -> None:
        self.name, self._root = name, root
        self._nodes = list(ast.walk(tree))
        self._functions = [node for node in self._nodes if isinstance(node, _Function)]
        self._calls = [node for node in self._nodes if isinstance(node, ast.Call)]

    @cached_property
    def _imported(self) -> ModuleType:
        return importlib.import_module(self.name.removesuffix(".py").removesuffix("/__init__").replace("/", "."))

    # --- notices ---

    def notices(self) -> Iterator[RaisedNotice]:
        """Find the notices of this module, also those raised through a function that takes the code and the text."""
        raising: list[tuple[_Function | None, ast.Call, _Module]] = [
            (None, call, self) for call in self._calls_of("Notice")
        ]
        flag: ast.expr | None = None
        passed_on = set()
        while raising:
            through, call, where = raising.pop()
            given = _arguments(call, through)
            function = where._function_around(call)
            code = given["code"]
            if isinstance(code, ast.Name) and function is not None and code.id in _parameters(function):
                flag = given.get("for_the_record", flag) if through is None else flag
                if function.name not in passed_on:
                    passed_on.add(function.name)
                    raising += [
                        (function, further, module)
                        for module in (self, *self._importers(function))
                        for further in module._calls_of(function.name)
                    ]
                continue
            text = " ".join(where._text(given["text"], function).split())
            for one in where._codes(code, function):
                known = {**given, "code": ast.Constant(one)}
                for_the_record = self._value(given.get("for_the_record") if through is None else flag, known)
                yield RaisedNotice(one, text, for_the_record, where.name, call.lineno)

    def _importers(self, function: _Function) -> list[_Module]:
        """Find the modules that import this one, where the function is public."""
        dotted = self.name.removesuffix(".py").replace("/", ".")
        return [
            module
            for module in (() if function.name.startswith("_") else _modules(self._root))
            if any(isinstance(node, ast.ImportFrom) and node.module == dotted for node in module._nodes)
        ]

    def _codes(self, code: ast.expr, function: _Function | None) -> list[str]:
        """Read the codes that an expression can have. Raises ValueError where the source does not show them."""
        match code:
            case ast.Constant():
                return [str(code.value)]
            case ast.JoinedStr():
                codes = [""]
                for part in code.values:
                    ends = self._codes(part.value if isinstance(part, ast.FormattedValue) else part, function)
                    codes = [begin + end for begin in codes for end in ends]
                return codes
            case ast.Name():
                if codes := self._literals(code, function) or self._loop_values(code):
                    return codes
                if function is not None and (text := self._assigned(code, function)):
                    return text.split(_OR)
        place = f"{self.name}, line {code.lineno}"
        raise ValueError(f"{place}: the code of a notice cannot be read from the source: write it out there")

    def _literals(self, name: ast.Name, function: _Function | None) -> list[str]:
        """Read the values that a parameter annotated with a Literal can have."""
        for argument in () if function is None else function.args.args:
            if argument.arg == name.id and isinstance(argument.annotation, ast.Name):
                return [str(value) for value in get_args(getattr(self._imported, argument.annotation.id))]
        return []

    def _loop_values(self, name: ast.Name) -> list[str]:
        """Read the values of the table of the module that a loop over `TABLE.items()` gives a name."""
        for node in self._nodes:
            match node:
                case ast.For(target=target, iter=ast.Call(func=ast.Attribute(value=ast.Name(id=table)))) if (
                    name.id in _names(target)
                ):
                    return [str(value) for value in getattr(self._imported, table).values()]
        return []

    def _value(self, flag: ast.expr | None, given: Mapping[str, ast.expr]) -> bool | None:
        """Evaluate whether a notice is for the record; None if that depends on the run."""
        if flag is None or isinstance(flag, ast.Constant):
            return bool(flag and flag.value)
        if isinstance(flag, ast.Name):
            flag = next(
                node.value
                for node in self._nodes
                if isinstance(node, ast.Assign) and isinstance(flag, ast.Name) and flag.id in _names(node.targets[0])
            )
        names = dict(vars(self._imported))
        for name, value in ({"for_the_record": ast.Constant(value=False)} | dict(given)).items():
            with suppress(NameError):  # its value depends on the run
                names[name] = eval(ast.unparse(value), names)
        try:
            return bool(eval(ast.unparse(flag), names))
        except NameError:
            return None

    def _text(self, text: ast.expr, function: _Function | None) -> str:
        """Read a text as it stands in the source, with names in italics where values go."""
        match text:
            case ast.Constant():
                return str(text.value)
            case ast.JoinedStr():
                return "".join(self._text(part, function) for part in text.values)
            case ast.FormattedValue():
                return self._text(text.value, function)
            case ast.BinOp(op=ast.Add()):
                return self._text(text.left, function) + self._text(text.right, function)
            case ast.BinOp(op=ast.Mult()):
                return ""  # a sentence that is there in some cases only
            case ast.IfExp():
                return _OR.join(filter(str.strip, (self._text(text.body, function), self._text(text.orelse, function))))
            case ast.Name() if function is not None and (words := self._assigned(text, function)):
                return words
        return _placeholder(text)

    def _assigned(self, name: ast.Name, function: _Function) -> str:
        """Read the text that was last assigned to a name before its use, and what was added to it."""
        words = ""
        found = [
            node
            for node in ast.walk(function)
            if isinstance(node, ast.Assign | ast.AugAssign) and node.lineno < name.lineno
        ]
        for node in sorted(found, key=lambda node: node.lineno):
            target = node.targets[0] if isinstance(node, ast.Assign) else node.target
            if isinstance(target, ast.Name) and target.id == name.id and _is_text(node.value):
                words = (words if isinstance(node, ast.AugAssign) else "") + self._text(node.value, function)
        return words

    # --- counters ---

    def counted(self) -> Iterator[CountedName]:
        """Find the counters of this module."""
        for call in self._calls_of("Counter"):
            for table in call.args:
                for key in table.keys if isinstance(table, ast.Dict) else ():
                    if isinstance(key, ast.Constant):
                        yield CountedName(str(key.value), self.name)
        for node in self._nodes:
            target = (
                node.target
                if isinstance(node, ast.AugAssign)
                else node.targets[0]
                if isinstance(node, ast.Assign)
                else None
            )
            if not isinstance(target, ast.Subscript) or _last_name(target.value) not in _COUNTERS:
                continue
            for name in self._counter_names(target.slice, self._function_around(target)):
                if re.search(r"[a-z]", re.sub(r"<.*?>", "", name)):
                    yield CountedName(name, self.name)

    def _counter_names(self, key: ast.expr, function: _Function | None) -> list[str]:
        """Read the names that a key of the counters can be."""
        match key:
            case ast.Constant():
                return [str(key.value)]
            case ast.IfExp():
                return [*self._counter_names(key.body, function), *self._counter_names(key.orelse, function)]
            case ast.JoinedStr():
                return ["".join(self._counter_names(part, function)[0] for part in key.values)]
            case ast.FormattedValue():
                name = _last_name(key.value) or "value"
                return [str(vars(self._imported).get(name, f"<{name.strip('_')}>"))]
            case ast.Name() if function is not None and (words := self._assigned(key, function)):
                return words.split(_OR)
        return []

    # --- the tree ---

    def _calls_of(self, name: str) -> list[ast.Call]:
        return [call for call in self._calls if _last_name(call.func) == name]

    def _function_around(self, node: ast.expr) -> _Function | None:
        around = [one for one in self._functions if one.lineno <= node.lineno <= (one.end_lineno or 0)]
        return max(around, key=lambda one: one.lineno, default=None)


def _arguments(call: ast.Call, function: _Function | None) -> dict[str, ast.expr]:
    """Find what a call gives each parameter. function: the method that is called, None for the record itself."""
    positional = () if function is None else _parameters(function)[1:]
    return dict(zip(positional, call.args, strict=False)) | {word.arg: word.value for word in call.keywords if word.arg}


def _parameters(function: _Function) -> list[str]:
    return [argument.arg for argument in (*function.args.args, *function.args.kwonlyargs)]


def _names(target: ast.expr) -> list[str]:
    return [node.id for node in ast.walk(target) if isinstance(node, ast.Name)]


def _last_name(value: ast.expr) -> str:
    """Give the last name of `a.b.c`, empty for other expressions."""
    return value.attr if isinstance(value, ast.Attribute) else value.id if isinstance(value, ast.Name) else ""


def _is_text(value: ast.expr) -> bool:
    """Check whether an expression is made of text, so that it can be shown."""
    match value:
        case ast.BinOp(op=ast.Add()):
            return _is_text(value.left) or _is_text(value.right)
        case ast.IfExp():
            return _is_text(value.body) or _is_text(value.orelse)
        case ast.Constant():
            return isinstance(value.value, str)
    return isinstance(value, ast.JoinedStr)


def _placeholder(value: ast.expr) -> str:
    words = _last_name(value).strip("_").replace("_", " ")
    return f"*{words}*" if len(words) > 1 else _NO_NAME
