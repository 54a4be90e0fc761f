"""Compare what a stage computes with exact or high-precision arithmetic, and watch its floating-point exceptions."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from fractions import Fraction
from functools import partial
from typing import Any, Final, NamedTuple, TypeAlias

import mpmath
import msgspec
import numpy as np

Exact: TypeAlias = Fraction | mpmath.mpf | int | float

DIGITS: Final = 50  # decimal digits of the reference: three times those of float64
STRESS_HEADER: Final = (
    *("stage", "inputs", "against", "largest error", "bound", "in float32", "condition", "exceptions", ""),
)
_ALLOWED: Final = "underflow"  # a number that is lost below 1e-308 is 0 to every stage


class Watch:
    """Call stages and note the floating-point exceptions that numpy raises in them."""

    def __init__(self) -> None:
        self.raised: set[str] = set()

    def __call__(self, door: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
        """Call a door with its arguments; returns what it returns."""
        with np.errstate(all="call", call=lambda kind, _: self.raised.add(kind)):
            return door(*arguments, **options)


class Found(NamedTuple):
    """Hold the largest error of a row.

    condition: of the problem, how much larger than its input's rounding the answer's error must be; single: the error
    that the same has in float32. NaN where they mean nothing.
    """

    error: float
    condition: float = math.nan
    single: float = math.nan


class NumberRow(NamedTuple):
    """Name a stage, its input and what it is held to.

    measure takes a watch, through which it calls the stage, and whether few inputs do.
    unit: of the error, "relative" or what it is in. reference: what the stage is compared with.
    """

    stage: str
    inputs: str
    reference: str
    unit: str
    bound: float
    measure: Callable[[Watch, bool], Found]

    @property
    def name(self) -> str:
        """Join stage and input."""
        return f"{self.stage}, {self.inputs}"


def each(
    stage: str,
    inputs: str,
    reference: str,
    unit: str,
    bound: float,
    measure: Callable[[Any, Watch, bool], Found],
    values: Iterable[Any],
) -> list[NumberRow]:
    """Name a row per value, which `inputs` has in braces and `measure` takes first."""
    return [NumberRow(stage, inputs.format(value), reference, unit, bound, partial(measure, value)) for value in values]


class NumberResult(msgspec.Struct, frozen=True):
    """Hold a measured row. exceptions: floating-point exceptions that numpy raised.

    error, condition, single: as in Found, None where they are no finite number, which JSON cannot hold.
    """

    stage: str
    inputs: str
    reference: str
    unit: str
    error: float | None
    bound: float
    condition: float | None
    single: float | None
    exceptions: tuple[str, ...]

    @property
    def holds(self) -> bool:
        """Check whether the error is within its bound and no exception was raised but underflow."""
        return self.error is not None and self.error <= self.bound and not set(self.exceptions) - {_ALLOWED}


def measure_row(row: NumberRow, quick: bool) -> NumberResult:
    """Measure one row."""
    watch = Watch()
    with mpmath.workdps(DIGITS):
        error, condition, single = (value if math.isfinite(value) else None for value in row.measure(watch, quick))
    names = row.stage, row.inputs, row.reference, row.unit
    return NumberResult(*names, error, row.bound, condition, single, tuple(sorted(watch.raised)))


def exact(value: Exact) -> mpmath.mpf:
    """Convert a number to the precision of the reference without a rounding of its own."""
    if isinstance(value, Fraction):
        return mpmath.mpf(value.numerator) / value.denominator
    return mpmath.mpf(value)


def relative(found: Iterable[float], references: Iterable[Exact]) -> float:
    """Find the largest relative error; infinite where a number is NaN, or not 0 where the reference is."""
    worst = 0.0
    for number, reference in zip(found, references, strict=True):
        wanted = exact(reference)
        if not math.isfinite(number):
            return math.inf
        off = abs(mpmath.mpf(number) - wanted)
        if off != 0:
            worst = max(worst, math.inf if wanted == 0 else float(off / abs(wanted)))
    return worst


def absolute(found: Iterable[float], references: Iterable[Exact]) -> float:
    """Find the largest difference; infinite where a number is NaN."""
    worst = 0.0
    for number, reference in zip(found, references, strict=True):
        off = abs(mpmath.mpf(number) - exact(reference)) if math.isfinite(number) else math.inf
        worst = max(worst, float(off))
    return worst


def unlike(one: Any, other: Any) -> float:
    """Count the numbers in which two results differ; arrays, or tuples of them."""
    if isinstance(one, tuple):
        return sum(unlike(a, b) for a, b in zip(one, other, strict=True))
    if one is None or other is None:
        return float(one is not other)
    a, b = np.asarray(one), np.asarray(other)
    if a.shape != b.shape or a.dtype != b.dtype:
        return math.inf
    return float(np.count_nonzero(~((a == b) | ((a != a) & (b != b)))))


def random_of(seed: int) -> np.random.Generator:
    """Make the generator of one row."""
    return np.random.Generator(np.random.PCG64(seed))


def stress_cells(result: NumberResult) -> list[str]:
    """Write a row of text of a measured row."""
    unit = "" if result.unit == "relative" else f" {result.unit}"
    return [
        result.stage,
        result.inputs,
        result.reference,
        "infinite" if result.error is None else f"{_number(result.error)}{unit}",
        _number(result.bound),
        _number(result.single),
        _number(result.condition),
        ", ".join(result.exceptions),
        "ok" if result.holds else "FAILED",
    ]


def _number(value: float | None) -> str:
    if value is None:
        return ""
    return f"{value:.0f}" if value == 0.0 else f"{value:.1e}"
