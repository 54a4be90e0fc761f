"""Add the options that choose which missions a bench flies, and read them."""

from __future__ import annotations

import argparse
from pathlib import Path

from auv_mcm.errors import UsageError
from sim_replay.arguments import count
from sim_replay.simulator.scene_file import named_scenes


def add_line_options(parser: argparse.ArgumentParser, n_draws: int) -> None:
    """Add which recorded lines targets are embedded in, and how often by default."""
    parser.add_argument(
        "--log",
        type=Path,
        action="append",
        default=[],
        metavar="FILE",
        help="a recorded line to augment, XTF; repeatable",
    )
    parser.add_argument(
        "--log-seeds",
        type=count,
        default=n_draws,
        help=f"draws of targets per recorded line (default {n_draws})",
    )


def chosen_scenes(text: str) -> tuple[str, ...]:
    """Return the scenes that `--scenes` names.

    Raises UsageError for a scene that is not there, or that is named twice.
    """
    names = tuple(text.split(","))
    if unknown := [repr(name) for name in names if name not in named_scenes()]:
        raise UsageError(f"--scenes: there is no {', '.join(unknown)}. Choose from {', '.join(named_scenes())}")
    if len(set(names)) < len(names):
        raise UsageError(f"--scenes {text}: a scene is named twice. Name each once")
    return names


def chosen_seeds(arguments: argparse.Namespace) -> range:
    """Return the seeds of each scene's missions."""
    return range(arguments.first_seed, arguments.first_seed + arguments.seeds)


def chosen_draws(arguments: argparse.Namespace) -> range:
    """Return the seeds by which targets of each recorded line are drawn."""
    return range(arguments.first_seed, arguments.first_seed + arguments.log_seeds)
