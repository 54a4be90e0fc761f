"""YAML for files that people write by hand: nothing is guessed, nothing silently dropped."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import msgspec
import yaml

from auv_mcm.errors import UsageError


def read_text(path: Path, what: str) -> str:
    """The text of a file; `what` it should be, for messages. Raises UsageError if it cannot be read or is no UTF-8."""
    try:
        return path.read_text("utf-8")
    except OSError as error:
        raise UsageError(f"{what} {path} cannot be read: {error.strerror}. Check the path") from error
    except UnicodeDecodeError as error:
        raise UsageError(f"{what} {path} is no UTF-8 text (byte {error.start})") from error


def load_mapping(text: str, place: str, expected: str) -> dict[Any, Any]:
    """The mapping that a YAML text holds, {} for an empty one; `place` names it in messages, `expected` says what it should be.

    Raises UsageError for text that is no YAML, repeated keys, aliases, and numbers that are not finite, with the key's path.
    """
    try:
        data: Any = yaml.load(text, _Loader)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise UsageError(f"{place}: not valid YAML: {error}") from error
    if data is None:
        data = {}
    if not isinstance(data, dict):
        raise UsageError(f"{place}: got {type(data).__name__}; {expected}")
    _refuse_non_finite(data, "", place)
    return data


def keyed(error: msgspec.ValidationError) -> str:
    """What a validation error says, with the key's path as it stands in the file."""
    return str(error).replace("`$.", "`").replace(" - at `$`", "")


class _Loader(yaml.SafeLoader):
    """YAML 1.2 scalars, so that 1e-4 is a number and `no`, `1:30` or a date is plain text. Repeated keys and aliases are refused."""

    yaml_implicit_resolvers: dict[str, list[tuple[str, re.Pattern[str]]]] = {}  # noqa: RUF012 (PyYAML's own class attribute)

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            raise yaml.composer.ComposerError(None, None, "aliases are not supported here: write the value out", self.get_mark())
        return super().compose_node(parent, index)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        mapping = super().construct_mapping(node, deep)
        if len(mapping) < len(node.value):
            keys = [self.construct_object(key) for key, _ in node.value]
            repeated = next(key for i, key in enumerate(keys) if key in keys[:i])
            raise yaml.constructor.ConstructorError(None, None, f"key {repeated!r} is given twice", node.start_mark)
        return mapping

    def construct_decimal(self, node: yaml.ScalarNode) -> int:
        return int(node.value)


_Loader.add_constructor("tag:yaml.org,2002:int", _Loader.construct_decimal)
for _tag, _pattern, _first in (
    ("bool", r"true|false", "tf"),
    ("null", r"null|~|", "n~"),
    ("int", r"[-+]?[0-9]+", "-+0123456789"),
    ("float", r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.inf|\.nan", "-+.0123456789"),
):
    # The empty scalar is filed by PyYAML under the empty string.
    _Loader.add_implicit_resolver(f"tag:yaml.org,2002:{_tag}", re.compile(f"(?:{_pattern})$"), [*_first, *([""] if _tag == "null" else [])])


def _refuse_non_finite(data: Any, path: str, place: str) -> None:
    if isinstance(data, float) and not math.isfinite(data):
        raise UsageError(f"{place}: Expected a finite number, got {data} - at `{path}`")
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in items:
        _refuse_non_finite(value, f"{path}.{key}" if path else str(key), place)
