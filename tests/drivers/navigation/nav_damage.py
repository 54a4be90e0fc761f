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
    def feed(self, data: bytes, stamp: Stamp) -> list[NavFix]: ...
    def finish(self) -> list[NavFix]: ...


def fed(unit: Unit, chunks: Sequence[bytes], finish: bool = True) -> list[NavFix]:
    found = [fix for chunk in chunks for fix in unit.feed(chunk, T0)]
    return found + unit.finish() if finish else found


@st.composite
def pieces(draw: st.DrawFn, messages: Sequence[bytes], noise: bytes) -> list[tuple[bytes, bool]]:
    """Up to 8 pieces, and whether each is an intact message. noise: bytes that are likelier than others."""
    found: list[tuple[bytes, bool]] = []
    marks = [noise[i : i + 1] for i in range(len(noise))]
    for _ in range(draw(st.integers(1, 8))):
        kind = draw(st.sampled_from(["intact", "intact", "noise", "cut", "head", "tail", "flipped", "inserted"]))
        piece = draw(st.sampled_from(messages))
        place = draw(st.integers(1, len(piece) - 1))
        if kind == "noise":
            piece = draw(st.lists(st.one_of(st.binary(max_size=9), st.sampled_from(marks)), max_size=8).map(b"".join))
        elif kind == "cut":
            piece = piece[:place] + piece[place + draw(st.integers(1, 30)) :]
        elif kind == "head":
            piece = piece[:place]
        elif kind == "tail":
            piece = piece[place:]
        elif kind == "flipped":
            piece = piece[:place] + bytes((piece[place] ^ 1 << draw(st.integers(0, 7)),)) + piece[place + 1 :]
        elif kind == "inserted":
            piece = piece[:place] + draw(st.binary(min_size=1, max_size=5)) + piece[place:]
        found.append((piece, kind == "intact"))
    return found


@st.composite
def chunks_of(draw: st.DrawFn, stream: bytes) -> list[bytes]:
    cuts = sorted(draw(st.lists(st.integers(0, len(stream)), max_size=12)))
    return [stream[a:b] for a, b in zip([0, *cuts], [*cuts, len(stream)], strict=True)]


def is_subsequence(wanted: Sequence[Any], found: Sequence[Any]) -> bool:
    rest = iter(found)
    return all(any(item == other for other in rest) for item in wanted)
