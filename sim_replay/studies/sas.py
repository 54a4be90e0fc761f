"""Outline and classify mines in synthetic aperture images, simulated and recorded.

auv-mcm bench sas                    objects on simulated sand: outlines, classes, blurred shadows, looks
auv-mcm bench sas --pictures DIR     the same objects embedded in recorded pictures: outlines and classes
"""

from __future__ import annotations

import argparse
from pathlib import Path

from auv_mcm.classify.fit import SOLIDS
from sim_replay.arguments import count
from sim_replay.studies.embedded_snippets import PIXELS_M, embed, noise_of, recorded_floors
from sim_replay.studies.sas_objects import MORE, looks_compared, outlines_and_classes, shadows_compared, tables_of


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `auv-mcm bench sas`."""
    parser.add_argument("--objects", type=count, default=4, help="objects per class (default 4)")
    parser.add_argument(
        "--pictures", type=Path, metavar="DIR", help="folder with recorded pictures, sas and floors/sassed, to embed in"
    )


def run(chosen: argparse.Namespace) -> int:
    """Print the tables; returns the exit code. Raises BadInputError for a folder without pictures."""
    if chosen.pictures is not None:
        print(embedded(chosen.pictures, chosen.objects))
        return 0
    print(outlines_and_classes(chosen.objects), flush=True)
    print()
    print(shadows_compared(chosen.objects), flush=True)
    print()
    print(looks_compared(MORE * chosen.objects))
    return 0


def embedded(data: Path, n: int) -> str:
    """Write the tables of n objects per class and pixel size, each in the next of the recorded pictures."""
    floors = recorded_floors(data)
    noise = noise_of(floors)
    drawn = {
        pixel_m: [
            embed(solid, pixel_m, floors[(4 * number + k) % len(floors)], noise, 4 * number + k)
            for number in range(n)
            for k, solid in enumerate(SOLIDS)
        ]
        for pixel_m in PIXELS_M
    }
    return f"{len(floors)} pictures, noise {noise:.3f} of the mean floor\n\n" + tables_of(drawn, "pixel, cm")
