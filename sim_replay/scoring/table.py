"""Print a score as plain text for a terminal."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final

from auv_mcm.clean_text import tinted
from sim_replay.scoring.breakdown import Group, PositionSpread
from sim_replay.scoring.froc import Bootstrap, Bounds, OperatingPoint
from sim_replay.scoring.intervals import Density, Proportion
from sim_replay.scoring.matching import MAX_SIGMA_GATE_M, SIGMAS
from sim_replay.scoring.score import MissionRow, Score

_NOTHING: Final = "-"
_MAX_NAME: Final = 40  # characters of a name in the table
_RATES: Final = ("Pd", "interval", "count", "FA per km²", "interval", "FA")


def table(score: Score) -> str:
    """Lay out a score: headline first, then the curve, then where the rates come from; intervals are 95 %."""
    parts = [
        sentence(score),
        _about(score),
        _at_threshold(score),
        _called(score),
        _calibration(score),
        _curve(score),
        _kinds(score),
        _ranges(score.ranges),
        _seabeds(score.seabeds),
    ]
    if len(score.missions) > 1:
        parts.insert(6, _missions(score))
    parts += [_confusion(score), _errors(score), _notes(score)]
    return "\n\n".join(part for part in parts if part) + "\n"


def sentence(score: Score) -> str:
    """Say in one sentence how many mines were found and how many false alarms there were, as far as is known."""
    how = f"found at p_mine {score.threshold:g}" if score.called is None else "called"
    point = score.called or score.at_threshold
    n_wrong = point.false_alarms.count
    alarms = "no false alarm" if not n_wrong else _number_of(n_wrong, "false alarm")
    return f"{point.pd.count} of {_number_of(point.pd.of, 'mine')} {how}, {alarms} on {score.area_km2:.3g} km²."


def _about(score: Score) -> str:
    left_out = score.left_out
    numbers = (
        (len(score.missions), "mission"),
        (score.n_targets, "target"),
        (score.rocks_called_mines.of, "other object"),
        (score.n_contacts, "contact"),
    )
    lines = [
        f"{', '.join(_number_of(*number) for number in numbers)} on {score.area_km2:.4g} km²; intervals are 95 %",
        (
            f"matched one-to-one within {score.gate_m:g} m, or {SIGMAS:g} sigma of the contact if that is more, up to "
            f"{MAX_SIGMA_GATE_M:g} m"
        ),
    ]
    counts = (
        (left_out.targets_never_seen, "target", "that no pass saw"),
        (left_out.other_objects_never_seen, "other object", "that no pass saw"),
        (left_out.contacts_outside_swept_area, "contact", "outside the swept area"),
        (left_out.contacts_without_position, "contact", "without a position"),
    )
    phrases = [f"{_number_of(count, noun)} {why}" for count, noun, why in counts if count]
    return "\n".join([*lines, *([f"left out: {', '.join(phrases)}"] if phrases else [])])


def _at_threshold(score: Score) -> str:
    point, rocks = score.at_threshold, score.rocks_called_mines
    rows = [
        ["Pd", *_share(point.pd)],
        [
            "false alarms per km²",
            *_per_km2(point.false_alarms),
            f"{point.false_alarms.count}, {point.on_known_clutter} of them on known clutter",
        ],
        ["rocks called mines", *_share(rocks)],
        ["duplicates", str(point.duplicates), "", "further contacts on targets that have one; no false alarms"],
    ]
    if point.on_unseen_targets:
        rows.append(
            [
                "on unseen targets",
                str(point.on_unseen_targets),
                "",
                "contacts on targets that no pass saw; no false alarms",
            ]
        )
    if score.bootstrap:
        rows += _resampled(score.bootstrap)
    return _laid_out([f"p_mine >= {score.threshold:g}", "", "interval", "count"], rows, to_left=(0, 3))


def _called(score: Score) -> str:
    point = score.called
    if point is None:
        return ""
    asked, area_km2 = point.asked_per_km2, point.false_alarms.area_km2
    rows = [
        ["Pd", *_share(point.pd)],
        [
            "false alarms per km²",
            *_per_km2(point.false_alarms),
            f"{point.false_alarms.count}, {point.on_known_clutter} of them on known clutter",
        ],
    ]
    if asked is not None:
        expected = "" if area_km2 is None else f"{asked * area_km2:.1f} on this area"
        rows.append(["false alarms per km² asked", f"{asked:g}", "", expected])
    return _laid_out(["called by the payload", "", "interval", "count"], rows, to_left=(0, 3))


def _calibration(score: Score) -> str:
    kept = score.calibration
    if kept is None or kept.error is None:
        return ""
    rows = [[f"{each.low:g}-{each.high:g}", f"{each.mean_p_mine:.3f}", *_share(each.on_mines)] for each in kept.bins]
    laid_out = _laid_out(["p_mine", "mean", "on mines", "interval", "count"], rows)
    return f"{laid_out}\nexpected calibration error of p_mine, in ten bins: {kept.error:.3f}"


def _resampled(bootstrap: Bootstrap) -> list[list[str]]:
    how = f"missions resampled {bootstrap.n_resamples} times"
    return [
        ["Pd, by mission", "", _bounds(bootstrap.pd, 3), how],
        ["per km², by mission", "", _bounds(bootstrap.fa_per_km2, 1), how],
    ]


def _curve(score: Score) -> str:
    rows = [[f"{point.threshold:.1f}", *_point(point)] for point in score.ladder]
    best = []
    for index, headline in enumerate(score.headlines):
        by_mission = [_bounds(score.bootstrap.headline_pd[index], 3)] if score.bootstrap else []
        where = _NOTHING if headline.threshold is None else f"{headline.threshold:.4g}"
        best.append(
            [
                f"{headline.limit_per_km2:g}",
                *_share(headline.pd)[:2],
                *by_mission,
                _three_figures(headline.per_km2),
                where,
            ]
        )
    columns = [
        "at most per km²",
        "best Pd",
        "interval",
        *(["by mission"] if score.bootstrap else []),
        "per km²",
        "p_mine >=",
    ]
    area = (
        ""
        if score.partial_area is None
        else f"\nmean Pd over 1 to 1000 per km², logarithmic (partial area): {score.partial_area:.3f}"
    )
    return (
        _laid_out(columns, best) + area + "\n\n" + _laid_out(["p_mine >=", *_RATES, "on clutter", "duplicates"], rows)
    )


def _missions(score: Score) -> str:
    return _laid_out(["mission", *_RATES], [[_shortened(row.name), *_rates(row)] for row in score.missions])


def _kinds(score: Score) -> str:
    rows = [[row.kind, "target" if row.is_target else "other", *_share(row.called)] for row in score.kinds]
    return _laid_out(["kind", "", "called", "interval", "count"], rows, to_left=(0, 1)) if rows else ""


def _ranges(groups: Sequence[Group]) -> str:
    return _laid_out(["range", *_RATES], [[group.name, *_rates(group)] for group in groups]) if groups else ""


def _seabeds(groups: Sequence[Group]) -> str:
    rows = [[group.name, *_rates(group), _area(group.false_alarms)] for group in groups]
    return _laid_out(["sea floor", *_RATES, "km²"], rows) if rows else ""


def _confusion(score: Score) -> str:
    matrix = score.confusion
    rows = [[row.kind, "target" if row.is_target else "other", *map(str, row.counts)] for row in matrix.rows]
    rows.append(["nothing there", "", *map(str, matrix.nothing_there[:-1]), ""])
    return _laid_out(["truth \\ class", "", *(name.replace("_", " ") for name in matrix.columns)], rows, to_left=(0, 1))


def _errors(score: Score) -> str:
    position, size = score.position_errors, score.size_errors
    rows = [
        ["east", *_spread(position.east_m, "m")],
        ["north", *_spread(position.north_m, "m")],
        ["distance", *_spread(position.total_m, "m")],
        ["distance by sigma_m", *_spread(position.in_sigmas, "")],
        ["length", *_spread(size.length_m, "m")],
        ["width", *_spread(size.width_m, "m")],
        ["height above floor", *_spread(size.height_m, "m")],
    ]
    return _laid_out(["contact less truth", "median", "95 % within", "n"], rows)


def _notes(score: Score) -> str:
    notes = []
    if not score.n_targets:
        notes.append("no targets in the truth: there is no Pd, only false alarms")
    if score.missed_targets_of_unknown_range:
        notes.append(
            f"the truth states no range of {_number_of(score.missed_targets_of_unknown_range, 'missed target')} (no "
            "'looks'): Pd per range band leaves them out and is too high"
        )
    if any(group.false_alarms.count for group in score.ranges):
        notes.append("false alarms per range band are over the whole area, so that the bands add up to the total")
    return "\n".join(f"note: {note}" for note in notes)


def _point(point: OperatingPoint) -> list[str]:
    return [*_rates(point), str(point.on_known_clutter), str(point.duplicates)]


def _rates(rated: OperatingPoint | Group | MissionRow) -> list[str]:
    """Fill the columns of `_RATES`."""
    return [*_share(rated.pd), *_per_km2(rated.false_alarms), str(rated.false_alarms.count)]


def _share(share: Proportion) -> list[str]:
    if share.value is None:
        return [_NOTHING, _NOTHING, "0"]
    return [f"{share.value:.3f}", f"{share.low:.3f}-{share.high:.3f}", f"{share.count} of {share.of}"]


def _per_km2(density: Density) -> list[str]:
    if density.per_km2 is None or density.low is None or density.high is None:
        return [_NOTHING, _NOTHING]
    return [_three_figures(density.per_km2), f"{_three_figures(density.low)}-{_three_figures(density.high)}"]


def _area(density: Density) -> str:
    return f"{density.area_km2:.4g}" if density.area_km2 else _NOTHING


def _bounds(bounds: Bounds | None, digits: int) -> str:
    return _NOTHING if bounds is None else f"{bounds.low:.{digits}f}-{bounds.high:.{digits}f}"


def _spread(spread: PositionSpread, unit: str) -> list[str]:
    if spread.median is None or spread.p95_absolute is None:
        return [_NOTHING, _NOTHING, "0"]
    return [
        *(f"{round(error, 2) + 0.0:.2f} {unit}".rstrip() for error in (spread.median, spread.p95_absolute)),
        str(spread.n),
    ]


def _three_figures(value: float) -> str:
    """Round to three figures or more, and never to a power of ten."""
    return f"{value:.0f}" if value >= 100.0 else f"{value:.3g}"


def _number_of(count: int, noun: str) -> str:
    return f"{count} {noun}" + ("" if count == 1 else "s")


def _shortened(name: str) -> str:
    return name if len(name) <= _MAX_NAME else f"…{name[-_MAX_NAME + 1 :]}"


def _laid_out(header: Sequence[str], rows: Iterable[Sequence[str]], to_left: Sequence[int] = (0,)) -> str:
    """Lay columns two blanks apart, those of text aligned to the left, those of numbers to the right."""
    lines = [list(header), *map(list, rows)]
    widths = [max(len(line[column]) for line in lines) for column in range(len(header))]
    sides = ["<" if column in to_left else ">" for column in range(len(header))]
    texts = [
        "  ".join(f"{cell:{side}{width}}" for cell, side, width in zip(line, sides, widths, strict=True))
        for line in lines
    ]
    first, *others = (text.rstrip() for text in [texts[0], "-" * len(texts[0]), *texts[1:]])
    return "\n".join([tinted(first, "bold"), *others])
