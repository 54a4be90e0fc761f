"""Draw the free-response curve."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from auv_mcm.errors import UsageError
from sim_replay.scoring.froc import AREA_TO_PER_KM2
from sim_replay.scoring.intervals import poisson_interval, proportion
from sim_replay.scoring.score import Score

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_LEFT_PER_KM2: Final = 0.1  # false alarms per km² at the left end; the axis is logarithmic
_INK: Final = "#1f4e79"
_MARK: Final = "#c0392b"
_DPI: Final = 150  # of the picture


def plot(score: Score, path: Path) -> None:
    """Write the curve with its 95 % band, and the chosen threshold with both intervals.

    The suffix chooses the format, PNG at best.

    Raises UsageError for a suffix that is not a picture format or missions without targets, OSError if the file cannot
    be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    if not score.n_targets:
        raise UsageError("the truth holds no targets that were seen: there is no Pd to draw. Leave --plot out")
    figure = Figure(figsize=(7.5, 5.0), dpi=_DPI, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    known = path.suffix.lower().lstrip(".")
    if known not in canvas.get_supported_filetypes():
        raise UsageError(f"--plot {path}: '{path.suffix}' is not a picture format. Use a name that ends in .png")
    axes = figure.add_subplot()
    per_km2, pd, low, high = _stairs(score)
    right = max(AREA_TO_PER_KM2, 1.5 * float(per_km2[-1]))
    axes.fill_between(per_km2, low, high, step="post", color=_INK, alpha=0.18, linewidth=0.0, label="95 % (Wilson)")
    axes.step(per_km2, pd, where="post", color=_INK, linewidth=1.8, label="Pd")
    axes.plot(
        [per_km2[-1], right],
        [pd[-1], pd[-1]],
        color=_INK,
        linewidth=1.2,
        linestyle=":",
        label="no contacts left to call",
    )
    _mark_chosen(axes, score)
    axes.set_xscale("log")
    axes.set_xlim(_LEFT_PER_KM2, right)
    axes.set_ylim(0.0, 1.02)
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set_xlabel("false alarms per km²")
    axes.set_ylabel("probability of detection")
    axes.grid(which="major", color="0.85")
    axes.grid(which="minor", axis="x", color="0.93", linewidth=0.5)
    axes.set_axisbelow(True)
    plural = "s" if len(score.missions) > 1 else ""
    axes.set_title(
        f"{len(score.missions)} mission{plural}, {score.n_targets} targets, {score.area_km2:.3g} km², gate "
        f"{score.gate_m:g} m",
        fontsize=10,
    )
    axes.legend(loc="lower right", framealpha=1.0, edgecolor="none")
    figure.savefig(path)


def _stairs(score: Score) -> tuple[NDArray[np.float64], ...]:
    """List false alarms per km², Pd and its bounds at the stair's steps.

    A density of 0 is put at the left edge of the logarithmic axis.
    """
    steps = {0.0: (0.0, 0.0, float(proportion(0, score.n_targets).high))}
    for point in score.froc:
        steps[point.false_alarms.count / score.area_km2] = (float(point.pd.value or 0.0), point.pd.low, point.pd.high)
    pd, low, high = np.array(list(steps.values())).T
    return np.maximum(np.array(list(steps)), _LEFT_PER_KM2), pd, low, high


def _mark_chosen(axes: Axes, score: Score) -> None:
    chosen = score.at_threshold
    pd = float(chosen.pd.value or 0.0)
    low, high = (bound / score.area_km2 for bound in poisson_interval(chosen.false_alarms.count))
    per_km2 = max(chosen.false_alarms.count / score.area_km2, _LEFT_PER_KM2)
    axes.errorbar(
        [per_km2],
        [pd],
        xerr=[[max(per_km2 - float(low), 0.0)], [max(float(high) - per_km2, 0.0)]],
        yerr=[[pd - chosen.pd.low], [chosen.pd.high - pd]],
        fmt="o",
        color=_MARK,
        markersize=5.0,
        capsize=3.0,
        linewidth=1.2,
        label=f"p_mine ≥ {score.threshold:g}",
    )
