"""Check what the code of other packages gives, so that a wrong field is named at their door and not met far behind."""

from __future__ import annotations

import functools
import math
from collections import Counter
from collections.abc import Mapping
from numbers import Real
from types import NoneType, UnionType
from typing import Any, Final, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import msgspec
import numpy as np
from msgspec import structs

from auv_mcm.records import EchoTrace

S = TypeVar("S", bound=msgspec.Struct)
_WHOLE_BELOW: Final = float(1 << 63)  # the chain keeps numbers of pings in 64 bits


def check_record(record: object, *expected: type) -> None:
    """Check that a record is one of those expected, and every number and array in it what its field holds.

    Raises TypeError, which names the field. What is merely impossible, as a latitude of 400 degrees, passes: whoever
    uses it counts and refuses it.
    """
    if not isinstance(record, expected):
        *first, last = (one.__name__ for one in expected)
        wanted = f"{', '.join(first)} or {last}" if first else last
        raise TypeError(f"a {type(record).__name__} was given, not a {wanted}")
    _check_fields(record, type(record).__name__)


def own_samples(record: S) -> S:
    """Return a ping or frame whose samples nobody else changes; others use one buffer for all pings."""
    traces = {side: getattr(record, side, None) for side in ("port", "starboard")}
    copied = {
        side: structs.replace(trace, samples=np.array(trace.samples))
        for side, trace in traces.items()
        if isinstance(trace, EchoTrace)
    }
    return structs.replace(record, **copied) if copied else record


def clean_counters(counters: object) -> Counter[str]:
    """Return counters as names and whole numbers, which can be added and written; what is no number is left out."""
    items = counters.items() if isinstance(counters, Mapping) else ()
    return Counter({str(name): int(float(n)) for name, n in items if isinstance(n, Real) and math.isfinite(n)})


def _check_fields(record: Any, name: str) -> None:
    kind: Any = type(record)
    for field, hint in _hints(kind).items():
        _check(getattr(record, field), hint, f"{name}.{field}")


@functools.cache
def _hints(kind: Any) -> dict[str, Any]:
    return get_type_hints(kind)


def _check(value: Any, hint: Any, name: str) -> None:
    kind = get_origin(hint) or hint
    if kind in (UnionType, Union):  # of one type and None
        if value is None:
            return
        (hint,) = (one for one in get_args(hint) if one is not NoneType)
        kind = get_origin(hint) or hint
    if kind is float:
        _demand(isinstance(value, Real), value, name, "a number; NaN where it is not known")
    elif kind is int:
        is_whole = isinstance(value, Real) and math.isfinite(value) and abs(float(value)) < _WHOLE_BELOW
        _demand(is_whole, value, name, "a whole number of 64 bits")
    elif kind is Literal:
        _demand(value in get_args(hint), value, name, f"one of {', '.join(map(repr, get_args(hint)))}")
    elif kind is np.ndarray:
        is_row = isinstance(value, np.ndarray) and value.ndim == 1 and value.dtype.kind in "uif"
        _demand(
            is_row and not isinstance(value, np.ma.MaskedArray), value, name, "a plain numpy array (n,) of real numbers"
        )
    elif kind is tuple and get_args(hint)[1:] == (...,):
        _demand(isinstance(value, tuple | list), value, name, "a tuple")
        for index, item in enumerate(value):
            _check(item, get_args(hint)[0], f"{name}[{index}]")
    elif isinstance(kind, type) and (issubclass(kind, msgspec.Struct) or hasattr(kind, "_fields")):
        _demand(isinstance(value, kind), value, name, f"a {kind.__name__}")
        _check_fields(value, name)


def _demand(holds: bool, value: Any, name: str, wanted: str) -> None:
    if not holds:
        is_array = isinstance(value, np.ndarray)
        given = f"{value.shape} of {value.dtype}" if is_array else f"{value!r:.40}"
        raise TypeError(f"{name} is a {type(value).__name__} {given}, not {wanted}")
