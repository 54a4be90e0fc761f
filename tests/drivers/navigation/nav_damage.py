"""Damage text as cables do: intact messages between the remains of others and noise, cut into chunks anywhere."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

from hypothesis import strategies as st

from auv_mcm.clock import Stamp
from drivers.navigation.nav_decoder import NavFix

T0 = Stamp(5_000_000_000, 1_700_000_000_000_000_000)


def at(seconds: float) -> Stamp:
    """Return a stamp so long after T0, on both clocks."""
    return Stamp(T0.mono_ns + round(seconds * 1e9), T0.utc_ns + round(seconds * 1e9))


class Unit(Protocol):
    def feed(self, data: bytes, stamp: Stamp) -> Sequence[NavFix]: ...
    def finish(self) -> Sequence[NavFix]: ...


def fed(unit: Unit, chunks: Sequence[bytes], finish: bool = True) -> list[NavFix]:
    found = [fix for chunk in chunks for fix in unit.feed(chunk, T0)]
    return [*found, *unit.finish()] if finish else found


@st.composite
def chunks_of(draw: st.DrawFn, stream: bytes) -> list[bytes]:
    cuts = sorted(draw(st.lists(st.integers(0, len(stream)), max_size=12)))
    return [stream[a:b] for a, b in zip([0, *cuts], [*cuts, len(stream)], strict=True)]


def is_subsequence(wanted: Sequence[Any], found: Sequence[Any]) -> bool:
    rest = iter(found)
    return all(any(item == other for other in rest) for item in wanted)
