"""Give the columns that experiments on scored missions share."""

from __future__ import annotations

from collections.abc import Sequence

from sim_replay.benches.experiment import Cell, density, number, share
from sim_replay.scoring.inputs import ScoredMission
from sim_replay.scoring.score import score_missions
from sim_replay.scoring.thresholds import pd_at
from sim_replay.text_tables import NOTHING


def pd_at_limit(limit_per_km2: float, missions: Sequence[ScoredMission], *, on_clutter: bool = True) -> Cell:
    """Show the best Pd with at most so many false alarms per km². on_clutter: whether those on known clutter count."""
    return share(pd_at(score_missions(missions), limit_per_km2, on_clutter=on_clutter))


def pd_at_threshold(missions: Sequence[ScoredMission]) -> Cell:
    """Show Pd at p_mine 0.5."""
    return share(score_missions(missions).at_threshold.pd)


def density_at(missions: Sequence[ScoredMission]) -> Cell:
    """Show false alarms per km² at p_mine 0.5."""
    return density(score_missions(missions).at_threshold.false_alarms)


def rocks_called(missions: Sequence[ScoredMission]) -> Cell:
    """Show the share of objects that are no targets but have a contact at p_mine 0.5."""
    return share(score_missions(missions).rocks_called_mines)


def position_error(missions: Sequence[ScoredMission]) -> Cell:
    """Show the median distance of contacts from their targets, m."""
    median_m = score_missions(missions).position_errors.total_m.median
    return Cell(NOTHING) if median_m is None else number(median_m, 2)


def n_targets(missions: Sequence[ScoredMission]) -> Cell:
    """Show how many targets were seen."""
    return number(score_missions(missions).n_targets)


def area(missions: Sequence[ScoredMission]) -> Cell:
    """Show the area, km²."""
    return number(sum(one.truth.area_km2 for one in missions), 3)
