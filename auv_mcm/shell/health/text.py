"""Render a record of health: one line for the log, a table for a terminal, and the text format of Prometheus."""

from __future__ import annotations

from typing import Final

from auv_mcm.clean_text import clean
from auv_mcm.shell.health.record import REASONS, STATES, VALUES, Health, Part

_BASE_UNITS: Final = {"_s": "_seconds", "_hz": "_per_second", "_c": "_celsius"}
"""Endings of names as Prometheus has them, by ours."""


def health_line(health: Health) -> str:
    """Write the health line of the log: counts of the mission, ports, vehicle, and the state with its reasons."""
    parts = {part.name: part for part in health.parts}
    service, perception = parts["service"].values, parts["perception"].values
    ports = [part for part in health.parts if part.name.startswith("port.")]
    words = [
        f"pings={perception['pings_total']:.0f}",
        f"queue={perception['queue_pings']:.0f}/{perception['queue_pings_limit']:.0f}",
        f"in_flight={perception['messages_in_flight']:.0f}",
        f"dropped={perception['pings_dropped_total']:.0f}",
        f"contacts={service['contacts']:.0f}",
        f"clutter={service['clutter']:.0f}",
        f"lag_ms={service['event_loop_late_s'] * 1e3:.1f}",
    ]
    if "no_kernels" in parts["perception"].reasons:
        words.append("kernels=NUMPY")
    if ports:
        words.append("ports=" + ",".join(f"{part.name.removeprefix('port.')}:{_link_state(part)}" for part in ports))
    if "vehicle" in parts:
        words.append(parts["vehicle"].words)
    words.append(f"state={health.state}" + "".join(f",{reason}" for reason in health.reasons))
    return " ".join(words)


def health_table(health: Health, age_s: float) -> str:
    """Write lines for a terminal: the whole, each part with its values, then what each reason means and what to do.

    age_s: how long ago the record was made.
    """
    lines = [
        f"auv-mcm {health.version}  {health.state}  {age_s:.0f} s ago  {health.session}",
        "",
        *(_row(part) for part in health.parts),
    ]
    reasons = dict.fromkeys(reason for part in health.parts for reason in part.reasons)
    if reasons:
        lines += ["", *(f"{reason}: {REASONS.get(reason, 'a reason of another version')}" for reason in reasons)]
    return "\n".join(clean(line) for line in lines)


def prometheus_text(health: Health) -> str:
    """Write the text format of Prometheus, version 0.0.4.

    auv_mcm_state{part} is 0 for boot, 1 normal, 2 degraded, 3 fault; auv_mcm_reason{part,code} is 1 while it holds.
    """
    lines = ["# HELP auv_mcm_state " + ", ".join(f"{n} {state}" for n, state in enumerate(STATES))]
    lines.append("# TYPE auv_mcm_state gauge")
    lines += [f"auv_mcm_state{_labels(part)} {STATES.index(part.state)}" for part in health.parts]
    lines += ["# HELP auv_mcm_reason 1 while it holds", "# TYPE auv_mcm_reason gauge"]
    lines += [f"auv_mcm_reason{_labels(part, reason)} 1" for part in health.parts for reason in part.reasons]
    lines += ["# HELP auv_mcm_time_seconds UTC of this record", "# TYPE auv_mcm_time_seconds gauge"]
    lines.append(f"auv_mcm_time_seconds {health.utc_s:.3f}")
    for name, meaning in VALUES.items():
        samples = [f"{_labels(part)} {part.values[name]:.16g}" for part in health.parts if name in part.values]
        if samples:
            metric = f"auv_mcm_{metric_name(name)}"
            kind = "counter" if name.endswith("_total") else "gauge"
            lines += [f"# HELP {metric} {meaning}", f"# TYPE {metric} {kind}"]
            lines += [metric + sample for sample in samples]
    return "\n".join(lines) + "\n"


def metric_name(value: str) -> str:
    """Give the name of a value with the unit spelt out, as Prometheus has it."""
    for ending, unit in _BASE_UNITS.items():
        if value.endswith(ending):
            return value.removesuffix(ending) + unit
    return value


def _link_state(part: Part) -> str:
    return next(
        (reason.removeprefix("port_") for reason in ("port_down", "port_silent") if reason in part.reasons), "up"
    )


def _row(part: Part) -> str:
    values = "  ".join(f"{name} {_short(name, value)}" for name, value in part.values.items())
    return f"{part.state.upper() if part.state == 'fault' else part.state:9} {part.name:24} " + "  ".join(
        text for text in (", ".join(part.reasons), part.words, values) if text
    )


def _short(name: str, value: float) -> str:
    if name.endswith("_bytes") or "bytes_" in name:
        for unit, size in (("G", 1e9), ("M", 1e6), ("k", 1e3)):
            if value >= size:
                return f"{value / size:.3g}{unit}"
    return f"{value:.0f}" if value >= 1000.0 or value == int(value) else f"{value:.3g}"


def _labels(part: Part, code: str = "") -> str:
    """Write labels, whose values escape backslash, quote and line end."""
    named = {"part": part.name} | ({"code": code} if code else {})
    escaped = {
        key: value.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n") for key, value in named.items()
    }
    return "{" + ",".join(f'{key}="{value}"' for key, value in escaped.items()) + "}"
