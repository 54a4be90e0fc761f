"""Ask how fine a sonar has to resolve: for the best observer, who knows everything but what lies there, and the chain.

auv-mcm bench resolution                         both, and prints
auv-mcm bench resolution --quick                 a few objects and no chain; ends with code 5 if an answer is impossible
auv-mcm bench resolution --without-chain         the observer alone
auv-mcm bench resolution --plot FILE             draws the curves, too (.png, .svg, .pdf)

The observer knows floor, pose, place and the law of speckle, and has seen each rock and mine before; no processing errs
less. Pixels are independent samples as large as the resolution, in slant range and along the
track.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Final

import numpy as np

from auv_mcm.errors import SelfCheckError
from sim_replay.arguments import count
from sim_replay.benches.resolution.chain import FIRST_SEED, LIMIT_PER_KM2, SETTINGS, fly, rows
from sim_replay.benches.resolution.distances import DISTINCT_NATS, ERRORS, FOUND_NATS
from sim_replay.benches.resolution.observer import (
    COARSER,
    Distances,
    drawn_anew,
    nats_of,
    observed,
    pixel_for,
    share_rows,
)
from sim_replay.benches.resolution.pictures import FINE_M, MINES
from sim_replay.text_tables import columns, markdown

STRENGTHS_DB: Final = {"bright": -12.0, "faint": -24.0}
"""Backscattering strengths of objects: the brightest and the faintest of the named scenes."""
LOOKS: Final = (1, 4)
"""Looks per pixel: a side-scan sonar has one, multilook images have some."""
SHARE: Final = 0.9
"""Share of mines for which a pixel has to be small enough."""
_QUESTIONS: Final = (
    ("found", "floor", FOUND_NATS),
    ("distinct from rocks", "rocks", DISTINCT_NATS),
    ("named", "others", DISTINCT_NATS),
)
_QUICK: Final = (2, 3)  # mines of each kind and rocks


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `auv-mcm bench resolution`."""
    parser.add_argument("--mines", type=count, default=24, help="mines of each kind for the observer (default 24)")
    parser.add_argument("--rocks", type=count, default=48, help="rocks for the observer (default 48)")
    parser.add_argument("--missions", type=count, default=8, help="missions of the chain per resolution (default 8)")
    parser.add_argument("--first-seed", type=count, default=FIRST_SEED, help=f"of missions (default {FIRST_SEED})")
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--quick", action="store_true", help="check the observer on a few objects")
    what.add_argument("--without-chain", action="store_true", help="leave the chain out")
    parser.add_argument("--markdown", action="store_true", help="print tables in Markdown")
    parser.add_argument("--plot", type=Path, metavar="PATH", help="draw the curves (.png, .svg, .pdf)")


def run(arguments: argparse.Namespace) -> int:
    """Ask both, and print; returns the exit code. Raises SelfCheckError for an answer of --quick that cannot be."""
    n_mines, n_rocks = _QUICK if arguments.quick else (arguments.mines, arguments.rocks)
    compared = {name: observed(n_mines, n_rocks, strength_db) for name, strength_db in STRENGTHS_DB.items()}
    print(observer_report(compared, in_markdown=arguments.markdown))
    if arguments.plot is not None:
        _draw(compared, arguments.plot)
    if arguments.quick:
        check(compared)
        return 0
    if not arguments.without_chain:
        print()
        print(chain_report(arguments.missions, arguments.first_seed, in_markdown=arguments.markdown))
    return 0


def check(compared: dict[str, list[Distances]]) -> None:
    """Check what holds for any objects: finer pixels, more looks and a second view never separate less.

    Raises SelfCheckError.
    """
    for one in (one for some in compared.values() for one in some):
        for name in ("floor", "rocks", "others"):
            nats = getattr(one, name)
            if not (np.all(np.isfinite(nats)) and np.all(nats >= 0.0)):
                raise SelfCheckError(f"a {one.kind} is {nats.min():g} nats from {name}: a distance is 0 or more")
            # A pixel that is n times a smaller one is its average, which cannot separate more.
            for finer, coarse in ((0, 1), (1, 2), (2, 3), (3, 4), (4, 6)):
                if np.any(nats[:, coarse] > nats[:, finer] * (1.0 + 1e-9)):
                    raise SelfCheckError(f"a coarser pixel separates a {one.kind} better from {name}")
            if np.any(nats[1] < nats[0] * (1.0 - 1e-9)):
                raise SelfCheckError(f"two views separate a {one.kind} from {name} less than one")


