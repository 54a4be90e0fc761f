"""Word numbers with units, positions as read on a chart, and what each counter means to a person."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime, timedelta
from typing import Final, NamedTuple

from auv_mcm.classify.beliefs import APART_FROM, DEMPSTER_BELOW
from auv_mcm.skips import SKIPS

_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)

STAGES: Final = {
    "reader": "Reading the log",
    "ping": "Order of pings",
    "navigation": "Navigation",
    "quality": "Quality of echoes",
    "transfer": "Sample scale",
    "bottom": "Bottom tracking",
    "ground": "Ground range",
    "radiometry": "Brightness",
    "waterfall": "Waterfall tiles",
    "grid": "Waterfall tiles",
    "tile": "Waterfall tiles",
    "coverage": "Coverage",
    "detect": "Detection",
    "contacts": "Contacts",
    "plan": "Re-inspection plan",
    "replay": "Replay",
    "service": "Service",
    "queue": "Queues",
}

WORK: Final = frozenset(
    {
        *("reader.pings", "reader.joined_log", "reader.repeated_navigation", "reader.other_channel", "ping.received"),
        *("detect.candidate", "detect.suppressed", "detect.windows", "detect.evaluations", "detect.windows_rejected"),
        *(
            "detect.gated",
            "detect.pixels_bounded",
            "detect.tiles_clear_contrasts",
            "detect.tile_skipped_nothing_to_see",
        ),
        *("confirm.looked_at", "confirm.rejected", "confirm.odds_too_low", "confirm.ended_at_contours"),
        *("confirm.ended_at_verifier", "confirm.solids_not_refined", "contacts.too_unlikely", "contacts.repeated"),
    }
)
"""Counters of work done, and of work that could not have changed the answer."""

_SKIPPED: Final = {skip.counter: f"{skip.leaves_out}: {skip.because}" for skip in SKIPS}

MEANINGS: Final = {
    "detect.evaluations": "comparisons of brightness that the trained detector made",
    "detect.windows": "places that the trained detector looked at",
    "confirm.looked_at": "detections that were confirmed: echo and shadow outlined and compared with solids",
    "confirm.rejected": "of these, detections whose outlines cannot be those of a mine",
    "detect.candidate": "places bright or dark enough to measure",
    "detect.windows_cut": "places beyond a tile's budget, where contrasts served without the cascade",
    "confirm.beyond_budget": "detections beyond a tile's budget, not confirmed",
    "budget.tile_limited": "tiles whose budget left something out, which earn less coverage",
    "budget.cheapest_pass_over": "tiles whose cheapest pass is beyond their budget",
    "detect.over_budget": "candidates beyond the limit of a tile, not measured",
    "detect.suppressed": "candidates merged into a stronger one beside them",
    "contacts.repeated": "detections of a likely mine that their passage had shown more clearly, left out",
    "detect.tile_skipped_nothing_to_see": "tiles without a valid pixel, skipped",
    "detect.without_position": "detections left out because their position is not known",
    "navigation.heading_from_course": "navigation samples without heading: the course over ground stood in for it",
    "navigation.speed_from_fixes": "navigation samples without speed: it was derived from position fixes",
    "pipeline.close_look_failed": "detections whose confirmation failed: they keep the detector's p_mine",
    "pipeline.coverage_failed": "tiles whose coverage could not be computed: they count as not covered",
    "pipeline.detection_failed": "tiles in which detection failed: they count as not covered",
    "ping.received": "pings that came in",
    "ping.trace_unusable": "traces refused by the quality checks",
    "ping.without_samples": "pings without a single sample",
    "plan.outside_fence": "contacts without a second view proposed, since the way leads out of the vehicle's fence",
    "plan.start_pose_unknown": "re-inspection plans not made because the vehicle's last pose is not known",
    "quality.dead": "traces without any signal",
    "quality.floor_not_heard": "pings of a side that show no sea floor: nothing there counts as covered",
    "quality.interference": "pings with pulses of another sonar, which were taken out",
    "quality.no_samples": "traces without samples",
    "quality.ping_mostly_saturated": "traces with most of their echoes clipped",
    "quality.trace_all_negative": "traces without a positive sample",
    "quality.trace_scaled": "traces scaled by a power of two, since their squares would not fit into single precision",
    "quality.stuck": "traces that repeat the one before, sample by sample",
    "replay.log_unusable": "logs nothing could be read from",
    "replay.bottom_line_unused": "corrected bottom lines that do not belong to their log, not used",
    "perception.restarted": "times that the perception process ended too early and was started again",
    "service.event_dropped": "results dropped because the receiver was too slow",
    "service.journal_failed": "results that could not be written to disk",
    "service.not_spooled": "pings and samples that a restart could not have been fed again: the disk did not take them",
    "service.ping_dropped": "pings dropped because perception was too slow",
    "service.work_shed": "pings with which less work was allowed because perception was behind",
    "service.ping_too_large": "pings larger than the buffer between processes",
    "transfer.turned": "changes of the sample law after pings had been read by another one",
    "bottom.not_seen": (
        "pings whose first bottom return did not stand out; the altitude was carried over from their neighbours"
    ),
    "bottom.corrected": "pings whose first bottom return a person corrected",
    "bottom.correction_beyond_range": "pings whose corrected first bottom return is beyond their range, not used",
    "navigation.not_finite": "navigation values that were not numbers, dropped",
    "navigation.ping_stale": (
        "pings too far from a navigation sample: their position is uncertain, they earn no coverage"
    ),
    "navigation.position_repeated": "positions left out because they repeat the fix before while the vehicle moves",
    "navigation.position_jump": "position fixes rejected because the vehicle cannot have moved that far",
    "navigation.position_out_of_range": "positions that do not exist on Earth, rejected",
    "navigation.position_refix": "times a jump was accepted after several fixes agreed on the new place",
    "navigation.position_zero": "positions of exactly zero: a navigation unit that had no fix yet",
    "navigation.speed_unknown": "pings without a speed, neither measured nor derivable",
    "navigation.time_backwards": "navigation samples older than the one before, dropped",
    "navigation.time_leap": "navigation samples whose clock leapt, dropped",
    "navigation.time_not_finite": "navigation samples without a usable time, dropped",
    "navigation.time_repeated": "navigation values with the time of the one before, dropped",
    "navigation.zero_with_position": "values of exactly zero that came with a position and were taken for not measured",
    "ping.sub_aperture": "times the pings went on to another sub-aperture: a new stretch begins",
    "ping.clock_stepped_back": "times the ping clock stepped back for good: a new stretch begins",
    "ping.gap": "holes between pings: nothing there is covered",
    "ping.no_side_scan_channel": "pings without a side-scan channel, dropped",
    "ping.time_backwards": "pings older than the one before, dropped",
    "ping.time_not_finite": "pings without a usable time, dropped",
    "ping.time_repeated": "pings with the time of the one before, dropped",
    "quality.sample_not_finite_or_negative": "samples that cannot be echoes, masked",
    "quality.sample_saturated": "clipped samples: their level is a minimum, never used as background",
    "radiometry.gain_step": "sudden changes of gain, evened out",
    "reader.clock_stuck": "pings whose recorder clock stood still; times were spread evenly",
    "reader.damaged_bytes": "bytes skipped in search of the next readable packet",
    "reader.damaged_packet": "packets that could not be read, skipped",
    "reader.impossible_position": "positions that do not exist on Earth",
    "reader.joined_log": "places where one log ends and the next begins",
    "reader.nan_navigation": "packets with navigation that was not a number",
    "reader.other_channel": "channels that are not the chosen side-scan pair",
    "reader.packet_not_side_scan": "packets of another kind, not needed here",
    "reader.pings": "pings read",
    "reader.repeated_navigation": "pings that repeat the navigation of the one before",
    "reader.sample_not_finite": "samples that were not numbers",
    "reader.side_empty": "pings with an empty channel on one side",
    "reader.sound_speed_absurd": "sound speeds that no sea has, replaced by 1500 m/s",
    "reader.time_backwards": "pings older than the one before",
    "reader.time_invalid": "packets whose date or time does not exist",
    "reader.time_tied": "pings that shared a coarse time stamp and were spread evenly",
    "reader.weight_change": "changes of the recorder's weighting factor",
    "reader.zero_navigation": "packets with all navigation at zero",
    "reader.zero_position": "packets with a position of exactly zero",
}


class CounterLine(NamedTuple):
    """Hold one counter with its meaning."""

    name: str
    number: str
    meaning: str


def is_loss(name: str) -> bool:
    """Decide whether a counter counts what was dropped or degraded rather than work done.

    A new counter counts as a loss.
    """
    return name not in WORK and not name.startswith("reader.packet_not_side_scan")


def explained_counters(
    counters: Mapping[str, float], wanted: Callable[[str], bool]
) -> list[tuple[str, list[CounterLine]]]:
    """Explain the wanted counters that are not zero, by stage; one without an entry is shown by its own name."""
    stages: dict[str, list[CounterLine]] = {}
    for name in sorted(counters):
        if counters[name] and wanted(name):
            stage = name.partition(".")[0] if "." in name else ""
            stages.setdefault(STAGES.get(stage, stage.replace("_", " ").capitalize() or "Other"), []).append(
                CounterLine(name, f"{counters[name]:,.10g}".replace(",", "\u202f"), _meaning(name))
            )
    return list(stages.items())


def _meaning(name: str) -> str:
    """Explain a counter, also one per side (`quality.port_...`) or kind (`reader.packet_not_side_scan.attitude`)."""
    sided = re.sub(r"\b(port|starboard)_", "", name)
    side = re.search(r"\b(port|starboard)_", name)
    general, _, kind = sided.rpartition(".")
    if sided in _SKIPPED:
        return _SKIPPED[sided]
    if sided in MEANINGS:
        return MEANINGS[sided] + (f" ({side[1]} side)" if side else "")
    if general in MEANINGS:
        return f"{MEANINGS[general]}: {kind.replace('_', ' ')}"
    return name.rpartition(".")[2].replace("_", " ")


def utc(time_s: float, form: str = "%Y-%m-%d %H:%M:%S") -> str:
    """Write UTC seconds since 1970 as date and time."""
    try:
        return (_EPOCH + timedelta(seconds=round(time_s))).strftime(form)
    except (OverflowError, ValueError):
        return "unknown"


def duration(seconds: float) -> str:
    """Write seconds in a unit that fits."""
    if not math.isfinite(seconds):
        return "unknown"
    if seconds < 10.0:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes:02d} min"
    return f"{minutes} min {rest:02d} s" if minutes else f"{rest} s"


def distance(metres: float) -> str:
    """Write metres in a unit that fits."""
    if not math.isfinite(metres):
        return "unknown"
    return f"{metres:.0f} m" if abs(metres) < 1000.0 else f"{metres / 1000.0:.2f} km"


def area(square_metres: float) -> str:
    """Write square metres in a unit that fits."""
    if not math.isfinite(square_metres):
        return "unknown"
    return (
        f"{square_metres:,.0f} m²".replace(",", "\u202f") if square_metres < 1e5 else f"{square_metres / 1e6:.3f} km²"
    )


def metres(value: float, digits: int = 2) -> str:
    """Write metres; "unknown" if not finite."""
    return f"{value:.{digits}f} m" if math.isfinite(value) else "unknown"


def plus_minus(value_m: float, sigma_m: float) -> str:
    """Write a size with its 1-sigma, if that is known."""
    return f"{value_m:.2f} ± {sigma_m:.2f} m" if math.isfinite(value_m) and math.isfinite(sigma_m) else metres(value_m)


def decibels(level_db: float) -> str:
    """Write decibels with their sign; "none" if not finite."""
    return f"{level_db:+.1f} dB".replace("-", "\u2212") if math.isfinite(level_db) else "none"


def evidence_words(log_ratio: float) -> str:
    """Write evidence for a mine against clutter in nats, and in words: steps of ten and a hundred to one."""
    if not math.isfinite(log_ratio):
        return "unknown"
    strength = next(
        text
        for least, text in ((4.6, "strongly "), (2.3, ""), (1.0, "slightly "), (0.0, None))
        if abs(log_ratio) >= least
    )
    verdict = "undecided" if strength is None else f"{strength}{'for' if log_ratio > 0.0 else 'against'} a mine"
    return f"{verdict} ({log_ratio:+.1f}\u00a0nats)".replace("-", "\u2212")


def agreement(conflict: float) -> str:
    """Word how far the views of a contact contradict each other.

    The steps are those at which they are combined in another way.
    """
    if not math.isfinite(conflict):
        return "unknown"
    steps = (
        (APART_FROM, "they contradict each other so far that they hardly show one object"),
        (DEMPSTER_BELOW, "they contradict each other: what they disagree in counts as unknown"),
        (0.3, "they agree in part"),
        (0.0, "they agree"),
    )
    return f"{next(text for least, text in steps if conflict >= least)} (conflict {conflict:.2f})"


def listed(parts: Sequence[str]) -> str:
    """Join parts by commas, and the last by a word."""
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}" if parts else ""


def call_name(call: str) -> str:
    """Name a verdict as people write it."""
    return {"mine_like": "mine-like", "not_mine_like": "not mine-like"}.get(call, call)


_SIZES: Final = {
    "length_m": "length",
    "width_m": "width",
    "height_m": "height",
    "radius_m": "radius",
    "base_radius_m": "base radius",
    "top_radius_m": "top radius",
    "burial_m": "buried",
    "azimuth_rad": "turned",
}


def model_sizes(sizes: Mapping[str, float], sigma: Mapping[str, float]) -> str:
    """List the sizes of a solid with their 1-sigma, in the order people give them."""
    phrases = []
    for name, word in _SIZES.items():
        size, error = sizes.get(name, math.nan), sigma.get(name, math.nan)
        if not math.isfinite(size) or (name == "burial_m" and size < 0.005):
            continue
        if name == "azimuth_rad":
            phrases.append(f"{word} {math.degrees(size):.0f}°".replace("-", "\u2212"))
            if math.isfinite(error):
                phrases[-1] += f" ± {math.degrees(error):.0f}°"
        else:
            phrases.append(f"{word} {plus_minus(size, error)}")
    return ", ".join(phrases)


def degrees_minutes(degrees: float, positive: str, negative: str, digits: int = 4) -> str:
    """Write a latitude or longitude as read on a chart: 55° 12.3456′ N."""
    if not math.isfinite(degrees):
        return "unknown"
    scaled = round(abs(degrees) * 60.0 * 10**digits)
    whole, minutes = divmod(scaled, 60 * 10**digits)
    width = digits + 3 if digits else 2
    return f"{whole}° {minutes / 10**digits:0{width}.{digits}f}′ {negative if degrees < 0.0 else positive}"


def nice_step(span: float, most: int) -> float:
    """Find the smallest of 1, 2, 5 times a power of ten that divides `span` into `most` parts or fewer."""
    least = span / most
    power = 10.0 ** math.floor(math.log10(least))
    return next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= least * (1.0 - 1e-9))
