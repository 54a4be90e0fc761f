"""Provide the log that a bench of the chain runs over."""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from sim_replay.arguments import count

_SCENE: Final = "demo"


def add_log(parser: argparse.ArgumentParser) -> None:
    """Add the argument for a log and the options of what is flown without one."""
    parser.add_argument(
        "log",
        nargs="?",
        type=Path,
        help=f"an XTF, JSF or svlog file or a recorded session; without it the scene '{_SCENE}' is flown",
    )
    parser.add_argument("--repeat", type=count, default=5, help="repetitions (default 5)")


@contextmanager
def given_or_flown(log: Path | None) -> Iterator[tuple[Path, Path]]:
    """Return the log given, or one of a simulated mission.

    Comes with a folder for further files that is removed afterwards.
    """
    with tempfile.TemporaryDirectory(prefix="auv-mcm-bench-") as folder:
        yield log or _flown(Path(folder)), Path(folder)


def _flown(folder: Path) -> Path:
    from sim_replay.simulate import simulate
    from sim_replay.simulator.scene_file import read_scene

    return simulate(read_scene(_SCENE), folder).log
