"""Draw Pd over false alarms per km², with bands: a row per group of missions, a column per object."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.errors import UsageError
from auv_mcm.shell.whole_files import write_file
from sim_replay.scoring.roc import Roc
from sim_replay.studies.pfa import PAPER_PER_KM2, PAPER_PFA

if TYPE_CHECKING:
    from matplotlib.axes import Axes

DRAWN_PER_KM2: Final = np.logspace(0.0, 4.0, 33)
"""False alarms per km² that curves are drawn at."""
_COLOURS: Final = ("#1f4e79", "#c0392b")
_SIZE_IN: Final = (2.9, 2.9)  # inches, of one diagram
_DPI: Final = 120  # of a picture of pixels
_DECIMALS: Final = re.compile(rb"(\d\.\d\d)\d+")
"""Numbers of an SVG keep two decimals: a hundredth of a point is finer than any screen, and half as many bytes."""


class Panel(NamedTuple):
    """Hold one diagram: its row and column, and a curve by system.

    once_per_km2: density of one false alarm on all the floor there is; further left nothing can be counted.
    """

    title: str
    name: str
    once_per_km2: float
    curves: dict[str, Roc]


def draw(panels: Sequence[Panel], path: Path) -> None:
    """Write the diagrams; the same curves give the same SVG.

    The suffix chooses the format. Raises UsageError for one that is not a picture format or a file that cannot be
    written.
    """
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    titles, names = (list(dict.fromkeys(getattr(one, part) for one in panels)) for part in ("title", "name"))
    size = _SIZE_IN[0] * len(names), _SIZE_IN[1] * len(titles)
    figure = Figure(figsize=size, dpi=_DPI, layout="constrained")
    suffix = path.suffix.lower().lstrip(".")
    if suffix not in FigureCanvasAgg(figure).get_supported_filetypes():
        raise UsageError(f"--plot {path}: '{path.suffix}' is not a picture format. Use a name that ends in .svg")
    axes = figure.subplots(len(titles), len(names), sharex=True, sharey=True, squeeze=False)
    for one in panels:
        row, column = titles.index(one.title), names.index(one.name)
        _draw(axes[row, column], one)
        if row == 0:
            top = axes[row, column].secondary_xaxis("top", functions=(_as_pfa, _as_per_km2))
            top.set_xlabel(f"{one.name}\n\nPFA as the source paper counts", fontsize=8)
            top.tick_params(labelsize=7)
            top.minorticks_off()
            top.xaxis.set_major_formatter("{x:.0e}")
        if row == len(titles) - 1:
            axes[row, column].set_xlabel("false alarms per km²", fontsize=8)
        if column == 0:
            axes[row, column].set_ylabel(f"{one.title}\nprobability of detection", fontsize=8)
    axes[0, 0].legend(fontsize=7, loc="upper left", framealpha=1.0, edgecolor="none")
    drawn = io.BytesIO()
    with rc_context({"svg.hashsalt": "figure12", "svg.fonttype": "none"}):  # letters, not their outlines: small
        figure.savefig(drawn, format=suffix, metadata={"Date": None} if suffix == "svg" else None)
    data = drawn.getvalue()
    if suffix == "svg":
        data = _DECIMALS.sub(rb"\1", data)
    try:
        write_file(path, data)
    except OSError as error:
        raise UsageError(f"--plot {path} cannot be written: {error.strerror}") from error


def _draw(axes: Axes, panel: Panel) -> None:
    for colour, (system, curve) in zip(_COLOURS, panel.curves.items(), strict=False):
        shown = _corners(curve) & (curve.per_km2 <= max(curve.last_per_km2, curve.per_km2[0]))
        per_km2 = curve.per_km2[shown]
        axes.fill_between(per_km2, curve.low[shown], curve.high[shown], color=colour, alpha=0.18, linewidth=0.0)
        axes.plot(per_km2, curve.pd[shown], color=colour, linewidth=1.4, label=system)
    axes.axvline(panel.once_per_km2, color="0.4", linewidth=0.9, linestyle=":", label="one alarm on the whole floor")
    axes.set_xscale("log")
    axes.minorticks_off()
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set_xlim(DRAWN_PER_KM2[0], DRAWN_PER_KM2[-1])
    axes.set_ylim(0.0, 1.02)
    axes.tick_params(labelsize=7)
    axes.grid(which="major", color="0.88", linewidth=0.6)
    axes.set_axisbelow(True)
    n_targets = next(iter(panel.curves.values())).n_targets
    axes.text(0.98, 0.04, f"{n_targets} targets", transform=axes.transAxes, ha="right", fontsize=7)


def _corners(curve: Roc) -> NDArray[np.bool_]:
    """Find the points without which lines and bands would be drawn differently; the others are left out."""
    steps = np.any(np.diff([curve.pd, curve.low, curve.high], axis=1) != 0.0, axis=0)
    ends = np.concatenate([[True], steps]), np.concatenate([steps, [True]])
    end_of_curve = np.append(curve.per_km2[1:] > curve.last_per_km2, True)
    return np.asarray(ends[0] | ends[1] | end_of_curve)


def _as_pfa(per_km2: NDArray[np.float64]) -> NDArray[np.float64]:
    return per_km2 * (PAPER_PFA / PAPER_PER_KM2)


def _as_per_km2(pfa: NDArray[np.float64]) -> NDArray[np.float64]:
    return pfa * (PAPER_PER_KM2 / PAPER_PFA)
