"""Put the keys of the configuration, their kinds and their values in words."""

from __future__ import annotations

import math
from typing import Any

import yaml
from msgspec import inspect

from auv_mcm.settings.port_settings import PortConfig

# Choices, written without quotes because none of them means anything else in YAML.
_WORDS = frozenset({"auto", "amplitude", "intensity", "log", "near_to_far", "far_to_near"})


def port_keys() -> list[str]:
    """Describe every key of one of the `ports`, one line each: kind, range, default and meaning."""
    return _keys_of(inspect.type_info(PortConfig), "")


def bare(kind: inspect.Type) -> inspect.Type:
    """Strip the description of a kind; of one that may be empty, give the section that it may be."""
    if isinstance(kind, inspect.Metadata):
        kind = kind.type
    if isinstance(kind, inspect.UnionType):
        return next((member for member in kind.types if isinstance(member, inspect.StructType)), kind)
    return kind


def _keys_of(section: inspect.Type, path: str) -> list[str]:
    assert isinstance(section, inspect.StructType)
    lines = []
    for field in section.fields:
        if isinstance(bare(field.type), inspect.StructType):
            lines += _keys_of(bare(field.type), f"{path}{field.name}.")
            continue
        description = _stated(field.type, "description")
        default = "required" if field.required else f"default {_scalar(field.default) or 'empty'}"
        lines.append(
            f"{path}{field.name}: {_kind(field.type)}; {default}" + (f" - {description}" if description else "")
        )
    return lines


def key_lines(field: inspect.Field, value: Any, indent: str) -> list[str]:
    """Write a key as YAML with `value`, after its meaning, kind and default."""
    return [
        f"{indent}# {_stated(field.type, 'description')}",
        f"{indent}# {_kind(field.type)}; default {_scalar(field.default) or 'empty'}",
        f"{indent}{field.name}: {_scalar(value)}".rstrip(),
    ]


def _stated(kind: inspect.Type, what: str) -> Any:
    """Give what is stated beside a kind, "" if nothing is."""
    return (kind.extra_json_schema or {}).get(what, "") if isinstance(kind, inspect.Metadata) else ""


def _kind(kind: inspect.Type) -> str:
    """Describe in words what a key takes."""
    if examples := _stated(kind, "examples"):
        return f"one of {', '.join(map(str, examples))}, or one that another package adds"
    if isinstance(kind, inspect.Metadata):
        kind = kind.type
    if isinstance(kind, inspect.DictType):
        return "keys with values"
    if isinstance(kind, inspect.LiteralType):
        return "one of " + ", ".join(str(value) for value in kind.values)
    if isinstance(kind, inspect.BoolType):
        return "true or false"
    if isinstance(kind, inspect.StrType):
        return "text" if kind.max_length is None else f"text of at most {kind.max_length} characters"
    if isinstance(kind, inspect.VarTupleType):
        item = bare(kind.item_type)
        return (
            "list; 'auv-mcm run --example' prints one"
            if isinstance(item, inspect.StructType)
            else f"list: {_kind(item)}"
        )
    if isinstance(kind, inspect.TupleType):
        return f"list of {len(kind.item_types)}: {_kind(kind.item_types[0])}"
    if isinstance(kind, inspect.UnionType):
        return ", or ".join(
            ["empty" if isinstance(member, inspect.NoneType) else _kind(member) for member in kind.types]
        )
    if isinstance(kind, inspect.IntType | inspect.FloatType):
        word = "whole number" if isinstance(kind, inspect.IntType) else "number"
        if kind.ge is not None and kind.le is not None:
            return f"{word} from {kind.ge:g} to {kind.le:g}"
        bounds = (("at least", kind.ge), ("above", kind.gt), ("at most", kind.le), ("below", kind.lt))
        return f"{word} {' and '.join(f'{name} {bound:g}' for name, bound in bounds if bound is not None)}".rstrip()
    raise TypeError(f"no words for {kind}")  # a new kind of key needs its words here


def _scalar(value: Any) -> str:
    """Write one value as YAML on one line; empty for None.

    Exponents get a decimal point, which YAML 1.1 readers insist on.
    """
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return "[" + ", ".join(_scalar(item) for item in value) + "]"
    if isinstance(value, str):
        return (
            value
            if value in _WORDS
            else yaml.safe_dump(value, default_style='"', allow_unicode=True, width=math.inf).rstrip("\n")
        )
    text = repr(value)
    return text if "e" not in text or "." in text else text.replace("e", ".0e")
