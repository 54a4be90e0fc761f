"""Write tables of benches, in columns for a terminal or in Markdown, and rates in them; and models as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, Literal

import msgspec

from sim_replay.scoring.intervals import Density, Proportion

NOTHING: Final = "-"


def json_lines(value: Any, order: Literal["deterministic"] | None = None) -> bytes:
    """Write a model as JSON, a line per value; see msgspec for the order."""
    return msgspec.json.format(msgspec.json.encode(value, order=order), indent=1) + b"\n"


def share_cell(share: Proportion) -> str:
    """Write a share with its interval."""
    return NOTHING if share.value is None else f"{share.value:.2f} ({share.low:.2f}-{share.high:.2f})"


def density_cell(density: Density) -> str:
    """Write a number per km² with its interval."""
    if density.per_km2 is None or density.low is None or density.high is None:
        return NOTHING
    return f"{density.per_km2:.0f} ({density.low:.0f}-{density.high:.0f})"


def columns(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Lay out a table in columns of spaces."""
    widths = [max(len(line[column]) for line in (header, *rows)) for column in range(len(header))]
    lines = [
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
        for line in (header, *rows)
    ]
    return "\n".join([lines[0], "-" * len(lines[0]), *lines[1:]])


def markdown(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Lay out a table in Markdown."""
    return "\n".join(f"| {' | '.join(line)} |" for line in (header, ["---"] * len(header), *rows))
