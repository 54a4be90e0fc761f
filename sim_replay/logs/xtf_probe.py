"""Learn from the first pings of an XTF log what all of them share: how samples are stored, which fields are used."""

from __future__ import annotations

import math
from collections import Counter
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from auv_mcm.settings.config import SonarConfig
from sim_replay.logs.port_order import DECISIVE, PortOrderEvidence, port_order_evidence
from sim_replay.logs.xtf_layout import Layout
from sim_replay.logs.xtf_navigation import Wanted
from sim_replay.logs.xtf_pings import RawPing, Trace
from sim_replay.logs.xtf_report import LogReport
from sim_replay.logs.xtf_samples import are_signed, halves, hold_both_sides, magnitude


class Change(NamedTuple):
    """Hold what is done to every ping. signed: sides of which magnitudes are used. splits: a trace is both sides."""

    signed: frozenset[str] = frozenset()
    splits: bool = False

    def apply(self, raw: RawPing) -> RawPing:
        """Return the ping with what is done to it."""
        if raw.port is not None and "port" in self.signed:
            raw = replace(raw, port=replace(raw.port, samples=magnitude(raw.port.samples)))
        if raw.starboard is not None and "starboard" in self.signed:
            raw = replace(raw, starboard=replace(raw.starboard, samples=magnitude(raw.starboard.samples)))
        only = raw.port or raw.starboard
        if not self.splits or only is None or (raw.port is not None and raw.starboard is not None):
            return raw
        port, starboard = halves(only.samples)
        return replace(raw, port=replace(only, samples=port), starboard=replace(only, samples=starboard))


class Orders(NamedTuple):
    """Hold which sides are stored far to near."""

    port_far_to_near: bool
    starboard_far_to_near: bool


class Fields(NamedTuple):
    """Hold which fields of ping headers are used. wanted: what they lack, so that navigation packets give it."""

    ship_position: bool
    ship_gyro: bool
    ship_speed: bool
    wanted: Wanted


def learn_change(probe: list[RawPing], layout: Layout, blank_m: float, report: LogReport) -> Change:
    """Find whether samples are signed, and whether one trace holds two sides.

    Parameters
    ----------
    probe
        The first pings.
    layout
        How the log holds channels.
    blank_m
        Slant range of ring-down.
    report
        Takes notices.
    """
    place = report.place(probe[0].offset)
    signed = {side for side in ("port", "starboard") if _is_signed(side, probe, layout, report)}
    change = Change(frozenset(signed))
    if not _hold_both_sides([change.apply(raw) for raw in probe], blank_m):
        return change
    text = (
        "one channel holds both sides, port from far to near, then starboard from near to far: the water "
        "column is in its middle. It is split there; if port and starboard look exchanged, set sonar.sides: "
        "swapped"
    )
    report.notify("reader.both_sides_in_one_channel", text, place)
    return change._replace(splits=True)


def _is_signed(side: str, probe: list[RawPing], layout: Layout, report: LogReport) -> bool:
    traces = [trace for raw in probe if (trace := getattr(raw, side)) is not None]
    if not traces or (layout.pair.port if side == "port" else layout.pair.starboard) is None:
        return False
    says_signed = layout.says_signed(side)
    if not are_signed(np.concatenate([trace.samples for trace in traces]), says_signed):
        return False
    text = f"samples of {side} are signed numbers about zero; their magnitude is used"
    if not says_signed:
        text += ", although the file header says UniPolar. Check the waterfall, and export envelopes if it is wrong"
    report.notify("reader.signed_samples", text, report.place(probe[0].offset), for_the_record=says_signed)
    return True


def _hold_both_sides(probe: list[RawPing], blank_m: float) -> bool:
    if any(raw.port is not None and raw.starboard is not None for raw in probe):
        return False
    traces = [trace for raw in probe if (trace := raw.port or raw.starboard) is not None]
    (n_samples, range_m), _ = Counter((trace.samples.shape[0], trace.range_m) for trace in traces).most_common(1)[0]
    chosen = [trace.samples for trace in traces if (trace.samples.shape[0], trace.range_m) == (n_samples, range_m)]
    return hold_both_sides(np.stack(chosen), range_m, blank_m)


def learn_fields(
    probe: list[RawPing], packet_kinds: dict[str, int], nav_units: int | None, report: LogReport
) -> Fields:
    """Find which fields of ping headers hold navigation, and which quantities packets of their own have to give.

    Parameters
    ----------
    probe
        The first pings.
    packet_kinds
        Kinds of packets that give position, heading and level.
    nav_units
        What a log says whose positions are degrees by value; None where they are what it says.
    report
        Takes notices.
    """
    headers, place = [raw.header for raw in probe], report.place(probe[0].offset)

    def any_known(field: str) -> bool:
        return any(math.isfinite(value) and value != 0.0 for value in (getattr(h, field) for h in headers))

    def all_unknown(field: str) -> bool:
        return not any_known(field)

    ship_position = (
        all_unknown("SensorYcoordinate") and all_unknown("SensorXcoordinate") and any_known("ShipYcoordinate")
    )
    if ship_position:
        layback = any_known("Layback")
        report.notify_once(
            "reader.ship_position",
            f"the log has no sensor positions; the vessel's are used, {'with the' if layback else 'without'} "
            f"layback{' logged for each ping' if layback else ''}. For a towed sonar log sensor positions, or set "
            "sonar.lever_arm_m to the sonar's place from the vessel's reference ([-30, 0, 0] for 30 m astern)",
            place,
        )
    wanted = Wanted(
        position=not (ship_position or any_known("SensorYcoordinate") or any_known("SensorXcoordinate")),
        heading=all_unknown("SensorHeading") and all_unknown("ShipGyro"),
        level=all_unknown("SensorPitch") and all_unknown("SensorRoll"),
    )
    used = ", ".join(
        f"{quantity} from packets {kind}" for quantity, kind in packet_kinds.items() if getattr(wanted, quantity)
    )
    if used:
        text = f"ping headers lack what packets of their own hold: {used}"
        report.notify("reader.navigation_packets", text, place, for_the_record=True)
    if nav_units is not None and (used or not wanted.position):
        report.notify_once(
            "reader.units_by_value",
            f"the log says that positions are metres (NavUnits {nav_units}), and their values are "
            "degrees: they are read as degrees. Check a contact's place; have the writer state NavUnits 3",
            place,
        )
    return Fields(
        ship_position=ship_position,
        ship_gyro=all_unknown("SensorHeading") and any_known("ShipGyro"),
        ship_speed=all_unknown("SensorSpeed") and any_known("ShipSpeed"),
        wanted=wanted,
    )


