"""Convert false alarms per km² to a probability per decision, which means nothing without the number of decisions.

auv-mcm bench pfa
"""

from __future__ import annotations

import argparse
from typing import Final, NamedTuple

from auv_mcm.settings.config import Config

PAPER_PER_KM2: Final = 100.0
PAPER_PFA: Final = 2.68e-6
"""What the source paper (its figure 12) takes for 100 false alarms per km²."""

_M2_PER_KM2: Final = 1e6
_PAPER_PIXEL_M: Final = (0.12, 0.058)  # along and across track, section 4.3


class DecisionGrid(NamedTuple):
    """Describe how a detector lays its decisions on the sea floor, metres apart along and across track."""

    name: str
    along_m: float
    across_m: float


def decisions_per_km2(along_m: float, across_m: float) -> float:
    """Return K, decisions per km², of a detector with one every along_m by across_m, both above 0. Each pass over a
    place counts.
    """
    if not (along_m > 0.0 and across_m > 0.0):
        raise ValueError(f"decisions {along_m} m by {across_m} m apart: both must be above 0")
    return _M2_PER_KM2 / (along_m * across_m)


def pfa(false_alarms_per_km2: float, per_km2: float) -> float:
    """Return the probability of a false alarm per decision, of a detector with `per_km2` of them, above 0, per km²."""
    if not per_km2 > 0.0:
        raise ValueError(f"{per_km2} decisions per km²: must be above 0")
    return false_alarms_per_km2 / per_km2


def false_alarms_per_km2(probability: float, per_km2: float) -> float:
    """Convert a probability of a false alarm per decision back."""
    return probability * per_km2


def grids() -> tuple[DecisionGrid, ...]:
    """Return one decision per pixel of the source paper's images and of this package's, and one per two pixels by
    two."""
    waterfall = Config().waterfall
    along_m, across_m = waterfall.row_spacing_m, waterfall.column_spacing_m
    return (
        DecisionGrid("each pixel of the source paper", *_PAPER_PIXEL_M),
        DecisionGrid("each second row and column of it", *(2.0 * side for side in _PAPER_PIXEL_M)),
        DecisionGrid("each pixel of the default grid", along_m, across_m),
        DecisionGrid("each second row and column of it", 2.0 * along_m, 2.0 * across_m),
    )


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add no options: nothing is measured."""


def run(arguments: argparse.Namespace) -> int:
    """Print the conversion; return the exit code."""
    implied = PAPER_PER_KM2 / PAPER_PFA
    cell_m = (_M2_PER_KM2 / implied) ** 0.5
    print(
        f"{PAPER_PER_KM2:g} false alarms per km² and a PFA of {PAPER_PFA:.3g}, as the source paper pairs them, are "
        f"{implied:.4g} decisions"
    )
    print(
        f"per km², one in each square of {cell_m:.3f} m. Probabilities compare only where the number of decisions is "
        "the same.\n"
    )
    print(
        f"{'one decision for':<36}{'K per km²':>12}{'PFA at 100/km²':>17}"
        f"{'FA/km² at PFA ' + format(PAPER_PFA, '.3g'):>26}"
    )
    for grid in grids():
        per_km2 = decisions_per_km2(grid.along_m, grid.across_m)
        alarms = false_alarms_per_km2(PAPER_PFA, per_km2)
        print(f"{grid.name:<36}{per_km2:>12.4g}{pfa(PAPER_PER_KM2, per_km2):>17.3g}{alarms:>26.0f}")
    return 0
