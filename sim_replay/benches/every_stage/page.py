"""One page with a plot of time against error per stage, and the table."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

from sim_replay.benches.every_stage.rows import StageRow
from sim_replay.benches.run_time.measure import BenchMachine
from sim_replay.benches.run_time.page import STYLE, html_table, html_text

_WIDTH, _HEIGHT = 520, 300
_LEFT, _RIGHT, _TOP, _BOTTOM = 60, 20, 20, 45
_OURS, _THEIRS = "#1b6ca8", "#c1440e"
_FEWEST_MS: Final = 1e-3  # what a time is drawn as that the clock reads as none


class _Point(NamedTuple):
    ms: float
    error: float
    words: str
    colour: str


def every_stage_page(
    machine: BenchMachine, rows: Sequence[StageRow], header: Sequence[str], cells: Sequence[Sequence[str]]
) -> str:
    """Write the page of the bench, HTML that needs nothing but itself."""
    versions = ", ".join(f"{name} {version}" for name, version in machine.versions.items())
    plots = "".join(
        f"<figure><figcaption>{html_text(f'{stage}: {unit}')}</figcaption>"
        f"{_plot([row for row in rows if (row.stage, row.unit) == (stage, unit)])}</figure>"
        for stage, unit in dict.fromkeys((row.stage, row.unit) for row in rows)
    )
    return (
        '<!doctype html><html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
        f"<title>Time against error of every stage</title><style>{STYLE}figure{{display:inline-block;width:30em;"
        "max-width:100%;margin:0.5em}</style><h1>Time against error of every stage</h1>"
        f"<p>{html_text(machine.date)}; {html_text(machine.processor)}, {machine.cores} cores; kernels: "
        f"{html_text(machine.kernels)}; {html_text(versions)}. Processor time of one thread. "
        f'<span style="color:{_OURS}">Blue</span>: this package; <span style="color:{_THEIRS}">red</span>: what a user '
        f"would take instead.</p>{plots}"
        f"<div>{html_table(header, [('missed' if row[-1] else '', row) for row in cells])}</div></html>\n"
    )


def _plot(rows: Sequence[StageRow]) -> str:
    """Draw error over the logarithm of time as SVG."""
    points = [_Point(max(row.cost.ms, _FEWEST_MS), row.error, row.setting, _OURS) for row in rows]
    points += [
        _Point(max(other.cost.ms, _FEWEST_MS), other.error, other.name, _THEIRS)
        for other in (row.alternative for row in rows)
        if other is not None and other.cost is not None and other.error is not None
    ]
    low = math.log(min(point.ms for point in points) / 1.5)
    high = math.log(max(point.ms for point in points) * 1.5)
    highest = max(point.error for point in points) or 1.0
    parts = []
    for tick in range(math.ceil(low / math.log(10.0)), math.floor(high / math.log(10.0)) + 1):
        across = _LEFT + (_WIDTH - _LEFT - _RIGHT) * (tick * math.log(10.0) - low) / (high - low)
        parts.append(
            f'<text x="{across:.1f}" y="{_HEIGHT - _BOTTOM + 18}" font-size="12" text-anchor="middle">{10.0**tick:g}'
            "</text>"
        )
    for share in (0.0, 0.5, 1.0):
        up = _TOP + (_HEIGHT - _TOP - _BOTTOM) * (1.0 - share)
        parts.append(
            f'<line x1="{_LEFT}" x2="{_WIDTH - _RIGHT}" y1="{up:.1f}" y2="{up:.1f}" stroke="#eee"/>'
            f'<text x="{_LEFT - 6}" y="{up + 4:.1f}" font-size="12" text-anchor="end">{share * highest:.2g}</text>'
        )
    for point in dict.fromkeys(points):
        across = _LEFT + (_WIDTH - _LEFT - _RIGHT) * (math.log(point.ms) - low) / (high - low)
        up = _TOP + (_HEIGHT - _TOP - _BOTTOM) * (1.0 - point.error / highest)
        words = html_text(f"{point.words}: {point.ms:.3g} ms, {point.error:.3g}")
        parts.append(
            f'<circle cx="{across:.1f}" cy="{up:.1f}" r="5" fill="{point.colour}"><title>{words}</title></circle>'
        )
    parts.append(
        f'<text x="{(_LEFT + _WIDTH) / 2}" y="{_HEIGHT - 8}" font-size="12" text-anchor="middle">processor time, ms '
        "(logarithmic)</text>"
    )
    return f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img" aria-label="error over time">{"".join(parts)}</svg>'
