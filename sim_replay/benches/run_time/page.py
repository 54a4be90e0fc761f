"""One page with the plot of run time against error, its table and the targets."""

from __future__ import annotations

import html
import math
import statistics
from collections.abc import Callable, Sequence
from typing import Final

from sim_replay.benches.run_time.measure import LIMITS_PER_KM2, SettingResult
from sim_replay.benches.run_time.one_run import DEFAULT
from sim_replay.benches.run_time.results import POINT_HEADER, RunTimeResults, on_front, point_rows, reason_words
from sim_replay.benches.run_time.targets import TARGET_HEADER, target_rows

_WIDTH, _HEIGHT = 900, 520
_LEFT, _RIGHT, _TOP, _BOTTOM = 60, 20, 20, 50
_PLOTTED: Final = 1  # index of the limit whose Pd is drawn
_COLOURS: Final = (
    "#1b6ca8",
    "#c1440e",
    "#3c7a3c",
    "#7a3c7a",
    "#8a6d1b",
    "#00838f",
    "#ad1457",
    "#455a64",
    "#5d4037",
    "#283593",
)
STYLE: Final = (
    "body{font:15px/1.4 system-ui,sans-serif;margin:2em auto;max-width:1100px;padding:0 "
    "1em}table{border-collapse:collapse;font-size:13px}"
    "td,th{border-bottom:1px solid #ccc;padding:3px 8px;text-align:left}svg{width:100%;height:auto;background:#fff}"
    ".missed{color:#b00}.default{font-weight:bold}div{overflow-x:auto}"
)


def run_time_page(results: RunTimeResults) -> str:
    """Write the page of the bench, HTML that needs nothing but itself."""
    machine = results.machine
    versions = ", ".join(f"{name} {version}" for name, version in machine.versions.items())
    load = " to ".join(f"{value:.1f}" for value in machine.load)
    rows = [("default" if row[0] == DEFAULT else "", row) for row in point_rows(results)]
    target_lines = [("missed" if row[5] == "missed" else "", row) for row in target_rows(results.targets)]
    profiles = "".join(
        f"<li>{html_text(one.name)}: {html_text(one.profile)}</li>" for one in results.targets if one.profile
    )
    return (
        '<!doctype html><html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
        f"<title>Run time against error</title><style>{STYLE}</style><h1>Run time against error</h1>"
        f"<p>{html_text(machine.date)}; {html_text(machine.processor)}, {machine.cores} cores, load {load}; "
        f"kernels: {html_text(machine.kernels)}; {html_text(versions)}. Processor time of whole processes on one core, "
        "medians "
        f"of {results.repeat} "
        f"repeats, all points in turn. {len(results.missions)} missions, {results.sonar_s:.0f} s of sonar: "
        f"{html_text(', '.join(results.missions))}. Intervals of Pd and contacts are 95 %; those of ratios go from the "
        "lowest to the highest "
        f"repeat.</p>{pareto_plot(results)}<p><b>The default</b> (ringed): {html_text(reason_words(results))}.</p>"
        f"<h2>Operating points</h2><div>{html_table(POINT_HEADER, rows)}</div>"
        + (
            f"<h2>Targets</h2><div>{html_table(TARGET_HEADER, target_lines)}</div><ul>{profiles}</ul>"
            if results.targets
            else ""
        )
        + "</html>\n"
    )


