"""Read YAML that people write by hand: no value is guessed, none silently dropped."""

from __future__ import annotations

import difflib
import math
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import msgspec
import yaml
from msgspec import inspect

from auv_mcm.clean_text import clean
from auv_mcm.errors import BadInputError, UsageError
from auv_mcm.safe_files import read_regular

MAX_TEXT_BYTES: Final = 1 << 19  # bytes of a file: forty times all keys of a configuration; takes up to 8 s to read


def read_text(path: Path, what: str) -> str:
    """Read the text of a file; `what` names the file's role in messages.

    Raises UsageError if it cannot be read, is no regular file, is larger than MAX_TEXT_BYTES or is not UTF-8.
    """
    try:
        return read_regular(path, MAX_TEXT_BYTES).decode("utf-8")
    except BadInputError as error:  # a pipe, a device, or too large
        raise UsageError(f"{what} {error}") from error
    except OSError as error:
        raise UsageError(f"{what} {path} cannot be read: {error.strerror}. Check the path") from error
    except UnicodeDecodeError as error:
        raise UsageError(f"{what} {path} is not UTF-8 text (byte {error.start})") from error


def load_mapping(text: str, place: str, expected: str) -> dict[Any, Any]:
    """Read the mapping in a YAML text, {} for an empty one.

    `place` names the text in messages, `expected` describes what it should hold.

    Raises UsageError for text that is not YAML, repeated keys, aliases, numbers that are not finite, and halves of
    surrogate pairs, with the key's path.
    """
    try:
        data: Any = yaml.load(text, _Loader)
    except (yaml.YAMLError, ValueError) as error:
        raise UsageError(f"{place}: not valid YAML: {error}") from error
    if data is None:
        data = {}
    if not isinstance(data, dict):
        raise UsageError(f"{place}: got {type(data).__name__}; {expected}")
    _refuse_unusable(data, "", place)
    return data


def explain_validation_error(error: msgspec.ValidationError, kind: type, data: Any = None) -> str:
    """Explain a validation error with the key's path as it stands in the file.

    Names the valid values of a choice, and the nearest known key.

    Parameters
    ----------
    kind
        The type that the file was converted to.
    data
        What the file holds, which says the kind of a section that may be of several.
    """
    message = str(error)
    text = message.replace("`$.", "`").replace(" - at `$`", "")
    at = _PLACE.search(message)
    root = inspect.type_info(kind)
    kinds = _kinds_at(root, at["path"] if at else "")
    if at and at["key"]:
        kinds = [key for here in kinds if isinstance(here, inspect.DictType) for key in _alternatives(here.key_type)]
    unknown = _UNKNOWN.match(message)
    if unknown is not None:
        kinds = _of_its_tag(kinds, data, at["path"] if at else "")
        return f"{text} ({_known_keys(unknown['name'], kinds, root)})"
    values = [str(value) for here in kinds if isinstance(here, inspect.LiteralType) for value in here.values]
    if not values:
        return text
    wrong = _WRONG_VALUE.search(message)
    near = difflib.get_close_matches(wrong["value"], values, n=1) if wrong else []
    return f"{text} ({f'did you mean {near[0]}? ' if near else ''}valid: {', '.join(values)})"


_PLACE: Final = re.compile(r" - at (?P<key>`key` in )?`\$(?P<path>[^`]*)`$")
_UNKNOWN: Final = re.compile(r"Object contains unknown field `(?P<name>[^`]*)`")
_WRONG_VALUE: Final = re.compile(r"Invalid (?:enum )?value '(?P<value>[^']*)'")
_MAX_DEPTH: Final = 64  # levels: chosen, ten times a configuration's; each deeper one costs as much as all before it
_SURROGATE: Final = re.compile("[\ud800-\udfff]")
_STEP: Final = re.compile(r"\.(?P<name>\w+)|\[(?P<index>\d+|\.\.\.)\]")


def _kinds_at(root: inspect.Type, path: str) -> list[inspect.Type]:
    """List the types that may stand at a path such as `.ports[0].device`.

    Several below a union, none where the path leads nowhere.
    """
    kinds = _alternatives(root)
    for step in _STEP.finditer(path):
        kinds = [below for kind in kinds for below in _below(kind, step)]
    return kinds


def _of_its_tag(kinds: list[inspect.Type], data: Any, path: str) -> list[inspect.Type]:
    """Leave of several sections that may stand at a path the one that the tag in it names; all where none is named."""
    for step in _STEP.finditer(path):
        try:
            data = data[step["name"] if step["name"] is not None else int(step["index"])]
        except (KeyError, IndexError, TypeError, ValueError):
            return kinds
    given = data if isinstance(data, dict) else {}
    tagged = [one for one in kinds if isinstance(one, inspect.StructType) and one.tag_field is not None]
    return [*filter(lambda one: given.get(one.tag_field) == one.tag, tagged)] or kinds


