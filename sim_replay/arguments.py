"""Parse a bench's command line; reject numbers with which nothing can be measured, and files that cannot be made."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Final

from auv_mcm.errors import UsageError

_MOST: Final = 1_000_000  # beyond it a number is a slip, not a wish: it would run for years


def count(text: str) -> int:
    """Parse a whole number from 1 to a million. Raises ArgumentTypeError."""
    if not text.isdecimal() or len(text) > 9 or not 1 <= int(text) <= _MOST:
        raise argparse.ArgumentTypeError(f"'{text}' is not a whole number from 1 to {_MOST}")
    return int(text)


def new_file(text: str) -> Path:
    """Parse the name of a file to write; its folder has to be there before anything is measured.

    Raises ArgumentTypeError.
    """
    path = Path(text)
    if not path.parent.is_dir():
        raise argparse.ArgumentTypeError(f"{path}: there is no folder {path.parent}. Make it first")
    return path


def check_new(out: Path | None, option: str = "--out") -> None:
    """Check early that a file can be made. Raises UsageError if it cannot."""
    if out is None:
        return
    if out.exists():
        raise UsageError(f"{option} {out} exists and is not overwritten: name a new file, or remove it")
    if not out.parent.is_dir():
        raise UsageError(f"{option} {out}: there is no folder {out.parent}. Make it first")


def refuse_other_log(log: Path, truth: Path) -> None:
    """Refuse to overwrite a log that no truth beside it shows to be an earlier result. Raises UsageError."""
    if log.exists() and not truth.is_file():
        raise UsageError(
            f"{log} is there without a {truth.name} and may be a recording, which is never overwritten: name another "
            "directory, or remove it"
        )


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
        "--log-seeds", type=count, default=n_draws, help=f"draws of targets per recorded line (default {n_draws})"
    )