def pareto_plot(results: RunTimeResults) -> str:
    """Draw Pd against processor time per minute of sonar as SVG, with the front that no point beats in both."""
    shown = [point for point in results.points if point.pd and point.pd[_PLOTTED].value is not None]
    if not shown:
        return ""
    costs = {point.name: _cost(point, results.sonar_s) for point in shown}
    low, high = math.log(min(costs.values()) / 1.2), math.log(max(costs.values()) * 1.2)
    colours = {knob: _COLOURS[k % len(_COLOURS)] for k, knob in enumerate(dict.fromkeys(point.knob for point in shown))}

    def x(cost: float) -> float:
        return _LEFT + (_WIDTH - _LEFT - _RIGHT) * (math.log(cost) - low) / (high - low)

    def y(pd: float) -> float:
        return _TOP + (_HEIGHT - _TOP - _BOTTOM) * (1.0 - pd)

    parts = [_axes(x, y, math.exp(low), math.exp(high))]
    front = on_front(results)
    line = sorted((costs[point.name], _pd(point)) for point in shown if point.name in front)
    path = " ".join(f"{x(cost):.1f},{y(pd):.1f}" for cost, pd in line)
    parts.append(f'<polyline points="{path}" fill="none" stroke="#999" stroke-dasharray="5 4"/>')
    for point in shown:
        share, across, up = point.pd[_PLOTTED], x(costs[point.name]), y(_pd(point))
        words = (
            f"{point.name}: {costs[point.name]:.2f} s per minute, Pd {_pd(point):.2f} "
            f"({share.low:.2f}-{share.high:.2f})"
        )
        colour = colours[point.knob]
        ring = (
            f'<circle cx="{across:.1f}" cy="{up:.1f}" r="10" fill="none" stroke="#000"/>'
            if point.name == DEFAULT
            else ""
        )
        parts.append(
            f'<g><title>{html_text(words)}</title><line x1="{across:.1f}" x2="{across:.1f}" y1="{y(share.low):.1f}" '
            f'y2="{y(share.high):.1f}" '
            f'stroke="{colour}" stroke-opacity="0.25"/>{ring}<circle cx="{across:.1f}" cy="{up:.1f}" r="4.5" '
            f'fill="{colour}"/></g>'
        )
        if point.knob in (DEFAULT, "reference"):
            parts.append(f'<text x="{across + 12:.1f}" y="{up + 4:.1f}" font-size="12">{html_text(point.name)}</text>')
    for k, (knob, colour) in enumerate(colours.items()):
        place = _HEIGHT - _BOTTOM - 18 * (len(colours) - k)
        parts.append(
            f'<circle cx="{_WIDTH - 190}" cy="{place}" r="4.5" fill="{colour}"/>'
            f'<text x="{_WIDTH - 180}" y="{place + 4}" font-size="12">{html_text(knob)}</text>'
        )
    return (
        f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img" aria-label="Pd against processor '
        f'time">{"".join(parts)}</svg>'
    )


def _axes(x: Callable[[float], float], y: Callable[[float], float], low: float, high: float) -> str:
    parts = []
    for tenth in range(0, 11, 2):
        place = y(tenth / 10.0)
        parts.append(
            f'<line x1="{_LEFT}" x2="{_WIDTH - _RIGHT}" y1="{place:.1f}" y2="{place:.1f}" stroke="#eee"/>'
            f'<text x="{_LEFT - 8}" y="{place + 4:.1f}" font-size="12" text-anchor="end">{tenth / 10.0:.1f}</text>'
        )
    ticks = [
        mantissa * 10.0**power
        for power in range(-4, 5)
        for mantissa in (1, 2, 5)
        if low <= mantissa * 10.0**power <= high
    ]
    for tick in ticks:
        parts.append(
            f'<text x="{x(tick):.1f}" y="{_HEIGHT - _BOTTOM + 18}" font-size="12" text-anchor="middle">{tick:g}</text>'
        )
    limit = LIMITS_PER_KM2[_PLOTTED]
    parts.append(
        f'<text x="{(_LEFT + _WIDTH) / 2}" y="{_HEIGHT - 10}" font-size="13" text-anchor="middle">'
        "processor time per minute of sonar, s (logarithmic)</text>"
        f'<text x="16" y="{_HEIGHT / 2}" font-size="13" text-anchor="middle" transform="rotate(-90 16 {_HEIGHT / 2})">'
        f"Pd at {limit:g} false alarms per km²</text>"
    )
    return "".join(parts)


def _cost(point: SettingResult, sonar_s: float) -> float:
    return statistics.median(point.process_s()) / sonar_s * 60.0


def _pd(point: SettingResult) -> float:
    return point.pd[_PLOTTED].value or 0.0


def html_table(header: Sequence[str], rows: Sequence[tuple[str, Sequence[str]]]) -> str:
    """Write a table. rows: the class of each, and its cells."""
    head = "".join(f"<th>{html_text(cell)}</th>" for cell in header)
    body = "".join(
        f'<tr class="{kind}">' + "".join(f"<td>{html_text(cell)}</td>" for cell in row) + "</tr>" for kind, row in rows
    )
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def html_text(words: str) -> str:
    """Escape words for HTML."""
    return html.escape(words)