def _below(kind: inspect.Type, step: re.Match[str]) -> list[inspect.Type]:
    match kind:
        case inspect.StructType() if step["name"] is not None:
            if step["name"] == kind.tag_field:
                return [inspect.LiteralType((kind.tag,))]
            return [
                found
                for field in kind.fields
                if field.encode_name == step["name"]
                for found in _alternatives(field.type)
            ]
        case inspect.DictType():
            return _alternatives(kind.value_type)
        case inspect.VarTupleType() | inspect.ListType():
            return _alternatives(kind.item_type)
        case inspect.TupleType() if (step["index"] or "").isdecimal() and int(step["index"]) < len(kind.item_types):
            return _alternatives(kind.item_types[int(step["index"])])
    return []


def _alternatives(kind: inspect.Type) -> list[inspect.Type]:
    """Strip a type's description; give the members of a union."""
    match kind:
        case inspect.Metadata():
            return _alternatives(kind.type)
        case inspect.UnionType():
            return [found for member in kind.types for found in _alternatives(member)]
    return [kind]


def _known_keys(name: str, kinds: list[inspect.Type], root: inspect.Type) -> str:
    """Suggest what an unknown key should be: the same key in its own section, else the nearest one, else all keys."""
    known = list(dict.fromkeys(key for kind in kinds if isinstance(kind, inspect.StructType) for key in _keys(kind)))
    elsewhere = [path for path in _paths(root) if path.rpartition(".")[2] == name]
    if near := elsewhere[:1] or difflib.get_close_matches(name, known, n=1):
        return f"did you mean `{near[0]}`?"
    return f"known there: {', '.join(known)}"


def _keys(kind: inspect.StructType) -> list[str]:
    tag = [] if kind.tag_field is None else [kind.tag_field]
    return [*tag, *(field.encode_name for field in kind.fields)]


def _paths(kind: inspect.Type, before: str = "") -> Iterator[str]:
    """List paths of all keys below a section, lists left out."""
    for section in _alternatives(kind):
        if isinstance(section, inspect.StructType):
            for field in section.fields:
                yield f"{before}{field.encode_name}"
                yield from _paths(field.type, f"{before}{field.encode_name}.")


class _Loader(yaml.SafeLoader):
    """Load YAML 1.2 scalars: 1e-4 is a number and `no`, `1:30` or a date is plain text.

    Repeated keys and aliases are rejected.
    """

    yaml_implicit_resolvers: dict[str, list[tuple[str, re.Pattern[str]]]] = {}  # noqa: RUF012 (PyYAML's own class attribute)

    _depth = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            raise yaml.composer.ComposerError(
                None, None, "aliases are not supported here: write the value out", self.get_mark()
            )
        if self._depth >= _MAX_DEPTH:
            raise yaml.composer.ComposerError(None, None, f"more than {_MAX_DEPTH} levels deep", self.get_mark())
        self._depth += 1
        node: yaml.Node | None = super().compose_node(parent, index)
        self._depth -= 1
        return node

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        mapping = super().construct_mapping(node, deep)
        if len(mapping) < len(node.value):
            given = Counter(self.construct_object(key) for key, _ in node.value)
            repeated = next(key for key, n in given.items() if n > 1)
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
    _Loader.add_implicit_resolver(
        f"tag:yaml.org,2002:{_tag}", re.compile(f"(?:{_pattern})$"), [*_first, *([""] if _tag == "null" else [])]
    )


def _refuse_unusable(data: Any, path: str, place: str) -> None:
    """Refuse what has no meaning further on: numbers that are not finite, and text that no encoding takes."""
    if isinstance(data, float) and not math.isfinite(data):
        raise UsageError(f"{place}: Expected a finite number, got {data} - at `{path}`")
    if isinstance(data, str) and (half := _SURROGATE.search(data)) is not None:
        at = f" - at `{path}`" if path else ""
        raise UsageError(f"{place}: {clean(half[0])} is half a character: write the whole one as it is{at}")
    for key, value in data.items() if isinstance(data, dict) else ():
        _refuse_unusable(key, path, place)
        _refuse_unusable(value, f"{path}.{key}" if path else str(key), place)
    for index, value in enumerate(data if isinstance(data, list) else ()):
        _refuse_unusable(value, f"{path}.{index}" if path else str(index), place)