def observer_report(compared: dict[str, list[Distances]], *, in_markdown: bool) -> str:
    """Lay out the shares by pixel size, the pixels that suffice, and what a second aspect is worth."""
    table = markdown if in_markdown else columns
    sizes = [f"{100.0 * FINE_M * n:g} cm" for n in COARSER]
    parts = [f"At most {100.0 * ERRORS:g} % errors are guaranteed. Intervals are 95 %, Wilson's."]
    for name, some in compared.items():
        parts.append(
            f"{name} objects, one look, one view:\n\n"
            + table(["mine", "question", *sizes], list(share_rows(some, 1, views=1)))
        )
    for looks in LOOKS:
        header = [
            "mine",
            "question",
            *(f"{name}, {views} view{'s' * (views > 1)}" for name in compared for views in (1, 2)),
        ]
        parts.append(
            f"The largest pixel, cm, that suffices for {100.0 * SHARE:g} % of the mines, looks: {looks}\n\n"
            + table(header, [_pixel_row(compared, kind, question, looks) for kind in MINES for question in _QUESTIONS])
        )
    return "\n\n".join(parts)


def _pixel_row(
    compared: dict[str, list[Distances]], kind: str, question: tuple[str, str, float], looks: int
) -> list[str]:
    words, name, least_nats = question
    cells = []
    for some in compared.values():
        of_kind = [one for one in some if one.kind == kind]
        for views in (1, 2):
            nats = nats_of(of_kind, name, views=views, looks=looks)
            drawn_m = np.nan_to_num(pixel_for(drawn_anew(nats), least_nats, share=SHARE), nan=0.0)
            low, high = np.quantile(drawn_m, [0.025, 0.975]).tolist()
            cells.append(f"{_in_cm(float(pixel_for(nats, least_nats, share=SHARE)))} ({_in_cm(low)}-{_in_cm(high)})")
    return [kind, words, *cells]


def _in_cm(pixel_m: float) -> str:
    """Write a pixel, cm; where none of the sizes tried is small enough, or all are, it says so."""
    if not pixel_m >= FINE_M:
        return f"< {100.0 * FINE_M:g}"
    largest_m = FINE_M * COARSER[-1]
    return f"> {100.0 * largest_m:g}" if pixel_m >= largest_m else f"{100.0 * pixel_m:.0f}"


def chain_report(n_missions: int, first_seed: int, *, in_markdown: bool) -> str:
    """Fly the chain at every resolution, and lay out what it finds, names and ranks above rocks."""
    table = markdown if in_markdown else columns
    lines = []
    for setting in SETTINGS:
        flights = [fly(setting, seed) for seed in range(first_seed, first_seed + n_missions)]
        lines += [[f"{100.0 * setting.resolution_m:g}", f"{setting.looks}", *row] for row in rows(flights)]
        print(f"\r{len(lines) // 2} of {len(SETTINGS)} resolutions flown", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    header = [
        "resolution, cm",
        "looks",
        "views",
        f"Pd at {LIMIT_PER_KM2:g} FA/km²",
        "named right, of those found",
        "mine above rock",
    ]
    return f"The chain, {n_missions} missions:\n\n" + table(header, lines)


def _draw(compared: dict[str, list[Distances]], path: Path) -> None:
    """Draw the median distance of each kind over the pixel size."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 3.4), layout="constrained")
    FigureCanvasAgg(figure)
    pixels_cm = [100.0 * FINE_M * n for n in COARSER]
    for axes, (words, name, least_nats) in zip(figure.subplots(1, 3, sharey=True), _QUESTIONS, strict=True):
        for number, kind in enumerate(MINES):
            for strength, style in zip(compared, ("-", "--"), strict=True):
                some = [getattr(one, name)[0] for one in compared[strength] if one.kind == kind]
                lowest = np.quantile(np.stack(some), 1.0 - SHARE, axis=0)
                axes.loglog(pixels_cm, np.maximum(lowest, 1e-2), style, color=f"C{number}", label=f"{kind}, {strength}")
        axes.axhline(least_nats, color="0.5", linewidth=1.0)
        axes.set(title=words, xlabel="pixel, cm", xticks=pixels_cm, xticklabels=[f"{size:g}" for size in pixels_cm])
        axes.minorticks_off()
    figure.axes[0].set_ylabel(f"nats that {100.0 * SHARE:g} % exceed")
    figure.axes[-1].legend(fontsize=6)
    figure.savefig(path)