def learn_orders(probe: list[RawPing], sonar: SonarConfig, report: LogReport) -> Orders:
    """Find which sides are stored far to near: port as a rule, starboard against the format.

    Parameters
    ----------
    probe
        The first pings.
    sonar
        As configured.
    report
        Takes notices.
    """
    is_turned = _starboard_is_turned(probe, sonar.blank_m, report)
    if is_turned:
        probe = [replace(raw, starboard=_reversed(raw.starboard)) for raw in probe]
    return Orders(_port_order(probe, sonar, report) == "far_to_near", is_turned)


def _port_order(probe: list[RawPing], sonar: SonarConfig, report: LogReport) -> str:
    wanted = sonar.port_order
    evidence = _probe_port_order(probe, sonar.blank_m)
    place = report.place(probe[0].offset)
    if evidence is None:
        return "far_to_near"  # no port channel: nothing to turn
    seen = None
    if abs(evidence.total) >= DECISIVE:
        seen = "far_to_near" if evidence.total > 0.0 else "near_to_far"
    cues = (
        f"water column {evidence.water_column:+.2f}, ring-down {evidence.ring_down:+.2f}, "
        f"likeness to starboard {evidence.starboard:+.2f}; positive speaks for far_to_near"
    )
    if wanted == "auto":
        order = seen or "far_to_near"
        text = (
            f"port samples are taken as stored {order} ({cues})"
            if seen
            else f"the order of port samples cannot be seen in the first pings ({cues}); {order} is assumed. "
            "If port looks mirrored, set sonar.port_order"
        )
        report.notify("reader.port_order", text, place, for_the_record=seen is not None)
        return order
    if seen is not None and seen != wanted and abs(evidence.total) >= 2 * DECISIVE:
        report.notify(
            "reader.port_order_disagrees",
            f"sonar.port_order is {wanted}, but the first pings look {seen} ({cues}). The setting is obeyed; "
            "check the port waterfall",
            place,
        )
    return wanted


def _starboard_is_turned(probe: list[RawPing], blank_m: float, report: LogReport) -> bool:
    """Check whether starboard is stored far to near, which the format does not provide for."""
    alone = _probe_port_order([replace(raw, port=raw.starboard, starboard=None) for raw in probe], blank_m)
    if alone is None or alone.total < DECISIVE:
        return False
    port = _probe_port_order([replace(raw, starboard=None) for raw in probe], blank_m)
    likeness = 0.0
    if port is not None and abs(port.total) >= DECISIVE:
        near = [replace(raw, port=_reversed(raw.port)) for raw in probe] if port.total > 0.0 else probe
        pairs = [replace(raw, port=raw.starboard, starboard=raw.port) for raw in near]
        with_port = _probe_port_order(pairs, blank_m)
        likeness = 0.0 if with_port is None else with_port.starboard
    if alone.total < 2 * DECISIVE and alone.total + likeness < 3 * DECISIVE:
        return False
    text = "starboard is stored far to near and is turned"
    exchanged = port is not None and port.total <= -2 * DECISIVE
    if exchanged:
        text += (
            ", while port is stored near to far: the channels may be exchanged. The file header's sides are taken; "
            "if port and starboard look exchanged, set sonar.sides: swapped"
        )
    code = "reader.sides_disagree" if exchanged else "reader.starboard_order"
    report.notify(code, text, report.place(probe[0].offset), for_the_record=not exchanged)
    return True


def _reversed(trace: Trace | None) -> Trace | None:
    return None if trace is None else replace(trace, samples=trace.samples[::-1])


def _probe_port_order(probe: list[RawPing], blank_m: float) -> PortOrderEvidence | None:
    """Return evidence from the probed pings of the commonest port form; None without a port channel."""
    forms = Counter((raw.port.samples.shape[0], raw.port.range_m) for raw in probe if raw.port is not None)
    if not forms:
        return None
    n_samples, range_m = forms.most_common(1)[0][0]
    chosen = [
        raw
        for raw in probe
        if raw.port is not None and (raw.port.samples.shape[0], raw.port.range_m) == (n_samples, range_m)
    ]
    port = np.stack([raw.port.samples for raw in chosen if raw.port is not None])
    others = [
        raw.starboard.samples
        for raw in chosen
        if raw.starboard is not None and raw.starboard.samples.shape[0] == n_samples
    ]
    starboard = np.stack(others) if others else None
    return port_order_evidence(
        np.nan_to_num(port), None if starboard is None else np.nan_to_num(starboard), range_m / n_samples, blank_m
    )
